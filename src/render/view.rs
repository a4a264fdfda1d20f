//! View rays: recursion over specular surfaces down to diffuse light.

use super::diffuse::Spot;
use super::{Context, Estimator, Method, Quality, Sampler, lobe};
use crate::bsdf::{Scatter, Specular};
use crate::color::{self, Rgb};
use crate::embree::LANES;
use crate::emitters::{Connection, connect, mis_share};
use crate::scene::Material;
use crate::visibility::{SurfaceHit, SurfacePoint};
use glam::{DVec3, Vec3};

/// Branches weaker than this play Russian roulette.
const WEAK: f64 = 0.05;
/// Branches over more surfaces than this play Russian roulette, whatever they weigh: between facing perfect mirrors
/// nothing else ends them.
const DEEP: u32 = 64;
/// Chance that such a branch goes on: light caught in glass leaves slowly, and a smaller chance would leave its sum to
/// few branches of great weight.
const GOES_ON: f64 = 0.98;
/// Surfaces on one branch at most, for the sake of the stack; of what two facing mirrors of albedo 0.99 show, 0.6 % lies beyond.
const DEEPEST: u32 = 512;
/// Behind a lobe this wide, interpolated radiosity is as good as fresh samples.
const WIDE: f64 = 0.02;

/// One view ray on its way.
#[derive(Clone, Copy)]
pub(super) struct Sight {
    origin: Vec3,
    direction: DVec3,
    /// The face that it left.
    from: u32,
    depth: u32,
    /// Weight in the pixel, for decisions only.
    weight: f64,
    /// Its share of what the camera ray sees, with all that Russian roulette made of it.
    share: f64,
    /// Glossy lobes on the way.
    glossy: u32,
    /// Diffuse light at the method's own quality.
    fine: bool,
    /// What emitter samples have found of the emitters at its end, straight and by one flat mirror.
    shared: Option<Shared>,
}

/// A ray of a glossy lobe whose emitters have been sampled too.
#[derive(Clone, Copy)]
struct Shared {
    /// Density of its direction [sr^-1].
    density: f64,
    /// Rays of the lobe.
    rays: f64,
    /// Emitter samples of the lobe.
    samples: f64,
    /// Its length up to the mirror that it met, whose images of the emitters were sampled.
    to_mirror: Option<f64>,
}

impl Sight {
    /// A camera's ray.
    pub(super) fn of_camera(origin: Vec3, direction: DVec3) -> Sight {
        Sight {
            origin,
            direction,
            from: u32::MAX,
            depth: 0,
            weight: 1.0,
            share: 1.0,
            glossy: 0,
            fine: true,
            shared: None,
        }
    }
}

impl Context<'_, '_> {
    fn see(&self, sight: &Sight, sampler: Sampler) -> Rgb {
        self.cast(1);
        let Some(hit) = self.visibility.closest(sight.origin, sight.direction.as_vec3(), sight.from) else {
            return self.scene.environment;
        };
        let (radiance, spot) = self.meet(sight, &hit, sampler);
        let Some(spot) = spot else { return radiance };
        let mut diffuse = [Rgb::ZERO; LANES];
        self.diffuse(&[spot], sampler, self.quality(sight.fine), &mut diffuse);
        radiance + diffuse[0]
    }

    /// What a view ray sees where it meets a surface [W m^-2 sr^-1]. Diffuse light that is to be sampled anew is left out: it
    /// is that of the spot, if there is one.
    pub(super) fn meet(&self, sight: &Sight, hit: &SurfaceHit, sampler: Sampler) -> (Rgb, Option<Spot<'_>>) {
        let material = self.scene.material(&self.scene.faces[hit.face as usize]);
        let mut radiance = Rgb::ZERO;
        if let Some((emitted, density)) = self.emitters.at(hit.face, hit.front) {
            let share = sight.shared.map_or(1.0, |s| {
                let at = self.visibility.point(hit);
                let r = s.to_mirror.unwrap_or(0.0) + at.point.distance(sight.origin.as_dvec3());
                mis_share(
                    s.rays,
                    s.density,
                    s.samples,
                    density * r * r / sight.direction.dot(at.geometric).abs(),
                )
            });
            radiance += emitted * share;
        }
        if !hit.front && !material.two_sided {
            return (radiance, None);
        }
        let sampled = material.is_diffuse() && self.quality(sight.fine) != Quality::Mesh;
        if material.is_diffuse() && !sampled {
            radiance += self.interpolated(hit);
        }
        let specular = material.is_specular() && self.settings.method != Method::Radiosity;
        if !sampled && !specular {
            return (radiance, None);
        }
        let at = self.visibility.point(hit);
        let wo = -sight.direction;
        let normal = at.facing(wo);
        if specular {
            let surface = Specular::new(material, wo, normal, at.geometric, at.front);
            radiance += self.specular(&surface, &at, sight, sampler);
        }
        let spot = |scale| Spot { material, at, normal, sampler, scale };
        (radiance, if sampled { self.roulette(sight, material, sampler).map(spot) } else { None })
    }

