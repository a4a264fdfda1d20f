//! Specular lobes: mirrors, glass, thin windows, smooth or rough.
//!
//! Directions point away from the surface. A surface's specular part is a set of microfacets (GGX,
//! Smith's separable masking) each of which reflects with albedo `Ks`, without a Fresnel factor, and,
//! where the material is glass, splits the rest of the light by the exact Fresnel equations of a
//! dielectric (DESIGN section 2). Below [`MIRROR_ALPHA`] the microfacets are one plane. Single scattering only:
//! light that a facet throws against another one is lost, so nothing is created. Sources: Walter
//! et al. 2007, "Microfacet models for refraction"; Heitz 2018, "Sampling the GGX distribution of
//! visible normals".
//!
//! **Radiance in glass** is carried as radiance over index squared, which refraction does not change: a
//! closed scene in equilibrium has the same value everywhere, and factors keep their closure. What
//! carries power instead (particles from emitters) multiplies by [`Scatter::power_factor`].

pub mod ggx;

use crate::color::{self, Rgb};
use crate::geometry::{Frame, reflect};
use crate::scene::{MIRROR_ALPHA, Material};
use glam::DVec3;

/// Indices closer than this are the same medium: nothing is reflected or bent.
const MATCHED: f64 = 1e-7;

/// A sampled specular direction.
#[derive(Debug, Clone, Copy)]
pub struct Scatter {
    /// Unit direction in which the light came (or the path goes on).
    pub direction: DVec3,
    /// Lobe times cosine over density: what the radiance along `direction` is multiplied by.
    pub weight: Rgb,
    /// Density per solid angle; infinite for a perfect lobe.
    pub density: f64,
    /// The direction lies on the other side of the surface.
    pub transmitted: bool,
    /// Index of refraction on the side of `direction` over that on the side it came from.
    pub eta: f64,
    /// The normal that the lobe was taken about: the shading normal, or the geometric one where the
    /// shading normal would have sent a perfect lobe to the wrong side of the face.
    pub normal: DVec3,
}

impl Scatter {
    /// By what `weight` must be multiplied where power travels from `wo` along the direction,
    /// instead of radiance the other way.
    ///
    /// Two departures from symmetry: refraction changes the cross-section of a beam (Veach 1997, section
    /// 5.2), and a shading normal's cosine is not the one that power arrives with (section 5.3).
    pub fn power_factor(&self, wo: DVec3, geometric: DVec3) -> f64 {
        let cos = |w: DVec3, n: DVec3| w.dot(n).abs();
        let shading = cos(wo, self.normal) * cos(self.direction, geometric);
        let flat = cos(wo, geometric) * cos(self.direction, self.normal);
        if flat > 0.0 { shading / flat / (self.eta * self.eta) } else { 0.0 }
    }
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

/// The specular part of a surface, seen from one direction.
#[derive(Debug, Clone, Copy)]
pub struct Specular<'m> {
    material: &'m Material,
    wo: DVec3,
    normal: DVec3,
    geometric: DVec3,
    /// Index on the other side over the index on this side; above 1 from both sides of a thin sheet.
    eta: f64,
    alpha: f64,
    /// What glass shares out between reflection and transmission.
    glass: Rgb,
}

