//! Where rays land: the element and the kind of surface of each hit, for 16 at a time and without branches.

use super::raycast::Casting;
use crate::embree::{Hits, LANES, RayLanes};
use crate::mesh::{Grid, Lattice, Mesh, NONE};
use crate::scene::Scene;
use glam::Vec3;

/// An emitter whose light is gathered on the way.
pub(super) const EMITTER: u8 = 1;
/// Chains go on from here.
pub(super) const SPECULAR: u8 = 2;
/// A side that no light can reach.
pub(super) const UNREACHED: u8 = 4;
/// What ends here without an element is absorbed.
pub(super) const ABSORBED: u8 = 8;
/// No face at all.
pub(super) const ESCAPED: u8 = 16;

/// All that a hit needs to know of its face, side by side in memory.
#[derive(Clone)]
struct Target {
    normal: Vec3,
    grid: Grid,
    /// First element by side, or [`NONE`].
    first: [u32; 2],
    kind: [u8; 2],
}

/// The faces of a scene, and one more that stands for none.
pub(super) struct Targets {
    faces: Vec<Target>,
    /// Some faces have cells that differ in size.
    adaptive: bool,
}

/// Where the rays of a packet landed.
pub(super) struct Landings {
    /// Elements, or [`NONE`].
    pub(super) column: [u32; LANES],
    /// Kinds of the surfaces.
    pub(super) kind: [u8; LANES],
}

/// Where a ray landed.
#[derive(Clone, Copy, Default)]
pub(super) struct Landing {
    /// Element, or [`NONE`].
    pub(super) column: u32,
    /// Kinds of the surface.
    pub(super) kind: u8,
    /// The ray came to the front.
    pub(super) front: bool,
}

impl Targets {
    pub(super) fn new(scene: &Scene, mesh: &Mesh, casting: &Casting) -> Targets {
        let kind = |k: u32, front: bool| {
            let material = scene.material(&scene.faces[k as usize]);
            let emitter = casting.emitters.is_some_and(|(e, _)| !e.are_few() && e.at(k, front).is_some());
            let specular = casting.specular && material.is_specular() && (front || material.two_sided);
            // A specular side leads on wherever it is; only a side that would end the ray can prove it covered.
            let unreached = !specular && casting.reached.is_some_and(|r| !r.contains(k, front));
            let absorbed = !specular && mesh.first(k, front) == NONE;
            (EMITTER * u8::from(emitter))
                | (SPECULAR * u8::from(specular))
                | (UNREACHED * u8::from(unreached))
                | (ABSORBED * u8::from(absorbed))
        };
        let target = |k: u32| Target {
            normal: scene.faces[k as usize].normal.as_vec3(),
            grid: mesh.grid(k).clone(),
            first: [mesh.first(k, true), mesh.first(k, false)],
            kind: [kind(k, true), kind(k, false)],
        };
        let none = Target {
            normal: Vec3::ZERO,
            grid: Lattice { nu: 1, nv: 1, triangle: false }.into(),
            first: [NONE; 2],
            kind: [ESCAPED; 2],
        };
        let faces: Vec<Target> = (0..scene.faces.len() as u32).map(target).chain([none]).collect();
        Targets { adaptive: faces.iter().any(|t| t.grid.is_adaptive()), faces }
    }

    /// From now on emitters are met like any other surface.
    pub(super) fn forget_emitters(&mut self) {
        for target in &mut self.faces {
            target.kind.iter_mut().for_each(|k| *k &= !EMITTER);
        }
    }

    /// Where a ray landed that came to (u, v) of a face; a face that there is not stands for none.
    #[inline(always)]
    pub(super) fn landing(&self, face: u32, (u, v): (f32, f32), direction: Vec3) -> Landing {
        let target = &self.faces[(face as usize).min(self.faces.len() - 1)];
        let front = target.normal.dot(direction) < 0.0;
        let side = usize::from(!front);
        let (first, kind) = (target.first[side], target.kind[side]);
        let column = first.wrapping_add(target.grid.cell(u, v));
        Landing { column: if first == NONE { NONE } else { column }, kind, front }
    }

    /// Where the rays of a packet landed.
    #[inline(always)]
    pub(super) fn landings(&self, hits: &Hits, rays: &RayLanes) -> Landings {
        let mut face = [&self.faces[0]; LANES];
        let (mut normal, mut first, mut kind) = ([[0.0; LANES]; 3], [[NONE; LANES]; 2], [[0; LANES]; 2]);
        let (mut nu, mut nv, mut triangle) = ([0; LANES], [0; LANES], [false; LANES]);
        for l in 0..LANES {
            let t = &self.faces[(hits.face[l] as usize).min(self.faces.len() - 1)];
            face[l] = t;
            (normal[0][l], normal[1][l], normal[2][l]) = t.normal.into();
            (first[0][l], first[1][l]) = t.first.into();
            (kind[0][l], kind[1][l]) = t.kind.into();
            (nu[l], nv[l], triangle[l]) = (t.grid.lattice.nu, t.grid.lattice.nv, t.grid.lattice.triangle);
        }
        let mut found = Landings { column: [0; LANES], kind: [0; LANES] };
        let mut side = [false; LANES];
        for l in 0..LANES {
            let [x, y, z] = [0, 1, 2].map(|c| normal[c][l] * rays.direction[c][l]);
            side[l] = x + y + z < 0.0;
        }
        for l in 0..LANES {
            let lattice = Lattice { nu: nu[l], nv: nv[l], triangle: triangle[l] };
            found.column[l] = lattice.cell(hits.u[l], hits.v[l]);
        }
        if self.adaptive {
            found.column.iter_mut().zip(face).for_each(|(c, face)| *c = face.grid.holding(*c));
        }
        for l in 0..LANES {
            let first = if side[l] { first[0][l] } else { first[1][l] };
            let column = first.wrapping_add(found.column[l]);
            found.column[l] = if first == NONE { NONE } else { column };
            found.kind[l] = if side[l] { kind[0][l] } else { kind[1][l] };
        }
        found
    }
}
