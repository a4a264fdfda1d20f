//! The `twopass` program.

fn main() {}