    /// What diffuse light behind specular surfaces is scaled by; none where it loses Russian roulette, because it weighs little.
    fn roulette(&self, sight: &Sight, material: &Material, sampler: Sampler) -> Option<f64> {
        let survive = sight.weight * color::mean(material.diffuse + material.diffuse_transmission) / WEAK;
        if sight.depth == 0 || survive >= 1.0 {
            return Some(1.0);
        }
        (sampler.numbers(10)[0] < survive).then(|| 1.0 / survive)
    }

    fn specular(&self, surface: &Specular, at: &SurfacePoint, sight: &Sight, sampler: Sampler) -> Rgb {
        let mut scale = 1.0;
        if sight.depth >= DEEP {
            if sight.depth >= DEEPEST {
                let perfect: Rgb = surface.perfect().iter().flatten().map(|s| s.weight).sum();
                self.cut(sight.share * color::mean(perfect + surface.glossy_albedo()));
                return Rgb::ZERO;
            }
            if sampler.numbers(6)[0] >= GOES_ON {
                return Rgb::ZERO;
            }
            scale = 1.0 / GOES_ON;
        }
        let sight = &Sight { share: scale * sight.share, ..*sight };
        let perfect = surface.perfect();
        let lobes = perfect.iter().zip([3, 2]).filter_map(|(s, branch)| Some((s.as_ref()?, branch)));
        let mut sum: Rgb = lobes.map(|(s, branch)| self.follow(at, s, sight, sampler.branch(branch))).sum();
        if surface.is_glossy() {
            sum += match self.settings.estimator {
                // Grids within grids would cost n^4 rays: behind the first glossy surface one ray samples the lobe.
                Estimator::Frustum(n) if sight.glossy == 0 => self.frustum(surface, at, n, sight, sampler),
                Estimator::Lobe(n) if sight.glossy == 0 => self.lobe(surface, at, n, sight, sampler),
                _ => self.lobe(surface, at, 1, sight, sampler),
            };
        }
        scale * sum
    }

    /// The ray of one branch, or its Russian roulette.
    fn follow(&self, at: &SurfacePoint, s: &Scatter, sight: &Sight, sampler: Sampler) -> Rgb {
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
        let image = |shared: &Shared| shared.to_mirror.is_none() && self.emitters.is_image_mirror(at.face);
        let shared = sight.shared.filter(image).map(|shared| {
            let length = at.point.distance(sight.origin.as_dvec3());
            Shared { to_mirror: Some(length), ..shared }
        });
        let next = Sight {
            origin: self.visibility.leave(at.face, at.point, side),
            direction: s.direction,
            from: at.face,
            depth: sight.depth + 1,
            weight: weight.max(WEAK),
            share: sight.share * color::mean(scale),
            shared,
            ..*sight
        };
        scale * self.see(&next, sampler)
    }

    /// The paper's estimator of a glossy lobe: a grid over nearly all of it, and a ray for the rest.
    fn frustum(&self, surface: &Specular, at: &SurfacePoint, n: u32, sight: &Sight, sampler: Sampler) -> Rgb {
        let (frame, _) = surface.local();
        let cells = lobe::frustum(surface, n, |cell| {
            let u = sampler.branch(4 + 16 * cell).numbers(3);
            (u[0], u[1])
        });
        let mut sum = Rgb::ZERO;
        for (k, (direction, weight)) in cells.iter().enumerate() {
            let direction = frame.to_scene(*direction);
            if let Some(mut next) = self.glossy(at, direction, surface, sight, None) {
                next.share *= color::mean(*weight);
                sum += *weight * self.see(&next, sampler.branch(5 + 16 * k as u32));
            }
        }
        sum
    }

