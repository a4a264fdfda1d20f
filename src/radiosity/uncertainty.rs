//! Standard errors of a solution, with all that errors of the factors do on their way.
//!
//! Every row has a few independent randomisations ([`Rows::batches`]). A replica of the system takes one of
//! them from each row, at random; the difference of its solution from the mean system's is `A^-1 (g_m - g)`, where g is
//! what the rows gather of the solved light. The differences contain each row's own error and, over the inverse, what all
//! other rows inherit of it, at any number of bounces: near an albedo of 1, where the room's mean light
//! carries most of the error, an element's own gathering shows next to nothing of it. Each randomisation serves equally
//! often, so the mean square over [`REPLICAS`] replicas is `(1 - 1/n) / m` of the variance of one, and
//! `1 / (n - 1)` of it that of the mean of n (a balanced bootstrap; Davison and Hinkley 1997, section 9.2).
//!
//! An element's own part still rests on n values. Errors of neighbours are alike, so variances are
//! averaged over the 3 x 3 cells about an element (or as many neighbours by number on a triangle): some
//! 25 degrees of freedom instead of 3.
//!
//! [`Rows::batches`]: crate::form_factor::Rows::batches

use super::Transport;
use super::exchange::{Exchange, MANY, round};
use super::solve::{Acceleration, Krylov, combine, norm, subtract};
use super::symmetric::{Groups, Symmetric};
use crate::color::Rgb;
use crate::form_factor::Row;
use crate::mesh::{Lattice, Mesh};
use crate::sampling::seed_of;
use crate::scene::Scene;
use rayon::prelude::*;
use serde::Serialize;
use std::borrow::Cow;

/// Replicas of the system.
const REPLICAS: usize = 16;
/// Replicas that share their multiplications.
const TOGETHER: usize = 4;
/// Relative residual of a replica's solve.
const ROUGH: f64 = 0.05;
/// Sum of the residuals of a group of elements, over what the sum of its right-hand sides should be, were they independent. Rooms of
/// their own that lose little of their light have errors that grow far beyond their small part in a norm over all.
const ROUGH_SUM: f64 = 0.5;
/// Mean share of light that a group loses at a bounce from which its errors do not grow.
const LOSSY: f64 = 0.1;
/// Most steps of a replica's solve, of two multiplications.
const MOST_STEPS: usize = 30;

/// Mean radiosity of one side of an object.
#[derive(Debug, Clone, Serialize)]
pub struct ObjectRadiosity {
    /// The object's number.
    #[serde(skip)]
    pub object: u32,
    /// The object's name.
    pub name: String,
    /// The front by the right-hand rule.
    pub front: bool,
    /// Area that has elements, without what others cover (of a side that is covered everywhere, all of it) [m^2].
    pub area: f64,
    /// Mean over that area, emission included [W m^-2].
    pub radiosity: Rgb,
    /// Its standard error [W m^-2].
    pub standard_error: Rgb,
}

/// Light straight from the sources, by row and randomisation.
pub(super) struct BySource<'a> {
    /// Errors independent from row to row.
    pub own: &'a (dyn Fn(usize, usize) -> Rgb + Sync),
    /// Particles, which all rows share; none where there are none.
    pub particles: Option<&'a (dyn Fn(usize, usize) -> Rgb + Sync)>,
}

/// Differences of the replicas' irradiances from the solution's [W m^-2]; empty with one randomisation.
pub(super) struct Replicas {
    differences: Vec<Vec<[f32; 3]>>,
    /// Variance of the mean over the mean square of the differences.
    scale: f64,
    /// Degrees of freedom that each row brings.
    freedom: f64,
}

/// What replicas are made of: one value for each randomisation of each row, row by row.
struct Parts {
    /// What it gathers of the solved light less the mean [W m^-2].
    own: Vec<Rgb>,
    /// What makes it close.
    close: Vec<f64>,
    /// What it gathers of the light that a radiosity of 1 on every element leads to; zero with a coarse grid, which does without.
    ones: Vec<Rgb>,
}

