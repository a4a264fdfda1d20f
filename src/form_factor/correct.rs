//! Corrected matrices: estimates moved as little as need be, so that they obey what exact factors obey.
//!
//! Everything happens on the exchange areas `G_ij = A_i F_ij` [m^2].
//!
//! **Reciprocity.** `G_ij` and `G_ji` estimate one number. Their mean weighted by the inverse variances replaces both. A
//! single entry's sample variance is no good weight: it rises and falls with the entry itself, and one that no ray
//! happened to hit has none. The variances are modelled as those of counts, `var(G_ij) = c_i A_i G_ij`, with
//! one `c_i` a row, measured as the ratio of the row's summed sample variances to its summed factors, exact ones left out; without
//! standard errors all `c_i` are equal. The weights `1 / (c_i A_i)` do not depend on the entry, so the mean stays unbiased.
//! Where both directions agree to the last digits, they are one estimate, and their mean is no better than it.
//!
//! **Closure.** Of all symmetric matrices with the pattern of G whose rows sum to the areas, the one nearest to it in
//! relative entropy, each entry's counted by `G_ij / var(G_ij)`, is `G_ij exp(w_ij (x_i + x_j))` with `w_ij = var(G_ij) / G_ij`.
//! For small moves that is least-squares smoothing weighted by the variances, as
//! Larsen and Howell (J. Heat Transfer 108, 1986) and Daun, Morton and Howell (J. Heat Transfer 127, 2005) do it, but no entry can turn
//! negative and none appears where no ray went. With the same `w` everywhere it is symmetric Sinkhorn scaling (Knight and Ruiz,
//! IMA J. Numer. Anal. 33, 2013). The variance is that of counts, or the sample variance where that is smaller: of entries found
//! otherwise. Entries without a standard error count as known to a millionth: they stay, to some 1e-10 of
//! themselves, where estimates can close the row, and move like each other in a row that consists of them alone. In an open enclosure what
//! lies outside takes part as one more surface with no sum of its own, `A_i = sum_j G_ij + A_i (escaped_i + absorbed_i)`, so
//! escaped and absorbed shares move as counts of their row.
//!
//! The x minimise the convex function
//! `1/2 sum_ij G_ij (e^(w_ij (x_i + x_j)) - 1) / w_ij + sum_i O_i (e^(v_i x_i) - 1) / v_i - sum_i A_i x_i`, found by Newton's method
//! with conjugate gradients.
//!
//! An entry that closure moves by more than its standard error has that move as standard error.

use super::Factors;
use crate::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// What a matrix is made to obey.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Enforce {
    /// `A_i F_ij = A_j F_ji`.
    Reciprocity,
    /// Reciprocity, and rows that sum to 1 less their escaped and absorbed shares.
    Closure,
}

/// How far a correction moved a matrix.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Correction {
    /// `reciprocity` or `closure`.
    pub enforced: &'static str,
    /// Factors that the raw or the corrected matrix holds.
    pub factors: usize,
    /// Largest move of a factor, absolute.
    pub largest_move: f64,
    /// Root mean square move of the factors.
    pub rms_move: f64,
    /// Largest move in standard errors, of those factors that have one.
    pub largest_move_in_standard_errors: Option<f64>,
    /// Root mean square move in standard errors, of the same.
    pub rms_move_in_standard_errors: Option<f64>,
    /// Factors without a standard error, which are exact as far as the estimator can say; 0 where none has one to tell.
    pub exact_factors: usize,
    /// Largest move of one of these, as a share of the factor.
    pub largest_relative_move_of_exact: f64,
    /// Largest move of an escaped or absorbed share.
    pub largest_move_of_escape: f64,
    /// Newton's steps for closure.
    pub iterations: usize,
    /// Largest departure of a row's sum from 1 (escaped and absorbed shares included) afterwards.
    pub closure: f64,
    /// The same beforehand.
    pub closure_before: f64,
}

