//! Gathering through the matrix, with closure enforced.
//!
//! A row's factors are single-precision numbers. Where the rays number no power of two, their sum misses closure by
//! up to 6e-8, and the mean loss of a bounce, `1 - rho`, by as much: at an albedo of 1 - 1e-6 this alone would change
//! the answer by 6 %. Each row is therefore scaled in double precision so that it closes exactly: factors, escaped,
//! absorbed and dropped shares sum to 1. A row further from closure than [`MOST_CORRECTION`] is left as it is.
//!
//! Closure is what a nearly white closed room needs, and where much of the light is lost at a bounce it is enough: errors of
//! reciprocity then stay what they are, and the standard errors contain them. Where little is lost they grow without bound. Of
//! two rooms joined by a small opening, each sends the other what *its* rays found of the opening: at an albedo of 1 both are equally
//! bright, and the rows make them as different as these two numbers of rays. There the exchange is made reciprocal too
//! ([`Balance`]).

use super::Transport;
use crate::color::Rgb;
use crate::form_factor::{ExchangeMatrix, Row, RowSummary, Rows, Tiles, widen};
use rayon::prelude::*;

/// Largest relative change that closes a row.
const MOST_CORRECTION: f64 = 0.01;

/// Elements that are worth a task where each takes a few operations.
pub(super) const MANY: usize = 4096;

/// Rows that close, made reciprocal on request.
pub(super) struct Exchange<'m> {
    pub rows: Rows<'m>,
    /// By element, what its surface does not pass on specularly; none where no surface passes on anything.
    taken: Option<&'m [Rgb]>,
    scale: Vec<f64>,
    balance: Option<Balance<'m>>,
    /// Of many rows that count rays, the entries once more.
    tiles: Option<Tiles>,
}

/// What makes rows reciprocal.
///
/// With `n_ij` of R rays from i to j, both `A_i n_ij / R` and `A_j n_ji / R` estimate the exchange area of i and j. Their mean,
/// weighted by inverse variances (those of counts, `A^2 n / R^2`), is
///
/// ```text
/// S_ij = A_i A_j / (A_i + A_j) (n_ij + n_ji) / R
/// ```
///
/// and symmetric. What a row's sum then misses goes to the element itself:
///
/// ```text
/// (F x)_i = t_i x_i + 1/a_i sum over j of S_ij (x_j - x_i)
/// ```
///
/// with the open area a and the share t of rays that met elements. A uniform x gives `t x` exactly, all is linear in the counts (so
/// nothing is biased), and off the diagonal nothing is negative.
pub(super) struct Balance<'m> {
    matrix: &'m ExchangeMatrix,
    /// Areas of the elements [m^2].
    area: Vec<f64>,
    /// Their open parts [m^2].
    pub open: Vec<f64>,
    /// Shares of rays that met elements; zero for elements that are covered.
    pub target: Vec<f64>,
}

/// Elements times runs of rows that a balanced multiplication works on at the same time, at most.
const MOST_SUMS: usize = 1 << 22;

impl<'m> Exchange<'m> {
    /// `sums` and `taken` are those of [`Rows::check`].
    pub fn new(rows: Rows<'m>, sums: &[Rgb], taken: Option<&'m [Rgb]>) -> Exchange<'m> {
        let scale = sums
            .iter()
            .zip(rows.summary())
            .map(|(sum, s)| {
                let target = Rgb::ONE - s.escaped - s.absorbed - s.dropped;
                let ratio = crate::color::mean(target) / crate::color::mean(*sum);
                if (ratio - 1.0).abs() <= MOST_CORRECTION { ratio } else { 1.0 }
            })
            .collect();
        Exchange { rows, taken, scale, balance: None, tiles: None }
    }

    /// Makes the exchange reciprocal; `matrix` are its rows, which count rays: without specular chains. `area` holds the elements'
    /// areas [m^2].
    pub fn make_reciprocal(&mut self, matrix: &'m ExchangeMatrix, area: Vec<f64>) {
        let summary = &matrix.summary;
        let open = area.iter().zip(summary).map(|(a, s)| a * s.exposed).collect();
        // Covered elements see nothing, not even themselves.
        let met = |s: &RowSummary| {
            if s.exposed > 0.0 { 1.0 - s.escaped.x - s.absorbed.x - s.dropped.x } else { 0.0 }
        };
        let target = summary.iter().map(met).collect();
        self.balance = Some(Balance { matrix, area, open, target });
    }

    /// Orders the entries by tiles where that is worth it: of many rows that are kept, count rays and are not made reciprocal.
    pub fn make_tiles(&mut self) {
        self.tiles = self.rows.kept().and_then(Tiles::new);
    }

    /// Of a reciprocal exchange, what makes it so.
    pub fn balance(&self) -> Option<&Balance<'m>> {
        self.balance.as_ref()
    }

    /// Irradiance from radiosities.
    pub fn gather(&self, x: &[Rgb]) -> Vec<Rgb> {
        match (&self.balance, &self.tiles) {
            (Some(balance), _) => balance.gather(x, None),
            (None, Some(tiles)) => self.scaled(tiles.multiply(x, |x| x)),
            (None, None) => self.rows.map(|k, row| row.dot(x) * self.scale[k]),
        }
    }

    /// The same from radiosities in single precision: a third of the time where these do not fit the processor's cache.
    /// Channels are the first three numbers.
    pub fn gather_rough(&self, x: &[[f32; 4]]) -> Vec<Rgb> {
        match &self.tiles {
            Some(tiles) => self.scaled(tiles.multiply(x, widen)),
            None => self.rows.map(|k, row| row.dot_rough(x) * self.scale[k]),
        }
    }

    fn scaled(&self, mut y: Vec<Rgb>) -> Vec<Rgb> {
        y.par_iter_mut().zip(&self.scale).with_min_len(MANY).for_each(|(y, s)| *y *= *s);
        y
    }

    /// Entries by tiles and what each row must be multiplied by, where there are tiles.
    pub fn tiles(&self) -> Option<(&Tiles, &[f64])> {
        self.tiles.as_ref().map(|t| (t, &self.scale[..]))
    }

    /// What one randomisation of a row takes of the light if every surface sends the same in all: 1 where nothing escapes, is absorbed
    /// or falls on covered parts. An estimate of the whole, by channel.
    pub fn closure(&self, row: &Row, batch: usize) -> Rgb {
        row.sum_batch(batch, |j| self.taken.map_or(Rgb::ONE, |taken| taken[j]))
    }

    /// Visits all rows with what each must be multiplied by.
    pub fn map<T: Send>(&self, f: impl Fn(usize, &Row, f64) -> T + Sync) -> Vec<T> {
        self.rows.map(|k, row| f(k, row, self.scale[k]))
    }
}

