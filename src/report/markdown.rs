//! Tables of a suite in Markdown, and their places in other files.

use super::text;
use crate::bench::record::{GroupRecord, Subject, Suite};
use crate::{Error, Result};
use std::fmt::Write;
use std::path::Path;

/// The whole suite as tables.
pub fn to_markdown(suite: &Suite) -> String {
    let mut out = format!("# Benchmarks\n\n`{}`\n\n{}\n", text::command(suite), text::machine(suite));
    for group in &suite.groups {
        let _ = write!(out, "\n## {}\n\n{}\n", group.title, group.about);
        if !group.figures.is_empty() {
            out.push('\n');
        }
        for figure in &group.figures {
            let _ = writeln!(out, "- {}: **{}**", figure.label, text::samples(&figure.samples, figure.unit));
        }
        for subject in &group.subjects {
            let _ = write!(out, "\n### {}\n\n{}\n\n{}", subject.title, subject.about, table(subject));
            for (k, chart) in subject.charts.iter().enumerate() {
                let file = super::plot::file(group, subject, k);
                let _ = write!(out, "\n![{}]({file})\n\n{}\n", chart.title, chart.about);
            }
            for note in &subject.notes {
                let _ = write!(out, "\n{note}\n");
            }
        }
    }
    out
}

/// Names of a subject's quantities, in the order they first appear.
pub fn quantities(subject: &Subject) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    let all = subject.series.iter().flat_map(|s| &s.points).flat_map(|p| &p.measured);
    for m in all {
        if !names.contains(&m.quantity.as_str()) {
            names.push(&m.quantity);
        }
    }
    names
}

/// One row a point: medians, and ranges in parentheses.
pub fn table(subject: &Subject) -> String {
    let names = quantities(subject);
    let mut out = format!("| | | {} |\n|{}\n", names.join(" | "), " --- |".repeat(names.len() + 2));
    for series in &subject.series {
        for point in &series.points {
            let at = parameter(point.parameter, &series.parameter);
            let _ = write!(out, "| {} | {at} |", series.name);
            for name in &names {
                let cell = point.get(name).map_or_else(|| "-".into(), text::measured);
                let _ = write!(out, " {cell} |");
            }
            out.push('\n');
        }
    }
    out
}

/// A parameter's value with its name; the name alone where there is nothing to vary.
pub fn parameter(value: f64, name: &str) -> String {
    let number = text::value(value, crate::bench::record::Unit::Count);
    if name.is_empty() { String::new() } else { format!("{number} {name}") }
}

const END: &str = "<!-- /bench -->";

/// Replaces what stands between `<!-- bench GROUP/SUBJECT -->` and `<!-- /bench -->` with that subject's table,
/// everywhere in `old`. Tables that the suite did not measure stay as they are; returns the names of those that
/// changed.
pub fn replace_tables(old: &str, path: &Path, suite: &Suite) -> Result<(String, Vec<String>)> {
    const BEGIN: &str = "<!-- bench ";
    let line_of = |at: usize| Some(old[..at].matches('\n').count() + 1);
    let (mut new, mut rest, mut changed) = (String::new(), 0, Vec::new());
    while let Some(found) = old[rest..].find(BEGIN) {
        let begin = rest + found;
        let broken = |what: &str| Error::parse(path, line_of(begin), what);
        let Some(close) = old[begin..].find("-->") else {
            return Err(broken("this mark does not end with -->"));
        };
        let inner = begin + close + 3;
        let name = old[begin + BEGIN.len()..inner - 3].trim();
        let Some(end) = old[inner..].find(END).map(|k| inner + k) else {
            return Err(broken(&format!("no {END} follows this mark")));
        };
        if old[inner..end].contains(BEGIN) {
            return Err(broken(&format!("no {END} before the next mark")));
        }
        new.push_str(&old[rest..inner]);
        match find(suite, name) {
            Some((group, subject)) => {
                let _ = write!(new, "\n{}\n", block(suite, group, subject));
                changed.push(name.to_string());
            }
            None => new.push_str(&old[inner..end]),
        }
        new.push_str(END);
        rest = end + END.len();
    }
    new.push_str(&old[rest..]);
    if changed.is_empty() {
        let known: Vec<String> = suite
            .groups
            .iter()
            .flat_map(|g| g.subjects.iter().map(move |s| format!("{}/{}", g.name, s.name)))
            .collect();
        let message =
            format!("holds no mark <!-- bench NAME --> of a measured table; there are {}", known.join(", "));
        return Err(Error::parse(path, None, message));
    }
    Ok((new, changed))
}

fn find<'a>(suite: &'a Suite, name: &str) -> Option<(&'a GroupRecord, &'a Subject)> {
    let (group, subject) = name.split_once('/')?;
    let group = suite.groups.iter().find(|g| g.name == group)?;
    Some((group, group.subjects.iter().find(|s| s.name == subject)?))
}

fn block(suite: &Suite, group: &GroupRecord, subject: &Subject) -> String {
    let quick = if suite.machine.quick { " --quick" } else { "" };
    format!(
        "{}\nMedians and ranges by `twopass bench {}{quick} -o DIR`; {}.",
        table(subject),
        group.name,
        text::machine(suite)
    )
}
