//! Counts where the rays of one row landed, in time and memory that follow the rays, not the elements.

/// Sums of weights by column, in the order in which columns were first met: a hash table with open addressing.
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
    use std::collections::BTreeMap;

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
