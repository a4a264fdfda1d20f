//! One element against others.

use super::body::Body;
use super::cells::{Accuracy, Cells};
use super::shadow::{Pieces, Seen, Shadow, visible};
use super::shaft::{Shaft, blocks_all};
use super::{BATCHES, Between, MOST_POINTS, PairCounts, Shared};
use crate::embree::ShadowPacket;
use crate::form_factor::analytic::{EXACT, Polygon, exchange_facing, facing};
use crate::form_factor::table::mean_error;
use crate::mesh::Mesh;
use crate::sampling::{seed_of, sobol};
use crate::scene::Scene;
use glam::DVec3;
use std::f64::consts::PI;
use std::ops::Range;

/// Bodies between two elements beyond which points are cheaper than cells.
const MOST_BODIES: usize = 64;
/// Least standard error of integrals over cells, as a share of the factor: 98 % of those of the Cornell box are then within two.
const LEAST: f64 = 1e-4;
/// Faces in a shaft beyond which rays are cheaper than shadows.
const MOST_SHADOWS: usize = 48;
/// Distance, in radii of the polygon, beyond which rules of second degree are within 1e-3 of Lambert's formula.
const SMALL: f64 = 4.0;
/// Least points of a randomisation: the spread of fewer says nothing.
const LEAST_POINTS: usize = 8;

/// Pairs of one element.
pub(super) struct Row {
    /// Exchange areas and their standard errors [m^2].
    pub exchange: Vec<f64>,
    pub error: Vec<f32>,
    pub counts: PairCounts,
    pub rays: u64,
    /// By object of j: exchange area [m^2] and its variance.
    pub objects: Vec<(u32, f64, f64)>,
    /// The j whose pairs are left to hemisphere rays; nothing is in `exchange` for them.
    pub left: Vec<u32>,
}

/// The part of an element that faces the other one of a pair, and the element.
type Side<'a> = (&'a Polygon, usize);

/// What points of all randomisations make known.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Visible and whole kernel of each randomisation.
    seen: [(f64, f64); BATCHES],
    /// Squares of whole kernels.
    squares: f64,
}

/// Buffers of one thread.
#[derive(Default)]
pub(super) struct Scratch {
    shadows: Vec<Shadow>,
    pieces: Pieces,
    packet: ShadowPacket,
    cells: Cells,
    /// Planes between the row's element and each body, found when they are first needed.
    past: Vec<Option<Vec<(DVec3, DVec3)>>>,
}

/// An estimate of one pair.
#[derive(Clone, Copy)]
struct Estimate {
    /// Visible fraction of each randomisation (linearised about the mean).
    fractions: [f64; BATCHES],
    mean: f64,
    /// Variance of the mean.
    variance: f64,
    /// Part of it that the spread of the randomisations does not show.
    unseen: f64,
    missed: bool,
}

impl Shared<'_, '_> {
    /// The pairs of element i with those of a range; none with itself. Where `only` names elements, pairs without any of them
    /// are left at nothing.
    pub(super) fn row(
        &self,
        scratch: &mut Scratch,
        i: usize,
        others: Range<usize>,
        only: Option<&[bool]>,
    ) -> Row {
        let a = &self.elements[i];
        scratch.past.clear();
        scratch.past.resize(self.bodies.len(), None);
        let mut sums = vec![([0.0; BATCHES], 0.0, 0.0); self.objects];
        let mut row = Row {
            exchange: Vec::with_capacity(others.len()),
            error: Vec::with_capacity(others.len()),
            counts: PairCounts::default(),
            rays: 0,
            objects: Vec::new(),
            left: Vec::new(),
        };
        for j in others {
            if only.is_some_and(|only| !only[i] && !only[j]) {
                row.exchange.push(0.0);
                row.error.push(0.0);
                continue;
            }
            let b = &self.elements[j];
            let (by_batch, unseen, certain) = &mut sums[b.object as usize];
            let averted = a.surface == b.surface || self.between(i, j).is_some_and(|between| between.averted);
            let (mut exchange, mut variance, mut met) = (0.0, 0.0, false);
            let crowded = !averted && self.is_crowded(scratch, (i, j));
            if crowded && self.work.rows.is_some() && facing(&a.polygon, &b.polygon).is_some() {
                row.left.push(j as u32);
                row.exchange.push(0.0);
                row.error.push(0.0);
                continue;
            }
            let (of_a, of_b) = (a.parts(), b.parts());
            for (pa, pb) in of_a.iter().flat_map(|pa| of_b.iter().map(move |pb| (pa, pb))) {
                if averted {
                    continue;
                }
                let cut;
                let (pa, pb) = if pb.lies_before(pa) && pa.lies_before(pb) {
                    (pa, pb)
                } else {
                    let Some(parts) = facing(pa, pb) else { continue };
                    cut = parts;
                    (&cut.0, &cut.1)
                };
                met = true;
                let (full, estimate) = self.pair(scratch, (i, j), (pa, pb), crowded, &mut row);
                match estimate {
                    None => *certain += full,
                    Some(e) => {
                        by_batch.iter_mut().zip(e.fractions).for_each(|(s, f)| *s += f * full);
                        *unseen += e.unseen * full * full;
                    }
                }
                exchange += full * estimate.map_or(1.0, |e| e.mean);
                variance += full * full * estimate.map_or(0.0, |e| e.variance);
            }
            row.counts.averted += u64::from(!met);
            row.exchange.push(exchange);
            row.error.push(variance.sqrt() as f32);
        }
        for (object, (batches, unseen, certain)) in sums.into_iter().enumerate() {
            let (mean, error) = mean_error(&batches[..self.work.batches]);
            let mean = mean + certain;
            if mean > 0.0 || unseen > 0.0 {
                row.objects.push((object as u32, mean, error * error + unseen));
            }
        }
        row
    }

