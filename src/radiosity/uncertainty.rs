//! Standard errors of a solution, with all that errors of the factors do on their way.
//!
//! Every row has a few independent randomisations ([`ExchangeMatrix::batches`]). A replica of the system takes one of
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
//! [`ExchangeMatrix::batches`]: crate::form_factor::ExchangeMatrix::batches

use super::Transport;
use super::exchange::{Exchange, residual_operator};
use super::solve::solve_roughly;
use crate::color::Rgb;
use crate::mesh::Mesh;
use crate::sampling::seed_of;
use crate::scene::Scene;
use rayon::prelude::*;
use serde::Serialize;

/// Replicas of the system.
const REPLICAS: usize = 16;
/// Relative residual of a replica's solve.
const ROUGH: f64 = 0.05;

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
    /// Area that has elements [m^2].
    pub area: f64,
    /// Area-weighted mean, emission included [W m^-2].
    pub radiosity: Rgb,
    /// Its standard error [W m^-2].
    pub standard_error: Rgb,
}

/// Light straight from the sources, by row and randomisation.
pub(super) struct BySource<'a> {
    /// Errors independent from row to row.
    pub own: &'a (dyn Fn(usize, usize) -> Rgb + Sync),
    /// Particles, which all rows share.
    pub particles: &'a (dyn Fn(usize, usize) -> Rgb + Sync),
}

/// Differences of the replicas' irradiances from the solution's [W m^-2]; empty with one randomisation.
pub(super) struct Replicas {
    differences: Vec<Vec<Rgb>>,
    /// Variance of the mean over the mean square of the differences.
    scale: f64,
}

impl Replicas {
    pub fn new(
        exchange: &Exchange,
        transport: &Transport,
        irradiance: &[Rgb],
        sources: &BySource,
        environment: Rgb,
    ) -> Replicas {
        let matrix = exchange.matrix();
        let (n, batches) = (matrix.len(), matrix.batches());
        if batches < 2 {
            return Replicas { differences: Vec::new(), scale: f64::NAN };
        }
        let radiosity = transport.reflect(irradiance);
        let ones = vec![Rgb::ONE; n];
        let outside = std::f64::consts::PI * environment;
        // By row and randomisation: what it gathers less the mean, and the share that makes it close.
        let rows: Vec<(Vec<Rgb>, Vec<f64>)> = (0..n)
            .into_par_iter()
            .with_min_len(64)
            .map(|row| {
                let s = &matrix.summary[row];
                let sums = exchange.row_by_batch(row, &ones);
                let mean_sum = sums.iter().sum::<Rgb>() / batches as f64;
                let closed = s.escaped + s.absorbed + s.dropped == Rgb::ZERO;
                let close: Vec<f64> = sums
                    .iter()
                    .map(|sum| match mean_sum.x / sum.x {
                        // Rays from covered parts do not count: the others still make the whole.
                        c if c.is_finite() && (closed || c < 1.0) => c,
                        _ => 1.0,
                    })
                    .collect();
                let estimates: Vec<Rgb> = exchange
                    .row_by_batch(row, &radiosity)
                    .iter()
                    .enumerate()
                    .map(|(b, e)| {
                        // What meets no element leaves the scene, as far as anything does.
                        let escaped = if s.escaped.x > 0.0 { mean_sum - sums[b] } else { Rgb::ZERO };
                        *e * if closed { close[b] } else { 1.0 } + (sources.own)(row, b) + escaped * outside
                    })
                    .collect();
                let mean = estimates.iter().sum::<Rgb>() / batches as f64;
                (estimates.iter().map(|e| *e - mean).collect(), close)
            })
            .collect();
        let shared_mean: Vec<Rgb> = (0..n)
            .map(|row| (0..batches).map(|b| (sources.particles)(row, b)).sum::<Rgb>() / batches as f64)
            .collect();
        // Whole turns through the randomisations, so that each serves equally often.
        let replicas = REPLICAS.div_ceil(batches) * batches;
        let common = Shuffle::new(replicas, batches, u32::MAX);
        let orders: Vec<Shuffle> = (0..n as u32).map(|row| Shuffle::new(replicas, batches, row)).collect();
        let differences = (0..replicas)
            .map(|m| {
                let pick = |row: usize| orders[row].0[m] as usize;
                let b: Vec<Rgb> = (0..n)
                    .map(|row| {
                        rows[row].0[pick(row)] + (sources.particles)(row, common.0[m] as usize)
                            - shared_mean[row]
                    })
                    .collect();
                let gather = |x: &[Rgb]| {
                    let mut y = exchange.gather_batch(pick, x);
                    y.iter_mut().enumerate().for_each(|(row, y)| *y *= rows[row].1[pick(row)]);
                    y
                };
                solve_roughly(|h| residual_operator(gather, transport, h), &b, ROUGH)
            })
            .collect();
        Replicas { differences, scale: 1.0 / ((batches - 1) * replicas) as f64 }
    }

