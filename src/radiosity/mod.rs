//! Pass 1: the diffuse light of the whole scene, independent of any view.

mod caustic;
mod changes;
mod coarse;
mod direct;
mod directional;
mod exchange;
mod file;
mod importance;
mod lamps;
mod ledger;
mod reconstruct;
mod refine;
mod regions;
mod solve;
mod symmetric;
mod system;
mod trust;
mod uncertainty;

pub use caustic::{Caustic, CausticMap, cells_of as caustic_cells, trace_particles};
pub use changes::Changes;
pub use direct::sample_emitters;
pub use directional::{Directional, solve_directional};
pub use file::Kept;
pub use importance::{Importance, View};
pub use ledger::Ledger;
pub use reconstruct::Field;
pub use refine::{ElementError, Judge, Reads, block_errors};
pub use solve::Convergence;
pub(crate) use system::LITTLE_LOSS;
pub use system::System;
pub use trust::{UNCERTAIN, too_large, warnings};
pub use uncertainty::ObjectRadiosity;

use crate::color::{self, Rgb};
use crate::emitters::Emitters;
use crate::form_factor::{EmitterIrradiance, EmitterRows, ExchangeMatrix, Rows};
use crate::mesh::{Mesh, NONE, Nodes};
use crate::scene::Scene;
use rayon::prelude::*;
use solve::Acceleration;
use std::f64::consts::PI;
use symmetric::Groups;

/// The solved radiosity of a scene; every vector holds one value an element.
#[derive(Debug, Clone)]
pub struct Solution {
    /// The elements.
    pub mesh: Mesh,
    /// Their shared nodes.
    pub nodes: Nodes,
    /// Radiosity, emission included [W m^-2].
    pub radiosity: Vec<Rgb>,
    /// Emitted radiosity [W m^-2].
    pub emitted: Vec<Rgb>,
    /// Irradiance [W m^-2].
    pub irradiance: Vec<Rgb>,
    /// Radiosity reflected and transmitted from light that came straight from emitters [W m^-2].
    pub direct: Vec<Rgb>,
    /// Standard error of `radiosity` [W m^-2]; NaN with a single randomisation.
    pub standard_error: Vec<Rgb>,
    /// Means over the sides of the objects, with their standard errors.
    pub objects: Vec<ObjectRadiosity>,
    /// Where the power went.
    pub ledger: Ledger,
    /// How the solve went.
    pub convergence: Convergence,
    /// Reflected radiosity (emission left out) on the nodes.
    pub reflected: Field,
    /// The part of `reflected` that pass 2 does not sample anew from emitters and their mirror images.
    pub indirect: Field,
    /// The part of `reflected` from emitters by specular chains that pass 2 cannot sample, as far as
    /// hemisphere rays found it; none where the scene has no such chains.
    pub caustic: Option<Field>,
    /// The rest of that part, as particles found it; `indirect` leaves it out.
    pub caustic_map: Option<CausticMap>,
}

impl Solution {
    /// Reflected and transmitted radiosity of an element, emission left out [W m^-2].
    pub fn reflected_radiosity(&self, element: usize) -> Rgb {
        self.radiosity[element] - self.emitted[element]
    }

    /// Share of the light arriving at elements that is lost at a bounce, in the mean; NaN in the dark.
    pub fn loss(&self) -> f64 {
        let arriving: Rgb = (0..self.mesh.len()).map(|e| self.irradiance[e] * self.mesh.area(e as u32)).sum();
        color::mean(self.ledger.emitted + self.ledger.environment) / color::mean(arriving)
    }
}

/// Light from emitters as the three kinds of samples found it.
pub struct EmitterLight {
    /// By hemisphere rays and by samples of the emitters' area; none where there are no emitters.
    pub rows: Option<EmitterRows>,
    /// By particles.
    pub particles: Option<Caustic>,
}

/// Irradiance on an element from each kind of source [W m^-2].
#[derive(Debug, Clone, Copy, Default)]
struct Sources {
    emitters: EmitterIrradiance,
    particles: Rgb,
    environment: Rgb,
}

impl Sources {
    fn total(&self) -> Rgb {
        self.emitters.straight + self.emitters.image + self.emitters.chain + self.particles + self.environment
    }
}

