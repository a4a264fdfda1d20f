//! Form factors by rows, kept in memory or cast again each time they are needed.

use super::gathered::EmitterRows;
use super::matrix::{ExchangeMatrix, RowSummary};
use super::raycast::{BLOCK, Caster, Casting};
use super::rows::{Block, Row};
use crate::color::Rgb;
use crate::mesh::Mesh;
use crate::scene::Scene;
use crate::visibility::Visibility;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// Rows that one task visits: as many as are cast together, so that sums are the same to the bit from a matrix.
const TASK: usize = BLOCK;

/// Form factors without a matrix: every visit of the rows casts their rays again, the same to the bit.
pub struct Recast<'a> {
    caster: Caster<'a, 'a>,
    summary: Vec<RowSummary>,
    rays: AtomicU64,
}

impl<'a> Recast<'a> {
    /// Casts all rows once, for what becomes of their rays and the irradiance from emitters.
    pub fn new(
        visibility: &'a Visibility<'a>,
        mesh: &'a Mesh,
        casting: &Casting<'a>,
    ) -> (Recast<'a>, EmitterRows) {
        let mut caster = Caster::new(visibility, mesh, casting);
        let (summary, light, rays) = caster.survey();
        caster.repeat_quietly();
        (Recast { caster, summary, rays: AtomicU64::new(rays) }, light)
    }

    /// Rays cast so far, chains included.
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }
}

/// Form factors by rows.
#[derive(Clone, Copy)]
pub enum Rows<'a> {
    /// From a matrix in memory.
    Kept(&'a ExchangeMatrix),
    /// Cast again at each visit.
    Cast(&'a Recast<'a>),
}

impl<'a> From<&'a ExchangeMatrix> for Rows<'a> {
    fn from(matrix: &'a ExchangeMatrix) -> Rows<'a> {
        Rows::Kept(matrix)
    }
}

impl<'a> Rows<'a> {
    /// What became of the rays of each row that landed on no element.
    pub fn summary(&self) -> &'a [RowSummary] {
        match self {
            Rows::Kept(matrix) => &matrix.summary,
            Rows::Cast(recast) => &recast.summary,
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.summary().len()
    }

    /// No rows.
    pub fn is_empty(&self) -> bool {
        self.summary().is_empty()
    }

