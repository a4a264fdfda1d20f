//! What pass 2 needs to know of every face that a ray may meet.

use super::Context;
use crate::color::Rgb;
use crate::embree::{Hits, LANES};
use crate::emitters::Emitters;
use crate::mesh::NONE;
use crate::radiosity::{Field, Solution};
use crate::scene::Scene;
use crate::visibility::{FaceSides, SideTable, SurfaceHit};
use pulp::Simd;
use std::f64::consts::FRAC_1_PI;

/// A side that emits.
pub(super) const EMITTER: u8 = 1;
/// A side with a specular part.
pub(super) const SPECULAR: u8 = 2;

/// All faces, their cells' nodes numbered as in the solution.
pub(super) struct Landings(SideTable);

/// Where 16 rays landed, and how to interpolate there.
pub(super) struct Places {
    /// First node of the side, or [`NONE`].
    first: [u32; LANES],
    /// Local nodes.
    nodes: [[u32; LANES]; 4],
    weights: [[f32; LANES]; 4],
    /// [`EMITTER`] and [`SPECULAR`].
    pub(super) kind: [u32; LANES],
}

impl Landings {
    pub fn new(scene: &Scene, emitters: &Emitters, solution: Option<&Solution>) -> Landings {
        let sides = |k: u32| {
            let face = &scene.faces[k as usize];
            let material = scene.material(face);
            let kind = [true, false].map(|front| {
                let specular = material.is_specular() && (front || material.two_sided);
                let emits = emitters.at(k, front).is_some();
                (EMITTER * u8::from(emits)) | (SPECULAR * u8::from(specular))
            });
            let Some(solution) = solution else { return FaceSides::bare(face.normal.as_vec3(), kind) };
            let first = [true, false].map(|front| solution.nodes.first(k, front));
            FaceSides::new(face, solution.mesh.grid(k).clone(), first, kind)
        };
        Landings(SideTable::new((0..scene.faces.len() as u32).map(sides), 0))
    }

    /// [`EMITTER`] and [`SPECULAR`] of the side that was met.
    #[inline]
    pub fn kind(&self, hit: &SurfaceHit) -> u8 {
        self.0.face(hit.face).kind[usize::from(!hit.front)]
    }

    /// The face that stands for none in the hits of packets.
    pub fn none(&self) -> u32 {
        self.0.none()
    }

    /// Where the rays of a packet landed.
    #[inline(always)]
    pub fn places<S: Simd>(&self, simd: S, hits: &Hits) -> Places {
        let sides = self.0.lanes(simd, hits);
        let (nodes, weights) = sides.interpolation();
        Places { first: sides.first, nodes, weights, kind: sides.kind }
    }
}

impl Context<'_, '_> {
    /// Radiance that leaves a point by diffuse reflection and transmission, interpolated from pass 1 [W m^-2 sr^-1].
    #[inline]
    pub(super) fn interpolated(&self, hit: &SurfaceHit) -> Rgb {
        self.read(|s| Some(&s.reflected), hit) * FRAC_1_PI
    }

    /// [`Context::interpolated`] where a ray of a packet landed.
    #[inline(always)]
    pub(super) fn interpolated_at(&self, places: &Places, lane: usize) -> Rgb {
        match (self.solution, places.first[lane]) {
            (None, _) | (_, NONE) => Rgb::ZERO,
            (Some(solution), first) => {
                let place = (places.nodes.map(|n| n[lane]), places.weights.map(|w| w[lane]));
                let [r, g, b] = solution.reflected.read(&solution.nodes, first, &place);
                Rgb::new(r.into(), g.into(), b.into()) * FRAC_1_PI
            }
        }
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
        let sides = self.landings.0.face(hit.face);
        match sides.first[usize::from(!hit.front)] {
            NONE => Rgb::ZERO,
            first => {
                let place = sides.grid.interpolation(hit.u, hit.v);
                let [r, g, b] = field.read(&solution.nodes, first, &place);
                Rgb::new(r.into(), g.into(), b.into())
            }
        }
    }
}
