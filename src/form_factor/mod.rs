//! Form factors between elements, ordinary and extended.

pub mod analytic;
mod file;
mod matrix;
mod raycast;
mod source;
mod specular;
mod table;

pub use matrix::{ExchangeMatrix, RowSummary};
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast};
pub use source::time_embree;
pub use specular::{ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
