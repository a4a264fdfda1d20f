//! Rays that do not end where they first land: what they bring over specular chains, and from emitters.

use super::super::gathered::EmitterIrradiance;
use super::super::immersed::Immersed;
use super::super::landing::{ABSORBED, EMITTER, IMMERSED, SPECULAR, UNREACHED};
use super::super::source::Source;
use super::super::specular::{Carried, Link, pass_on};
use super::{AtSpecular, Caster, Scratch};
use crate::color::{self, Rgb};
use crate::emitters::{Passage, cosine_density, mis_share};
use crate::mesh::NONE;
use crate::sampling::seed_of;
use crate::scene::Material;
use crate::visibility::SurfaceHit;
use glam::{DVec3, Vec3};

/// Least share by which chains are weighed.
const LEAST: f64 = 0.02;

impl Caster<'_, '_> {
    /// A ray that met its own face, an emitter, a specular surface, a black one inside of glass or a side that no light can reach;
    /// `at` is the place in the group, the randomisation and the point, `l` the lane of the packet.
    #[cold]
    pub(super) fn beyond(&self, scratch: &mut Scratch, source: &Source, at: (usize, u32, u32), l: usize) {
        let (k, batch, point) = at;
        let (origin, direction) = scratch.packet.ray(l);
        let place = self.place(scratch, k, batch);
        let Some(mut hit) = self.visibility.lane(&scratch.packet, l, origin, direction, source.face) else {
            scratch.fates[place].escaped += 1;
            return;
        };
        let met = self.targets.landing(hit.face, (hit.u, hit.v), direction);
        hit.front = met.front;
        let fate = &mut scratch.fates[place];
        if met.kind & UNREACHED != 0 {
            fate.covered += 1;
            return;
        }
        fate.absorbed += u32::from(met.kind & ABSORBED != 0);
        if met.kind & IMMERSED != 0 {
            fate.index2 += self.targets.index2(hit.face, hit.front) - 1.0;
            fate.inside += 1;
        }
        let index2 = if met.kind & SPECULAR != 0 { self.index2(&hit, direction) } else { 1.0 };
        if index2 != 1.0 {
            fate.index2 += index2 - 1.0;
            fate.inside += 1;
        }
        scratch.landed.set(batch as usize, k, point as usize, met.column);
        if met.kind & (EMITTER | SPECULAR) == 0 {
            return;
        }
        let mut emitted = EmitterIrradiance::default();
        if met.kind & EMITTER != 0 {
            self.emitter(source, origin, direction, &hit, &mut emitted);
        }
        if met.kind & SPECULAR != 0 {
            let seed = seed_of(&[self.casting.seed, source.element, batch]);
            let ray = (origin, direction, hit);
            self.chain(scratch, source, (k, batch), ray, (point, seed), &mut emitted);
        }
        scratch.fates[place].emitted += emitted;
    }

    /// Squared index of the medium that a ray came through to a specular surface; 1 where that is no glass, which tells nothing.
    fn index2(&self, hit: &SurfaceHit, direction: Vec3) -> f64 {
        let scene = self.visibility.scene();
        let bends = scene.material(&scene.faces[hit.face as usize]).bends();
        if bends { self.targets.index2_before(self.visibility, hit, direction) } else { 1.0 }
    }

    /// A hemisphere ray that met an emitter in a straight line.
    fn emitter(
        &self,
        source: &Source,
        origin: Vec3,
        direction: Vec3,
        hit: &SurfaceHit,
        emitted: &mut EmitterIrradiance,
    ) {
        let length = self.visibility.point(hit).point.distance(origin.as_dvec3());
        let link = Link {
            hit: *hit,
            weight: Rgb::ONE,
            passage: Passage::Straight,
            length,
            direction: direction.as_dvec3(),
        };
        self.emission(source, direction.as_dvec3(), &link, emitted);
    }