impl Correction {
    /// What the correction did, in a line.
    pub fn line(&self) -> String {
        let in_errors = self.rms_move_in_standard_errors.map(|m| format!(" ({m:.2} standard errors)"));
        let exact = (self.largest_relative_move_of_exact > TOLD).then(|| {
            let (count, most) = (self.exact_factors, self.largest_relative_move_of_exact);
            format!("; {count} factors without standard errors by {most:.1e} of themselves at most")
        });
        format!(
            "{} enforced: factors moved by {:.1e} at most, {:.1e} RMS{}{}",
            self.enforced,
            self.largest_move,
            self.rms_move,
            in_errors.unwrap_or_default(),
            exact.unwrap_or_default()
        )
    }
}

/// Relative move of exact factors that is worth a word.
const TOLD: f64 = 1e-9;
/// Rows sum to 1 within this.
pub const CLOSURE_TOLERANCE: f64 = 1e-12;
/// Newton's steps: far more than a matrix takes that has a solution.
const MOST_STEPS: usize = 60;
const MOST_CG_STEPS: usize = 400;
/// Growth of an entry in one of Newton's steps, as a logarithm: e^x is no straight line.
const MOST_GROWTH: f64 = 2.0;
/// Relative standard error up to which a factor counts as exact: rounding makes as much of none, and integrals
/// over cells have a hundred times more.
const EXACT: f64 = 1e-6;
/// Least mobility of an entry: with less, rows of which nothing else moves would be told from rounding no more.
const LEAST_MOBILITY: f64 = 1e-9;
/// Relative difference of two directions' estimates that are one estimate.
const SAME: f64 = 1e-12;

/// Corrects factors in place; all rows must be held.
///
/// # Errors
/// Closure cannot be met: the factors above zero allow no symmetric matrix with these sums. Names nodes
/// whose sums cannot be met. The factors are then as they were.
pub fn correct(factors: &mut Factors, enforce: Enforce) -> Result<Correction> {
    let n = factors.nodes();
    if factors.rows != (0..n) {
        return Err(Error::Usage("a correction needs all rows of the matrix".into()));
    }
    let raw = factors.clone();
    let noise = Noise::of(&raw);
    let mut symmetric = Symmetric::new(&raw, &noise);
    let mut outside = Outside {
        areas: (0..n).map(|i| raw.areas[i] * (raw.escaped[i] + raw.absorbed[i])).collect(),
        mobility: noise.outside.clone(),
    };
    let exact: Vec<bool> =
        symmetric.values.iter().zip(&symmetric.errors).map(|(v, e)| is_exact(*v, *e)).collect();
    let (x, iterations) = match enforce {
        Enforce::Reciprocity => (vec![0.0; n], 0),
        Enforce::Closure => match multipliers(&symmetric, &outside, &raw) {
            Ok(found) => found,
            // Rows that only exact entries could close: all move alike.
            Err(_) => {
                symmetric.mobility.iter_mut().for_each(|w| *w = f32::from(*w > 0.0));
                outside.mobility.iter_mut().for_each(|v| *v = f64::from(*v > 0.0));
                multipliers(&symmetric, &outside, &raw)?
            }
        },
    };
    for i in 0..n {
        for k in symmetric.start[i]..symmetric.start[i + 1] {
            // The sum is formed alike for (i, j) and (j, i).
            let growth = symmetric.growth(k, x[i] + x[symmetric.columns[k] as usize]);
            let before = symmetric.values[k];
            symmetric.values[k] *= growth;
            if let Some(error) = symmetric.errors.get_mut(k) {
                let moved = (symmetric.values[k] - before).abs();
                // A move within rounding leaves what is exact exact.
                let told = if moved > SAME * before { moved } else { 0.0 };
                *error = (*error * growth.max(1.0)).max(told);
            }
        }
    }
    let area_of: Vec<usize> =
        (0..n).flat_map(|i| std::iter::repeat_n(i, symmetric.start[i + 1] - symmetric.start[i])).collect();
    factors.values = symmetric.values.iter().zip(&area_of).map(|(g, i)| g / raw.areas[*i]).collect();
    factors.errors = symmetric.errors.iter().zip(&area_of).map(|(g, i)| g / raw.areas[*i]).collect();
    factors.start = symmetric.start;
    factors.columns = symmetric.columns;
    for (i, x) in x.iter().enumerate() {
        let growth = (outside.mobility[i] * x).exp();
        factors.escaped[i] *= growth;
        factors.absorbed[i] *= growth;
    }
    factors.written = match enforce {
        Enforce::Reciprocity => "reciprocity",
        Enforce::Closure => "closure",
    };
    Ok(moves(&raw, factors, &exact, iterations))
}