impl Replicas {
    pub fn new(
        exchange: &Exchange,
        transport: &Transport,
        acceleration: &Acceleration,
        irradiance: &[Rgb],
        sources: &BySource,
        environment: Rgb,
    ) -> Replicas {
        let (n, batches) = (exchange.rows.len(), exchange.rows.batches());
        if batches < 2 {
            return Replicas { differences: Vec::new(), scale: f64::NAN, freedom: 0.0 };
        }
        let radiosity = transport.reflect(irradiance);
        let parts = Parts::new(exchange, transport, acceleration, &radiosity, sources, environment);
        let balanced = exchange.balance().map(|b| (b, b.gather(&radiosity, None)));
        let shared_mean: Option<Vec<Rgb>> = sources.particles.map(|particles| {
            (0..n).map(|k| (0..batches).map(|b| particles(k, b)).sum::<Rgb>() / batches as f64).collect()
        });
        // A turn serves every randomisation of every row once; its replicas share their multiplications.
        let turns = REPLICAS.div_ceil(batches) as u32;
        let mut differences = Vec::with_capacity(turns as usize * batches);
        for turn in 0..turns {
            let order: Vec<u16> =
                (0..n as u32).into_par_iter().flat_map_iter(|row| shuffle(batches, row, turn)).collect();
            let common: Vec<u16> = shuffle(batches, u32::MAX, turn).collect();
            for first in (0..batches).step_by(TOGETHER) {
                let count = TOGETHER.min(batches - first);
                let pick = |row: usize, m: usize| usize::from(order[row * batches + first + m]);
                let different: Vec<Vec<Rgb>> = (0..count)
                    .map(|m| {
                        let shared = |row: usize| match (sources.particles, &shared_mean) {
                            (Some(p), Some(mean)) => p(row, usize::from(common[first + m])) - mean[row],
                            _ => Rgb::ZERO,
                        };
                        let own = (0..n)
                            .into_par_iter()
                            .map(|row| parts.own[row * batches + pick(row, m)] + shared(row));
                        let Some((balance, mean)) = &balanced else { return own.collect() };
                        let picked = balance.gather(&radiosity, Some(&|row| pick(row, m)));
                        own.zip(picked.par_iter().zip(mean))
                            .map(|(own, (p, mean))| own + *p - *mean)
                            .collect()
                    })
                    .collect();
                if let Acceleration::Symmetric(symmetric) = acceleration {
                    for b in &different {
                        differences.push(linear(exchange, transport, symmetric, b));
                    }
                    continue;
                }
                let turn = Turn { exchange, transport, parts: &parts, count, pick: &pick, acceleration };
                for x in turn.solve(different) {
                    differences.push(x.iter().map(|x| x.as_vec3().to_array()).collect());
                }
            }
        }
        let scale = 1.0 / ((batches - 1) * differences.len()) as f64;
        Replicas { differences, scale, freedom: (batches - 1) as f64 }
    }

    /// Standard error of a linear function of the irradiances; NaN with one randomisation.
    pub fn of(&self, f: impl Fn(&[Rgb]) -> Rgb) -> Rgb {
        let squares: Rgb = self
            .differences
            .iter()
            .map(|d| {
                let y = f(&wide(d));
                y * y
            })
            .sum();
        (squares * self.scale).map(f64::sqrt)
    }

    /// Standard error of every element's radiosity [W m^-2]; `open` are the elements' open shares.
    pub fn by_element(&self, scene: &Scene, mesh: &Mesh, transport: &Transport, open: &[f64]) -> Vec<Rgb> {
        let mut variance = vec![Rgb::ZERO; mesh.len()];
        for d in &self.differences {
            for (v, r) in variance.iter_mut().zip(transport.reflect(&wide(d))) {
                *v += r * r * self.scale;
            }
        }
        if self.differences.is_empty() {
            variance.fill(Rgb::NAN);
        }
        (0..mesh.len() as u32)
            .into_par_iter()
            .map(|e| {
                let (mut sum, mut count) = (Rgb::ZERO, 0.0);
                // An element that is all but covered has next to no rays of its own: it must not speak for its neighbours.
                neighbours(scene, mesh, e, |k| {
                    sum += variance[k as usize] * open[k as usize];
                    count += open[k as usize];
                });
                let mean = if count > 0.0 { sum / count } else { variance[e as usize] };
                mean.map(f64::sqrt)
            })
            .collect()
    }