    /// Exchange area of a pair whose parts `pa`, `pb` face each other, and the estimate of the visible fraction of it, where
    /// that is not certain.
    fn pair(
        &self,
        scratch: &mut Scratch,
        (i, j): (usize, usize),
        (pa, pb): (&Polygon, &Polygon),
        crowded: bool,
        row: &mut Row,
    ) -> (f64, Option<Estimate>) {
        if self.work.unoccluded {
            row.counts.free += 1;
            return (exchange_facing(pa, pb, self.tolerance()), None);
        }
        if let Some(relative) = self.work.cells.filter(|_| !crowded) {
            return self.by_cells(scratch, (i, j), (pa, pb), relative, row);
        }
        let full = exchange_facing(pa, pb, self.tolerance());
        let mut between: Vec<u32> = Vec::new();
        let candidates = self.between(i, j).map_or(&[][..], |between| &between.surfaces);
        if !candidates.is_empty() {
            let mut shaft = Shaft::new(pa, pb, self.eps);
            between.extend(candidates.iter().filter(|q| shaft.may_block(&self.surfaces[**q as usize])));
        }
        if between.is_empty() {
            row.counts.free += 1;
            return (full, None);
        }
        if between.iter().any(|q| blocks_all(pa, pb, &self.surfaces[*q as usize].polygon))
            || self.bodies.iter().any(|body| body.is_solid() && body.has_any(&between) && body.hides(pa, pb))
        {
            row.counts.hidden += 1;
            return (0.0, None);
        }
        // Points on the smaller part see less change of the other one.
        let sides = if pa.area() <= pb.area() { ((pa, i), (pb, j)) } else { ((pb, j), (pa, i)) };
        let largest = full / self.elements[i].area.min(self.elements[j].area);
        let estimate = if between.len() <= MOST_SHADOWS {
            row.counts.shadows += 1;
            let (from, to) = (sides.0.0, sides.1.0);
            let middle = to.middle();
            let (radius, reach) =
                (to.radius(middle), from.middle().distance(middle) - from.radius(from.middle()));
            let seen = Seen { polygon: to, small: self.tolerance() > EXACT && reach > SMALL * radius };
            self.estimate(largest, |k, out| self.by_shadows(scratch, sides, &seen, &between, k, out))
        } else {
            row.counts.rays += 1;
            let mut rays = 0;
            let estimate = self.estimate(largest, |k, out| {
                rays += self.work.batches as u64;
                self.by_rays(scratch, sides, k, out);
            });
            row.rays += rays;
            estimate
        };
        row.counts.missed += u64::from(estimate.missed);
        (full, Some(estimate))
    }

    /// What may come between the surfaces of two elements, unless everything is ignored.
    fn between(&self, i: usize, j: usize) -> Option<&Between> {
        let (f, g) = (self.elements[i].side as usize, self.elements[j].side as usize);
        self.between.get(f.min(g) * self.sides + f.max(g))
    }

    /// Whether too many bodies for cells may come between two elements.
    fn is_crowded(&self, scratch: &mut Scratch, (i, j): (usize, usize)) -> bool {
        self.work.cells.is_some()
            && self.between(i, j).is_some_and(|between| between.bodies.len() > MOST_BODIES)
            && self.bodies_between(scratch, (i, j), &self.elements[j].polygon).len() > MOST_BODIES
    }

