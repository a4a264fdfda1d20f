//! Queries of every width, for benchmarks of Embree's own rate on the same rays.

use super::packet::Valid;
use super::ray::Ray;
use super::scene::{CommittedScene, MISS};
use super::sys;

/// How many rays one call into Embree carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// One ray.
    One,
    /// Packets of 4.
    Four,
    /// Packets of 8.
    Eight,
    /// Packets of 16.
    Sixteen,
}

impl Width {
    /// All widths.
    pub const ALL: [Width; 4] = [Width::One, Width::Four, Width::Eight, Width::Sixteen];

    /// Rays in a call.
    pub fn rays(self) -> usize {
        match self {
            Width::One => 1,
            Width::Four => 4,
            Width::Eight => 8,
            Width::Sixteen => 16,
        }
    }
}

/// Rays laid out for calls of one width.
#[derive(Debug, Clone)]
pub struct Queries(Layout);

#[derive(Debug, Clone)]
enum Layout {
    One(Vec<sys::RTCRayHit>),
    Four(Vec<sys::RTCRayHit4>),
    Eight(Vec<sys::RTCRayHit8>),
    Sixteen(Vec<sys::RTCRayHit16>),
}

/// Packets of `$n` from rays, and the part that does not fill one left out.
macro_rules! packets {
    ($rays:expr, $n:expr, $kind:ident) => {
        $rays
            .chunks_exact($n)
            .map(|chunk| {
                let mut query = sys::$kind::default();
                query.ray.mask = [u32::MAX; $n];
                query.hit.geomID = [MISS; $n];
                for (lane, ray) in chunk.iter().enumerate() {
                    super::packet::set_lane!(&mut query.ray, lane, ray);
                }
                query
            })
            .collect()
    };
}

impl Queries {
    /// Lays out rays in order; rays that do not fill a last packet are left out, and so are those that are not finite.
    pub fn new(rays: &[Ray], width: Width) -> Queries {
        let rays: Vec<Ray> = rays.iter().copied().filter(Ray::is_valid).collect();
        Queries(match width {
            Width::One => Layout::One(
                rays.iter()
                    .map(|ray| {
                        let mut query = sys::RTCRayHit { ray: ray.to_raw(), hit: sys::RTCHit::default() };
                        query.hit.geomID = MISS;
                        query
                    })
                    .collect(),
            ),
            Width::Four => Layout::Four(packets!(rays, 4, RTCRayHit4)),
            Width::Eight => Layout::Eight(packets!(rays, 8, RTCRayHit8)),
            Width::Sixteen => Layout::Sixteen(packets!(rays, 16, RTCRayHit16)),
        })
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        match &self.0 {
            Layout::One(q) => q.len(),
            Layout::Four(q) => 4 * q.len(),
            Layout::Eight(q) => 8 * q.len(),
            Layout::Sixteen(q) => 16 * q.len(),
        }
    }

    /// No rays.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Distance of every ray's hit in order, infinite for a miss.
    pub fn distances(&self) -> Vec<f32> {
        match &self.0 {
            Layout::One(q) => q.iter().map(|q| q.ray.tfar).collect(),
            Layout::Four(q) => q.iter().flat_map(|q| q.ray.tfar).collect(),
            Layout::Eight(q) => q.iter().flat_map(|q| q.ray.tfar).collect(),
            Layout::Sixteen(q) => q.iter().flat_map(|q| q.ray.tfar).collect(),
        }
    }
}

impl CommittedScene {
    /// Traces all queries, one call each: nothing but Embree's own work.
    pub fn trace(&self, queries: &mut Queries, coherent: bool) {
        static ALL: Valid = Valid([-1; 16]);
        let (valid, scene, flag) = (ALL.0.as_ptr(), self.raw(), i32::from(coherent));
        match &mut queries.0 {
            Layout::One(queries) => {
                for query in queries {
                    // SAFETY: the scene is committed, and the query a whole, aligned RTCRayHit.
                    unsafe { sys::twopass_intersect1(scene, query) }
                }
            }
            Layout::Four(queries) => {
                for query in queries {
                    // SAFETY: the scene is committed; the mask holds at least 4 lanes, and mask and query are aligned by
                    // their types.
                    unsafe { sys::twopass_intersect4(valid, scene, query, flag) }
                }
            }
            Layout::Eight(queries) => {
                for query in queries {
                    // SAFETY: as above, with 8 lanes.
                    unsafe { sys::twopass_intersect8(valid, scene, query, flag) }
                }
            }
            Layout::Sixteen(queries) => {
                for query in queries {
                    // SAFETY: as above, with 16 lanes.
                    unsafe { sys::twopass_intersect16(valid, scene, query, flag) }
                }
            }
        }
    }
}
