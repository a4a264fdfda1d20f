//! Where particles from the emitters are worth sending.
//!
//! Most light of a lamp goes straight to diffuse surfaces and is not for particles: only what comes over specular
//! chains is. A few particles over a grid of directions tell where these begin, and the others are sent there more often, and
//! weigh less: a projection map (Jensen 1996, "Global illumination using photon maps", section 3), found by tracing.

use super::specular::{Carried, Chains};
use crate::color;
use crate::emitters::{EmitterSample, Emitters, Passage};
use crate::geometry::Frame;
use crate::mesh::{Mesh, NONE};
use crate::sampling::{MAX_POINTS, concentric_square, cosine_hemisphere, seed_of, sobol};
use crate::visibility::{SurfaceHit, Visibility};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Cells along an edge of the unit square of directions.
const EDGE: usize = 32;
/// Share of the particles that goes everywhere alike: what the first ones missed is found, too.
const EVEN: f64 = 0.2;
/// With more emitting sides than this they share one grid, each about its own normal.
const MOST_GRIDS: usize = 32;
/// What a cell beside one that brings light is worth of it: their border is not where specular things end.
const BESIDE: f64 = 0.5;

/// Density of particles over the directions in which emitters send them.
#[derive(Debug, Clone)]
pub struct ProjectionMap {
    grids: Vec<Grid>,
    /// Share of particles that bring light over a specular chain, sent in proportion to the emitted light.
    pub useful: f64,
    /// The same of particles that are aimed.
    pub aimed: f64,
    /// Rays cast to find out.
    pub rays: u64,
}

#[derive(Debug, Clone)]
struct Grid {
    /// Density of each cell relative to emitted light, row by row.
    density: Vec<f64>,
    /// Where the rows begin in [0, 1], and the end.
    rows: Vec<f64>,
    /// Where the cells of each row begin in [0, 1], and the end.
    columns: Vec<Vec<f64>>,
}

/// What a few particles found in one cell.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// Root mean square of the power that arrived, of 1 sent.
    strength: f64,
    /// Share of those that arrived.
    arrived: f64,
}

impl ProjectionMap {
    /// Looks with about `particles` particles where light over specular chains comes to the elements of a mesh. Returns
    /// none where none of them brought any: then hemisphere rays may have all of it.
    pub fn new(
        visibility: &Visibility,
        mesh: &Mesh,
        emitters: &Emitters,
        particles: u32,
        seed: u32,
    ) -> Option<ProjectionMap> {
        let grids = if emitters.len() > MOST_GRIDS { 1 } else { emitters.len() };
        let each = (particles as usize / (grids * EDGE * EDGE)).max(1) as u32;
        let looked: Vec<(Vec<Cell>, u64)> = (0..grids * EDGE)
            .into_par_iter()
            .map(|row| {
                let side = (grids == emitters.len()).then_some(row / EDGE);
                let look =
                    Look { visibility, mesh, emitters, side, seed: seed_of(&[seed, row as u32, 0xa13]) };
                look.row(row % EDGE, each)
            })
            .collect();
        let mut map = ProjectionMap {
            grids: Vec::new(),
            useful: 0.0,
            aimed: 0.0,
            rays: looked.iter().map(|l| l.1).sum(),
        };
        for (k, rows) in looked.chunks(EDGE).enumerate() {
            let cells: Vec<Cell> = rows.iter().flat_map(|r| r.0.iter().copied()).collect();
            let grid = Grid::new(&cells);
            let chance = if grids == 1 { 1.0 } else { emitters.chance(k) };
            for (cell, density) in cells.iter().zip(&grid.density) {
                let share = chance * cell.arrived / (EDGE * EDGE) as f64;
                map.useful += share;
                map.aimed += share * density;
            }
            map.grids.push(grid);
        }
        (map.useful > 0.0).then_some(map)
    }

    fn grid(&self, side: usize) -> &Grid {
        &self.grids[if self.grids.len() == 1 { 0 } else { side }]
    }

