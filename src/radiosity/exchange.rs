//! Gathering through the matrix, with closure enforced.
//!
//! A row's factors are single-precision numbers. Where the rays number no power of two, their sum misses closure by
//! up to 6e-8, and the mean loss of a bounce, `1 - rho`, by as much: at an albedo of 1 - 1e-6 this alone would change
//! the answer by 6 %. Each row is therefore scaled in double precision so that it closes exactly: factors, escaped,
//! absorbed and dropped shares sum to 1. A row further from closure than [`MOST_CORRECTION`] is left as it is.
//!
//! Closure is what a nearly white closed room needs. Reciprocity is not enforced: the factors of one row have
//! independent errors from those of another, which shifts the weight of each row in the room's mean by the row's relative error, whatever
//! the albedo, and the standard errors contain it.

use super::Transport;
use crate::color::Rgb;
use crate::form_factor::ExchangeMatrix;
use rayon::prelude::*;

/// Largest relative change that closes a row.
const MOST_CORRECTION: f64 = 0.01;

/// A matrix whose rows close.
pub(super) struct Exchange<'m> {
    matrix: &'m ExchangeMatrix,
    scale: Vec<f64>,
}

impl<'m> Exchange<'m> {
    /// `keep` is the share that each element's surface passes on specularly.
    pub fn new(matrix: &'m ExchangeMatrix, keep: impl Fn(u32) -> Rgb + Sync) -> Exchange<'m> {
        let taken: Vec<Rgb> = (0..matrix.len() as u32).map(|e| Rgb::ONE - keep(e)).collect();
        let sums = matrix.multiply(&taken);
        let scale = sums
            .iter()
            .zip(&matrix.summary)
            .map(|(sum, s)| {
                let target = Rgb::ONE - s.escaped - s.absorbed - s.dropped;
                let ratio = crate::color::mean(target) / crate::color::mean(*sum);
                if (ratio - 1.0).abs() <= MOST_CORRECTION { ratio } else { 1.0 }
            })
            .collect();
        Exchange { matrix, scale }
    }

    /// The matrix as it was cast.
    pub fn matrix(&self) -> &ExchangeMatrix {
        self.matrix
    }

    /// Irradiance from radiosities.
    pub fn gather(&self, x: &[Rgb]) -> Vec<Rgb> {
        let mut y = self.matrix.multiply(x);
        y.iter_mut().zip(&self.scale).for_each(|(y, s)| *y *= *s);
        y
    }

    /// The same from one randomisation of every row, `batch(row)`, an estimate of the whole.
    pub fn gather_batch(&self, batch: impl Fn(usize) -> usize + Sync, x: &[Rgb]) -> Vec<Rgb> {
        (0..self.matrix.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|row| self.matrix.multiply_batch(row, batch(row), x) * self.scale[row])
            .collect()
    }

    /// Estimates of one row from each randomisation.
    pub fn row_by_batch(&self, row: usize, x: &[Rgb]) -> Vec<Rgb> {
        let mut y = self.matrix.multiply_batches(row, x);
        y.iter_mut().for_each(|y| *y *= self.scale[row]);
        y
    }
}

/// `H - F (rho H + tau H')`.
pub(super) fn residual_operator(
    gather: impl Fn(&[Rgb]) -> Vec<Rgb>,
    transport: &Transport,
    h: &[Rgb],
) -> Vec<Rgb> {
    let y = gather(&transport.reflect(h));
    h.iter().zip(&y).map(|(h, y)| *h - *y).collect()
}
