//! Light that comes from emitters over specular chains, by particles from the emitters.
//!
//! A hemisphere ray of an element rarely finds a small emitter behind a mirror, a glass ball or a
//! glossy floor; a particle that starts at the emitter finds the element easily. Both sample the same paths:
//! by reciprocity a path has the density `1 / (pi A_i)` per area and projected solid angle for a ray of element
//! i, and `p / pi` for a particle that starts with area density p (more or less where particles are aimed, [`crate::form_factor::ProjectionMap`]). Both are constant along
//! the path (its throughput is the same from both ends), so they share the work by the power heuristic.
//! Paths over one flat mirror are left out: these have their own samples ([`crate::emitters`]).

use super::Field;
use crate::color::Rgb;
use crate::emitters::{Emitters, Passage};
use crate::form_factor::{Carried, Chains, EmitterWork};
use crate::geometry::Frame;
use crate::mesh::{Mesh, NONE, Nodes};
use crate::sampling::{MAX_POINTS, cosine_hemisphere, seed_of, sobol};
use crate::scene::Scene;
use crate::visibility::Visibility;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Cells of the map along an element's edge: caustics have sharper edges than the rest of the
/// indirect light, and cells for them cost no form factors.
const FINENESS: f64 = 4.0;
/// Most cells of the map.
const MOST_CELLS: f64 = 4e6;
/// Particles of one task.
const BLOCK: u32 = 1 << 13;

/// What particles brought to the elements and, finer, to the cells of a map.
pub struct Caustic {
    /// Irradiance by (element, randomisation), over the whole element [W m^-2].
    pub by_element: Vec<Rgb>,
    /// The same light, finer; none where no particle arrived.
    pub map: Option<CausticMap>,
    /// Rays cast.
    pub rays: u64,
}

/// Radiosity reflected from light that particles brought, on cells finer than the elements.
#[derive(Debug, Clone)]
pub struct CausticMap {
    mesh: Mesh,
    nodes: Nodes,
    field: Field,
}

impl CausticMap {
    /// Reflected radiosity at (u, v) of a side [W m^-2]; none where the side has no cells.
    pub fn at(&self, side: (u32, bool), u: f32, v: f32) -> Option<Rgb> {
        self.field.at(&self.mesh, &self.nodes, side, u, v)
    }

    /// A map of known values.
    pub(super) fn of(mesh: Mesh, nodes: Nodes, field: Field) -> CausticMap {
        CausticMap { mesh, nodes, field }
    }

    /// What its cells were made by: their largest edge \[m\].
    pub(super) fn element_size(&self) -> f64 {
        self.mesh.element_size
    }

    /// Its values on the nodes of its cells.
    pub(super) fn field(&self) -> &Field {
        &self.field
    }
}

/// A particle's arrival.
struct Arrival {
    element: u32,
    cell: u32,
    irradiance: [f32; 3],
}

/// The cells of the map on the elements of a mesh.
///
/// # Errors
/// They are too many to be numbered.
pub fn cells_of(scene: &Scene, mesh: &Mesh) -> crate::Result<Mesh> {
    let area: f64 = (0..mesh.len() as u32).map(|e| mesh.area(e)).sum();
    let size = (mesh.element_size / FINENESS).max((area / MOST_CELLS).sqrt());
    Mesh::new(scene, &mesh.sides(), size, false)
}

