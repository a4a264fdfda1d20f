//! What a point sees of a polygon past convex bodies.

use super::body::{Body, PlaneSet, View};
use super::ring::{Cover, Planes, Ring, Rings, behind, clip, cover, moment};
use crate::form_factor::analytic::{Polygon, lambert};
use glam::DVec3;
use std::f64::consts::{FRAC_1_PI, PI};

/// Distance, in radii of the polygon, beyond which rules of second degree are within 1e-3 of Lambert's formula.
const SMALL: f64 = 4.0;
/// Distance, in radii of the polygon, beyond which its kernel at the centroid is good enough.
const FAR: f64 = 10.0;
/// Bodies beyond which it pays to ask which of them can hide anything from some of the points.
const FEW_BODIES: usize = 2;
/// Parts that bodies hide, alone or together, beyond which these are cut off instead of added up.
const MOST_PARTS: usize = 3;

/// The polygon that points look at, and the bodies that may hide it.
pub struct Target<'a> {
    polygon: &'a Polygon,
    /// Area [m^2] and centroid.
    moment: (f64, DVec3),
    size: Size,
    bodies: &'a [&'a Body],
    /// Planes of each body that the polygon reaches before.
    reached: Vec<PlaneSet>,
    /// Planes between the polygon and each body, as [`Body::between`] has them; none where bodies are few.
    past: Vec<Vec<(DVec3, DVec3)>>,
}

/// How large a polygon is for its distance.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Size {
    /// The kernel at the centroid stands for all of it.
    Point,
    /// A rule of second degree is within 1e-3 of Lambert's formula.
    Small,
    Large,
}

/// Buffers of a point that looks.
#[derive(Default)]
pub struct Looker {
    /// Bodies that may hide something from where it is.
    active: Vec<usize>,
    /// What these show to the whole cell, or to the point alone where that differs within the cell.
    views: Vec<View>,
    /// Some body hides the polygon from all of the cell.
    covered: bool,
    before: [PlaneSet; 2],
    shadow: Planes,
    /// Parts that bodies hide, alone or together, to be added up with these signs.
    hidden: Rings,
    signs: Vec<f64>,
    /// Parts that are left over.
    pieces: Rings,
    rest: Rings,
    clipped: [Ring; 2],
    out: Ring,
}