    /// Means over each side of each object that has elements; `open` has the shares of elements that are not covered.
    pub fn by_object(
        &self,
        scene: &Scene,
        mesh: &Mesh,
        transport: &Transport,
        radiosity: &[Rgb],
        open: &[f64],
    ) -> Vec<ObjectRadiosity> {
        let mut of = std::collections::BTreeMap::<(u32, bool), usize>::new();
        let side = |e: u32| {
            let (face, front, _) = mesh.place(e);
            (scene.faces[face as usize].object, !front)
        };
        (0..mesh.len() as u32).for_each(|e| {
            of.entry(side(e)).or_insert(0);
        });
        of.values_mut().enumerate().for_each(|(k, v)| *v = k);
        let slot: Vec<usize> = (0..mesh.len() as u32).map(|e| of[&side(e)]).collect();
        let mut is_open = vec![false; of.len()];
        slot.iter().zip(open).for_each(|(k, open)| is_open[*k] |= *open > 0.0);
        let weight: Vec<f64> = (0..mesh.len())
            .map(|e| mesh.area(e as u32) * if is_open[slot[e]] { open[e] } else { 1.0 })
            .collect();
        let total = |values: &[Rgb]| {
            let mut sums = vec![Rgb::ZERO; of.len()];
            for (e, v) in values.iter().enumerate() {
                sums[slot[e]] += *v * weight[e];
            }
            sums
        };
        let (areas, sums) = (total(&vec![Rgb::ONE; mesh.len()]), total(radiosity));
        let mut elements = vec![0.0; of.len()];
        slot.iter().for_each(|k| elements[*k] += 1.0);
        let mut squares = vec![Rgb::ZERO; of.len()];
        for d in &self.differences {
            let of_replica = total(&transport.reflect(&wide(d)));
            squares.iter_mut().zip(of_replica).for_each(|(s, d)| *s += d * d);
        }
        of.into_iter()
            .map(|((object, back), k)| {
                let area = areas[k].x;
                let error = match self.differences.is_empty() {
                    true => Rgb::NAN,
                    // Of few elements the spread is known badly: with it, departures over stated errors are as large as they
                    // should be (the variance of Student's t).
                    false => {
                        let freedom = f64::max(self.freedom * elements[k], 3.0);
                        (squares[k] * self.scale * freedom / (freedom - 2.0)).map(f64::sqrt) / area
                    }
                };
                ObjectRadiosity {
                    object,
                    name: scene.objects[object as usize].clone(),
                    front: !back,
                    area,
                    radiosity: sums[k] / area,
                    standard_error: error,
                }
            })
            .collect()
    }
}

/// What errors `b` of the gathered light come to, to first order.
fn linear(exchange: &Exchange, transport: &Transport, symmetric: &Symmetric, b: &[Rgb]) -> Vec<[f32; 3]> {
    let norm = symmetric.norm(b);
    let scatter = scatter(&symmetric.groups, b);
    let done = |_: &[Rgb], r: &[Rgb]| {
        let size = symmetric.norm(r);
        (0..3).all(|c| size[c] <= ROUGH * norm[c]) && is_settled(&symmetric.groups, r, &scatter)
    };
    let (x, _) = symmetric.solve(b, b.to_vec(), done, MOST_STEPS);
    let gathered = exchange.gather(&transport.reflect(&x));
    b.iter().zip(&gathered).map(|(b, g)| (*b + *g).as_vec3().to_array()).collect()
}

/// By group, the standard deviation of a sum of independent values as large as these.
fn scatter(groups: &Groups, b: &[Rgb]) -> Vec<Rgb> {
    groups.sums(b.iter().map(|b| *b * *b)).into_iter().map(|s| s.map(f64::sqrt)).collect()
}

/// The same where groups lose little of their light, infinite where they lose much; `ones` is `A 1`.
fn scatter_of_lossless(groups: &Groups, b: &[Rgb], ones: &[Rgb]) -> Vec<Rgb> {
    let (lost, counts) = (groups.sums(ones.iter().copied()), groups.sums(b.iter().map(|_| Rgb::ONE)));
    let keep =
        |((s, lost), count): ((Rgb, Rgb), &Rgb)| Rgb::select(lost.cmplt(LOSSY * *count), s, Rgb::INFINITY);
    scatter(groups, b).into_iter().zip(lost).zip(&counts).map(keep).collect()
}

