//! The committed scene: geometry in Embree's own buffers, and the queries against it.

use super::halves::{face_of, halves, turned};
use super::packet::{RayPacket, ShadowPacket};
use super::ray::{Hit, Ray};
use super::{Device, sys};
use crate::error::{Error, Result};
use std::ptr::NonNull;

/// Embree's `RTC_INVALID_GEOMETRY_ID`, which bindgen cannot evaluate.
pub(super) const MISS: u32 = u32::MAX;

/// Beyond this, Embree drops a vertex's primitives without a word (its `FLT_LARGE`).
const LARGEST_COORDINATE: f32 = 1.8e18;

/// Triangles and quads in a finished tree. Immutable, and shared freely between threads.
///
/// Embree has quads of its own, and would keep them in a tree beside that of the triangles. It gets halves of them instead: triangles
/// alone are traced 1.02 to 1.5 times as fast in the scenes of this program.
#[derive(Debug)]
pub struct CommittedScene {
    scene: NonNull<sys::RTCSceneTy>,
    triangle_count: u32,
    /// What coordinates are multiplied by on their way to Embree: 1 but for tiny and huge scenes.
    scale: f32,
    /// Declared after what `drop` releases: Embree's device goes last.
    _device: Device,
}

// SAFETY: after the commit in `new` nothing changes the scene, and Embree allows queries of a
// committed scene from any number of threads.
unsafe impl Send for CommittedScene {}
// SAFETY: as for `Send`.
unsafe impl Sync for CommittedScene {}

impl Drop for CommittedScene {
    fn drop(&mut self) {
        // SAFETY: the handle came from `rtcNewScene`, is released once, and its device is alive.
        unsafe { sys::rtcReleaseScene(self.scene.as_ptr()) }
    }
}

impl CommittedScene {
    /// Copies the faces into Embree and builds the tree.
    ///
    /// Fails where an index names no vertex, a vertex is not finite, there are more faces than a
    /// `u32` counts, or Embree refuses. Without any face every query misses.
    pub fn new(
        device: &Device,
        vertices: &[[f32; 3]],
        triangles: &[[u32; 3]],
        quads: &[[u32; 4]],
    ) -> Result<CommittedScene> {
        validate(vertices, triangles, quads)?;
        let triangle_count = triangles.len() as u32;

        // SAFETY: the device handle is live.
        let scene = unsafe { sys::rtcNewScene(device.raw()) };
        let Some(scene) = NonNull::new(scene) else {
            device.check("new scene")?;
            return Err(Error::Embree("new scene: no scene".into()));
        };
        // From here on `drop` releases the scene, whichever way this function ends.
        let scale = scale_of(vertices);
        let committed = CommittedScene { scene, triangle_count, scale, _device: device.clone() };
        // SAFETY: the scene handle is live and nobody else has it yet.
        unsafe {
            sys::rtcSetSceneFlags(scene.as_ptr(), sys::RTC_SCENE_FLAG_ROBUST);
            sys::rtcSetSceneBuildQuality(scene.as_ptr(), sys::RTC_BUILD_QUALITY_HIGH);
        }
        let scaled: Vec<[f32; 3]>;
        let vertices = if scale == 1.0 {
            vertices
        } else {
            scaled = vertices.iter().map(|v| v.map(|x| x * scale)).collect();
            &scaled
        };
        let all: Vec<[u32; 3]> =
            triangles.iter().copied().chain(quads.iter().copied().flat_map(halves)).collect();
        committed.attach(device, vertices, &all)?;
        // SAFETY: the scene handle is live and still ours alone.
        unsafe { sys::rtcCommitScene(scene.as_ptr()) };
        device.check("building the tree")?;
        Ok(committed)
    }

    pub(super) fn raw(&self) -> sys::RTCScene {
        self.scene.as_ptr()
    }

