//! Form factors by ray-cast hemisphere sampling.
//!
//! Rays leave each element uniformly in area and cosine-weighted in direction, so the share of
//! rays that land on element j is `F_ij` itself (Malley 1988; DESIGN section 2). The points are
//! Owen-scrambled Sobol points in four dimensions; every row has several independent scramblings. Packets hold the same
//! ray of neighbouring elements (see [`super::source`]).

mod beyond;
mod fate;
#[cfg(test)]
mod tests;

use super::gathered::{EmitterRows, EmitterWork, add_batch};
use super::immersed::{Immersed, settle};
use super::landed::{Landed, POINTS};
use super::landing::{ABSORBED, EMITTER, ESCAPED, IMMERSED, SPECULAR, Targets, UNREACHED};
use super::matrix::{ExchangeMatrix, RowSummary};
use super::rows::{Block, Builder};
use super::source::{Lanes, groups, shared};
use super::specular::Chains;
use super::tally::{Counts, Tally};
use crate::color::Rgb;
use crate::embree::{LANES, RayPacket};
use crate::emitters::Emitters;
use crate::mesh::{Mesh, NONE, Sides};
use crate::sampling::{MAX_POINTS, Scramble, ScrambledPoints, SobolTable, seed_of};
use crate::visibility::Visibility;
use fate::Fate;
use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Elements that one task casts: small enough to share the work, large enough to hold a few groups of [`LANES`].
pub(super) const BLOCK: usize = 32;

/// What becomes of rays that meet specular surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtSpecular {
    /// They are absorbed.
    End,
    /// Chains go on.
    GoOn,
    /// Chains go on, by Russian roulette those less far whose element passes most light on specularly itself: for radiosity,
    /// which counts but the share that such a surface reflects diffusely or absorbs.
    GoOnByShare,
}

/// How to cast.
#[derive(Clone, Copy)]
pub struct Casting<'a> {
    /// Rays an element, at least; rounded up to fill every randomisation equally.
    pub rays: u32,
    /// Independent randomisations of each row.
    pub batches: u32,
    /// Seed.
    pub seed: u32,
    /// What becomes of rays at specular surfaces.
    pub specular: AtSpecular,
    /// Sides that light can reach: a ray that lands elsewhere started on a covered part of its
    /// element and does not count. None: every ray counts.
    pub reached: Option<&'a Sides>,
    /// Emitters whose light is gathered on the way, and their own samples, which share the work by
    /// multiple importance sampling. Of few emitters ([`Emitters::are_few`]) only what comes over specular chains.
    pub emitters: Option<(&'a Emitters, EmitterWork<'a>)>,
    /// Called with the number of elements finished.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

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

/// Casts rows, as often as asked, the same to the bit each time.
pub struct Caster<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    casting: Casting<'a>,
    table: SobolTable,
    batches: u32,
    channels: usize,
    chains: Chains<'a, 's>,
    targets: Targets,
    arch: Arch,
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

/// Buffers of one thread.
struct Scratch {
    packet: RayPacket,
    points: ScrambledPoints,
    landed: Landed,
    /// What chains brought: (element of the group, randomisation), column, weight.
    chained: Vec<((u32, u32), u32, [f32; 3])>,
    tally: Tally,
    /// For few elements.
    counts: Option<Counts>,
    builder: Builder,
    /// By (randomisation, element).
    fates: Vec<Fate>,
    /// Rays cast.
    cast: u64,
}

/// [`Caster::packets`], compiled once for every processor and once for those of x86-64-v3, which do eight numbers at a time. The
/// results are the same to the bit: nothing is contracted or reordered.
struct Packets<'p, 'a, 's> {
    caster: &'p Caster<'a, 's>,
    scratch: &'p mut Scratch,
    lanes: &'p Lanes,
    offset: usize,
    batch: u32,
}

impl WithSimd for Packets<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Packets { caster, scratch, lanes, offset, batch } = self;
        match lanes.points_a_packet() {
            1 => caster.packets::<S, true>(simd, scratch, lanes, offset, batch),
            _ => caster.packets::<S, false>(simd, scratch, lanes, offset, batch),
        }
    }
}

