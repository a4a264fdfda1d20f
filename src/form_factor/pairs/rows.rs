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
/// Points of a randomisation whose shadows are kept for the other pairs of the row.
const KEPT: usize = 16;

/// Pairs of one element.
pub(super) struct Row {
    /// Exchange areas and their standard errors [m^2].
    pub exchange: Vec<f64>,
    pub error: Vec<f32>,
    pub counts: PairCounts,
    pub rays: u64,
    /// By object of j: exchange area [m^2] and its variance.
    pub objects: Vec<(u32, f64, f64)>,
}

/// One point on the row's element: its place and the direction that a ray takes on the other.
#[derive(Clone, Copy)]
struct Sample {
    point: DVec3,
    /// Uniform numbers that choose a point of the other element.
    other: [f64; 2],
}

/// Buffers of one thread.
#[derive(Default)]
pub(super) struct Scratch {
    /// `samples[k * batches + batch]`.
    samples: Vec<Sample>,
    /// Shadows of a face from the first samples.
    shadows: Vec<Vec<Shadow>>,
    fresh: Vec<Shadow>,
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
        scratch.samples.clear();
        scratch.shadows.iter_mut().for_each(Vec::clear);
        scratch.shadows.resize(self.surfaces.len(), Vec::new());
        scratch.past.clear();
        scratch.past.resize(self.bodies.len(), None);
        let mut sums = vec![([0.0; BATCHES], 0.0, 0.0); self.objects];
        let mut row = Row {
            exchange: Vec::with_capacity(others.len()),
            error: Vec::with_capacity(others.len()),
            counts: PairCounts::default(),
            rays: 0,
            objects: Vec::new(),
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
            // Points lie all over elements: to them, what a body stands on is hidden like the rest of what it hides.
            let partly = a.open.is_some() || b.open.is_some();
            let by_points = partly && self.bodies_between(scratch, (i, j), &b.polygon).is_none();
            let (of_a, of_b) = (a.parts(by_points), b.parts(by_points));
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
                let (full, estimate) = self.pair(scratch, (i, j), (pa, pb), &mut row);
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
        row: &mut Row,
    ) -> (f64, Option<Estimate>) {
        if self.work.unoccluded {
            row.counts.free += 1;
            return (exchange_facing(pa, pb, self.tolerance()), None);
        }
        if let Some(relative) = self.work.cells {
            if let Some(found) = self.by_cells(scratch, (i, j), (pa, pb), relative, row) {
                return found;
            }
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
        let estimate = if between.len() <= MOST_SHADOWS {
            row.counts.shadows += 1;
            let middle = pb.middle();
            let (radius, reach) = (pb.radius(middle), pa.middle().distance(middle) - pa.radius(pa.middle()));
            let seen = Seen { polygon: pb, small: self.tolerance() > EXACT && reach > SMALL * radius };
            self.estimate(scratch, i, (i, j), full, |scratch, k, out| {
                self.by_shadows(scratch, i, &seen, &between, k, out);
            })
        } else {
            row.counts.rays += 1;
            let mut rays = 0;
            let estimate = self.estimate(scratch, i, (i, j), full, |scratch, k, out| {
                rays += self.work.batches as u64;
                self.by_rays(scratch, (i, j), k, out);
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

    /// Bodies that may come between element i and a polygon of element j; none where they are too many for cells.
    fn bodies_between(
        &self,
        scratch: &mut Scratch,
        (i, j): (usize, usize),
        pb: &Polygon,
    ) -> Option<Vec<&Body>> {
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
            if between.len() == MOST_BODIES {
                return None;
            }
            between.push(body);
        }
        Some(between)
    }

    /// The same as [`Shared::pair`] from bodies; none where too many of them lie between.
    fn by_cells(
        &self,
        scratch: &mut Scratch,
        (i, j): (usize, usize),
        (pa, pb): (&Polygon, &Polygon),
        relative: f64,
        row: &mut Row,
    ) -> Option<(f64, Option<Estimate>)> {
        let between = self.bodies_between(scratch, (i, j), pb)?;
        if between.iter().any(|body| body.hides(pa, pb)) {
            row.counts.hidden += 1;
            return Some((0.0, None));
        }
        let full = exchange_facing(pa, pb, self.tolerance());
        if between.is_empty() {
            row.counts.free += 1;
            return Some((full, None));
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
        Some((full, Some(Estimate { fractions, mean: found.value, variance, unseen: variance, missed })))
    }

    /// Adds points, one in each randomisation, until there are enough. `see` gives (visible, whole)
    /// kernel of sample k of every randomisation.
    fn estimate(
        &self,
        scratch: &mut Scratch,
        i: usize,
        (a, b): (usize, usize),
        full: f64,
        mut see: impl FnMut(&mut Scratch, usize, &mut [(f64, f64); BATCHES]),
    ) -> Estimate {
        let mut sums = [(0.0, 0.0); BATCHES];
        let batches = self.work.batches;
        let mut values = [(0.0, 0.0); BATCHES];
        // Of an element in many pieces much is covered, and more points must tell what is not.
        let pieces = (self.elements[a].pieces() * self.elements[b].pieces()).next_power_of_two();
        let (mut done, mut goal) = (0, (self.work.points.max(1) as usize * pieces).min(MOST_POINTS as usize));
        let largest = full / self.elements[a].area.min(self.elements[b].area);
        loop {
            self.extend(scratch, i, goal);
            for k in done..goal {
                see(scratch, k, &mut values);
                for (s, v) in sums.iter_mut().zip(&values).take(batches) {
                    s.0 += v.0;
                    s.1 += v.1;
                }
            }
            done = goal;
            let mut estimate = Estimate::of(&sums, self.work.batches, done * self.work.batches);
            let Some(asked) = self.work.error else { return estimate };
            // A narrow strip that is seen (or hidden) alone can slip between all points, and then their spread is too
            // small: n points find it within about `sqrt(V) / n`, miss 1 / n of it where all see everything, and
            // less where all see nothing, since what is seen there begins at nothing on both elements.
            let points = (done * batches) as f64;
            let (mean, spread) = (estimate.mean, (estimate.variance - estimate.unseen).max(0.0).sqrt());
            let strip = 1.0 / points * if mean == 1.0 { 1.0 } else { mean.min(1.0 - mean).sqrt() };
            let lost = 0.25 / points;
            let enough = mean > 0.0 && spread.max(strip) <= asked * mean
                || largest * (mean + 2.0 * spread + lost) < self.work.floor;
            if enough || done >= MOST_POINTS as usize {
                estimate.missed = !enough;
                return estimate;
            }
            goal = 2 * done;
        }
    }

    /// Makes sure that the first `count` points of each randomisation exist.
    fn extend(&self, scratch: &mut Scratch, i: usize, count: usize) {
        let scene = self.visibility.scene();
        for k in scratch.samples.len() / self.work.batches..count {
            for batch in 0..self.work.batches {
                let x = sobol(k as u32, 0, seed_of(&[self.work.seed, i as u32, batch as u32, 0x7061]));
                let point = point_on(scene, self.mesh, i as u32, x[0], x[1]);
                scratch.samples.push(Sample { point, other: [x[2], x[3]] });
            }
        }
    }

    /// What the points see of polygon `b` past the faces `between`.
    fn by_shadows(
        &self,
        scratch: &mut Scratch,
        i: usize,
        seen: &Seen,
        between: &[u32],
        k: usize,
        out: &mut [(f64, f64); BATCHES],
    ) {
        let Scratch { samples, shadows, fresh, pieces, .. } = scratch;
        let (normal, batches) = (self.elements[i].polygon.normal, self.work.batches);
        if k < KEPT {
            for q in between {
                let (kept, face) = (&mut shadows[*q as usize], &self.surfaces[*q as usize].polygon);
                let new = samples[..(k + 1) * batches].iter().skip(kept.len());
                kept.extend(new.map(|s| Shadow::new(s.point, face)));
            }
        }
        for (batch, out) in out.iter_mut().enumerate().take(batches) {
            let at = k * batches + batch;
            let point = samples[at].point;
            *out = if (point - seen.polygon.corners()[0]).dot(seen.polygon.normal) <= 0.0 {
                (0.0, 0.0)
            } else if k < KEPT {
                visible(point, normal, seen, between.iter().map(|q| &shadows[*q as usize][at]), pieces)
            } else {
                fresh.clear();
                fresh.extend(between.iter().map(|q| Shadow::new(point, &self.surfaces[*q as usize].polygon)));
                visible(point, normal, seen, fresh.iter(), pieces)
            };
        }
    }

    /// The kernel from each point to one of element j, and whether a ray gets there.
    fn by_rays(
        &self,
        scratch: &mut Scratch,
        (i, j): (usize, usize),
        k: usize,
        out: &mut [(f64, f64); BATCHES],
    ) {
        let scene = self.visibility.scene();
        let (na, nb) = (self.elements[i].polygon.normal, self.elements[j].polygon.normal);
        scratch.packet.clear();
        for (batch, out) in out.iter_mut().enumerate().take(self.work.batches) {
            let Sample { point, other } = scratch.samples[k * self.work.batches + batch];
            let target = point_on(scene, self.mesh, j as u32, other[0], other[1]);
            let d = target - point;
            let (cos, cos_there, r2) = (d.dot(na), -d.dot(nb), d.length_squared());
            let kernel = if cos > 0.0 && cos_there > 0.0 {
                self.elements[j].area * cos * cos_there / (PI * r2 * r2)
            } else {
                0.0
            };
            *out = (kernel, kernel);
            if kernel > 0.0 {
                let [from, to] = [i, j].map(|e| self.mesh.place(e as u32).0);
                let ray = self.visibility.segment(self.visibility.leave(from, point, na), to, target, nb);
                scratch.packet.set(batch, &ray);
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

impl Estimate {
    fn of(sums: &[(f64, f64); BATCHES], batches: usize, points: usize) -> Estimate {
        let (seen, whole) = sums.iter().fold((0.0, 0.0), |s, v| (s.0 + v.0, s.1 + v.1));
        if whole == 0.0 {
            // Every point lies behind the other element: nothing is known but that it is small.
            let unseen = 1.0;
            return Estimate {
                fractions: [0.0; BATCHES],
                mean: 0.0,
                variance: unseen,
                unseen,
                missed: false,
            };
        }
        let mean = seen / whole;
        let scale = batches as f64 / whole;
        let fractions = sums.map(|(f, f0)| mean + (f - mean * f0) * scale);
        let (_, error) = mean_error(&fractions[..batches]);
        // All points alike: what n points all missed covers less than 3/n of the element (95 %), and hides or shows
        // a third of it on average, since it starts from nothing.
        let unseen = if seen == 0.0 || seen == whole { (0.5 / points as f64).powi(2) } else { 0.0 };
        Estimate { fractions, mean, variance: error * error + unseen, unseen, missed: false }
    }
}
