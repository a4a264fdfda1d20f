//! The reference: unbiased path tracing with next-event estimation.

use super::{Context, Sampler};
use crate::bsdf::Specular;
use crate::color::{self, Rgb};
use crate::emitters::{Passage, connect, cosine_density, mis_share};
use crate::form_factor::pass_on;
use crate::geometry::Frame;
use crate::sampling::cosine_hemisphere;
use crate::scene::Material;
use crate::visibility::SurfacePoint;
use glam::{DVec3, Vec3};

/// Paths longer than this play Russian roulette.
const SURE: u32 = 4;
/// No path is longer; facing perfect mirrors of albedo 1 alone come near.
const LONGEST: u32 = 10_000;

/// Shares of the ways on from a surface, and its lobes without the perfect ones.
struct Surface<'m> {
    material: &'m Material,
    specular: Specular<'m>,
    normal: DVec3,
    /// Probabilities of diffuse reflection, diffuse transmission and the specular lobes.
    choice: [f64; 3],
    /// Probability of a specular lobe that has a width.
    glossy: f64,
}

impl<'m> Surface<'m> {
    fn new(material: &'m Material, at: &SurfacePoint, wo: DVec3) -> Option<Surface<'m>> {
        let specular = if material.is_specular() { pass_on(material) } else { Rgb::ZERO };
        let weights = [material.diffuse, material.diffuse_transmission, specular].map(color::mean);
        let total: f64 = weights.iter().sum();
        let normal = at.facing(wo);
        let specular = Specular::new(material, wo, normal, at.geometric, at.front);
        let choice = weights.map(|w| w / total);
        let glossy = if material.is_specular() { choice[2] * specular.chance_of_glossy() } else { 0.0 };
        (total > 0.0).then_some(Surface { material, specular, normal, choice, glossy })
    }

    /// Light comes through the surface in directions that emitter samples can find.
    fn scatters_through(&self) -> bool {
        self.material.is_translucent() || (self.glossy > 0.0 && self.material.is_glass())
    }

    /// Scattering function times cosine towards `wi`, perfect lobes left out [sr^-1], and the density with which
    /// a path goes on towards `wi`, these left out too [sr^-1].
    fn evaluate(&self, wi: DVec3) -> (Rgb, f64) {
        let cos = wi.dot(self.normal);
        let (albedo, chance) = if cos < 0.0 {
            (self.material.diffuse_transmission, self.choice[1])
        } else {
            (self.material.diffuse, self.choice[0])
        };
        let diffuse = cosine_density(cos.abs());
        let (mut f, mut p) = (albedo * diffuse, chance * diffuse);
        if self.glossy > 0.0 {
            let (value, density) = self.specular.glossy(wi);
            f += value;
            p += self.glossy * density;
        }
        (f, p)
    }
}

impl Context<'_, '_> {
    /// Radiance along a camera ray, one path [W m^-2 sr^-1].
    pub(super) fn path(&self, origin: Vec3, direction: DVec3, sampler: Sampler) -> Rgb {
        let (mut origin, mut direction, mut from) = (origin, direction, u32::MAX);
        let mut throughput = Rgb::ONE;
        let mut radiance = Rgb::ZERO;
        // Density of the last direction that emitter samples could have found too, how the path
        // went since, and its length since.
        let mut sampled: Option<f64> = None;
        let mut passage = Passage::Straight;
        let mut length = 0.0;
        for depth in 0..LONGEST {
            // The path's own ray and its emitter sample's.
            self.cast(2);
            let Some(hit) = self.visibility.closest(origin, direction.as_vec3(), from) else {
                return radiance + throughput * self.scene.environment;
            };
            let at = self.visibility.point(&hit);
            let material = self.scene.material(&self.scene.faces[hit.face as usize]);
            length += at.point.distance(origin.as_dvec3());
            if let Some((emitted, density)) = self.emitters.at(hit.face, hit.front) {
                let share = match sampled {
                    Some(p) if passage != Passage::Chain => {
                        mis_share(1.0, p, 1.0, density * length * length / direction.dot(at.geometric).abs())
                    }
                    _ => 1.0,
                };
                radiance += throughput * emitted * share;
            }
            if !hit.front && !material.two_sided {
                return radiance;
            }
            let wo = -direction;
            let Some(surface) = Surface::new(material, &at, wo) else { return radiance };
            let numbers = sampler.branch(depth);
            if material.is_diffuse() || surface.glossy > 0.0 {
                radiance += throughput * self.next_event(&surface, &at, numbers.numbers(1));
            }
            let u = numbers.numbers(2);
            let mut side = at.geometric;
            if u[3] >= surface.choice[0] + surface.choice[1] {
                let Some(s) = surface.specular.sample([u[0], u[1], u[2]]) else { return radiance };
                if (s.direction.dot(at.geometric) > 0.0) == s.transmitted {
                    return radiance;
                }
                direction = s.direction;
                if s.transmitted {
                    side = -side;
                }
                if s.density.is_infinite() {
                    throughput *= s.weight / surface.choice[2];
                    let image = self.emitters.is_image_mirror(at.face);
                    passage =
                        if passage == Passage::Straight && image { Passage::Image } else { Passage::Chain };
                } else {
                    let (value, p) = surface.evaluate(direction);
                    if p <= 0.0 {
                        return radiance;
                    }
                    throughput *= value / p;
                    (sampled, passage, length) = (Some(p), Passage::Straight, 0.0);
                }
            } else {
                let transmitted = u[3] >= surface.choice[0];
                let sign = if transmitted { -1.0 } else { 1.0 };
                let local = cosine_hemisphere(u[0], u[1]);
                let frame = Frame::new(surface.normal);
                direction = frame.to_scene(DVec3::new(local.x, local.y, sign * local.z));
                side *= sign;
                if direction.dot(side) <= 0.0 {
                    return radiance;
                }
                let (value, p) = surface.evaluate(direction);
                // Exactly grazing: such a direction carries nothing.
                if p <= 0.0 {
                    return radiance;
                }
                throughput *= value / p;
                (sampled, passage, length) = (Some(p), Passage::Straight, 0.0);
            }
            if depth >= SURE {
                let survive = throughput.max_element().min(0.99);
                if survive <= 0.0 || numbers.numbers(3)[0] >= survive {
                    return radiance;
                }
                throughput /= survive;
            }
            origin = self.visibility.leave(at.face, at.point, side);
            from = at.face;
        }
        radiance
    }

