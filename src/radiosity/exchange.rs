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
use crate::form_factor::{Row, Rows};
use rayon::prelude::*;

/// Largest relative change that closes a row.
const MOST_CORRECTION: f64 = 0.01;

/// Elements that are worth a task where each takes a few operations.
pub(super) const MANY: usize = 4096;

/// Rows that close.
pub(super) struct Exchange<'m> {
    pub rows: Rows<'m>,
    scale: Vec<f64>,
}

impl<'m> Exchange<'m> {
    /// `sums` are those of [`Rows::check`].
    pub fn new(rows: Rows<'m>, sums: &[Rgb]) -> Exchange<'m> {
        let scale = sums
            .iter()
            .zip(rows.summary())
            .map(|(sum, s)| {
                let target = Rgb::ONE - s.escaped - s.absorbed - s.dropped;
                let ratio = crate::color::mean(target) / crate::color::mean(*sum);
                if (ratio - 1.0).abs() <= MOST_CORRECTION { ratio } else { 1.0 }
            })
            .collect();
        Exchange { rows, scale }
    }

    /// Irradiance from radiosities.
    pub fn gather(&self, x: &[Rgb]) -> Vec<Rgb> {
        self.rows.map(|k, row| row.dot(x) * self.scale[k])
    }

    /// The same from radiosities in single precision: a third of the time where these do not fit the processor's cache.
    /// Channels are the first three numbers.
    pub fn gather_rough(&self, x: &[[f32; 4]]) -> Vec<Rgb> {
        self.rows.map(|k, row| row.dot_rough(x) * self.scale[k])
    }

    /// Visits all rows with what each must be multiplied by.
    pub fn map<T: Send>(&self, f: impl Fn(usize, &Row, f64) -> T + Sync) -> Vec<T> {
        self.rows.map(|k, row| f(k, row, self.scale[k]))
    }
}

/// `H - F (rho H + tau H')`.
pub(super) fn residual_operator(
    gather: impl Fn(&[Rgb]) -> Vec<Rgb>,
    transport: &Transport,
    h: &[Rgb],
) -> Vec<Rgb> {
    let mut y = gather(&transport.reflect(h));
    y.par_iter_mut().zip(h).with_min_len(MANY).for_each(|(y, h)| *y = *h - *y);
    y
}

/// Radiosities in single precision, padded so that each lies within one line of the cache.
pub(super) fn round(x: &[Rgb]) -> Vec<[f32; 4]> {
    x.par_iter().with_min_len(MANY).map(|x| [x.x as f32, x.y as f32, x.z as f32, 0.0]).collect()
}