/// Whether the residuals of each group add up to little beside the scatter of the right-hand sides.
fn is_settled(groups: &Groups, r: &[Rgb], scatter: &[Rgb]) -> bool {
    let sums = groups.sums(r.iter().copied());
    sums.iter().zip(scatter).all(|(sum, s)| sum.abs().cmple(ROUGH_SUM * *s).all())
}

fn wide(d: &[[f32; 3]]) -> Vec<Rgb> {
    d.iter().map(|d| Rgb::from(d.map(f64::from))).collect()
}

impl Parts {
    fn new(
        exchange: &Exchange,
        transport: &Transport,
        acceleration: &Acceleration,
        radiosity: &[Rgb],
        sources: &BySource,
        environment: Rgb,
    ) -> Parts {
        let outside = std::f64::consts::PI * environment;
        let white = match acceleration {
            Acceleration::Coarse(_) => None,
            _ => Some(transport.reflect(&vec![Rgb::ONE; radiosity.len()])),
        };
        let batches = exchange.rows.batches();
        let tiled: Option<Vec<Vec<[Rgb; TOGETHER]>>> = exchange.tiles().map(|(tiles, _)| {
            let x = round(radiosity);
            let of = |first: usize| {
                let lane = |_: usize, b: usize| b.checked_sub(first).filter(|m| *m < TOGETHER);
                tiles.multiply_each(&x, lane, |x, _| *x)
            };
            (0..batches).step_by(TOGETHER).map(of).collect()
        });
        let gathered = |k: usize, b: usize, row: &Row| match &tiled {
            Some(tiled) => tiled[b / TOGETHER][k][b % TOGETHER],
            None => row.dot_batch(b, radiosity),
        };
        let of_row = |k: usize, row: &Row, scale: f64| {
            let s = &exchange.rows.summary()[k];
            let sums: Vec<Rgb> = (0..batches).map(|b| exchange.closure(row, b) * scale).collect();
            let mean_sum = sums.iter().sum::<Rgb>() / batches as f64;
            let closed = s.escaped + s.absorbed + s.dropped == Rgb::ZERO;
            let mut parts: Vec<(Rgb, (f64, Rgb))> = (0..batches)
                .map(|b| {
                    let close = match mean_sum.x / sums[b].x {
                        // Rays from covered parts do not count: the others still make the whole.
                        c if c.is_finite() && (closed || c < 1.0) => c,
                        _ => 1.0,
                    };
                    // What meets no element leaves the scene, as far as anything does.
                    let escaped = if s.escaped.x > 0.0 { mean_sum - sums[b] } else { Rgb::ZERO };
                    // A reciprocal exchange is no sum of rows: it is gathered as a whole.
                    let gathered = match exchange.balance() {
                        Some(_) => Rgb::ZERO,
                        None => gathered(k, b, row) * scale * if closed { close } else { 1.0 },
                    };
                    let ones =
                        white.as_ref().map_or(Rgb::ZERO, |white| row.dot_batch(b, white) * (scale * close));
                    (gathered + (sources.own)(k, b) + escaped * outside, (close, ones))
                })
                .collect();
            let mean = parts.iter().map(|p| p.0).sum::<Rgb>() / batches as f64;
            parts.iter_mut().for_each(|p| p.0 -= mean);
            parts
        };
        let (own, (close, ones)) = exchange.map(of_row).into_iter().flatten().unzip();
        Parts { own, close, ones }
    }
}

/// Replicas that share their multiplications: each takes another randomisation of a row.
struct Turn<'a, 'm> {
    exchange: &'a Exchange<'m>,
    transport: &'a Transport,
    acceleration: &'a Acceleration<'a, 'm>,
    parts: &'a Parts,
    /// How many they are.
    count: usize,
    /// Randomisation that a row lends to a replica.
    pick: &'a (dyn Fn(usize, usize) -> usize + Sync),
}