    /// Light from one emitter sample, straight and by its mirror images, over all but the perfect lobes.
    fn next_event(&self, surface: &Surface, at: &SurfacePoint, u: [f64; 4]) -> Rgb {
        let Some(sample) = self.emitters.sample([u[2], u[0], u[1]]) else { return Rgb::ZERO };
        let mut sum = Rgb::ZERO;
        let sides: &[f64] = if surface.scatters_through() { &[1.0, -1.0] } else { &[1.0] };
        for &sign in sides {
            let (normal, side) = (sign * surface.normal, sign * at.geometric);
            let origin = self.visibility.leave(at.face, at.point, side);
            let weigh = |c: &crate::emitters::Connection| {
                let cos = c.direction.dot(normal);
                let (value, density) = surface.evaluate(c.direction);
                c.irradiance * (value / cos) * mis_share(1.0, c.density, 1.0, density)
            };
            if let Some(c) = connect(at.point, normal, &sample) {
                let value = weigh(&c);
                if value.max_element() > 0.0
                    && c.direction.dot(side) > 0.0
                    && self.visibility.unoccluded(&self.visibility.segment(
                        origin,
                        sample.face,
                        sample.point,
                        sample.normal,
                    ))
                {
                    sum += value;
                }
            }
            if self.emitters.has_images() {
                self.emitters.images(self.scene, at.point, normal, &sample, |mirror, window, c| {
                    if self.emitters.image_visible(self.visibility, origin, mirror, window, &sample) {
                        sum += weigh(&c);
                    }
                });
            }
        }
        sum
    }
}
