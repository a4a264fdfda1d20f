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
//! is no bound. Where they differ by too much, cells are first halved both ways, to look between the points, and then the
//! worst one time after time, across the direction in which the view changes most: from the side of a frame that stands two
//! centimetres under a ceiling, the view opens within a millimetre along a metre of edge. Where outlines of several bodies may
//! cross, views can bend between all points and a corner of a cell; there corners look too, wherever that could matter.
//! Measured, of factors above 1e-6 that were asked for to 1 %: none of 140,130 of the Cornell box on 532 elements is off by more
//! than 0.8 %, where without the corners' looks twelve were by more than 1 % (1.7 % at most), for up to a twelfth more time.

use super::body::{Body, PlaneSet};
use super::look::{Looker, Target};
use crate::form_factor::analytic::{Cut, MOST_CORNERS, Polygon};
use glam::{DVec2, DVec3};
use std::collections::BinaryHeap;

/// Most cells of a pair before these are halved for accuracy.
const MOST_CELLS: usize = 48;
/// As many for each body between, over the relative error that is allowed. Measured on concentric spheres, the Cornell box and the
/// gallery, against converged runs: as many factors miss what is asked as with all cells.
const CUTS: f64 = 0.16;
/// And not fewer than this.
const FEW_CELLS: usize = 8;
/// Most cells of a pair.
const MOST_HALVED: usize = 4096;
/// Most times that cells are refined for a share that has changed meanwhile.
const ROUNDS: usize = 4;
/// Share of a cell's extent below which a plane does not cut it.
const SLIVER: f64 = 1e-4;
/// Largest radius of a cell as a share of the distance to the polygon.
const NEAR: f64 = 0.25;
/// Share of a range of views that counts as doubt where these may begin or end within a cell: measured, against converged runs
/// of the Cornell box and of the gallery.
const MIXED: f64 = 0.015;
/// Multiple of the difference of two rules that counts as doubt in the better one: measured likewise.
const DOUBT: f64 = 1.5;
/// Share of what halving a cell changed that counts as doubt in either half, at least: measured likewise.
const MOVED: f64 = 0.25;
/// Share of how far a corner's view is from what points within let expect there that counts as doubt. A view that bends just
/// beyond the point next to a triangle's corner, a third of the way to the middle of the opposite edge, differs over a ninth of
/// the triangle's area, and by a third of the difference at the corner on average.
const BENT: f64 = 1.0 / 27.0;

/// Buffers.
#[derive(Default)]
pub struct Cells {
    cells: Vec<Cell>,
    /// Cells beyond which no plane cuts any.
    most_cells: usize,
    planes: Vec<DVec3>,
    before: PlaneSet,
    /// Doubt in cells (bits of a number that is not negative) and their places.
    worst: BinaryHeap<(u64, usize)>,
    looker: Looker,
    /// Most that any point sees, as a share of what there is to be seen.
    most: f64,
    /// Points of a cell and what they see.
    seen: Vec<(DVec3, f64)>,
}

#[derive(Clone, Copy)]
struct Cell {
    polygon: Polygon,
    value: Value,
    /// How far this half and the other one together moved what their whole saw.
    moved: f64,
}

/// Integrals over a cell.
#[derive(Clone, Copy, Default)]
struct Value {
    seen: f64,
    whole: f64,
    /// Differences of two rules in both.
    off: (f64, f64),
    /// Where some points see nothing or all of the polygon, and others not: the range of what they see, as a share of
    /// what there is to be seen.
    mixed: f64,
    /// In the cell's plane, the direction in which what is seen changes most.
    across: DVec3,
    /// Outlines of several bodies may cross, where views bend.
    crossed: bool,
    /// What the points let expect of each corner's view, as a share likewise.
    ends: [f32; MOST_CORNERS],
    /// Largest difference of a corner's view from that, where corners looked.
    bent: f64,
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

impl Accuracy {
    /// Error of a fraction.
    fn allowed(&self, fraction: f64) -> f64 {
        self.relative * fraction.max(self.floor)
    }
}

impl Cell {
    fn of(polygon: Polygon) -> Cell {
        Cell { polygon, value: Value::default(), moved: 0.0 }
    }