impl Turn<'_, '_> {
    /// `A_m x_m` of each replica that has an x.
    fn apply(&self, xs: [Option<&[Rgb]>; TOGETHER]) -> [Option<Vec<Rgb>>; TOGETHER] {
        let rough = xs.map(|x| x.map(|x| round(&self.transport.reflect(x))));
        if let Some((tiles, scale)) = self.exchange.tiles() {
            let n = scale.len();
            let lanes = |k: usize| std::array::from_fn(|m| rough[m].as_ref().map_or([0.0; 4], |x| x[k]));
            let together: Vec<[[f32; 4]; TOGETHER]> = (0..n).into_par_iter().map(lanes).collect();
            drop(rough);
            let batches = self.exchange.rows.batches();
            let lane = |k: usize, batch: usize| (0..self.count).find(|m| (self.pick)(k, *m) == batch);
            let gathered = tiles.multiply_each::<TOGETHER, _>(&together, lane, |x, m| x[m]);
            return std::array::from_fn(|m| {
                let close = |k: usize| scale[k] * self.parts.close[k * batches + (self.pick)(k, m)];
                let one = |(k, x): (usize, &Rgb)| *x - gathered[k][m] * close(k);
                xs[m].map(|x| x.par_iter().enumerate().with_min_len(MANY).map(one).collect())
            });
        }
        // A replica at a time keeps its radiosities in the cache; but where rays are cast again, once must do for all.
        if self.exchange.rows.kept().is_none() {
            let gathered = self.exchange.map(|k, row, scale| {
                let gathered = |(m, x): (usize, &Option<Vec<_>>)| {
                    x.as_ref().map_or(Rgb::ZERO, |x| self.gather(m, (k, row, scale), x))
                };
                let mut y = [Rgb::ZERO; TOGETHER];
                y.iter_mut().zip(rough.iter().enumerate()).for_each(|(y, x)| *y = gathered(x));
                y
            });
            return std::array::from_fn(|m| {
                xs[m].map(|x| x.iter().zip(&gathered).map(|(x, y)| *x - y[m]).collect())
            });
        }
        std::array::from_fn(|m| {
            let (x, rough) = (xs[m]?, rough[m].as_ref()?);
            Some(self.exchange.map(|k, row, scale| x[k] - self.gather(m, (k, row, scale), rough)))
        })
    }

    /// What a replica's own randomisation of row k gathers.
    #[inline]
    fn gather(&self, m: usize, (k, row, scale): (usize, &Row, f64), x: &[[f32; 4]]) -> Rgb {
        let b = (self.pick)(k, m);
        row.dot_batch_rough(b, x) * (scale * self.parts.close[k * row.batches() + b])
    }

    /// Solves `A_m x_m = b_m` until the residuals have the share [`ROUGH`] of the right-hand sides.
    fn solve(&self, b: Vec<Vec<Rgb>>) -> Vec<Vec<Rgb>> {
        let of = |all: &[Vec<Rgb>]| self.apply(std::array::from_fn(|m| all.get(m).map(|x| &x[..])));
        let norms: Vec<Rgb> = b.iter().map(|b| norm(b)).collect();
        if let Acceleration::Coarse(coarse) = self.acceleration {
            let guess: Vec<Vec<Rgb>> = b.iter().map(|b| coarse.precondition(b)).collect();
            let a_guess = of(&guess);
            let from = |(b, a): (&Vec<Rgb>, Vec<Rgb>)| Krylov::new(vec![Rgb::ZERO; a.len()], subtract(b, &a));
            let mut systems: Vec<Krylov> = b.iter().zip(a_guess.into_iter().flatten()).map(from).collect();
            // A step of Richardson's shrinks the residual as the guess did. Where that is enough, what it becomes need not be known.
            let near: Vec<bool> =
                systems.iter().zip(&norms).map(|(s, norm)| s.relative(*norm) < ROUGH.sqrt()).collect();
            for system in systems.iter_mut().zip(&near).filter(|(_, near)| **near).map(|s| s.0) {
                system.x = system.r.clone();
            }
            self.run(&mut systems, &norms, &[], near.iter().map(|near| !near).collect());
            let moved = |(x, s): (&Vec<Rgb>, &Krylov)| combine(x, Rgb::ONE, &coarse.precondition(&s.x));
            return guess.iter().zip(&systems).map(moved).collect();
        }
        let batches = self.exchange.rows.batches();
        let ones_of = |m: usize| -> Vec<Rgb> {
            let one = |k: usize| Rgb::ONE - self.parts.ones[k * batches + (self.pick)(k, m)];
            (0..b[m].len()).map(one).collect()
        };
        let ones: Vec<Vec<Rgb>> = (0..b.len()).map(ones_of).collect();
        let mut systems: Vec<Krylov> = b
            .iter()
            .zip(of(&b).into_iter().flatten())
            .enumerate()
            .map(|(m, (b, a_b))| Krylov::balanced(b, &a_b, &ones[m]))
            .collect();
        let alive = vec![true; systems.len()];
        let scatters: Vec<Vec<Rgb>> = match self.acceleration {
            Acceleration::Balance(groups) => {
                b.iter().enumerate().map(|(m, b)| scatter_of_lossless(groups, b, &ones[m])).collect()
            }
            _ => Vec::new(),
        };
        self.run(&mut systems, &norms, &scatters, alive);
        // What is left of the residuals is small beside them all, but not beside what the mean light loses at a bounce: balance again.
        systems.into_iter().enumerate().map(|(m, s)| s.balance(&ones[m])).collect()
    }

