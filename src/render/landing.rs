//! What pass 2 needs to know of every face that a ray may meet, side by side in memory.

use super::Context;
use crate::color::Rgb;
use crate::embree::{Hits, LANES, RayLanes};
use crate::emitters::Emitters;
use crate::mesh::{Grid, Lattice, NONE};
use crate::radiosity::{Field, Solution};
use crate::scene::Scene;
use crate::visibility::SurfaceHit;
use glam::Vec3;
use std::f64::consts::FRAC_1_PI;

/// A side that emits.
pub(super) const EMITTER: u8 = 1;
/// A side with a specular part.
pub(super) const SPECULAR: u8 = 2;

/// All faces.
pub(super) struct Landings {
    faces: Vec<Landing>,
    /// Some faces have cells that differ in size.
    adaptive: bool,
}

struct Landing {
    normal: Vec3,
    /// Of its elements, where it has any.
    grid: Grid,
    /// First node of each side, or [`NONE`].
    nodes: [u32; 2],
    kind: [u8; 2],
}

/// Where 16 rays landed, and how to interpolate there.
pub(super) struct Places {
    /// First node of the side, or [`NONE`].
    first: [u32; LANES],
    /// Local nodes.
    nodes: [[u32; LANES]; 4],
    weights: [[f32; LANES]; 4],
    /// [`EMITTER`] and [`SPECULAR`].
    pub(super) kind: [u8; LANES],
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
                normal: scene.faces[k].normal.as_vec3(),
                grid: solution.map_or_else(|| none.into(), |s| s.mesh.grid(k as u32).clone()),
                nodes: [nodes(true), nodes(false)],
                kind: [kind(true), kind(false)],
            }
        };
        let faces: Vec<Landing> = (0..scene.faces.len()).map(landing).collect();
        Landings { adaptive: faces.iter().any(|f| f.grid.is_adaptive()), faces }
    }

    /// [`EMITTER`] and [`SPECULAR`] of the side that was met.
    #[inline]
    pub fn kind(&self, hit: &SurfaceHit) -> u8 {
        self.faces[hit.face as usize].kind[usize::from(!hit.front)]
    }

    /// Where the rays of a packet landed; of lanes without a hit, anything. There must be a face.
    #[inline(always)]
    pub fn places(&self, hits: &Hits, rays: &RayLanes) -> Places {
        let mut face = [&self.faces[0]; LANES];
        let (mut normal, mut first, mut kind) = ([[0.0; LANES]; 3], [[NONE; LANES]; 2], [[0; LANES]; 2]);
        let mut lattice = ([0; LANES], [0; LANES], [false; LANES]);
        for l in 0..LANES {
            let f = &self.faces[(hits.face[l] as usize).min(self.faces.len() - 1)];
            face[l] = f;
            (normal[0][l], normal[1][l], normal[2][l]) = f.normal.into();
            (first[0][l], first[1][l]) = f.nodes.into();
            (kind[0][l], kind[1][l]) = f.kind.into();
            (lattice.0[l], lattice.1[l], lattice.2[l]) =
                (f.grid.lattice.nu, f.grid.lattice.nv, f.grid.lattice.triangle);
        }
        let mut places = Places {
            first: [NONE; LANES],
            nodes: [[0; LANES]; 4],
            weights: [[0.0; LANES]; 4],
            kind: [0; LANES],
        };
        for l in 0..LANES {
            let [x, y, z] = [0, 1, 2].map(|c| normal[c][l] * rays.direction[c][l]);
            let front = x + y + z < 0.0;
            places.first[l] = if front { first[0][l] } else { first[1][l] };
            places.kind[l] = if front { kind[0][l] } else { kind[1][l] };
        }
        for l in 0..LANES {
            let lattice = Lattice { nu: lattice.0[l], nv: lattice.1[l], triangle: lattice.2[l] };
            let (nodes, weights) = lattice.interpolation(hits.u[l], hits.v[l]);
            for k in 0..4 {
                (places.nodes[k][l], places.weights[k][l]) = (nodes[k], weights[k]);
            }
        }
        if self.adaptive {
            for (l, face) in face.iter().enumerate().filter(|(_, f)| f.grid.is_adaptive()) {
                let (nodes, weights) = face.grid.interpolation(hits.u[l], hits.v[l]);
                for k in 0..4 {
                    (places.nodes[k][l], places.weights[k][l]) = (nodes[k], weights[k]);
                }
            }
        }
        places
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
        let landing = &self.landings.faces[hit.face as usize];
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
