//! Rows of form factors in the memory that they need.

use crate::color::{self, Rgb};
use glam::Vec4;
use std::ops::{Add, AddAssign};

/// Bits of a counted entry that hold the column; the others hold the count less one.
const COLUMN_BITS: u32 = 27;
const COLUMN: u32 = (1 << COLUMN_BITS) - 1;
/// Largest count of one entry; larger ones take several entries in a row.
const MOST: u32 = 1 << (32 - COLUMN_BITS);
/// Sums that a row's sum is taken in, for no addition to wait for the one before.
const CHAINS: usize = 4;
/// Entries whose sum single precision may hold.
const RUN: usize = 64;

/// Entries of a block of consecutive rows.
#[derive(Debug, Clone)]
pub(super) enum Entries {
    /// How many rays of a randomisation landed on a column, 4 bytes an entry; by row, what one ray counts.
    Counts(Box<[u32]>, Box<[f64]>),
    /// Columns, and a value for each channel.
    Weights(Box<[u32]>, Box<[f32]>),
}

/// A few consecutive rows.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// Start of each (row, randomisation), and the end.
    start: Box<[u32]>,
    entries: Entries,
}

/// A block while its rows are found.
pub(super) struct Builder {
    start: Vec<u32>,
    counts: bool,
    columns: Vec<u32>,
    values: Vec<f32>,
    scale: Vec<f64>,
}

impl Builder {
    /// `counts`: weights are whole numbers of rays, in one channel.
    pub(super) fn new(counts: bool) -> Builder {
        Builder { start: vec![0], counts, columns: Vec::new(), values: Vec::new(), scale: Vec::new() }
    }

    /// Adds an entry to the current randomisation.
    #[inline]
    pub(super) fn push(&mut self, column: u32, weight: &[f32]) {
        if !self.counts {
            self.columns.push(column);
            self.values.extend_from_slice(weight);
            return;
        }
        self.push_count(column, weight[0] as u32);
    }

    /// Adds an entry of so many rays where these are counted.
    #[inline]
    pub(super) fn push_count(&mut self, column: u32, mut count: u32) {
        debug_assert!(self.counts);
        while count > MOST {
            self.columns.push(column | (MOST - 1) << COLUMN_BITS);
            count -= MOST;
        }
        if count > 0 {
            self.columns.push(column | (count - 1) << COLUMN_BITS);
        }
    }

    /// Adds entries of so many rays where these are counted: of all `met` that are below `columns`. Counts are zero then.
    #[inline(always)]
    pub(super) fn push_counts(&mut self, met: &[u32], columns: u32, counts: &mut [u32]) {
        debug_assert!(self.counts);
        let mut next = self.columns.len();
        self.columns.resize(next + met.len(), 0);
        for (k, &column) in met.iter().enumerate() {
            let count = std::mem::take(&mut counts[column as usize]);
            if count > MOST && column < columns {
                self.columns.truncate(next);
                self.push_count(column, count);
                next = self.columns.len();
                self.columns.resize(next + met.len() - (k + 1), 0);
                continue;
            }
            // Without a branch: what is no column is overwritten.
            self.columns[next] = column | count.wrapping_sub(1) << COLUMN_BITS;
            next += usize::from(column < columns);
        }
        self.columns.truncate(next);
    }

    /// Ends a randomisation.
    pub(super) fn end_batch(&mut self) {
        self.start.push(self.columns.len() as u32);
    }

    /// Ends a row of `batches` randomisations: what was pushed counts `scale` times.
    pub(super) fn end_row(&mut self, batches: usize, channels: usize, scale: f64) {
        if self.counts {
            self.scale.push(scale);
            return;
        }
        let first = self.start[self.start.len() - 1 - batches] as usize;
        self.values[first * channels..].iter_mut().for_each(|v| *v *= scale as f32);
    }

    /// The rows so far; the builder starts anew.
    pub(super) fn finish(&mut self) -> Block {
        let columns = Box::from(&self.columns[..]);
        let entries = match self.counts {
            true => Entries::Counts(columns, Box::from(&self.scale[..])),
            false => Entries::Weights(columns, Box::from(&self.values[..])),
        };
        let block = Block { start: Box::from(&self.start[..]), entries };
        self.start.truncate(1);
        self.columns.clear();
        self.values.clear();
        self.scale.clear();
        block
    }
}

impl Block {
    /// Entries in all.
    pub(super) fn stored(&self) -> usize {
        self.start.last().map_or(0, |s| *s as usize)
    }

    /// Entries are counts of rays.
    pub(super) fn counts_rays(&self) -> bool {
        matches!(self.entries, Entries::Counts(..))
    }

