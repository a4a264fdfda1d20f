//! Form factors by ray-cast hemisphere sampling.
//!
//! Rays leave each element uniformly in area and cosine-weighted in direction, so the share of
//! rays that land on element j is `F_ij` itself (Malley 1988; DESIGN section 2). The points are
//! Owen-scrambled Sobol points in four dimensions; every row has several independent scramblings.

use super::matrix::{ExchangeMatrix, RowSummary};
use super::source::{Source, lane};
use super::specular::{Carried, Chains, Link, pass_on};
use crate::color::Rgb;
use crate::embree::RayPacket;
use crate::emitters::{Emitters, Passage, cosine_density, mis_share};
use crate::mesh::{Grid, Mesh, NONE, Sides};
use crate::sampling::{MAX_POINTS, Scramble, SobolTable, seed_of};
use crate::scene::Scene;
use crate::visibility::{SurfaceHit, Visibility};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Elements that one task casts: small enough to share the work, large enough to keep its buffers.
pub(super) const BLOCK: usize = 16;

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
    /// multiple importance sampling.
    pub emitters: Option<(&'a Emitters, EmitterWork)>,
    /// Called with the number of elements finished.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

/// Samples of the emitters that share their light with the hemisphere rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EmitterWork {
    /// Samples of the emitters' area, an element.
    pub samples: u32,
    /// Particles from the emitters in all, for specular chains.
    pub particles: u32,
}

/// Irradiance from emitters that hemisphere rays found, by passage [W m^-2], over the whole
/// element, covered parts included.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EmitterIrradiance {
    /// In a straight line.
    pub straight: Rgb,
    /// By one flat mirror.
    pub image: Rgb,
    /// By other chains.
    pub chain: Rgb,
}

impl EmitterIrradiance {
    /// Adds irradiance that came by `passage`.
    pub fn add(&mut self, passage: Passage, irradiance: Rgb) {
        match passage {
            Passage::Straight => self.straight += irradiance,
            Passage::Image => self.image += irradiance,
            Passage::Chain => self.chain += irradiance,
        }
    }
}

impl std::ops::Mul<f64> for EmitterIrradiance {
    type Output = EmitterIrradiance;

    fn mul(self, f: f64) -> EmitterIrradiance {
        EmitterIrradiance { straight: self.straight * f, image: self.image * f, chain: self.chain * f }
    }
}

impl std::ops::AddAssign for EmitterIrradiance {
    fn add_assign(&mut self, other: EmitterIrradiance) {
        self.straight += other.straight;
        self.image += other.image;
        self.chain += other.chain;
    }
}

const EMITTER: u8 = 1;
const SPECULAR: u8 = 2;
const UNREACHED: u8 = 4;

/// Casts the rows of every element of a mesh. Returns the matrix and, with `emitters`, the
/// irradiance that came from them: one value for each (row, randomisation).
pub fn cast(
    visibility: &Visibility,
    mesh: &Mesh,
    casting: &Casting,
) -> (ExchangeMatrix, Vec<EmitterIrradiance>) {
    cast_rows(visibility, mesh, casting, None)
}

/// As [`cast`], for those elements alone that `rows` names; other rows stay empty, without any exposed area.
pub fn cast_rows(
    visibility: &Visibility,
    mesh: &Mesh,
    casting: &Casting,
    rows: Option<&[bool]>,
) -> (ExchangeMatrix, Vec<EmitterIrradiance>) {
    cast_points(visibility, mesh, casting, rows, SobolTable::new)
}

/// As [`cast_rows`], with independent random points in place of Sobol's: what these are compared with.
pub fn cast_random(
    visibility: &Visibility,
    mesh: &Mesh,
    casting: &Casting,
    rows: Option<&[bool]>,
) -> ExchangeMatrix {
    cast_points(visibility, mesh, casting, rows, |n| SobolTable::random(n, casting.seed)).0
}

/// As [`cast_rows`], with so many points of a table for each randomisation.
fn cast_points(
    visibility: &Visibility,
    mesh: &Mesh,
    casting: &Casting,
    rows: Option<&[bool]>,
    points: impl Fn(u32) -> SobolTable,
) -> (ExchangeMatrix, Vec<EmitterIrradiance>) {
    let scene = visibility.scene();
    let batches = casting.batches.max(casting.rays.div_ceil(MAX_POINTS)).clamp(1, casting.rays.max(1));
    let per_batch = casting.rays.max(1).div_ceil(batches);
    let coloured =
        casting.specular && scene.materials.iter().any(|m| m.is_specular() && !m.has_grey_specular());
    let shared = Shared {
        visibility,
        mesh,
        casting,
        table: points(per_batch),
        batches,
        channels: if coloured { 3 } else { 1 },
        chains: Chains::new(visibility, casting.emitters.map(|e| e.0)),
        targets: targets(scene, mesh, casting),
    };
    let n = mesh.len();
    let blocks: Vec<Block> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(
            || Scratch::new(n, shared.channels),
            |scratch, b| {
                let range = b * BLOCK..((b + 1) * BLOCK).min(n);
                let count = range.clone().filter(|e| rows.is_none_or(|r| r[*e])).count() as u64;
                let block = shared.block(scratch, range, rows);
                (casting.progress)(count);
                block
            },
        )
        .collect();
    join(blocks, &shared, n)
}

