//! Cases on which radiosity, form factors and single-precision rays are known to break.

pub mod build;