    /// How far off what is seen may be, where `share` of the whole is.
    fn doubt(&self, share: f64) -> f64 {
        let v = &self.value;
        let own = DOUBT * (v.off.0 - share * v.off.1).abs() + MIXED * v.whole * v.mixed;
        own.max(MOVED * self.moved).max(BENT * v.whole * v.bent)
    }
}

impl Cells {
    /// The fraction of the exchange between `a` and `b`, which face each other, that these bodies leave.
    /// Points lie on `a`, which should be the one farther from the bodies.
    pub fn fraction(&mut self, a: &Polygon, b: &Polygon, bodies: &[&Body], accuracy: Accuracy) -> Fraction {
        let each = (CUTS / accuracy.relative) as usize;
        self.most_cells = (bodies.len() * each.clamp(FEW_CELLS, MOST_CELLS)).min(MOST_CELLS);
        self.split(a, b, bodies);
        self.halve(b.middle());
        let target = Target::new(b, a, bodies);
        self.most = 0.0;
        for k in 0..self.cells.len() {
            let polygon = self.cells[k].polygon;
            self.cells[k].value = self.value(&polygon, &target);
        }
        let found = self.sum();
        let count = self.cells.len();
        let least = 0.5 * accuracy.allowed(found.value) * self.total().1 / count as f64;
        for k in 0..count {
            let mut cell = self.cells[k];
            if self.may_hide_a_bend(&cell, found.value, least) {
                self.looker.enter(&cell.polygon, &target);
                self.look_from_corners(&mut cell, &target);
                self.cells[k].value.bent = cell.value.bent;
            }
        }
        let found = self.sum();
        if found.error <= accuracy.allowed(found.value) {
            return found;
        }
        self.quarter(&target, found.value, least);
        // Doubts are added up for the share that was known first, and may be a little more for the last one.
        for _ in 0..ROUNDS {
            self.refine(&target, accuracy, least);
            let found = self.sum();
            if found.error <= accuracy.allowed(found.value) {
                return found;
            }
        }
        self.sum()
    }

    /// What all cells see together.
    fn sum(&self) -> Fraction {
        let (seen, whole) = self.total();
        if whole <= 0.0 {
            return Fraction { value: 0.0, error: 0.0 };
        }
        let value = (seen / whole).clamp(0.0, 1.0);
        Fraction { value, error: self.cells.iter().map(|cell| cell.doubt(value)).sum::<f64>() / whole }
    }

    fn total(&self) -> (f64, f64) {
        let add = |sum: (f64, f64), cell: &Cell| (sum.0 + cell.value.seen, sum.1 + cell.value.whole);
        self.cells.iter().fold((0.0, 0.0), add)
    }

    /// Halves cells in doubt both ways: where some are in doubt, rules agree in others by chance.
    fn quarter(&mut self, target: &Target, share: f64, least: f64) {
        for k in 0..self.cells.len() {
            let cell = self.cells[k];
            if cell.doubt(share) <= least {
                continue;
            }
            let halves = cell.polygon.halves().into_iter().flatten();
            let mut place = k;
            for polygon in halves.flat_map(|half| half.halves()).flatten() {
                let quarter = self.cell(&polygon, target, share, least);
                self.put(place, quarter);
                place = self.cells.len();
            }
        }
    }

    /// A part of a cell in doubt, which looks from its corners where that can matter.
    fn cell(&mut self, polygon: &Polygon, target: &Target, share: f64, least: f64) -> Cell {
        let mut cell = Cell { polygon: *polygon, value: self.value(polygon, target), moved: 0.0 };
        if self.may_hide_a_bend(&cell, share, least) {
            self.look_from_corners(&mut cell, target);
        }
        cell
    }

    /// Whether a view that bends between the points and a corner would cast more doubt than there is on a cell, and more than
    /// `least`. Where all points see the same, or nothing, a corner may see as much as any other point.
    fn may_hide_a_bend(&self, cell: &Cell, share: f64, least: f64) -> bool {
        let v = &cell.value;
        v.crossed && BENT * v.whole * self.most > least.max(cell.doubt(share))
    }

    /// Compares what a cell's corners see, the looker being there, with what its points let expect.
    fn look_from_corners(&mut self, cell: &mut Cell, target: &Target) {
        let mut bent = 0.0f64;
        for (corner, expected) in cell.polygon.corners().iter().zip(cell.value.ends) {
            let (seen, whole) = self.looker.look(*corner, cell.polygon.normal, target);
            if whole > 0.0 {
                bent = bent.max((seen / whole - f64::from(expected)).abs());
            }
        }
        cell.value.bent = bent;
    }

    /// Halves the cell that is most in doubt, time after time.
    fn refine(&mut self, target: &Target, accuracy: Accuracy, least: f64) {
        let (mut seen, mut whole) = self.total();
        let share = |seen: f64, whole: f64| (seen / whole).clamp(0.0, 1.0);
        let now = share(seen, whole);
        let mut doubt = 0.0;
        self.worst.clear();
        for (k, cell) in self.cells.iter().enumerate() {
            let own = cell.doubt(now);
            doubt += own;
            self.worst.push((own.to_bits(), k));
        }
        while doubt > accuracy.allowed(share(seen, whole)) * whole && self.cells.len() < MOST_HALVED {
            let Some((bits, k)) = self.worst.pop() else { break };
            let cell = self.cells[k];
            // As narrow as rounding, a cell stays as it is, and its doubt with it.
            let [Some(first), Some(second)] = cell.polygon.halves_across(cell.value.across) else { continue };
            let mut halves = [first, second].map(|polygon| self.cell(&polygon, target, now, least));
            let before = (cell.value.seen, cell.value.whole);
            let [first, second] = halves.map(|half| (half.value.seen, half.value.whole));
            let change = (first.0 + second.0 - before.0, first.1 + second.1 - before.1);
            seen += change.0;
            whole += change.1;
            doubt -= f64::from_bits(bits);
            let mut place = k;
            for half in &mut halves {
                half.moved = (change.0 - now * change.1).abs();
                let own = half.doubt(now);
                doubt += own;
                self.put(place, *half);
                self.worst.push((own.to_bits(), place));
                place = self.cells.len();
            }
        }
    }

