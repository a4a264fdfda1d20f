//! Form factors between elements, ordinary and extended.

pub mod analytic;
mod estimate;
mod file;
mod found;
mod matrix;
pub mod pairs;
mod raycast;
mod source;
mod specular;
mod table;

pub use estimate::{MOST_RAYS, Request, by_pairs, estimate, unoccluded};
pub use found::Found;
pub use matrix::{ExchangeMatrix, RowSummary};
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast};
pub use source::time_embree;
pub use specular::{ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
