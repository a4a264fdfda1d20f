//! The linear system of pass 1, `H = H0 + F (rho H + tau H')`, by Krylov's methods.
//!
//! H is the irradiance, H0 its part straight from the sources. Where a bounce loses much of the light, rows are used as they were cast, and
//! Bi-CGSTAB (van der Vorst 1992) solves: it needs no transpose and no exact reciprocity, which such rows lack. Where little is
//! lost, the exchange is reciprocal ([`super::exchange::Balance`]) and conjugate gradients solve, with a coarse space for the slow
//! modes ([`super::symmetric`]): Bi-CGSTAB's first guess settles the mean light of one closed room by the balance of power, but of
//! rooms joined by small openings each has its own. Rows that are kept have a coarse grid in its place ([`super::coarse`]).
//!
//! **Error bound.** `A = 1 - F rho` has an inverse without negative entries. For any `w > 0` with `d = A w > 0`, the error
//! of an irradiance with residual r is at most `max |r_i / d_i|` times `w` (take `A^-1 d = w`). With `w = 1`, `d_i` is
//! what is lost of the light that element i gathers, and the bound is at least as good as `|r| / (1 - max rho)`. Where
//! an element sees nothing but perfectly white surfaces, `w` takes more bounces.

use super::Transport;
use super::coarse::Coarse;
use super::exchange::{Exchange, MANY, residual_operator, round};
use super::symmetric::{Groups, Symmetric};
use crate::color::Rgb;
use crate::{Error, Result};
use rayon::prelude::*;

/// Most steps; far above what any reflectance below 1 - 1e-9 needs.
const MOST_STEPS: usize = 4000;
/// Times that a solve starts, from the true residual.
const RESTARTS: usize = 4;
/// Mean share of light lost at a bounce below which double precision cannot tell a steady state from none.
const LEAST_LOSS: f64 = 1e-12;
/// Loss at a bounce, at every element, from which on single precision is enough for the steps of the solver.
const LOSSY: f64 = 0.1;
/// Bounces that the weight of the error bound may take.
const MOST_BOUNCES: usize = 16;
/// Larger relative errors of a solve are refused.
const MOST_ERROR: f64 = 1e-4;

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convergence {
    /// Multiplications with the matrix.
    pub iterations: usize,
    /// Euclidean norm of the residual over that of the right-hand side, worst channel.
    pub residual: f64,
    /// Bound on the largest error of an irradiance over the largest irradiance, worst channel; infinite where none is known.
    pub error_bound: f64,
    /// What was asked of both.
    pub tolerance: f64,
}

impl Convergence {
    /// Its numbers in the order in which they are declared.
    pub(super) fn numbers(&self) -> [f64; 4] {
        [self.iterations as f64, self.residual, self.error_bound, self.tolerance]
    }

    /// The inverse of [`Convergence::numbers`].
    pub(super) fn of_numbers([iterations, residual, error_bound, tolerance]: [f64; 4]) -> Convergence {
        Convergence { iterations: iterations as usize, residual, error_bound, tolerance }
    }
}

/// What makes steps few.
pub(super) enum Acceleration<'a, 'm> {
    /// The mean light of the scene as a first guess; of groups, errors are looked at apart.
    Balance(Groups),
    /// A coarse grid.
    Coarse(Coarse),
    /// Reciprocity.
    Symmetric(Symmetric<'a, 'm>),
}