/// Sends the particles of `work` from the emitters, equally many in each of `batches` independent randomisations, to the elements of a
/// mesh and their `cells` ([`cells_of`]).
///
/// `rays` is the number of hemisphere rays an element that share the paths.
pub fn trace_particles(
    visibility: &Visibility,
    (mesh, cells): (&Mesh, Mesh),
    emitters: &Emitters,
    (batches, work): (u32, EmitterWork),
    rays: u32,
    seed: u32,
) -> Caustic {
    let scene = visibility.scene();
    let particles = work.particles / batches;
    let tracer = Tracer { visibility, mesh, cells: &cells, emitters, work, rays, seed };
    let mut by_element = vec![Rgb::ZERO; mesh.len() * batches as usize];
    let mut by_cell = vec![Rgb::ZERO; cells.len()];
    let mut cast = 0;
    let blocks = particles.div_ceil(BLOCK);
    let tasks: Vec<(u32, u32)> =
        (0..batches).flat_map(|batch| (0..blocks).map(move |b| (batch, b))).collect();
    // Rounds bound the memory of arrivals; each round is added up in a fixed order.
    for round in tasks.chunks(64) {
        let arrived: Vec<(u32, Vec<Arrival>, u64)> = round
            .par_iter()
            .map(|&(batch, b)| {
                let (list, rays) = tracer.block(batch, b * BLOCK..((b + 1) * BLOCK).min(particles));
                (batch, list, rays)
            })
            .collect();
        for (batch, list, rays) in &arrived {
            cast += rays;
            for a in list {
                let irradiance = Rgb::from(a.irradiance.map(f64::from));
                let area = mesh.area(a.element);
                by_element[a.element as usize * batches as usize + *batch as usize] +=
                    irradiance * (f64::from(batches) / area);
                by_cell[a.cell as usize] += irradiance / cells.area(a.cell);
            }
        }
    }
    let lit = by_cell.iter().any(|c| *c != Rgb::ZERO);
    let map = lit.then(|| CausticMap::new(scene, cells, &by_cell));
    Caustic { by_element, map, rays: cast }
}

impl CausticMap {
    fn new(scene: &Scene, mesh: Mesh, irradiance: &[Rgb]) -> CausticMap {
        let transport = super::Transport::of(scene, &mesh);
        let nodes = Nodes::new(scene, &mesh);
        let open = vec![1.0; mesh.len()];
        let field = Field::smooth(&mesh, &nodes, &open, &transport.reflect(irradiance));
        CausticMap { mesh, nodes, field }
    }
}

struct Tracer<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    cells: &'a Mesh,
    emitters: &'a Emitters,
    work: EmitterWork<'a>,
    rays: u32,
    seed: u32,
}

impl Tracer<'_, '_> {
    /// Particles `range` of a randomisation: arrivals with power [W], and rays cast.
    fn block(&self, batch: u32, range: std::ops::Range<u32>) -> (Vec<Arrival>, u64) {
        let scene = self.visibility.scene();
        let chains = Chains::new(self.visibility, Some(self.emitters));
        let (mut list, mut cast) = (Vec::new(), 0u64);
        for k in range {
            let seed = seed_of(&[self.seed, batch, k / MAX_POINTS, 0xca57]);
            let k = k % MAX_POINTS;
            let p = sobol(k, 0, seed);
            let choose = sobol(k, 0, seed_of(&[seed, 1]))[0];
            let Some(s) = self.emitters.sample([choose, p[0], p[1]]) else { break };
            let (direction, aimed) = match self.work.projection {
                Some(projection) => projection.sample(&s, [p[2], p[3]]),
                None => (Frame::new(s.normal).to_scene(cosine_hemisphere(p[2], p[3])), 1.0),
            };
            let direction = direction.as_vec3();
            let origin = self.visibility.leave(s.face, s.point, s.normal);
            cast += 1;
            let Some(hit) = self.visibility.closest(origin, direction, s.face) else { continue };
            if !scene.material(&scene.faces[hit.face as usize]).is_specular() {
                continue;
            }
            let power = s.radiance * (PI / (s.density * aimed * f64::from(self.work.particles)));
            let numbers = (k, seed_of(&[seed, 2]));
            let end = chains.follow(Carried::Power, (origin, direction, hit), numbers, 1.0, |link| {
                if link.passage != Passage::Chain {
                    return;
                }
                let at = &link.hit;
                let element = self.mesh.element(at.face, at.front, at.u, at.v);
                if element == NONE {
                    return;
                }
                let cell = self.cells.element(at.face, at.front, at.u, at.v);
                let densities = (s.density, aimed);
                let share = self.work.particle_share(densities, self.rays, self.mesh.area(element));
                let irradiance = (power * link.weight * share).as_vec3().to_array();
                list.push(Arrival { element, cell, irradiance });
            });
            cast += u64::from(end.rays);
        }
        (list, cast)
    }
}
