//! Form factors between elements, ordinary and extended.

mod file;
mod matrix;
mod raycast;
mod source;
mod specular;
mod table;

pub use matrix::{ExchangeMatrix, RowSummary};
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast};
pub use source::element_rays;
pub use specular::{ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