/// Solves for the irradiance [W m^-2] of every element; `incident` is its part straight from the sources, `ones` what a
/// multiplication of the system with 1 gives where that is known.
///
/// Errors where nothing is lost at a bounce, so that no steady state exists.
pub(super) fn solve(
    exchange: &Exchange,
    transport: &Transport,
    acceleration: &Acceleration,
    incident: &[Rgb],
    ones: Option<Vec<Rgb>>,
    tolerance: f64,
) -> Result<(Vec<Rgb>, Convergence)> {
    let n = incident.len();
    let lost = (0..n).fold(Rgb::ZERO, |sum, row| {
        let s = &exchange.rows.summary()[row];
        sum + (Rgb::ONE - transport.reflectance[row] - transport.transmittance[row]) + s.escaped + s.absorbed
    }) / n.max(1) as f64;
    let lit = incident.iter().fold(Rgb::ZERO, |m, b| m.max(*b));
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
    let apply = |x: &[Rgb]| residual_operator(|y| exchange.gather(y), transport, x);
    let ones = ones.unwrap_or_else(|| apply(&vec![Rgb::ONE; n]));
    let bound = Bound::new(apply, ones);
    // Where every element loses enough of what it gathers, steps work in single precision: the restart from the true residual
    // makes good what that costs. Where little is lost, they would diverge.
    let lossy = bound.ones.iter().all(|d| d.min_element() >= LOSSY);
    let rough = |x: &[Rgb]| match lossy {
        true => residual_operator(|y| exchange.gather_rough(&round(y)), transport, x),
        false => apply(x),
    };
    let mut iterations = bound.bounces + 1;
    let norm = norm(incident);
    let done = |x: &[Rgb], r: &[Rgb]| match bound.relative(x, r) {
        e if e.is_finite() => e <= tolerance,
        _ => relative(r, norm) <= tolerance,
    };
    // The recurrence drifts from the true residual: start again from where it ended.
    let mut x = match acceleration {
        Acceleration::Symmetric(symmetric) => {
            let (mut x, mut count) =
                symmetric.solve(incident, incident.to_vec(), done, MOST_STEPS / RESTARTS);
            for _ in 1..RESTARTS {
                iterations += count;
                (x, count) = symmetric.solve(incident, x, done, MOST_STEPS / RESTARTS);
                if count == 1 {
                    break;
                }
            }
            iterations += count;
            x
        }
        Acceleration::Coarse(coarse) => {
            let mut x = coarse.precondition(incident);
            for _ in 0..RESTARTS {
                let r = subtract(incident, &apply(&x));
                iterations += 1;
                if done(&x, &r) {
                    break;
                }
                let mut state = Krylov::new(vec![Rgb::ZERO; n], r);
                let moved = |u: &[Rgb]| combine(&x, Rgb::ONE, &coarse.precondition(u));
                let step = |u: &[Rgb]| rough(&coarse.precondition(u));
                iterations += state.run(step, |u, r| done(&moved(u), r), MOST_STEPS / RESTARTS);
                x = moved(&state.x);
            }
            x
        }
        Acceleration::Balance(_) => {
            let mut state = Krylov::balanced(incident, &apply(incident), &bound.ones);
            for restart in 0..RESTARTS {
                if restart > 0 {
                    let r = subtract(incident, &apply(&state.x));
                    iterations += 1;
                    state = Krylov::new(state.x, r);
                }
                if done(&state.x, &state.r) {
                    break;
                }
                iterations += state.run(rough, done, MOST_STEPS / RESTARTS);
            }
            state.x
        }
    };
    // One more bounce of what is not negative: no dark element keeps a negative rest of the solver's.
    x.iter_mut().for_each(|x| *x = x.max(Rgb::ZERO));
    let gathered = exchange.gather(&transport.reflect(&x));
    x = incident.iter().zip(&gathered).map(|(a, b)| *a + *b).collect();
    let r = subtract(incident, &apply(&x));
    let (residual, error_bound) = (relative(&r, norm), bound.relative(&x, &r));
    let error = if error_bound.is_finite() { error_bound } else { residual };
    if error.is_nan() || error > MOST_ERROR.max(10.0 * tolerance) {
        return Err(Error::scene(
            "radiosity",
            format!(
                "no steady state found: error {error:.1e} after {iterations} steps (wanted {tolerance:.0e}); the \
                 largest albedo is {}: in a closed scene it must stay below 1, and where little is lost the noise of the \
                 factors must not hide that: cast more rays (--rays)",
                transport.largest()
            ),
        ));
    }
    Ok((x, Convergence { iterations, residual, error_bound, tolerance }))
}

/// A weight `w` and `d = A w` for the error bound.
struct Bound {
    bounces: usize,
    weight: Rgb,
    d: Vec<Rgb>,
    /// `A 1`.
    ones: Vec<Rgb>,
}

