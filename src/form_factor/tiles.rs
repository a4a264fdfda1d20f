//! Entries of a matrix ordered by tiles, for multiplications that keep to the processor's cache.
//!
//! A row of many elements' factors reads radiosities from all over the scene, each from another line of memory. Here the rows of
//! a band take turns: all that they read of a few neighbouring columns comes together, columns in ascending order
//! (compressed sparse blocks; Buluc et al. 2009, doi:10.1145/1583991.1584053).

use super::matrix::ExchangeMatrix;
use crate::color::Rgb;
use rayon::prelude::*;
use std::ops::Range;

/// Bits of an entry, from the highest: its column within the tile, its row within the band, its randomisation, and the count of rays
/// less one. So they sort by columns: memory that is read in its order comes ahead of time.
const COLUMN_BITS: u32 = 8;
const ROW_BITS: u32 = 12;
const BATCH_BITS: u32 = 4;
const COUNT_BITS: u32 = 8;
const ROWS: usize = 1 << ROW_BITS;
const COLUMNS: usize = 1 << COLUMN_BITS;
/// Rows from which on radiosities do not fit the cache next to the processor.
const LEAST_ROWS: usize = 1 << 17;

/// The entries of a matrix that counts rays.
pub struct Tiles {
    rows: usize,
    batches: usize,
    bands: Vec<Band>,
}

/// Consecutive rows.
struct Band {
    /// Start of each tile's entries, and the end.
    start: Box<[u32]>,
    entries: Box<[u32]>,
    /// By row, what one ray counts.
    scale: Box<[f64]>,
}

struct Entry {
    row: usize,
    column: usize,
    batch: usize,
    count: u32,
}

impl Entry {
    #[inline]
    fn pack(&self) -> u32 {
        let place = (self.column as u32) << ROW_BITS | self.row as u32;
        (place << BATCH_BITS | self.batch as u32) << COUNT_BITS | (self.count - 1)
    }

    #[inline]
    fn unpack(bits: u32) -> Entry {
        Entry {
            column: (bits >> (ROW_BITS + BATCH_BITS + COUNT_BITS)) as usize,
            row: (bits >> (BATCH_BITS + COUNT_BITS)) as usize % ROWS,
            batch: (bits >> COUNT_BITS) as usize % (1 << BATCH_BITS),
            count: bits % (1 << COUNT_BITS) + 1,
        }
    }
}

impl Tiles {
    /// Whether tiles are made of a matrix: what its multiplications gain is worth as much memory again. `counts`: entries count
    /// rays.
    pub fn are_worth(rows: usize, batches: usize, counts: bool) -> bool {
        counts && rows >= LEAST_ROWS && batches <= 1 << BATCH_BITS
    }

    /// Orders the entries of a matrix; none where it has few rows or does not count rays.
    pub fn new(matrix: &ExchangeMatrix) -> Option<Tiles> {
        let (rows, batches) = (matrix.len(), matrix.batches());
        if !Tiles::are_worth(rows, batches, matrix.counts_rays()) {
            return None;
        }
        let bands = (0..rows.div_ceil(ROWS))
            .into_par_iter()
            .map_init(Default::default, |scratch, b| {
                Band::new(matrix, b * ROWS..((b + 1) * ROWS).min(rows), scratch)
            })
            .collect();
        Some(Tiles { rows, batches, bands })
    }

    /// The matrix times `x`.
    pub fn multiply<X: Copy + Sync>(&self, x: &[X], widen: impl Fn(X) -> Rgb + Sync) -> Vec<Rgb> {
        let mut y = vec![Rgb::ZERO; self.rows];
        y.par_chunks_mut(ROWS).zip(&self.bands).for_each(|(y, band)| {
            band.visit(x, |x, e| y[e.row] += f64::from(e.count) * widen(x[e.column]));
            y.iter_mut().zip(&band.scale).for_each(|(y, s)| *y *= *s);
        });
        y
    }

    /// One randomisation of each row times `x`, for M of them together: estimates of the whole. `lane` says which of the M a
    /// randomisation of a row goes to, `value` what it reads of a column. In single precision.
    pub fn multiply_each<const M: usize, X: Copy + Sync>(
        &self,
        x: &[X],
        lane: impl Fn(usize, usize) -> Option<usize> + Sync,
        value: impl Fn(&X, usize) -> [f32; 4] + Sync,
    ) -> Vec<[Rgb; M]> {
        const IDLE: u8 = u8::MAX;
        let mut y = vec![[Rgb::ZERO; M]; self.rows];
        y.par_chunks_mut(ROWS).zip(&self.bands).enumerate().for_each(|(b, (y, band))| {
            let mut lanes = vec![IDLE; y.len() << BATCH_BITS];
            for (k, l) in lanes.chunks_exact_mut(1 << BATCH_BITS).enumerate() {
                (0..self.batches)
                    .for_each(|batch| l[batch] = lane(b * ROWS + k, batch).map_or(IDLE, |m| m as u8));
            }
            let mut sums = vec![[[0.0f32; 4]; M]; y.len()];
            band.visit(x, |x, e| {
                let lane = usize::from(lanes[e.row << BATCH_BITS | e.batch]);
                if lane < M {
                    let (sum, value) = (&mut sums[e.row][lane], value(&x[e.column], lane));
                    sum.iter_mut().zip(value).for_each(|(s, v)| *s += e.count as f32 * v);
                }
            });
            for ((y, sums), scale) in y.iter_mut().zip(&sums).zip(&band.scale) {
                let scale = scale * self.batches as f64;
                *y = sums.map(|[r, g, b, _]| Rgb::new(r.into(), g.into(), b.into()) * scale);
            }
        });
        y
    }
}

