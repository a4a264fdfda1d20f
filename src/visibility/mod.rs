//! Every visibility question: the only caller of Embree, and the one place that decides where rays start and which of
//! their hits count (`offset.rs` gives the reasons).

mod contact;
mod offset;
mod reach;
mod sides;
#[cfg(test)]
mod tests;

pub use reach::reachable_sides;
pub use sides::{FaceSides, SideTable};

use crate::Result;
use crate::embree::{CommittedScene, Device, Ray, RayPacket, ShadowPacket};
use crate::mesh::Place;
use crate::scene::{Face, Scene, from_halves};
use glam::{DVec2, DVec3, Vec3};
use offset::Offset;

/// A ray's meeting with a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceHit {
    /// The face.
    pub face: u32,
    /// First coordinate on the face.
    pub u: f32,
    /// Second coordinate on the face.
    pub v: f32,
    /// The ray came to the front of the face.
    pub front: bool,
}

/// A point of a surface, seen from one side.
#[derive(Debug, Clone, Copy)]
pub struct SurfacePoint {
    /// The face.
    pub face: u32,
    /// First coordinate on the face.
    pub u: f32,
    /// Second coordinate on the face.
    pub v: f32,
    /// Seen from the front.
    pub front: bool,
    /// Position [m, relative to the scene's centre], as far from the face's edges as rays must start.
    pub point: DVec3,
    /// Unit geometric normal, towards the side it is seen from.
    pub geometric: DVec3,
    /// Unit shading normal, towards the same side.
    pub shading: DVec3,
}

/// A scene ready for ray tracing.
pub struct Visibility<'s> {
    scene: &'s Scene,
    embree: CommittedScene,
    normals: Vec<Vec3>,
    /// Of every face, where some are no parallelograms; empty otherwise.
    skews: Vec<[f32; 2]>,
    offsets: Vec<Offset>,
    /// Every edge is shared: from within nothing can be missed.
    closed: bool,
}

impl<'s> Visibility<'s> {
    /// Hands the faces to Embree and builds its tree.
    pub fn new(device: &Device, scene: &'s Scene) -> Result<Visibility<'s>> {
        let vertices: Vec<[f32; 3]> = scene.vertices.iter().map(|v| v.as_vec3().to_array()).collect();
        let (triangles, quads) = scene.faces.split_at(scene.triangle_count);
        let triangles: Vec<[u32; 3]> =
            triangles.iter().map(|f| [f.vertices[0], f.vertices[1], f.vertices[2]]).collect();
        let quads: Vec<[u32; 4]> = quads.iter().map(|f| f.vertices).collect();
        let embree = CommittedScene::new(device, &vertices, &triangles, &quads)?;
        let normals = scene.faces.iter().map(|f| f.normal.as_vec3()).collect();
        let skew = |f: &Face| f.skew.as_vec2().to_array();
        let twisted = scene.faces.iter().any(|f| f.skew != DVec2::ZERO);
        let skews = if twisted { scene.faces.iter().map(skew).collect() } else { Vec::new() };
        let (mut offsets, closed) = offset::offsets(scene);
        contact::widen(scene, &embree, &mut offsets);
        Ok(Visibility { scene, embree, normals, skews, offsets, closed })
    }

    /// What single precision does not resolve in this scene, by name of the object.
    pub fn warnings(&self) -> Vec<String> {
        let unresolved = offset::unresolved(self.scene, &self.offsets);
        if unresolved.is_empty() {
            return Vec::new();
        }
        let total: usize = unresolved.iter().map(|(_, n)| n).sum();
        let mut names: Vec<String> = unresolved
            .iter()
            .take(5)
            .map(|&(object, n)| format!("object \"{}\": {n}", self.scene.objects[object as usize]))
            .collect();
        if unresolved.len() > names.len() {
            names.push("...".into());
        }
        let are = if total == 1 { "face is" } else { "faces are" };
        vec![format!(
            "{total} {are} too small, too thin or at too small an angle to others for single precision in a scene of this \
             size; light near there may be wrong ({})",
            names.join(", ")
        )]
    }

    /// The scene that rays are cast into.
    pub fn scene(&self) -> &'s Scene {
        self.scene
    }

    /// Embree's scene, for measurements of its raw speed.
    pub fn embree(&self) -> &CommittedScene {
        &self.embree
    }

    /// Where a ray starts that leaves `point` of a face to the side that `normal` points to.
    #[inline]
    pub fn leave(&self, face: u32, point: DVec3, normal: DVec3) -> Vec3 {
        (point + self.offsets[face as usize].lift * normal).as_vec3()
    }

    /// (u, v) of the point of a face nearest to the given one at which rays may start.
    #[inline]
    pub fn inside(&self, face: u32, u: f64, v: f64) -> (f64, f64) {
        self.offsets[face as usize].inside(u, v)
    }

    /// The point of an element for (s, t) uniform in the unit square, drawn in from where rays may not start \[m\].
    #[inline]
    pub fn start(&self, place: &Place, s: f64, t: f64) -> DVec3 {
        let uv = place.uv(s, t);
        place.at(self.inside(place.face, uv.x, uv.y).into())
    }

