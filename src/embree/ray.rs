//! Single rays and their hits.

use super::sys;
use glam::Vec3;

/// Embree's own limit on coordinates.
pub(super) const LIMIT: f32 = 1.8e18;

/// A ray segment; the direction need not be a unit vector, distances count in its length.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Where the ray starts.
    pub origin: Vec3,
    /// Where it goes.
    pub direction: Vec3,
    /// Hits before this distance do not count; not negative.
    pub tnear: f32,
    /// Hits beyond this distance do not count. Exactly at `tnear` or `tfar` they may.
    pub tfar: f32,
}

impl Ray {
    /// An endless ray.
    #[inline]
    pub fn new(origin: Vec3, direction: Vec3) -> Ray {
        Ray::segment(origin, direction, f32::INFINITY)
    }

    /// A ray that ends at the distance `tfar`.
    #[inline]
    pub fn segment(origin: Vec3, direction: Vec3, tfar: f32) -> Ray {
        Ray { origin, direction, tnear: 0.0, tfar }
    }

    /// Whether Embree accepts the ray. Debian builds Embree with assertions: one NaN would end the
    /// process, so a ray that is none never gets there and simply hits nothing.
    #[inline]
    pub(super) fn is_valid(&self) -> bool {
        // A sum of magnitudes is NaN or infinite if any part is.
        let size = self.origin.abs().element_sum() + self.direction.abs().element_sum();
        size < LIMIT && self.tnear >= 0.0 && self.tfar >= self.tnear
    }

    #[inline]
    pub(super) fn to_raw(self) -> sys::RTCRay {
        sys::RTCRay {
            org_x: self.origin.x,
            org_y: self.origin.y,
            org_z: self.origin.z,
            tnear: self.tnear,
            dir_x: self.direction.x,
            dir_y: self.direction.y,
            dir_z: self.direction.z,
            tfar: self.tfar,
            mask: u32::MAX,
            ..Default::default()
        }
    }
}

/// Where a ray meets a face.
///
/// The point is `p0 + u (p1 - p0) + v (p2 - p0)` on a triangle and `p0 + u (p1 - p0) + v (p3 - p0)` on a quad, where u + v <= 1. The
/// other half of a quad is counted from the opposite corner, as `1 - u` and `1 - v`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The face: triangles first, then quads, in the order the scene was given them.
    pub face: u32,
    /// First coordinate on the face.
    pub u: f32,
    /// Second coordinate on the face.
    pub v: f32,
    /// Distance, in lengths of the ray's direction.
    pub t: f32,
}
