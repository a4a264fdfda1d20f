//! Form factors pair by pair: the exact unoccluded factor times the visible fraction.
//!
//! Three things are certain without sampling: elements that face away from each other or lie in one plane
//! have no factor; where a plane parts every body from both elements, their factor is the
//! unoccluded one; where one convex body cuts every segment, it is zero. Faces that continue each other
//! count as one, and faces that enclose a convex body as that body, unless elements lie on its inside or other faces
//! within it.
//!
//! Where few bodies lie between two elements, `cells` integrates what one element sees of the other. Other pairs take what hemisphere
//! rays found (`left`), or points are spread over one element, and what each sees of the other element is weighted by the kernel:
//!
//! `F = F_0 * sum of f(p) / sum of f_0(p)`,
//!
//! a ratio of sums over the same points, whose bias is of the order of its variance. Where few faces reach into
//! the shaft, `f(p)` is what Lambert's formula gives for the polygon less the shadows of those faces, and so
//! free of noise; where there are many, `f(p)` is the kernel towards one point of the other element, and a ray asks
//! whether that is visible.

mod body;
mod cells;
mod few;
mod left;
mod look;
mod merge;
mod ring;
mod rows;
mod shadow;
mod shaft;

use super::analytic::{EXACT, Polygon};
use super::export::sides;
use super::{ExchangeMatrix, RowSummary};
use crate::color::Rgb;
use crate::mesh::Mesh;
use crate::sampling::{seed_of, sobol};
use crate::scene::Scene;
use crate::visibility::Visibility;
use body::Body;
pub use few::FewPairs;
pub use merge::Surfaces;
use rayon::prelude::*;
use shaft::{Bounded, Shaft};
use std::collections::BTreeSet;

/// Most independent randomisations of the points on each element: 15 degrees of freedom.
pub const BATCHES: usize = 16;
/// Randomisations where many elements share the work: more points in each converge faster.
pub const FEW_BATCHES: usize = 8;

/// Most surfaces (faces, joined where they continue each other) whose shafts are searched: the search takes their
/// number cubed.
pub const MOST_SURFACES: usize = 1024;
/// Most elements whose pairs are held: 100 MB.
pub const MOST_ELEMENTS: usize = 4096;

/// Largest rest of a row that may be an error of its factors whatever these state.
const CLOSED: f64 = 1e-3;
/// Standard errors of a row's sum that its rest may be an error of.
const CLOSED_ERRORS: f64 = 4.0;
/// Rays that meet a gap in the mean: of as many none does but once in 1,000 times.
const RAYS_THAT_MEET: f64 = 7.0;

/// Rays that look for what lies between, all pairs together.
const LOOKS: usize = 1 << 21;

/// How to estimate.
#[derive(Clone, Copy)]
pub struct PairWork<'a> {
    /// Points of each randomisation, a pair; a power of two.
    pub points: u32,
    /// Randomisations, 2 to [`BATCHES`].
    pub batches: usize,
    /// Points are doubled until the standard error is at most this share of the factor.
    pub error: Option<f64>,
    /// Factors below this need not meet `error`.
    pub floor: f64,
    /// Relative error of unoccluded factors, at least 1e-11.
    pub tolerance: f64,
    /// Partly hidden pairs are integrated cell by cell, to this relative error, where few bodies lie between; all by points
    /// where none is given.
    pub cells: Option<f64>,
    /// Hemisphere rays of all elements, which tell of pairs with too many bodies for cells between; these are estimated by points
    /// where there are none.
    pub rows: Option<&'a ExchangeMatrix>,
    /// Ignore what lies between.
    pub unoccluded: bool,
    /// Seed.
    pub seed: u32,
    /// Called with the number of elements finished.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

/// Relative error of integrals over cells where none is asked for.
pub const CELL_ERROR: f64 = 0.01;

/// Most points of one randomisation of a pair.
pub const MOST_POINTS: u32 = 4096;