/// Whether a factor's standard error says nothing.
fn is_exact(value: f64, error: f64) -> bool {
    error <= EXACT * value
}

/// Largest departure of a row's sum from 1.
fn closure(factors: &Factors) -> f64 {
    let residual = |row: usize| {
        let sum: f64 = factors.row(row).1.iter().sum();
        (sum + factors.escaped[row] + factors.absorbed[row] - 1.0).abs()
    };
    (0..factors.rows.len()).map(residual).fold(0.0, f64::max)
}

/// `certain`: of the corrected matrix's entries, those that are exact from both sides.
fn moves(raw: &Factors, now: &Factors, certain: &[bool], iterations: usize) -> Correction {
    let (mut count, mut square, mut largest) = (0usize, 0.0, 0.0f64);
    let (mut with_error, mut square_in_errors, mut largest_in_errors) = (0usize, 0.0, 0.0f64);
    let (mut exact, mut largest_of_exact) = (0usize, 0.0f64);
    for i in 0..now.nodes() {
        let (old_columns, old_values, old_errors) = raw.row(i);
        let (columns, values, _) = now.row(i);
        let mut k = 0;
        for ((j, value), entry) in columns.iter().zip(values).zip(now.start[i]..) {
            // The new pattern holds the old one.
            let old = old_columns.get(k) == Some(j);
            let moved = (value - if old { old_values[k] } else { 0.0 }).abs();
            count += 1;
            square += moved * moved;
            largest = largest.max(moved);
            if let (true, Some(errors)) = (old, old_errors) {
                // The randomisations of a few rays may agree by chance, but not those from both sides.
                if certain[entry] && old_values[k] > 0.0 {
                    exact += 1;
                    largest_of_exact = largest_of_exact.max(moved / old_values[k]);
                } else if !is_exact(old_values[k], errors[k]) {
                    with_error += 1;
                    square_in_errors += (moved / errors[k]).powi(2);
                    largest_in_errors = largest_in_errors.max(moved / errors[k]);
                }
            }
            k += usize::from(old);
        }
    }
    let escape = raw.escaped.iter().zip(&now.escaped).chain(raw.absorbed.iter().zip(&now.absorbed));
    Correction {
        enforced: now.written,
        factors: count,
        largest_move: largest,
        rms_move: (square / count.max(1) as f64).sqrt(),
        largest_move_in_standard_errors: (with_error > 0).then_some(largest_in_errors),
        rms_move_in_standard_errors: (with_error > 0).then(|| (square_in_errors / with_error as f64).sqrt()),
        exact_factors: exact,
        largest_relative_move_of_exact: largest_of_exact,
        largest_move_of_escape: escape.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        iterations,
        closure: closure(now),
        closure_before: closure(raw),
    }
}

/// A symmetric sparse matrix with sorted columns: exchange areas [m^2].
struct Symmetric {
    start: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
    /// Standard errors, or empty.
    errors: Vec<f64>,
    /// Variance over value of each entry, in units of the noisiest row's.
    mobility: Vec<f32>,
}

