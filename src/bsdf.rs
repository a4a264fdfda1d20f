//! Specular lobes: perfect mirror, GGX, smooth dielectric.
//!
//! Directions point away from the surface. Lobes are evaluated in the frame of the shading normal
//! on the side of the outgoing direction. The GGX lobe has Smith's separable masking and no
//! Fresnel factor (DESIGN section 2); the albedo `Ks` multiplies it. Sources: Walter et al. 2007,
//! "Microfacet models for refraction"; Heitz 2018, "Sampling the GGX distribution of visible
//! normals".

use crate::color::{self, Rgb};
use crate::geometry::{Frame, reflect};
use crate::scene::Material;
use glam::DVec3;
use std::f64::consts::PI;

/// Below this GGX width a lobe is a perfect mirror: its angular size is below f32's resolution.
pub const MIRROR_ALPHA: f64 = 1e-4;

/// A sampled specular direction.
#[derive(Debug, Clone, Copy)]
pub struct Scatter {
    /// Unit direction in which the light came (or the path goes on).
    pub direction: DVec3,
    /// Lobe times cosine over density: what the radiance along `direction` is multiplied by.
    pub weight: Rgb,
    /// Density per solid angle; infinite for a perfect mirror or smooth glass.
    pub density: f64,
    /// The direction lies on the other side of the surface.
    pub transmitted: bool,
}

/// GGX normal distribution [sr^-1] at half vector `h` (Walter et al. 2007, eq. 33).
pub fn ggx_d(h: DVec3, alpha: f64) -> f64 {
    if h.z <= 0.0 {
        return 0.0;
    }
    let a2 = alpha * alpha;
    let t = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
    1.0 / (PI * a2 * t * t)
}

/// Smith's masking function of the GGX distribution (Walter et al. 2007, eq. 34).
pub fn ggx_g1(w: DVec3, alpha: f64) -> f64 {
    if w.z <= 0.0 {
        return 0.0;
    }
    let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    2.0 / (1.0 + (1.0 + alpha * alpha * tan2).sqrt())
}

/// Reflection lobe times the cosine of `wi` [sr^-1], for albedo 1, in the local frame.
pub fn ggx_reflect(wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    if wo.z <= 0.0 || wi.z <= 0.0 {
        return 0.0;
    }
    let h = (wo + wi).normalize_or_zero();
    ggx_d(h, alpha) * ggx_g1(wo, alpha) * ggx_g1(wi, alpha) / (4.0 * wo.z)
}