/// How many pairs of elements (unordered) were found in which way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct PairCounts {
    /// Face away from each other, or lie in one plane.
    pub averted: u64,
    /// Proven free: the factor is the exact unoccluded one.
    pub free: u64,
    /// Proven hidden.
    pub hidden: u64,
    /// Integrated cell by cell.
    pub cells: u64,
    /// Estimated by points that see past the faces between.
    pub shadows: u64,
    /// Estimated by rays from area to area.
    pub rays: u64,
    /// Taken from hemisphere rays.
    pub hemisphere: u64,
    /// Of the estimated ones, those that missed the error asked for.
    pub missed: u64,
}

/// Symmetric exchange areas between all elements.
pub struct PairFactors {
    n: usize,
    /// Area of each element [m^2].
    areas: Vec<f64>,
    /// `A_i F_ij` for i < j, row by row [m^2].
    exchange: Vec<f64>,
    /// Standard errors of these [m^2].
    error: Vec<f32>,
    /// How the pairs were found.
    pub counts: PairCounts,
    /// Rays cast.
    pub rays: u64,
    /// By object pair: exchange area [m^2] and its variance, summed over elements, whose points are independent.
    objects: Vec<(f64, f64)>,
    object_count: usize,
    /// Relative error that was asked of each factor, and the floor that it was asked above.
    asked: Option<(f64, f64)>,
    /// Elements whose rows were found; none: all.
    only: Option<Vec<bool>>,
}

/// Factors whose standard error is larger than asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misses {
    /// How many they are, both directions.
    pub count: usize,
    /// How many factors lie above the floor.
    pub of: usize,
    /// The floor.
    pub floor: f64,
    /// Largest relative standard error and the elements that it is between.
    pub worst: (f64, usize, usize),
}

/// Everything that does not change from pair to pair.
struct Shared<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    work: &'a PairWork<'a>,
    elements: Vec<Element>,
    surfaces: Vec<Bounded>,
    /// Number of the surfaces' sides that may have elements: fronts, then, where any back has elements, backs.
    sides: usize,
    /// What may come between two sides of surfaces, by pair.
    between: Vec<Between>,
    bodies: Vec<Body>,
    eps: f64,
    objects: usize,
}

#[derive(Default)]
struct Between {
    /// The surfaces face away from each other.
    averted: bool,
    /// Surfaces.
    surfaces: Vec<u32>,
    /// The bodies that these belong to.
    bodies: Vec<u32>,
}

struct Element {
    polygon: Polygon,
    /// The parts that no body stands on; none: the whole.
    open: Option<Vec<Polygon>>,
    /// The surface that it is part of, and the side of it.
    surface: u32,
    side: u32,
    object: u32,
    area: f64,
}

impl PairFactors {
    /// Factors between all elements of a mesh.
    pub fn new(visibility: &Visibility, mesh: &Mesh, work: &PairWork) -> PairFactors {
        PairFactors::of_rows(visibility, mesh, work, None)
    }

    /// The same for the rows of those elements alone that `only` names; other factors are not to be read.
    pub fn of_rows(
        visibility: &Visibility,
        mesh: &Mesh,
        work: &PairWork,
        only: Option<&[bool]>,
    ) -> PairFactors {
        let scene = visibility.scene();
        let shared = Shared::new(visibility, scene, mesh, work);
        let n = mesh.len();
        let mut rows: Vec<rows::Row> = (0..n)
            .into_par_iter()
            // Elements at frames and edges take a hundred times as long as others, and lie side by side.
            .with_max_len(1)
            .map_init(rows::Scratch::default, |scratch, i| {
                let row = shared.row(scratch, i, i + 1..n, only);
                (work.progress)(1);
                row
            })
            .collect();
        let left: Vec<Vec<u32>> = rows.iter_mut().map(|row| std::mem::take(&mut row.left)).collect();
        let m = shared.objects;
        let mut all = PairFactors {
            n,
            areas: (0..n as u32).map(|e| mesh.area(e)).collect(),
            exchange: Vec::with_capacity(n * n.saturating_sub(1) / 2),
            error: Vec::with_capacity(n * n.saturating_sub(1) / 2),
            counts: PairCounts::default(),
            rays: 0,
            objects: vec![(0.0, 0.0); m * m],
            object_count: m,
            asked: work.error.map(|error| (error, work.floor)),
            only: only.map(<[bool]>::to_vec),
        };
        for (i, row) in rows.into_iter().enumerate() {
            all.exchange.extend_from_slice(&row.exchange);
            all.error.extend_from_slice(&row.error);
            all.rays += row.rays;
            all.counts.add(&row.counts);
            let a = shared.elements[i].object as usize;
            row.objects
                .iter()
                .for_each(|&(b, mean, variance)| all.add_objects((a, b as usize), mean, variance));
        }
        if let Some(matrix) = work.rows {
            all.take_left(&shared, &left, matrix);
        }
        all
    }

