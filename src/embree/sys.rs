//! What bindgen made of the installed headers. Layout tests are compile-time assertions in it.

#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, missing_docs, dead_code, clippy::all)]

include!(concat!(env!("OUT_DIR"), "/embree.rs"));