impl<'a> Target<'a> {
    /// `polygon` as points of `from`, which faces it, see it.
    pub fn new(polygon: &'a Polygon, from: &Polygon, bodies: &'a [&'a Body]) -> Target<'a> {
        let (ma, mb) = (from.middle(), polygon.middle());
        let size = match (ma.distance(mb) - from.radius(ma)) / polygon.radius(mb) {
            r if r > FAR => Size::Point,
            r if r > SMALL => Size::Small,
            _ => Size::Large,
        };
        let many = bodies.len() > FEW_BODIES;
        Target {
            polygon,
            moment: moment(polygon.corners(), polygon.normal),
            size,
            bodies,
            reached: bodies.iter().map(|body| body.reached(polygon)).collect(),
            past: if many { bodies.iter().map(|body| body.between(polygon)).collect() } else { Vec::new() },
        }
    }

    /// Whether all of a cell sees the polygon past body k.
    fn sees_past(&self, cell: &Polygon, k: usize) -> bool {
        let before = |(o, n): &(DVec3, DVec3)| cell.corners().iter().all(|c| (*c - *o).dot(*n) >= 0.0);
        self.past.get(k).is_some_and(|planes| planes.iter().any(before))
    }
}

impl Looker {
    /// Goes to a cell, where later looks come from.
    pub fn enter(&mut self, cell: &Polygon, target: &Target) {
        self.active.clear();
        self.covered = false;
        for k in (0..target.bodies.len()).filter(|k| !target.sees_past(cell, *k)) {
            let body = target.bodies[k];
            if self.views.len() == self.active.len() {
                self.views.push(View::default());
            }
            let view = &mut self.views[self.active.len()];
            body.common_view(cell, &target.reached[k], &mut self.before, view);
            let cover = match (view.common, view.within, body.is_solid()) {
                (false, ..) => Cover::Part(u64::MAX),
                (true, false, _) => view.narrow(cell.corners(), target.polygon.corners()),
                (true, true, true) => Cover::Whole,
                (true, true, false) => Cover::None,
            };
            match cover {
                Cover::None => {}
                Cover::Whole => {
                    self.covered = true;
                    return;
                }
                Cover::Part(_) => self.active.push(k),
            }
        }
    }

    /// Nothing begins or ends within the cell: what is hidden from its points differs by size alone, as far as single bodies go.
    pub fn is_even(&self) -> bool {
        self.covered || self.active.len() < 2 && self.views[..self.active.len()].iter().all(|v| v.cuts)
    }

    /// Several bodies may hide something from the cell: where their outlines cross within the polygon, views bend.
    pub fn is_crossed(&self) -> bool {
        !self.covered && self.active.len() > 1
    }

    /// Finds the shadow of an active body; false where the point lies within the body.
    #[inline]
    fn find_shadow(&mut self, viewer: DVec3, active: usize, target: &Target) -> bool {
        let view = &mut self.views[active];
        if !view.common {
            let k = self.active[active];
            target.bodies[k].view(viewer, &target.reached[k], &mut self.before[0], view);
        }
        view.shadow(viewer, &mut self.shadow);
        !view.within
    }

    /// Factor from a differential area to what it sees of the polygon, and to the whole polygon.
    pub fn look(&mut self, viewer: DVec3, normal: DVec3, target: &Target) -> (f64, f64) {
        let polygon = target.polygon;
        let point = |area: f64, at: DVec3| area * kernel(viewer, normal, at, polygon.normal) * FRAC_1_PI;
        let whole = match target.size {
            Size::Point => point(target.moment.0, target.moment.1),
            Size::Small => midpoints(viewer, normal, polygon.corners(), polygon.normal),
            Size::Large => lambert(viewer, normal, polygon.corners()),
        };
        if whole <= 0.0 {
            // On the plane of the polygon, where both touch.
            return (0.0, 0.0);
        }
        if self.covered {
            return (0.0, whole);
        }
        self.hidden.clear();
        self.signs.clear();
        for active in 0..self.active.len() {
            if !self.find_shadow(viewer, active, target) {
                if target.bodies[self.active[active]].is_solid() {
                    return (0.0, whole);
                }
                continue;
            }
            let cover = match self.views[active].cuts {
                true => Cover::Part(u64::MAX),
                false => cover(polygon.corners(), &self.shadow),
            };
            match cover {
                Cover::None => {}
                Cover::Whole => return (0.0, whole),
                Cover::Part(crossed) => {
                    let count = self.hidden.len();
                    if count > MOST_PARTS {
                        return self.look_past(viewer, normal, target, whole);
                    }
                    let at = clip(polygon.corners(), &self.shadow, crossed, &mut self.clipped);
                    if self.clipped[at].corners().len() < 3 {
                        continue;
                    }
                    self.hidden.push(self.clipped[at].corners());
                    self.signs.push(1.0);
                    for k in 0..count {
                        let at = clip(self.hidden.get(k), &self.shadow, u64::MAX, &mut self.clipped);
                        if self.clipped[at].corners().len() >= 3 {
                            self.hidden.push(self.clipped[at].corners());
                            self.signs.push(-self.signs[k]);
                        }
                    }
                }
            }
        }
        if self.signs.is_empty() {
            return (whole, whole);
        }
        let hidden = || self.signs.iter().zip(self.hidden.iter());
        let sum =
            |value: &dyn Fn(&[DVec3]) -> f64| hidden().map(|(sign, ring)| sign * value(ring)).sum::<f64>();
        let seen = match target.size {
            Size::Point => {
                let (mut open, mut first) = (target.moment.0, target.moment.0 * target.moment.1);
                for (sign, ring) in hidden() {
                    let (area, centroid) = moment(ring, polygon.normal);
                    open -= sign * area;
                    first -= sign * area * centroid;
                }
                if open <= 0.0 { 0.0 } else { point(open, first / open) }
            }
            Size::Small => {
                let rest = whole - sum(&|ring| midpoints(viewer, normal, ring, polygon.normal));
                if rest > 0.5 * whole {
                    rest
                } else {
                    // The rule's error would be large for the little that is left.
                    lambert(viewer, normal, polygon.corners()) - sum(&|ring| lambert(viewer, normal, ring))
                }
            }
            Size::Large => whole - sum(&|ring| lambert(viewer, normal, ring)),
        };
        (seen.clamp(0.0, whole), whole)
    }

    /// The same, by cutting off one shadow after the other.
    fn look_past(&mut self, viewer: DVec3, normal: DVec3, target: &Target, whole: f64) -> (f64, f64) {
        self.pieces.clear();
        self.pieces.push(target.polygon.corners());
        for active in 0..self.active.len() {
            if !self.find_shadow(viewer, active, target) {
                if target.bodies[self.active[active]].is_solid() {
                    return (0.0, whole);
                }
                continue;
            }
            self.rest.clear();
            for piece in self.pieces.iter() {
                let crossed = match cover(piece, &self.shadow) {
                    Cover::None => {
                        self.rest.push(piece);
                        continue;
                    }
                    Cover::Whole => continue,
                    Cover::Part(crossed) => crossed,
                };
                let first = self.rest.len();
                let [mut from, mut to] = [0, 1];
                self.clipped[from].set(piece);
                for (k, &(point, outward)) in self.shadow.iter().enumerate() {
                    if crossed >> k.min(63) & 1 == 0 {
                        continue;
                    }
                    behind(self.clipped[from].corners(), point, -outward, &mut self.out);
                    let [a, b] = &mut self.clipped;
                    let (source, within) = if from == 0 { (a, b) } else { (b, a) };
                    behind(source.corners(), point, outward, within);
                    if within.corners().len() < 3 {
                        // Nothing is in the shadow: the whole piece stays as it is.
                        self.rest.truncate(first);
                        self.rest.push(piece);
                        break;
                    }
                    if self.out.corners().len() >= 3 {
                        self.rest.push(self.out.corners());
                    }
                    std::mem::swap(&mut from, &mut to);
                }
            }
            std::mem::swap(&mut self.pieces, &mut self.rest);
            if self.pieces.len() == 0 {
                return (0.0, whole);
            }
        }
        let seen: f64 = self.pieces.iter().map(|p| lambert(viewer, normal, p)).sum();
        (seen.clamp(0.0, whole), whole)
    }
}

/// `cos cos' / r^2` between a differential area and a point.
#[inline]
fn kernel(viewer: DVec3, normal: DVec3, at: DVec3, facing: DVec3) -> f64 {
    let d = at - viewer;
    let r2 = d.length_squared();
    -d.dot(normal) * d.dot(facing) / (r2 * r2)
}

/// Form factor from a differential area to a polygon by the edge midpoints of a fan of triangles: exact for kernels of
/// second degree.
fn midpoints(viewer: DVec3, normal: DVec3, corners: &[DVec3], facing: DVec3) -> f64 {
    let kernel = |p: DVec3, q: DVec3| kernel(viewer, normal, 0.5 * (p + q), facing);
    let o = corners[0];
    let (mut sum, mut along) = (0.0, kernel(o, corners[1]));
    for pair in corners[1..].windows(2) {
        let next = kernel(o, pair[1]);
        let area = (pair[0] - o).cross(pair[1] - o).dot(facing);
        sum += area * (along + next + kernel(pair[0], pair[1]));
        along = next;
    }
    sum / (6.0 * PI)
}