impl Symmetric {
    /// Means of both directions' estimates.
    fn new(raw: &Factors, noise: &Noise) -> Symmetric {
        let n = raw.nodes();
        let weight = &noise.weights;
        let transposed = transpose(raw);
        let mut result = Symmetric {
            start: vec![0],
            columns: Vec::new(),
            values: Vec::new(),
            errors: Vec::new(),
            mobility: Vec::new(),
        };
        for i in 0..n {
            let (columns, values, errors) = raw.row(i);
            let back = &transposed.1[transposed.0[i]..transposed.0[i + 1]];
            let (mut a, mut b) = (0, 0);
            while a < columns.len() || b < back.len() {
                let next = |list: Option<u32>| list.unwrap_or(u32::MAX);
                let (ja, jb) = (next(columns.get(a).copied()), next(back.get(b).map(|e| e.0)));
                let j = ja.min(jb) as usize;
                // (value, error) from i to j and from j to i, as exchange areas.
                let there = if ja as usize == j {
                    (raw.areas[i] * values[a], raw.areas[i] * errors.map_or(0.0, |e| e[a]))
                } else {
                    (0.0, 0.0)
                };
                let return_ = if jb as usize == j {
                    let k = back[b].1;
                    let error = raw.errors.get(k).copied().unwrap_or(0.0);
                    (raw.areas[j] * raw.values[k], raw.areas[j] * error)
                } else {
                    (0.0, 0.0)
                };
                a += usize::from(ja as usize == j);
                b += usize::from(jb as usize == j);
                // The smaller index first, for the same rounding from both sides.
                let ((x, wx), (y, wy)) = if i <= j {
                    ((there, weight[i]), (return_, weight[j]))
                } else {
                    ((return_, weight[j]), (there, weight[i]))
                };
                let value = if i == j { x.0 } else { (wx * x.0 + wy * y.0) / (wx + wy) };
                result.columns.push(j as u32);
                result.values.push(value);
                let counts = if i == j { weight[i] } else { wx + wy };
                let mut variance = value / counts;
                if errors.is_some() {
                    let close = |a: f64, b: f64, share: f64| (a - b).abs() <= share * a.max(b);
                    // Errors of pairs are kept in f32.
                    let same = i == j || close(x.0, y.0, SAME) && close(x.1, y.1, EXACT);
                    let error = if same {
                        x.1.max(y.1)
                    } else if is_exact(x.0, x.1) && is_exact(y.0, y.1) {
                        // Randomisations of a few rays agree by chance, and the directions do not.
                        (value - x.0).abs().max((value - y.0).abs())
                    } else {
                        (wx * x.1).hypot(wy * y.1) / (wx + wy)
                    };
                    result.errors.push(error);
                    variance = variance.min(error.max(EXACT * value).powi(2));
                }
                let mobility =
                    if value > 0.0 { (variance / value / noise.largest).max(LEAST_MOBILITY) } else { 0.0 };
                result.mobility.push(mobility as f32);
            }
            result.start.push(result.columns.len());
        }
        result
    }

    /// Entry k over what it was, where the multipliers of its row and column sum to `x`.
    fn growth(&self, k: usize, x: f64) -> f64 {
        (f64::from(self.mobility[k]) * x).exp()
    }

    /// Calls `row` with each row and its entries' indices, on all cores.
    fn by_row<T: Send>(&self, row: impl Fn(usize, Range<usize>) -> T + Sync) -> Vec<T> {
        let rows = (0..self.start.len() - 1).into_par_iter().with_min_len(64);
        rows.map(|i| row(i, self.start[i]..self.start[i + 1])).collect()
    }
}

/// How noisy the rows are, as counts are.
struct Noise {
    /// Inverse variance of each row's exchange areas over the exchange area: `1 / (c_i A_i)`.
    weights: Vec<f64>,
    /// The largest `c_i A_i`.
    largest: f64,
    /// Variance over value of what lies outside, in units of the largest.
    outside: Vec<f64>,
}