impl<'a, 's> Caster<'a, 's> {
    /// Prepares to cast the rows of a mesh.
    pub fn new(visibility: &'a Visibility<'s>, mesh: &'a Mesh, casting: &Casting<'a>) -> Caster<'a, 's> {
        let scene = visibility.scene();
        let batches = casting.batches.max(casting.rays.div_ceil(MAX_POINTS)).clamp(1, casting.rays.max(1));
        let per_batch = casting.rays.max(1).div_ceil(batches);
        let coloured = casting.specular != AtSpecular::End
            && scene.materials.iter().any(|m| m.is_specular() && !m.has_grey_specular());
        Caster {
            visibility,
            mesh,
            casting: *casting,
            table: SobolTable::new(per_batch),
            batches,
            channels: if coloured { 3 } else { 1 },
            chains: Chains::new(visibility, casting.emitters.map(|e| e.0)),
            targets: Targets::new(visibility, mesh, casting),
            arch: Arch::new(),
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
        self.targets.forget_emitters();
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
            .with_max_len(1)
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
            landed: Landed::default(),
            chained: Vec::new(),
            tally: Tally::new(self.channels),
            counts: Counts::new(self.mesh.len()),
            // Chains have weights; rays alone are counted.
            builder: Builder::new(self.casting.specular == AtSpecular::End),
            fates: Vec::new(),
            cast: 0,
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
        scratch.cast = 0;
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
                let at = (element - elements.start) as usize;
                let light = (light > 0).then_some((&mut cast.light, at));
                cast.summary.push(self.row(scratch, found, light));
                cast.immersed.extend(self.immersed(scratch, element, found));
                found += 1;
            }
        }
        cast.entries = scratch.builder.finish();
        cast.rays = scratch.cast;
        cast
    }

    /// Casts the rays of elements of a group, all randomisations, into the buffers.
    fn group(&self, scratch: &mut Scratch, first: u32, elements: &[u32]) {
        let (m, batches) = (elements.len(), self.batches as usize);
        scratch.landed.start(shared(m, &self.table), self.table.len(), batches);
        scratch.chained.clear();
        scratch.fates.clear();
        scratch.fates.resize(m * batches, Fate::default());
        let mut parts: Vec<(usize, Lanes)> = shared(m, &self.table)
            .map(|part| (part.start, Lanes::new(self.visibility, self.mesh, elements[part].iter().copied())))
            .collect();
        for batch in 0..self.batches {
            let scramble = Scramble::new(seed_of(&[self.casting.seed, first, batch]));
            self.table.scramble(&scramble, &mut scratch.points);
            for (offset, lanes) in &mut parts {
                lanes.shift(self.casting.seed, batch, self.table.shared_bits());
                self.arch.dispatch(Packets { caster: self, scratch, lanes, offset: *offset, batch });
            }
        }
        scratch.chained.sort_by_key(|c| c.0);
    }

    /// Casts one randomisation of a part of a group, which begins at element `offset` of it. `WHOLE`: the part fills packets with one
    /// point each.
    #[inline(always)]
    fn packets<S: Simd, const WHOLE: bool>(
        &self,
        simd: S,
        scratch: &mut Scratch,
        lanes: &Lanes,
        offset: usize,
        batch: u32,
    ) {
        let n = self.table.len();
        let first = self.place(scratch, offset, batch);
        scratch.cast += (n * lanes.sources.len()) as u64;
        let step = if WHOLE { 1 } else { lanes.points_a_packet() };
        let whole = lanes.active(step);
        let part = offset..offset + lanes.sources.len();
        // By lane: where in a tile its rays go, the element's face, and how many of its rays met nothing or were absorbed.
        let (mut own, mut face) = ([0; LANES], [0; LANES]);
        for l in 0..LANES {
            let (k, point) = lanes.place(l);
            (own[l], face[l]) = (k * POINTS + point, lanes.sources[k].face);
        }
        let (mut escaped, mut absorbed) = ([0u32; LANES], [0u32; LANES]);
        let none = self.targets.none();
        for base in (0..n).step_by(step) {
            let rays = lanes.rays::<WHOLE>(&scratch.points, base);
            let active = if n - base >= step { whole } else { lanes.active(n - base) };
            scratch.packet.fill(&rays, active);
            self.visibility.closest16(&mut scratch.packet, true);
            let hits = scratch.packet.hits(none);
            let landings = self.targets.landings(simd, &hits);
            // No closures here: they would not be compiled for the wider registers.
            let (mut other, mut any) = ([0; LANES], 0);
            for l in 0..LANES {
                let kind = landings.kind[l];
                escaped[l] += u32::from(kind & u32::from(ESCAPED) != 0);
                let own = u32::from(hits.face[l] == face[l]);
                other[l] = kind & u32::from(EMITTER | SPECULAR | UNREACHED | IMMERSED) | own;
                let ends = if other[l] == 0 { kind } else { 0 };
                absorbed[l] += u32::from(ends & u32::from(ABSORBED) != 0);
            }
            for other in other {
                any |= other;
            }
            if active == u16::MAX && any == 0 {
                let tile = scratch.landed.tile(batch as usize, &part, base);
                let tile = &mut tile[..LANES / step * POINTS];
                for l in 0..LANES {
                    let own = if WHOLE { l * POINTS } else { own[l] };
                    tile[own + base % POINTS] = landings.column[l];
                }
                continue;
            }
            for l in 0..LANES {
                let (k, point) = lanes.place(l);
                if active >> l & 1 == 0 {
                    escaped[l] -= 1;
                    continue;
                }
                let column = if other[l] == 0 { landings.column[l] } else { NONE };
                scratch.landed.set(batch as usize, offset + k, base + point, column);
                if other[l] != 0 {
                    self.beyond(scratch, &lanes.sources[k], (offset + k, batch, (base + point) as u32), l);
                }
            }
        }
        for l in 0..LANES {
            let fate = &mut scratch.fates[first + lanes.place(l).0];
            fate.escaped += escaped[l];
            fate.absorbed += absorbed[l];
        }
    }

    /// Where an element of a group stands among all, in one randomisation.
    fn place(&self, scratch: &Scratch, k: usize, batch: u32) -> usize {
        batch as usize * (scratch.fates.len() / self.batches as usize) + k
    }

    /// Adds up the row of the `k`-th element of a group, and what light its rays found.
    fn row(
        &self,
        scratch: &mut Scratch,
        k: usize,
        mut light: Option<(&mut EmitterRows, usize)>,
    ) -> RowSummary {
        let (n, batches) = (self.table.len(), self.batches as usize);
        let mut row = RowSummary::default();
        let mut covered = 0;
        for batch in 0..self.batches {
            let place = self.place(scratch, k, batch);
            let fate = &mut scratch.fates[place];
            let scale = fate.settle(n);
            covered += fate.covered;
            row.escaped += scale * (fate.chains.escaped + Rgb::splat(f64::from(fate.escaped)));
            row.absorbed += scale * (fate.chains.absorbed + Rgb::splat(f64::from(fate.absorbed)));
            row.dropped += scale * fate.chains.dropped;
            if let Some((EmitterRows { mean, total, .. }, at)) = &mut light {
                let emitted = fate.emitted * (scale / n as f64);
                add_batch(&mut mean[*at], &mut total[*at * batches + batch as usize], emitted, batches);
            }
            self.factors(scratch, (k as u32, batch), scale);
        }
        let total = u64::from(self.rays_per_row());
        let open = total - u64::from(covered);
        let scale = if open > 0 { 1.0 / open as f64 } else { 0.0 };
        scratch.builder.end_row(batches, self.channels, scale);
        row.escaped *= scale;
        row.absorbed *= scale;
        row.dropped *= scale;
        row.exposed = open as f64 / total as f64;
        row
    }

    /// Adds one randomisation to a row: what each of its rays counts is `scale`.
    fn factors(&self, scratch: &mut Scratch, at: (u32, u32), scale: Rgb) {
        let (landed, rays) = (scratch.landed.row(at.1 as usize, at.0 as usize), scratch.landed.row_len());
        let builder = &mut scratch.builder;
        let first = scratch.chained.partition_point(|c| c.0 < at);
        let chained = || scratch.chained[first..].iter().take_while(|c| c.0 == at);
        let scale = scale.as_vec3().to_array();
        if let (Some(counts), None) = (&mut scratch.counts, chained().next()) {
            if self.casting.specular == AtSpecular::End {
                let (met, counts) = counts.count(landed, rays);
                builder.push_counts(met, counts.len() as u32 - 1, counts);
            } else {
                counts.each(landed, rays, |column, count| {
                    builder.push(column, &scale.map(|s| s * count as f32)[..self.channels]);
                });
            }
            builder.end_batch();
            return;
        }
        for &column in landed.flatten().filter(|c| **c != NONE) {
            scratch.tally.add(column, &scale[..self.channels]);
        }
        for (_, column, weight) in chained() {
            let weight: [f32; 3] = std::array::from_fn(|c| weight[c] * scale[c]);
            scratch.tally.add(*column, &weight[..self.channels]);
        }
        scratch.tally.drain(|column, weight| builder.push(column, weight));
        builder.end_batch();
    }
}
