//! The suite of hard cases as a group: what breaks elsewhere, the program's error and its time.

use super::{Context, Measurements};
use crate::Result;
use crate::hard_cases::{Case, Measured, Outcome, Pace, cases};
use crate::report::record::{Figure, Subject, Unit};

/// Error of the program, relative to the answer.
const ERROR: &str = "error";
/// The error that the program itself states.
const STATED: &str = "standard error";
const TIME: &str = "time";
/// 1 where a case is as it should be.
const RIGHT: &str = "right";

const SUBJECTS: [(&str, &str, &str); 3] = [
    (
        "geometry",
        "Geometry on which meshes, trees and single precision break",
        "Each case is a small scene that is made, solved and compared with an answer that does not come from the same code.",
    ),
    (
        "transport",
        "Light on which solvers and samplers break",
        "Reflectances near 1, light that arrives only through narrow or specular ways, materials at the ends of their ranges.",
    ),
    (
        "work",
        "Amounts of work on which loops and statistics break",
        "One of a kind, or far more of one thing than of the other.",
    ),
];

pub fn run(context: &Context) -> Result<Measurements> {
    let fits = |case: &Case| !context.settings.quick || case.pace == Pace::Fast;
    let (chosen, left): (Vec<Case>, Vec<Case>) = cases().into_iter().partition(fits);
    let mut rows: Vec<(Case, Vec<Measured>)> = Vec::new();
    for case in chosen {
        (context.observer)(&format!("hard-cases: {}", case.name));
        // Always the same seed, so the same error: runs differ in their time alone.
        let runs = if case.pace == Pace::Minutes { 1 } else { context.choose(1, 3) };
        rows.push((case, (0..runs).map(|_| case.measure()).collect()));
    }
    Ok(record(&rows, &left))
}

/// The measured cases as data; `left` are those that a quick run leaves out.
fn record(rows: &[(Case, Vec<Measured>)], left: &[Case]) -> Measurements {
    let mut subjects = Vec::new();
    for (name, title, about) in SUBJECTS {
        let mut subject = Subject::new(name, title, about);
        for (case, runs) in rows.iter().filter(|r| r.0.group == name) {
            row(&mut subject, case, runs);
        }
        let names: Vec<&str> = left.iter().filter(|c| c.group == name).map(|c| c.name).collect();
        if !names.is_empty() {
            subject.notes.push(format!("left out of a quick run: {}", names.join(", ")));
        }
        if !subject.series.is_empty() || !names.is_empty() {
            subjects.push(subject);
        }
    }
    let right = rows.iter().filter(|(case, runs)| runs.iter().all(|m| case.passes(m))).count();
    let figures = vec![Figure {
        label: format!(
            "of {} hard cases are right: within their limit or four of their own standard errors",
            rows.len()
        ),
        unit: Unit::Count,
        samples: vec![right as f64],
    }];
    Measurements { figures, subjects }
}

fn row(subject: &mut Subject, case: &Case, runs: &[Measured]) {
    let series = subject.series(case.name, "");
    let outcome = runs.iter().find(|m| !case.passes(m)).or(runs.first()).map(|m| match &m.outcome {
        Ok(Outcome::Number { .. }) if case.passes(m) => "right".into(),
        Ok(Outcome::Number { .. }) => "WRONG".into(),
        Ok(Outcome::Said(_)) => "said so".into(),
        Err(message) => format!("FAILED: {message}"),
    });
    for (column, text) in [
        ("what breaks elsewhere", case.breaks.to_string()),
        ("answer from", case.answer.to_string()),
        ("outcome", outcome.unwrap_or_default()),
    ] {
        series.words.push((column.into(), text));
    }
    let point = series.at(1.0);
    for m in runs {
        if let Ok(Outcome::Number { error, standard_error }) = m.outcome {
            // Beyond all numbers: its outcome says so.
            if error.is_finite() {
                point.push(ERROR, Unit::Share, error);
            }
            if standard_error > 0.0 && standard_error.is_finite() {
                point.push(STATED, Unit::Share, standard_error);
            }
        }
        point.push(TIME, Unit::Seconds, m.seconds);
        point.push(RIGHT, Unit::Count, f64::from(u8::from(case.passes(m))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Real cases, one of each kind of outcome, and two that fail.
    #[test]
    fn cases_become_rows() {
        let named = |name: &str| cases().into_iter().find(|c| c.name == name).expect("a case");
        let run = |name: &str| {
            let case = named(name);
            (case, vec![case.measure()])
        };
        let wrong = Outcome::Number { error: 0.5, standard_error: 0.01 };
        let failed = |case: &Case, outcome| vec![Measured { case: case.name, outcome, seconds: 2.0 }];
        let (pixel, few) = (named("one pixel"), named("more elements than rays"));
        let rows = [
            run("one element"),
            run("no light at all"),
            (pixel, failed(&pixel, Ok(wrong))),
            (few, failed(&few, Err("out of memory".into()))),
        ];
        let left = [named("sphere of a million triangles")];
        let found = record(&rows, &left);
        assert_eq!(found.figures[0].samples, [2.0]);
        assert!(found.figures[0].label.starts_with("of 4 "));
        let names: Vec<&str> = found.subjects.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["geometry", "transport", "work"]);
        assert!(found.subjects[0].notes[0].contains("sphere of a million triangles"));
        let word = |s: usize, k: usize| found.subjects[s].series[k].words[2].1.as_str();
        assert_eq!([word(1, 0), word(2, 0), word(2, 1)], ["said so", "right", "WRONG"]);
        assert_eq!(word(2, 2), "FAILED: out of memory");
        let value =
            |k: usize, q: &str| found.subjects[2].series[k].points[0].get(q).map(|m| m.samples.clone());
        // A plate under an open sky sees nothing but it: exact to single precision.
        assert!(value(0, ERROR).is_some_and(|e| e[0] < 1e-6), "{:?}", value(0, ERROR));
        assert_eq!((value(1, ERROR), value(1, STATED)), (Some(vec![0.5]), Some(vec![0.01])));
        assert_eq!((value(2, ERROR), value(2, TIME)), (None, Some(vec![2.0])));
        assert_eq!([0, 1, 2].map(|k| value(k, RIGHT)), [1.0, 0.0, 0.0].map(|r| Some(vec![r])));
    }
}
