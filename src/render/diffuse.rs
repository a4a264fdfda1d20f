//! Diffuse light at points of a view: interpolated, or sampled anew for up to 16 points together.
//!
//! Neighbouring pixels share packets: the same sample of each goes into one lane, in nearly the same direction. As in
//! pass 1 ([`crate::form_factor`]), they share one Owen scrambling of their points and shift them by bits of their
//! own (exclusive or), below the leading bits that [`cell_bits`] allows. So each has the points that it would have
//! alone, and the errors of neighbours are uncorrelated.

use super::guide::Guide;
use super::landing::{EMITTER, SPECULAR};
use super::{Context, Method, Quality, Sampler};
use crate::color::{self, Rgb};
use crate::embree::{LANES, RayLanes, RayPacket, ShadowPacket};
use crate::emitters::{Passage, connect, cosine_density, mis_share};
use crate::form_factor::{Carried, Chains, Link};
use crate::geometry::Frame;
use crate::sampling::{cell_bits, cosine_hemisphere_rough, sobol_bits, unit};
use crate::scene::Material;
use crate::visibility::{SurfaceHit, SurfacePoint};
use glam::{DVec3, Vec3};
use pulp::{Simd, WithSimd};
use std::f64::consts::{FRAC_1_PI, PI};

/// A point on a diffuse surface whose light is to be found.
#[derive(Clone, Copy)]
pub(super) struct Spot<'m> {
    /// Its material.
    pub material: &'m Material,
    /// Where.
    pub at: SurfacePoint,
    /// Shading normal on the side seen.
    pub normal: DVec3,
    /// Numbers of its own.
    pub sampler: Sampler,
    /// What its light is multiplied by.
    pub scale: f64,
}

/// One side of a spot, over which light arrives.
#[derive(Clone, Copy)]
struct Receiver<'g> {
    face: u32,
    point: DVec3,
    origin: Vec3,
    normal: DVec3,
    /// Normal of the face, where the other one is a shading normal: no light comes from below it.
    geometric: Option<DVec3>,
    sampler: Sampler,
    /// What its irradiance is multiplied by.
    albedo: f64,
    /// Where its light comes from, as far as that is known.
    guide: Option<&'g Guide>,
}

/// [`Context::light_from_hemisphere`], compiled for wide registers too, as in pass 1.
struct FromHemisphere<'r, 'a, 's> {
    context: &'r Context<'a, 's>,
    receivers: &'r [Receiver<'r>],
    shared: Sampler,
    irradiance: &'r mut [Rgb; LANES],
}

impl WithSimd for FromHemisphere<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.context.light_from_hemisphere(simd, self.receivers, self.shared, self.irradiance);
    }
}

impl Context<'_, '_> {
    /// Where the method takes diffuse light from. `fine` asks for the method's own quality; otherwise
    /// interpolated radiosity will do (behind a wide lobe, say).
    pub(super) fn quality(&self, fine: bool) -> Quality {
        match self.settings.method {
            Method::TwoPass(Quality::Mesh) | Method::Radiosity => Quality::Mesh,
            Method::TwoPass(Quality::Gather) if fine => Quality::Gather,
            Method::TwoPass(_) if !fine => Quality::Mesh,
            _ => Quality::Direct,
        }
    }

    /// Radiance that leaves points (at most [`LANES`]) by diffuse reflection and transmission, sampled anew as `quality` says
    /// [W m^-2 sr^-1]. `shared` has the numbers that they have in common, at the index of their own.
    pub(super) fn diffuse(
        &self,
        spots: &[Spot],
        shared: Sampler,
        quality: Quality,
        found: &mut [Rgb; LANES],
    ) {
        let gather = quality == Quality::Gather;
        let map = self.solution.and_then(|s| s.caustic_map.as_ref());
        for (spot, sum) in spots.iter().zip(found.iter_mut()) {
            let at = &spot.at;
            let hit = SurfaceHit { face: at.face, u: at.u, v: at.v, front: at.front };
            *sum = self.read(|s| if gather { s.caustic.as_ref() } else { Some(&s.indirect) }, &hit);
            *sum += map.and_then(|m| m.at((at.face, at.front), at.u, at.v)).unwrap_or(Rgb::ZERO);
        }
        let reflecting = |m: &Material| m.diffuse;
        self.reflected(spots, 1.0, reflecting, shared, gather, found);
        if spots.iter().any(|s| s.material.is_translucent()) {
            let passing = |m: &Material| m.diffuse_transmission;
            self.reflected(spots, -1.0, passing, shared.branch(7), gather, found);
        }
        found.iter_mut().zip(spots).for_each(|(sum, spot)| *sum *= FRAC_1_PI * spot.scale);
    }

