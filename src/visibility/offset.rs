//! Where rays start: the one policy against self-hits, leaks and lost contact shadows.
//!
//! Embree works in single precision. With `u = 2^-24` (half a unit in the last place of 1), a coordinate
//! `x` is wrong by at most `u |x|` after rounding; a vertex, a ray's origin and the few sums that lead from one
//! to the other add up to an error along the face's normal of at most
//! `4 u (sum over k of |n_k| M_k + D)`, where `M_k` is the face's largest coordinate along axis k relative to
//! the scene's centre and `D` its longest edge (as in Pharr, Jakob and Humphreys 2023, "Physically Based Rendering",
//! section 6.8: an absolute error by axis, projected on the normal). That bound is the face's
//! **lift**: points are computed in double precision, lifted by it along the normal, and rounded once. It follows the
//! face's own coordinates, not the size of the scene, so a screw in the middle of a hall keeps its contact shadows; a
//! face on an axis-aligned wall far away has a larger one.
//!
//! **No self-hit.** A flat face cannot be met by a ray that leaves it: hits on the ray's own face are passed over
//! by number (Waechter and Binder 2019, "A fast and robust method for avoiding self-intersection", lift too, but by
//! integers of the last place; the number makes the choice of a distance uncritical). Shadow segments end a lift
//! before their target and a further `8 u` of their length earlier, for the rounding of their direction.
//!
//! **No leak.** Where two faces meet at an angle `a`, a point nearer to the common edge than `lift cot(a / 2)` could be lifted
//! through the other face, or be rounded to its far side. Points that close are moved away from the edge,
//! within their own face: the **margin**. A wedge looks alike at every distance from its edge, so the light
//! there is the same. Free edges have the margin of a right angle, since other faces may touch there; where an edge of a small
//! face lies on another face, `contact.rs` finds their angle.
//! Edges are the same if their ends are the same in single precision.
//!
//! **What is left.** A face of which the margins would take more than a quarter is too small for
//! single precision where it lies; the scene's warnings name its object.

use crate::scene::Scene;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Half a unit in the last place of 1 in single precision.
const UNIT: f64 = 1.0 / 16_777_216.0;
/// A segment ends by this share of its length before its target.
pub(super) const SHORTER: f32 = 1.0 - 8.0 / 16_777_216.0;
/// Largest share of a face's height that a margin takes.
pub(super) const WIDEST: f64 = 0.25;

/// How far rays of one face start from its plane and its edges.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    /// Distance along the normal \[m\].
    pub lift: f64,
    /// Distance from each edge, as a share of the face's height over it; edge k runs from corner k to the next.
    pub margin: [f32; 4],
    triangle: bool,
}

/// The offsets of every face, and whether every edge belongs to two faces or more.
pub(super) fn offsets(scene: &Scene) -> (Vec<Offset>, bool) {
    let mut offsets: Vec<Offset> = (0..scene.faces.len() as u32).map(|k| own_offset(scene, k)).collect();
    let mut closed = true;
    for edges in shared_edges(scene).chunk_by(|a, b| a.0 == b.0) {
        closed &= edges.len() > 1;
        for (k, &(_, face, edge)) in edges.iter().enumerate() {
            for &(_, other, other_edge) in edges[..k].iter().filter(|e| e.1 != face) {
                let (a, b) = (inward(scene, face, edge as usize), inward(scene, other, other_edge as usize));
                // cot(angle / 2) = |a + b| / |a - b| of unit vectors.
                let cot = (a + b).length() / (a - b).length().max(1e-12);
                let lift = offsets[face as usize].lift.max(offsets[other as usize].lift);
                for (f, e) in [(face, edge), (other, other_edge)] {
                    let share = (lift * cot / height(scene, f, e as usize)).min(WIDEST) as f32;
                    let margin = &mut offsets[f as usize].margin[e as usize];
                    *margin = margin.max(share);
                }
            }
        }
    }
    (offsets, closed)
}

/// Lift of a face, and the margins of its edges as if they were free.
fn own_offset(scene: &Scene, k: u32) -> Offset {
    let face = &scene.faces[k as usize];
    let corners = [0, 1, 2, 3].map(|k| scene.corner(face, k));
    let most = corners.iter().fold(DVec3::ZERO, |m, c| m.max(c.abs()));
    let longest = (0..4).map(|k| corners[k].distance(corners[(k + 1) % 4])).fold(0.0, f64::max);
    let lift = 4.0 * UNIT * (face.normal.abs().dot(most) + longest);
    let triangle = face.is_triangle();
    let mut margin = [0.0; 4];
    for (edge, m) in margin.iter_mut().enumerate().take(if triangle { 3 } else { 4 }) {
        *m = (lift / height(scene, k, edge)).min(WIDEST) as f32;
    }
    Offset { lift, margin, triangle }
}

