//! What pass 2 needs to know of every face that a ray may meet, side by side in memory.

use super::Context;
use crate::color::Rgb;
use crate::emitters::Emitters;
use crate::mesh::{Grid, Lattice, NONE};
use crate::radiosity::{Field, Solution};
use crate::scene::Scene;
use crate::visibility::SurfaceHit;
use std::f64::consts::FRAC_1_PI;

/// A side that emits.
pub(super) const EMITTER: u8 = 1;
/// A side with a specular part.
pub(super) const SPECULAR: u8 = 2;

/// All faces.
pub(super) struct Landings(Vec<Landing>);

struct Landing {
    /// Of its elements, where it has any.
    grid: Grid,
    /// First node of each side, or [`NONE`].
    nodes: [u32; 2],
    kind: [u8; 2],
}

impl Landings {
    pub fn new(scene: &Scene, emitters: &Emitters, solution: Option<&Solution>) -> Landings {
        let none = Lattice { nu: 1, nv: 1, triangle: false };
        let landing = |k: usize| {
            let material = scene.material(&scene.faces[k]);
            let kind = |front: bool| {
                let specular = material.is_specular() && (front || material.two_sided);
                let emits = emitters.at(k as u32, front).is_some();
                (EMITTER * u8::from(emits)) | (SPECULAR * u8::from(specular))
            };
            let nodes = |front: bool| solution.map_or(NONE, |s| s.nodes.first(k as u32, front));
            Landing {
                grid: solution.map_or_else(|| none.into(), |s| s.mesh.grid(k as u32).clone()),
                nodes: [nodes(true), nodes(false)],
                kind: [kind(true), kind(false)],
            }
        };
        Landings((0..scene.faces.len()).map(landing).collect())
    }

    /// [`EMITTER`] and [`SPECULAR`] of the side that was met.
    #[inline]
    pub fn kind(&self, hit: &SurfaceHit) -> u8 {
        self.0[hit.face as usize].kind[usize::from(!hit.front)]
    }
}

impl Context<'_, '_> {
    /// Radiance that leaves a point by diffuse reflection and transmission, interpolated from pass 1 [W m^-2 sr^-1].
    #[inline]
    pub(super) fn interpolated(&self, hit: &SurfaceHit) -> Rgb {
        self.read(|s| Some(&s.reflected), hit) * FRAC_1_PI
    }

    /// A field of the solution at a point, zero where there is none.
    #[inline]
    pub(super) fn read<'f>(
        &'f self,
        field: impl Fn(&'f Solution) -> Option<&'f Field>,
        hit: &SurfaceHit,
    ) -> Rgb {
        let Some((solution, field)) = self.solution.and_then(|s| Some((s, field(s)?))) else {
            return Rgb::ZERO;
        };
        let landing = &self.landings.0[hit.face as usize];
        match landing.nodes[usize::from(!hit.front)] {
            NONE => Rgb::ZERO,
            first => {
                let place = landing.grid.interpolation(hit.u, hit.v);
                let [r, g, b] = field.read(&solution.nodes, first, &place);
                Rgb::new(r.into(), g.into(), b.into())
            }
        }
    }
}