    /// Bodies that may come between element i and a polygon of element j; where they are too many for cells, one more than that.
    fn bodies_between(&self, scratch: &mut Scratch, (i, j): (usize, usize), pb: &Polygon) -> Vec<&Body> {
        let mut between: Vec<&Body> = Vec::new();
        for k in self.between(i, j).map_or(&[][..], |between| &between.bodies) {
            let body = &self.bodies[*k as usize];
            let past =
                scratch.past[*k as usize].get_or_insert_with(|| body.between(&self.elements[i].polygon));
            let before =
                |(o, n): &(DVec3, DVec3)| pb.corners().iter().all(|c| (*c - *o).dot(*n) >= -self.eps);
            if let Some(k) = past.iter().position(before) {
                // What parts this element from the body will part its neighbours.
                past.swap(0, k);
                continue;
            }
            between.push(body);
            if between.len() > MOST_BODIES {
                break;
            }
        }
        between
    }

    /// The same as [`Shared::pair`] from bodies.
    fn by_cells(
        &self,
        scratch: &mut Scratch,
        (i, j): (usize, usize),
        (pa, pb): (&Polygon, &Polygon),
        relative: f64,
        row: &mut Row,
    ) -> (f64, Option<Estimate>) {
        let between = self.bodies_between(scratch, (i, j), pb);
        if between.iter().any(|body| body.hides(pa, pb)) {
            row.counts.hidden += 1;
            return (0.0, None);
        }
        let full = exchange_facing(pa, pb, self.tolerance());
        if between.is_empty() {
            row.counts.free += 1;
            return (full, None);
        }
        row.counts.cells += 1;
        // Points belong where the body is far: there the view changes slowly.
        let distance = |p: &Polygon| {
            let (middle, size) = (p.middle(), p.area().sqrt());
            between.iter().map(|body| body.distance(middle) / size).fold(f64::INFINITY, f64::min)
        };
        let largest = full / self.elements[i].area.min(self.elements[j].area);
        let accuracy = Accuracy { relative, floor: self.work.floor / largest };
        let found = if distance(pa) >= distance(pb) {
            scratch.cells.fraction(pa, pb, &between, accuracy)
        } else {
            scratch.cells.fraction(pb, pa, &between, accuracy)
        };
        let part = found.value > 0.0 && found.value < 1.0;
        let least = if part { LEAST * found.value } else { 0.0 };
        let variance = found.error.max(least).powi(2);
        let missed = self.work.error.is_some()
            && found.error > relative * found.value
            && largest * found.value > self.work.floor;
        row.counts.missed += u64::from(missed);
        let fractions = [found.value; BATCHES];
        (full, Some(Estimate { fractions, mean: found.value, variance, unseen: variance, missed }))
    }

    /// Adds points, one in each randomisation, until there are enough. `see` gives (visible, whole)
    /// kernel of point k of every randomisation; `largest` is the larger of the pair's two factors if all were visible.
    fn estimate(&self, largest: f64, mut see: impl FnMut(usize, &mut [(f64, f64); BATCHES])) -> Estimate {
        let mut sums = Sums::default();
        let batches = self.work.batches;
        let mut values = [(0.0, 0.0); BATCHES];
        let (mut done, mut goal) = (0, (self.work.points as usize).clamp(LEAST_POINTS, MOST_POINTS as usize));
        loop {
            for k in done..goal {
                see(k, &mut values);
                for (s, v) in sums.seen.iter_mut().zip(&values).take(batches) {
                    s.0 += v.0;
                    s.1 += v.1;
                    sums.squares += v.1 * v.1;
                }
            }
            done = goal;
            let mut estimate = Estimate::of(&sums, batches);
            let Some(asked) = self.work.error else { return estimate };
            // A narrow strip that is seen (or hidden) alone can slip between all points, and then their spread is too
            // small: n points find it within about `sqrt(V) / n`, miss 1 / n of it where all see everything, and
            // less where all see nothing, since what is seen there begins at nothing on both elements.
            let points = sums.points();
            let (mean, spread) = (estimate.mean, (estimate.variance - estimate.unseen).max(0.0).sqrt());
            let strip = 1.0 / points * if mean == 1.0 { 1.0 } else { mean.min(1.0 - mean).sqrt() };
            let lost = 0.25 / points;
            // Where no point faces the other part there is nothing to go by.
            let enough = points > 0.0
                && (mean > 0.0 && spread.max(strip) <= asked * mean
                    || largest * (mean + 2.0 * spread + lost) < self.work.floor);
            if enough || done >= MOST_POINTS as usize {
                estimate.missed = !enough;
                return estimate;
            }
            goal = 2 * done;
        }
    }