    /// Bytes that the block occupies.
    pub(super) fn bytes(&self) -> usize {
        let entries = match &self.entries {
            Entries::Counts(entries, scale) => 4 * entries.len() + 8 * scale.len(),
            Entries::Weights(columns, values) => 4 * (columns.len() + values.len()),
        };
        size_of::<Block>() + 4 * self.start.len() + entries
    }

    /// Row `k` of the block.
    #[inline]
    pub(super) fn row(&self, k: usize, batches: usize, channels: usize) -> Row<'_> {
        let start = &self.start[k * batches..=(k + 1) * batches];
        match &self.entries {
            Entries::Counts(entries, scale) => {
                Row { start, columns: entries, values: Values::Counts(scale[k]) }
            }
            Entries::Weights(columns, values) => {
                let values = if channels == 1 { Values::Grey(values) } else { Values::Coloured(values) };
                Row { start, columns, values }
            }
        }
    }
}

/// One row of form factors, its independent randomisations apart.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    /// Start of each randomisation, and the end.
    start: &'a [u32],
    columns: &'a [u32],
    values: Values<'a>,
}

#[derive(Debug, Clone, Copy)]
enum Values<'a> {
    Counts(f64),
    Grey(&'a [f32]),
    Coloured(&'a [f32]),
}

impl<'a> Row<'a> {
    /// Independent randomisations.
    pub fn batches(&self) -> usize {
        self.start.len() - 1
    }

    /// Column and value (by channel) of each entry of one randomisation; no column comes twice.
    pub fn batch(&self, batch: usize) -> impl Iterator<Item = (usize, Rgb)> + use<'a> {
        let row = *self;
        let (mut next, end) = (self.start[batch] as usize, self.start[batch + 1] as usize);
        std::iter::from_fn(move || {
            if next == end {
                return None;
            }
            let entry = next;
            next += 1;
            Some(match row.values {
                Values::Counts(scale) => {
                    let column = row.columns[entry] & COLUMN;
                    let mut count = (row.columns[entry] >> COLUMN_BITS) + 1;
                    while next < end && row.columns[next] & COLUMN == column {
                        count += (row.columns[next] >> COLUMN_BITS) + 1;
                        next += 1;
                    }
                    (column as usize, Rgb::splat(f64::from(count) * scale))
                }
                Values::Grey(values) => (row.columns[entry] as usize, Rgb::splat(f64::from(values[entry]))),
                Values::Coloured(values) => {
                    let v = &values[3 * entry..3 * entry + 3];
                    (row.columns[entry] as usize, Rgb::new(v[0].into(), v[1].into(), v[2].into()))
                }
            })
        })
    }

    /// Entries of all randomisations; a column may come once in each.
    pub fn entries(&self) -> impl Iterator<Item = (usize, Rgb)> + use<'a> {
        let row = *self;
        (0..self.batches()).flat_map(move |b| row.batch(b))
    }

    /// Shows column and value, the mean of the channels, of each entry of all randomisations; a column may come once in each.
    #[inline]
    pub(super) fn each_mean(&self, mut show: impl FnMut(usize, f64)) {
        let range = self.start[0] as usize..self.start[self.batches()] as usize;
        let columns = &self.columns[range.clone()];
        match self.values {
            Values::Counts(scale) => {
                for range in self.start.windows(2) {
                    let mut entries = self.columns[range[0] as usize..range[1] as usize].iter();
                    while let Some(e) = entries.next() {
                        let (column, mut count) = (e & COLUMN, (e >> COLUMN_BITS) + 1);
                        // The rest of a large count follows.
                        let mut last = count;
                        while last == MOST && entries.as_slice().first().is_some_and(|e| e & COLUMN == column)
                        {
                            last = entries.next().map_or(0, |e| (e >> COLUMN_BITS) + 1);
                            count += last;
                        }
                        show(column as usize, f64::from(count) * scale);
                    }
                }
            }
            Values::Grey(values) => {
                columns.iter().zip(&values[range]).for_each(|(j, v)| show(*j as usize, f64::from(*v)));
            }
            Values::Coloured(values) => {
                let values = values[3 * range.start..3 * range.end].chunks_exact(3);
                columns.iter().zip(values).for_each(|(j, v)| {
                    show(*j as usize, color::mean(Rgb::new(v[0].into(), v[1].into(), v[2].into())));
                });
            }
        }
    }

    /// Shows randomisation, column and count of each entry of a row that counts rays; a column may come several times.
    #[inline]
    pub(super) fn counts(&self, mut show: impl FnMut(usize, usize, u32)) {
        for (batch, range) in self.start.windows(2).enumerate() {
            for e in &self.columns[range[0] as usize..range[1] as usize] {
                show(batch, (e & COLUMN) as usize, (e >> COLUMN_BITS) + 1);
            }
        }
    }

    /// What one ray of a row that counts them counts.
    pub(super) fn count_scale(&self) -> f64 {
        match self.values {
            Values::Counts(scale) => scale,
            Values::Grey(_) | Values::Coloured(_) => 1.0,
        }
    }

    /// The row times `x`.
    #[inline]
    pub fn dot(&self, x: &[Rgb]) -> Rgb {
        self.sum(0, self.batches(), |j| x[j])
    }

    /// One randomisation times `x`, an estimate of the whole.
    #[inline]
    pub fn dot_batch(&self, batch: usize, x: &[Rgb]) -> Rgb {
        self.sum_batch(batch, |j| x[j])
    }

    /// [`Row::dot`] with a vector in single precision.
    #[inline]
    pub fn dot_rough(&self, x: &[[f32; 4]]) -> Rgb {
        self.sum_rough(0, self.batches(), x)
    }

    /// [`Row::dot_batch`] with a vector in single precision.
    #[inline]
    pub fn dot_batch_rough(&self, batch: usize, x: &[[f32; 4]]) -> Rgb {
        self.sum_rough(batch, batch + 1, x) * self.batches() as f64
    }

    /// Sum over the columns of one randomisation of the factor times `f`, an estimate of the whole.
    #[inline]
    pub fn sum_batch(&self, batch: usize, f: impl Fn(usize) -> Rgb) -> Rgb {
        self.sum(batch, batch + 1, f) * self.batches() as f64
    }

    /// [`Row::sum`] of a vector in single precision, which also holds the sums of runs of [`RUN`] entries.
    #[inline]
    fn sum_rough(&self, from: usize, to: usize, x: &[[f32; 4]]) -> Rgb {
        let range = self.start[from] as usize..self.start[to] as usize;
        let columns = &self.columns[range.clone()];
        let at = |j: u32| Vec4::from_array(x[j as usize]);
        match self.values {
            Values::Counts(scale) => {
                let of = |e: u32, _: &u32| ((e >> COLUMN_BITS) + 1) as f32 * at(e & COLUMN);
                columns.chunks(RUN).map(|run| widen(in_chains(run, run, of).to_array())).sum::<Rgb>() * scale
            }
            Values::Grey(values) => {
                let runs = columns.chunks(RUN).zip(values[range].chunks(RUN));
                runs.map(|(run, values)| widen(in_chains(run, values, |j, v| *v * at(j)).to_array())).sum()
            }
            Values::Coloured(_) => self.sum(from, to, |j| widen(x[j])),
        }
    }

    #[inline]
    fn sum(&self, from: usize, to: usize, f: impl Fn(usize) -> Rgb) -> Rgb {
        let range = self.start[from] as usize..self.start[to] as usize;
        let columns = &self.columns[range.clone()];
        match self.values {
            Values::Counts(scale) => {
                let of = |e: u32, _: &u32| f64::from((e >> COLUMN_BITS) + 1) * f((e & COLUMN) as usize);
                in_chains(columns, columns, of) * scale
            }
            Values::Grey(values) => in_chains(columns, &values[range], |j, v| f64::from(*v) * f(j as usize)),
            Values::Coloured(values) => {
                let triples = columns.iter().zip(values[3 * range.start..3 * range.end].chunks_exact(3));
                triples.fold(Rgb::ZERO, |sum, (j, v)| {
                    sum + Rgb::new(v[0].into(), v[1].into(), v[2].into()) * f(*j as usize)
                })
            }
        }
    }
}

