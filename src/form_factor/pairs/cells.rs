//! The visible fraction of a pair, integrated cell by cell.
//!
//! From one point, the part of a polygon that a convex body hides is a convex polygon, and its factor is known exactly. As the point
//! moves, that factor is smooth until an edge of the body passes a corner of the polygon: the planes through these
//! (critical surfaces of edge and vertex; Heckbert, "Discontinuity meshing for radiosity", 1992) cut the point's
//! element into cells, and in each of them a rule of low degree is accurate. Cells end where the polygon comes into sight, so
//! a pair that barely sees each other is found as accurately as any other.
//!
//! Planes through a corner of the body and an edge of the polygon, and those in which a side of the body turns away, cut
//! too. Kinks are left where two bodies' edges cross and where edges that are cut off by others would meet. Two rules of
//! second degree with different points tell how far both are off; they can agree by chance, so the doubt that they state
//! is no bound (measured: 4 factors in 100,000 of the Cornell box are off by more than the 1 % that was asked for, 1.5 % at most).

use super::body::Body;
use super::ring::{Cover, Planes, Ring, clip, cover};
use crate::form_factor::analytic::{Cut, Polygon, lambert};
use glam::{DVec2, DVec3};
use std::f64::consts::PI;

/// Most cells of a pair before these are halved for accuracy.
const MOST_CELLS: usize = 48;
/// Share of a cell's extent below which a plane does not cut it.
const SLIVER: f64 = 1e-4;
/// Distance, in radii of the polygon, beyond which rules of second degree are within 1e-3 of Lambert's formula.
const SMALL: f64 = 4.0;
/// Distance, in radii of the polygon, beyond which its kernel at the centroid is good enough.
const FAR: f64 = 10.0;
/// Largest radius of a cell as a share of the distance to the polygon.
const NEAR: f64 = 0.25;
/// Share of a range of views that counts as doubt where these begin or end within a cell: measured, against a converged
/// run of the Cornell box.
const MIXED: f64 = 0.01;
/// Share of the difference of two rules that counts as doubt in the better one: measured likewise.
const DOUBT: f64 = 0.5;
/// Times that cells in doubt are halved both ways.
const ROUNDS: usize = 5;

/// Buffers.
#[derive(Default)]
pub struct Cells {
    cells: Vec<Cell>,
    next: Vec<Cell>,
    planes: Vec<DVec3>,
    shadow: Planes,
    pieces: Vec<Ring>,
    rest: Vec<Ring>,
    /// The part of the polygon that a body hides, another one, and what both hide; each in one of two rings.
    hidden: [[Ring; 2]; 3],
}

#[derive(Clone, Copy)]
struct Cell {
    polygon: Polygon,
    value: Option<Value>,
}

/// Integrals over a cell.
#[derive(Clone, Copy)]
struct Value {
    seen: f64,
    whole: f64,
    /// Differences of two rules in both.
    off: (f64, f64),
    /// Where some points see nothing or all of the polygon, and others not: the range of what they see, as a share of
    /// what there is to be seen.
    mixed: f64,
}

/// A visible share of an unoccluded factor.
#[derive(Debug, Clone, Copy)]
pub struct Fraction {
    /// The share.
    pub value: f64,
    /// What the differences of two rules leave of doubt.
    pub error: f64,
}

/// How accurate a fraction must be.
#[derive(Debug, Clone, Copy)]
pub struct Accuracy {
    /// Error as a share of the fraction.
    pub relative: f64,
    /// Fraction below which the error counts as a share of this one.
    pub floor: f64,
}

/// The polygon that points look at.
struct Target<'a> {
    polygon: &'a Polygon,
    /// Area [m^2] and centroid.
    moment: (f64, DVec3),
    size: Size,
    /// Planes of each body that the polygon reaches before.
    reached: Vec<u64>,
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