/// Puts the blocks in order, freeing each as it goes.
fn join(blocks: Vec<Block>, shared: &Shared, n: usize) -> (ExchangeMatrix, Vec<EmitterIrradiance>) {
    let stored: usize = blocks.iter().map(|b| b.columns.len()).sum();
    let mut matrix = ExchangeMatrix {
        batches: shared.batches as usize,
        channels: shared.channels,
        start: Vec::with_capacity(n * shared.batches as usize + 1),
        columns: Vec::with_capacity(stored),
        values: Vec::with_capacity(stored * shared.channels),
        summary: Vec::with_capacity(n),
        rays_per_row: shared.rays_per_row(),
        rays: 0,
    };
    let mut emitted = Vec::new();
    for block in blocks {
        let base = matrix.columns.len() as u64;
        matrix.start.extend(block.start.iter().map(|s| base + u64::from(*s)));
        matrix.columns.extend_from_slice(&block.columns);
        matrix.values.extend_from_slice(&block.values);
        matrix.summary.extend_from_slice(&block.summary);
        matrix.rays += block.rays;
        emitted.extend_from_slice(&block.emitted);
    }
    matrix.start.push(matrix.columns.len() as u64);
    (matrix, emitted)
}

/// All that a hit needs to know of its face, side by side in memory.
#[derive(Clone, Copy)]
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
        let emitter = casting.emitters.is_some_and(|(e, _)| e.at(k, front).is_some());
        let specular = casting.specular && material.is_specular() && (front || material.two_sided);
        // A specular side leads on wherever it is; only a side that would end the ray can prove it covered.
        let unreached = !specular && casting.reached.is_some_and(|r| !r.contains(k, front));
        (EMITTER * u8::from(emitter)) | (SPECULAR * u8::from(specular)) | (UNREACHED * u8::from(unreached))
    };
    let target = |k: u32| Target {
        normal: scene.faces[k as usize].normal.as_vec3(),
        grid: *mesh.grid(k),
        first: [mesh.first(k, true), mesh.first(k, false)],
        kind: [kind(k, true), kind(k, false)],
    };
    (0..scene.faces.len() as u32).map(target).collect()
}

struct Shared<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    casting: &'a Casting<'a>,
    table: SobolTable,
    batches: u32,
    channels: usize,
    chains: Chains<'a, 's>,
    targets: Vec<Target>,
}

#[derive(Default)]
struct Block {
    start: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
    summary: Vec<RowSummary>,
    emitted: Vec<EmitterIrradiance>,
    rays: u64,
}

impl Block {
    /// A row that was not asked for.
    fn skip(&mut self, batches: usize, emitters: bool) {
        self.start.extend(std::iter::repeat_n(self.columns.len() as u32, batches));
        self.summary.push(RowSummary::default());
        self.emitted
            .extend(std::iter::repeat_n(EmitterIrradiance::default(), if emitters { batches } else { 0 }));
    }
}

/// Dense accumulators of one thread; only the touched columns are visited and cleared.
struct Scratch {
    weight: Vec<f32>,
    touched: Vec<u32>,
    packet: RayPacket,
}

impl Scratch {
    fn new(n: usize, channels: usize) -> Scratch {
        Scratch { weight: vec![0.0; n * channels], touched: Vec::new(), packet: RayPacket::new() }
    }
}

impl Shared<'_, '_> {
    fn rays_per_row(&self) -> u32 {
        self.batches * self.table.len() as u32
    }

    fn block(&self, scratch: &mut Scratch, elements: std::ops::Range<usize>, rows: Option<&[bool]>) -> Block {
        let mut block = Block::default();
        for element in elements {
            if rows.is_none_or(|r| r[element]) {
                self.row(scratch, element as u32, &mut block);
            } else {
                block.skip(self.batches as usize, self.casting.emitters.is_some());
            }
        }
        block
    }

    fn row(&self, scratch: &mut Scratch, element: u32, block: &mut Block) {
        let source = Source::new(self.visibility, self.mesh, element);
        let first_value = block.values.len();
        let mut row = RowSummary::default();
        let mut covered = 0u64;
        let total = u64::from(self.batches) * self.table.len() as u64;
        for batch in 0..self.batches {
            block.start.push(block.columns.len() as u32);
            let mut emitted = EmitterIrradiance::default();
            self.batch(
                scratch,
                &source,
                (element, batch),
                &mut row,
                &mut covered,
                &mut emitted,
                &mut block.rays,
            );
            for &j in &scratch.touched {
                block.columns.push(j);
                let k = j as usize * self.channels;
                block.values.extend_from_slice(&scratch.weight[k..k + self.channels]);
                scratch.weight[k..k + self.channels].fill(0.0);
            }
            scratch.touched.clear();
            if self.casting.emitters.is_some() {
                let scale = 1.0 / self.table.len() as f64;
                block.emitted.push(emitted * scale);
            }
        }
        let open = total - covered;
        if open > 0 {
            let scale = 1.0 / open as f64;
            for v in &mut block.values[first_value..] {
                *v *= scale as f32;
            }
            row.escaped *= scale;
            row.absorbed *= scale;
            row.dropped *= scale;
            row.index2 = 1.0 + (row.index2 - 1.0) * scale;
            row.exposed = open as f64 / total as f64;
        }
        block.summary.push(row);
    }