    /// Adds triangles as geometry 0; nothing where there are none.
    fn attach(&self, device: &Device, vertices: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<()> {
        if triangles.is_empty() {
            return Ok(());
        }
        // SAFETY: the device handle is live.
        let geometry = unsafe { sys::rtcNewGeometry(device.raw(), sys::RTC_GEOMETRY_TYPE_TRIANGLE) };
        if geometry.is_null() {
            device.check("new geometry")?;
            return Err(Error::Embree("new geometry: no geometry".into()));
        }
        let filled = fill(geometry, sys::RTC_BUFFER_TYPE_VERTEX, sys::RTC_FORMAT_FLOAT3, vertices)
            && fill(geometry, sys::RTC_BUFFER_TYPE_INDEX, sys::RTC_FORMAT_UINT3, triangles);
        // SAFETY: both handles are live; the geometry is committed only with its buffers filled,
        // and its own reference goes once the scene holds one.
        unsafe {
            if filled {
                sys::rtcSetGeometryBuildQuality(geometry, sys::RTC_BUILD_QUALITY_HIGH);
                // Version 4 tests masks, and its geometries answer only to bit 0 by default.
                sys::rtcSetGeometryMask(geometry, u32::MAX);
                sys::rtcCommitGeometry(geometry);
                sys::rtcAttachGeometryByID(self.scene.as_ptr(), geometry, 0);
            }
            sys::rtcReleaseGeometry(geometry);
        }
        device.check("copying the faces")?;
        if filled { Ok(()) } else { Err(Error::Embree("copying the faces: out of memory".into())) }
    }

    /// The nearest hit of a ray; none for a ray that is not finite.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> Option<Hit> {
        let ray = self.scaled(ray);
        if !ray.is_valid() {
            return None;
        }
        let mut query = sys::RTCRayHit { ray: ray.to_raw(), hit: sys::RTCHit::default() };
        query.hit.geomID = MISS;
        // SAFETY: the scene is committed, and `query` is a whole, aligned RTCRayHit of the
        // installed headers.
        unsafe { sys::twopass_intersect1(self.scene.as_ptr(), &mut query) };
        let hit = &query.hit;
        (hit.geomID != MISS).then(|| {
            let (face, second) = face_of(hit.primID, self.triangle_count);
            Hit { face, u: turned(hit.u, second), v: turned(hit.v, second), t: query.ray.tfar / self.scale }
        })
    }

    /// A ray in Embree's coordinates: its direction stays, so distances grow with them.
    #[inline]
    fn scaled(&self, ray: &Ray) -> Ray {
        let s = self.scale;
        Ray { origin: ray.origin * s, tnear: ray.tnear * s, tfar: ray.tfar * s, ..*ray }
    }

    /// Whether any face lies on the ray between `tnear` and `tfar`.
    #[inline]
    pub fn occluded(&self, ray: &Ray) -> bool {
        let ray = self.scaled(ray);
        if !ray.is_valid() {
            return false;
        }
        let mut query = ray.to_raw();
        // SAFETY: the scene is committed, and `query` is a whole, aligned RTCRay.
        unsafe { sys::twopass_occluded1(self.scene.as_ptr(), &mut query) };
        query.tfar == f32::NEG_INFINITY
    }

    /// The nearest hits of a packet's active lanes, to be read with [`RayPacket::hit`].
    ///
    /// `coherent` pays only where the rays share a narrow cone of directions; elsewhere it costs
    /// up to half the speed.
    #[inline]
    pub fn intersect16(&self, packet: &mut RayPacket, coherent: bool) {
        packet.triangle_count = self.triangle_count;
        if self.scale != 1.0 {
            packet.rescale(self.scale);
        }
        // SAFETY: the scene is committed; the mask and the RTCRayHit16 are whole, and 64-byte
        // aligned by their types.
        unsafe {
            sys::twopass_intersect16(
                packet.valid.0.as_ptr(),
                self.scene.as_ptr(),
                &mut packet.query,
                i32::from(coherent),
            );
        }
        if self.scale != 1.0 {
            packet.rescale(1.0 / self.scale);
        }
    }

