//! What a point sees of a polygon behind others, exactly: what lies in the others' shadows is cut off.

use crate::form_factor::analytic::{Cut, Polygon, lambert};
use glam::DVec3;
use std::f64::consts::PI;

/// The shadow of a face, seen from a point: the cone of the face's edges, beyond its plane.
#[derive(Debug, Clone, Copy)]
pub struct Shadow {
    /// A point on the face's plane, and the plane's normal towards the viewer; none: the face is seen edge-on.
    plane: Option<(DVec3, DVec3)>,
    /// Normals of the planes through viewer and edges, outwards.
    sides: [DVec3; 4],
    count: usize,
}

impl Shadow {
    /// The shadow of a triangle or quad.
    pub fn new(viewer: DVec3, face: &Polygon) -> Shadow {
        let o = face.corners()[0];
        let distance = (viewer - o).dot(face.normal);
        let mut sides = [DVec3::ZERO; 4];
        if distance == 0.0 {
            return Shadow { plane: None, sides, count: 0 };
        }
        let sign = distance.signum();
        let mut count = 0;
        for (side, (p, q)) in sides.iter_mut().zip(face.edges()) {
            *side = sign * (p - viewer).cross(q - viewer);
            count += 1;
        }
        Shadow { plane: Some((o, sign * face.normal)), sides, count }
    }

    /// Whether a polygon lies wholly out of the shadow (1), wholly in it (0), or neither is plain (none).
    #[inline]
    fn leaves(&self, viewer: DVec3, polygon: &Polygon) -> Option<f64> {
        let Some((point, normal)) = self.plane else { return Some(1.0) };
        let mut inside = true;
        let mut test = |point: DVec3, outward: DVec3| {
            let (mut out, mut within) = (true, true);
            for c in polygon.corners() {
                let d = (*c - point).dot(outward);
                out &= d >= 0.0;
                within &= d <= 0.0;
            }
            inside &= within;
            out
        };
        if test(point, normal) || self.sides[..self.count].iter().any(|s| test(viewer, *s)) {
            return Some(1.0);
        }
        inside.then_some(0.0)
    }

    /// Adds what lies out of the shadow to `pieces`.
    fn cut(&self, viewer: DVec3, polygon: &Polygon, pieces: &mut Vec<Polygon>) {
        let Some((point, normal)) = self.plane else { return pieces.push(*polygon) };
        let planes =
            std::iter::once((point, normal)).chain(self.sides[..self.count].iter().map(|s| (viewer, *s)));
        let first = pieces.len();
        let mut rest = *polygon;
        for (point, outward) in planes {
            match rest.before(point, outward) {
                Cut::All => {
                    // Nothing is in the shadow: the whole polygon stays in one piece.
                    pieces.truncate(first);
                    pieces.push(*polygon);
                    return;
                }
                Cut::Nothing => {}
                Cut::Part(out) => {
                    pieces.push(out);
                    match rest.before(point, -outward) {
                        Cut::Part(within) => rest = within,
                        Cut::All => {}
                        Cut::Nothing => return,
                    }
                }
            }
        }
    }
}

/// Room for the pieces of one polygon.
#[derive(Default)]
pub struct Pieces(Vec<Polygon>, Vec<Polygon>);

/// A polygon that points look at.
pub struct Seen<'a> {
    /// The polygon, in front of the points' horizon.
    pub polygon: &'a Polygon,
    /// It is small for its distance: rules of second degree (4 or 3 points) take the place of Lambert's formula.
    pub small: bool,
}

impl Seen<'_> {
    /// Form factor from a differential area to a part of the polygon.
    #[inline]
    fn factor(&self, viewer: DVec3, normal: DVec3, part: &Polygon) -> f64 {
        if !self.small {
            return lambert(viewer, normal, part.corners());
        }
        // Edge midpoints of a fan of triangles: exact for kernels of second degree.
        let c = part.corners();
        let kernel = |p: DVec3| {
            let d = p - viewer;
            let r2 = d.length_squared();
            -d.dot(normal) * d.dot(part.normal) / (r2 * r2)
        };
        let mut sum = 0.0;
        let mut along = kernel(0.5 * (c[0] + c[1]));
        for k in 1..c.len() - 1 {
            let next = kernel(0.5 * (c[0] + c[k + 1]));
            let area = (c[k] - c[0]).cross(c[k + 1] - c[0]).dot(part.normal);
            sum += area * (along + next + kernel(0.5 * (c[k] + c[k + 1])));
            along = next;
        }
        sum / (6.0 * PI)
    }
}

/// Form factor from a differential area to what it sees of a polygon, and to the whole polygon, which faces
/// it; `shadows` are those of the faces that may come between.
pub fn visible<'a>(
    viewer: DVec3,
    normal: DVec3,
    seen: &Seen,
    shadows: impl Iterator<Item = &'a Shadow>,
    pieces: &mut Pieces,
) -> (f64, f64) {
    let whole = seen.factor(viewer, normal, seen.polygon);
    if whole <= 0.0 {
        // On the plane of the polygon but for rounding, where both touch.
        return (0.0, 0.0);
    }
    let Pieces(lit, next) = pieces;
    lit.clear();
    for shadow in shadows {
        match shadow.leaves(viewer, seen.polygon) {
            Some(1.0) => continue,
            Some(_) => return (0.0, whole),
            None => {}
        }
        if lit.is_empty() {
            lit.push(*seen.polygon);
        }
        next.clear();
        lit.iter().for_each(|p| shadow.cut(viewer, p, next));
        std::mem::swap(lit, next);
        if lit.is_empty() {
            return (0.0, whole);
        }
    }
    if lit.is_empty() {
        return (whole, whole);
    }
    let part: f64 = lit.iter().map(|p| seen.factor(viewer, normal, p)).sum();
    (part.clamp(0.0, whole), whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    /// A point in the plane of a polygon sees nothing of it; rounding may say less than nothing.
    #[test]
    fn a_polygon_seen_from_its_own_plane() {
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
        let polygon = |corners: [[f64; 3]; 4], normal: DVec3| {
            Polygon::new(&corners.map(|c| turn * DVec3::from(c)), turn * normal)
        };
        let floor = [[1.0, -1.0, 0.0], [2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
        let post = [[0.5, -0.1, -1.0], [0.5, 0.1, -1.0], [0.5, 0.1, 1.0], [0.5, -0.1, 1.0]];
        let (floor, post) = (polygon(floor, DVec3::Z), polygon(post, DVec3::X));
        let seen = Seen { polygon: &floor, small: false };
        let mut pieces = Pieces::default();
        for k in 0..1000 {
            let (y, z) = (f64::from(k) / 1000.0 - 0.5, 1e-17 * f64::from(k % 7));
            let viewer = turn * DVec3::new(-0.3 * y, y, z);
            let shadow = Shadow::new(viewer, &post);
            let (part, whole) = visible(viewer, turn * DVec3::X, &seen, [&shadow].into_iter(), &mut pieces);
            assert!((0.0..1e-15).contains(&whole) && (0.0..=whole).contains(&part), "{part} of {whole}");
        }
    }
}
