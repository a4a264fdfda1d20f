//! Form factors by ray-cast hemisphere sampling.
//!
//! Rays leave each element uniformly in area and cosine-weighted in direction, so the share of
//! rays that land on element j is `F_ij` itself (Malley 1988; DESIGN section 2). The points are
//! Owen-scrambled Sobol points in four dimensions; every row has several independent scramblings. Packets hold the same
//! ray of neighbouring elements (see [`super::source`]).

use super::gathered::{EmitterIrradiance, EmitterRows, EmitterWork, add_batch};
use super::immersed::{Immersed, settle};
use super::matrix::{ExchangeMatrix, RowSummary};
use super::rows::{Block, Builder};
use super::source::{Lanes, Source, groups, lane, share_packets};
use super::specular::{Carried, Chains, Link, pass_on};
use super::tally::Tally;
use crate::color::Rgb;
use crate::embree::{LANES, RayPacket};
use crate::emitters::{Emitters, Passage, cosine_density, mis_share};
use crate::mesh::{Grid, Mesh, NONE, Sides};
use crate::sampling::{MAX_POINTS, Scramble, ScrambledPoints, SobolTable, seed_of};
use crate::scene::Scene;
use crate::visibility::{SurfaceHit, Visibility};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Elements that one task casts: small enough to share the work, large enough to hold a few groups of [`LANES`].
const BLOCK: usize = 64;

/// How to cast.
#[derive(Clone, Copy)]
pub struct Casting<'a> {
    /// Rays an element, at least; rounded up to fill every randomisation equally.
    pub rays: u32,
    /// Independent randomisations of each row.
    pub batches: u32,
    /// Seed.
    pub seed: u32,
    /// Let chains go on over specular surfaces; otherwise these block and absorb.
    pub specular: bool,
    /// Sides that light can reach: a ray that lands elsewhere started on a covered part of its
    /// element and does not count. None: every ray counts.
    pub reached: Option<&'a Sides>,
    /// Emitters whose light is gathered on the way, and their own samples, which share the work by
    /// multiple importance sampling. Of few emitters ([`Emitters::are_few`]) only what comes over specular chains.
    pub emitters: Option<(&'a Emitters, EmitterWork<'a>)>,
    /// Called with the number of elements finished.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

const EMITTER: u8 = 1;
const SPECULAR: u8 = 2;
const UNREACHED: u8 = 4;

/// Casts the rows of every element of a mesh. Returns the matrix and the irradiance that came from the casting's
/// emitters (dark without any).
pub fn cast(visibility: &Visibility, mesh: &Mesh, casting: &Casting) -> (ExchangeMatrix, EmitterRows) {
    cast_rows(visibility, mesh, casting, None)
}

/// As [`cast`], for those elements alone that `rows` names; other rows stay empty, without any exposed area.
pub fn cast_rows(
    visibility: &Visibility,
    mesh: &Mesh,
    casting: &Casting,
    rows: Option<&[bool]>,
) -> (ExchangeMatrix, EmitterRows) {
    collect(Caster::new(visibility, mesh, casting), rows)
}

/// As [`cast_rows`], with independent random points in place of Sobol's: what these are compared with.
pub fn cast_random(
    visibility: &Visibility,
    mesh: &Mesh,
    casting: &Casting,
    rows: Option<&[bool]>,
) -> ExchangeMatrix {
    let mut caster = Caster::new(visibility, mesh, casting);
    caster.table = SobolTable::random(caster.table.len() as u32, casting.seed);
    collect(caster, rows).0
}

fn collect(caster: Caster, rows: Option<&[bool]>) -> (ExchangeMatrix, EmitterRows) {
    let cast = caster.run(rows, |_, cast| cast);
    let mut matrix = ExchangeMatrix {
        batches: caster.batches as usize,
        channels: caster.channels,
        rows_per_block: BLOCK,
        blocks: Vec::with_capacity(cast.len()),
        summary: Vec::with_capacity(caster.mesh.len()),
        rays_per_row: caster.rays_per_row(),
        rays: 0,
    };
    let mut light = EmitterRows::dark(0, matrix.batches);
    let mut immersed = Vec::new();
    for part in cast {
        matrix.blocks.push(part.entries);
        matrix.summary.extend_from_slice(&part.summary);
        matrix.rays += part.rays;
        light.append(&part.light);
        immersed.extend(part.immersed);
    }
    settle(&mut matrix.summary, &immersed);
    (matrix, light)
}