    /// Which active lanes of a packet are blocked: bit `i` for lane `i`.
    #[inline]
    pub fn occluded16(&self, packet: &mut ShadowPacket, coherent: bool) -> u16 {
        if self.scale != 1.0 {
            packet.rescale(self.scale);
        }
        // SAFETY: the scene is committed; the mask and the RTCRay16 are whole, and 64-byte
        // aligned by their types.
        unsafe {
            sys::twopass_occluded16(
                packet.valid.0.as_ptr(),
                self.scene.as_ptr(),
                &mut packet.query,
                i32::from(coherent),
            );
        }
        let blocked = packet.blocked();
        if self.scale != 1.0 {
            packet.rescale(1.0 / self.scale);
        }
        blocked
    }
}

/// Embree takes (u, v) as 0 where twice a face's area is below 1e-18, and multiplies three lengths, which single precision holds up
/// to 7e12. Scenes smaller than a centimetre grow to a kilometre, those larger than 2^33 shrink to that, by a power of two, which
/// changes no digit.
fn scale_of(vertices: &[[f32; 3]]) -> f32 {
    let largest = vertices.iter().flatten().fold(0f32, |m, x| m.max(x.abs()));
    let exponent = largest.log2().floor();
    if exponent > 32.0 {
        (32.0 - exponent).exp2()
    } else if largest >= 1.0 / 128.0 || largest == 0.0 {
        1.0
    } else {
        // Beyond 2^120 the scale itself would leave the range of single precision.
        (10.0 - exponent).min(120.0).exp2()
    }
}

/// Copies `items` into a new buffer of the geometry; false where Embree gives none.
fn fill<const N: usize, T: Copy>(
    geometry: sys::RTCGeometry,
    kind: sys::RTCBufferType,
    format: sys::RTCFormat,
    items: &[[T; N]],
) -> bool {
    let stride = size_of::<[T; N]>();
    // SAFETY: the geometry is live and not committed. Embree allocates, and pads the buffer for
    // its 16-byte loads.
    let buffer = unsafe { sys::rtcSetNewGeometryBuffer(geometry, kind, 0, format, stride, items.len()) }
        .cast::<[T; N]>();
    if buffer.is_null() {
        return false;
    }
    // SAFETY: the buffer was asked to hold `items.len()` items of this size, is aligned to 16
    // bytes and cannot overlap a Rust slice.
    unsafe { std::ptr::copy_nonoverlapping(items.as_ptr(), buffer, items.len()) };
    true
}

fn validate(vertices: &[[f32; 3]], triangles: &[[u32; 3]], quads: &[[u32; 4]]) -> Result<()> {
    // The last number is Embree's mark of a miss.
    let faces = quads.len().checked_mul(2).and_then(|n| n.checked_add(triangles.len()));
    if faces.is_none_or(|n| n >= u32::MAX as usize) {
        return Err(Error::Embree("more faces than can be counted".into()));
    }
    for (i, v) in vertices.iter().enumerate() {
        // Written so that NaN fails too.
        if !v.iter().all(|c| c.abs() < LARGEST_COORDINATE) {
            return Err(Error::Embree(format!("vertex {i} is not finite: {v:?}")));
        }
    }
    check_indices("triangle", vertices.len(), triangles)?;
    check_indices("quad", vertices.len(), quads)
}

fn check_indices<const N: usize>(kind: &str, vertices: usize, faces: &[[u32; N]]) -> Result<()> {
    for (i, face) in faces.iter().enumerate() {
        if let Some(index) = face.iter().find(|&&index| index as usize >= vertices) {
            return Err(Error::Embree(format!("{kind} {i} names vertex {index} of {vertices}")));
        }
    }
    Ok(())
}
