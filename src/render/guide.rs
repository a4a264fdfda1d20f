//! Where a patch's light comes from, as pass 1 knows it: rays that gather in pass 2 go there more often.
//!
//! Each patch that is gathered on has a density over the unit square of cosine-weighted directions, constant on cells, in
//! proportion to the root mean square of the radiance that a few rays read from pass 1. Uniform points of the square are
//! warped by it and the rays' weights divided by it. No direction goes without rays, so that the estimate is free of bias
//! whatever the density. Path guiding learns such densities from paths (Mueller et al. 2017); pass 1 knows them beforehand.

use super::{Context, Method, Quality, Settings};
use crate::color;
use crate::form_factor::Chains;
use crate::geometry::Frame;
use crate::mesh::{Mesh, NONE};
use crate::radiosity::Solution;
use crate::sampling::{cosine_hemisphere, seed_of, sobol};
use crate::scene::{Camera, Scene};
use crate::visibility::{SurfacePoint, Visibility};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Cells along each side of the square.
const CELLS: usize = 16;
/// Slots of an axis that its cells share.
const SLOTS: usize = 64;
/// Slots that each cell has in any case: a quarter of an even share, so that no direction gets less than a sixteenth of its
/// cosine-weighted rays.
const LEAST: usize = SLOTS / CELLS / 4;
/// Rays that find a density, on average two a cell.
const RAYS: u32 = 2 * (CELLS * CELLS) as u32;
/// Densities are made where they take less than this share of the rays that gather.
const SHARE: f64 = 1.0 / 32.0;
/// An even density does as well where a density in proportion would lower the second moment by less than this factor.
const GAIN: f64 = 1.3;

/// A density over the unit square of cosine-weighted directions.
pub(super) struct Guide {
    rows: Axis,
    cells: [Axis; CELLS],
}

/// A piecewise linear map of [0, 1) to itself.
#[derive(Clone, Copy)]
struct Axis {
    /// The cell that a slot belongs to.
    cell: [u8; SLOTS],
    /// Offset and slope of each cell's map.
    map: [[f32; 2]; CELLS],
}

impl Axis {
    /// Cells in proportion to `shares` (of any positive sum), beyond what each has in any case.
    fn new(shares: &[f64; CELLS]) -> Axis {
        let total: f64 = shares.iter().sum();
        let spare = (SLOTS - LEAST * CELLS) as f64;
        let mut axis = Axis { cell: [0; SLOTS], map: [[0.0; 2]; CELLS] };
        let (mut below, mut first) = (0.0, 0);
        for (k, share) in shares.iter().enumerate() {
            below += share;
            let end = LEAST * (k + 1) + (spare * below / total).round() as usize;
            axis.cell[first..end].fill(k as u8);
            let slope = SLOTS as f32 / (CELLS * (end - first)) as f32;
            axis.map[k] = [k as f32 / CELLS as f32 - slope * (first as f32 / SLOTS as f32), slope];
            first = end;
        }
        axis
    }

    /// The cell of `x`, where `x` goes, and one over the density there.
    #[inline(always)]
    fn warp(&self, x: f32) -> (usize, f32, f32) {
        // The leading bits of x.
        let slot = (1.0 + x).to_bits() >> (23 - SLOTS.ilog2());
        let cell = usize::from(self.cell[slot as usize % SLOTS]) % CELLS;
        let [offset, slope] = self.map[cell];
        (cell, (offset + slope * x).min(1.0 - f32::EPSILON), slope)
    }
}

/// Roots of the sums of squared radiance by cell.
fn blurred(squares: &[[f64; CELLS]; CELLS]) -> [[f64; CELLS]; CELLS] {
    // A ray in one cell says something of its neighbours too.
    let near = |k: usize| {
        (k.saturating_sub(1)..(k + 2).min(CELLS)).map(move |i| (i, [1.0, 2.0][usize::from(i == k)]))
    };
    std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            let (sum, weights) = near(r)
                .flat_map(|(i, a)| near(c).map(move |(j, b)| (i, j, a * b)))
                .fold((0.0, 0.0), |(sum, weights), (i, j, w)| (sum + w * squares[i][j], weights + w));
            f64::sqrt(sum / weights)
        })
    })
}