    /// Importance sampling of a glossy lobe with `n` rays, sharing emitters with their own samples.
    fn lobe(&self, surface: &Specular, at: &SurfacePoint, n: u32, sight: &Sight, sampler: Sampler) -> Rgb {
        let samples = if self.emitters.is_empty() { 0 } else { self.settings.emitter_samples.min(n.max(1)) };
        let mut sum = Rgb::ZERO;
        for k in 0..n {
            let u = sampler.split(3, k, n);
            let Some(s) = surface.sample_glossy([u[0], u[1], u[2]]) else { continue };
            let shared = (samples > 0).then_some(Shared {
                density: s.density,
                rays: f64::from(n),
                samples: f64::from(samples),
                to_mirror: None,
            });
            let Some(mut next) = self.glossy(at, s.direction, surface, sight, shared) else { continue };
            let mut scale = s.weight / f64::from(n);
            if next.weight < WEAK {
                let survive = (next.weight / WEAK).max(1e-3);
                if u[3] >= survive {
                    continue;
                }
                scale /= survive;
                next.weight = WEAK;
            }
            next.share *= color::mean(scale);
            sum += scale * self.see(&next, sampler.branch_split(6, k, n));
        }
        for k in 0..samples {
            sum += self.emitters_in_lobe(surface, at, (n, samples), sampler.split(4, k, samples));
        }
        sum
    }

    /// One of `samples` samples of the emitters, straight and by their mirror images, in a glossy lobe that `rays` rays
    /// sample too; `u` in [0, 1)^3.
    fn emitters_in_lobe(
        &self,
        surface: &Specular,
        at: &SurfacePoint,
        (rays, samples): (u32, u32),
        u: [f64; 4],
    ) -> Rgb {
        let Some(sample) = self.emitters.sample([u[2], u[0], u[1]]) else { return Rgb::ZERO };
        let (rays, samples) = (f64::from(rays), f64::from(samples));
        let weigh = |c: &Connection, side: DVec3| {
            let (value, density) = surface.glossy(c.direction);
            // Shading and geometric normal must agree about the side.
            if value == Rgb::ZERO || surface.is_below(c.direction) != (side != at.geometric) {
                return Rgb::ZERO;
            }
            let share = mis_share(samples, c.density, rays, density);
            value * c.irradiance * (share / (c.direction.dot(side) * samples))
        };
        let mut sum = Rgb::ZERO;
        let sides: &[f64] = if surface.is_glass() { &[1.0, -1.0] } else { &[1.0] };
        for side in sides.iter().map(|sign| *sign * at.geometric) {
            let origin = self.visibility.leave(at.face, at.point, side);
            if let Some(c) = connect(at.point, side, &sample) {
                let light = weigh(&c, side);
                let segment = self.visibility.segment(origin, sample.face, sample.point, sample.normal);
                if light.max_element() > 0.0 {
                    self.cast(1);
                    if self.visibility.unoccluded(&segment) {
                        sum += light;
                    }
                }
            }
            if self.emitters.has_images() {
                self.emitters.images(self.scene, at.point, side, &sample, |mirror, window, c| {
                    let light = weigh(&c, side);
                    if light.max_element() > 0.0 {
                        self.cast(2);
                        if self.emitters.image_visible(self.visibility, origin, mirror, window, &sample) {
                            sum += light;
                        }
                    }
                });
            }
        }
        sum
    }

    /// The view ray of one direction of a glossy lobe; none where the face lies in its way.
    fn glossy(
        &self,
        at: &SurfacePoint,
        direction: DVec3,
        surface: &Specular,
        sight: &Sight,
        shared: Option<Shared>,
    ) -> Option<Sight> {
        let transmitted = surface.is_below(direction);
        let side = if transmitted { -at.geometric } else { at.geometric };
        (direction.dot(side) > 0.0).then(|| Sight {
            origin: self.visibility.leave(at.face, at.point, side),
            direction,
            from: at.face,
            depth: sight.depth + 1,
            weight: sight.weight * color::mean(surface.glossy_albedo()),
            share: sight.share,
            glossy: sight.glossy + 1,
            fine: sight.fine && surface.alpha() < WIDE,
            shared,
        })
    }
}
