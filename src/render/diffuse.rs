//! Diffuse light at a point of a view: interpolated, or sampled anew.

use super::{Context, Method, Quality, Sampler};
use crate::color::Rgb;
use crate::embree::{Ray, RayPacket, ShadowPacket};
use crate::emitters::{Passage, connect, cosine_density, mis_share};
use crate::form_factor::{Carried, Chains, Link};
use crate::geometry::Frame;
use crate::radiosity::Field;
use crate::sampling::cosine_hemisphere;
use crate::scene::Material;
use crate::visibility::{SurfaceHit, SurfacePoint};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

impl Context<'_, '_> {
    /// Radiance that leaves a point by diffuse reflection and transmission [W m^-2 sr^-1].
    ///
    /// `normal` is the shading normal on the side seen. `fine` asks for the method's own quality; otherwise
    /// interpolated radiosity will do (behind a wide lobe, say).
    pub(super) fn diffuse(
        &self,
        material: &Material,
        at: &SurfacePoint,
        normal: DVec3,
        sampler: Sampler,
        fine: bool,
    ) -> Rgb {
        let quality = match self.settings.method {
            Method::TwoPass(Quality::Mesh) | Method::Radiosity => Quality::Mesh,
            Method::TwoPass(Quality::Gather) if fine => Quality::Gather,
            Method::TwoPass(_) if !fine => Quality::Mesh,
            _ => Quality::Direct,
        };
        let read = |field: Option<&Field>| self.read(field, at.face, at.front, at.u, at.v);
        let mapped = || {
            let map = self.solution.and_then(|s| s.caustic_map.as_ref());
            map.and_then(|m| m.at((at.face, at.front), at.u, at.v)).unwrap_or(Rgb::ZERO)
        };
        let sampled = |gather: bool| {
            let mut r = Rgb::ZERO;
            if material.diffuse != Rgb::ZERO {
                r += material.diffuse * self.irradiance(at, at.geometric, normal, sampler, gather);
            }
            if material.is_translucent() {
                let behind = self.irradiance(at, -at.geometric, -normal, sampler.branch(7), gather);
                r += material.diffuse_transmission * behind;
            }
            r
        };
        let radiosity = match quality {
            Quality::Mesh => read(self.solution.map(|s| &s.reflected)),
            Quality::Direct => read(self.solution.map(|s| &s.indirect)) + mapped() + sampled(false),
            Quality::Gather => {
                read(self.solution.and_then(|s| s.caustic.as_ref())) + mapped() + sampled(true)
            }
        };
        radiosity / PI
    }

    /// A field's value, zero where there is none.
    fn read(&self, field: Option<&Field>, face: u32, front: bool, u: f32, v: f32) -> Rgb {
        match (field, self.solution) {
            (Some(f), Some(s)) => f.at(&s.mesh, &s.nodes, (face, front), u, v).unwrap_or(Rgb::ZERO),
            _ => Rgb::ZERO,
        }
    }

    /// Irradiance at a point on the side of `side`: from emitters and their images and, with `gather`,
    /// from the whole hemisphere about `normal` [W m^-2].
    fn irradiance(
        &self,
        at: &SurfacePoint,
        side: DVec3,
        normal: DVec3,
        sampler: Sampler,
        gather: bool,
    ) -> Rgb {
        let origin = self.visibility.leave(at.face, at.point, side);
        let hemisphere = if gather { self.settings.gather_rays } else { 0 };
        let mut sum = self.light_from_emitters(at, origin, normal, sampler, hemisphere);
        if gather {
            sum += self.light_from_hemisphere(at, origin, normal, sampler);
        }
        sum
    }