    /// Improves the systems that are `alive` and further than [`ROUGH`] from `norms`, or by groups than [`ROUGH_SUM`] from
    /// `scatters`; preconditioned where there is a coarse grid.
    fn run(&self, systems: &mut [Krylov], norms: &[Rgb], scatters: &[Vec<Rgb>], mut alive: Vec<bool>) {
        let settled = |m: usize, s: &Krylov| match (self.acceleration, scatters.get(m)) {
            (Acceleration::Balance(groups), Some(scatter)) => is_settled(groups, &s.r, scatter),
            _ => true,
        };
        for _ in 0..MOST_STEPS {
            for (m, s) in systems.iter().enumerate() {
                alive[m] &= s.relative(norms[m]) > ROUGH || !settled(m, s);
            }
            if alive.iter().all(|a| !a) {
                break;
            }
            let multiply = |systems: &[Krylov], alive: &[bool], what: fn(&Krylov) -> &[Rgb]| {
                let x: [Option<Cow<[Rgb]>>; TOGETHER] = std::array::from_fn(|m| {
                    let x = what(systems.get(m).filter(|_| alive[m])?);
                    Some(match self.acceleration {
                        Acceleration::Coarse(coarse) => Cow::Owned(coarse.precondition(x)),
                        _ => Cow::Borrowed(x),
                    })
                });
                self.apply(std::array::from_fn(|m| x[m].as_deref()))
            };
            let v = multiply(systems, &alive, |s| s.direction());
            for (s, v) in systems.iter_mut().zip(v) {
                v.into_iter().for_each(|v| s.first(v));
            }
            let t = multiply(systems, &alive, |s| &s.r);
            for ((s, t), alive) in systems.iter_mut().zip(t).zip(&mut alive) {
                t.into_iter().for_each(|t| *alive &= s.second(&t));
            }
        }
    }
}

/// A random order of `0..batches`, different for each row and turn.
fn shuffle(batches: usize, row: u32, turn: u32) -> impl Iterator<Item = u16> {
    let mut order: Vec<u16> = (0..batches as u16).collect();
    for k in (1..batches).rev() {
        // The remainder's bias is below 1e-8.
        order.swap(k, seed_of(&[row, turn, k as u32, 0x5e]) as usize % (k + 1));
    }
    order.into_iter()
}

/// Calls `found` for an element and its neighbours on the same side of the same face, or of neighbouring faces of
/// the same object where these are single elements.
fn neighbours(scene: &Scene, mesh: &Mesh, element: u32, mut found: impl FnMut(u32)) {
    const AROUND: u32 = 4;
    let (face, front, cell) = mesh.place(element);
    let grid = mesh.grid(face);
    let first = element - cell;
    if !grid.is_triangle() && !grid.is_adaptive() && grid.len() >= 4 {
        let Lattice { nu, nv, .. } = grid.lattice;
        let (iu, iv) = (cell % nu, cell / nu);
        for v in iv.saturating_sub(1)..(iv + 2).min(nv) {
            for u in iu.saturating_sub(1)..(iu + 2).min(nu) {
                found(first + v * nu + u);
            }
        }
        return;
    }
    let object = scene.faces[face as usize].object;
    for k in element.saturating_sub(AROUND)..(element + AROUND + 1).min(mesh.len() as u32) {
        let (other, side, _) = mesh.place(k);
        let f = &scene.faces[other as usize];
        let similar =
            f.object == object && side == front && f.normal.dot(scene.faces[face as usize].normal) > 0.9;
        if k == element || similar {
            found(k);
        }
    }
}