    /// A direction for a particle from a point of an emitter, and its density relative to the emitted light's, cos / pi; `u` in [0, 1)^2.
    pub fn sample(&self, s: &EmitterSample, u: [f64; 2]) -> (DVec3, f64) {
        let (p, density) = self.grid(s.side).sample(u);
        (Frame::new(s.normal).to_scene(cosine_hemisphere(p[0], p[1])), density)
    }

    /// That density for a direction in which a side of this unit normal emits.
    pub fn density(&self, side: usize, normal: DVec3, direction: DVec3) -> f64 {
        let local = Frame::new(normal).to_local(direction);
        let (u, v) = concentric_square(local.truncate());
        let cell = |x: f64| ((x * EDGE as f64) as usize).min(EDGE - 1);
        self.grid(side).density[cell(v) * EDGE + cell(u)]
    }
}

impl Grid {
    fn new(cells: &[Cell]) -> Grid {
        let at = |i: usize, j: usize| cells[i * EDGE + j].strength;
        let near = |k: usize| k.saturating_sub(1)..(k + 2).min(EDGE);
        let mut worth = Vec::with_capacity(cells.len());
        for (i, j) in (0..EDGE).flat_map(|i| (0..EDGE).map(move |j| (i, j))) {
            let beside = near(i).flat_map(|a| near(j).map(move |b| at(a, b))).fold(0.0, f64::max);
            worth.push(at(i, j).max(BESIDE * beside));
        }
        let mean = worth.iter().sum::<f64>() / worth.len() as f64;
        let density = |w: &f64| if mean > 0.0 { EVEN + (1.0 - EVEN) * w / mean } else { 1.0 };
        let density: Vec<f64> = worth.iter().map(density).collect();
        let rows: Vec<f64> = density.chunks(EDGE).map(|r| r.iter().sum()).collect();
        Grid { rows: cumulative(&rows), columns: density.chunks(EDGE).map(cumulative).collect(), density }
    }

    fn sample(&self, u: [f64; 2]) -> ([f64; 2], f64) {
        let (i, v) = place(&self.rows, u[1]);
        let (j, w) = place(&self.columns[i], u[0]);
        ([(j as f64 + w) / EDGE as f64, (i as f64 + v) / EDGE as f64], self.density[i * EDGE + j])
    }
}

/// Sums of all values before each, of their total; all of it at the end.
fn cumulative(values: &[f64]) -> Vec<f64> {
    let total: f64 = values.iter().sum();
    let mut sum = 0.0;
    let mut begins: Vec<f64> = vec![0.0];
    begins.extend(values.iter().map(|v| {
        sum += v / total;
        sum
    }));
    begins
}

/// The interval in which `u` lies, and where in it, in [0, 1).
fn place(begins: &[f64], u: f64) -> (usize, f64) {
    let k = begins.partition_point(|b| *b <= u).clamp(1, begins.len() - 1) - 1;
    (k, ((u - begins[k]) / (begins[k + 1] - begins[k])).clamp(0.0, 1.0 - f64::EPSILON))
}

/// Particles sent to find out what a direction is worth.
struct Look<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    emitters: &'a Emitters,
    /// The emitting side; none for any.
    side: Option<usize>,
    seed: u32,
}