impl Cells {
    /// The fraction of the exchange between `a` and `b`, which face each other, that these bodies leave.
    /// Points lie on `a`, which should be the one farther from the bodies.
    pub fn fraction(&mut self, a: &Polygon, b: &Polygon, bodies: &[&Body], accuracy: Accuracy) -> Fraction {
        let (ma, mb) = (a.middle(), b.middle());
        let distance = ma.distance(mb);
        self.split(a, b, bodies);
        self.halve(mb);
        let ring = Ring::of(b.corners());
        let radii = (distance - a.radius(ma)) / b.radius(mb);
        let size = match radii {
            r if r > FAR => Size::Point,
            r if r > SMALL => Size::Small,
            _ => Size::Large,
        };
        let reached = bodies.iter().map(|body| body.reached(b)).collect();
        let target = Target { polygon: b, moment: ring.moment(b.normal), size, reached };
        for round in 0.. {
            let mut cells = std::mem::take(&mut self.cells);
            let (mut seen, mut whole) = (0.0, 0.0);
            for cell in &mut cells {
                let polygon = &cell.polygon;
                let value = cell.value.get_or_insert_with(|| self.value(polygon, &target, bodies));
                seen += value.seen;
                whole += value.whole;
            }
            self.cells = cells;
            if whole <= 0.0 {
                break;
            }
            let share = (seen / whole).clamp(0.0, 1.0);
            let doubt = |v: &Value| DOUBT * (v.off.0 - share * v.off.1).abs() + MIXED * v.whole * v.mixed;
            let sum: f64 = self.cells.iter().filter_map(|c| c.value.as_ref()).map(doubt).sum();
            let found = Fraction { value: share, error: sum / whole };
            let allowed = accuracy.relative * found.value.max(accuracy.floor);
            if found.error <= allowed || round == ROUNDS {
                return found;
            }
            // Halve those that make up the doubt.
            let most = 0.5 * allowed * whole / self.cells.len() as f64;
            self.next.clear();
            for cell in &self.cells {
                if cell.value.as_ref().is_none_or(|v| doubt(v) <= most) {
                    self.next.push(*cell);
                } else {
                    let halves = cell.polygon.halves().into_iter().flatten();
                    let quarters = halves.flat_map(|half| half.halves()).flatten();
                    self.next.extend(quarters.map(|polygon| Cell { polygon, value: None }));
                }
            }
            std::mem::swap(&mut self.cells, &mut self.next);
        }
        Fraction { value: 0.0, error: 0.0 }
    }

    /// Integrals over a cell, by rules of second degree on a fan of triangles.
    fn value(&mut self, cell: &Polygon, target: &Target, bodies: &[&Body]) -> Value {
        let c = cell.corners();
        let (mut low, mut high) = (1.0f64, 0.0f64);
        let mut look = |point: DVec3| {
            let (seen, whole) = self.look(point, cell.normal, target, bodies);
            if whole > 0.0 {
                low = low.min(seen / whole);
                high = high.max(seen / whole);
            }
            DVec2::new(seen, whole)
        };
        let (mut inner, mut edges) = (DVec2::ZERO, DVec2::ZERO);
        // Neighbours in the fan share an edge.
        let mut along = look(0.5 * (c[0] + c[1]));
        for j in 1..c.len() - 1 {
            let corners = [c[0], c[j], c[j + 1]];
            let third = (corners[1] - c[0]).cross(corners[2] - c[0]).dot(cell.normal) / 6.0;
            let sum: DVec3 = corners.iter().sum();
            inner += third * corners.iter().map(|p| look(0.5 * p + sum / 6.0)).sum::<DVec2>();
            let next = look(0.5 * (c[0] + c[j + 1]));
            edges += third * (along + next + look(0.5 * (c[j] + c[j + 1])));
            along = next;
        }
        let mixed = if low == 0.0 || high == 1.0 { (high - low).max(0.0) } else { 0.0 };
        // Of any third degree, the rule of the edges misses -9 times as much as the inner one.
        let both = 0.9 * inner + 0.1 * edges;
        let off = inner - edges;
        Value { seen: both.x, whole: both.y, off: (off.x, off.y), mixed }
    }