    /// Standard error of a linear function of the irradiances; NaN with one randomisation.
    pub fn of(&self, f: impl Fn(&[Rgb]) -> Rgb) -> Rgb {
        let squares: Rgb = self
            .differences
            .iter()
            .map(|d| {
                let y = f(d);
                y * y
            })
            .sum();
        (squares * self.scale).map(f64::sqrt)
    }

    /// Standard error of every element's radiosity [W m^-2].
    pub fn by_element(&self, scene: &Scene, mesh: &Mesh, transport: &Transport) -> Vec<Rgb> {
        let mut variance = vec![Rgb::ZERO; mesh.len()];
        for d in &self.differences {
            for (v, r) in variance.iter_mut().zip(transport.reflect(d)) {
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
                neighbours(scene, mesh, e, |k| {
                    sum += variance[k as usize];
                    count += 1.0;
                });
                (sum / count).map(f64::sqrt)
            })
            .collect()
    }

    /// Means over each side of each object that has elements.
    pub fn by_object(
        &self,
        scene: &Scene,
        mesh: &Mesh,
        transport: &Transport,
        radiosity: &[Rgb],
    ) -> Vec<ObjectRadiosity> {
        let reflected: Vec<Vec<Rgb>> = self.differences.iter().map(|d| transport.reflect(d)).collect();
        let mut sums = std::collections::BTreeMap::<(u32, bool), (f64, Rgb, Vec<Rgb>)>::new();
        for e in 0..mesh.len() as u32 {
            let (face, front, _) = mesh.place(e);
            let object = scene.faces[face as usize].object;
            let sum = sums
                .entry((object, !front))
                .or_insert_with(|| (0.0, Rgb::ZERO, vec![Rgb::ZERO; reflected.len()]));
            let (area, e) = (mesh.area(e), e as usize);
            sum.0 += area;
            sum.1 += area * radiosity[e];
            sum.2.iter_mut().zip(&reflected).for_each(|(s, r)| *s += area * r[e]);
        }
        sums.into_iter()
            .map(|((object, back), (area, radiosity, differences))| {
                let variance =
                    differences.iter().map(|d| (*d / area) * (*d / area)).sum::<Rgb>() * self.scale;
                ObjectRadiosity {
                    object,
                    name: scene.objects[object as usize].clone(),
                    front: !back,
                    area,
                    radiosity: radiosity / area,
                    standard_error: variance.map(f64::sqrt),
                }
            })
            .collect()
    }
}

/// A random order of `replicas / batches` copies of each of `0..batches`.
struct Shuffle(Vec<u16>);

impl Shuffle {
    fn new(replicas: usize, batches: usize, row: u32) -> Shuffle {
        let mut order: Vec<u16> = (0..replicas).map(|m| (m % batches) as u16).collect();
        for k in (1..replicas).rev() {
            // The remainder's bias is below 1e-8.
            order.swap(k, seed_of(&[row, k as u32, 0x5e]) as usize % (k + 1));
        }
        Shuffle(order)
    }
}

/// Calls `found` for an element and its neighbours on the same side of the same face, or of neighbouring faces of
/// the same object where these are single elements.
fn neighbours(scene: &Scene, mesh: &Mesh, element: u32, mut found: impl FnMut(u32)) {
    const AROUND: u32 = 4;
    let (face, front, cell) = mesh.place(element);
    let grid = mesh.grid(face);
    let first = element - cell;
    if !grid.triangle && grid.len() >= 4 {
        let (iu, iv) = (cell % grid.nu, cell / grid.nu);
        for v in iv.saturating_sub(1)..(iv + 2).min(grid.nv) {
            for u in iu.saturating_sub(1)..(iu + 2).min(grid.nu) {
                found(first + v * grid.nu + u);
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