/// All that a hit needs to know of its face, side by side in memory.
#[derive(Clone)]
struct Target {
    normal: Vec3,
    grid: Grid,
    /// First element by side, or [`NONE`].
    first: [u32; 2],
    kind: [u8; 2],
}

fn targets(scene: &Scene, mesh: &Mesh, casting: &Casting) -> Vec<Target> {
    let kind = |k: u32, front: bool| {
        let material = scene.material(&scene.faces[k as usize]);
        let emitter = casting.emitters.is_some_and(|(e, _)| !e.are_few() && e.at(k, front).is_some());
        let specular = casting.specular && material.is_specular() && (front || material.two_sided);
        // A specular side leads on wherever it is; only a side that would end the ray can prove it covered.
        let unreached = !specular && casting.reached.is_some_and(|r| !r.contains(k, front));
        (EMITTER * u8::from(emitter)) | (SPECULAR * u8::from(specular)) | (UNREACHED * u8::from(unreached))
    };
    let target = |k: u32| Target {
        normal: scene.faces[k as usize].normal.as_vec3(),
        grid: mesh.grid(k).clone(),
        first: [mesh.first(k, true), mesh.first(k, false)],
        kind: [kind(k, true), kind(k, false)],
    };
    (0..scene.faces.len() as u32).map(target).collect()
}

/// Casts rows, as often as asked, the same to the bit each time.
pub struct Caster<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    casting: Casting<'a>,
    table: SobolTable,
    batches: u32,
    channels: usize,
    chains: Chains<'a, 's>,
    targets: Vec<Target>,
    normals: Vec<Vec3>,
}

/// The rows of one task.
struct Cast {
    entries: Block,
    summary: Vec<RowSummary>,
    light: EmitterRows,
    immersed: Vec<Immersed>,
    rays: u64,
}

/// What became of the rays of one element.
#[derive(Clone, Default)]
struct Fate {
    summary: RowSummary,
    /// Met the back of glass first.
    inside: u32,
    covered: u32,
    escaped: u32,
    absorbed: u32,
}

/// Buffers of one thread.
struct Scratch {
    packet: RayPacket,
    points: ScrambledPoints,
    /// Where each ray of a group landed, by (randomisation, element, ray); [`NONE`] where no element is.
    landed: Vec<u32>,
    /// What chains brought: (element of the group, randomisation), column, weight.
    chained: Vec<((u32, u32), u32, [f32; 3])>,
    emitted: Vec<EmitterIrradiance>,
    tally: Tally,
    builder: Builder,
    fates: Vec<Fate>,
    rays: u64,
}

impl<'a, 's> Caster<'a, 's> {
    /// Prepares to cast the rows of a mesh.
    pub fn new(visibility: &'a Visibility<'s>, mesh: &'a Mesh, casting: &Casting<'a>) -> Caster<'a, 's> {
        let scene = visibility.scene();
        let batches = casting.batches.max(casting.rays.div_ceil(MAX_POINTS)).clamp(1, casting.rays.max(1));
        let per_batch = casting.rays.max(1).div_ceil(batches);
        let coloured =
            casting.specular && scene.materials.iter().any(|m| m.is_specular() && !m.has_grey_specular());
        Caster {
            visibility,
            mesh,
            casting: *casting,
            table: SobolTable::new(per_batch),
            batches,
            channels: if coloured { 3 } else { 1 },
            chains: Chains::new(visibility, casting.emitters.map(|e| e.0)),
            targets: targets(scene, mesh, casting),
            normals: scene.faces.iter().map(|f| f.normal.as_vec3()).collect(),
        }
    }

    /// Rays of each row.
    pub(super) fn rays_per_row(&self) -> u32 {
        self.batches * self.table.len() as u32
    }

    /// Independent randomisations of each row.
    pub(super) fn batches(&self) -> usize {
        self.batches as usize
    }

