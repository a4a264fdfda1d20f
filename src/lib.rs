//! Two-pass global illumination after Wallace, Cohen and Greenberg (SIGGRAPH 1987).

pub mod color;
pub mod embree;
pub mod error;
pub mod image;
pub mod scene;

pub use error::{Error, Result};
