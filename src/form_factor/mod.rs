//! Form factors between elements, ordinary and extended.

pub mod analytic;
mod correct;
mod estimate;
pub mod export;
mod found;
mod gathered;
mod hemicube;
mod immersed;
mod matrix;
mod mirror;
pub mod pairs;
mod projection;
mod raycast;
mod recast;
mod rows;
mod source;
mod specular;
mod table;
mod tally;
mod tiles;

pub use correct::{Correction, Enforce, correct};
pub use estimate::{MOST_RAYS, Request, by_pairs, estimate, unoccluded};
pub use export::Factors;
pub use found::{Estimates, Found};
pub use gathered::{EmitterIrradiance, EmitterRows, EmitterWork};
pub use hemicube::{DeltaFactors, HemicubeErrors, HemicubeSettings, MOST_PIXELS, hemicube, item_image};
pub use matrix::{ExchangeMatrix, RowSummary};
pub use mirror::cast_images;
pub use projection::ProjectionMap;
pub use raycast::{Caster, Casting, cast, cast_random, cast_rows};
pub use recast::{Check, Recast, Rows};
pub use rows::{Row, widen};
pub use source::packets_of;
pub use specular::{Carried, ChainEnd, Chains, Link, pass_on};
pub use table::ObjectTable;
pub use tiles::Tiles;