impl Noise {
    fn of(raw: &Factors) -> Noise {
        let n = raw.nodes();
        let c: Vec<f64> = (0..n)
            .map(|i| {
                let (_, values, errors) = raw.row(i);
                let Some(errors) = errors else { return 0.0 };
                let noisy = values.iter().zip(errors).filter(|(v, e)| **v > 0.0 && !is_exact(**v, **e));
                let (sum, squares) =
                    noisy.fold((0.0, 0.0), |(sum, squares), (v, e)| (sum + v, squares + e * e));
                if sum > 0.0 { squares / sum } else { 0.0 }
            })
            .collect();
        // Rows whose randomisations all agree (all rays land on one node) count as exact, but not without bound; rows without factors
        // as the others.
        let known: Vec<f64> = c.iter().copied().filter(|c| *c > 0.0).collect();
        let mean = if known.is_empty() { 1.0 } else { known.iter().sum::<f64>() / known.len() as f64 };
        let variance = |i: usize| {
            let empty = raw.start[i] == raw.start[i + 1];
            if empty || known.is_empty() { mean } else { c[i].max(1e-6 * mean) }
        };
        let rows: Vec<f64> = (0..n).map(|i| variance(i) * raw.areas[i]).collect();
        let largest = rows.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        // What lies outside is counted by rays, however well the factors of its row are known; where it is nothing, it stays so
        // however far the row's factors must move.
        let lost = |i: usize| raw.escaped[i] + raw.absorbed[i] > 0.0;
        let mobility = |i: usize| if lost(i) { c[i].max(mean) * raw.areas[i] / largest } else { 0.0 };
        let outside = (0..n).map(mobility).collect();
        Noise { weights: rows.iter().map(|v| 1.0 / v).collect(), largest, outside }
    }
}

/// What lies outside: exchange areas with it [m^2] and their mobilities.
struct Outside {
    areas: Vec<f64>,
    mobility: Vec<f64>,
}

/// Start of each column, and (row, index of the entry) by column, rows in order.
fn transpose(raw: &Factors) -> (Vec<usize>, Vec<(u32, usize)>) {
    let n = raw.nodes();
    let mut start = vec![0usize; n + 1];
    raw.columns.iter().for_each(|j| start[*j as usize + 1] += 1);
    for j in 0..n {
        start[j + 1] += start[j];
    }
    let mut next = start.clone();
    let mut entries = vec![(0, 0); raw.columns.len()];
    for i in 0..n {
        for k in raw.start[i]..raw.start[i + 1] {
            let j = raw.columns[k] as usize;
            entries[next[j]] = (i as u32, k);
            next[j] += 1;
        }
    }
    (start, entries)
}

/// A row for given multipliers.
#[derive(Clone, Copy)]
struct RowState {
    /// Sum of the row, with what lies outside [m^2].
    sum: f64,
    /// The same, each entry times its mobility: the sum's derivative.
    stiffness: f64,
    /// The row's part of the function that is minimised.
    value: f64,
}

fn state(g: &Symmetric, outside: &Outside, areas: &[f64], x: &[f64]) -> Vec<RowState> {
    // (e^(w x) - 1) / w, which is x for none.
    let raised = |w: f64, x: f64| if w > 0.0 { (w * x).exp_m1() / w } else { x };
    g.by_row(|i, entries| {
        let (o, v) = (outside.areas[i], outside.mobility[i]);
        let beyond = o * (v * x[i]).exp();
        let mut row =
            RowState { sum: beyond, stiffness: v * beyond, value: o * raised(v, x[i]) - areas[i] * x[i] };
        for k in entries {
            let (w, both) = (f64::from(g.mobility[k]), x[i] + x[g.columns[k] as usize]);
            let raised = raised(w, both);
            let now = g.values[k] * (1.0 + w * raised);
            row.sum += now;
            row.stiffness += w * now;
            row.value += 0.5 * g.values[k] * raised;
        }
        row
    })
}