/// Solves for the radiosity of every element of a system's mesh.
///
/// # Errors
/// No steady state exists, or none was found to `tolerance`.
pub fn solve(
    scene: &Scene,
    mesh: Mesh,
    system: &System,
    emitters: &Emitters,
    light: EmitterLight,
    tolerance: f64,
) -> crate::Result<Solution> {
    let (n, rows) = (mesh.len(), system.exchange.rows);
    let batches = rows.batches();
    let System { open, transport, exchange, .. } = system;
    // Means over the open part of each element: covered parts receive nothing and are not seen.
    let per_open = |row: usize| match open[row] {
        o if o > 0.0 => 1.0 / o,
        _ => 0.0,
    };
    let found = light.particles.as_ref();
    let particles = |row: usize, batch: usize| -> Rgb {
        found.map_or(Rgb::ZERO, |p| p.by_element[row * batches + batch] * per_open(row))
    };
    let sources: Vec<Sources> = (0..n)
        .map(|row| {
            let mut sum = Sources {
                environment: rows.summary()[row].escaped * scene.environment * PI,
                ..Default::default()
            };
            if let Some(light) = &light.rows {
                sum.emitters = light.mean[row] * Rgb::splat(per_open(row));
            }
            if found.is_some() {
                sum.particles = (0..batches).map(|b| particles(row, b)).sum::<Rgb>() / batches as f64;
            }
            sum
        })
        .collect();
    let incident: Vec<Rgb> = sources.iter().map(Sources::total).collect();
    let acceleration = system.acceleration(scene, &mesh);
    let (irradiance, convergence) = system.solve(&acceleration, &incident, tolerance)?;
    // The system's inverse has no negative entry: what is below zero is what is left of the residual.
    let irradiance: Vec<Rgb> = irradiance.into_iter().map(|h| h.max(Rgb::ZERO)).collect();
    let reflected = transport.reflect(&irradiance);
    let by_source = uncertainty::BySource {
        own: &|row, batch| light.rows.as_ref().map_or(Rgb::ZERO, |l| l.total(row, batch) * per_open(row)),
        particles: if found.is_some() { Some(&particles) } else { None },
    };
    let replicas = uncertainty::Replicas::new(
        exchange,
        transport,
        &acceleration,
        &irradiance,
        &by_source,
        scene.environment,
    );
    let emitted: Vec<Rgb> = (0..n as u32)
        .map(|e| {
            let (face, front, _) = mesh.place(e);
            emitters.at(face, front).map_or(Rgb::ZERO, |(radiance, _)| PI * radiance)
        })
        .collect();
    let part = |f: &dyn Fn(&Sources) -> Rgb| -> Vec<Rgb> {
        let h: Vec<Rgb> = sources.iter().map(f).collect();
        transport.reflect(&h)
    };
    let direct = part(&|s| s.emitters.straight);
    let image = part(&|s| s.emitters.image);
    let chain = part(&|s| s.emitters.chain);
    let mapped = part(&|s| s.particles);
    let indirect: Vec<Rgb> = (0..n).map(|e| reflected[e] - direct[e] - image[e] - mapped[e]).collect();
    let nodes = Nodes::new(scene, &mesh);
    let standard_error = replicas.by_element(scene, &mesh, transport, open);
    let noisy = |values: &[Rgb], share: &dyn Fn(usize) -> f64| {
        Field::noisy(&mesh, &nodes, open, values, &|e| color::mean(standard_error[e]) * share(e))
    };
    let field = |values: &[Rgb]| noisy(values, &|e| share_of_error(values[e], reflected[e]));
    let has_caustic = chain.iter().any(|c| c.max_element() > 0.0);
    let radiosity: Vec<Rgb> = emitted.iter().zip(&reflected).map(|(e, r)| *e + *r).collect();
    Ok(Solution {
        ledger: Ledger::new(
            scene,
            &mesh,
            rows,
            emitters,
            transport,
            &emitted,
            &reflected,
            &irradiance,
            &replicas,
        ),
        objects: replicas.by_object(scene, &mesh, transport, &radiosity, open),
        radiosity,
        reflected: field(&reflected),
        indirect: if emitters.are_few() { noisy(&indirect, &|_| 1.0) } else { field(&indirect) },
        caustic: has_caustic.then(|| field(&chain)),
        standard_error,
        caustic_map: light.particles.and_then(|p| p.map),
        emitted,
        irradiance,
        direct,
        convergence,
        nodes,
        mesh,
    })
}

