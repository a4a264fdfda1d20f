//! Convex bodies made of faces, which prove elements hidden from each other.

use super::shaft::Bounded;
use crate::form_factor::analytic::Polygon;
use crate::scene::Scene;
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// A convex body whose surface is faces, but for one plane at most (a box that stands on a floor has no bottom).
#[derive(Debug)]
pub struct Body {
    /// A point on each bounding plane and its outward unit normal.
    planes: Vec<(DVec3, DVec3)>,
    faces: BTreeSet<u32>,
    eps: f64,
}

impl Body {
    /// The bodies of a scene: faces that hang together by their edges, lie behind each other's planes,
    /// and leave open edges in one plane only.
    pub fn all(scene: &Scene, faces: &[Bounded], eps: f64) -> Vec<Body> {
        let edges = |f: usize| {
            let face = &scene.faces[f];
            let n = if face.is_triangle() { 3 } else { 4 };
            (0..n).map(move |k| {
                let place = |k: usize| scene.corner(face, k % n).to_array().map(f64::to_bits);
                let (a, b) = (place(k), place(k + 1));
                (a.min(b), a.max(b))
            })
        };
        let mut by_edge = BTreeMap::<_, Vec<usize>>::new();
        for f in 0..faces.len() {
            edges(f).for_each(|e| by_edge.entry(e).or_default().push(f));
        }
        let (mut seen, mut bodies) = (vec![false; faces.len()], Vec::new());
        for start in 0..faces.len() {
            if seen[start] {
                continue;
            }
            seen[start] = true;
            let (mut group, mut next) = (vec![start], 0);
            while next < group.len() {
                for f in edges(group[next]).flat_map(|e| &by_edge[&e]) {
                    if !std::mem::replace(&mut seen[*f], true) {
                        group.push(*f);
                    }
                }
                next += 1;
            }
            let open: Vec<DVec3> = group
                .iter()
                .flat_map(|f| edges(*f))
                .filter(|e| by_edge[e].len() == 1)
                .flat_map(|(a, b)| [a, b].map(|p| DVec3::from_array(p.map(f64::from_bits))))
                .collect();
            bodies.extend(Body::of(&group, faces, &open, eps));
        }
        bodies
    }

    fn of(group: &[usize], faces: &[Bounded], open: &[DVec3], eps: f64) -> Option<Body> {
        let polygons = || group.iter().map(|f| &faces[*f].polygon);
        let mut planes: Vec<_> = polygons().map(|p| (p.corners()[0], p.normal)).collect();
        if planes.len() < 3 {
            return None;
        }
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
        let faces = group.iter().map(|f| *f as u32).collect();
        convex.then_some(Body { planes, faces, eps })
    }

    /// Whether one of these faces belongs to the body.
    pub fn has_any(&self, faces: &[u32]) -> bool {
        faces.iter().any(|f| self.faces.contains(f))
    }

    /// Whether the body cuts every segment between two polygons that lie outside it.
    ///
    /// From one point, the points that a convex body hides form a convex set; so does, for one of these, the set of
    /// the points that it is hidden from. It suffices that the segments between corners pass through the body. Each
    /// then crosses the surface twice, and the open plane at most once.
    pub fn hides(&self, a: &Polygon, b: &Polygon) -> bool {
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
        outside(a) && outside(b) && a.corners().iter().all(|p| b.corners().iter().all(|q| through(p, q)))
    }
}