    /// Irradiance by samples of the emitters, sharing the work with `hemisphere` rays.
    fn light_from_emitters(
        &self,
        at: &SurfacePoint,
        origin: Vec3,
        normal: DVec3,
        sampler: Sampler,
        hemisphere: u32,
    ) -> Rgb {
        let count = self.settings.emitter_samples;
        if self.emitters.is_empty() || count == 0 {
            return Rgb::ZERO;
        }
        let share = |density: f64, cos: f64| {
            mis_share(f64::from(count), density, f64::from(hemisphere), cosine_density(cos))
        };
        let mut sum = Rgb::ZERO;
        let mut packet = ShadowPacket::new();
        let mut pending = [Rgb::ZERO; 16];
        let mut used = 0;
        for k in 0..count {
            let u = sampler.split(1, k, count);
            let Some(sample) = self.emitters.sample(self.scene, [u[2], u[0], u[1]]) else { break };
            if let Some(c) = connect(at.point, normal, &sample) {
                packet.set(used, &self.visibility.segment(origin, sample.face, sample.point, sample.normal));
                pending[used] = c.irradiance * share(c.density, c.direction.dot(normal));
                used += 1;
            }
            if self.emitters.has_images() {
                self.emitters.images(self.scene, at.point, normal, &sample, |mirror, window, c| {
                    if self.emitters.image_visible(self.visibility, origin, mirror, window, &sample) {
                        sum += c.irradiance * share(c.density, c.direction.dot(normal));
                    }
                });
            }
            if used == 16 || (k + 1 == count && used > 0) {
                self.cast(used as u32);
                let blocked = self.visibility.occluded16(&mut packet, false);
                sum += (0..used).filter(|k| blocked >> k & 1 == 0).map(|k| pending[k]).sum::<Rgb>();
                packet.clear();
                used = 0;
            }
        }
        sum / f64::from(count)
    }

    /// Irradiance by cosine-weighted rays that read reflected radiosity where they land.
    fn light_from_hemisphere(&self, at: &SurfacePoint, origin: Vec3, normal: DVec3, sampler: Sampler) -> Rgb {
        let count = self.settings.gather_rays;
        let frame = Frame::new(normal);
        let chains = Chains::new(self.visibility, Some(self.emitters));
        let mut sum = Rgb::ZERO;
        let mut packet = RayPacket::new();
        let mut lanes = [Vec3::ZERO; 16];
        for base in (0..count).step_by(16) {
            let n = (count - base).min(16);
            packet.clear();
            for k in 0..n {
                let u = sampler.split(2, base + k, count);
                let d = frame.to_scene(cosine_hemisphere(u[0], u[1])).as_vec3();
                lanes[k as usize] = d;
                packet.set(k as usize, &Ray::new(origin, d));
            }
            self.cast(n);
            self.visibility.closest16(&mut packet, false);
            for (k, &direction) in lanes.iter().enumerate().take(n as usize) {
                let Some(hit) = self.visibility.lane(&packet, k, origin, direction, at.face) else {
                    sum += self.scene.environment;
                    continue;
                };
                let first = direction.as_dvec3();
                let length = || self.visibility.point(&hit).point.distance(origin.as_dvec3());
                sum += self.arriving(&hit, Rgb::ONE, Passage::Straight, length, first, first.dot(normal));
                let material = self.scene.material(&self.scene.faces[hit.face as usize]);
                if material.is_specular() && (hit.front || material.two_sided) {
                    let number = sampler.index.wrapping_mul(count).wrapping_add(base + k as u32);
                    let end = chains.follow(
                        Carried::Radiance,
                        (origin, direction, hit),
                        (number, sampler.branch(9).seed),
                        |link: &Link| {
                            let Link { hit, weight, passage, length, direction } = *link;
                            sum +=
                                self.arriving(&hit, weight, passage, || length, direction, first.dot(normal));
                        },
                    );
                    self.cast(end.rays);
                    sum += end.escaped * self.scene.environment;
                }
            }
        }
        sum * (PI / f64::from(count.max(1)))
    }

    /// Radiance towards the gathering point from one surface on a hemisphere ray's way: reflected
    /// light, and emission as far as the emitters' own samples leave it.
    fn arriving(
        &self,
        hit: &SurfaceHit,
        weight: Rgb,
        passage: Passage,
        length: impl Fn() -> f64,
        direction: DVec3,
        cos: f64,
    ) -> Rgb {
        let field = self.solution.map(|s| &s.reflected);
        let mut radiance = self.read(field, hit.face, hit.front, hit.u, hit.v) / PI;
        // Emission by longer chains is in the caustic part of the solution.
        if passage != Passage::Chain {
            if let Some((emitted, density)) = self.emitters.at(hit.face, hit.front) {
                let length = length();
                let n = self.scene.faces[hit.face as usize].normal;
                let q = density * length * length / direction.dot(n).abs();
                let (rays, samples) = (self.settings.gather_rays, self.settings.emitter_samples);
                radiance += emitted * mis_share(f64::from(rays), cosine_density(cos), f64::from(samples), q);
            }
        }
        radiance * weight
    }
}
