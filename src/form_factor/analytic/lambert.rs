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
        Cut::All => lambert(point, normal, polygon),
        Cut::Nothing => 0.0,
        Cut::Part(part) => lambert(point, normal, &part),
    }
}

/// [`differential`] for a polygon that lies above the horizon and faces the point.
#[inline]
pub fn lambert(point: DVec3, normal: DVec3, polygon: &Polygon) -> f64 {
    let corners = polygon.corners();
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
