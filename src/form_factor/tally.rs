//! Counts where the rays of one row landed, in time that follows the rays, not the elements.

/// Elements up to which each has a counter: these fit the processor's second cache.
const FEW: usize = 1 << 16;

/// Rays by element, elements in the order in which they were first met: a counter an element, and not a branch.
pub(super) struct Counts {
    /// The last one counts rays that met no element.
    count: Vec<u32>,
    met: Vec<u32>,
}

impl Counts {
    /// None where the elements are too many.
    pub(super) fn new(elements: usize) -> Option<Counts> {
        (elements <= FEW).then(|| Counts { count: vec![0; elements + 1], met: Vec::new() })
    }

    /// Counts at most `rays` rays by the elements that they met, or [`crate::mesh::NONE`]. Returns the elements, among them the
    /// number of all elements for none, and their counts, to be zero again before rays are counted anew.
    #[inline(always)]
    pub(super) fn count<'r>(
        &mut self,
        landed: impl Iterator<Item = &'r [u32]>,
        rays: usize,
    ) -> (&[u32], &mut [u32]) {
        let none = self.count.len() - 1;
        if self.met.len() <= rays {
            self.met.resize(rays + 1, 0);
        }
        let (met, count) = (&mut self.met[..rays + 1], &mut self.count[..none + 1]);
        let mut len = 0;
        for run in landed {
            for element in run {
                let element = (*element as usize).min(none);
                met[len] = element as u32;
                len += usize::from(count[element] == 0);
                count[element] += 1;
            }
        }
        (&self.met[..len], &mut self.count)
    }

    /// As [`Counts::count`]; shows each element with its number of rays, and starts anew.
    pub(super) fn each<'r>(
        &mut self,
        landed: impl Iterator<Item = &'r [u32]>,
        rays: usize,
        mut each: impl FnMut(u32, u32),
    ) {
        let (met, count) = self.count(landed, rays);
        let none = count.len() - 1;
        for element in met {
            let count = std::mem::take(&mut count[*element as usize]);
            if *element as usize != none {
                each(*element, count);
            }
        }
    }
}

/// Sums of weights by column, in the order in which columns were first met: a hash table with open addressing, in memory that follows
/// the rays.
pub(super) struct Tally {
    channels: usize,
    /// Index into `columns` plus one, or 0.
    slots: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<f32>,
}

impl Tally {
    pub(super) fn new(channels: usize) -> Tally {
        Tally { channels, slots: vec![0; 64], columns: Vec::new(), weights: Vec::new() }
    }

    /// Adds a weight, one number a channel, to a column.
    #[inline]
    pub(super) fn add(&mut self, column: u32, weight: &[f32]) {
        if 2 * (self.columns.len() + 1) > self.slots.len() {
            self.grow();
        }
        let slot = self.slot(column);
        let at = match self.slots[slot] {
            0 => {
                self.columns.push(column);
                self.slots[slot] = self.columns.len() as u32;
                self.weights.extend_from_slice(weight);
                return;
            }
            k => (k as usize - 1) * self.channels,
        };
        self.weights[at..at + self.channels].iter_mut().zip(weight).for_each(|(w, v)| *w += v);
    }

    /// Where a column is, or where it would go.
    #[inline]
    fn slot(&self, column: u32) -> usize {
        let mask = self.slots.len() - 1;
        // Fibonacci hashing: the upper bits of the product are well mixed.
        let mut slot = column.wrapping_mul(0x9e37_79b9) as usize >> (32 - self.slots.len().ilog2());
        loop {
            match self.slots[slot] {
                0 => return slot,
                k if self.columns[k as usize - 1] == column => return slot,
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    #[cold]
    fn grow(&mut self) {
        self.slots = vec![0; 4 * self.slots.len()];
        for k in 0..self.columns.len() {
            let slot = self.slot(self.columns[k]);
            self.slots[slot] = k as u32 + 1;
        }
    }

    /// Hands out columns with their weights and starts anew.
    pub(super) fn drain(&mut self, mut each: impl FnMut(u32, &[f32])) {
        for (column, weight) in self.columns.iter().zip(self.weights.chunks_exact(self.channels)) {
            each(*column, weight);
        }
        self.slots.fill(0);
        self.columns.clear();
        self.weights.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::NONE;
    use std::collections::BTreeMap;

    #[test]
    fn both_count_alike() {
        let landed: Vec<u32> = (0..5000u32).map(|k| if k % 7 == 0 { NONE } else { k * k % 977 }).collect();
        let (mut counts, mut tally) = (Counts::new(977).expect("few"), Tally::new(1));
        for round in 0..2 {
            landed.iter().filter(|c| **c != NONE).for_each(|c| tally.add(*c, &[1.0]));
            let (mut expected, mut found) = (Vec::new(), Vec::new());
            tally.drain(|column, weight| expected.push((column, weight[0] as u32)));
            counts.each(landed.chunks(16), landed.len(), |column, count| found.push((column, count)));
            assert_eq!(found, expected, "round {round}");
        }
        assert!(Counts::new(FEW + 1).is_none());
    }

    #[test]
    fn sums_by_column_and_starts_anew() {
        let mut tally = Tally::new(3);
        for round in 0..2 {
            let mut expected = BTreeMap::new();
            for k in 0..5000u32 {
                // Columns that collide in their lower bits, and repeat.
                let column = (k * k % 977) << 12;
                tally.add(column, &[1.0, 2.0, k as f32]);
                let sum: &mut [f32; 3] = expected.entry(column).or_default();
                *sum = [sum[0] + 1.0, sum[1] + 2.0, sum[2] + k as f32];
            }
            let mut found = BTreeMap::new();
            tally.drain(|column, w| assert!(found.insert(column, [w[0], w[1], w[2]]).is_none()));
            assert_eq!(found, expected, "round {round}");
        }
    }
}
