//! View rays: recursion over specular surfaces down to diffuse light.

use super::{Context, Estimator, Method, Sampler, lobe};
use crate::bsdf::{self, MIRROR_ALPHA, Scatter};
use crate::color::{self, Rgb};
use crate::emitters::{connect, mis_share};
use crate::geometry::Frame;
use crate::scene::Material;
use crate::visibility::SurfacePoint;
use glam::{DVec3, Vec3};

/// Branches weaker than this play Russian roulette.
const WEAK: f64 = 0.05;
/// Surfaces on one branch at most; reached between facing perfect mirrors only.
const DEEPEST: u32 = 64;
/// Behind a lobe this wide, interpolated radiosity is as good as fresh samples.
const WIDE: f64 = 0.02;

/// One view ray on its way.
#[derive(Clone, Copy)]
struct Sight {
    origin: Vec3,
    direction: DVec3,
    /// The face that it left.
    from: u32,
    depth: u32,
    /// Weight in the pixel, for decisions only.
    weight: f64,
    /// Glossy lobes on the way.
    glossy: u32,
    /// Diffuse light at the method's own quality.
    fine: bool,
    /// Density of the direction and the numbers of lobe rays and emitter samples that shared the
    /// lobe, where an emitter at the end has been sampled too.
    shared: Option<(f64, f64, f64)>,
}

impl Context<'_, '_> {
    /// Radiance along a camera ray [W m^-2 sr^-1].
    pub(super) fn view(&self, origin: Vec3, direction: DVec3, sampler: Sampler) -> Rgb {
        let sight = Sight {
            origin,
            direction,
            from: u32::MAX,
            depth: 0,
            weight: 1.0,
            glossy: 0,
            fine: true,
            shared: None,
        };
        self.see(&sight, sampler)
    }

    fn see(&self, sight: &Sight, sampler: Sampler) -> Rgb {
        self.cast(1);
        let Some(hit) = self.visibility.closest(sight.origin, sight.direction.as_vec3(), sight.from) else {
            return self.scene.environment;
        };
        let at = self.visibility.point(&hit);
        let material = self.scene.material(&self.scene.faces[hit.face as usize]);
        let mut radiance = Rgb::ZERO;
        if let Some((emitted, density)) = self.emitters.at(hit.face, hit.front) {
            let share = sight.shared.map_or(1.0, |(p, n, m)| {
                let r2 = at.point.distance_squared(sight.origin.as_dvec3());
                mis_share(n, p, m, density * r2 / -sight.direction.dot(at.geometric))
            });
            radiance += emitted * share;
        }
        if !hit.front && !material.two_sided {
            return radiance;
        }
        let wo = -sight.direction;
        let normal = at.facing(wo);
        if material.is_diffuse() {
            radiance += self.diffuse(material, &at, normal, sampler, sight.fine);
        }
        if material.is_specular() && self.settings.method != Method::Radiosity && sight.depth < DEEPEST {
            radiance += self.specular(material, &at, normal, wo, sight, sampler);
        }
        radiance
    }

    fn specular(
        &self,
        material: &Material,
        at: &SurfacePoint,
        normal: DVec3,
        wo: DVec3,
        sight: &Sight,
        sampler: Sampler,
    ) -> Rgb {
        if material.is_glass() {
            let branches = bsdf::glass_branches(material, wo, normal, at.front);
            return branches
                .iter()
                .zip([1, 2])
                .filter_map(|(s, branch)| Some(self.follow(at, s.as_ref()?, sight, sampler.branch(branch))))
                .sum();
        }
        let alpha = material.alpha();
        if alpha < MIRROR_ALPHA {
            return bsdf::sample_reflection(material, wo, normal, 0.0, 0.0)
                .map_or(Rgb::ZERO, |s| self.follow(at, &s, sight, sampler.branch(3)));
        }
        match self.settings.estimator {
            // Grids within grids would cost n^4 rays: behind the first glossy surface one ray samples the lobe.
            Estimator::Frustum(n) if sight.glossy == 0 => {
                self.frustum(material, at, normal, wo, n, sight, sampler)
            }
            Estimator::Lobe(n) if sight.glossy == 0 => self.lobe(material, at, normal, wo, n, sight, sampler),
            _ => self.lobe(material, at, normal, wo, 1, sight, sampler),
        }
    }

    /// The ray of one branch, or its Russian roulette.
    fn follow(&self, at: &SurfacePoint, s: &Scatter, sight: &Sight, sampler: Sampler) -> Rgb {
        // An interpolated normal may have turned the direction to the wrong side of the face.
        if (s.direction.dot(at.geometric) > 0.0) == s.transmitted {
            return Rgb::ZERO;
        }
        let mut scale = s.weight;
        let weight = sight.weight * color::mean(scale);
        if weight <= 0.0 {
            return Rgb::ZERO;
        }
        if weight < WEAK {
            let survive = weight / WEAK;
            if sampler.numbers(5)[0] >= survive {
                return Rgb::ZERO;
            }
            scale /= survive;
        }
        let side = if s.transmitted { -at.geometric } else { at.geometric };
        let next = Sight {
            origin: self.visibility.leave(at.face, at.point, side),
            direction: s.direction,
            from: at.face,
            depth: sight.depth + 1,
            weight: weight.max(WEAK),
            shared: None,
            ..*sight
        };
        scale * self.see(&next, sampler)
    }