impl Bound {
    fn new(apply: impl Fn(&[Rgb]) -> Vec<Rgb>, ones: Vec<Rgb>) -> Bound {
        let n = ones.len();
        let mut w = vec![Rgb::ONE; n];
        // The light of one bounce more each time: 1, F rho 1, ...
        let mut bounce = w.clone();
        let mut d = ones.clone();
        for bounces in 1..=MOST_BOUNCES {
            if d.iter().all(|d| d.min_element() > 1e-13) {
                let weight = w.iter().fold(Rgb::ZERO, |m, w| m.max(*w));
                return Bound { bounces, weight, d, ones };
            }
            bounce = bounce.iter().zip(apply(&bounce)).map(|(b, a)| *b - a).collect();
            w.iter_mut().zip(&bounce).for_each(|(w, b)| *w += *b);
            d = apply(&w);
        }
        Bound { bounces: 2 * MOST_BOUNCES, weight: Rgb::INFINITY, d: vec![Rgb::ONE; n], ones }
    }

    /// Bound on the largest error over the largest value, worst channel.
    fn relative(&self, x: &[Rgb], r: &[Rgb]) -> f64 {
        let worst = |m: Rgb, (r, d): (&Rgb, &Rgb)| m.max((*r / *d).abs());
        let most = r.par_iter().zip(&self.d).with_min_len(MANY).fold(|| Rgb::ZERO, worst);
        let most = most.reduce(|| Rgb::ZERO, Rgb::max);
        let largest = x.par_iter().with_min_len(MANY).fold(|| Rgb::ZERO, |m, x| m.max(x.abs()));
        let largest = largest.reduce(|| Rgb::ZERO, Rgb::max);
        let share = |c: usize| if most[c] == 0.0 { 0.0 } else { most[c] * self.weight[c] / largest[c] };
        share(0).max(share(1)).max(share(2))
    }
}

/// Bi-CGSTAB on its way, in halves of a step, so that several systems can share their multiplications.
pub(super) struct Krylov {
    pub x: Vec<Rgb>,
    /// Residual.
    pub r: Vec<Rgb>,
    shadow: Vec<Rgb>,
    p: Vec<Rgb>,
    v: Vec<Rgb>,
    rho: Rgb,
    alpha: Rgb,
}

impl Krylov {
    /// From a guess and its residual.
    pub fn new(x: Vec<Rgb>, r: Vec<Rgb>) -> Krylov {
        let rho = dot(&r, &r);
        Krylov { x, shadow: r.clone(), p: r.clone(), r, v: Vec::new(), rho, alpha: Rgb::ZERO }
    }

    /// From `b` and the constant that makes the sum of the residuals zero; `a_b` is `A b` and `ones` is `A 1`.
    pub fn balanced(b: &[Rgb], a_b: &[Rgb], ones: &[Rgb]) -> Krylov {
        let r = subtract(b, a_b);
        let c = ratio(r.iter().sum(), ones.iter().sum());
        Krylov::new(b.iter().map(|b| *b + c).collect(), combine(&r, -c, ones))
    }

    /// The solution, moved by the constant that makes the sum of the residuals zero; `ones` is `A 1`.
    pub fn balance(self, ones: &[Rgb]) -> Vec<Rgb> {
        let c = ratio(self.r.iter().sum(), ones.iter().sum());
        self.x.into_iter().map(|x| x + c).collect()
    }

    /// What the first multiplication of a step is with.
    pub fn direction(&self) -> &[Rgb] {
        &self.p
    }

    /// `v` is `A` times the direction; afterwards `r` is what the second multiplication is with.
    pub fn first(&mut self, v: Vec<Rgb>) {
        self.alpha = ratio(self.rho, dot(&self.shadow, &v));
        self.r = combine(&self.r, -self.alpha, &v);
        self.v = v;
    }

    /// `t` is `A r`; false where nothing is left to improve.
    pub fn second(&mut self, t: &[Rgb]) -> bool {
        let omega = ratio(dot(t, &self.r), dot(t, t));
        let alpha = self.alpha;
        let both = self.p.par_iter().zip(&self.r);
        self.x
            .par_iter_mut()
            .zip(both)
            .with_min_len(MANY)
            .for_each(|(x, (p, r))| *x += alpha * *p + omega * *r);
        self.r = combine(&self.r, -omega, t);
        let next = dot(&self.shadow, &self.r);
        let beta = ratio(next, self.rho) * ratio(self.alpha, omega);
        let both = self.r.par_iter().zip(&self.v);
        self.p
            .par_iter_mut()
            .zip(both)
            .with_min_len(MANY)
            .for_each(|(p, (r, v))| *p = *r + beta * (*p - omega * *v));
        self.rho = next;
        self.rho != Rgb::ZERO
    }

