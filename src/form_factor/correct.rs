//! Corrected matrices: estimates moved as little as need be, so that they obey what exact factors obey.
//!
//! Everything happens on the exchange areas `G_ij = A_i F_ij` [m^2].
//!
//! **Reciprocity.** `G_ij` and `G_ji` estimate one number. Their mean weighted by the inverse variances replaces both. A
//! single entry's sample variance is no good weight: it rises and falls with the entry itself, and one that no ray
//! happened to hit has none. The variances are modelled as those of counts, `var(G_ij) = c_i A_i G_ij`, with
//! one `c_i` a row, measured as the ratio of the row's summed sample variances to its summed factors; without
//! standard errors all `c_i` are equal. The weights `1 / (c_i A_i)` do not depend on the entry, so the mean stays unbiased.
//!
//! **Closure.** Of all symmetric matrices with the pattern of G, the one nearest to it in relative entropy whose rows
//! sum to the areas is `D G D` with a positive diagonal D (symmetric Sinkhorn scaling; Knight and Ruiz, IMA J. Numer. Anal. 33,
//! 2013). For small moves that is least-squares smoothing weighted by the variances of counts, as
//! Larsen and Howell (J. Heat Transfer 108, 1986) and Daun, Morton and Howell (J. Heat Transfer 127, 2005) do it, but no entry can turn
//! negative and none appears where no ray went. van Leersum (Int. J. Heat Fluid Flow 10, 1989) spreads the residual
//! in proportion to the entries row by row, which converges to the same kind of scaling. In an open enclosure what lies outside
//! takes part as one more surface with no sum of its own, `A_i = sum_j G_ij + A_i (escaped_i + absorbed_i)`, so escaped
//! and absorbed shares move like the factors of their row.
//!
//! D minimises the convex function `1/2 sum_ij G_ij e^(x_i + x_j) + sum_i O_i e^(x_i) - sum_i A_i x_i` with `D_ii = e^(x_i)`,
//! found by Newton's method with conjugate gradients.

use super::Factors;
use crate::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;

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
    /// Largest move in standard errors, of those factors that have one above zero.
    pub largest_move_in_standard_errors: Option<f64>,
    /// Root mean square move in standard errors, of the same.
    pub rms_move_in_standard_errors: Option<f64>,
    /// Largest move of an escaped or absorbed share.
    pub largest_move_of_escape: f64,
    /// Newton's steps for closure.
    pub iterations: usize,
    /// Largest departure of a row's sum from 1 (escaped and absorbed shares included) afterwards.
    pub closure: f64,
    /// The same beforehand.
    pub closure_before: f64,
}

/// Rows sum to 1 within this.
pub const CLOSURE_TOLERANCE: f64 = 1e-12;
/// Newton's steps: far more than a matrix takes that has a solution.
const MOST_STEPS: usize = 60;
const MOST_CG_STEPS: usize = 400;

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
    let mut symmetric = Symmetric::new(&raw);
    let outside: Vec<f64> = (0..n).map(|i| raw.areas[i] * (raw.escaped[i] + raw.absorbed[i])).collect();
    let (scale, iterations) = match enforce {
        Enforce::Reciprocity => (vec![1.0; n], 0),
        Enforce::Closure => scaling(&symmetric, &outside, &raw)?,
    };
    for i in 0..n {
        for k in symmetric.start[i]..symmetric.start[i + 1] {
            // The product is formed alike for (i, j) and (j, i).
            let factor = scale[i] * scale[symmetric.columns[k] as usize];
            symmetric.values[k] *= factor;
            if let Some(error) = symmetric.errors.get_mut(k) {
                *error *= factor;
            }
        }
    }
    let area_of: Vec<usize> =
        (0..n).flat_map(|i| std::iter::repeat_n(i, symmetric.start[i + 1] - symmetric.start[i])).collect();
    factors.values = symmetric.values.iter().zip(&area_of).map(|(g, i)| g / raw.areas[*i]).collect();
    factors.errors = symmetric.errors.iter().zip(&area_of).map(|(g, i)| g / raw.areas[*i]).collect();
    factors.start = symmetric.start;
    factors.columns = symmetric.columns;
    for (i, s) in scale.iter().enumerate() {
        factors.escaped[i] *= s;
        factors.absorbed[i] *= s;
    }
    factors.written = match enforce {
        Enforce::Reciprocity => "reciprocity",
        Enforce::Closure => "closure",
    };
    Ok(moves(&raw, factors, iterations))
}

/// Largest departure of a row's sum from 1.
fn closure(factors: &Factors) -> f64 {
    let residual = |row: usize| {
        let sum: f64 = factors.row(row).1.iter().sum();
        (sum + factors.escaped[row] + factors.absorbed[row] - 1.0).abs()
    };
    (0..factors.rows.len()).map(residual).fold(0.0, f64::max)
}