/// By how much the mean of the squares exceeds the square of the mean: the second moment with an even density over that with one in
/// proportion.
fn gain(shares: &[[f64; CELLS]; CELLS]) -> f64 {
    let sum = |f: fn(f64) -> f64| shares.iter().flatten().map(|s| f(*s)).sum::<f64>();
    (CELLS * CELLS) as f64 * sum(|s| s * s) / sum(|s| s).powi(2)
}

impl Guide {
    /// A density in proportion to `shares`.
    fn new(shares: &[[f64; CELLS]; CELLS]) -> Guide {
        let shares = shares.map(|row| row.map(|s| s.max(f64::MIN_POSITIVE.sqrt())));
        let rows = shares.map(|row| row.iter().sum());
        Guide { rows: Axis::new(&rows), cells: shares.map(|row| Axis::new(&row)) }
    }

    /// Where the uniform point (u, v) of the square goes, and one over the density there.
    #[inline(always)]
    pub fn warp(&self, u: f32, v: f32) -> ([f32; 2], f32) {
        let (row, u, a) = self.rows.warp(u);
        let (_, v, b) = self.cells[row].warp(v);
        ([u, v], a * b)
    }
}

/// Densities of all patches, each made when it is first asked for.
pub(super) struct Guides {
    /// Patches that share a density: elements of a mesh, coarser than that of pass 1 where pixels are few.
    patches: Mesh,
    /// None where an even density is as good.
    made: Vec<OnceLock<Option<Box<Guide>>>>,
    /// Patches whose densities take no more than [`SHARE`] of the rays of an image.
    most: f64,
}

impl Guides {
    /// For images of `size` pixels; none where the settings do not gather.
    pub fn new(scene: &Scene, solution: &Solution, size: [u32; 2], settings: &Settings) -> Option<Guides> {
        if settings.method != Method::TwoPass(Quality::Gather) {
            return None;
        }
        let [width, height] = size;
        let gathering =
            f64::from(width) * f64::from(height) * f64::from(settings.spp) * f64::from(settings.gather_rays);
        let most = SHARE * gathering / f64::from(RAYS);
        let mesh = &solution.mesh;
        let mut patches = Mesh::patches(scene, &mesh.sides(), mesh.element_size).ok()?;
        for _ in 0..3 {
            let many = patches.len() as f64 / most;
            if many > 1.0 {
                patches = Mesh::patches(scene, &mesh.sides(), patches.element_size * many.sqrt()).ok()?;
            }
        }
        let made = (0..patches.len()).map(|_| OnceLock::new()).collect();
        Some(Guides { patches, made, most })
    }

    /// Whether the patches that a camera sees are few enough, and the rays that found out.
    pub fn are_worth(&self, visibility: &Visibility, camera: &Camera) -> (bool, u64) {
        if self.patches.len() as f64 <= self.most {
            return (true, 0);
        }
        // More where faces are smaller than patches: those out of sight are not made.
        let rays = u64::from(camera.size[0]) * u64::from(camera.size[1]);
        (in_sight(visibility, camera, &self.patches) as f64 <= self.most, rays)
    }
}

/// How many patches the centres of the pixels see.
fn in_sight(visibility: &Visibility, camera: &Camera, patches: &Mesh) -> usize {
    let frame = camera.frame(visibility.scene());
    let [width, height] = camera.size;
    let mut seen: Vec<u32> = (0..width * height)
        .into_par_iter()
        .map(|k| {
            let direction = frame.direction(f64::from(k % width) + 0.5, f64::from(k / width) + 0.5);
            let hit = visibility.closest(frame.origin().as_vec3(), direction.as_vec3(), u32::MAX);
            hit.map_or(NONE, |hit| patches.element(hit.face, hit.front, hit.u, hit.v))
        })
        .collect();
    seen.par_sort_unstable();
    seen.dedup();
    seen.len()
}

impl Context<'_, '_> {
    /// The density at a point, on the side seen (`side` 1) or the other one (-1); none where an even one does as well.
    pub(super) fn guide(&self, at: &SurfacePoint, side: f64) -> Option<&Guide> {
        let guides = self.guides?;
        let patch = guides.patches.element(at.face, at.front == (side > 0.0), at.u, at.v);
        guides.made.get(patch as usize)?.get_or_init(|| self.make_guide(&guides.patches, patch)).as_deref()
    }