impl Balance<'_> {
    /// Weight `S_ij` [m^2] of a factor from i to j.
    #[inline]
    fn weight(&self, summary: &[RowSummary], i: usize, j: usize, factor: f64) -> f64 {
        match self.open[j] {
            0.0 => 0.0,
            _ => self.area[i] * self.area[j] / (self.area[i] + self.area[j]) * factor * summary[i].exposed,
        }
    }

    /// `F x` from all randomisations, or from the one of each row that `pick` names.
    pub fn gather(&self, x: &[Rgb], pick: Option<&(dyn Fn(usize) -> usize + Sync)>) -> Vec<Rgb> {
        let (n, batches, summary) = (x.len(), self.matrix.batches(), &self.matrix.summary);
        let runs = self.runs(vec![Rgb::ZERO; n], |y, i, row| {
            let mut add = |(j, f): (usize, Rgb), times: f64| {
                let flow = (x[j] - x[i]) * (self.weight(summary, i, j, f.x) * times);
                y[i] += flow;
                y[j] -= flow;
            };
            match pick {
                Some(pick) => row.batch(pick(i)).for_each(|e| add(e, batches as f64)),
                None => row.entries().for_each(|e| add(e, 1.0)),
            }
        });
        let one = |i: usize| {
            let flow: Rgb = runs.iter().map(|y| y[i]).sum();
            let own = match pick {
                Some(pick) if self.target[i] < 1.0 => {
                    // Of what leaves the scene, too, this randomisation is an estimate.
                    let sum = self.matrix.at(i).sum_batch(pick(i), |_| Rgb::ONE);
                    sum.x.min(1.0)
                }
                _ => self.target[i],
            };
            own * x[i] + if self.open[i] > 0.0 { flow / self.open[i] } else { Rgb::ZERO }
        };
        (0..n).into_par_iter().with_min_len(MANY).map(one).collect()
    }

    /// Sums over pairs of elements by groups: `sum over i in g, j in h of S_ij f(i, j)` for all g and h, both ways, and
    /// the two sums of what [`Balance::gather`] takes off the diagonal.
    pub fn by_groups(&self, group: &[u16], groups: usize, weight: &[Rgb]) -> Vec<Rgb> {
        let summary = &self.matrix.summary;
        let runs = self.runs(vec![Rgb::ZERO; groups * groups], |sums, i, row| {
            let g = usize::from(group[i]);
            for (j, f) in row.entries() {
                let h = usize::from(group[j]);
                let s = self.weight(summary, i, j, f.x);
                let (a, b) = (weight[i], weight[j]);
                sums[g * groups + h] -= a * b * s;
                sums[h * groups + g] -= a * b * s;
                sums[g * groups + g] += a * a * s;
                sums[h * groups + h] += b * b * s;
            }
        });
        (0..groups * groups).map(|k| runs.iter().map(|r| r[k]).sum()).collect()
    }

    /// Visits the rows in runs on all cores, each with sums of its own that start as `zero`; their number depends on nothing
    /// but the number of rows.
    fn runs<T: Clone + Send + Sync>(
        &self,
        zero: Vec<T>,
        visit: impl Fn(&mut Vec<T>, usize, &Row) + Sync,
    ) -> Vec<Vec<T>> {
        let n = self.area.len();
        let count = (MOST_SUMS / zero.len().max(1)).clamp(2, 16);
        let run = |r: usize| {
            let mut sums = zero.clone();
            let range = r * n / count..(r + 1) * n / count;
            range.filter(|i| self.open[*i] > 0.0).for_each(|i| visit(&mut sums, i, &self.matrix.at(i)));
            sums
        };
        (0..count).into_par_iter().map(run).collect()
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
