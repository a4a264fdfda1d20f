//! Camera rays of neighbouring pixels, traced and shaded together.

use super::diffuse::Spot;
use super::view::Sight;
use super::{Context, Quality, Sampler};
use crate::color::Rgb;
use crate::embree::{LANES, RayLanes, RayPacket};
use crate::sampling::{seed_of, unit};
use crate::scene::CameraFrame;
use glam::DVec3;

/// Edge of a block of pixels: its square makes a packet.
pub(super) const BLOCK: u32 = 4;

impl Context<'_, '_> {
    /// Mean radiance over each of at most [`LANES`] pixels of one block [W m^-2 sr^-1].
    ///
    /// The samples of each pixel are those of one low-discrepancy sequence of its own: pixels share an Owen scrambling,
    /// and shift it.
    pub(super) fn block(&self, frame: &CameraFrame, pixels: &[(u32, u32)]) -> [Rgb; LANES] {
        let mut sum = [Rgb::ZERO; LANES];
        let Some(&(x0, y0)) = pixels.first() else { return sum };
        let settings = &self.settings;
        let seeds: Vec<u32> = pixels.iter().map(|(x, y)| seed_of(&[settings.seed, *x, *y, 0x91e])).collect();
        let shifts: Vec<[u32; 3]> = seeds.iter().map(|s| Sampler { seed: *s, index: 0 }.shift(0)).collect();
        let shared = seed_of(&[settings.seed, x0 / BLOCK, y0 / BLOCK, 0xb10c5]);
        let quality = self.quality(true);
        let mut rays = RayLanes { origin: [[0.0; LANES]; 3], direction: [[0.0; LANES]; 3] };
        let mut directions = [DVec3::ZERO; LANES];
        let active = u16::MAX >> (LANES - pixels.len());
        let mut packet = RayPacket::new();
        let mut spots: Vec<Spot> = Vec::with_capacity(LANES);
        let mut lanes = [0; LANES];
        for index in 0..settings.spp {
            let shared = Sampler { seed: shared, index };
            let bits = shared.bits(0);
            for (lane, ((x, y), shift)) in pixels.iter().zip(&shifts).enumerate() {
                let u = [0, 1].map(|d| f64::from(unit(bits[d] ^ shift[d])));
                let (origin, direction) = frame.ray(f64::from(*x) + u[0], f64::from(*y) + u[1]);
                directions[lane] = direction;
                rays.set(lane, origin, direction.as_vec3());
            }
            self.cast(pixels.len() as u32);
            packet.fill(&rays, active);
            self.visibility.closest16(&mut packet, true);
            spots.clear();
            for lane in 0..pixels.len() {
                let (origin, direction) = (rays.origin(lane), directions[lane]);
                let Some(hit) = self.visibility.lane(&packet, lane, origin, direction.as_vec3(), u32::MAX)
                else {
                    sum[lane] += self.scene.environment;
                    continue;
                };
                let sampler = Sampler { seed: seeds[lane], index };
                let (radiance, spot) = self.meet(&Sight::of_camera(origin, direction), &hit, sampler);
                sum[lane] += radiance;
                if let Some(spot) = spot {
                    lanes[spots.len()] = lane;
                    spots.push(spot);
                }
            }
            if !spots.is_empty() {
                debug_assert!(quality != Quality::Mesh);
                let mut found = [Rgb::ZERO; LANES];
                self.diffuse(&spots, shared, quality, &mut found);
                for (lane, radiance) in lanes.iter().zip(&found[..spots.len()]) {
                    sum[*lane] += *radiance;
                }
            }
        }
        sum.map(|s| s / f64::from(settings.spp.max(1)))
    }
}