    /// Point k of a randomisation of a pair: four uniform numbers.
    fn numbers(&self, (i, j): (usize, usize), k: usize, batch: usize) -> [f64; 4] {
        sobol(k as u32, 0, seed_of(&[self.work.seed, i as u32, j as u32, batch as u32, 0x7061]))
    }

    /// What the points of one side see of the other, `seen`, past the faces `between`.
    fn by_shadows(
        &self,
        scratch: &mut Scratch,
        ((from, i), (_, j)): (Side, Side),
        seen: &Seen,
        between: &[u32],
        k: usize,
        out: &mut [(f64, f64); BATCHES],
    ) {
        let Scratch { shadows, pieces, .. } = scratch;
        for (batch, out) in out.iter_mut().enumerate().take(self.work.batches) {
            let x = self.numbers((i, j), k, batch);
            let point = from.point(x[0], x[1]);
            *out = if (point - seen.polygon.corners()[0]).dot(seen.polygon.normal) <= 0.0 {
                (0.0, 0.0)
            } else {
                shadows.clear();
                shadows
                    .extend(between.iter().map(|q| Shadow::new(point, &self.surfaces[*q as usize].polygon)));
                visible(point, from.normal, seen, shadows.iter(), pieces)
            };
        }
    }

    /// The kernel from each point of one side to one of the other, and whether a ray gets there.
    fn by_rays(
        &self,
        scratch: &mut Scratch,
        ((from, i), (to, j)): (Side, Side),
        k: usize,
        out: &mut [(f64, f64); BATCHES],
    ) {
        let area = to.area();
        scratch.packet.clear();
        for (batch, out) in out.iter_mut().enumerate().take(self.work.batches) {
            let x = self.numbers((i, j), k, batch);
            let (point, target) = (from.point(x[0], x[1]), to.point(x[2], x[3]));
            let d = target - point;
            let (cos, cos_there, r2) = (d.dot(from.normal), -d.dot(to.normal), d.length_squared());
            let kernel =
                if cos > 0.0 && cos_there > 0.0 { area * cos * cos_there / (PI * r2 * r2) } else { 0.0 };
            *out = (kernel, kernel);
            if kernel > 0.0 {
                let [start, end] = [i, j].map(|e| self.mesh.place(e as u32).0);
                let start = self.visibility.leave(start, point, from.normal);
                scratch.packet.set(batch, &self.visibility.segment(start, end, target, to.normal));
            }
        }
        let blocked = self.visibility.occluded16(&mut scratch.packet, false);
        for (batch, out) in out.iter_mut().enumerate() {
            if blocked >> batch & 1 == 1 {
                out.0 = 0.0;
            }
        }
    }
}

/// The point of an element for (s, t) uniform in the unit square; uniform in area.
pub(super) fn point_on(scene: &Scene, mesh: &Mesh, element: u32, s: f64, t: f64) -> DVec3 {
    let place = mesh.place_of(scene, element);
    place.at(place.uv(s, t))
}

impl Sums {
    /// How many points of equal kernel would tell as much: one that lies close to the other side outweighs many.
    fn points(&self) -> f64 {
        let whole: f64 = self.seen.iter().map(|s| s.1).sum();
        if whole > 0.0 { whole * whole / self.squares } else { 0.0 }
    }
}

impl Estimate {
    fn of(sums: &Sums, batches: usize) -> Estimate {
        let (seen, whole) = sums.seen.iter().fold((0.0, 0.0), |s, v| (s.0 + v.0, s.1 + v.1));
        if whole == 0.0 {
            // Every point lies behind the other element: nothing is known, and half is off by half at most.
            let (mean, unseen) = (0.5, 0.25);
            let fractions = [mean; BATCHES];
            return Estimate { fractions, mean, variance: unseen, unseen, missed: false };
        }
        let mean = seen / whole;
        let scale = batches as f64 / whole;
        let fractions = sums.seen.map(|(f, f0)| mean + (f - mean * f0) * scale);
        let (_, error) = mean_error(&fractions[..batches]);
        // All points alike: what n points all missed covers less than 3/n of the element (95 %), and hides or shows
        // a third of it on average, since it starts from nothing. Where so few points count that these leave randomisations
        // without any, the spread does not show more either.
        let points = sums.points();
        let alike = seen == 0.0 || seen == whole || points < batches as f64;
        let unseen = if alike { (0.5 / points).powi(2) } else { 0.0 };
        Estimate { fractions, mean, variance: error * error + unseen, unseen, missed: false }
    }
}