    /// Adds the radiosity by light on the side seen (`side` 1) or the other one (-1), `albedo` times the irradiance.
    fn reflected(
        &self,
        spots: &[Spot],
        side: f64,
        albedo: impl Fn(&Material) -> Rgb,
        shared: Sampler,
        gather: bool,
        found: &mut [Rgb; LANES],
    ) {
        let lit = |s: &&Spot| albedo(s.material) != Rgb::ZERO;
        let receivers: Vec<Receiver> = spots
            .iter()
            .filter(lit)
            .map(|s| Receiver {
                face: s.at.face,
                point: s.at.point,
                origin: self.visibility.leave(s.at.face, s.at.point, side * s.at.geometric),
                normal: side * s.normal,
                geometric: (s.normal != s.at.geometric).then(|| side * s.at.geometric),
                sampler: if side > 0.0 { s.sampler } else { s.sampler.branch(7) },
                albedo: color::mean(albedo(s.material)),
                guide: if gather { self.guide(&s.at, side) } else { None },
            })
            .collect();
        if receivers.is_empty() {
            return;
        }
        let mut irradiance = [Rgb::ZERO; LANES];
        let hemisphere = if gather { self.settings.gather_rays } else { 0 };
        self.light_from_emitters(&receivers, shared, hemisphere, &mut irradiance);
        if gather {
            let irradiance = &mut irradiance;
            self.arch.dispatch(FromHemisphere { context: self, receivers: &receivers, shared, irradiance });
        }
        let lit = spots.iter().zip(found.iter_mut()).filter(|(s, _)| lit(s));
        lit.zip(irradiance).for_each(|((s, sum), h)| *sum += albedo(s.material) * h);
    }

    /// Adds irradiance by samples of the emitters, sharing the work with `hemisphere` rays.
    fn light_from_emitters(
        &self,
        receivers: &[Receiver],
        shared: Sampler,
        hemisphere: u32,
        irradiance: &mut [Rgb; LANES],
    ) {
        let count = self.settings.emitter_samples;
        if self.emitters.is_empty() || count == 0 {
            return;
        }
        let share = |density: f64, cos: f64| {
            mis_share(f64::from(count), density, f64::from(hemisphere), cosine_density(cos))
        };
        let numbers = Numbers::new(receivers, shared, (1, count), self.settings.spp);
        let mut sum = [Rgb::ZERO; LANES];
        let mut packet = ShadowPacket::new();
        let mut pending = [Rgb::ZERO; LANES];
        for base in (0..count).step_by(numbers.points()) {
            let points = numbers.of(base, count);
            packet.clear();
            let mut active = 0u16;
            for lane in numbers.lanes(count - base) {
                let r = numbers.receiver(lane);
                let &Receiver { point, origin, normal, .. } = &receivers[r];
                let u = points.map(|p| f64::from(p[lane]));
                let Some(sample) = self.emitters.sample([u[2], u[0], u[1]]) else { return };
                if let Some(c) = connect(point, normal, &sample) {
                    let segment = self.visibility.segment(origin, sample.face, sample.point, sample.normal);
                    packet.set(lane, &segment);
                    pending[lane] = c.irradiance * share(c.density, c.direction.dot(normal));
                    active |= 1 << lane;
                }
                if self.emitters.has_images() {
                    self.emitters.images(self.scene, point, normal, &sample, |mirror, window, c| {
                        if self.emitters.image_visible(self.visibility, origin, mirror, window, &sample) {
                            sum[r] += c.irradiance * share(c.density, c.direction.dot(normal));
                        }
                    });
                }
            }
            if active != 0 {
                self.cast(active.count_ones());
                // The coherent flag slows these down, whether they go to one lamp or several.
                let blocked = self.visibility.occluded16(&mut packet, false);
                for lane in (0..LANES).filter(|l| active & !blocked & 1 << l != 0) {
                    sum[numbers.receiver(lane)] += pending[lane];
                }
            }
        }
        irradiance.iter_mut().zip(sum).for_each(|(h, s)| *h += s / f64::from(count));
    }