/// Sum of `of` over columns and as many values, in [`CHAINS`] parts.
#[inline(always)]
fn in_chains<T: Copy + Default + Add<Output = T> + AddAssign, V>(
    columns: &[u32],
    values: &[V],
    of: impl Fn(u32, &V) -> T,
) -> T {
    let mut sums = [T::default(); CHAINS];
    let (mut columns, mut values) = (columns.chunks_exact(CHAINS), values.chunks_exact(CHAINS));
    for (j, v) in columns.by_ref().zip(values.by_ref()) {
        for k in 0..CHAINS {
            sums[k] += of(j[k], &v[k]);
        }
    }
    for (j, v) in columns.remainder().iter().zip(values.remainder()) {
        sums[0] += of(*j, v);
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// The first three numbers.
#[inline]
pub fn widen(x: [f32; 4]) -> Rgb {
    Rgb::new(x[0].into(), x[1].into(), x[2].into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What goes in comes out, large counts in one piece.
    #[test]
    fn counts_come_back_whole() {
        let mut builder = Builder::new(true);
        for batch in [&[(7u32, 1.0f32), (COLUMN, 65_536.0), (3, 33.0)][..], &[], &[(3, 32.0)]] {
            batch.iter().for_each(|(j, n)| builder.push(*j, &[*n]));
            builder.end_batch();
        }
        builder.end_row(3, 1, 0.5);
        let block = builder.finish();
        let row = block.row(0, 3, 1);
        let found = |b: usize| row.batch(b).map(|(j, f)| (j as u32, f.x)).collect::<Vec<_>>();
        assert_eq!(found(0), [(7, 0.5), (COLUMN, 32_768.0), (3, 16.5)]);
        assert_eq!((found(1), found(2)), (vec![], vec![(3, 16.0)]));
        let mut means = Vec::new();
        row.each_mean(|j, f| means.push((j as u32, f)));
        assert_eq!(means, [(7, 0.5), (COLUMN, 32_768.0), (3, 16.5), (3, 16.0)]);
        let sum = row.sum(0, 3, |j| if j == 3 { Rgb::ONE } else { Rgb::ZERO });
        assert_eq!(sum, Rgb::splat(32.5));
        assert_eq!(row.sum_batch(2, |_| Rgb::ONE), Rgb::splat(48.0));
    }

    /// Rows of 0 to 200 entries and values of twelve orders of magnitude: what single precision sums in runs is within 64 roundings of
    /// the sum of moduli, and single randomisations likewise.
    #[test]
    fn rough_dots_are_close() {
        let mut state = 1u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1u32 << 24)
        };
        let mut value = |signed: bool| {
            let size = 10f64.powf(12.0 * uniform() - 6.0) as f32;
            if signed && uniform() < 0.5 { -size } else { size }
        };
        const COLUMNS: u32 = 300;
        let rough: Vec<[f32; 4]> =
            (0..COLUMNS).map(|_| [value(true), value(true), value(true), 0.0]).collect();
        let exact: Vec<Rgb> = rough.iter().map(|x| widen(*x)).collect();
        let moduli: Vec<Rgb> = exact.iter().map(|x| x.abs()).collect();
        let mut worst = 0.0f64;
        for counts in [true, false] {
            for entries in 0..=200 {
                let mut builder = Builder::new(counts);
                for batch in [0..entries / 3, entries / 3..entries] {
                    for k in batch {
                        // Counts of one to 32, and weights.
                        let weight = if counts { (1 + k % 32) as f32 } else { value(false) };
                        builder.push(7 * k % COLUMNS, &[weight]);
                    }
                    builder.end_batch();
                }
                builder.end_row(2, 1, 0.25);
                let block = builder.finish();
                let row = block.row(0, 2, 1);
                let mut near = |rough: Rgb, exact: Rgb, moduli: Rgb| {
                    let allowed = moduli * (64.0 * f64::from(f32::EPSILON) / 2.0);
                    let off = (rough - exact).abs();
                    assert!(off.cmple(allowed).all(), "{entries} entries: {rough}, exact {exact}");
                    let share = off / allowed;
                    worst =
                        if entries > 0 && share.is_finite() { worst.max(share.max_element()) } else { worst };
                };
                near(row.dot_rough(&rough), row.dot(&exact), row.dot(&moduli));
                for b in 0..2 {
                    near(row.dot_batch_rough(b, &rough), row.dot_batch(b, &exact), row.dot_batch(b, &moduli));
                }
            }
        }
        // It is single precision.
        assert!(worst > 0.0);
    }

    /// What was counted comes out as if it had been pushed one by one, whatever its size and wherever those stand that are no columns.
    #[test]
    fn many_counts_come_back_as_single_ones() {
        let numbers = [3, 33, 1, 500, 32, 64, 65, 7];
        for none in 0..=numbers.len() {
            let (mut together, mut single) = (Builder::new(true), Builder::new(true));
            let mut met: Vec<u32> = (0..8).rev().collect();
            let mut counts = numbers.to_vec();
            counts.push(100);
            met.insert(none, 8);
            met.iter().filter(|j| **j < 8).for_each(|j| single.push_count(*j, counts[*j as usize]));
            together.push_counts(&met, 8, &mut counts);
            assert_eq!(counts, [0; 9]);
            assert_eq!(together.columns, single.columns, "none at {none}");
        }
    }
}
