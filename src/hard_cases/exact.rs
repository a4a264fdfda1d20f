//! Answers that share nothing with ray casting: Lambert's formula at a point, integrated by double exponential
//! quadrature, which does not mind singular edges.

use super::build::Point;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI};

/// Factor from a surface point with unit normal `n` to a polygon that lies wholly in front of it
/// and faces it with either side (Lambert 1760; Nusselt 1928).
pub fn point_factor(p: DVec3, n: DVec3, polygon: &[Point]) -> f64 {
    let corners: Vec<DVec3> = polygon.iter().map(|c| DVec3::from(*c) - p).collect();
    let sum: f64 = (0..corners.len())
        .map(|k| {
            let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
            let cross = a.cross(b);
            let l = cross.length();
            if l == 0.0 { 0.0 } else { l.atan2(a.dot(b)) * n.dot(cross) / l }
        })
        .sum();
    sum.abs() / (2.0 * PI)
}

/// Mean factor from the parallelogram with corners `a` (its first three span it) to a polygon that lies
/// wholly in front of it.
pub fn factor(a: &[Point], polygon: &[Point]) -> f64 {
    let p = |k: usize| DVec3::from(a[k]);
    let (o, e1, e2) = (p(0), p(1) - p(0), p(3) - p(0));
    let n = e1.cross(e2).normalize();
    let nodes = double_exponential();
    let mut sum = 0.0;
    for &(u, wu) in &nodes {
        for &(v, wv) in &nodes {
            sum += wu * wv * point_factor(o + u * e1 + v * e2, n, polygon);
        }
    }
    sum
}

/// Nodes and weights on (0, 1) of the tanh-sinh rule (Takahasi and Mori 1974).
fn double_exponential() -> Vec<(f64, f64)> {
    const H: f64 = 0.08;
    (-40..=40)
        .map(|k| {
            let t = f64::from(k) * H;
            let s = FRAC_PI_2 * t.sinh();
            // (1 + tanh s) / 2 without cancellation near 0.
            let x = 1.0 / (1.0 + (-2.0 * s).exp());
            (x, H * FRAC_PI_2 * t.cosh() / (2.0 * s.cosh() * s.cosh()))
        })
        .filter(|(_, w)| *w > 1e-18)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hard_cases::build::{box_sides, plate};

    #[test]
    fn cube_faces_have_their_known_factors() {
        let sides = box_sides([0.0; 3], [1.0; 3], true);
        // Opposite faces (Howell, C-11), and closure for the four others.
        let opposite = factor(&sides[0].1, &sides[1].1);
        let adjacent = factor(&sides[0].1, &sides[2].1);
        assert!((opposite - 0.199_824_895_698_387_4).abs() < 1e-9, "{opposite}");
        assert!((opposite + 4.0 * adjacent - 1.0).abs() < 1e-8, "{adjacent}");
    }

    #[test]
    fn a_point_under_a_large_plate_sees_nothing_else() {
        let ceiling = plate([-1e6, 1e6], [-1e6, 1e6], 1.0, false);
        assert!((point_factor(DVec3::ZERO, DVec3::Z, &ceiling) - 1.0).abs() < 1e-9);
    }
}
