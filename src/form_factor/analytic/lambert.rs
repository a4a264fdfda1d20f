//! From a point to a polygon: Lambert's formula.

use super::polygon::{Cut, Polygon};
use glam::DVec3;
use std::f64::consts::PI;

/// Form factor from a differential area at `point` with unit `normal` to the front of a polygon, dimensionless,
/// nothing between: Lambert's `1/(2 pi) sum of gamma_k n . Gamma_k` over the edges, with the angle `gamma_k` that
/// edge k fills and the unit normal `Gamma_k` of the plane through edge and point (Lambert 1760; Baum,
/// Rushmeier and Winget 1989, equation 7). What lies below the point's horizon is cut off; 0 where the
/// point is behind the polygon or on its plane.
///
/// Accurate to some 1e-15 of the largest edge term: a polygon of small solid angle loses as many
/// digits as its angular size has zeros.
pub fn differential(point: DVec3, normal: DVec3, polygon: &Polygon) -> f64 {
    if (point - polygon.corners()[0]).dot(polygon.normal) <= 0.0 {
        return 0.0;
    }
    match polygon.before(point, normal) {
        Cut::All => lambert(point, normal, polygon.corners()),
        Cut::Nothing => 0.0,
        Cut::Part(part) => lambert(point, normal, part.corners()),
    }
}

/// [`differential`] for the corners of a polygon that lies above the horizon and faces the point.
#[inline]
pub fn lambert(point: DVec3, normal: DVec3, corners: &[DVec3]) -> f64 {
    let mut from = corners[corners.len() - 1] - point;
    let mut sum = 0.0;
    for corner in corners {
        let to = *corner - point;
        let cross = from.cross(to);
        let sine = cross.length();
        if sine > 0.0 {
            sum -= cross.dot(normal) * (sine.atan2(from.dot(to)) / sine);
        }
        from = to;
    }
    sum / (2.0 * PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(corners: &[DVec3]) -> f64 {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        differential(DVec3::ZERO, DVec3::Z, &Polygon::new(corners, normal))
    }

    /// A unit square at distance 1 above one of its corners (Howell B-3), from its front and from its back, and one that
    /// rises through the horizon.
    #[test]
    fn lambert_of_known_polygons() {
        let square = |z: f64| [[0.0, 0.0, z], [0.0, 1.0, z], [1.0, 1.0, z], [1.0, 0.0, z]].map(DVec3::from);
        let exact = {
            let r = 2f64.sqrt();
            2.0 * (1.0 / r) * (1.0 / r).atan() / std::f64::consts::TAU
        };
        let down = square(1.0);
        assert!((seen(&down) - exact).abs() < 1e-15);
        let mut up = down;
        up.reverse();
        assert_eq!(seen(&up), 0.0);
        // A wall at x = 1, 2 wide, that goes from far below to far above fills half of the horizon's cut.
        let wall = |low: f64| {
            [[1.0, 1.0, low], [1.0, -1.0, low], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]].map(DVec3::from)
        };
        let (cut, whole) = (seen(&wall(-3.0)), seen(&wall(0.0)));
        assert!(whole > 0.05 && (cut - whole).abs() < 1e-15, "{cut} {whole}");
    }
}
