//! Convex polygons clipped by shadows, in buffers that are used again.

use crate::form_factor::analytic::{MOST_CORNERS, Polygon};
use glam::DVec3;

/// Half-spaces that make one shadow: a point of each border and its outward direction.
pub type Planes = Vec<(DVec3, DVec3)>;

/// Corners of a convex polygon: as many as the outline of what cuts it.
#[derive(Default)]
pub struct Ring(Vec<DVec3>);

/// How much of a polygon a shadow covers.
pub enum Cover {
    None,
    Whole,
    /// Partly, and bit k is set where plane k cuts the polygon.
    Part(u64),
}

/// How much of a polygon a shadow covers.
#[inline]
pub fn cover(polygon: &[DVec3], shadow: &[(DVec3, DVec3)]) -> Cover {
    let mut crossed = 0u64;
    for (k, (point, outward)) in shadow.iter().enumerate() {
        let (mut out, mut within) = (true, true);
        for c in polygon {
            let d = (*c - *point).dot(*outward);
            out &= d >= 0.0;
            within &= d <= 0.0;
        }
        if out {
            return Cover::None;
        }
        if !within {
            crossed |= 1 << k.min(63);
        }
    }
    if crossed == 0 { Cover::Whole } else { Cover::Part(crossed) }
}

/// The part of a polygon within a shadow, in one of two buffers: which one. `crossed` names the planes that may cut it.
pub fn clip(corners: &[DVec3], shadow: &[(DVec3, DVec3)], crossed: u64, buffers: &mut [Ring; 2]) -> usize {
    let [a, b] = buffers;
    let mut planes =
        shadow.iter().enumerate().filter(|(k, _)| crossed >> k.min(&63) & 1 == 1).map(|(_, p)| p);
    match planes.next() {
        Some(&(point, outward)) => behind(corners, point, outward, a),
        None => a.set(corners),
    }
    let mut at = 0;
    for &(point, outward) in planes {
        let (from, to) = if at == 0 { (&*a, &mut *b) } else { (&*b, &mut *a) };
        if from.corners().len() < 3 {
            break;
        }
        behind(from.corners(), point, outward, to);
        at = 1 - at;
    }
    at
}

/// The part of a convex polygon behind a plane.
#[inline]
pub fn behind(corners: &[DVec3], point: DVec3, normal: DVec3, part: &mut Ring) {
    let part = &mut part.0;
    part.clear();
    let Some(&(mut from)) = corners.last() else { return };
    let mut d = (from - point).dot(normal);
    for &to in corners {
        let e = (to - point).dot(normal);
        // From the end that lies behind, so that both sides of a cut get the same corner.
        if d > 0.0 && e < 0.0 {
            part.push(to + e / (e - d) * (from - to));
        } else if d < 0.0 && e > 0.0 {
            part.push(from + d / (d - e) * (to - from));
        }
        if e <= 0.0 {
            part.push(to);
        }
        (from, d) = (to, e);
    }
}

/// Many convex polygons, corner after corner.
#[derive(Default)]
pub struct Rings {
    corners: Vec<DVec3>,
    /// Where each ends.
    ends: Vec<usize>,
}

impl Rings {
    pub fn clear(&mut self) {
        self.corners.clear();
        self.ends.clear();
    }

    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn push(&mut self, corners: &[DVec3]) {
        self.corners.extend_from_slice(corners);
        self.ends.push(self.corners.len());
    }

    pub fn truncate(&mut self, len: usize) {
        self.ends.truncate(len);
        self.corners.truncate(self.ends.last().copied().unwrap_or(0));
    }

    pub fn get(&self, k: usize) -> &[DVec3] {
        let start = if k == 0 { 0 } else { self.ends[k - 1] };
        &self.corners[start..self.ends[k]]
    }

    pub fn iter(&self) -> impl Iterator<Item = &[DVec3]> {
        (0..self.len()).map(|k| self.get(k))
    }
}

impl Ring {
    pub fn corners(&self) -> &[DVec3] {
        &self.0
    }

    /// Adds it to `polygons`, in as many as its corners take: cuts will add some to each.
    pub fn fan(&self, normal: DVec3, polygons: &mut Vec<Polygon>) {
        let Some((first, others)) = self.0.split_first() else { return };
        let mut begin = 0;
        while begin + 1 < others.len() {
            let end = others.len().min(begin + MOST_CORNERS / 2);
            let corners: Vec<DVec3> = std::iter::once(first).chain(&others[begin..end]).copied().collect();
            polygons.push(Polygon::new(&corners, normal));
            begin = end - 1;
        }
    }

    pub fn set(&mut self, corners: &[DVec3]) {
        self.0.clear();
        self.0.extend_from_slice(corners);
    }
}

/// Area [m^2] and centroid of a polygon with this unit normal.
pub fn moment(corners: &[DVec3], normal: DVec3) -> (f64, DVec3) {
    let o = corners[0];
    let (mut area, mut first) = (0.0, DVec3::ZERO);
    let mut p = corners[1] - o;
    for corner in &corners[2..] {
        let q = *corner - o;
        let twice = p.cross(q).dot(normal);
        area += twice;
        first += twice * (p + q);
        p = q;
    }
    if area == 0.0 { (0.0, o) } else { (0.5 * area, o + first / (3.0 * area)) }
}
