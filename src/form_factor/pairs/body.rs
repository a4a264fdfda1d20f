//! Convex bodies made of surfaces: what hides elements from each other.

use super::merge::{Surfaces, edge_key};
use super::ring::{Cover, Ring, behind};
use super::shaft::blocks_all;
use crate::form_factor::analytic::{Cut, Polygon};
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// Thickness of a body, in units of what counts as touching.
const THICK: f64 = 1e3;
/// Most planes of a body.
const MOST_PLANES: usize = 1024;
/// Sines below this have no direction.
const COLLINEAR: f64 = 1e-12;

/// A convex body whose surface is opaque, but for one plane at most (a box that stands on a floor has no bottom);
/// or a single polygon, which is a body without thickness.
#[derive(Debug)]
pub struct Body {
    /// A point on each bounding plane and its outward unit normal; of a single polygon, both its sides.
    planes: Vec<(DVec3, DVec3)>,
    corners: Vec<DVec3>,
    edges: Vec<Edge>,
    surfaces: BTreeSet<u32>,
    /// The polygon, where there is only one.
    flat: Option<Polygon>,
    eps: f64,
}

/// A set of a body's planes; a buffer, too.
#[derive(Clone, Default)]
pub struct PlaneSet(Vec<u64>);

impl PlaneSet {
    #[inline]
    fn has(&self, plane: usize) -> bool {
        self.0[plane / 64] >> (plane % 64) & 1 == 1
    }
}

/// What a body shows to a point, or to all points of a cell.
#[derive(Default)]
pub struct View {
    /// Ends of the edges of its outline.
    outline: Vec<[DVec3; 2]>,
    /// Sides that bound the shadow.
    sides: Vec<(DVec3, DVec3)>,
    /// The point lies within the body.
    pub within: bool,
    /// It is the same from all points of a cell.
    pub common: bool,
    /// Wherever in the cell the point is, each of its planes cuts the polygon that is looked at.
    pub cuts: bool,
}

impl View {
    /// Leaves out the planes of a common view that cut nothing off a polygon, wherever in the cell the point is, and says how
    /// much of the polygon the body covers as far as that is the same for all points.
    ///
    /// Which side of a plane through an edge and the point a corner lies on is the sign of a tetrahedron's volume. That is affine
    /// in the point, so the cell's corners tell.
    pub fn narrow(&mut self, cell: &[DVec3], polygon: &[DVec3]) -> Cover {
        let (mut apart, mut cuts) = (false, true);
        self.outline.retain(|[p, q]| {
            let (mut out, mut within) = (true, true);
            for corner in polygon {
                let normal = (*q - *corner).cross(*p - *corner);
                let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
                for viewer in cell {
                    let side = (*viewer - *corner).dot(normal);
                    low = if side < low { side } else { low };
                    high = if side > high { side } else { high };
                }
                out &= low >= 0.0;
                within &= high <= 0.0;
                cuts &= low >= 0.0 || high <= 0.0;
            }
            apart |= out;
            !within
        });
        self.sides.retain(|(point, outward)| {
            let side = |c: &DVec3| (*c - *point).dot(*outward);
            apart |= polygon.iter().all(|c| side(c) >= 0.0);
            polygon.iter().any(|c| side(c) > 0.0)
        });
        self.cuts = cuts;
        match (apart, self.outline.is_empty() && self.sides.is_empty()) {
            (true, _) => Cover::None,
            (_, true) => Cover::Whole,
            _ => Cover::Part(u64::MAX),
        }
    }

    /// The shadow as half-spaces: each a plane's point and outward normal (of any length).
    #[inline]
    pub fn shadow(&self, viewer: DVec3, shadow: &mut Vec<(DVec3, DVec3)>) {
        shadow.clear();
        for [p, q] in &self.outline {
            let (p, q) = (*p - viewer, *q - viewer);
            let normal = p.cross(q);
            let least = COLLINEAR * COLLINEAR * p.length_squared() * q.length_squared();
            if normal.length_squared() > least {
                shadow.push((viewer, normal));
            }
        }
        shadow.extend_from_slice(&self.sides);
    }
}

/// An edge between two planes of a body; seen from before the first plane alone, the body lies to its left.
#[derive(Debug)]
struct Edge {
    ends: [DVec3; 2],
    planes: [usize; 2],
}