    /// Origin and edges in (u, v) of a cell of a face, drawn in from where rays may not start.
    pub fn inside_cell(&self, face: u32, cell: (DVec2, DVec2, DVec2)) -> (DVec2, DVec2, DVec2) {
        self.offsets[face as usize].inside_cell(cell)
    }

    /// First face along a ray that left face `from`.
    #[inline]
    pub fn closest(&self, origin: Vec3, direction: Vec3, from: u32) -> Option<SurfaceHit> {
        let mut ray = Ray::new(origin, direction);
        loop {
            let Some(hit) = self.embree.intersect(&ray) else { return self.nudged(&ray, from) };
            if hit.face != from {
                return Some(self.side(hit, direction));
            }
            // Moves on to the next f32 above t, which is not negative: no other face is passed over.
            ray.tnear = f32::from_bits(hit.t.to_bits() + 1);
        }
    }

    /// What a ray meets that slipped through an edge: where all edges are shared, a miss is tried again a few
    /// units in the last place aside. (Embree's robust mode misses a ray in ten thousand that is aimed exactly at a vertex.)
    #[cold]
    fn nudged(&self, ray: &Ray, from: u32) -> Option<SurfaceHit> {
        if !self.closed {
            return None;
        }
        let size = 4.0 * f32::EPSILON * ray.direction.abs().max_element();
        [Vec3::new(1.0, 0.7, -0.4), Vec3::new(-0.6, 0.5, 1.0)].iter().find_map(|aside| {
            let direction = ray.direction + size * aside;
            let hit = self.embree.intersect(&Ray { direction, ..*ray })?;
            (hit.face != from).then(|| self.side(hit, direction))
        })
    }

    /// Resolves a lane of a traced packet that holds an endless ray.
    #[inline]
    pub fn lane(
        &self,
        packet: &RayPacket,
        lane: usize,
        origin: Vec3,
        direction: Vec3,
        from: u32,
    ) -> Option<SurfaceHit> {
        let Some(hit) = packet.hit(lane) else { return self.nudged(&Ray::new(origin, direction), from) };
        if hit.face == from {
            return self.closest(origin, direction, from);
        }
        Some(self.side(hit, direction))
    }

    #[inline]
    fn side(&self, hit: crate::embree::Hit, direction: Vec3) -> SurfaceHit {
        let front = self.normals[hit.face as usize].dot(direction) < 0.0;
        let (u, v) = match self.skews.get(hit.face as usize) {
            Some(skew) => from_halves(*skew, hit.u, hit.v),
            None => (hit.u, hit.v),
        };
        SurfaceHit { face: hit.face, u, v, front }
    }

    /// Traces a packet.
    #[inline]
    pub fn closest16(&self, packet: &mut RayPacket, coherent: bool) {
        self.embree.intersect16(packet, coherent);
    }

    /// The ray from `origin` to `target`, a point of a face seen from the side that `normal` points to:
    /// unoccluded if nothing lies between.
    #[inline]
    pub fn segment(&self, origin: Vec3, face: u32, target: DVec3, normal: DVec3) -> Ray {
        let d = self.leave(face, target, normal) - origin;
        let length = d.length();
        // Points that coincide see each other: the segment has no inside.
        let direction = if length > 0.0 { d / length } else { normal.as_vec3() };
        Ray::segment(origin, direction, length * offset::SHORTER)
    }

    /// Whether nothing lies on a segment.
    #[inline]
    pub fn unoccluded(&self, segment: &Ray) -> bool {
        !self.embree.occluded(segment)
    }

    /// Bit k set: segment k of the packet is blocked.
    #[inline]
    pub fn occluded16(&self, packet: &mut ShadowPacket, coherent: bool) -> u16 {
        self.embree.occluded16(packet, coherent)
    }

    /// The surface point of a hit.
    #[inline]
    pub fn point(&self, hit: &SurfaceHit) -> SurfacePoint {
        let face = &self.scene.faces[hit.face as usize];
        let (u, v) = (f64::from(hit.u), f64::from(hit.v));
        let sign = if hit.front { 1.0 } else { -1.0 };
        let geometric = sign * face.normal;
        let shading =
            if face.normals.is_none() { geometric } else { sign * shading_normal(self.scene, face, u, v) };
        SurfacePoint {
            face: hit.face,
            u: hit.u,
            v: hit.v,
            front: hit.front,
            point: self.scene.face_frame(face).at(self.inside(hit.face, u, v).into()),
            geometric,
            shading,
        }
    }
}

impl SurfacePoint {
    /// The shading normal where it faces `wo`, the geometric one where interpolation turned it away.
    pub fn facing(&self, wo: DVec3) -> DVec3 {
        if self.shading.dot(wo) > 1e-3 { self.shading } else { self.geometric }
    }
}

/// Interpolated unit shading normal, towards the front; the geometric one where there is none.
pub fn shading_normal(scene: &Scene, face: &Face, u: f64, v: f64) -> DVec3 {
    let Some(ids) = face.normals else { return face.normal };
    let n = ids.map(|k| scene.normals[k as usize]);
    let blended = if face.is_triangle() {
        (1.0 - u - v) * n[0] + u * n[1] + v * n[2]
    } else {
        (1.0 - u) * (1.0 - v) * n[0] + u * (1.0 - v) * n[1] + u * v * n[2] + (1.0 - u) * v * n[3]
    };
    blended.try_normalize().unwrap_or(face.normal)
}
