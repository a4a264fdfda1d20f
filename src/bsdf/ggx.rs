//! The GGX distribution of microfacets: normals, masking, sampling.
//!
//! Directions are in the frame of the surface's normal. Sources: Walter et al. 2007, "Microfacet
//! models for refraction"; Heitz 2018, "Sampling the GGX distribution of visible normals".

use crate::geometry::Frame;
use glam::DVec3;
use std::f64::consts::PI;

/// GGX normal distribution [sr^-1] at half vector `h` (Walter et al. 2007, eq. 33).
pub fn distribution(h: DVec3, alpha: f64) -> f64 {
    if h.z <= 0.0 {
        return 0.0;
    }
    let a2 = alpha * alpha;
    let t = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
    1.0 / (PI * a2 * t * t)
}

/// Smith's masking function of the GGX distribution (Walter et al. 2007, eq. 34), the same on both sides.
pub fn masking(w: DVec3, alpha: f64) -> f64 {
    if w.z == 0.0 {
        return 0.0;
    }
    let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    2.0 / (1.0 + (1.0 + alpha * alpha * tan2).sqrt())
}

/// A visible normal of the GGX distribution seen from `wo` (Heitz 2018, section 3).
pub fn sample_visible_normal(wo: DVec3, alpha: f64, u: f64, v: f64) -> DVec3 {
    let stretched = DVec3::new(alpha * wo.x, alpha * wo.y, wo.z).normalize();
    let frame = Frame::new(stretched);
    let (r, phi) = (u.sqrt(), 2.0 * PI * v);
    // The disc is warped so that the half hidden behind the hemisphere's rim is not sampled. Its
    // second axis must be the one perpendicular to both z and the view direction.
    let horizontal = DVec3::new(-stretched.y, stretched.x, 0.0);
    let t1 = if horizontal.length_squared() > 1e-18 { horizontal.normalize() } else { frame.x };
    let t2 = stretched.cross(t1);
    let (p1, mut p2) = (r * phi.cos(), r * phi.sin());
    let s = 0.5 * (1.0 + stretched.z);
    p2 = (1.0 - s) * (1.0 - p1 * p1).max(0.0).sqrt() + s * p2;
    let n = p1 * t1 + p2 * t2 + (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt() * stretched;
    DVec3::new(alpha * n.x, alpha * n.y, n.z.max(1e-12)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projected_area_is_one() {
        // The integral of D(h) cos over the hemisphere is 1 for every width.
        for alpha in [0.05, 0.3, 1.0] {
            let n = 200_000;
            let sum: f64 = (0..n)
                .map(|i| {
                    // Uniform in tan^2 transformed: z in (0, 1), midpoint rule in z^2 is smooth enough.
                    let z = (i as f64 + 0.5) / n as f64;
                    let r = (1.0 - z * z).sqrt();
                    2.0 * PI * distribution(DVec3::new(r, 0.0, z), alpha) * z / n as f64
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-3, "alpha {alpha}: {sum}");
        }
    }
}
