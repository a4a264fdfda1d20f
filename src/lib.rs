//! Two-pass global illumination after Wallace, Cohen and Greenberg (SIGGRAPH 1987).

pub mod bsdf;
pub mod cli;
pub mod color;
pub mod embree;
pub mod emitters;
pub mod error;
pub mod form_factor;
pub mod geometry;
pub mod image;
pub mod mesh;
pub mod output;
pub mod pipeline;
pub mod radiosity;
pub mod render;
pub mod report;
pub mod sampling;
pub mod scene;
pub mod visibility;

pub use error::{Error, Result};
