//! Disjoint sets of numbers that are joined (Tarjan 1975).

/// The numbers from 0 up, each in one set.
pub(crate) struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    /// `n` numbers, each in a set of its own.
    pub fn new(n: usize) -> Sets {
        Sets { parent: (0..n as u32).collect() }
    }

    /// The smallest number of the set that `k` is in.
    pub fn find(&mut self, mut k: u32) -> u32 {
        let parent = &mut self.parent;
        while parent[k as usize] != k {
            parent[k as usize] = parent[parent[k as usize] as usize];
            k = parent[k as usize];
        }
        k
    }

    /// Makes the sets of `a` and `b` one.
    pub fn join(&mut self, a: u32, b: u32) {
        let (x, y) = (self.find(a), self.find(b));
        self.parent[x.max(y) as usize] = x.min(y);
    }

    /// The smallest number of every number's set.
    pub fn names(mut self) -> Vec<u32> {
        (0..self.parent.len() as u32).map(|k| self.find(k)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_joined_has_one_name() {
        let mut sets = Sets::new(7);
        [(5, 6), (2, 5), (0, 1), (6, 2), (3, 3)].into_iter().for_each(|(a, b)| sets.join(a, b));
        assert_eq!(sets.find(6), 2);
        assert_eq!(sets.names(), [0, 0, 2, 3, 4, 2, 2]);
    }
}