    /// Values of an entry.
    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// From now on nothing listens, and emitters are met like any other surface.
    pub(super) fn repeat_quietly(&mut self) {
        (self.casting.progress, self.casting.emitters) = (&|_| (), None);
        for target in &mut self.targets {
            target.kind.iter_mut().for_each(|k| *k &= !EMITTER);
        }
    }

    /// Casts every row and keeps no factors: summaries, irradiance from emitters, rays cast.
    pub(super) fn survey(&self) -> (Vec<RowSummary>, EmitterRows, u64) {
        let parts = self.run(None, |_, cast| (cast.summary, cast.light, cast.rays, cast.immersed));
        let (mut summary, mut immersed) = (Vec::with_capacity(self.mesh.len()), Vec::new());
        let (mut light, mut rays) = (EmitterRows::dark(0, self.batches()), 0);
        for part in parts {
            summary.extend(part.0);
            light.append(&part.1);
            rays += part.2;
            immersed.extend(part.3);
        }
        settle(&mut summary, &immersed);
        (summary, light, rays)
    }

    /// Casts every row and shows it to `f`, by blocks: one value a block, in order, and the rays cast.
    pub(super) fn visit<T: Send>(
        &self,
        f: impl Fn(std::ops::Range<usize>, &Block) -> T + Sync,
    ) -> (Vec<T>, u64) {
        let parts =
            self.run(None, |first, cast| (f(first..first + cast.summary.len(), &cast.entries), cast.rays));
        let rays = parts.iter().map(|p| p.1).sum();
        (parts.into_iter().map(|p| p.0).collect(), rays)
    }

    /// Casts blocks of rows on all cores and hands each to `each` with its first row.
    fn run<T: Send>(&self, rows: Option<&[bool]>, each: impl Fn(usize, Cast) -> T + Sync) -> Vec<T> {
        let n = self.mesh.len();
        (0..n.div_ceil(BLOCK))
            .into_par_iter()
            .map_init(
                || self.scratch(),
                |scratch, b| {
                    let range = b * BLOCK..((b + 1) * BLOCK).min(n);
                    let count = range.clone().filter(|e| rows.is_none_or(|r| r[*e])).count() as u64;
                    let cast = self.block(scratch, range.start as u32..range.end as u32, rows);
                    (self.casting.progress)(count);
                    each(range.start, cast)
                },
            )
            .collect()
    }

    fn scratch(&self) -> Scratch {
        Scratch {
            packet: RayPacket::new(),
            points: ScrambledPoints::default(),
            landed: Vec::new(),
            chained: Vec::new(),
            emitted: Vec::new(),
            tally: Tally::new(self.channels),
            // Chains have weights; rays alone are counted.
            builder: Builder::new(!self.casting.specular),
            fates: Vec::new(),
            rays: 0,
        }
    }

    fn block(&self, scratch: &mut Scratch, elements: std::ops::Range<u32>, rows: Option<&[bool]>) -> Cast {
        let (n, batches) = (elements.len(), self.batches as usize);
        let light = if self.casting.emitters.is_some() { n } else { 0 };
        let mut cast = Cast {
            entries: scratch.builder.finish(),
            summary: Vec::with_capacity(n),
            light: EmitterRows::dark(light, batches),
            immersed: Vec::new(),
            rays: 0,
        };
        scratch.rays = 0;
        for group in groups(self.mesh, &self.normals, elements.clone()) {
            let wanted = |e: &u32| rows.is_none_or(|r| r[*e as usize]);
            let chosen: Vec<u32> = group.clone().filter(wanted).collect();
            self.group(scratch, group.start, &chosen);
            let mut found = 0;
            for element in group {
                if chosen.get(found) != Some(&element) {
                    (0..batches).for_each(|_| scratch.builder.end_batch());
                    scratch.builder.end_row(batches, self.channels, 1.0);
                    cast.summary.push(RowSummary::default());
                    continue;
                }
                cast.summary.push(self.row(scratch, found, chosen.len()));
                cast.immersed.extend(self.immersed(scratch, element, (found, chosen.len())));
                if light > 0 {
                    let at = (element - elements.start) as usize;
                    for b in 0..batches {
                        let emitted = scratch.emitted[found * batches + b] * (1.0 / self.table.len() as f64);
                        let EmitterRows { mean, total, .. } = &mut cast.light;
                        add_batch(&mut mean[at], &mut total[at * batches + b], emitted, batches);
                    }
                }
                found += 1;
            }
        }
        cast.entries = scratch.builder.finish();
        cast.rays = scratch.rays;
        cast
    }

