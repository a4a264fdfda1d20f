//! Irradiance on elements from samples of the emitters' areas.
//!
//! Few emitters are [`Lamps`]; of them only mirror images are sampled here.

use super::lamps::Lamps;
use crate::color::Rgb;
use crate::embree::ShadowPacket;
use crate::emitters::{Emitters, Passage, connect, cosine_density, mis_share};
use crate::form_factor::{EmitterIrradiance, EmitterRows};
use crate::mesh::Mesh;
use crate::sampling::{SobolTable, seed_of, sobol};
use crate::visibility::Visibility;

/// Samples the emitters from every element: `per_batch` pairs of points for each of `batches`
/// independent randomisations. Adds to `light` what these find beside the `rays` hemisphere rays of an
/// element (power heuristic).
pub fn sample_emitters(
    visibility: &Visibility,
    mesh: &Mesh,
    emitters: &Emitters,
    (batches, per_batch): (u32, u32),
    rays: u32,
    seed: u32,
    light: &mut EmitterRows,
) {
    let lamps = Lamps::of(visibility, mesh, emitters);
    if let Some(lamps) = &lamps {
        let table = SobolTable::new(per_batch);
        light.add(|element| lamps.light(element, (batches, &table), seed));
    }
    let straight = lamps.is_none();
    if straight || emitters.has_images() {
        let sampler =
            Sampler { visibility, mesh, emitters, straight, rays, samples: batches * per_batch, seed };
        light.add(|element| {
            (0..batches).map(|batch| sampler.batch(element, batch, per_batch)).collect::<Vec<_>>()
        });
    }
}

struct Sampler<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    emitters: &'a Emitters,
    /// Straight light counts too, beside that of mirror images.
    straight: bool,
    rays: u32,
    samples: u32,
    seed: u32,
}

impl Sampler<'_, '_> {
    fn batch(&self, element: u32, batch: u32, count: u32) -> EmitterIrradiance {
        let scene = self.visibility.scene();
        let place = self.mesh.place_of(scene, element);
        let (face, normal) = (place.face, place.normal);
        let seed = seed_of(&[self.seed, element, batch, 0xe817]);
        let mut sum = EmitterIrradiance::default();
        let mut packet = ShadowPacket::new();
        let mut pending = [crate::color::Rgb::ZERO; 16];
        let mut used = 0;
        let flush =
            |packet: &mut ShadowPacket, pending: &[crate::color::Rgb], sum: &mut EmitterIrradiance| {
                let blocked = self.visibility.occluded16(packet, false);
                for (k, irradiance) in pending.iter().enumerate() {
                    if blocked >> k & 1 == 0 {
                        sum.add(Passage::Straight, *irradiance);
                    }
                }
                packet.clear();
            };
        for k in 0..count {
            let (p, q) = (sobol(k, 0, seed), sobol(k, 1, seed));
            let point = self.visibility.start(&place, p[0], p[1]);
            let Some(sample) = self.emitters.sample([q[0], p[2], p[3]]) else { break };
            let share = |c: &crate::emitters::Connection| {
                mis_share(
                    f64::from(self.samples),
                    c.density,
                    f64::from(self.rays),
                    cosine_density(c.direction.dot(normal)),
                )
            };
            if let Some(c) = connect(point, normal, &sample).filter(|_| self.straight) {
                let origin = self.visibility.leave(face, point, normal);
                packet.set(used, &self.visibility.segment(origin, sample.face, sample.point, sample.normal));
                pending[used] = c.irradiance * share(&c);
                used += 1;
                if used == 16 {
                    flush(&mut packet, &pending, &mut sum);
                    used = 0;
                }
            }
            if self.emitters.has_images() {
                let origin = self.visibility.leave(face, point, normal);
                self.emitters.images(scene, point, normal, &sample, |mirror, window, c| {
                    if self.emitters.image_visible(self.visibility, origin, mirror, window, &sample) {
                        sum.add(Passage::Image, c.irradiance * share(&c));
                    }
                });
            }
        }
        if used > 0 {
            flush(&mut packet, &pending[..used], &mut sum);
        }
        sum * Rgb::splat(1.0 / f64::from(count.max(1)))
    }
}