    /// Irradiance from an emitter at the end of a path, shared with the emitters' own samples.
    fn emission(&self, source: &Source, first: DVec3, link: &Link, emitted: &mut EmitterIrradiance) {
        let Some((emitters, work)) = self.casting.emitters else { return };
        let Some((radiance, density)) = emitters.at(link.hit.face, link.hit.front) else { return };
        let rays = f64::from(self.rays_per_row());
        let share = if link.passage == Passage::Chain {
            let aimed = work.projection.zip(emitters.side(link.hit.face, link.hit.front));
            let aimed = aimed.map_or(1.0, |(projection, (side, normal))| {
                projection.density(side, normal, -link.direction)
            });
            1.0 - work.particle_share((density, aimed), self.rays_per_row(), source.area)
        } else {
            let normal = self.visibility.scene().faces[link.hit.face as usize].normal;
            let q = density * link.length * link.length / link.direction.dot(normal).abs();
            mis_share(rays, cosine_density(first.dot(source.normal)), f64::from(work.samples), q)
        };
        emitted.add(link.passage, std::f64::consts::PI * radiance * link.weight * share);
    }

    fn chain(
        &self,
        scratch: &mut Scratch,
        source: &Source,
        at: (usize, u32),
        (origin, direction, hit): (Vec3, Vec3, SurfaceHit),
        numbers: (u32, u32),
        emitted: &mut EmitterIrradiance,
    ) {
        let scene = self.visibility.scene();
        let first = direction.as_dvec3();
        let fate = self.place(scratch, at.0, at.1);
        let met = scene.material(&scene.faces[hit.face as usize]);
        let mut absorbed = Rgb::ZERO;
        if self.mesh.element(hit.face, hit.front, hit.u, hit.v) != NONE {
            absorbed -= counted_twice(met);
        }
        let place = (at.0 as u32, at.1);
        let chained = &mut scratch.chained;
        let worth = match self.casting.specular {
            AtSpecular::GoOnByShare => {
                let own = scene.material(&scene.faces[source.face as usize]);
                (1.0 - color::mean(pass_on(own))).max(LEAST)
            }
            _ => 1.0,
        };
        let end = self.chains.follow(Carried::Radiance, (origin, direction, hit), numbers, worth, |link| {
            let j = self.mesh.element(link.hit.face, link.hit.front, link.hit.u, link.hit.v);
            let material = scene.material(&scene.faces[link.hit.face as usize]);
            if j != NONE {
                chained.push((place, j, link.weight.as_vec3().to_array()));
                absorbed -= link.weight * counted_twice(material);
            } else if material.is_diffuse() && (link.hit.front || material.two_sided) {
                // Diffuse, but without elements there: nothing that was reached lies beyond.
                absorbed += link.weight * (Rgb::ONE - pass_on(material));
            }
            self.emission(source, first, link, emitted);
        });
        let chains = &mut scratch.fates[fate].chains;
        chains.escaped += end.escaped;
        chains.absorbed += end.absorbed + absorbed;
        chains.dropped += end.dropped;
        chains.roulette += end.roulette;
        scratch.cast += u64::from(end.rays);
    }

    /// The rays of the `k`-th element of a group, if some of them began inside of glass.
    pub(super) fn immersed(&self, scratch: &Scratch, element: u32, k: usize) -> Option<Immersed> {
        let places = || (0..self.batches).map(|batch| self.place(scratch, k, batch));
        let fates = || places().map(|place| &scratch.fates[place]);
        let inside: u32 = fates().map(|f| f.inside).sum();
        if inside == 0 {
            return None;
        }
        let landed = (0..self.batches).flat_map(|batch| scratch.landed.row(batch as usize, k).flatten());
        let mut landed: Vec<u32> = landed.copied().filter(|c| *c != NONE).collect();
        landed.sort_unstable();
        // Diffuse glass has elements too: rays that met these have told where they began.
        let mut last = (NONE, false);
        landed.retain(|&column| {
            if column != last.0 {
                last = (column, !self.is_glass(column));
            }
            last.1
        });
        let open = self.rays_per_row() - fates().map(|f| f.covered).sum::<u32>();
        Some(Immersed { element, inside, index2: fates().map(|f| f.index2).sum(), open, landed })
    }

    /// Whether an element belongs to the surface of a glass body.
    fn is_glass(&self, element: u32) -> bool {
        let scene = self.visibility.scene();
        scene.material(&scene.faces[self.mesh.place(element).0 as usize]).bends()
    }
}

/// What a chain counts as absorbed where it meets an element: of an emitter that is not diffuse, what it does not pass on. The element
/// takes that already.
fn counted_twice(material: &Material) -> Rgb {
    if material.is_diffuse() { Rgb::ZERO } else { Rgb::ONE - pass_on(material) }
}