    /// Casts one randomisation; accumulates unscaled weights.
    #[allow(clippy::too_many_arguments)] // the parts of one row, which live in different places
    fn batch(
        &self,
        scratch: &mut Scratch,
        source: &Source,
        (element, batch): (u32, u32),
        row: &mut RowSummary,
        covered: &mut u64,
        emitted: &mut EmitterIrradiance,
        rays: &mut u64,
    ) {
        let seed = seed_of(&[self.casting.seed, element, batch]);
        let scramble = Scramble::new(seed);
        let n = self.table.len();
        *rays += n as u64;
        let mut escaped = 0u32;
        for base in (0..n).step_by(16) {
            let count = (n - base).min(16);
            let lanes = source.rays(&self.table.block(base / 16, &scramble));
            scratch.packet.fill(&lanes, count);
            self.visibility.closest16(&mut scratch.packet, false);
            for k in 0..count {
                let (origin, direction) = lane(&lanes, k);
                let Some(met) = scratch.packet.hit(k) else {
                    escaped += 1;
                    continue;
                };
                let mut hit = SurfaceHit { face: met.face, u: met.u, v: met.v, front: true };
                if met.face == source.face {
                    match self.visibility.closest(origin, direction, source.face) {
                        Some(next) => hit = next,
                        None => {
                            escaped += 1;
                            continue;
                        }
                    }
                }
                let target = &self.targets[hit.face as usize];
                hit.front = target.normal.dot(direction) < 0.0;
                let side = usize::from(!hit.front);
                let kind = target.kind[side];
                if kind & UNREACHED != 0 {
                    *covered += 1;
                    continue;
                }
                if target.first[side] != NONE {
                    self.count(scratch, target.first[side] + target.grid.cell(hit.u, hit.v));
                } else if kind & SPECULAR == 0 {
                    row.absorbed += Rgb::ONE;
                }
                if kind & EMITTER != 0 {
                    self.emitter(source, origin, direction, &hit, emitted);
                }
                if kind & SPECULAR != 0 {
                    self.chain(
                        scratch,
                        source,
                        (origin, direction, hit),
                        ((base + k) as u32, seed),
                        row,
                        emitted,
                        rays,
                    );
                }
            }
        }
        row.escaped += Rgb::splat(f64::from(escaped));
    }

    #[inline]
    fn count(&self, scratch: &mut Scratch, j: u32) {
        let k = j as usize * self.channels;
        if scratch.weight[k] == 0.0 {
            scratch.touched.push(j);
        }
        for w in &mut scratch.weight[k..k + self.channels] {
            *w += 1.0;
        }
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
            mis_share(rays, 1.0 / source.area, f64::from(work.particles), density)
        } else {
            let normal = self.visibility.scene().faces[link.hit.face as usize].normal;
            let q = density * link.length * link.length / link.direction.dot(normal).abs();
            mis_share(rays, cosine_density(first.dot(source.normal)), f64::from(work.samples), q)
        };
        emitted.add(link.passage, std::f64::consts::PI * radiance * link.weight * share);
    }

    #[allow(clippy::too_many_arguments)] // as `batch`
    fn chain(
        &self,
        scratch: &mut Scratch,
        source: &Source,
        (origin, direction, hit): (Vec3, Vec3, SurfaceHit),
        numbers: (u32, u32),
        row: &mut RowSummary,
        emitted: &mut EmitterIrradiance,
        rays: &mut u64,
    ) {
        let scene = self.visibility.scene();
        let first = direction.as_dvec3();
        let met = scene.material(&scene.faces[hit.face as usize]);
        if met.bends() && !hit.front {
            row.index2 += met.ior * met.ior - 1.0;
        }
        let mut absorbed = Rgb::ZERO;
        let end = self.chains.follow(Carried::Radiance, (origin, direction, hit), numbers, |link| {
            let j = self.mesh.element(link.hit.face, link.hit.front, link.hit.u, link.hit.v);
            if j != NONE {
                let k = j as usize * self.channels;
                if scratch.weight[k] == 0.0 {
                    scratch.touched.push(j);
                }
                for (w, v) in scratch.weight[k..k + self.channels].iter_mut().zip(link.weight.to_array()) {
                    *w += v as f32;
                }
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
        row.escaped += end.escaped;
        row.absorbed += end.absorbed + absorbed;
        row.dropped += end.dropped;
        *rays += u64::from(end.rays);
    }
}
