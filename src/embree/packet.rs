//! Packets of 16 rays, in Embree's own structures so that nothing is copied around a query.

use super::halves::{face_of, turned};
use super::ray::{Hit, LIMIT, Ray};
use super::scene::MISS;
use super::sys;
use glam::Vec3;

/// Rays in a packet.
pub const LANES: usize = 16;

/// The bit of each lane.
const BITS: [i32; LANES] = {
    let mut bits = [0; LANES];
    let mut lane = 0;
    while lane < LANES {
        bits[lane] = 1 << lane;
        lane += 1;
    }
    bits
};

/// Embree's mask of active lanes: -1 active, 0 not.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub(super) struct Valid(pub(super) [i32; LANES]);

impl Valid {
    /// Makes lanes inactive whose origins Embree would not take.
    fn keep_within(&mut self, origin: [&[f32; LANES]; 3]) {
        for (l, valid) in self.0.iter_mut().enumerate() {
            if origin.iter().map(|x| x[l].abs()).sum::<f32>() >= LIMIT {
                *valid = 0;
            }
        }
    }
}

/// Writes one ray into the lane of a ray structure.
macro_rules! set_lane {
    ($rays:expr, $lane:expr, $ray:expr) => {{
        let (rays, lane, ray) = ($rays, $lane, $ray);
        rays.org_x[lane] = ray.origin.x;
        rays.org_y[lane] = ray.origin.y;
        rays.org_z[lane] = ray.origin.z;
        rays.dir_x[lane] = ray.direction.x;
        rays.dir_y[lane] = ray.direction.y;
        rays.dir_z[lane] = ray.direction.z;
        rays.tnear[lane] = ray.tnear;
        rays.tfar[lane] = ray.tfar;
    }};
}

pub(super) use set_lane;

/// Origins and directions of 16 rays, by coordinate and lane.
#[derive(Debug, Clone, Copy)]
pub struct RayLanes {
    /// Where the rays start.
    pub origin: [[f32; LANES]; 3],
    /// Where they go.
    pub direction: [[f32; LANES]; 3],
}

/// Cosine between the first direction of a packet and any other, at least, where Embree's coherent traversal is worth its
/// cost.
const NARROW: f32 = 0.8;

impl RayLanes {
    /// Origin of a lane (0 to 15).
    #[inline]
    pub fn origin(&self, lane: usize) -> Vec3 {
        Vec3::new(self.origin[0][lane], self.origin[1][lane], self.origin[2][lane])
    }

    /// Writes a lane (0 to 15).
    #[inline]
    pub fn set(&mut self, lane: usize, origin: Vec3, direction: Vec3) {
        for c in 0..3 {
            (self.origin[c][lane], self.direction[c][lane]) = (origin[c], direction[c]);
        }
    }

    /// Direction of a lane (0 to 15).
    #[inline]
    pub fn direction(&self, lane: usize) -> Vec3 {
        Vec3::new(self.direction[0][lane], self.direction[1][lane], self.direction[2][lane])
    }

    /// Whether the active lanes, whose directions must have length 1, go nearly the same way: worth Embree's coherent flag.
    #[inline(always)]
    pub fn is_narrow(&self, active: u16) -> bool {
        let is_active = |l: usize| active >> l & 1 == 1;
        let Some(first) = (0..LANES).find(|l| is_active(*l)) else { return true };
        let [x, y, z] = &self.direction;
        let mut least = 1f32;
        for l in 0..LANES {
            let cos = x[l] * x[first] + y[l] * y[first] + z[l] * z[first];
            least = least.min(if is_active(l) { cos } else { 1.0 });
        }
        least > NARROW
    }
}

/// What the rays of a packet met.
#[derive(Debug, Clone, Copy)]
pub struct Hits {
    /// Face, or what stands for none, of a miss and of an inactive lane.
    pub face: [u32; LANES],
    /// First coordinate on the face; without meaning where there is none.
    pub u: [f32; LANES],
    /// Second coordinate on the face.
    pub v: [f32; LANES],
    /// Cosine between the ray and the face's front, times a positive number; negative where the ray comes to the front.
    pub cosine: [f32; LANES],
}

/// 16 rays and their nearest hits.
///
/// A query shortens the rays that hit: set a lane again before it is traced again.
#[derive(Debug, Clone)]
pub struct RayPacket {
    pub(super) query: sys::RTCRayHit16,
    pub(super) valid: Valid,
    /// Of the scene that was traced last; turns a primitive into a face.
    pub(super) triangle_count: u32,
}

impl Default for RayPacket {
    fn default() -> RayPacket {
        RayPacket::new()
    }
}

impl RayPacket {
    /// A packet without rays.
    pub fn new() -> RayPacket {
        let mut query = sys::RTCRayHit16::default();
        query.ray.mask = [u32::MAX; LANES];
        query.hit.geomID = [MISS; LANES];
        RayPacket { query, valid: Valid([0; LANES]), triangle_count: 0 }
    }

    /// Puts a ray into a lane (0 to 15), which becomes active if the ray is finite and loses its old hit.
    #[inline]
    pub fn set(&mut self, lane: usize, ray: &Ray) {
        assert!(lane < LANES);
        set_lane!(&mut self.query.ray, lane, ray);
        self.query.hit.geomID[lane] = MISS;
        self.valid.0[lane] = -i32::from(ray.is_valid());
    }

