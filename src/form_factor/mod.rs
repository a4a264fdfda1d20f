//! Form factors between elements, ordinary and extended.

mod correct;
pub mod export;
mod hemicube;
mod matrix;
mod mirror;
mod raycast;
mod source;
mod specular;
mod table;

pub use correct::{Correction, Enforce, correct};
pub use export::Factors;
pub use hemicube::{DeltaFactors, HemicubeErrors, HemicubeSettings, MOST_PIXELS, hemicube, item_image};
pub use matrix::{ExchangeMatrix, RowSummary};
pub use mirror::cast_images;
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast, cast_rows};
pub use source::element_rays;
pub use specular::{Carried, ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