fn moves(raw: &Factors, now: &Factors, iterations: usize) -> Correction {
    let (mut count, mut square, mut largest) = (0usize, 0.0, 0.0f64);
    let (mut with_error, mut square_in_errors, mut largest_in_errors) = (0usize, 0.0, 0.0f64);
    for i in 0..now.nodes() {
        let (old_columns, old_values, old_errors) = raw.row(i);
        let (columns, values, _) = now.row(i);
        let mut k = 0;
        for (j, value) in columns.iter().zip(values) {
            // The new pattern holds the old one.
            let old = old_columns.get(k) == Some(j);
            let moved = (value - if old { old_values[k] } else { 0.0 }).abs();
            count += 1;
            square += moved * moved;
            largest = largest.max(moved);
            if let (true, Some(errors)) = (old, old_errors) {
                if errors[k] > 0.0 {
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
}

impl Symmetric {
    /// Means of both directions' estimates.
    fn new(raw: &Factors) -> Symmetric {
        let n = raw.nodes();
        let weight = weights(raw);
        let transposed = transpose(raw);
        let mut result =
            Symmetric { start: vec![0], columns: Vec::new(), values: Vec::new(), errors: Vec::new() };
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
                let value = if i == j { there.0 } else { (wx * x.0 + wy * y.0) / (wx + wy) };
                result.columns.push(j as u32);
                result.values.push(value);
                if errors.is_some() {
                    let error = if i == j { there.1 } else { (wx * x.1).hypot(wy * y.1) / (wx + wy) };
                    result.errors.push(error);
                }
            }
            result.start.push(result.columns.len());
        }
        result
    }

    /// Row sums of `D G D`, D given by its diagonal.
    fn sums(&self, d: &[f64]) -> Vec<f64> {
        self.multiply(d).iter().zip(d).map(|(s, d)| s * d).collect()
    }

    fn multiply(&self, x: &[f64]) -> Vec<f64> {
        (0..x.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|i| {
                let range = self.start[i]..self.start[i + 1];
                let pairs = self.columns[range.clone()].iter().zip(&self.values[range]);
                pairs.map(|(j, g)| g * x[*j as usize]).sum()
            })
            .collect()
    }
}

/// Inverse variance of each row's exchange areas over the exchange area: `1 / (c_i A_i)`.
fn weights(raw: &Factors) -> Vec<f64> {
    let n = raw.nodes();
    let c: Vec<f64> = (0..n)
        .map(|i| {
            let (_, values, errors) = raw.row(i);
            let sum: f64 = values.iter().sum();
            match errors {
                Some(errors) if sum > 0.0 => errors.iter().map(|e| e * e).sum::<f64>() / sum,
                _ => 0.0,
            }
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
    (0..n).map(|i| 1.0 / (variance(i) * raw.areas[i])).collect()
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

/// The diagonal of D, and the number of Newton's steps.
fn scaling(g: &Symmetric, outside: &[f64], raw: &Factors) -> Result<(Vec<f64>, usize)> {
    let n = outside.len();
    let areas = &raw.areas;
    let mut x = vec![0.0; n];
    let state = |x: &[f64]| {
        let d: Vec<f64> = x.iter().map(|x| x.exp()).collect();
        let inner = g.sums(&d);
        // Half of the inner sums, all of the outer ones: the function that is minimised.
        let value: f64 = (0..n).map(|i| 0.5 * inner[i] + outside[i] * d[i] - areas[i] * x[i]).sum();
        let sums: Vec<f64> = (0..n).map(|i| inner[i] + outside[i] * d[i]).collect();
        (d, sums, value)
    };
    let off = |sums: &[f64]| {
        let relative = |i: usize| (sums[i] / areas[i] - 1.0).abs();
        (0..n).map(relative).fold(0.0, f64::max)
    };
    let (mut d, mut sums, mut value) = state(&x);
    for step in 0..MOST_STEPS {
        let residual = off(&sums);
        if residual <= CLOSURE_TOLERANCE {
            return Ok((d, step));
        }
        if !residual.is_finite() || sums.contains(&0.0) {
            break;
        }
        let gradient: Vec<f64> = (0..n).map(|i| areas[i] - sums[i]).collect();
        let mut s = newton_step(g, &d, &sums, &gradient, residual.min(0.1));
        // e^x is no straight line: no step beyond a factor of e^2.
        let longest = s.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        if longest > 2.0 {
            s.iter_mut().for_each(|v| *v *= 2.0 / longest);
        }
        let slope: f64 = s.iter().zip(&gradient).map(|(s, r)| -s * r).sum();
        let mut length = 1.0;
        loop {
            let trial: Vec<f64> = x.iter().zip(&s).map(|(x, s)| x + length * s).collect();
            let (trial_d, trial_sums, trial_value) = state(&trial);
            // Close to the minimum the function is all rounding: then the residual decides.
            let lower = trial_value <= value + 1e-4 * length * slope || off(&trial_sums) < 0.5 * residual;
            if lower || length < 1e-3 {
                (x, d, sums, value) = (trial, trial_d, trial_sums, trial_value);
                break;
            }
            length *= 0.5;
        }
    }
    if off(&sums) <= CLOSURE_TOLERANCE {
        return Ok((d, MOST_STEPS));
    }
    let mut worst: Vec<usize> = (0..n).collect();
    let departure = |i: &usize| (sums[*i] / areas[*i] - 1.0).abs();
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

/// Solves `(diag(sums) + D G D) s = r` by conjugate gradients, preconditioned by the diagonal.
fn newton_step(g: &Symmetric, d: &[f64], sums: &[f64], r: &[f64], tolerance: f64) -> Vec<f64> {
    let n = r.len();
    let apply = |p: &[f64]| -> Vec<f64> {
        let scaled: Vec<f64> = p.iter().zip(d).map(|(p, d)| p * d).collect();
        let product = g.multiply(&scaled);
        (0..n).map(|i| sums[i] * p[i] + d[i] * product[i]).collect()
    };
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let mut s = vec![0.0; n];
    let mut rest = r.to_vec();
    let mut z: Vec<f64> = rest.iter().zip(sums).map(|(r, h)| r / h).collect();
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
            z[i] = rest[i] / sums[i];
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