impl Body {
    /// The bodies of a scene: surfaces that hang together by their edges, lie behind each other's planes,
    /// and leave open edges in one plane only, unless something within them sees. Other surfaces are bodies each. The
    /// largest come first.
    pub fn all(surfaces: &Surfaces) -> Vec<Body> {
        let polygons = &surfaces.polygons;
        let mut by_edge = BTreeMap::<_, Vec<usize>>::new();
        for (f, polygon) in polygons.iter().enumerate() {
            for (a, b) in polygon.edges() {
                by_edge.entry(edge_key(a, b)).or_default().push(f);
            }
        }
        let (mut seen, mut bodies) = (vec![false; polygons.len()], Vec::new());
        for start in 0..polygons.len() {
            if seen[start] {
                continue;
            }
            seen[start] = true;
            let (mut group, mut next) = (vec![start], 0);
            while next < group.len() {
                for (a, b) in polygons[group[next]].edges() {
                    for f in &by_edge[&edge_key(a, b)] {
                        if !std::mem::replace(&mut seen[*f], true) {
                            group.push(*f);
                        }
                    }
                }
                next += 1;
            }
            match Body::solid(&group, polygons, surfaces.eps).filter(|body| !body.is_inhabited(polygons)) {
                Some(body) => bodies.push(body),
                None => bodies.extend(group.iter().map(|f| Body::single(*f, &polygons[*f], surfaces.eps))),
            }
        }
        // What the large ones hide, the small ones need not be asked about.
        bodies.sort_by(|a, b| b.extent().total_cmp(&a.extent()));
        bodies
    }

    /// The surfaces of a scene as bodies each, the largest first.
    pub fn singles(surfaces: &Surfaces) -> Vec<Body> {
        let numbered = surfaces.polygons.iter().enumerate();
        let mut bodies: Vec<Body> = numbered.map(|(f, p)| Body::single(f, p, surfaces.eps)).collect();
        bodies.sort_by(|a, b| b.extent().total_cmp(&a.extent()));
        bodies
    }

    /// Largest distance of two of its corners, squared.
    fn extent(&self) -> f64 {
        let all = self.corners.iter();
        all.flat_map(|a| self.corners.iter().map(|b| a.distance_squared(*b))).fold(0.0, f64::max)
    }

    fn single(number: usize, polygon: &Polygon, eps: f64) -> Body {
        let o = polygon.corners()[0];
        Body {
            planes: vec![(o, polygon.normal), (o, -polygon.normal)],
            corners: polygon.corners().to_vec(),
            edges: polygon.edges().map(|(a, b)| Edge { ends: [a, b], planes: [0, 1] }).collect(),
            surfaces: BTreeSet::from([number as u32]),
            flat: Some(*polygon),
            eps,
        }
    }

    fn solid(group: &[usize], all: &[Polygon], eps: f64) -> Option<Body> {
        let polygons = || group.iter().map(|f| &all[*f]);
        let mut planes: Vec<_> = polygons().map(|p| (p.corners()[0], p.normal)).collect();
        if planes.len() < 3 || planes.len() >= MOST_PLANES {
            return None;
        }
        let mut by_edge = BTreeMap::<_, Vec<(usize, [DVec3; 2])>>::new();
        for (k, polygon) in polygons().enumerate() {
            for (a, b) in polygon.edges() {
                by_edge.entry(edge_key(a, b)).or_default().push((k, [a, b]));
            }
        }
        let open: Vec<DVec3> = by_edge.values().filter(|e| e.len() == 1).flat_map(|e| e[0].1).collect();
        if let Some(o) = open.first() {
            let away = open.iter().max_by(|a, b| a.distance(*o).total_cmp(&b.distance(*o)))? - o;
            let across =
                open.iter().map(|p| away.cross(p - o)).max_by(|a, b| a.length().total_cmp(&b.length()))?;
            let normal = across.try_normalize()?;
            if open.iter().any(|p| (p - o).dot(normal).abs() > eps) {
                return None;
            }
            let middle = polygons().map(Polygon::middle).sum::<DVec3>() / group.len() as f64;
            planes.push((*o, if (middle - o).dot(normal) > 0.0 { -normal } else { normal }));
        }
        let convex = planes.iter().all(|(o, n)| polygons().all(|p| !p.reaches_before(*o, *n, eps)));
        // Surfaces of one plane enclose nothing.
        let thick = planes.iter().all(|(o, n)| polygons().any(|p| p.reaches_before(*o, -*n, THICK * eps)));
        if !convex || !thick || by_edge.values().any(|e| e.len() > 2) {
            return None;
        }
        let edges = by_edge.values().map(|e| Edge {
            ends: e[0].1,
            planes: [e[0].0, e.get(1).map_or(planes.len() - 1, |other| other.0)],
        });
        let mut corners: Vec<DVec3> = polygons().flat_map(|p| p.corners().iter().copied()).collect();
        corners.sort_by_key(|c| c.to_array().map(f64::to_bits));
        corners.dedup();
        Some(Body {
            edges: edges.collect(),
            corners,
            surfaces: group.iter().map(|f| *f as u32).collect(),
            flat: None,
            planes,
            eps,
        })
    }