    /// Cuts polygon `a` where an edge of a body passes a corner of `b`.
    fn split(&mut self, a: &Polygon, b: &Polygon, bodies: &[&Body]) {
        self.cells.clear();
        self.cells.push(Cell { polygon: *a, value: None });
        for body in bodies {
            for &corner in b.corners() {
                self.planes.clear();
                body.outline(corner, |p, q| {
                    let normal = p.cross(q);
                    if crosses(a, corner, normal) && spans(a, corner, [p, q], normal) {
                        self.planes.push(normal);
                    }
                });
                for k in 0..self.planes.len() {
                    self.cut(corner, self.planes[k]);
                }
            }
            for &corner in body.corners() {
                for (from, to) in b.edges() {
                    let (p, q) = (corner - from, corner - to);
                    let normal = p.cross(q);
                    if crosses(a, corner, normal) && spans(a, corner, [p, q], normal) {
                        self.cut(corner, normal);
                    }
                }
            }
            // Where a side of the body turns away, its outline goes on along another edge.
            for &(point, normal) in body.sides() {
                if crosses(a, point, normal) && crosses(b, point, normal) {
                    self.cut(point, normal);
                }
            }
        }
    }

    /// Cuts the cells that a plane crosses.
    fn cut(&mut self, point: DVec3, normal: DVec3) {
        if self.cells.len() >= MOST_CELLS {
            return;
        }
        for k in 0..self.cells.len() {
            let polygon = &self.cells[k].polygon;
            if !crosses(polygon, point, normal) {
                continue;
            }
            // Where one side is empty after all, the other is the whole cell.
            if let (Cut::Part(first), Cut::Part(second)) =
                (polygon.before(point, normal), polygon.before(point, -normal))
            {
                self.cells[k].polygon = first;
                self.cells.push(Cell { polygon: second, value: None });
            }
        }
    }

    /// Halves cells that are large for their distance.
    fn halve(&mut self, target: DVec3) {
        let mut k = 0;
        while k < self.cells.len() {
            let polygon = self.cells[k].polygon;
            let middle = polygon.middle();
            if self.cells.len() < 2 * MOST_CELLS && polygon.radius(middle) > NEAR * middle.distance(target) {
                self.cells.swap_remove(k);
                let halves = polygon.halves().into_iter().flatten();
                self.cells.extend(halves.map(|polygon| Cell { polygon, value: None }));
            } else {
                k += 1;
            }
        }
    }

    /// Factor from a differential area to what it sees of the polygon, and to the whole polygon.
    fn look(&mut self, viewer: DVec3, normal: DVec3, target: &Target, bodies: &[&Body]) -> (f64, f64) {
        let polygon = target.polygon;
        let point = |area: f64, at: DVec3| area * kernel(viewer, normal, at, polygon.normal) / PI;
        let whole = match target.size {
            Size::Point => point(target.moment.0, target.moment.1),
            Size::Small => midpoints(viewer, normal, polygon.corners(), polygon.normal),
            Size::Large => lambert(viewer, normal, polygon.corners()),
        };
        if whole <= 0.0 {
            // On the plane of the polygon, where both touch.
            return (0.0, 0.0);
        }
        let (mut count, mut at) = (0, [0; 3]);
        for (body, reached) in bodies.iter().zip(&target.reached) {
            if !body.shadow(viewer, *reached, &mut self.shadow) {
                if body.is_solid() {
                    return (0.0, whole);
                }
                continue;
            }
            match cover(polygon, &self.shadow) {
                Cover::None => {}
                Cover::Whole => return (0.0, whole),
                Cover::Part(_) if count == 2 => {
                    return self.look_past(viewer, normal, target, bodies, whole);
                }
                Cover::Part(crossed) => {
                    at[count] = clip(polygon.corners(), &self.shadow, crossed, &mut self.hidden[count]);
                    if self.hidden[count][at[count]].len < 3 {
                        continue;
                    }
                    if count == 1 {
                        let [first, _, common] = &mut self.hidden;
                        at[2] = clip(first[at[0]].corners(), &self.shadow, u64::MAX, common);
                    }
                    count += 1;
                }
            }
        }
        if count == 0 {
            return (whole, whole);
        }
        // What two bodies hide, each and both.
        let [first, second, common] = [0, 1, 2].map(|k| &self.hidden[k][at[k]]);
        let signed = [(1.0, first), (1.0, second), (-1.0, common)];
        let hidden = match count {
            1 => &signed[..1],
            _ if common.len < 3 => &signed[..2],
            _ => &signed[..],
        };
        let sum =
            |value: &dyn Fn(&Ring) -> f64| hidden.iter().map(|(sign, ring)| sign * value(ring)).sum::<f64>();
        let seen = match target.size {
            Size::Point => {
                let (mut open, mut moment) = (target.moment.0, target.moment.0 * target.moment.1);
                for (sign, ring) in hidden {
                    let (area, centroid) = ring.moment(polygon.normal);
                    open -= sign * area;
                    moment -= sign * area * centroid;
                }
                if open <= 0.0 { 0.0 } else { point(open, moment / open) }
            }
            Size::Small => {
                let rest = whole - sum(&|ring| midpoints(viewer, normal, ring.corners(), polygon.normal));
                if rest > 0.5 * whole {
                    rest
                } else {
                    // The rule's error would be large for the little that is left.
                    lambert(viewer, normal, polygon.corners()) - sum(&|ring| ring.lambert(viewer, normal))
                }
            }
            Size::Large => whole - sum(&|ring| ring.lambert(viewer, normal)),
        };
        (seen.clamp(0.0, whole), whole)
    }