    fn put(&mut self, place: usize, cell: Cell) {
        if place == self.cells.len() {
            self.cells.push(cell);
        } else {
            self.cells[place] = cell;
        }
    }

    /// Integrals over a cell, by rules of second degree on a fan of triangles.
    fn value(&mut self, cell: &Polygon, target: &Target) -> Value {
        let c = cell.corners();
        let (mut low, mut high) = (1.0f64, 0.0f64);
        self.looker.enter(cell, target);
        self.seen.clear();
        let mut look = |point: DVec3| {
            let (seen, whole) = self.looker.look(point, cell.normal, target);
            self.seen.push((point, seen));
            if whole > 0.0 {
                let share = seen / whole;
                low = if share < low { share } else { low };
                high = if share > high { share } else { high };
            }
            DVec2::new(seen, whole)
        };
        let (mut inner, mut edges) = (DVec2::ZERO, DVec2::ZERO);
        let mut ends = [0.0; MOST_CORNERS];
        // In a triangle, a corner, the point next to it and the middle of the opposite edge lie on one line.
        let end = |near: DVec2, far: DVec2| (1.5 * near.x / near.y - 0.5 * far.x / far.y) as f32;
        // Neighbours in the fan share an edge.
        let mut along = look(0.5 * (c[0] + c[1]));
        for j in 1..c.len() - 1 {
            let corners = [c[0], c[j], c[j + 1]];
            let third = (corners[1] - c[0]).cross(corners[2] - c[0]).dot(cell.normal) / 6.0;
            let sum: DVec3 = corners.iter().sum();
            let near = corners.map(|p| look(0.5 * p + sum / 6.0));
            let (next, far) = (look(0.5 * (c[0] + c[j + 1])), look(0.5 * (c[j] + c[j + 1])));
            inner += third * near.iter().sum::<DVec2>();
            edges += third * (along + next + far);
            if j == 1 {
                (ends[0], ends[1]) = (end(near[0], far), end(near[1], next));
            }
            ends[j + 1] = end(near[2], along);
            along = next;
        }
        let begins = !self.looker.is_even() && (low == 0.0 || high == 1.0);
        let spread = (high - low).max(0.0);
        let mixed = if begins { spread } else { 0.0 };
        let crossed = self.looker.is_crossed();
        self.most = self.most.max(high);
        // Of any third degree, the rule of the edges misses -9 times as much as the inner one.
        let both = 0.9 * inner + 0.1 * edges;
        let off = inner - edges;
        let across = across(cell, &self.seen);
        Value { seen: both.x, whole: both.y, off: (off.x, off.y), mixed, across, crossed, ends, bent: 0.0 }
    }

    /// Cuts polygon `a` where an edge of a body passes a corner of `b`.
    fn split(&mut self, a: &Polygon, b: &Polygon, bodies: &[&Body]) {
        self.cells.clear();
        self.cells.push(Cell::of(*a));
        for body in bodies {
            for &corner in b.corners() {
                self.planes.clear();
                body.outline(corner, &mut self.before, |p, q| {
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
        if self.cells.len() >= self.most_cells {
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
                self.cells.push(Cell::of(second));
            }
        }
    }

    /// Halves cells that are large for their distance.
    fn halve(&mut self, target: DVec3) {
        let mut k = 0;
        while k < self.cells.len() {
            let polygon = self.cells[k].polygon;
            let middle = polygon.middle();
            if self.cells.len() < 2 * self.most_cells
                && polygon.radius(middle) > NEAR * middle.distance(target)
            {
                self.cells.swap_remove(k);
                let halves = polygon.halves().into_iter().flatten();
                self.cells.extend(halves.map(Cell::of));
            } else {
                k += 1;
            }
        }
    }
}

/// The direction, along the longest edge of a cell or at right angles to it, in which what is seen changes most.
fn across(cell: &Polygon, seen: &[(DVec3, f64)]) -> DVec3 {
    let along =
        cell.edges().map(|(a, b)| b - a).max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    let along = along.unwrap_or(DVec3::X);
    let aside = cell.normal.cross(along);
    let mean = seen.iter().map(|l| l.1).sum::<f64>() / seen.len() as f64;
    let score = |d: DVec3| {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (p, _) in seen {
            let x = p.dot(d);
            low = low.min(x);
            high = high.max(x);
        }
        let (middle, scale) = (0.5 * (low + high), 2.0 / (high - low));
        let (mut first, mut second) = (0.0, 0.0);
        for (p, f) in seen {
            let x = (p.dot(d) - middle) * scale;
            first += x * (f - mean);
            second += x * x * (f - mean);
        }
        first.abs() + second.abs()
    };
    if score(aside) > score(along) { aside } else { along }
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