    /// Casts the rays of elements of a group, all randomisations, into the buffers.
    fn group(&self, scratch: &mut Scratch, first: u32, elements: &[u32]) {
        let (n, m, batches) = (self.table.len(), elements.len(), self.batches as usize);
        scratch.landed.clear();
        scratch.landed.resize(n * m * batches, NONE);
        scratch.chained.clear();
        scratch.emitted.clear();
        scratch.emitted.resize(m * batches, EmitterIrradiance::default());
        scratch.fates.clear();
        scratch.fates.resize(m, Fate::default());
        let together = if share_packets(&self.table) { m } else { 1 };
        let mut parts: Vec<Lanes> = elements
            .chunks(together.max(1))
            .map(|part| Lanes::new(self.visibility, self.mesh, part.iter().copied()))
            .collect();
        for batch in 0..self.batches {
            let scramble = Scramble::new(seed_of(&[self.casting.seed, first, batch]));
            self.table.scramble(&scramble, &mut scratch.points);
            for (k, lanes) in parts.iter_mut().enumerate() {
                lanes.shift(self.casting.seed, batch, self.table.shared_bits());
                self.packets(scratch, lanes, k * together, batch);
            }
        }
        scratch.chained.sort_by_key(|c| c.0);
    }

    /// Casts one randomisation of a part of a group, which begins at element `offset` of it.
    fn packets(&self, scratch: &mut Scratch, lanes: &Lanes, offset: usize, batch: u32) {
        let (n, m) = (self.table.len(), scratch.fates.len());
        let landed = (batch as usize * m + offset) * n;
        scratch.rays += (n * lanes.sources.len()) as u64;
        let step = lanes.points_a_packet();
        let whole = lanes.active(step);
        for base in (0..n).step_by(step) {
            let rays = lanes.rays(&scratch.points, base);
            let active = if n - base >= step { whole } else { lanes.active(n - base) };
            scratch.packet.fill(&rays, active);
            self.visibility.closest16(&mut scratch.packet, true);
            for l in (0..LANES).filter(|l| active >> l & 1 == 1) {
                let (k, point) = lanes.place(l);
                let source = &lanes.sources[k];
                let fate = &mut scratch.fates[offset + k];
                let Some(met) = scratch.packet.hit(l) else {
                    fate.escaped += 1;
                    continue;
                };
                let (origin, direction) = lane(&rays, l);
                let mut hit = SurfaceHit { face: met.face, u: met.u, v: met.v, front: true };
                if met.face == source.face {
                    match self.visibility.closest(origin, direction, source.face) {
                        Some(next) => hit = next,
                        None => {
                            fate.escaped += 1;
                            continue;
                        }
                    }
                }
                let target = &self.targets[hit.face as usize];
                hit.front = target.normal.dot(direction) < 0.0;
                let side = usize::from(!hit.front);
                let kind = target.kind[side];
                if kind & UNREACHED != 0 {
                    fate.covered += 1;
                    continue;
                }
                if target.first[side] != NONE {
                    scratch.landed[landed + k * n + base + point] =
                        target.first[side] + target.grid.cell(hit.u, hit.v);
                } else if kind & SPECULAR == 0 {
                    fate.absorbed += 1;
                }
                if kind & (EMITTER | SPECULAR) != 0 {
                    let at = (offset + k, batch, (base + point) as u32);
                    self.beyond(scratch, source, at, (origin, direction, hit), kind);
                }
            }
        }
    }

    /// A ray that met an emitter or a specular surface; `at` is the place in the group, the randomisation and the point.
    #[cold]
    fn beyond(
        &self,
        scratch: &mut Scratch,
        source: &Source,
        at: (usize, u32, u32),
        (origin, direction, hit): (Vec3, Vec3, SurfaceHit),
        kind: u8,
    ) {
        let (k, batch, point) = at;
        let mut emitted = EmitterIrradiance::default();
        if kind & EMITTER != 0 {
            self.emitter(source, origin, direction, &hit, &mut emitted);
        }
        if kind & SPECULAR != 0 {
            let seed = seed_of(&[self.casting.seed, source.element, batch]);
            let ray = (origin, direction, hit);
            self.chain(scratch, source, (k, batch), ray, (point, seed), &mut emitted);
        }
        scratch.emitted[k * self.batches as usize + batch as usize] += emitted;
    }

