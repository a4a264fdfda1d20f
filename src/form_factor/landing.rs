//! Where rays land: the element and the kind of surface of each hit.

use super::raycast::{AtSpecular, Casting};
use crate::embree::{Hits, LANES};
use crate::medium::Media;
use crate::mesh::{Mesh, NONE, side_index};
use crate::visibility::{FaceSides, SideTable, SurfaceHit, Visibility};
use glam::Vec3;
use pulp::Simd;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

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

/// What ends here without an element does so inside of glass.
pub(super) const IMMERSED: u8 = 32;

/// The faces of a scene, their cells numbered as elements.
pub(super) struct Targets {
    table: SideTable,
    /// Squared index of the medium of the sides that are [`IMMERSED`], by [`side_index`].
    immersed: FxHashMap<usize, f64>,
    /// None where no glass is followed.
    media: Option<Media>,
    /// Objects of glass that may lie in other glass.
    nested: Vec<bool>,
}

/// Where the rays of a packet landed.
pub(super) struct Landings {
    /// Elements, or [`NONE`].
    pub(super) column: [u32; LANES],
    /// Kinds of the surfaces.
    pub(super) kind: [u32; LANES],
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
    pub(super) fn new(visibility: &Visibility, mesh: &Mesh, casting: &Casting) -> Targets {
        let scene = visibility.scene();
        let follow = casting.specular != AtSpecular::End;
        let kind = |k: u32, front: bool| {
            let material = scene.material(&scene.faces[k as usize]);
            let emitter = casting.emitters.is_some_and(|(e, _)| !e.are_few() && e.at(k, front).is_some());
            let specular = follow && material.is_specular() && (front || material.two_sided);
            // A specular side leads on wherever it is; only a side that would end the ray can prove it covered.
            let unreached = !specular && casting.reached.is_some_and(|r| !r.contains(k, front));
            let absorbed = !specular && mesh.first(k, front) == NONE;
            (EMITTER * u8::from(emitter))
                | (SPECULAR * u8::from(specular))
                | (UNREACHED * u8::from(unreached))
                | (ABSORBED * u8::from(absorbed))
        };
        // Elements tell by their own rays where they lie; nothing else does so of sides without any.
        let faces = 0..scene.faces.len() as u32;
        let media = Media::new(scene).filter(|_| follow);
        let nested = media.as_ref().map_or(Vec::new(), |m| m.nested(visibility));
        let asked = faces.clone().into_par_iter().filter(|_| media.is_some());
        let asked = asked.flat_map_iter(|k| [true, false].map(|front| (k, front)));
        let asked = asked.filter(|&(k, front)| kind(k, front) & (ABSORBED | UNREACHED) == ABSORBED);
        let immersed: FxHashMap<usize, f64> = asked
            .map(|(k, front)| {
                let normal = scene.faces[k as usize].normal;
                let normal = if front { normal } else { -normal };
                let index2 = |m: &Media| m.side_index2(visibility, k, normal);
                (side_index(k, front), media.as_ref().map_or(1.0, index2))
            })
            .filter(|(_, index2)| *index2 != 1.0)
            .collect();
        let sides = |k: u32| {
            let first = [true, false].map(|front| mesh.first(k, front));
            let kind = [true, false].map(|front| {
                let immersed = immersed.contains_key(&side_index(k, front));
                kind(k, front) | (IMMERSED * u8::from(immersed))
            });
            FaceSides::new(&scene.faces[k as usize], mesh.grid(k).clone(), first, kind)
        };
        Targets { table: SideTable::new(faces.map(sides), ESCAPED), immersed, media, nested }
    }

    /// Squared index of the medium in front of a side that is [`IMMERSED`].
    pub(super) fn index2(&self, face: u32, front: bool) -> f64 {
        self.immersed.get(&side_index(face, front)).copied().unwrap_or(1.0)
    }

    /// Squared index of the medium that a ray came through to the surface of glass that it met.
    pub(super) fn index2_before(&self, visibility: &Visibility, hit: &SurfaceHit, direction: Vec3) -> f64 {
        let scene = visibility.scene();
        let face = &scene.faces[hit.face as usize];
        // About a body that lies in no other the index is 1.
        match &self.media {
            Some(media) if self.nested[face.object as usize] => {
                media.index2_before(visibility, hit, direction)
            }
            _ if hit.front => 1.0,
            _ => scene.material(face).ior.powi(2),
        }
    }

    /// From now on emitters are met like any other surface.
    pub(super) fn forget_emitters(&mut self) {
        self.table.without(EMITTER);
    }

    /// Where a ray landed that came to (u, v) of a face; a face that there is not stands for none.
    #[inline(always)]
    pub(super) fn landing(&self, face: u32, (u, v): (f32, f32), direction: Vec3) -> Landing {
        let face = self.table.face(face);
        let side = face.met(direction);
        let column = match face.first[side] {
            NONE => NONE,
            first => first + face.grid.cell(u, v),
        };
        Landing { column, kind: face.kind[side], front: side == 0 }
    }

    /// The face that stands for none in the hits of packets.
    #[inline(always)]
    pub(super) fn none(&self) -> u32 {
        self.table.none()
    }

    /// Where the rays of a packet landed.
    #[inline(always)]
    pub(super) fn landings<S: Simd>(&self, simd: S, hits: &Hits) -> Landings {
        let sides = self.table.lanes(simd, hits);
        Landings { column: sides.cells(simd), kind: sides.kind }
    }
}