    fn make_guide(&self, patches: &Mesh, patch: u32) -> Option<Box<Guide>> {
        let place = patches.place_of(self.scene, patch);
        let (face, normal) = (place.face, place.normal);
        let frame = Frame::new(normal);
        let seed = seed_of(&[self.settings.seed, patch, 0x601de]);
        let chains = Chains::new(self.visibility, Some(self.emitters));
        let mut squares = [[0.0; CELLS]; CELLS];
        for k in 0..RAYS {
            let [u, v, s, t] = sobol(k, 0, seed);
            let origin = self.visibility.leave(face, self.visibility.start(&place, s, t), normal);
            let direction = frame.to_scene(cosine_hemisphere(u, v)).as_vec3();
            let radiance = match self.visibility.closest(origin, direction, face) {
                Some(hit) => self.arriving(&chains, (origin, direction, hit), (normal, 1.0), (k, seed)),
                None => self.scene.environment,
            };
            let [r, c] = [u, v].map(|x| (x * CELLS as f64) as usize);
            squares[r][c] += color::mean(radiance).powi(2);
        }
        self.cast(RAYS);
        let shares = blurred(&squares);
        (gain(&shares) > GAIN).then(|| Box::new(Guide::new(&shares)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One bright cell in the dark, one dark row, a slope, all black.
    fn examples() -> [[[f64; CELLS]; CELLS]; 4] {
        let of = |f: fn(usize, usize) -> f64| std::array::from_fn(|r| std::array::from_fn(|c| f(r, c)));
        [
            of(|r, c| if (r, c) == (3, 15) { 1.0 } else { 1e-3 }),
            of(|r, _| if r == 7 { 0.0 } else { 1.0 }),
            of(|r, c| 1.0 + (r * c) as f64),
            of(|_, _| 0.0),
        ]
    }

    /// The midpoints of a fine grid, warped: those that land in a cell times their weights make the cell's area, and every
    /// cell gets at least a sixteenth of its points.
    #[test]
    fn weights_undo_the_density() {
        const N: usize = 512;
        for shares in examples() {
            let guide = Guide::new(&shares);
            let (mut weights, mut points) = ([[0.0; CELLS]; CELLS], [[0; CELLS]; CELLS]);
            for k in 0..N * N {
                let [u, v] = [k / N, k % N].map(|k| (k as f32 + 0.5) / N as f32);
                let ([u, v], w) = guide.warp(u, v);
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v), "{u} {v}");
                let [r, c] = [u, v].map(|x| (x * CELLS as f32) as usize);
                weights[r][c] += f64::from(w) / (N * N) as f64;
                points[r][c] += 1;
            }
            let area = 1.0 / (CELLS * CELLS) as f64;
            assert!(weights.iter().flatten().all(|w| (w / area - 1.0).abs() < 1e-5), "{weights:?}");
            let even = N * N / (CELLS * CELLS);
            assert!(points.iter().flatten().all(|p| *p >= even / 16), "{points:?}");
        }
    }

    /// What a bright cell sends varies less by as much as the density allows: 53 of 64 slots along both axes at most.
    #[test]
    fn a_bright_cell_gets_the_points() {
        let shares = &examples()[0];
        let guide = Guide::new(shares);
        let n = 1 << 14;
        let second = |warped: bool| {
            let squares = (0..n).map(|k| {
                let [u, v] = [sobol(k, 0, 1)[0] as f32, sobol(k, 0, 1)[1] as f32];
                let ([u, v], w) = if warped { guide.warp(u, v) } else { ([u, v], 1.0) };
                let [r, c] = [u, v].map(|x| (x * CELLS as f32) as usize);
                (f64::from(w) * shares[r][c]).powi(2)
            });
            squares.sum::<f64>() / f64::from(n)
        };
        let lower = second(false) / second(true);
        assert!(lower > 100.0, "{lower}");
        let predicted = gain(shares);
        assert!(predicted > 100.0, "{predicted}");
    }

    #[test]
    fn the_ends_stay_inside() {
        for shares in examples() {
            let guide = Guide::new(&shares);
            let last = 1.0 - f32::EPSILON / 2.0;
            for (u, v) in [(0.0, 0.0), (last, last), (0.0, last), (last, 0.0)] {
                let ([u, v], w) = guide.warp(u, v);
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v) && w > 0.0, "{u} {v} {w}");
            }
        }
    }
}
