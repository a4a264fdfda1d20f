//! The right factors, as far as they are known, and the distance of others from them.

use super::cases::{Answer, Configuration};
use crate::Result;
use crate::form_factor::analytic::EXACT;
use crate::form_factor::pairs::{CELL_ERROR, FEW_BATCHES, PairFactors, PairWork};
use crate::form_factor::{AtSpecular, Casting, Factors, cast_rows};
use crate::visibility::Visibility;

/// Seed of answers, apart from those that rounds use.
const SEED: u32 = 0x5eed_00f0;

/// Rows of right factors.
pub(super) struct Truth {
    /// Element and its row, a value for each element.
    rows: Vec<(usize, Vec<f64>)>,
    /// Mean squared standard error of the factors.
    variance: f64,
    /// Mean square of the factors.
    square: f64,
    /// The largest factor.
    largest: f64,
    /// Where the answer comes from, in a sentence.
    pub words: String,
}

/// How far factors are from the right ones.
#[derive(Debug, Clone, Copy)]
pub(super) struct Distance {
    /// Root mean square over all pairs of elements, as a share of the factors' own root mean square.
    pub rms: f64,
    /// Largest, as a share of the largest factor.
    pub largest: f64,
    /// The answer's own noise is as large: `rms` is an upper bound.
    pub unresolved: bool,
}

impl Truth {
    /// The answer of a configuration.
    pub fn new(visibility: &Visibility, configuration: &Configuration) -> Result<Truth> {
        let mesh = &configuration.mesh;
        let n = mesh.len();
        match configuration.answer {
            Answer::Exact => {
                let work = PairWork { unoccluded: true, tolerance: EXACT, ..pair_work(SEED) };
                let pairs = PairFactors::new(visibility, mesh, &work);
                Ok(Truth::of_pairs(&pairs, n, |_| "closed forms, exact to a relative 1e-11.".into()))
            }
            Answer::Pairs { points } => {
                // By points: their standard errors are known, and they share nothing with cells.
                let work = PairWork { points, cells: None, ..pair_work(SEED) };
                let pairs = PairFactors::new(visibility, mesh, &work);
                let c = pairs.counts;
                Ok(Truth::of_pairs(&pairs, n, |se| {
                    format!(
                        "exact unoccluded factors times visible fractions. Of {} pairs of elements, {} are certain ({} averted, {} proven free, {} \
                         proven hidden), the others estimated from {} points each; standard error {} % (RMS over the matrix).",
                        n * (n - 1) / 2,
                        c.averted + c.free + c.hidden,
                        c.averted,
                        c.free,
                        c.hidden,
                        points as usize * work.batches,
                        digits(100.0 * se)
                    )
                }))
            }
            Answer::Rows { rays } => {
                let mut asked = vec![false; n];
                let answered = configuration.sample.as_ref().map_or(&[][..], |s| &s.answered);
                answered.iter().for_each(|r| asked[*r] = true);
                let rows = answered.len();
                let casting = Casting {
                    rays,
                    batches: 16,
                    seed: SEED,
                    specular: AtSpecular::End,
                    reached: None,
                    emitters: None,
                    progress: &|_| (),
                };
                let matrix = cast_rows(visibility, mesh, &casting, Some(&asked)).0;
                let batches = matrix.batches() as f64;
                let (mut held, mut variance) = (Vec::new(), 0.0);
                for &row in answered {
                    let (mut sum, mut squares) = (vec![0.0; n], vec![0.0; n]);
                    for (j, f) in matrix.row(row) {
                        sum[j] += f.x;
                        squares[j] += f.x * f.x;
                    }
                    let of = |(s, q): (&f64, &f64)| (batches * q - s * s).max(0.0) / (batches - 1.0);
                    variance += sum.iter().zip(&squares).map(of).sum::<f64>() / (rows * n) as f64;
                    held.push((row, sum));
                }
                Ok(Truth::of_rows(held, variance, |se| {
                    format!(
                        "{rows} rows spread evenly over the elements by {rays} hemisphere rays each; standard error {} % (RMS over these \
                         rows). Errors are those of these rows. Times are those of {} rows, spread alike, times the number of all rows over theirs; \
                         combining both directions' estimates needs all rows, which are then found.",
                        digits(100.0 * se),
                        configuration.sample.as_ref().map_or(n, |s| s.len())
                    )
                }))
            }
        }
    }

