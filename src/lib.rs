//! Two-pass global illumination after Wallace, Cohen and Greenberg (SIGGRAPH 1987).
//!
//! Pass 1 ([`pipeline::solve`]) finds the diffuse light of a scene, independent of any view: surfaces
//! are divided into elements ([`mesh`]), rays measure how they see each other ([`form_factor`]), and a
//! linear system gives their radiosity ([`radiosity`]). Pass 2 ([`mod@render`]) adds what depends on
//! direction, for one camera at a time; one solution serves any number of cameras. Embree answers every
//! visibility question ([`visibility`]).
//!
//! Radiometric quantities are linear RGB in SI units, lengths are metres. Results depend on the seed,
//! never on the number of threads.
//!
//! ```
//! use twopass::{embree::Device, emitters::Emitters, pipeline, render, scene, visibility::Visibility};
//!
//! let scene = scene::load("scenes/cornell/cornell.toml".as_ref())?;
//! let device = Device::new(1)?;
//! let visibility = Visibility::new(&device, &scene)?;
//! let emitters = Emitters::new(&visibility);
//!
//! // Far fewer rays and elements than a good picture needs.
//! let camera = scene::Camera { size: [16, 16], ..scene.camera(None)?.clone() };
//! let settings = pipeline::Pass1 { rays: 64, element_size: Some(0.1), ..pipeline::Pass1::of(&scene) };
//! let (cameras, stages) = (std::slice::from_ref(&camera), &mut Vec::new());
//! let pass1 = pipeline::solve(&visibility, &emitters, cameras, &settings, &|_| (), stages)?;
//!
//! let settings = render::Settings {
//!     method: render::Method::TwoPass(render::Quality::Mesh),
//!     spp: 1,
//!     gather_rays: 1,
//!     emitter_samples: 1,
//!     estimator: render::Estimator::Lobe(1),
//!     seed: 0,
//! };
//! let solution = Some(&pass1.solution);
//! let (image, _traced) = render::render(&visibility, &emitters, solution, &camera, &settings, &|_| ());
//! assert!(image.get(8, 8).iter().all(|radiance| *radiance > 0.0));
//! # Ok::<(), twopass::Error>(())
//! ```

pub mod accuracy;
pub mod adaptive;
pub mod bench;
pub mod bsdf;
pub mod cli;
pub mod color;
pub mod embree;
pub mod emitters;
pub mod error;
pub mod form_factor;
pub mod geometry;
pub mod hard_cases;
pub mod image;
mod medium;
pub mod memory;
pub mod mesh;
pub mod npz;
pub mod output;
pub mod pipeline;
pub mod radiosity;
pub mod render;
pub mod report;
pub mod sampling;
pub mod scene;
pub mod sequence;
mod sets;
pub mod visibility;

pub use error::{Error, Result};
