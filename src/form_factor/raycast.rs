//! Form factors by ray-cast hemisphere sampling.
//!
//! Rays leave each element uniformly in area and cosine-weighted in direction, so the share of
//! rays that land on element j is `F_ij` itself (Malley 1988; DESIGN section 2). The points are
//! Owen-scrambled Sobol points in four dimensions; every row has several independent scramblings.

use super::matrix::{ExchangeMatrix, RowSummary};
use super::specular::{Chains, Link, pass_on};
use crate::color::Rgb;
use crate::embree::{Ray, RayPacket};
use crate::emitters::{Emitters, Passage, cosine_density, mis_share};
use crate::geometry::Frame;
use crate::mesh::{Mesh, NONE, Sides, side_index};
use crate::sampling::{MAX_POINTS, Scramble, SobolTable, seed_of};
use crate::scene::Scene;
use crate::visibility::{SurfaceHit, Visibility};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Elements that one task casts: small enough to share the work, large enough to keep its buffers.
const BLOCK: usize = 16;

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
    /// Emitters whose light is gathered on the way, and the number of their own samples that share
    /// the work by multiple importance sampling.
    pub emitters: Option<(&'a Emitters, u32)>,
    /// Called with the number of elements finished.
    pub progress: &'a (dyn Fn(u64) + Sync),
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
    let scene = visibility.scene();
    let batches = casting.batches.max(casting.rays.div_ceil(MAX_POINTS)).clamp(1, casting.rays.max(1));
    let per_batch = casting.rays.max(1).div_ceil(batches);
    let kinds = side_kinds(scene, casting);
    let coloured =
        casting.specular && scene.materials.iter().any(|m| m.is_specular() && !m.has_grey_specular());
    let shared = Shared {
        visibility,
        mesh,
        casting,
        table: SobolTable::new(per_batch),
        batches,
        channels: if coloured { 3 } else { 1 },
        chains: Chains::new(visibility, casting.emitters.map(|e| e.0)),
        kinds,
    };
    let n = mesh.len();
    let blocks: Vec<Block> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(
            || Scratch::new(n, shared.channels),
            |scratch, b| {
                let range = b * BLOCK..((b + 1) * BLOCK).min(n);
                let count = range.len() as u64;
                let block = shared.block(scratch, range);
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
        rays_per_row: shared.batches * shared.table.len() as u32,
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

fn side_kinds(scene: &Scene, casting: &Casting) -> Vec<u8> {
    let mut kinds = vec![0; 2 * scene.faces.len()];
    for (k, face) in scene.faces.iter().enumerate() {
        let material = scene.material(face);
        for front in [true, false] {
            let side = side_index(k as u32, front);
            if casting.emitters.is_some_and(|(e, _)| e.at(k as u32, front).is_some()) {
                kinds[side] |= EMITTER;
            }
            if casting.specular && material.is_specular() && (front || material.two_sided) {
                kinds[side] |= SPECULAR;
            }
            if casting.reached.is_some_and(|r| !r.contains(k as u32, front)) {
                kinds[side] |= UNREACHED;
            }
        }
    }
    kinds
}

struct Shared<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    casting: &'a Casting<'a>,
    table: SobolTable,
    batches: u32,
    channels: usize,
    chains: Chains<'a, 's>,
    kinds: Vec<u8>,
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

/// One element's rays: origins and the frame of their directions, in single precision.
struct Source {
    origin: Vec3,
    a: Vec3,
    b: Vec3,
    x: Vec3,
    y: Vec3,
    z: Vec3,
    triangle: bool,
    face: u32,
    normal: DVec3,
}

impl Source {
    fn new(visibility: &Visibility, mesh: &Mesh, element: u32) -> Source {
        let scene = visibility.scene();
        let (face, _, cell) = mesh.place(element);
        let (p0, e1, e2) = scene.face_frame(&scene.faces[face as usize]);
        let grid = mesh.grid(face);
        let (o, a, b) = grid.cell_frame(cell);
        let normal = mesh.normal(scene, element);
        let frame = Frame::new(normal);
        let edge = |d: glam::DVec2| (d.x * e1 + d.y * e2).as_vec3();
        Source {
            origin: visibility.leave(p0 + o.x * e1 + o.y * e2, normal),
            a: edge(a),
            b: edge(b),
            x: frame.x.as_vec3(),
            y: frame.y.as_vec3(),
            z: frame.z.as_vec3(),
            triangle: grid.triangle,
            face,
            normal,
        }
    }

    #[inline]
    fn ray(&self, p: [f32; 4]) -> (Vec3, Vec3) {
        let (s, t) = if !self.triangle {
            (p[0], p[1])
        } else if p[1] > p[0] {
            (0.5 * p[0], p[1] - 0.5 * p[0])
        } else {
            (p[0] - 0.5 * p[1], 0.5 * p[1])
        };
        let (dx, dy) = disc(p[2], p[3]);
        let dz = (1.0 - dx * dx - dy * dy).max(0.0).sqrt();
        (self.origin + s * self.a + t * self.b, dx * self.x + dy * self.y + dz * self.z)
    }
}

/// [`crate::sampling::concentric_disc`] in single precision; the angle stays within 45 degrees, where
/// short polynomials give sine and cosine to 1e-7.
#[inline]
fn disc(u: f32, v: f32) -> (f32, f32) {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    let swap = a.abs() <= b.abs();
    let (r, q) = if swap { (b, a) } else { (a, b) };
    if r == 0.0 {
        return (0.0, 0.0);
    }
    let phi = std::f32::consts::FRAC_PI_4 * (q / r);
    let p2 = phi * phi;
    let sin = phi * (1.0 + p2 * (-1.0 / 6.0 + p2 * (1.0 / 120.0 + p2 * (-1.0 / 5040.0))));
    let cos = 1.0 + p2 * (-0.5 + p2 * (1.0 / 24.0 + p2 * (-1.0 / 720.0 + p2 * (1.0 / 40320.0))));
    if swap { (r * sin, r * cos) } else { (r * cos, r * sin) }
}

impl Shared<'_, '_> {
    fn block(&self, scratch: &mut Scratch, elements: std::ops::Range<usize>) -> Block {
        let mut block = Block::default();
        for element in elements {
            self.row(scratch, element as u32, &mut block);
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
                block.emitted.push(EmitterIrradiance {
                    straight: emitted.straight * scale,
                    image: emitted.image * scale,
                    chain: emitted.chain * scale,
                });
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
        let mut lanes = [(Vec3::ZERO, Vec3::ZERO); 16];
        for base in (0..n).step_by(16) {
            let count = (n - base).min(16);
            if count < 16 {
                scratch.packet.clear();
            }
            for (k, lane) in lanes.iter_mut().enumerate().take(count) {
                *lane = source.ray(self.table.point(base + k, &scramble));
                scratch.packet.set(k, &Ray::new(lane.0, lane.1));
            }
            self.visibility.closest16(&mut scratch.packet, false);
            for (k, &(origin, direction)) in lanes.iter().enumerate().take(count) {
                let Some(hit) = self.visibility.lane(&scratch.packet, k, origin, direction, source.face)
                else {
                    row.escaped += Rgb::ONE;
                    continue;
                };
                let kind = self.kinds[side_index(hit.face, hit.front)];
                if kind & UNREACHED != 0 {
                    *covered += 1;
                    continue;
                }
                let j = self.mesh.element(hit.face, hit.front, hit.u, hit.v);
                if j != NONE {
                    self.count(scratch, j, 1.0);
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
    }

    #[inline]
    fn count(&self, scratch: &mut Scratch, j: u32, weight: f32) {
        let k = j as usize * self.channels;
        if scratch.weight[k] == 0.0 {
            scratch.touched.push(j);
        }
        for w in &mut scratch.weight[k..k + self.channels] {
            *w += weight;
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
        let Some((emitters, samples)) = self.casting.emitters else { return };
        let Some((radiance, density)) = emitters.at(link.hit.face, link.hit.front) else { return };
        let share = if link.passage == Passage::Chain {
            1.0
        } else {
            let normal = self.visibility.scene().faces[link.hit.face as usize].normal;
            let q = density * link.length * link.length / link.direction.dot(normal).abs();
            mis_share(
                f64::from(self.casting.rays),
                cosine_density(first.dot(source.normal)),
                f64::from(samples),
                q,
            )
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
        let mut absorbed = Rgb::ZERO;
        let end = self.chains.follow(origin, direction, hit, numbers, |link| {
            let j = self.mesh.element(link.hit.face, link.hit.front, link.hit.u, link.hit.v);
            if j != NONE {
                let k = j as usize * self.channels;
                if scratch.weight[k] == 0.0 {
                    scratch.touched.push(j);
                }
                for (w, v) in scratch.weight[k..k + self.channels].iter_mut().zip(link.weight.to_array()) {
                    *w += v as f32;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_disc_matches_the_exact_one() {
        for i in 0..=64 {
            for j in 0..=64 {
                let (u, v) = (i as f32 / 64.0, j as f32 / 64.0);
                let exact = crate::sampling::concentric_disc(f64::from(u), f64::from(v));
                let (x, y) = disc(u, v);
                assert!((f64::from(x) - exact.x).abs() < 1e-6 && (f64::from(y) - exact.y).abs() < 1e-6);
            }
        }
    }
}