    /// The residual's norm over another.
    pub fn relative(&self, norm: Rgb) -> f64 {
        relative(&self.r, norm)
    }

    /// Improves `x` until `done(x, r)` or for `most` multiplications; returns their number.
    fn run(
        &mut self,
        apply: impl Fn(&[Rgb]) -> Vec<Rgb>,
        done: impl Fn(&[Rgb], &[Rgb]) -> bool,
        most: usize,
    ) -> usize {
        let mut count = 0;
        while count < most && !done(&self.x, &self.r) {
            let v = apply(&self.p);
            self.first(v);
            let t = apply(&self.r);
            count += 2;
            if !self.second(&t) {
                break;
            }
        }
        count
    }
}

/// Euclidean norm by channel.
pub(super) fn norm(a: &[Rgb]) -> Rgb {
    dot(a, a).map(f64::sqrt)
}

/// Sums in a fixed order: the same on any number of threads.
fn dot(a: &[Rgb], b: &[Rgb]) -> Rgb {
    let part = |(a, b): (&[Rgb], &[Rgb])| a.iter().zip(b).map(|(a, b)| *a * *b).sum();
    let parts: Vec<Rgb> = a.par_chunks(MANY).zip(b.par_chunks(MANY)).map(part).collect();
    parts.iter().sum()
}

pub(super) fn subtract(a: &[Rgb], b: &[Rgb]) -> Vec<Rgb> {
    a.par_iter().zip(b).with_min_len(MANY).map(|(a, b)| *a - *b).collect()
}

pub(super) fn combine(a: &[Rgb], f: Rgb, b: &[Rgb]) -> Vec<Rgb> {
    a.par_iter().zip(b).with_min_len(MANY).map(|(a, b)| *a + f * *b).collect()
}

/// Channel by channel; a channel that has converged exactly stays where it is.
pub(super) fn ratio(a: Rgb, b: Rgb) -> Rgb {
    let div = |a: f64, b: f64| if b != 0.0 && (a / b).is_finite() { a / b } else { 0.0 };
    Rgb::new(div(a.x, b.x), div(a.y, b.y), div(a.z, b.z))
}

fn relative(r: &[Rgb], norm: Rgb) -> f64 {
    ratio(dot(r, r).map(f64::sqrt), norm).max_element()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::seed_of;

    /// Elements of two halves, of whose 16 rays every fifth crosses, and an albedo of 0.999: what is left of a residual that is
    /// small beside the noise decides about the mean light, which a bounce changes by a thousandth.
    #[test]
    fn balance_settles_the_mean_light() {
        let (n, rays, rho) = (400, 16, 0.999);
        for seed in 0..8 {
            let random = |k: usize, r: u32, what: u32| seed_of(&[seed, k as u32, r, what]);
            let hit = |k: usize, r: u32| {
                let crosses = random(k, r, 0) % 5 == 0;
                let half = if (k < n / 2) == crosses { n / 2 } else { 0 };
                half + random(k, r, 1) as usize % (n / 2)
            };
            let apply = |x: &[Rgb]| -> Vec<Rgb> {
                let gathered = |k: usize| (0..rays).map(|r| x[hit(k, r)]).sum::<Rgb>() / f64::from(rays);
                (0..n).map(|k| x[k] - rho * gathered(k)).collect()
            };
            let noise = |k: usize| f64::from(random(k, 0, 2)) / f64::from(u32::MAX) - 0.5;
            let b: Vec<Rgb> = (0..n).map(|k| Rgb::splat(noise(k))).collect();
            let ones = apply(&vec![Rgb::ONE; n]);
            let solve = |tolerance: f64| {
                let mut state = Krylov::balanced(&b, &apply(&b), &ones);
                state.run(apply, |_, r| relative(r, norm(&b)) < tolerance, 200);
                state.balance(&ones).iter().map(|x| x.x).sum::<f64>() / n as f64
            };
            let (rough, exact) = (solve(0.05), solve(1e-10));
            // What the noise's mean comes to, one standard deviation of it.
            let mean_light = (1.0 / 12.0 / n as f64).sqrt() / (1.0 - rho);
            assert!((rough - exact).abs() < 0.05 * mean_light, "{rough} {exact} of {mean_light}");
        }
    }
}