    /// Adds irradiance by cosine-weighted rays that read reflected radiosity where they land.
    #[inline(always)]
    fn light_from_hemisphere<S: Simd>(
        &self,
        simd: S,
        receivers: &[Receiver],
        shared: Sampler,
        irradiance: &mut [Rgb; LANES],
    ) {
        let count = self.settings.gather_rays;
        let numbers = Numbers::new(receivers, shared, (2, count), self.settings.spp);
        let bases = Bases::new(receivers, &numbers);
        let chains = Chains::new(self.visibility, Some(self.emitters));
        let mut sum = [Rgb::ZERO; LANES];
        let mut packet = RayPacket::new();
        let none = self.landings.none();
        for base in (0..count).step_by(numbers.points()) {
            let (points, weights) = self.guided(receivers, &numbers, numbers.of(base, count));
            let rays = bases.rays(&points);
            let active = numbers.lanes(count - base).fold(0u16, |bits, lane| bits | 1 << lane);
            self.cast(active.count_ones());
            packet.fill(&rays, active);
            self.visibility.closest16(&mut packet, rays.is_narrow(active));
            let hits = packet.hits(none);
            let places = self.landings.places(simd, &hits);
            for lane in numbers.lanes(count - base) {
                let r = numbers.receiver(lane);
                let &Receiver { face, origin, normal, geometric, sampler, albedo, .. } = &receivers[r];
                // Such a ray starts above the face and would go on through it.
                if geometric.is_some_and(|n| rays.direction(lane).as_dvec3().dot(n) <= 0.0) {
                    continue;
                }
                if hits.face[lane] != face && hits.face[lane] != none && places.kind[lane] == 0 {
                    sum[r] += f64::from(weights[lane]) * self.interpolated_at(&places, lane);
                    continue;
                }
                let direction = rays.direction(lane);
                let radiance = match self.visibility.lane(&packet, lane, origin, direction, face) {
                    None => self.scene.environment,
                    Some(hit) => {
                        let number =
                            sampler.index.wrapping_mul(count).wrapping_add(numbers.point(lane, base));
                        let ray = (origin, direction, hit);
                        self.arriving(&chains, ray, (normal, albedo), (number, sampler.branch(9).seed))
                    }
                };
                sum[r] += f64::from(weights[lane]) * radiance;
            }
        }
        let scale = PI / f64::from(count.max(1));
        irradiance.iter_mut().zip(sum).for_each(|(h, s)| *h += s * scale);
    }

    /// Points of a packet's lanes moved to where their receivers' light comes from, and what the rays then weigh.
    #[inline(always)]
    fn guided(
        &self,
        receivers: &[Receiver],
        numbers: &Numbers,
        mut points: [[f32; LANES]; 3],
    ) -> ([[f32; LANES]; 3], [f32; LANES]) {
        let mut weights = [1.0; LANES];
        if self.guides.is_some() {
            for lane in 0..LANES {
                if let Some(guide) = receivers.get(numbers.receiver(lane)).and_then(|r| r.guide) {
                    ([points[0][lane], points[1][lane]], weights[lane]) =
                        guide.warp(points[0][lane], points[1][lane]);
                }
            }
        }
        (points, weights)
    }

    /// Radiance that a hemisphere ray from a point with this normal and albedo brings from where it met a surface, of emission as far as
    /// the emitters' own samples leave it [W m^-2 sr^-1]. The point and the seed name random numbers.
    #[inline(always)]
    pub(super) fn arriving(
        &self,
        chains: &Chains,
        (origin, direction, hit): (Vec3, Vec3, SurfaceHit),
        (normal, albedo): (DVec3, f64),
        random: (u32, u32),
    ) -> Rgb {
        let kind = self.landings.kind(&hit);
        let mut radiance = self.interpolated(&hit);
        if kind == 0 {
            return radiance;
        }
        let first = direction.as_dvec3();
        if kind & EMITTER != 0 {
            let length = self.visibility.point(&hit).point.distance(origin.as_dvec3());
            radiance += self.emitted(&hit, length, first, first.dot(normal));
        }
        if kind & SPECULAR != 0 {
            let end =
                chains.follow(Carried::Radiance, (origin, direction, hit), random, albedo, |link: &Link| {
                    let Link { hit, weight, passage, length, direction } = *link;
                    let mut found = self.interpolated(&hit);
                    // Emission by longer chains is in the caustic part of the solution.
                    if passage != Passage::Chain {
                        found += self.emitted(&hit, length, direction, first.dot(normal));
                    }
                    radiance += weight * found;
                });
            self.cast(end.rays);
            radiance += end.escaped * self.scene.environment;
        }
        radiance
    }