    /// Adds up the row of the `k`-th of `m` elements of a group.
    fn row(&self, scratch: &mut Scratch, k: usize, m: usize) -> RowSummary {
        let (n, ones) = (self.table.len(), [1.0f32; 3]);
        for batch in 0..self.batches {
            let first = (batch as usize * m + k) * n;
            for &column in scratch.landed[first..first + n].iter().filter(|c| **c != NONE) {
                scratch.tally.add(column, &ones[..self.channels]);
            }
            let place = (k as u32, batch);
            let first = scratch.chained.partition_point(|c| c.0 < place);
            for (_, column, weight) in scratch.chained[first..].iter().take_while(|c| c.0 == place) {
                scratch.tally.add(*column, &weight[..self.channels]);
            }
            let builder = &mut scratch.builder;
            scratch.tally.drain(|column, weight| builder.push(column, weight));
            builder.end_batch();
        }
        let fate = &scratch.fates[k];
        let total = u64::from(self.rays_per_row());
        let open = total - u64::from(fate.covered);
        let scale = if open > 0 { 1.0 / open as f64 } else { 0.0 };
        scratch.builder.end_row(self.batches as usize, self.channels, scale);
        let mut row = fate.summary;
        row.escaped += Rgb::splat(f64::from(fate.escaped));
        row.absorbed += Rgb::splat(f64::from(fate.absorbed));
        row.escaped *= scale;
        row.absorbed *= scale;
        row.dropped *= scale;
        // Rows that see each other are needed to tell.
        row.index2 = 1.0;
        row.exposed = open as f64 / total as f64;
        row
    }

    /// The rays of the `k`-th of `m` elements of a group, if some of them began inside of glass.
    fn immersed(&self, scratch: &Scratch, element: u32, (k, m): (usize, usize)) -> Option<Immersed> {
        let (n, fate) = (self.table.len(), &scratch.fates[k]);
        if fate.inside == 0 {
            return None;
        }
        let rows = (0..self.batches as usize).map(|batch| (batch * m + k) * n);
        let landed = rows.flat_map(|first| &scratch.landed[first..first + n]);
        let mut landed: Vec<u32> = landed.copied().filter(|c| *c != NONE).collect();
        landed.sort_unstable();
        let open = self.rays_per_row() - fate.covered;
        Some(Immersed { element, inside: fate.inside, index2: fate.summary.index2 - 1.0, open, landed })
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
        let met = scene.material(&scene.faces[hit.face as usize]);
        if met.bends() && !hit.front {
            scratch.fates[at.0].summary.index2 += met.ior * met.ior - 1.0;
            scratch.fates[at.0].inside += 1;
        }
        let mut absorbed = Rgb::ZERO;
        let place = (at.0 as u32, at.1);
        let chained = &mut scratch.chained;
        let end = self.chains.follow(Carried::Radiance, (origin, direction, hit), numbers, |link| {
            let j = self.mesh.element(link.hit.face, link.hit.front, link.hit.u, link.hit.v);
            if j != NONE {
                chained.push((place, j, link.weight.as_vec3().to_array()));
                let material = scene.material(&scene.faces[link.hit.face as usize]);
                if !material.is_diffuse() && !material.is_specular() {
                    // A black emitter has elements: what it absorbs is counted there.
                    absorbed -= link.weight;
                }
            } else {
                let material = scene.material(&scene.faces[link.hit.face as usize]);
                if material.is_diffuse() && (link.hit.front || material.two_sided) {
                    // Diffuse, but without elements there: nothing that was reached lies beyond.
                    absorbed += link.weight * (Rgb::ONE - pass_on(material));
                }
            }
            self.emission(source, first, link, emitted);
        });
        let summary = &mut scratch.fates[at.0].summary;
        summary.escaped += end.escaped;
        summary.absorbed += end.absorbed + absorbed;
        summary.dropped += end.dropped;
        scratch.rays += u64::from(end.rays);
    }
}