/// Density per solid angle with which [`sample_ggx`] picks `wi`.
pub fn ggx_density(wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    if wo.z <= 0.0 || wi.z <= 0.0 {
        return 0.0;
    }
    let h = (wo + wi).normalize_or_zero();
    ggx_g1(wo, alpha) * ggx_d(h, alpha) / (4.0 * wo.z)
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

/// Samples the reflection lobe for albedo 1: direction and weight `G1(wi)`; none if it points
/// below the surface (energy that single scattering loses).
pub fn sample_ggx(wo: DVec3, alpha: f64, u: f64, v: f64) -> Option<(DVec3, f64)> {
    if wo.z <= 0.0 {
        return None;
    }
    let wi = reflect(wo, sample_visible_normal(wo, alpha, u, v));
    (wi.z > 0.0).then(|| (wi, ggx_g1(wi, alpha)))
}

/// Unpolarised Fresnel reflectance of a smooth dielectric, and the cosine on the other side.
///
/// `cos_i` in (0, 1]; `eta` is the index on the other side over the index on this side. Total
/// internal reflection gives (1, 0).
pub fn fresnel_dielectric(cos_i: f64, eta: f64) -> (f64, f64) {
    let sin2_t = (1.0 - cos_i * cos_i).max(0.0) / (eta * eta);
    if sin2_t >= 1.0 {
        return (1.0, 0.0);
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    let p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    (0.5 * (s * s + p * p), cos_t)
}

/// Albedo of the specular reflection lobe at a viewing cosine: `Ks`, or Fresnel for glass.
fn reflection_albedo(material: &Material, fresnel: Option<f64>) -> Rgb {
    match fresnel {
        // What the diffuse part takes is not there to be reflected.
        Some(f) => f * (Rgb::ONE - material.diffuse - material.diffuse_transmission).max(Rgb::ZERO),
        None => material.specular,
    }
}

/// Samples one specular branch of a material, without bias: reflection, or refraction for glass.
///
/// `wo` points away from the surface, `normal` is the unit shading normal on its side, `front`
/// tells whether that is the face's front (outside of the glass). `u` in [0, 1)^3; the last picks
/// the branch.
pub fn sample_specular(
    material: &Material,
    wo: DVec3,
    normal: DVec3,
    front: bool,
    u: [f64; 3],
) -> Option<Scatter> {
    if !material.is_glass() {
        return sample_reflection(material, wo, normal, u[0], u[1]);
    }
    let [reflected, refracted] = glass_branches(material, wo, normal, front);
    let (a, b) =
        (reflected.map_or(0.0, |s| color::mean(s.weight)), refracted.map_or(0.0, |s| color::mean(s.weight)));
    if a + b <= 0.0 {
        return None;
    }
    let p = a / (a + b);
    let (branch, p) = if u[2] < p { (reflected, p) } else { (refracted, 1.0 - p) };
    branch.map(|s| Scatter { weight: s.weight / p, ..s })
}

/// Samples the reflection lobe of an opaque material.
pub fn sample_reflection(material: &Material, wo: DVec3, normal: DVec3, u: f64, v: f64) -> Option<Scatter> {
    if material.specular == Rgb::ZERO || wo.dot(normal) <= 0.0 {
        return None;
    }
    let alpha = material.alpha();
    if alpha < MIRROR_ALPHA {
        let direction = reflect(wo, normal);
        return Some(Scatter {
            direction,
            weight: material.specular,
            density: f64::INFINITY,
            transmitted: false,
        });
    }
    let frame = Frame::new(normal);
    let local = frame.to_local(wo);
    let (wi, weight) = sample_ggx(local, alpha, u, v)?;
    Some(Scatter {
        direction: frame.to_scene(wi),
        weight: material.specular * weight,
        density: ggx_density(local, wi, alpha),
        transmitted: false,
    })
}

/// Both branches of smooth glass: reflected and refracted, each with its Fresnel weight.
///
/// The refracted weight carries radiance, not radiance over index squared: whatever enters a
/// closed piece of glass leaves it again into the same outside medium, where the factors cancel.
pub fn glass_branches(material: &Material, wo: DVec3, normal: DVec3, front: bool) -> [Option<Scatter>; 2] {
    let cos_o = wo.dot(normal).min(1.0);
    if cos_o <= 0.0 {
        return [None, None];
    }
    let eta = if front { material.ior } else { 1.0 / material.ior };
    let (f, cos_t) = fresnel_dielectric(cos_o, eta);
    let reflected = (f > 0.0).then(|| Scatter {
        direction: reflect(wo, normal),
        weight: reflection_albedo(material, Some(f)),
        density: f64::INFINITY,
        transmitted: false,
    });
    let refracted = (f < 1.0).then(|| Scatter {
        direction: ((cos_o / eta - cos_t) * normal - wo / eta).normalize(),
        weight: (1.0 - f) * material.specular_transmission,
        density: f64::INFINITY,
        transmitted: true,
    });
    [reflected, refracted]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling;

    #[test]
    fn ggx_projected_area_is_one() {
        // The integral of D(h) cos over the hemisphere is 1 for every width.
        for alpha in [0.05, 0.3, 1.0] {
            let n = 200_000;
            let sum: f64 = (0..n)
                .map(|i| {
                    // Uniform in tan^2 transformed: z in (0, 1), midpoint rule in z^2 is smooth enough.
                    let z = (i as f64 + 0.5) / n as f64;
                    let r = (1.0 - z * z).sqrt();
                    2.0 * PI * ggx_d(DVec3::new(r, 0.0, z), alpha) * z / n as f64
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-3, "alpha {alpha}: {sum}");
        }
    }

    #[test]
    fn sampled_weight_equals_lobe_over_density() {
        for alpha in [0.02, 0.1, 0.5, 1.0] {
            for (k, wo) in
                [DVec3::Z, DVec3::new(0.8, 0.0, 0.6), DVec3::new(0.5, -0.8, 0.1)].into_iter().enumerate()
            {
                let wo = wo.normalize();
                for i in 0..200 {
                    let p = sampling::sobol(i, 0, k as u32);
                    if let Some((wi, weight)) = sample_ggx(wo, alpha, p[0], p[1]) {
                        let expected = ggx_reflect(wo, wi, alpha) / ggx_density(wo, wi, alpha);
                        assert!((weight - expected).abs() < 1e-9, "{weight} {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn sampled_directions_follow_the_density() {
        // The mean of 1/density over sampled directions is the solid angle of the lobe's support;
        // test instead that two estimators of the lobe's albedo agree: visible normals and the
        // cosine-weighted hemisphere. n = 65,536 points; standard errors are below 2e-3.
        for (alpha, wo) in
            [(0.3, DVec3::new(0.6, 0.0, 0.8)), (0.7, DVec3::new(0.3, 0.9, 0.316)), (1.0, DVec3::Z)]
        {
            let wo = wo.normalize();
            let n = 65_536;
            let (mut a, mut b) = (0.0, 0.0);
            for i in 0..n {
                let p = sampling::sobol(i, 0, 9);
                a += sample_ggx(wo, alpha, p[0], p[1]).map_or(0.0, |s| s.1) / f64::from(n);
                let wi = sampling::cosine_hemisphere(p[2], p[3]);
                b += ggx_reflect(wo, wi, alpha) * PI / wi.z.max(1e-9) / f64::from(n);
            }
            assert!(a <= 1.0 + 1e-12 && (a - b).abs() < 8e-3, "alpha {alpha}: {a} {b}");
        }
    }

    #[test]
    fn lobe_is_reciprocal() {
        let (a, b) = (DVec3::new(0.1, 0.5, 0.7).normalize(), DVec3::new(-0.6, 0.2, 0.3).normalize());
        let (ab, ba) = (ggx_reflect(a, b, 0.4) / b.z, ggx_reflect(b, a, 0.4) / a.z);
        assert!((ab - ba).abs() < 1e-12 * ab);
    }

    #[test]
    fn fresnel_at_known_angles() {
        let (f, _) = fresnel_dielectric(1.0, 1.5);
        assert!((f - 0.04).abs() < 1e-15);
        // Brewster's angle: only s-polarised light is reflected, F = sin^2(i - t) / 2.
        let brewster = 1.5f64.atan();
        let (f, cos_t) = fresnel_dielectric(brewster.cos(), 1.5);
        let expected = 0.5 * (brewster - cos_t.acos()).sin().powi(2);
        assert!((f - expected).abs() < 1e-12);
        // Total internal reflection above the critical angle, asin(1/1.5).
        assert_eq!(fresnel_dielectric(0.7, 1.0 / 1.5).0, 1.0);
        assert!(fresnel_dielectric(0.75, 1.0 / 1.5).0 < 1.0);
    }

    #[test]
    fn refraction_obeys_snell_and_reverses() {
        let mut glass = Material::new("glass");
        glass.specular_transmission = Rgb::ONE;
        let wo = DVec3::new(0.6, 0.0, 0.8);
        let t = glass_branches(&glass, wo, DVec3::Z, true)[1].map(|s| s.direction).unwrap_or_default();
        assert!((t.x + 0.4).abs() < 1e-12 && t.z < 0.0, "{t}");
        // From inside, along the same line, light comes out where it came in.
        let back = glass_branches(&glass, t, -DVec3::Z, false)[1].map(|s| s.direction).unwrap_or_default();
        assert!(back.distance(wo) < 1e-12, "{back}");
    }

    #[test]
    fn sampled_glass_loses_nothing() {
        let mut glass = Material::new("glass");
        glass.specular_transmission = Rgb::ONE;
        for i in 0..100 {
            let p = sampling::sobol(i, 0, 3);
            let wo = sampling::cosine_hemisphere(p[0], p[1]);
            let s = sample_specular(&glass, wo, DVec3::Z, i % 2 == 0, [0.0, 0.0, p[2]]);
            assert!((color::mean(s.map_or(Rgb::ZERO, |s| s.weight)) - 1.0).abs() < 1e-12);
        }
    }
}
