//! What the files said, validated once and immutable afterwards.
//!
//! Coordinates are metres relative to [`Scene::center`]: files are read in f64 and moved to the
//! scene's centre before anything is stored in f32, so a room 100 km from the origin is traced as
//! precisely as the same room at the origin.

mod camera;
mod coplanar;
mod document;
#[cfg(test)]
mod documented;
mod faces;
mod features;
mod footing;
mod frame;
mod idle;
mod load;
mod material;
mod mtl;
mod obj;
mod obj_text;
mod path;
mod polygon;
mod strip;

pub use camera::{Camera, CameraFrame, within_size};
pub use features::Features;
pub use frame::{FaceFrame, from_affine, from_halves};
pub use load::load;
pub use material::{MIRROR_ALPHA, Material};
pub use path::CameraPath;

use crate::color::Rgb;
use glam::{DVec2, DVec3};
use std::path::PathBuf;

/// A validated scene.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The scene file (or the OBJ file, where one was given directly).
    pub path: PathBuf,
    /// Every file that was asked for to read the scene: `path`, geometry, libraries of materials.
    pub files: Vec<PathBuf>,
    /// Object names in the order of the files' `o`/`g` statements; names without faces are
    /// left out.
    pub objects: Vec<String>,
    /// Materials; faces refer to them by index.
    pub materials: Vec<Material>,
    /// Vertex positions \[m\], relative to `center`.
    pub vertices: Vec<DVec3>,
    /// Unit shading normals of the faces that have them.
    pub normals: Vec<DVec3>,
    /// Faces: `triangle_count` triangles first, then quads.
    pub faces: Vec<Face>,
    /// How many of `faces` are triangles.
    pub triangle_count: usize,
    /// Number of polygons in the input files that faces were made of.
    pub polygon_count: usize,
    /// Middle of the bounding box in the file's frame \[m\].
    pub center: DVec3,
    /// Half the diagonal of the bounding box \[m\].
    pub radius: f64,
    /// Metres per unit of the scene file.
    pub unit: f64,
    /// Cameras; may be empty (then only `solve` and `form-factors` work).
    pub cameras: Vec<Camera>,
    /// The cameras that move; each has the name of one of `cameras`.
    pub paths: Vec<CameraPath>,
    /// Constant radiance that arrives from outside [W m^-2 sr^-1].
    pub environment: Rgb,
    /// `[radiosity]` of the scene file.
    pub radiosity: RadiosityDefaults,
    /// `[render]` of the scene file.
    pub render: RenderDefaults,
    /// What the user should know, each said once.
    pub warnings: Vec<String>,
}

/// A face that Embree holds: a triangle, or a planar convex quad.
///
/// Point at (u, v): bilinear between the corners of a quad (0 <= u, v <= 1; see [`FaceFrame`]) and
/// `p0 + u (p1 - p0) + v (p2 - p0)` for a triangle (u, v >= 0, u + v <= 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Face {
    /// Indices into [`Scene::vertices`], counter-clockwise seen from the front; a triangle repeats
    /// its third vertex.
    pub vertices: [u32; 4],
    /// Indices into [`Scene::normals`], where the file has shading normals.
    pub normals: Option<[u32; 4]>,
    /// Index into [`Scene::objects`].
    pub object: u32,
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// The input polygon that this face is (a part of).
    pub polygon: u32,
    /// Unit geometric normal, by the right-hand rule.
    pub normal: DVec3,
    /// Area [m^2].
    pub area: f64,
    /// How far the third corner of a quad is from where it would be in a parallelogram, in multiples of the edges from the first
    /// one to the second and to the last; zero of parallelograms and triangles.
    pub skew: DVec2,
}

impl Face {
    /// Whether the face is a triangle; a quad otherwise.
    pub fn is_triangle(&self) -> bool {
        self.vertices[2] == self.vertices[3]
    }
}

/// Defaults for pass 1 from the scene file; the command line overrides them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RadiosityDefaults {
    /// Largest edge of an element \[m\].
    pub element_size: Option<f64>,
    /// Rays an element.
    pub rays: Option<u32>,
    /// Elements are fine only where the light asks for it.
    pub adaptive: bool,
}

/// Defaults for pass 2 from the scene file; the command line overrides them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RenderDefaults {
    /// Samples a pixel.
    pub spp: Option<u32>,
    /// `mesh`, `direct` or `gather`.
    pub quality: Option<String>,
}

impl Scene {
    /// Corner `k` (0..4) of a face [m, relative to the centre].
    pub fn corner(&self, face: &Face, k: usize) -> DVec3 {
        self.vertices[face.vertices[k] as usize]
    }

    /// The material of a face.
    pub fn material(&self, face: &Face) -> &Material {
        &self.materials[face.material as usize]
    }

    /// A number that changes whenever geometry, materials or environment change: FNV-1a over their
    /// exact values. Cameras and defaults do not count.
    pub fn hash(&self) -> u64 {
        let mut h = 0xcbf2_9ce4_8422_2325u64;
        let mut eat = |bytes: &[u8]| {
            for b in bytes {
                h = (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3);
            }
        };
        for v in self.vertices.iter().chain(&self.normals).chain([&self.center, &self.environment]) {
            v.to_array().iter().for_each(|x| eat(&x.to_bits().to_le_bytes()));
        }
        for f in &self.faces {
            f.vertices.iter().chain(f.normals.iter().flatten()).for_each(|i| eat(&i.to_le_bytes()));
            eat(&f.material.to_le_bytes());
            // Decides which grids and nodes go together.
            eat(&f.polygon.to_le_bytes());
        }
        for m in &self.materials {
            eat(format!("{m:?}").as_bytes());
        }
        h
    }
}