    /// Adds to the exchange area between two objects, and to its variance.
    fn add_objects(&mut self, (a, b): (usize, usize), mean: f64, variance: f64) {
        let m = self.object_count;
        // Both directions of a pair within one object are the same number twice.
        let (mean, variance) = if a == b { (2.0 * mean, 4.0 * variance) } else { (mean, variance) };
        for k in &[a * m + b, b * m + a][..if a == b { 1 } else { 2 }] {
            self.objects[*k].0 += mean;
            self.objects[*k].1 += variance;
        }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.n
    }

    /// No elements.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// Factors that are not zero, both directions.
    pub fn stored(&self) -> usize {
        2 * self.exchange.iter().filter(|g| **g > 0.0).count()
    }

    /// Bytes that the factors occupy.
    pub fn bytes(&self) -> usize {
        self.exchange.len() * size_of::<f64>() + self.error.len() * size_of::<f32>()
    }

    fn index(&self, i: usize, j: usize) -> Option<usize> {
        let (i, j) = (i.min(j), i.max(j));
        (i != j).then(|| i * (2 * self.n - i - 1) / 2 + j - i - 1)
    }

    /// Factor from element i to element j, and its standard error; dimensionless.
    pub fn factor(&self, i: usize, j: usize) -> (f64, f64) {
        self.index(i, j).map_or((0.0, 0.0), |k| {
            (self.exchange[k] / self.areas[i], f64::from(self.error[k]) / self.areas[i])
        })
    }