/// Solves for the irradiance [W m^-2] of every element where no surface is specular: `incident` is its part straight from
/// the sources, `matrix` holds ordinary form factors.
///
/// # Errors
/// No steady state exists, or none was found to `tolerance`.
pub fn solve_irradiance(
    matrix: &ExchangeMatrix,
    transport: &Transport,
    incident: &[Rgb],
    tolerance: f64,
) -> crate::Result<(Vec<Rgb>, Convergence)> {
    let rows = Rows::from(matrix);
    let sums = matrix.multiply(&vec![Rgb::ONE; matrix.len()]);
    let exchange = exchange::Exchange::new(rows, &sums, None);
    let acceleration = Acceleration::Balance(Groups::new(&vec![0; matrix.len()], Vec::new));
    solve::solve(&exchange, transport, &acceleration, incident, None, tolerance)
}

/// Of the standard error of all reflected light of an element, the share of a part of that light (0 to 1). Of few emitters
/// ([`Emitters::are_few`]) straight light has next to none, and what rows bring all of it.
fn share_of_error(part: Rgb, all: Rgb) -> f64 {
    match color::mean(all) {
        whole if whole > 0.0 => (color::mean(part) / whole).clamp(0.0, 1.0),
        _ => 1.0,
    }
}

/// Diffuse reflection and transmission at the elements.
#[derive(Debug, Clone)]
pub struct Transport {
    /// Diffuse albedo of each element.
    pub reflectance: Vec<Rgb>,
    /// Diffuse transmittance of each element.
    pub transmittance: Vec<Rgb>,
    /// The element on the other side, or [`NONE`]; asked for only where something is translucent.
    opposite: Vec<u32>,
}

impl Transport {
    /// The materials of a mesh's elements.
    pub fn of(scene: &Scene, mesh: &Mesh) -> Transport {
        let translucent = scene.materials.iter().any(|m| m.is_translucent());
        let opposite =
            (0..mesh.len() as u32).map(|e| if translucent { mesh.opposite(e) } else { NONE }).collect();
        let material = |e: u32| scene.material(&scene.faces[mesh.place(e).0 as usize]);
        let n = mesh.len() as u32;
        Transport {
            reflectance: (0..n).map(|e| material(e).diffuse).collect(),
            transmittance: (0..n).map(|e| material(e).diffuse_transmission).collect(),
            opposite,
        }
    }

    /// Makes the transmitted power what was received, where elements are open in part: radiosities and irradiances are means over
    /// the `open` shares, and those of an element's two sides may differ. What meets a covered part is lost.
    pub(crate) fn conserve(&mut self, open: &[f64]) {
        for (e, o) in self.opposite.iter().enumerate().filter(|(_, o)| **o != NONE) {
            let (here, there) = (open[e], open[*o as usize]);
            self.transmittance[e] *= if there < here { there / here } else { 1.0 };
        }
    }

    /// Of the power that an element receives, the share that it gives back on either side; `open` are the shares that
    /// [`Transport::conserve`] was given, times the squared index of the medium in front.
    fn given_back(&self, e: usize, open: &[f64]) -> Rgb {
        let through = match self.opposite[e] {
            NONE => Rgb::ZERO,
            o if open[e] > 0.0 => self.transmittance[o as usize] * (open[o as usize] / open[e]),
            _ => Rgb::ZERO,
        };
        self.reflectance[e] + through
    }

    /// `rho_i H_i + tau_i H'_i` of every element.
    pub fn reflect(&self, irradiance: &[Rgb]) -> Vec<Rgb> {
        (0..irradiance.len())
            .into_par_iter()
            .with_min_len(exchange::MANY)
            .map(|e| {
                let behind = match self.opposite[e] {
                    NONE => Rgb::ZERO,
                    o => irradiance[o as usize],
                };
                self.reflectance[e] * irradiance[e] + self.transmittance[e] * behind
            })
            .collect()
    }

    /// Largest sum of reflectance and transmittance in any channel.
    pub fn largest(&self) -> f64 {
        self.reflectance
            .iter()
            .zip(&self.transmittance)
            .map(|(r, t)| (*r + *t).max_element())
            .fold(0.0, f64::max)
    }
}
