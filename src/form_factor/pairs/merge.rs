//! Faces of one plane that meet along whole edges, joined to fewer polygons: what can come between elements.

use crate::form_factor::analytic::Polygon;
use crate::scene::Scene;
use glam::DVec3;
use std::collections::BTreeMap;

/// What counts as one plane, and one line, as a share of the scene's radius: files round to some six digits.
const COPLANAR: f64 = 1e-6;
/// What counts as touching, as a share of the scene's radius.
const TOUCHING: f64 = 1e-10;

/// The surfaces of a scene: its faces, joined where they continue each other as a triangle or quad.
pub struct Surfaces {
    /// Convex polygons of three or four corners.
    pub polygons: Vec<Polygon>,
    /// The surface that each face is part of.
    pub of_face: Vec<u32>,
    /// What counts as touching \[m\]: rounding, and what joined faces were out of one plane or line.
    pub eps: f64,
}

/// Ends of an edge, bit by bit, the smaller first.
type Edge = ([u64; 3], [u64; 3]);

pub(super) fn edge_key(a: DVec3, b: DVec3) -> Edge {
    // Adding zero makes -0 and 0 one point.
    let bits = |p: DVec3| (p + DVec3::ZERO).to_array().map(f64::to_bits);
    let (a, b) = (bits(a), bits(b));
    (a.min(b), a.max(b))
}

impl Surfaces {
    /// Joins the faces of a scene.
    pub fn new(scene: &Scene) -> Surfaces {
        let mut joining = Joining {
            polygons: scene.faces.iter().map(|f| Some(Polygon::of_face(scene, f))).collect(),
            by_edge: BTreeMap::new(),
            tolerance: COPLANAR * scene.radius,
            off: 0.0,
        };
        for k in 0..scene.faces.len() {
            joining.enter(k);
        }
        let mut into: Vec<usize> = (0..scene.faces.len()).collect();
        loop {
            let mut changed = false;
            for k in 0..scene.faces.len() {
                while let Some(other) = joining.grow(k) {
                    into[other] = k;
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
        let mut number = vec![0; scene.faces.len()];
        let mut polygons = Vec::new();
        for (k, polygon) in joining.polygons.iter().enumerate() {
            if let Some(polygon) = polygon {
                number[k] = polygons.len() as u32;
                polygons.push(*polygon);
            }
        }
        let root = |mut k: usize| {
            while into[k] != k {
                k = into[k];
            }
            number[k]
        };
        Surfaces {
            polygons,
            of_face: (0..scene.faces.len()).map(root).collect(),
            eps: (TOUCHING * scene.radius).max(2.0 * joining.off),
        }
    }
}

struct Joining {
    polygons: Vec<Option<Polygon>>,
    by_edge: BTreeMap<Edge, Vec<usize>>,
    tolerance: f64,
    /// Most that a joined corner was out of plane or line \[m\].
    off: f64,
}

impl Joining {
    fn enter(&mut self, k: usize) {
        let Some(polygon) = self.polygons[k] else { return };
        for (a, b) in polygon.edges() {
            self.by_edge.entry(edge_key(a, b)).or_default().push(k);
        }
    }

    fn leave(&mut self, k: usize) {
        let Some(polygon) = self.polygons[k] else { return };
        for (a, b) in polygon.edges() {
            if let Some(at) = self.by_edge.get_mut(&edge_key(a, b)) {
                at.retain(|other| *other != k);
            }
        }
    }

    /// Joins polygon k with a neighbour; returns that one, which is then no more.
    fn grow(&mut self, k: usize) -> Option<usize> {
        let polygon = self.polygons[k]?;
        for (edge, (a, b)) in polygon.edges().enumerate() {
            let Some([p, q]) = self.by_edge.get(&edge_key(a, b)).map(Vec::as_slice) else { continue };
            let other = if *p == k { *q } else { *p };
            let Some(neighbour) = self.polygons[other].filter(|_| other != k) else { continue };
            if let Some((joined, off)) = self.join(&polygon, edge, &neighbour) {
                self.leave(k);
                self.leave(other);
                self.polygons[other] = None;
                self.polygons[k] = Some(joined);
                self.enter(k);
                self.off = self.off.max(off);
                return Some(other);
            }
        }
        None
    }

    /// The union of two polygons that share an edge, if it is convex, plane and has four corners at most; and how far
    /// it is from plane.
    fn join(&self, a: &Polygon, edge: usize, b: &Polygon) -> Option<(Polygon, f64)> {
        if a.normal.dot(b.normal) < 0.999 {
            return None;
        }
        let (p, q) = (a.corners(), b.corners());
        let (start, end) = (p[edge], p[(edge + 1) % p.len()]);
        // The neighbour goes along the edge the other way.
        let back = (0..q.len()).find(|k| q[*k] == end && q[(k + 1) % q.len()] == start)?;
        let mut ring: Vec<DVec3> = (1..=p.len()).map(|k| p[(edge + k) % p.len()]).collect();
        ring.extend((2..q.len()).map(|k| q[(back + k) % q.len()]));
        let mut off = ring.iter().map(|c| (*c - start).dot(a.normal).abs()).fold(0.0, f64::max);
        // Only at the ends of the shared edge can corners vanish.
        for corner in [start, end] {
            let k = ring.iter().position(|c| *c == corner)?;
            let (before, after) = (ring[(k + ring.len() - 1) % ring.len()], ring[(k + 1) % ring.len()]);
            let along = (after - before).try_normalize()?;
            let aside = along.cross(corner - before).length();
            if aside <= self.tolerance {
                off = off.max(aside);
                ring.remove(k);
            }
        }
        let n = ring.len();
        let convex = (0..n).all(|k| {
            let (d, e) = (ring[(k + 1) % n] - ring[k], ring[(k + 2) % n] - ring[(k + 1) % n]);
            d.cross(e).dot(a.normal) > 0.0
        });
        (n <= 4 && convex && off <= self.tolerance).then(|| (Polygon::new(&ring, a.normal), off))
    }
}