impl Look<'_, '_> {
    /// Sends `each` particles through each cell of a row.
    fn row(&self, row: usize, each: u32) -> (Vec<Cell>, u64) {
        let chains = Chains::new(self.visibility, Some(self.emitters));
        let mut rays = 0;
        let mut cells = vec![Cell::default(); EDGE];
        for (column, cell) in cells.iter_mut().enumerate() {
            for k in 0..each {
                let point = (column as u32 * each + k) % MAX_POINTS;
                let u = sobol(point, 0, self.seed);
                let sample = match self.side {
                    Some(side) => Some(self.emitters.on_side(side, [u[0], u[1]])),
                    None => self.emitters.sample([sobol(point, 0, seed_of(&[self.seed, 1]))[0], u[0], u[1]]),
                };
                let Some(s) = sample else { continue };
                let p = cosine_hemisphere(
                    (column as f64 + u[2]) / EDGE as f64,
                    (row as f64 + u[3]) / EDGE as f64,
                );
                let direction = Frame::new(s.normal).to_scene(p).as_vec3();
                let origin = self.visibility.leave(s.face, s.point, s.normal);
                rays += 1;
                let Some(hit) = self.visibility.closest(origin, direction, s.face) else { continue };
                let (arrived, cast) = self.arrived(&chains, (origin, direction, hit), point);
                rays += cast;
                cell.strength += arrived * arrived / f64::from(each);
                cell.arrived += f64::from(u8::from(arrived > 0.0)) / f64::from(each);
            }
            cell.strength = cell.strength.sqrt();
        }
        (cells, rays)
    }

    /// Power that a particle of power 1 brings to elements over specular chains, and rays cast for it.
    fn arrived(&self, chains: &Chains, ray: (Vec3, Vec3, SurfaceHit), point: u32) -> (f64, u64) {
        let scene = self.visibility.scene();
        if !scene.material(&scene.faces[ray.2.face as usize]).is_specular() {
            return (0.0, 0);
        }
        let mut arrived = 0.0;
        let end = chains.follow(Carried::Power, ray, (point, seed_of(&[self.seed, 2])), 1.0, |link| {
            let at = &link.hit;
            let counts =
                link.passage == Passage::Chain && self.mesh.element(at.face, at.front, at.u, at.v) != NONE;
            arrived += if counts { color::mean(link.weight) } else { 0.0 };
        });
        (arrived, u64::from(end.rays))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The grid's samples have the density that it states: of a regular lattice, as many fall into each cell as its density
    /// says, to one row of the lattice; it integrates to 1; nothing is left out.
    #[test]
    fn samples_have_the_density() {
        let mut cells = vec![Cell::default(); EDGE * EDGE];
        for (k, strength) in [(5, 1.0), (6, 0.25), (700, 2.0), (1023, 0.5)] {
            cells[k].strength = strength;
        }
        let grid = Grid::new(&cells);
        let mean = grid.density.iter().sum::<f64>() / grid.density.len() as f64;
        assert!((mean - 1.0).abs() < 1e-12 && grid.density.iter().all(|d| *d >= EVEN));
        let n = 2048;
        let mut counts = vec![0.0; EDGE * EDGE];
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let u = [i, j].map(|k| (f64::from(k) + 0.5) / f64::from(n));
            let (p, density) = grid.sample(u);
            let [a, b] = p.map(|x| (x * EDGE as f64) as usize);
            assert_eq!(density, grid.density[b * EDGE + a]);
            counts[b * EDGE + a] += (EDGE * EDGE) as f64 / f64::from(n * n);
        }
        for (count, density) in counts.iter().zip(&grid.density) {
            assert!((count - density).abs() < 0.1 + 0.02 * density, "{count} {density}");
        }
    }

    /// A direction is found in the cell that it was drawn from.
    #[test]
    fn density_of_a_direction_is_that_it_was_drawn_with() {
        let mut cells = vec![Cell::default(); EDGE * EDGE];
        (0..cells.len()).step_by(7).for_each(|k| cells[k].strength = (k % 5) as f64);
        let map = ProjectionMap { grids: vec![Grid::new(&cells)], useful: 1.0, aimed: 1.0, rays: 0 };
        let normal = DVec3::new(0.36, 0.48, -0.8);
        for k in 0..1000 {
            let u = sobol(k, 0, 3);
            let (p, density) = map.grids[0].sample([u[0], u[1]]);
            // Rounding moves what lies on the border between cells.
            let inside = p.iter().all(|x| ((x * EDGE as f64).fract() - 0.5).abs() < 0.5 - 1e-9);
            let direction = Frame::new(normal).to_scene(cosine_hemisphere(p[0], p[1]));
            assert!(!inside || map.density(0, normal, direction) == density, "{p:?}");
        }
    }
}