    /// The factors of row i that are not zero.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        (0..self.n).map(move |j| (j, self.factor(i, j).0)).filter(|(_, f)| *f > 0.0)
    }

    /// What the factors of row i leave of 1, shared between escaped and absorbed as the hemisphere rays of `rows` were;
    /// all escaped without these, and where these met no gap although more is left than the factors may be off by, and
    /// not so much that the rays would have met it.
    pub fn rest(&self, i: usize, rows: Option<&ExchangeMatrix>) -> RowSummary {
        let row = rows.and_then(|rows| rows.summary.get(i));
        let rest = (1.0 - self.row(i).map(|(_, f)| f).sum::<f64>()).max(0.0);
        let mut found = RowSummary { exposed: 1.0, ..row.copied().unwrap_or_default() };
        if row.is_none() {
            found.escaped = Rgb::ONE;
        }
        let lost = found.escaped.x + found.absorbed.x;
        if lost > 0.0 {
            found.escaped *= rest / lost;
            found.absorbed *= rest / lost;
        } else if rest > CLOSED
            && rest > CLOSED_ERRORS * self.row_error(i)
            && rows.is_none_or(|rows| rest * f64::from(rows.rays_per_row) < RAYS_THAT_MEET)
        {
            // Too few rays to meet the gap.
            found.escaped = Rgb::splat(rest);
        }
        found
    }

    /// Standard error of the sum of row i.
    fn row_error(&self, i: usize) -> f64 {
        (0..self.n).map(|j| self.factor(i, j).1.powi(2)).sum::<f64>().sqrt()
    }

    /// Largest departure of a row from closure: factors and the rest that hemisphere rays found sum to 1.
    pub fn closure_residual(&self, rows: Option<&ExchangeMatrix>) -> f64 {
        let residual = |i: usize| {
            let rest = self.rest(i, rows);
            let sum: f64 = self.row(i).map(|(_, f)| f).sum();
            (sum + rest.escaped.x + rest.absorbed.x - 1.0).abs()
        };
        let found = |i: &usize| self.only.as_ref().is_none_or(|only| only[*i]);
        (0..self.n).filter(found).map(residual).fold(0.0, f64::max)
    }

    /// Pairs of objects between which rays are blocked although their factor is not zero, and the number of rays that
    /// looked: one from each element of a pair of objects to each of the other, or several where these are few.
    pub fn blocked_objects(&self, visibility: &Visibility, mesh: &Mesh, seed: u32) -> (Vec<(u32, u32)>, u64) {
        let scene = visibility.scene();
        let object = |e: usize| scene.faces[mesh.place(e as u32).0 as usize].object;
        let each = (LOOKS / (self.n * self.n).max(1)).clamp(1, 256) as u32;
        let look = |i: usize| {
            let (mut found, mut rays) = (BTreeSet::new(), 0);
            for j in (i + 1..self.n).filter(|j| self.factor(i, *j).0 > 0.0) {
                let pair = (object(i).min(object(j)), object(i).max(object(j)));
                for k in 0..each {
                    if found.contains(&pair) {
                        break;
                    }
                    let x = sobol(k, 0, seed_of(&[seed, i as u32, j as u32]));
                    let p = rows::point_on(scene, mesh, i as u32, x[0], x[1]);
                    let q = rows::point_on(scene, mesh, j as u32, x[2], x[3]);
                    let (np, nq) = (mesh.normal(scene, i as u32), mesh.normal(scene, j as u32));
                    if (q - p).dot(np) > 0.0 && (p - q).dot(nq) > 0.0 {
                        rays += 1;
                        let [from, to] = [i, j].map(|e| mesh.place(e as u32).0);
                        let ray = visibility.segment(visibility.leave(from, p, np), to, q, nq);
                        if !visibility.unoccluded(&ray) {
                            found.insert(pair);
                        }
                    }
                }
            }
            (found, rays)
        };
        let join = |mut a: (BTreeSet<_>, u64), b: (BTreeSet<_>, u64)| {
            a.0.extend(b.0);
            (a.0, a.1 + b.1)
        };
        let (found, rays) = (0..self.n).into_par_iter().map(look).reduce(Default::default, join);
        (found.into_iter().collect(), rays)
    }

    /// Largest relative standard error of a factor above `floor`.
    pub fn largest_error(&self, floor: f64) -> f64 {
        let mut worst = 0.0f64;
        for i in 0..self.n {
            for j in i + 1..self.n {
                let (f, e) = self.factor(
                    if self.areas[i] < self.areas[j] { i } else { j },
                    if self.areas[i] < self.areas[j] { j } else { i },
                );
                if f > floor {
                    worst = worst.max(e / f);
                }
            }
        }
        worst
    }

    /// Whether an error was asked of each factor.
    pub fn is_asked(&self) -> bool {
        self.asked.is_some()
    }

    /// The factors that miss the error asked for; none where all meet it or nothing was asked of them.
    pub fn misses(&self) -> Option<Misses> {
        let (asked, floor) = self.asked?;
        // Errors are kept in f32.
        let most = asked * (1.0 + f64::from(f32::EPSILON));
        let mut misses = Misses { count: 0, of: 0, floor, worst: (0.0, 0, 0) };
        for i in 0..self.n {
            for j in (0..self.n).filter(|j| *j != i) {
                let (f, e) = self.factor(i, j);
                if f <= floor {
                    continue;
                }
                misses.of += 1;
                misses.count += usize::from(e > most * f);
                if e > misses.worst.0 * f {
                    misses.worst = (e / f, i, j);
                }
            }
        }
        (misses.count > 0).then_some(misses)
    }

    /// Exchange area between objects a and b [m^2] and its standard error.
    pub fn between_objects(&self, a: usize, b: usize) -> (f64, f64) {
        let (exchange, variance) = self.objects[a * self.object_count + b];
        (exchange, variance.sqrt())
    }
}

impl PairCounts {
    fn add(&mut self, other: &PairCounts) {
        self.averted += other.averted;
        self.free += other.free;
        self.hidden += other.hidden;
        self.cells += other.cells;
        self.shadows += other.shadows;
        self.rays += other.rays;
        self.hemisphere += other.hemisphere;
        self.missed += other.missed;
    }
}

