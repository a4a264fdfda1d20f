//! Form factors between elements, ordinary and extended.

mod file;
mod matrix;
mod mirror;
mod raycast;
mod source;
mod specular;
mod table;

pub use matrix::{ExchangeMatrix, RowSummary};
pub use mirror::cast_images;
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast};
pub use source::element_rays;
pub use specular::{Carried, ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