impl<'m> Specular<'m> {
    /// The lobes of a material seen from `wo`. `normal` and `geometric` are the unit shading and geometric normals on
    /// the side of `wo`; `front` tells whether that is the face's front (outside of the glass).
    pub fn new(
        material: &'m Material,
        wo: DVec3,
        normal: DVec3,
        geometric: DVec3,
        front: bool,
    ) -> Specular<'m> {
        let eta = if front || material.thin { material.ior } else { 1.0 / material.ior };
        // What the other parts take is not there to be reflected.
        let others = material.diffuse + material.diffuse_transmission + material.specular;
        let glass = if material.is_glass() { (Rgb::ONE - others).max(Rgb::ZERO) } else { Rgb::ZERO };
        Specular { material, wo, normal, geometric, eta, alpha: material.alpha(), glass }
    }

    /// Albedos of one facet that `wo` meets with this cosine: reflection, transmission; the cosine
    /// on the other side.
    fn facet(&self, cos: f64) -> (Rgb, Rgb, f64) {
        let (reflected, through) = (self.material.specular, self.material.specular_transmission);
        if !self.material.is_glass() {
            return (reflected, Rgb::ZERO, 0.0);
        }
        if self.is_matched() {
            return (reflected, through, cos);
        }
        let (f, cos_t) = fresnel_dielectric(cos.min(1.0), self.eta);
        if !self.material.thin {
            return (reflected + f * self.glass, (1.0 - f) * through, cos_t);
        }
        // Both faces of a sheet and all reflections between them: geometric series of what one crossing
        // leaves, `tint`.
        let share = |glass: f64, through: f64| {
            let tint = if glass > 0.0 { (through / glass).min(1.0) } else { 0.0 };
            let t = (1.0 - f) * (1.0 - f) * tint / (1.0 - f * f * tint * tint).max(f64::MIN_POSITIVE);
            (glass * (f + f * tint * t), glass * t)
        };
        let [r, g, b] = [0, 1, 2].map(|c| share(self.glass[c], through[c]));
        (reflected + Rgb::new(r.0, g.0, b.0), Rgb::new(r.1, g.1, b.1), cos)
    }

    fn is_matched(&self) -> bool {
        (self.eta - 1.0).abs() < MATCHED
    }

    fn is_smooth(&self) -> bool {
        self.alpha < MIRROR_ALPHA
    }

    /// Perfect lobes: reflected and transmitted direction, each with its exact weight.
    ///
    /// Where an interpolated normal would send one of them to the wrong side of the face, both are taken about the
    /// geometric normal, so that no light is lost.
    pub fn perfect(&self) -> [Option<Scatter>; 2] {
        if !self.is_smooth() {
            // Rough or not, a sheet of the same index lets light straight on.
            let through = self.material.is_glass() && self.is_matched();
            let ahead = self.scatter(-self.wo, self.material.specular_transmission, true, self.normal);
            return [None, through.then_some(ahead)];
        }
        let right =
            |s: &Option<Scatter>| s.is_none_or(|s| (s.direction.dot(self.geometric) > 0.0) != s.transmitted);
        let lobes = self.perfect_about(self.normal);
        if lobes.iter().all(right) { lobes } else { self.perfect_about(self.geometric) }
    }

    fn perfect_about(&self, normal: DVec3) -> [Option<Scatter>; 2] {
        let cos = self.wo.dot(normal).min(1.0);
        if cos <= 0.0 {
            return [None, None];
        }
        let (r, t, cos_t) = self.facet(cos);
        let ahead = if self.material.thin || self.is_matched() {
            -self.wo
        } else {
            ((cos / self.eta - cos_t) * normal - self.wo / self.eta).normalize()
        };
        [
            (r != Rgb::ZERO).then(|| self.scatter(reflect(self.wo, normal), r, false, normal)),
            (t != Rgb::ZERO).then(|| self.scatter(ahead, t, true, normal)),
        ]
    }

    fn scatter(&self, direction: DVec3, weight: Rgb, transmitted: bool, normal: DVec3) -> Scatter {
        let eta = if transmitted && !self.material.thin { self.eta } else { 1.0 };
        Scatter { direction, weight, density: f64::INFINITY, transmitted, eta, normal }
    }

    /// Whether some lobe has a width.
    pub fn is_glossy(&self) -> bool {
        !self.is_smooth()
            && (self.material.specular != Rgb::ZERO || (self.material.is_glass() && !self.is_matched()))
    }

    /// Most that lobes with a width scatter.
    pub fn glossy_albedo(&self) -> Rgb {
        if !self.is_glossy() {
            return Rgb::ZERO;
        }
        self.material.specular + if self.is_matched() { Rgb::ZERO } else { self.glass }
    }

    /// Light passes through the surface.
    pub fn is_glass(&self) -> bool {
        self.material.is_glass()
    }

    /// GGX width of the lobes.
    pub fn alpha(&self) -> f64 {
        self.alpha
    }

    /// Whether a direction lies on the other side of the facets' mean plane.
    pub fn is_below(&self, wi: DVec3) -> bool {
        wi.dot(self.normal) < 0.0
    }

    /// The frame of the facets, and `wo` in it.
    pub fn local(&self) -> (Frame, DVec3) {
        let frame = Frame::new(self.normal);
        (frame, frame.to_local(self.wo))
    }

    /// What one facet with local normal `h` makes of `wo`: direction and albedo of its reflection
    /// and of its transmission, masked by other facets on the way out.
    pub fn of_facet(&self, wo: DVec3, h: DVec3) -> [(DVec3, Rgb); 2] {
        let cos = wo.dot(h).min(1.0);
        let (mut r, mut t, cos_t) = self.facet(cos);
        let mirrored = reflect(wo, h);
        let ahead = if self.material.thin {
            DVec3::new(mirrored.x, mirrored.y, -mirrored.z)
        } else {
            ((cos / self.eta - cos_t) * h - wo / self.eta).normalize()
        };
        r *= if mirrored.z > 0.0 { ggx::masking(mirrored, self.alpha) } else { 0.0 };
        // In a sheet of the same index what is transmitted is a perfect lobe.
        let leaves = ahead.z < 0.0 && !self.is_matched();
        t *= if leaves { ggx::masking(ahead, self.alpha) } else { 0.0 };
        [(mirrored, r), (ahead, t)]
    }

    /// Samples the lobes that have a width; none where the direction is lost (single scattering). `u` in
    /// [0, 1)^3; the last chooses between reflection and transmission.
    pub fn sample_glossy(&self, u: [f64; 3]) -> Option<Scatter> {
        let (frame, wo) = self.local();
        if wo.z <= 0.0 || !self.is_glossy() {
            return None;
        }
        let h = ggx::sample_visible_normal(wo, self.alpha, u[0], u[1]);
        let p = self.chance_of_reflection(wo.dot(h));
        let lobes = self.of_facet(wo, h);
        let (transmitted, chance) = if u[2] < p { (false, p) } else { (true, 1.0 - p) };
        let (wi, weight) = lobes[usize::from(transmitted)];
        if weight == Rgb::ZERO {
            return None;
        }
        let density = self.glossy(frame.to_scene(wi)).1;
        let direction = frame.to_scene(wi);
        let s = self.scatter(direction, weight / chance, transmitted, self.normal);
        Some(Scatter { density, ..s })
    }

    fn chance_of_reflection(&self, cos: f64) -> f64 {
        if !self.material.is_glass() || self.is_matched() {
            return 1.0;
        }
        let (r, t, _) = self.facet(cos);
        let (r, t) = (color::mean(r), color::mean(t));
        if r + t > 0.0 { r / (r + t) } else { 1.0 }
    }

    /// The normal of the facets that lead light from the local direction `wi` to `wo`, if any does.
    fn facet_normal(&self, wo: DVec3, wi: DVec3) -> Option<DVec3> {
        let h = if wi.z > 0.0 {
            wo + wi
        } else if self.material.thin {
            wo + DVec3::new(wi.x, wi.y, -wi.z)
        } else {
            wo + self.eta * wi
        };
        let h = h.try_normalize()?;
        let h = if h.z < 0.0 { -h } else { h };
        // Facets are seen from the side that light comes from and goes to.
        let other = if wi.z < 0.0 && !self.material.thin { -wi.dot(h) } else { 1.0 };
        (wo.dot(h) > 0.0 && other > 0.0 && h.z > 0.0).then_some(h)
    }

    /// The lobes that have a width: value times cosine towards `wi` [sr^-1], and the density with which
    /// [`Specular::sample_glossy`] picks `wi` [sr^-1].
    pub fn glossy(&self, wi: DVec3) -> (Rgb, f64) {
        let (frame, wo) = self.local();
        let wi = frame.to_local(wi);
        let transmitted = wi.z < 0.0;
        if wo.z <= 0.0 || wi.z == 0.0 || !self.is_glossy() {
            return (Rgb::ZERO, 0.0);
        }
        if transmitted && (!self.material.is_glass() || self.is_matched()) {
            return (Rgb::ZERO, 0.0);
        }
        let Some(h) = self.facet_normal(wo, wi) else { return (Rgb::ZERO, 0.0) };
        let cos = wo.dot(h);
        // Solid angle of facets over that of directions (Walter et al. 2007, eqs. 14 and 17).
        let spread = if transmitted && !self.material.thin {
            let across = -wi.dot(h);
            self.eta * self.eta * across / (cos - self.eta * across).powi(2)
        } else {
            0.25 / cos
        };
        let visible = ggx::masking(wo, self.alpha) * ggx::distribution(h, self.alpha) * cos / wo.z;
        let p = self.chance_of_reflection(cos);
        let (r, t, _) = self.facet(cos);
        let (albedo, chance) = if transmitted { (t, 1.0 - p) } else { (r, p) };
        let density = visible * spread;
        (albedo * (density * ggx::masking(wi, self.alpha)), density * chance)
    }

    /// Chance that [`Specular::sample`] takes a lobe that has a width.
    pub fn chance_of_glossy(&self) -> f64 {
        let glossy = color::mean(self.glossy_albedo());
        if glossy == 0.0 {
            return 0.0;
        }
        let perfect: f64 = self.perfect().iter().flatten().map(|s| color::mean(s.weight)).sum();
        glossy / (glossy + perfect)
    }

    /// Samples all lobes; none where the direction is lost. `u` in [0, 1)^3; the last chooses the lobe.
    pub fn sample(&self, u: [f64; 3]) -> Option<Scatter> {
        let glossy = self.chance_of_glossy();
        if u[2] < glossy {
            let s = self.sample_glossy([u[0], u[1], u[2] / glossy])?;
            return Some(Scatter { weight: s.weight / glossy, density: s.density * glossy, ..s });
        }
        let lobes = self.perfect();
        let strength = lobes.map(|s| s.map_or(0.0, |s| color::mean(s.weight)));
        let total = strength[0] + strength[1];
        if total <= 0.0 {
            return None;
        }
        let first = u[2] - glossy < (1.0 - glossy) * strength[0] / total;
        let (lobe, part) = if first { (lobes[0], strength[0]) } else { (lobes[1], strength[1]) };
        let chance = (1.0 - glossy) * part / total;
        lobe.map(|s| Scatter { weight: s.weight / chance, ..s })
    }
}

/// Samples one specular branch of a material about one normal; see [`Specular::sample`].
pub fn sample_specular(
    material: &Material,
    wo: DVec3,
    normal: DVec3,
    front: bool,
    u: [f64; 3],
) -> Option<Scatter> {
    Specular::new(material, wo, normal, normal, front).sample(u)
}

#[cfg(test)]
mod tests;