    /// The matrix that holds the rows: visits cast no rays.
    pub fn kept(&self) -> Option<&'a ExchangeMatrix> {
        match self {
            Rows::Kept(matrix) => Some(matrix),
            Rows::Cast(_) => None,
        }
    }

    /// Independent randomisations of each row.
    pub fn batches(&self) -> usize {
        match self {
            Rows::Kept(matrix) => matrix.batches(),
            Rows::Cast(recast) => recast.caster.batches(),
        }
    }

    /// Rays of each row.
    pub fn rays_per_row(&self) -> u32 {
        match self {
            Rows::Kept(matrix) => matrix.rays_per_row,
            Rows::Cast(recast) => recast.caster.rays_per_row(),
        }
    }

    /// Visits all rows on all cores, one value a row.
    pub fn map<T: Send>(&self, f: impl Fn(usize, &Row) -> T + Sync) -> Vec<T> {
        if let Rows::Kept(matrix) = self {
            let rows = (0..self.len()).into_par_iter().with_min_len(TASK);
            return rows.map(|k| f(k, &matrix.at(k))).collect();
        }
        let parts = self.tasks(|run| run.range().map(|k| f(k, &run.row(k))).collect::<Vec<T>>());
        let mut all = Vec::with_capacity(self.len());
        parts.into_iter().for_each(|part| all.extend(part));
        all
    }

    /// Visits the rows in runs on all cores, one value a run, in order.
    fn tasks<T: Send>(&self, f: impl Fn(&Run) -> T + Sync) -> Vec<T> {
        match self {
            Rows::Kept(matrix) => (0..self.len().div_ceil(TASK))
                .into_par_iter()
                .map(|t| f(&Run::Kept(matrix, t * TASK..((t + 1) * TASK).min(self.len()))))
                .collect(),
            Rows::Cast(recast) => {
                let caster = &recast.caster;
                let (done, rays) = caster.visit(|range, block| f(&Run::Cast(caster, block, range)));
                recast.rays.fetch_add(rays, Ordering::Relaxed);
                done
            }
        }
    }

    /// Closure and reciprocity in one visit; `keep` is the share that the surface of each element passes on specularly
    /// (a ray that goes on is counted at every diffuse surface on its way).
    pub fn check(&self, scene: &Scene, mesh: &Mesh, keep: impl Fn(u32) -> Rgb + Sync) -> Check {
        let n = self.len() as u32;
        let object: Vec<u32> = (0..n).map(|e| scene.faces[mesh.place(e).0 as usize].object).collect();
        let taken: Vec<Rgb> = (0..n).map(|e| Rgb::ONE - keep(e)).collect();
        let taken = taken.iter().any(|t| *t != Rgb::ONE).then_some(taken);
        let summary = self.summary();
        let parts = self.tasks(|run| {
            let mut exchange = FxHashMap::<(u32, u32), f64>::default();
            let visit = |k: usize| {
                let area = mesh.area(k as u32) * summary[k].exposed * summary[k].index2;
                let (mut sum, mut last, mut run_of_last) = (Rgb::ZERO, object[k], 0.0);
                for (j, f) in run.row(k).entries() {
                    sum += taken.as_ref().map_or(f, |taken| f * taken[j]);
                    // Rays that follow each other mostly meet one object.
                    if object[j] != last {
                        *exchange.entry((object[k], last)).or_default() += run_of_last;
                        (last, run_of_last) = (object[j], 0.0);
                    }
                    run_of_last += area * f.x;
                }
                *exchange.entry((object[k], last)).or_default() += run_of_last;
                sum
            };
            let sums: Vec<Rgb> = run.range().map(visit).collect();
            let mut exchange: Vec<_> = exchange.into_iter().collect();
            exchange.sort_unstable_by_key(|e| e.0);
            (sums, exchange)
        });
        let mut sums = Vec::with_capacity(self.len());
        let mut exchange = FxHashMap::<(u32, u32), f64>::default();
        for (part, pairs) in parts {
            sums.extend(part);
            pairs.into_iter().for_each(|(pair, g)| *exchange.entry(pair).or_default() += g);
        }
        let closure = sums
            .iter()
            .zip(summary)
            .filter(|(_, s)| s.exposed > 0.0)
            .map(|(sum, s)| (*sum + s.escaped + s.absorbed + s.dropped - Rgb::ONE).abs().max_element())
            .fold(0.0, f64::max);
        Check { sums, taken, closure, reciprocity: asymmetry(exchange) }
    }
}

/// `sum |G_ab - G_ba| / sum (G_ab + G_ba)` over pairs of different objects.
fn asymmetry(exchange: FxHashMap<(u32, u32), f64>) -> f64 {
    let mut pairs: Vec<_> = exchange.iter().filter(|((a, b), _)| a != b).collect();
    pairs.sort_unstable_by_key(|p| p.0);
    let (mut difference, mut sum) = (0.0, 0.0);
    for (&(a, b), ab) in pairs {
        match exchange.get(&(b, a)) {
            // Counted once, from its lower side.
            Some(_) if a > b => {}
            other => {
                let ba = other.copied().unwrap_or(0.0);
                difference += (ab - ba).abs();
                sum += ab + ba;
            }
        }
    }
    if sum > 0.0 { difference / sum } else { 0.0 }
}

/// Consecutive rows.
enum Run<'x> {
    Kept(&'x ExchangeMatrix, Range<usize>),
    Cast(&'x Caster<'x, 'x>, &'x Block, Range<usize>),
}

impl Run<'_> {
    fn range(&self) -> Range<usize> {
        match self {
            Run::Kept(_, range) | Run::Cast(_, _, range) => range.clone(),
        }
    }

    fn row(&self, k: usize) -> Row<'_> {
        match self {
            Run::Kept(matrix, _) => matrix.at(k),
            Run::Cast(caster, block, range) => {
                block.row(k - range.start, caster.batches(), caster.channels())
            }
        }
    }
}

/// How well factors close, and how reciprocal they are.
pub struct Check {
    /// `sum over j of F_ij taken_j` of each row, `taken_j` what the surface of j does not pass on specularly.
    pub sums: Vec<Rgb>,
    /// That share by element; none where no surface passes on anything.
    pub taken: Option<Vec<Rgb>>,
    /// Largest departure of a row from closure: factors to opaque diffuse surfaces, escaped,
    /// absorbed and dropped shares sum to 1.
    pub closure: f64,
    /// Departure from reciprocity between objects: `sum |G_ab - G_ba| / sum (G_ab + G_ba)` of the exchange
    /// areas `G_ab = sum of A_i n_i^2 F_ij` [m^2], i on object a and j on b.
    pub reciprocity: f64,
}