/// Ends of an edge in single precision, bit by bit, the smaller first.
pub(super) type EdgeKey = [[u32; 3]; 2];

/// Every edge of every face, equal ones side by side: key, face, edge.
pub(super) fn shared_edges(scene: &Scene) -> Vec<(EdgeKey, u32, u8)> {
    let mut edges = Vec::with_capacity(scene.faces.len() * 4);
    // Adding zero makes -0 and 0 one point.
    let at = |v: u32| (scene.vertices[v as usize].as_vec3() + glam::Vec3::ZERO).to_array().map(f32::to_bits);
    for (k, face) in scene.faces.iter().enumerate() {
        let corners = if face.is_triangle() { 3 } else { 4 };
        for c in 0..corners {
            let (a, b) = (at(face.vertices[c]), at(face.vertices[(c + 1) % corners]));
            edges.push((if a < b { [a, b] } else { [b, a] }, k as u32, c as u8));
        }
    }
    edges.par_sort_unstable();
    edges
}

pub(super) fn edge_ends(scene: &Scene, face: u32, edge: usize) -> (DVec3, DVec3) {
    let f = &scene.faces[face as usize];
    let corners = if f.is_triangle() { 3 } else { 4 };
    (scene.corner(f, edge), scene.corner(f, (edge + 1) % corners))
}

/// Unit vector from an edge into its face, in the face's plane.
pub(super) fn inward(scene: &Scene, face: u32, edge: usize) -> DVec3 {
    let (a, b) = edge_ends(scene, face, edge);
    scene.faces[face as usize].normal.cross(b - a).normalize_or_zero()
}

/// Height of a face over one of its edges; the lesser of both other corners' where they differ.
pub(super) fn height(scene: &Scene, face: u32, edge: usize) -> f64 {
    let (a, b) = edge_ends(scene, face, edge);
    let f = &scene.faces[face as usize];
    if f.skew != DVec2::ZERO {
        let inward = inward(scene, face, edge);
        let over = |k: usize| (scene.corner(f, (edge + k) % 4) - a).dot(inward);
        return over(2).min(over(3)).max(f64::MIN_POSITIVE);
    }
    f.area * if f.is_triangle() { 2.0 } else { 1.0 } / a.distance(b).max(f64::MIN_POSITIVE)
}

impl Offset {
    /// The point of the face nearest to (u, v) that keeps the margins.
    #[inline]
    pub fn inside(&self, u: f64, v: f64) -> (f64, f64) {
        let m = self.margin.map(f64::from);
        if !self.triangle {
            return (u.clamp(m[3], 1.0 - m[1]), v.clamp(m[0], 1.0 - m[2]));
        }
        let (u, v) = (u.max(m[2]), v.max(m[0]));
        let excess = u + v - (1.0 - m[1]);
        if excess <= 0.0 {
            return (u, v);
        }
        // Towards the corner where the two other margins meet.
        let s = 1.0 - excess / (u - m[2] + v - m[0]);
        (m[2] + (u - m[2]) * s, m[0] + (v - m[0]) * s)
    }

    /// A cell's origin and edges in (u, v), drawn in from the margins.
    pub fn inside_cell(&self, (o, a, b): (DVec2, DVec2, DVec2)) -> (DVec2, DVec2, DVec2) {
        let at = |p: DVec2| DVec2::from(self.inside(p.x, p.y));
        let origin = at(o);
        (origin, at(o + a) - origin, at(o + b) - origin)
    }

    /// A margin takes all that it may: single precision does not resolve the face.
    pub fn is_exceeded(&self) -> bool {
        self.margin.iter().any(|m| f64::from(*m) >= WIDEST)
    }
}

/// Objects of which single precision does not resolve some faces, and how many.
pub(super) fn unresolved(scene: &Scene, offsets: &[Offset]) -> Vec<(u32, usize)> {
    let mut counts: FxHashMap<u32, usize> = FxHashMap::default();
    for (face, _) in scene.faces.iter().zip(offsets).filter(|(_, o)| o.is_exceeded()) {
        *counts.entry(face.object).or_default() += 1;
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_unstable();
    counts
}