    /// Emission of a surface on a hemisphere ray's way, as far as the emitters' own samples leave it. `length` is that of the
    /// way, `direction` its last one, `cos` the first one's cosine at the receiver.
    fn emitted(&self, hit: &SurfaceHit, length: f64, direction: DVec3, cos: f64) -> Rgb {
        let Some((emitted, density)) = self.emitters.at(hit.face, hit.front) else { return Rgb::ZERO };
        let n = self.scene.faces[hit.face as usize].normal;
        let q = density * length * length / direction.dot(n).abs();
        let (rays, samples) = (self.settings.gather_rays, self.settings.emitter_samples);
        emitted * mis_share(f64::from(rays), cosine_density(cos), f64::from(samples), q)
    }
}

/// Numbers of receivers, spread over the lanes of packets: with m of them (rounded up to a power of two, the rest idle), lane l
/// has receiver l mod m and the (l / m)-th of the points that are due.
struct Numbers {
    receivers: usize,
    width: usize,
    /// Seed of the points that all share, and the first one's index.
    seed: u32,
    first: u32,
    shift: [[u32; LANES]; 3],
}

impl Numbers {
    /// `count` points in the dimensions of `set`, for each of `spp` samples.
    fn new(receivers: &[Receiver], shared: Sampler, (set, count): (u32, u32), spp: u32) -> Numbers {
        let width = receivers.len().next_power_of_two();
        let [a, b] = cell_bits(count.saturating_mul(spp));
        let mut shift = [[0; LANES]; 3];
        for lane in 0..LANES {
            if let Some(receiver) = receivers.get(lane & (width - 1)) {
                let own = receiver.sampler.shift(set);
                shift.iter_mut().zip(own).zip([a, b, 0]).for_each(|((s, own), c)| s[lane] = own >> c);
            }
        }
        let first = shared.index.wrapping_mul(count);
        Numbers { receivers: receivers.len(), width, seed: shared.seed_of(set), first, shift }
    }

    /// Points of each receiver that one packet takes.
    fn points(&self) -> usize {
        LANES / self.width
    }

    /// The receiver of a lane.
    #[inline]
    fn receiver(&self, lane: usize) -> usize {
        lane & (self.width - 1)
    }

    /// The point of a lane, in a packet that begins with point `base`.
    #[inline]
    fn point(&self, lane: usize, base: u32) -> u32 {
        base + (lane / self.width) as u32
    }

    /// Lanes that hold a ray, where `left` points are.
    fn lanes(&self, left: u32) -> impl Iterator<Item = usize> + use<> {
        let (mask, receivers) = (self.width - 1, self.receivers);
        let end = self.width * (left as usize).min(self.points());
        (0..end).filter(move |l| l & mask < receivers)
    }

    /// Three numbers in [0, 1) for each lane, from point `base` of `count` on.
    #[inline(always)]
    fn of(&self, base: u32, count: u32) -> [[f32; LANES]; 3] {
        let mut numbers = [[0.0; LANES]; 3];
        for (k, lanes) in (0..LANES).step_by(self.width).enumerate() {
            let point = (base + k as u32).min(count - 1);
            let bits = sobol_bits(self.first.wrapping_add(point), self.seed);
            let lanes = lanes..lanes + self.width;
            for (d, numbers) in numbers.iter_mut().enumerate() {
                let shift = &self.shift[d][lanes.clone()];
                numbers[lanes.clone()].iter_mut().zip(shift).for_each(|(u, s)| *u = unit(bits[d] ^ s));
            }
        }
        numbers
    }
}

/// Origins and frames of receivers by lane.
struct Bases {
    origin: [[f32; LANES]; 3],
    x: [[f32; LANES]; 3],
    y: [[f32; LANES]; 3],
    z: [[f32; LANES]; 3],
}

