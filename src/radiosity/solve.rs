//! The linear system of pass 1, `R = rho (H + F R)`, by stabilised biconjugate gradients.
//!
//! R is the reflected radiosity, H the irradiance straight from the sources. Bi-CGSTAB (van der
//! Vorst 1992) needs no transpose and no exact reciprocity, which ray-cast factors lack, and its
//! steps grow with the square root of the condition number where Gauss-Seidel's grow in proportion.

use super::Transport;
use crate::color::Rgb;
use crate::form_factor::ExchangeMatrix;
use crate::{Error, Result};

/// Most steps; far above what any reflectance below 1 - 1e-6 needs.
const MOST_STEPS: usize = 2000;

/// Mean share of light lost at a bounce below which single-precision rays cannot tell a steady state from none.
const LEAST_LOSS: f64 = 1e-8;

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convergence {
    /// Multiplications with the matrix.
    pub iterations: usize,
    /// Euclidean norm of the residual over that of the right-hand side, worst channel.
    pub residual: f64,
    /// What was asked for.
    pub tolerance: f64,
}

/// Solves for the reflected radiosity [W m^-2] of every element.
///
/// `incident` is the irradiance from sources [W m^-2]. Errors where the largest albedo is 1 and
/// nothing escapes or is absorbed, so that no steady state exists.
pub fn solve_reflected(
    matrix: &ExchangeMatrix,
    transport: &Transport,
    incident: &[Rgb],
    tolerance: f64,
) -> Result<(Vec<Rgb>, Convergence)> {
    let b = transport.reflect(incident);
    // Rays see a closed white room as closed exactly; the solver would return a large number.
    let lost = (0..matrix.len()).fold(Rgb::ZERO, |sum, row| {
        let s = &matrix.summary[row];
        sum + (Rgb::ONE - transport.reflectance[row] - transport.transmittance[row]) + s.escaped + s.absorbed
    }) / matrix.len().max(1) as f64;
    let lit = b.iter().fold(Rgb::ZERO, |m, b| m.max(*b));
    if (0..3).any(|c| lit[c] > 0.0 && lost[c] < LEAST_LOSS) {
        return Err(Error::scene(
            "radiosity",
            format!(
                "no steady state exists: the surfaces absorb a share of {:.1e} of the light and none escapes; \
                 lower an albedo below 1 or open the scene",
                lost.min_element()
            ),
        ));
    }
    let apply = |x: &[Rgb]| -> Vec<Rgb> {
        let y = transport.reflect(&matrix.multiply(x));
        x.iter().zip(&y).map(|(x, y)| *x - *y).collect()
    };
    let norm_b = dot(&b, &b).map(f64::sqrt);
    let mut x = b.clone();
    let mut r = subtract(&b, &apply(&x));
    let mut iterations = 1;
    let shadow = r.clone();
    let (mut p, mut rho) = (r.clone(), dot(&shadow, &r));
    let mut best = relative(&r, norm_b);
    while best > tolerance && iterations < MOST_STEPS {
        let v = apply(&p);
        let alpha = ratio(rho, dot(&shadow, &v));
        let s = combine(&r, -alpha, &v);
        let t = apply(&s);
        let omega = ratio(dot(&t, &s), dot(&t, &t));
        for k in 0..x.len() {
            x[k] += alpha * p[k] + omega * s[k];
        }
        r = combine(&s, -omega, &t);
        let next = dot(&shadow, &r);
        let beta = ratio(next, rho) * ratio(alpha, omega);
        for k in 0..p.len() {
            p[k] = r[k] + beta * (p[k] - omega * v[k]);
        }
        rho = next;
        iterations += 2;
        best = relative(&r, norm_b);
    }
    // The recurrence drifts from the true residual: report the true one.
    let residual = relative(&subtract(&b, &apply(&x)), norm_b);
    if residual.is_nan() || residual > 10.0 * tolerance {
        return Err(Error::scene(
            "radiosity",
            format!(
                "no steady state found: residual {residual:.1e} after {iterations} steps (wanted {tolerance:.0e}); the \
                 largest albedo is {:.6}: in a closed scene it must stay below 1",
                transport.largest()
            ),
        ));
    }
    Ok((x, Convergence { iterations, residual, tolerance }))
}

/// Sums in a fixed order: the same on any number of threads.
fn dot(a: &[Rgb], b: &[Rgb]) -> Rgb {
    a.iter().zip(b).map(|(a, b)| *a * *b).sum()
}

fn subtract(a: &[Rgb], b: &[Rgb]) -> Vec<Rgb> {
    a.iter().zip(b).map(|(a, b)| *a - *b).collect()
}

fn combine(a: &[Rgb], f: Rgb, b: &[Rgb]) -> Vec<Rgb> {
    a.iter().zip(b).map(|(a, b)| *a + f * *b).collect()
}

/// Channel by channel; a channel that has converged exactly stays where it is.
fn ratio(a: Rgb, b: Rgb) -> Rgb {
    let div = |a: f64, b: f64| if b != 0.0 && (a / b).is_finite() { a / b } else { 0.0 };
    Rgb::new(div(a.x, b.x), div(a.y, b.y), div(a.z, b.z))
}

fn relative(r: &[Rgb], norm: Rgb) -> f64 {
    ratio(dot(r, r).map(f64::sqrt), norm).max_element()
}
