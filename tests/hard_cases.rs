//! The suite of hard cases: every one within its limit or four of the program's own standard errors.

use twopass::hard_cases::{Outcome, Pace, cases};

fn run(group: &str) {
    let mut failed = Vec::new();
    let only = std::env::var("HARD_CASE").ok();
    for case in cases() {
        if case.group != group || only.as_ref().is_some_and(|o| !case.name.contains(o.as_str())) {
            continue;
        }
        if case.pace == Pace::Minutes && only.is_none() {
            eprintln!("{:44} left to `twopass bench hard-cases`", case.name);
            continue;
        }
        let m = case.measure();
        let verdict = if case.passes(&m) { "" } else { "  FAILS" };
        match &m.outcome {
            Ok(Outcome::Number { error, standard_error }) => eprintln!(
                "{:44} error {:8.4} %, standard error {:8.4} %, {:5.2} s{verdict}",
                case.name,
                100.0 * error,
                100.0 * standard_error,
                m.seconds
            ),
            Ok(Outcome::Said(words)) => eprintln!("{:44} said: {words}", case.name),
            Err(message) => eprintln!("{:44} {message}{verdict}", case.name),
        }
        if !case.passes(&m) {
            failed.push(case.name);
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn geometry() {
    run("geometry");
}

#[test]
fn transport() {
    run("transport");
}

#[test]
fn work() {
    run("work");
}