impl Element {
    /// Cuts off what bodies stand on.
    fn find_open(&mut self, bodies: &[Body]) {
        let mut open = vec![self.polygon];
        for body in bodies {
            let parts = std::mem::take(&mut open);
            parts.iter().for_each(|part| body.uncovered(part, &mut open));
        }
        let whole = matches!(open.as_slice(), [part] if part.corners() == self.polygon.corners());
        self.open = (!whole).then_some(open);
    }

    /// What no body stands on.
    fn parts(&self) -> &[Polygon] {
        self.open.as_deref().unwrap_or(std::slice::from_ref(&self.polygon))
    }
}

impl<'a, 's> Shared<'a, 's> {
    fn new(
        visibility: &'a Visibility<'s>,
        scene: &Scene,
        mesh: &'a Mesh,
        work: &'a PairWork<'a>,
    ) -> Shared<'a, 's> {
        let surfaces = Surfaces::new(scene);
        let (n, sides) = (surfaces.polygons.len() as u32, sides(scene, mesh));
        let element = |e: u32| {
            let (face, front, _) = mesh.place(e);
            let surface = surfaces.of_face[face as usize];
            Element {
                polygon: Polygon::of_element(scene, mesh, e),
                open: None,
                surface,
                side: surface + if front { 0 } else { n },
                object: sides.of_element[e as usize],
                area: mesh.area(e),
            }
        };
        let mut shared = Shared {
            visibility,
            mesh,
            work,
            elements: (0..mesh.len() as u32).map(element).collect(),
            between: Vec::new(),
            bodies: Vec::new(),
            eps: surfaces.eps,
            objects: sides.names.len(),
            sides: surfaces.polygons.len() * if mesh.has_backs() { 2 } else { 1 },
            surfaces: surfaces.polygons.iter().copied().map(Bounded::new).collect(),
        };
        if !work.unoccluded {
            // The insides of a body see each other through what is solid from outside.
            shared.bodies = if mesh.has_backs() { Body::singles(&surfaces) } else { Body::all(&surfaces) };
            shared.between = shared.all_between();
            if work.cells.is_some() {
                let bodies = &shared.bodies;
                shared.elements.iter_mut().for_each(|e| e.find_open(bodies));
            }
        }
        shared
    }

    fn all_between(&self) -> Vec<Between> {
        let n = self.surfaces.len();
        let side = |k: usize| {
            let polygon = self.surfaces[k % n].polygon;
            if k < n { polygon } else { polygon.turned() }
        };
        let mut body_of = vec![0; n];
        for (k, body) in self.bodies.iter().enumerate() {
            body.surfaces().for_each(|f| body_of[f as usize] = k as u32);
        }
        let list = |k: usize| {
            let (i, j) = (k / self.sides, k % self.sides);
            let mut found = Between::default();
            if i < j && i % n != j % n {
                let (a, b) = (&side(i), &side(j));
                let Some((a, b)) = super::analytic::facing(a, b) else {
                    // Elements of joined surfaces may lie off their plane a little.
                    let [ab, ba] = [(a, b), (b, a)]
                        .map(|(p, q)| p.reaches_before(q.corners()[0], q.normal, 2.0 * self.eps));
                    found.averted = !(ab && ba);
                    return found;
                };
                let mut shaft = Shaft::new(&a, &b, self.eps);
                let others = (0..n).filter(|q| *q != i % n && *q != j % n);
                found
                    .surfaces
                    .extend(others.filter(|q| shaft.may_block(&self.surfaces[*q])).map(|q| q as u32));
                found.bodies = found.surfaces.iter().map(|q| body_of[*q as usize]).collect();
                found.bodies.sort_unstable();
                found.bodies.dedup();
            }
            found
        };
        (0..self.sides * self.sides).into_par_iter().with_min_len(64).map(list).collect()
    }

    /// Relative error that unoccluded factors are found to.
    fn tolerance(&self) -> f64 {
        self.work.tolerance.max(EXACT)
    }
}