    /// Whether something within it may see out, or something else within: through an open plane one surface is enough, in a
    /// closed body it takes two.
    fn is_inhabited(&self, polygons: &[Polygon]) -> bool {
        let is_within = |polygon: &&Polygon| {
            let mut rest = **polygon;
            self.planes.iter().all(|(o, n)| match rest.before(*o - 2.0 * self.eps * *n, -*n) {
                Cut::All => true,
                Cut::Nothing => false,
                Cut::Part(part) => {
                    rest = part;
                    true
                }
            })
        };
        let Some((o, n)) = self.planes.last().filter(|_| self.planes.len() > self.surfaces.len()) else {
            return polygons.iter().filter(is_within).nth(1).is_some();
        };
        // A floor that a box stands in a little looks away from the plane that is open.
        let opening = || self.corners.iter().filter(|c| (**c - *o).dot(*n).abs() <= self.eps);
        let sees = |p: &&Polygon| opening().any(|c| (*c - p.corners()[0]).dot(p.normal) > self.eps);
        polygons.iter().filter(sees).any(|p| is_within(&p))
    }

    /// Numbers of the surfaces that it consists of.
    pub fn surfaces(&self) -> impl Iterator<Item = u32> + '_ {
        self.surfaces.iter().copied()
    }

    /// Whether one of these surfaces belongs to the body.
    pub fn has_any(&self, surfaces: &[u32]) -> bool {
        surfaces.iter().any(|f| self.surfaces.contains(f))
    }

    /// A point and the outward normal of each side; none of a single polygon, whose two turn away together.
    pub fn sides(&self) -> &[(DVec3, DVec3)] {
        if self.is_solid() { &self.planes } else { &[] }
    }

    /// Its corners.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// Whether there is something within it.
    pub fn is_solid(&self) -> bool {
        self.flat.is_none()
    }

    /// Distance from a point, or a little less.
    pub fn distance(&self, point: DVec3) -> f64 {
        self.planes.iter().map(|(o, n)| (point - *o).dot(*n)).fold(0.0, f64::max)
    }

    /// Whether the body cuts every segment between two polygons that lie outside it.
    ///
    /// From one point, the points that a convex body hides form a convex set; so does, for one of these, the set of
    /// the points that it is hidden from. It suffices that the segments between corners pass through the body. Each
    /// then crosses the surface twice, and the open plane at most once.
    pub fn hides(&self, a: &Polygon, b: &Polygon) -> bool {
        if let Some(polygon) = &self.flat {
            return blocks_all(a, b, polygon);
        }
        let outside = |p: &Polygon| {
            self.planes.iter().any(|(o, n)| p.corners().iter().all(|c| (*c - *o).dot(*n) >= -self.eps))
        };
        let through = |p: &DVec3, q: &DVec3| {
            let (mut enter, mut leave) = (0.0f64, 1.0f64);
            for (o, n) in &self.planes {
                let (d, e) = ((*p - *o).dot(*n), (*q - *o).dot(*n));
                if d > 0.0 && e > 0.0 {
                    return false;
                }
                if d > 0.0 {
                    enter = enter.max(d / (d - e));
                } else if e > 0.0 {
                    leave = leave.min(d / (d - e));
                }
            }
            (leave - enter) * p.distance(*q) > 2.0 * self.eps
        };
        a.corners().iter().all(|p| b.corners().iter().all(|q| through(p, q))) && outside(a) && outside(b)
    }

    /// Planes between a polygon and the body: point and unit normal; the polygon lies on and before each, the body on
    /// and behind it. Whatever else lies before one of them sees the polygon past the body.
    ///
    /// The region that the body can hide from the polygon is convex, and bounded by planes that lean on an
    /// edge of one and a corner of the other.
    pub fn between(&self, polygon: &Polygon) -> Vec<(DVec3, DVec3)> {
        let before = |o: DVec3, n: DVec3| polygon.corners().iter().all(|c| (*c - o).dot(n) >= -self.eps);
        let mut found: Vec<_> = self.planes.iter().copied().filter(|(o, n)| before(*o, *n)).collect();
        let mut consider = |a: DVec3, b: DVec3, corner: DVec3| {
            let (edge, other) = (b - a, corner - a);
            let normal = edge.cross(other);
            let length = normal.length();
            if length <= COLLINEAR * edge.length() * other.length() {
                return;
            }
            let normal = normal / length;
            let side = polygon.corners().iter().map(|c| (*c - a).dot(normal));
            let side = side.max_by(|x, y| x.abs().total_cmp(&y.abs())).unwrap_or(0.0);
            let normal = if side < 0.0 { -normal } else { normal };
            if before(a, normal) && self.corners.iter().all(|c| (*c - a).dot(normal) <= self.eps) {
                found.push((a, normal));
            }
        };
        for (a, b) in polygon.edges() {
            self.corners.iter().for_each(|c| consider(a, b, *c));
        }
        for edge in &self.edges {
            polygon.corners().iter().for_each(|c| consider(edge.ends[0], edge.ends[1], *c));
        }
        found
    }

    /// The planes that a point lies before.
    #[inline]
    fn before(&self, point: DVec3, set: &mut PlaneSet) {
        let bit = |(k, (o, n)): (usize, &(DVec3, DVec3))| u64::from((point - *o).dot(*n) > 0.0) << k;
        let word = |planes: &[_]| planes.iter().enumerate().map(bit).fold(0, |all, bit| all | bit);
        set.0.clear();
        set.0.extend(self.planes.chunks(64).map(word));
    }

    /// The planes that a polygon reaches before.
    pub fn reached(&self, polygon: &Polygon) -> PlaneSet {
        let (mut all, mut set) = (PlaneSet(vec![0; self.planes.len().div_ceil(64)]), PlaneSet::default());
        for corner in polygon.corners() {
            self.before(*corner, &mut set);
            all.0.iter_mut().zip(&set.0).for_each(|(word, other)| *word |= other);
        }
        all
    }

    /// Calls `visit` with the ends of each edge of the outline that the body shows to points before these planes; seen from
    /// there, the body lies to the left.
    #[inline]
    fn turned(&self, before: &PlaneSet, mut visit: impl FnMut(DVec3, DVec3)) {
        for edge in &self.edges {
            let [first, second] = edge.planes.map(|k| before.has(k));
            if first != second {
                let [p, q] = edge.ends;
                if first { visit(p, q) } else { visit(q, p) }
            }
        }
    }

    /// Calls `visit` with the ends, relative to a point, of each edge of the outline that the body shows it; the body
    /// lies on the side away from their cross product.
    pub fn outline(&self, viewer: DVec3, before: &mut PlaneSet, mut visit: impl FnMut(DVec3, DVec3)) {
        self.before(viewer, before);
        self.turned(before, |p, q| visit(p - viewer, q - viewer));
    }

    /// What makes the shadow that the body casts from a point; of the body's own planes those alone that `reached` names.
    pub fn view(&self, viewer: DVec3, reached: &PlaneSet, before: &mut PlaneSet, view: &mut View) {
        self.before(viewer, before);
        self.set_view(reached, before, view);
        (view.common, view.cuts) = (false, false);
    }

    /// The same for all points of a polygon at once, where all of them see the same sides of the body.
    pub fn common_view(
        &self,
        viewers: &Polygon,
        reached: &PlaneSet,
        before: &mut [PlaneSet; 2],
        view: &mut View,
    ) {
        let [first, other] = before;
        let [corner, others @ ..] = viewers.corners() else { return };
        self.before(*corner, first);
        for corner in others {
            self.before(*corner, other);
            if other.0 != first.0 {
                (view.common, view.cuts) = (false, false);
                return;
            }
        }
        self.set_view(reached, first, view);
        (view.common, view.cuts) = (true, false);
    }

    fn set_view(&self, reached: &PlaneSet, before: &PlaneSet, view: &mut View) {
        view.outline.clear();
        self.turned(before, |p, q| view.outline.push([p, q]));
        view.sides.clear();
        for (k, (before, reached)) in before.0.iter().zip(&reached.0).enumerate() {
            let mut own = before & reached;
            while own != 0 {
                view.sides.push(self.planes[64 * k + own.trailing_zeros() as usize]);
                own &= own - 1;
            }
        }
        view.within = before.0.iter().all(|word| *word == 0);
    }

    /// The parts of an element's polygon that the body, which may stand on it, leaves open.
    pub fn uncovered(&self, polygon: &Polygon, open: &mut Vec<Polygon>) {
        let on = |(o, n): &(DVec3, DVec3)| {
            n.dot(polygon.normal) < -0.999
                && polygon.corners().iter().all(|c| (*c - *o).dot(*n).abs() <= self.eps)
        };
        if self.flat.is_some() || !self.planes.iter().any(on) {
            open.push(*polygon);
            return;
        }
        let first = open.len();
        // What is covered may have as many corners as the body sides.
        let [mut rest, mut out, mut within] = [Ring::default(), Ring::default(), Ring::default()];
        rest.set(polygon.corners());
        for (o, n) in self.planes.iter().filter(|p| !on(p)) {
            if !rest.corners().iter().any(|c| (*c - *o).dot(*n) > self.eps) {
                continue;
            }
            behind(rest.corners(), *o, -*n, &mut out);
            behind(rest.corners(), *o, *n, &mut within);
            if out.corners().len() < 3 || within.corners().len() < 3 {
                // Nothing is covered: the whole polygon stays in one piece.
                open.truncate(first);
                open.push(*polygon);
                return;
            }
            out.fan(polygon.normal, open);
            std::mem::swap(&mut rest, &mut within);
        }
    }
}