/// The x, and the number of Newton's steps.
fn multipliers(g: &Symmetric, outside: &Outside, raw: &Factors) -> Result<(Vec<f64>, usize)> {
    let n = raw.nodes();
    let areas = &raw.areas;
    let off = |rows: &[RowState]| {
        let relative = |i: usize| (rows[i].sum / areas[i] - 1.0).abs();
        (0..n).map(relative).fold(0.0, |most, r| if r > most || r.is_nan() { r } else { most })
    };
    let value = |rows: &[RowState]| rows.iter().map(|r| r.value).sum::<f64>();
    let mut x = vec![0.0; n];
    let mut rows = state(g, outside, areas, &x);
    for step in 0..MOST_STEPS {
        let residual = off(&rows);
        if residual <= CLOSURE_TOLERANCE {
            return Ok((x, step));
        }
        if !residual.is_finite() || rows.iter().any(|r| r.sum == 0.0) {
            break;
        }
        let gradient: Vec<f64> = (0..n).map(|i| areas[i] - rows[i].sum).collect();
        let mut s = newton_step(g, &x, &rows, &gradient, residual.min(0.1));
        let most = |a: f64, b: f64| a.max(b);
        let growths = g.by_row(|i, entries| {
            let own = outside.mobility[i] * s[i];
            entries.map(|k| f64::from(g.mobility[k]) * (s[i] + s[g.columns[k] as usize])).fold(own, most)
        });
        let longest = growths.into_iter().fold(0.0, most);
        if longest > MOST_GROWTH {
            s.iter_mut().for_each(|v| *v *= MOST_GROWTH / longest);
        }
        let slope: f64 = s.iter().zip(&gradient).map(|(s, r)| -s * r).sum();
        let before = value(&rows);
        let mut length = 1.0;
        loop {
            let trial: Vec<f64> = x.iter().zip(&s).map(|(x, s)| x + length * s).collect();
            let trial_rows = state(g, outside, areas, &trial);
            // Close to the minimum the function is all rounding: then the residual decides.
            let lower =
                value(&trial_rows) <= before + 1e-4 * length * slope || off(&trial_rows) < 0.5 * residual;
            if lower || length < 1e-3 {
                (x, rows) = (trial, trial_rows);
                break;
            }
            length *= 0.5;
        }
    }
    if off(&rows) <= CLOSURE_TOLERANCE {
        return Ok((x, MOST_STEPS));
    }
    let mut worst: Vec<usize> = (0..n).collect();
    let departure = |i: &usize| (rows[*i].sum / areas[*i] - 1.0).abs();
    worst.sort_by(|a, b| departure(b).total_cmp(&departure(a)));
    let named: Vec<String> = worst.iter().take(3).map(|i| raw.name(*i)).collect();
    Err(Error::scene(
        "closure",
        format!(
            "no symmetric matrix with factors where these are sums to 1 in every row: the areas do not allow it, or too few rays \
             found too few pairs; worst at {}. Compute more precisely (more rays or pixels), check that the enclosure is closed, \
             or use --enforce reciprocity",
            named.join(", ")
        ),
    ))
}

/// Solves `H s = r` by conjugate gradients, preconditioned by the diagonal; H is the second derivative at x, each entry times
/// its mobility and the rows' sums of these on the diagonal besides.
fn newton_step(g: &Symmetric, x: &[f64], rows: &[RowState], r: &[f64], tolerance: f64) -> Vec<f64> {
    let n = r.len();
    let stiffness: Vec<f64> = g
        .by_row(|i, entries| {
            let at = |k: usize| {
                let both = x[i] + x[g.columns[k] as usize];
                f64::from(g.mobility[k]) * g.values[k] * g.growth(k, both)
            };
            entries.map(at).collect::<Vec<f64>>()
        })
        .concat();
    let apply = |p: &[f64]| -> Vec<f64> {
        g.by_row(|i, entries| {
            let product: f64 = entries.map(|k| stiffness[k] * p[g.columns[k] as usize]).sum();
            rows[i].stiffness * p[i] + product
        })
    };
    // A row of which nothing can move has no step.
    let inverse: Vec<f64> =
        rows.iter().map(|row| if row.stiffness > 0.0 { 1.0 / row.stiffness } else { 0.0 }).collect();
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let mut s = vec![0.0; n];
    let mut rest = r.to_vec();
    let mut z: Vec<f64> = rest.iter().zip(&inverse).map(|(r, h)| r * h).collect();
    let mut p = z.clone();
    let mut rz = dot(&rest, &z);
    let target = tolerance * tolerance * rz;
    for _ in 0..MOST_CG_STEPS {
        let q = apply(&p);
        let curvature = dot(&p, &q);
        if rz <= target || curvature <= 0.0 {
            break;
        }
        let alpha = rz / curvature;
        for i in 0..n {
            s[i] += alpha * p[i];
            rest[i] -= alpha * q[i];
            z[i] = rest[i] * inverse[i];
        }
        let next = dot(&rest, &z);
        let beta = next / rz;
        rz = next;
        for i in 0..n {
            p[i] = z[i] + beta * p[i];
        }
    }
    s
}

#[cfg(test)]
mod tests;