impl Bases {
    fn new(receivers: &[Receiver], numbers: &Numbers) -> Bases {
        let none = [[0.0; LANES]; 3];
        let mut bases = Bases { origin: none, x: none, y: none, z: none };
        for lane in 0..LANES {
            let Some(receiver) = receivers.get(numbers.receiver(lane)) else { continue };
            let frame = Frame::new(receiver.normal);
            for c in 0..3 {
                bases.origin[c][lane] = receiver.origin[c];
                bases.x[c][lane] = frame.x[c] as f32;
                bases.y[c][lane] = frame.y[c] as f32;
                bases.z[c][lane] = frame.z[c] as f32;
            }
        }
        bases
    }

    /// Cosine-weighted rays.
    #[inline(always)]
    fn rays(&self, [u, v, _]: &[[f32; LANES]; 3]) -> RayLanes {
        let (mut dx, mut dy, mut dz) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        for l in 0..LANES {
            [dx[l], dy[l], dz[l]] = cosine_hemisphere_rough(u[l], v[l]);
        }
        let mut direction = [[0.0; LANES]; 3];
        for (c, d) in direction.iter_mut().enumerate() {
            for l in 0..LANES {
                d[l] = dx[l] * self.x[c][l] + dy[l] * self.y[c][l] + dz[l] * self.z[c][l];
            }
        }
        RayLanes { origin: self.origin, direction }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Estimator, Renderer, Settings, render_pixels};
    use super::*;
    use crate::adaptive;
    use crate::embree::Device;
    use crate::emitters::Emitters;
    use crate::pipeline::{self, Pass1};
    use crate::radiosity::Reads;
    use crate::scene::{Camera, load};
    use crate::visibility::Visibility;
    use pulp::Arch;
    use std::path::Path;

    /// Gathered images do not depend on what the processor can do: with glass and without, on uniform and adaptive elements. Pixels
    /// asked for alone are those of the image.
    #[test]
    fn wide_registers_change_no_pixel() {
        let device = Device::new(1).expect("Embree");
        for (name, adaptive) in [("cornell", false), ("cornell", true), ("glass_ball", false)] {
            let path = format!("{}/scenes/{name}/{name}.toml", env!("CARGO_MANIFEST_DIR"));
            let scene = load(Path::new(&path)).expect("a scene of the project");
            let visibility = Visibility::new(&device, &scene).expect("a tree");
            let emitters = Emitters::new(&visibility);
            let camera = Camera { size: [24, 18], ..scene.camera(None).expect("a camera").clone() };
            let few = Pass1 { rays: 64, element_size: Some(0.1), ..Pass1::of(&scene) };
            let (cameras, stages) = (std::slice::from_ref(&camera), &mut Vec::new());
            let pass1 = if adaptive {
                let reads = (&few, Reads::Indirect);
                adaptive::solve(None, &visibility, &emitters, cameras, reads, &|_| (), stages).map(|s| s.0)
            } else {
                pipeline::solve(&visibility, &emitters, cameras, &few, &|_| (), stages)
            };
            let pass1 = pass1.expect("a solution");
            let settings = Settings {
                method: Method::TwoPass(Quality::Gather),
                spp: 2,
                gather_rays: 12,
                emitter_samples: 1,
                estimator: Estimator::Lobe(1),
                seed: 3,
            };
            let solution = Some(&pass1.solution);
            let mut renderer = Renderer::new(&visibility, &emitters, solution, camera.size, &settings);
            let pixels = |renderer: &Renderer| {
                let image = renderer.render(&camera, &|_| ()).0;
                (0..24 * 18).map(|k| image.get(k % 24, k / 24).map(f32::to_bits)).collect::<Vec<_>>()
            };
            let wide = pixels(&renderer);
            let few: Vec<[u32; 2]> = (0..18).map(|y| [(5 * y) % 24, y]).collect();
            let alone = render_pixels(&visibility, &emitters, solution, (&camera, &few), &settings).0;
            for ([x, y], pixel) in few.into_iter().zip(alone) {
                assert_eq!(
                    pixel.as_vec3().to_array().map(f32::to_bits),
                    wide[(24 * y + x) as usize],
                    "{name} {x} {y}"
                );
            }
            renderer.arch = Arch::Scalar;
            assert!(wide.iter().filter(|p| **p != [0; 3]).count() > 200, "{name}");
            assert!(pixels(&renderer) == wide, "{name}, adaptive {adaptive}");
        }
    }
}