    /// Puts endless rays into the lanes whose bit of `active` is set and empties the others: like [`RayPacket::set`] lane
    /// by lane, but at the speed of copying.
    #[inline(always)]
    pub fn fill(&mut self, rays: &RayLanes, active: u16) {
        let query = &mut self.query.ray;
        [query.org_x, query.org_y, query.org_z] = rays.origin;
        [query.dir_x, query.dir_y, query.dir_z] = rays.direction;
        query.tnear = [0.0; LANES];
        query.tfar = [f32::INFINITY; LANES];
        self.query.hit.geomID = [MISS; LANES];
        let ([x, y, z], [dx, dy, dz]) = (&rays.origin, &rays.direction);
        let active = i32::from(active);
        for l in 0..LANES {
            let size = (x[l].abs() + y[l].abs() + z[l].abs()) + (dx[l].abs() + dy[l].abs() + dz[l].abs());
            // No shifts by the lane and no branches: all lanes at once.
            let chosen = if active & BITS[l] != 0 { -1 } else { 0 };
            self.valid.0[l] = if size < LIMIT { chosen } else { 0 };
        }
    }

    /// Multiplies lengths by a power of two. Lanes of which an origin leaves Embree's range become inactive.
    pub(super) fn rescale(&mut self, scale: f32) {
        let r = &mut self.query.ray;
        for lanes in [&mut r.org_x, &mut r.org_y, &mut r.org_z, &mut r.tnear, &mut r.tfar] {
            lanes.iter_mut().for_each(|x| *x *= scale);
        }
        self.valid.keep_within([&r.org_x, &r.org_y, &r.org_z]);
    }

    /// Makes every lane inactive.
    #[inline]
    pub fn clear(&mut self) {
        self.valid.0 = [0; LANES];
        self.query.hit.geomID = [MISS; LANES];
    }

    /// Origin and direction of a lane (0 to 15).
    #[inline]
    pub fn ray(&self, lane: usize) -> (Vec3, Vec3) {
        let r = &self.query.ray;
        let origin = Vec3::new(r.org_x[lane], r.org_y[lane], r.org_z[lane]);
        (origin, Vec3::new(r.dir_x[lane], r.dir_y[lane], r.dir_z[lane]))
    }

    /// The hits of all lanes; `none` stands for the face of those that met nothing.
    #[inline(always)]
    pub fn hits(&self, none: u32) -> Hits {
        let (ray, hit) = (&self.query.ray, &self.query.hit);
        let mut hits = Hits { face: [none; LANES], u: hit.u, v: hit.v, cosine: [0.0; LANES] };
        for l in 0..LANES {
            // No branches: all lanes at once.
            let found = (self.valid.0[l] != 0) & (hit.geomID[l] != MISS);
            let (met, second) = face_of(hit.primID[l], self.triangle_count);
            hits.face[l] = if found { met } else { none };
            (hits.u[l], hits.v[l]) = (turned(hit.u[l], second), turned(hit.v[l], second));
            hits.cosine[l] =
                hit.Ng_x[l] * ray.dir_x[l] + hit.Ng_y[l] * ray.dir_y[l] + hit.Ng_z[l] * ray.dir_z[l];
        }
        hits
    }

    /// The hit of a lane (0 to 15); `None` for a miss and for an inactive lane.
    #[inline]
    pub fn hit(&self, lane: usize) -> Option<Hit> {
        assert!(lane < LANES);
        let hit = &self.query.hit;
        // Without AVX-512, Embree writes hits into inactive lanes too.
        (self.valid.0[lane] != 0 && hit.geomID[lane] != MISS).then(|| {
            let (face, second) = face_of(hit.primID[lane], self.triangle_count);
            let [u, v] = [hit.u[lane], hit.v[lane]].map(|x| turned(x, second));
            Hit { face, u, v, t: self.query.ray.tfar[lane] }
        })
    }
}

/// 16 rays of which only matters whether anything blocks them.
///
/// A query marks blocked rays in place: set a lane again before it is traced again.
#[derive(Debug, Clone)]
pub struct ShadowPacket {
    pub(super) query: sys::RTCRay16,
    pub(super) valid: Valid,
}

impl Default for ShadowPacket {
    fn default() -> ShadowPacket {
        ShadowPacket::new()
    }
}

impl ShadowPacket {
    /// A packet without rays.
    pub fn new() -> ShadowPacket {
        let query = sys::RTCRay16 { mask: [u32::MAX; LANES], ..Default::default() };
        ShadowPacket { query, valid: Valid([0; LANES]) }
    }

    /// Puts a ray into a lane (0 to 15), which becomes active if the ray is finite.
    #[inline]
    pub fn set(&mut self, lane: usize, ray: &Ray) {
        assert!(lane < LANES);
        set_lane!(&mut self.query, lane, ray);
        self.valid.0[lane] = -i32::from(ray.is_valid());
    }

    /// Multiplies lengths by a power of two. Lanes of which an origin leaves Embree's range become inactive.
    pub(super) fn rescale(&mut self, scale: f32) {
        let r = &mut self.query;
        for lanes in [&mut r.org_x, &mut r.org_y, &mut r.org_z, &mut r.tnear, &mut r.tfar] {
            lanes.iter_mut().for_each(|x| *x *= scale);
        }
        self.valid.keep_within([&r.org_x, &r.org_y, &r.org_z]);
    }

    /// Makes every lane inactive.
    #[inline]
    pub fn clear(&mut self) {
        self.valid.0 = [0; LANES];
    }

    /// The active lanes that Embree marked as blocked.
    #[inline]
    pub(super) fn blocked(&self) -> u16 {
        let mut bits = 0;
        for lane in 0..LANES {
            let blocked = self.valid.0[lane] != 0 && self.query.tfar[lane] == f32::NEG_INFINITY;
            bits |= u16::from(blocked) << lane;
        }
        bits
    }
}