    fn of_pairs(pairs: &PairFactors, n: usize, words: impl Fn(f64) -> String) -> Truth {
        let mut variance = 0.0;
        let rows = (0..n)
            .map(|i| {
                let row = (0..n).map(|j| {
                    let (f, error) = pairs.factor(i, j);
                    variance += error * error / (n * n) as f64;
                    f
                });
                (i, row.collect())
            })
            .collect();
        Truth::of_rows(rows, variance, words)
    }

    fn of_rows(rows: Vec<(usize, Vec<f64>)>, variance: f64, words: impl Fn(f64) -> String) -> Truth {
        let count: usize = rows.iter().map(|r| r.1.len()).sum();
        let all = || rows.iter().flat_map(|r| &r.1);
        let square = all().map(|f| f * f).sum::<f64>() / count as f64;
        let largest = all().copied().fold(0.0, f64::max);
        let words = words((variance / square).sqrt());
        Truth { rows, variance, square, largest, words }
    }

    /// Distance of factors from these. The answer's own variance is taken off the mean squared difference: both are
    /// independent.
    pub fn distance(&self, factors: &Factors) -> Distance {
        let (mut sum, mut largest, mut count) = (0.0, 0.0f64, 0);
        for (row, right) in &self.rows {
            let (columns, values, _) = factors.row(*row);
            let mut k = 0;
            for (j, right) in right.iter().enumerate() {
                let own = columns.get(k).is_some_and(|c| *c as usize == j);
                let off = right - if own { values[k] } else { 0.0 };
                k += usize::from(own);
                sum += off * off;
                largest = largest.max(off.abs());
            }
            count += right.len();
        }
        let measured = sum / count as f64;
        let clean = measured - self.variance;
        let unresolved = clean < self.variance;
        let shown = if unresolved { measured } else { clean };
        Distance { rms: (shown / self.square).sqrt(), largest: largest / self.largest, unresolved }
    }

    /// The rows that are known: element and factors to all elements.
    pub fn rows(&self) -> &[(usize, Vec<f64>)] {
        &self.rows
    }

    /// Sum of the right factors of a row, where it is known, by element.
    #[cfg(test)]
    pub fn sum(&self, row: usize) -> Option<f64> {
        self.rows.iter().find(|r| r.0 == row).map(|r| r.1.iter().sum())
    }
}

/// Work of the pair by pair estimates, before their settings.
pub(super) fn pair_work(seed: u32) -> PairWork<'static> {
    PairWork {
        points: 4,
        batches: FEW_BATCHES,
        error: None,
        floor: 0.0,
        tolerance: 1e-5,
        unoccluded: false,
        cells: Some(CELL_ERROR),
        rows: None,
        seed,
        progress: &|_| (),
    }
}

/// Two significant digits.
fn digits(x: f64) -> String {
    let places = (1 - x.abs().max(1e-12).log10().floor() as i32).max(0) as usize;
    format!("{x:.places$}")
}

/// Largest departure of a row from closure, of those that hold anything: factors, escaped and absorbed shares sum to 1.
pub(super) fn closure(factors: &Factors) -> f64 {
    let sum =
        |row: usize| factors.row(row).1.iter().sum::<f64>() + factors.escaped[row] + factors.absorbed[row];
    (0..factors.nodes()).map(sum).filter(|s| *s != 0.0).map(|s| (s - 1.0).abs()).fold(0.0, f64::max)
}

/// Departure from reciprocity between elements, over pairs whose rows are both held: `sum |G_ij - G_ji| / sum (G_ij + G_ji)`
/// of the exchange areas `G_ij = A_i F_ij`.
pub(super) fn reciprocity(factors: &Factors, held: Option<&[bool]>) -> f64 {
    let n = factors.nodes();
    let at = |i: usize, j: usize| {
        let (columns, values, _) = factors.row(i);
        columns.binary_search(&(j as u32)).map_or(0.0, |k| factors.areas[i] * values[k])
    };
    let is_held = |i: usize| held.is_none_or(|h| h[i]);
    let (mut difference, mut sum) = (0.0, 0.0);
    for i in (0..n).filter(|i| is_held(*i)) {
        let (columns, values, _) = factors.row(i);
        for (j, f) in columns.iter().map(|j| *j as usize).zip(values).filter(|(j, _)| is_held(*j)) {
            let (there, back) = (factors.areas[i] * f, at(j, i));
            // Each pair once; one that only this row knows of, too.
            if i < j || back == 0.0 {
                difference += (there - back).abs();
                sum += there + back;
            }
        }
    }
    if sum > 0.0 { difference / sum } else { 0.0 }
}