    /// The paper's estimator of a glossy lobe.
    #[allow(clippy::too_many_arguments)] // a surface, a ray and the numbers
    fn frustum(
        &self,
        material: &Material,
        at: &SurfacePoint,
        normal: DVec3,
        wo: DVec3,
        n: u32,
        sight: &Sight,
        sampler: Sampler,
    ) -> Rgb {
        let frame = Frame::new(normal);
        let local = frame.to_local(wo);
        let cells = lobe::frustum(local, material.alpha(), n, |cell| {
            let u = sampler.branch(4 + 16 * cell).numbers(3);
            (u[0], u[1])
        });
        let total: f64 = cells.iter().map(|c| c.1).sum();
        if total <= 0.0 {
            return Rgb::ZERO;
        }
        let albedo = material.specular * lobe::albedo(local.z, material.alpha());
        let mut sum = Rgb::ZERO;
        for (k, (direction, weight)) in cells.iter().enumerate().filter(|(_, c)| c.1 > 0.0) {
            let direction = frame.to_scene(*direction);
            if direction.dot(at.geometric) <= 0.0 {
                continue;
            }
            let next = self.glossy(at, direction, material, sight, None);
            sum += weight / total * self.see(&next, sampler.branch(5 + 16 * k as u32));
        }
        albedo * sum
    }

    /// Importance sampling of a glossy lobe with `n` rays, sharing emitters with their own samples.
    #[allow(clippy::too_many_arguments)] // as `frustum`
    fn lobe(
        &self,
        material: &Material,
        at: &SurfacePoint,
        normal: DVec3,
        wo: DVec3,
        n: u32,
        sight: &Sight,
        sampler: Sampler,
    ) -> Rgb {
        let alpha = material.alpha();
        let frame = Frame::new(normal);
        let local = frame.to_local(wo);
        let samples = if self.emitters.is_empty() { 0 } else { self.settings.emitter_samples.min(n.max(1)) };
        let mut sum = Rgb::ZERO;
        for k in 0..n {
            let u = sampler.split(3, k, n);
            let Some(s) = bsdf::sample_reflection(material, wo, normal, u[0], u[1]) else { continue };
            if s.direction.dot(at.geometric) <= 0.0 {
                continue;
            }
            let shared = (samples > 0).then_some((s.density, f64::from(n), f64::from(samples)));
            let mut next = self.glossy(at, s.direction, material, sight, shared);
            let mut scale = s.weight / f64::from(n);
            if next.weight < WEAK {
                let survive = (next.weight / WEAK).max(1e-3);
                if u[2] >= survive {
                    continue;
                }
                scale /= survive;
                next.weight = WEAK;
            }
            sum += scale * self.see(&next, sampler.branch_split(6, k, n));
        }
        let origin = self.visibility.leave(at.face, at.point, at.geometric);
        for k in 0..samples {
            let u = sampler.split(4, k, samples);
            let Some(sample) = self.emitters.sample(self.scene, [u[2], u[0], u[1]]) else { break };
            let Some(c) = connect(at.point, normal, &sample) else { continue };
            let wi = frame.to_local(c.direction);
            let value = bsdf::ggx_reflect(local, wi, alpha);
            if value <= 0.0 || c.direction.dot(at.geometric) <= 0.0 {
                continue;
            }
            let share =
                mis_share(f64::from(samples), c.density, f64::from(n), bsdf::ggx_density(local, wi, alpha));
            let segment = self.visibility.segment(origin, sample.face, sample.point, sample.normal);
            self.cast(1);
            if self.visibility.unoccluded(&segment) {
                let radiance = sample.radiance * value / c.density;
                sum += material.specular * radiance * (share / f64::from(samples));
            }
        }
        sum
    }

    /// The view ray of one direction of a glossy lobe.
    fn glossy(
        &self,
        at: &SurfacePoint,
        direction: DVec3,
        material: &Material,
        sight: &Sight,
        shared: Option<(f64, f64, f64)>,
    ) -> Sight {
        Sight {
            origin: self.visibility.leave(at.face, at.point, at.geometric),
            direction,
            from: at.face,
            depth: sight.depth + 1,
            weight: sight.weight * color::mean(material.specular),
            glossy: sight.glossy + 1,
            fine: sight.fine && material.alpha() < WIDE,
            shared,
        }
    }
}