    /// The same, by cutting off one shadow after the other.
    fn look_past(
        &mut self,
        viewer: DVec3,
        normal: DVec3,
        target: &Target,
        bodies: &[&Body],
        whole: f64,
    ) -> (f64, f64) {
        self.pieces.clear();
        self.pieces.push(Ring::of(target.polygon.corners()));
        for (body, reached) in bodies.iter().zip(&target.reached) {
            if !body.shadow(viewer, *reached, &mut self.shadow) {
                if body.is_solid() {
                    return (0.0, whole);
                }
                continue;
            }
            self.rest.clear();
            for piece in &self.pieces {
                let first = self.rest.len();
                let mut rest = *piece;
                for &(point, outward) in &self.shadow {
                    let (mut out, mut within) = (Ring::default(), Ring::default());
                    rest.behind(point, -outward, &mut out);
                    rest.behind(point, outward, &mut within);
                    if within.len < 3 {
                        // Nothing is in the shadow: the whole piece stays as it is.
                        self.rest.truncate(first);
                        self.rest.push(*piece);
                        break;
                    }
                    if out.len >= 3 {
                        self.rest.push(out);
                    }
                    rest = within;
                }
            }
            std::mem::swap(&mut self.pieces, &mut self.rest);
        }
        let seen: f64 = self.pieces.iter().map(|p| p.lambert(viewer, normal)).sum();
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

/// Whether a plane leaves a good share of a polygon on either side.
fn crosses(polygon: &Polygon, point: DVec3, normal: DVec3) -> bool {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for c in polygon.corners() {
        let d = (*c - point).dot(normal);
        low = low.min(d);
        high = high.max(d);
    }
    let least = SLIVER * (high - low);
    low < -least && high > least
}

/// Whether the part of a polygon's cut by a plane that is seen from `viewer` between the directions `ends` is not empty.
/// The plane goes through `viewer` and `ends`; `normal` is their cross product.
fn spans(polygon: &Polygon, viewer: DVec3, ends: [DVec3; 2], normal: DVec3) -> bool {
    // In the plane, what lies between the directions is on the inner side of both.
    let inward = [normal.cross(ends[0]), ends[1].cross(normal)];
    let (mut first, mut second) = (false, false);
    let corners = polygon.corners();
    let mut from = corners[corners.len() - 1] - viewer;
    let mut d = from.dot(normal);
    for corner in corners {
        let to = *corner - viewer;
        let e = to.dot(normal);
        if (d > 0.0) != (e > 0.0) {
            let crossing = from + d / (d - e) * (to - from);
            first |= crossing.dot(inward[0]) > 0.0;
            second |= crossing.dot(inward[1]) > 0.0;
        }
        (from, d) = (to, e);
    }
    first && second
}
