//! Memory of whole runs of the program, each in a process of its own.

use super::scenes::write_embedded;
use super::{Context, Measurements};
use crate::report::record::{Chart, Figure, PARAMETER, Subject, Unit};
use crate::{Error, Result};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

const PEAK: &str = "most memory held";

pub fn run(context: &Context) -> Result<Measurements> {
    let mut subject = Subject::new(
        "solve",
        "`twopass solve` on the Cornell box",
        "The most memory that the program held at once (as the system counts it: pages in memory, libraries included), each run in a \
         process of its own, from loading the scene to the written solution. Beside it the matrix of form factors, which holds 4 \
         bytes for each entry (an element, seen from another in one of 4 independent parts of its row) and 114 for each element.",
    );
    let Some(program) = &context.settings.program else {
        subject.notes.push("skipped: the program does not know its own file".into());
        return Ok(Measurements { figures: Vec::new(), subjects: vec![subject] });
    };
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    write_embedded("cornell", folder.path())?;
    let sizes: &[f64] = context.choose(&[0.08, 0.024, 0.01], &[0.08, 0.024, 0.0069, 0.0022]);
    let rays: &[u32] = context.choose(&[64], &[64, 1024]);
    for &rays in rays {
        // A million elements with 1024 rays each need tens of gigabytes.
        for &size in sizes.iter().filter(|s| rays == 64 || **s > 0.003) {
            for round in 0..context.choose(1, 2) {
                let seed = context.settings.seed.wrapping_add(round);
                (context.observer)(&format!("memory: {rays} rays, elements of {size} m, seed {seed}"));
                let report = solve(program, folder.path(), rays, size, seed)?;
                let number = |path: &str| {
                    let value = report.pointer(path).and_then(Value::as_f64);
                    value.ok_or_else(|| Error::scene("report of twopass solve", format!("has no {path}")))
                };
                let (elements, peak) = (number("/elements")?, number("/peak_memory_bytes")?);
                let (matrix, entries) = (number("/pass1/matrix_bytes")?, number("/pass1/stored_factors")?);
                if peak == 0.0 {
                    subject.notes.push("skipped: the system does not tell a process's memory".into());
                    return Ok(Measurements { figures: Vec::new(), subjects: vec![subject] });
                }
                let point = subject.series(&format!("{rays} rays an element"), "elements").at(elements);
                point.push(PEAK, Unit::Bytes, peak);
                point.push("matrix", Unit::Bytes, matrix);
                point.push("entries", Unit::Count, entries);
                point.push("matrix, an entry", Unit::Bytes, matrix / entries);
                point.push("all, an element", Unit::Bytes, peak / elements);
            }
        }
    }
    let chart = Chart::new(
        "Most memory held over elements",
        PARAMETER,
        PEAK,
        "Flat on the left: what any run needs. Then in proportion to the elements.",
    );
    subject.charts.push(chart.guide("in proportion: 1", 1.0));
    let figures = subject.series.iter().filter_map(|s| per_element(s).map(|v| (s, v))).map(|(s, samples)| {
        Figure { label: format!("held for each further element, {}", s.name), unit: Unit::Bytes, samples }
    });
    let figures = figures.collect();
    Ok(Measurements { figures, subjects: vec![subject] })
}

/// Bytes for each element beyond the smallest scene's, by run.
fn per_element(series: &crate::report::record::Series) -> Option<Vec<f64>> {
    let (first, last) = (series.points.first()?, series.points.last()?);
    let more = last.parameter - first.parameter;
    let pairs = first.get(PEAK)?.samples.iter().zip(&last.get(PEAK)?.samples);
    (more > 0.0).then(|| pairs.map(|(a, b)| (b - a) / more).collect())
}

/// Runs the program and reads its report.
fn solve(program: &Path, folder: &Path, rays: u32, size: f64, seed: u32) -> Result<Value> {
    let report = folder.join("report.json");
    let output = Command::new(program)
        .arg("solve")
        .arg(folder.join("cornell.toml"))
        .arg("-o")
        .arg(folder.join("solution.npz"))
        .args(["--rays", &rays.to_string(), "--element-size", &size.to_string(), "--seed", &seed.to_string()])
        .arg("--threads")
        .arg(rayon::current_num_threads().to_string())
        .arg("--quiet")
        .arg("--report")
        .arg(&report)
        .output()
        .map_err(|e| Error::io(program, e))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).trim().to_string();
        return Err(Error::scene(format!("{} solve", program.display()), said));
    }
    let text = std::fs::read_to_string(&report).map_err(|e| Error::io(&report, e))?;
    serde_json::from_str(&text).map_err(|e| Error::parse(&report, Some(e.line()), e.to_string()))
}
