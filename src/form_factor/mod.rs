//! Form factors between elements, ordinary and extended.

mod correct;
pub mod export;
mod hemicube;
mod matrix;
mod raycast;
mod source;
mod specular;
mod table;

pub use correct::{Correction, Enforce, correct};
pub use export::Factors;
pub use hemicube::{DeltaFactors, HemicubeErrors, HemicubeSettings, MOST_PIXELS, hemicube, item_image};
pub use matrix::{ExchangeMatrix, RowSummary};
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast, cast_rows};
pub use source::time_embree;
pub use specular::{ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
