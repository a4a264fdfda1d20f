//! Form factors between elements, ordinary and extended.

pub mod analytic;
mod correct;
mod estimate;
pub mod export;
mod found;
mod hemicube;
mod matrix;
mod mirror;
pub mod pairs;
mod raycast;
mod source;
mod specular;
mod table;

pub use correct::{Correction, Enforce, correct};
pub use estimate::{MOST_RAYS, Request, by_pairs, estimate, unoccluded};
pub use export::Factors;
pub use found::Found;
pub use hemicube::{DeltaFactors, HemicubeErrors, HemicubeSettings, MOST_PIXELS, hemicube, item_image};
pub use matrix::{ExchangeMatrix, RowSummary};
pub use mirror::cast_images;
pub use raycast::{Casting, EmitterIrradiance, EmitterWork, cast, cast_random, cast_rows};
pub use source::element_rays;
pub use specular::{Carried, ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
