//! Runs the suite of hard cases and prints its table: `cargo run --release --example hard_cases [all]`.
//! Cases that take minutes run only with `all`.

use twopass::hard_cases::{cases, table};

fn main() {
    let all = std::env::args().any(|a| a == "all");
    let rows: Vec<_> = cases()
        .into_iter()
        .filter(|c| all || !c.slow)
        .map(|c| {
            eprintln!("{}", c.name);
            (c, c.measure())
        })
        .collect();
    println!("{}", table(&rows));
}