impl Band {
    fn new(matrix: &ExchangeMatrix, rows: Range<usize>, scratch: &mut [Vec<u64>; 2]) -> Band {
        // Columns above, entries below; sorted by the lower half of the columns' bits, then by the upper.
        let [keys, half] = scratch;
        keys.clear();
        for (row, k) in rows.clone().enumerate() {
            matrix.at(k).counts(|batch, column, count| {
                let entry = Entry { row, column: column % COLUMNS, batch, count };
                keys.push((column as u64) << 32 | u64::from(entry.pack()));
            });
        }
        let digits = (usize::BITS - matrix.len().leading_zeros()).div_ceil(2);
        sort(keys, half, 32, digits);
        sort(half, keys, 32 + digits, digits);
        let mut start = vec![0u32; matrix.len().div_ceil(COLUMNS) + 1];
        keys.iter().for_each(|key| start[(key >> 32) as usize / COLUMNS + 1] += 1);
        (1..start.len()).for_each(|t| start[t] += start[t - 1]);
        let scale = rows.map(|k| matrix.at(k).count_scale()).collect();
        Band { start: start.into(), entries: keys.iter().map(|key| *key as u32).collect(), scale }
    }

    /// Visits all entries with the part of `x` that their tile reads.
    #[inline]
    fn visit<X>(&self, x: &[X], mut each: impl FnMut(&[X], Entry)) {
        for (x, range) in x.chunks(COLUMNS).zip(self.start.windows(2)) {
            for bits in &self.entries[range[0] as usize..range[1] as usize] {
                each(x, Entry::unpack(*bits));
            }
        }
    }
}

/// Sorts keys by `digits` bits from `low` on into `sorted`; those alike keep their order.
fn sort(keys: &[u64], sorted: &mut Vec<u64>, low: u32, digits: u32) {
    let digit = |key: u64| (key >> low) as usize % (1 << digits);
    let mut next = vec![0usize; (1 << digits) + 1];
    keys.iter().for_each(|key| next[digit(*key) + 1] += 1);
    (0..1 << digits).for_each(|d| next[d + 1] += next[d]);
    sorted.resize(keys.len(), 0);
    for key in keys {
        let next = &mut next[digit(*key)];
        sorted[*next] = *key;
        *next += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::form_factor::RowSummary;
    use crate::form_factor::rows::Builder;
    use crate::sampling::seed_of;

    /// Rows of a few large and many small counts all over the columns.
    fn matrix(n: usize, batches: usize) -> ExchangeMatrix {
        const BLOCK: usize = 64;
        let mut builder = Builder::new(true);
        let blocks = (0..n.div_ceil(BLOCK))
            .map(|b| {
                for row in b * BLOCK..((b + 1) * BLOCK).min(n) {
                    for batch in 0..batches {
                        for k in 0..3 {
                            let bits = seed_of(&[row as u32, batch as u32, k]);
                            builder.push(bits % n as u32, &[if k == 0 { 70.0 } else { 1.0 }]);
                        }
                        builder.end_batch();
                    }
                    builder.end_row(batches, 1, 1.0 / (72 * batches + row % 3) as f64);
                }
                builder.finish()
            })
            .collect();
        let summary = vec![RowSummary::default(); n];
        ExchangeMatrix {
            batches,
            channels: 1,
            rows_per_block: BLOCK,
            blocks,
            summary,
            rays_per_row: 1,
            rays: 1,
        }
    }

    /// The same products as row by row, whole and by randomisations, of a matrix whose last band and tile are short.
    #[test]
    fn tiles_multiply_as_rows_do() {
        let (n, batches) = (LEAST_ROWS + 77, 3);
        let matrix = matrix(n, batches);
        let tiles = Tiles::new(&matrix).expect("large enough");
        let x: Vec<Rgb> = (0..n).map(|k| Rgb::new(k as f64, (k % 7) as f64, 1.0)).collect();
        let y = tiles.multiply(&x, |x| x);
        let rough: Vec<[f32; 4]> = x.iter().map(|x| [x.x as f32, x.y as f32, x.z as f32, 0.0]).collect();
        let lane = |row: usize, batch: usize| (batch != row % 3).then_some((row + batch) % 2);
        let each = tiles.multiply_each::<2, _>(&rough, lane, |x, _| *x);
        for k in 0..n {
            let row = matrix.at(k);
            let whole = row.dot(&x);
            assert!((y[k] - whole).abs().max_element() <= 1e-12 * whole.max_element(), "row {k}");
            let mut wanted = [Rgb::ZERO; 2];
            for b in 0..batches {
                if let Some(m) = lane(k, b) {
                    wanted[m] += row.dot_batch(b, &x);
                }
            }
            for (found, wanted) in each[k].iter().zip(wanted) {
                assert!((*found - wanted).abs().max_element() <= 1e-6 * wanted.max_element(), "row {k}");
            }
        }
    }

    #[test]
    fn few_rows_and_many_randomisations_stay_rows() {
        assert!(Tiles::new(&matrix(1000, 4)).is_none());
        assert!(!Tiles::are_worth(LEAST_ROWS, 17, true) && !Tiles::are_worth(LEAST_ROWS, 4, false));
    }
}
