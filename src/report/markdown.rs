//! Tables of a suite in Markdown, and their places in other files.

use super::text;
use crate::report::record::{GroupRecord, Point, Series, Subject, Suite};
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
            let _ = write!(
                out,
                "\n### {}\n\n{}\n\n{}",
                subject.title,
                subject.about,
                table(subject, &Choice::default())
            );
            for (k, chart) in subject.charts.iter().enumerate() {
                let file = super::plot::file(group, subject, k);
                let _ = write!(out, "\n![{}]({file})\n\n{}\n", chart.title, chart.about);
            }
            for (strip, whole) in subject.strips.iter().filter_map(|s| Some((s, s.whole.as_ref()?))) {
                let _ = write!(out, "\n![{}]({})\n\n{}\n", strip.title, whole.file, strip.about);
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

/// Columns of a subject's table after its series and parameter: words first, then quantities.
pub fn columns(subject: &Subject) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for (column, _) in subject.series.iter().flat_map(|s| &s.words) {
        if !names.contains(&column.as_str()) {
            names.push(column);
        }
    }
    names.extend(quantities(subject));
    names
}

/// What stands in a column at a point, as people read it.
pub fn cell(series: &Series, point: &Point, column: &str) -> String {
    match series.words.iter().find(|w| w.0 == column) {
        Some((_, text)) => text.clone(),
        None => point.get(column).map_or_else(|| "-".into(), text::measured),
    }
}

/// Whether any series has a parameter to show.
pub fn has_parameter(subject: &Subject) -> bool {
    subject.series.iter().any(|s| !s.parameter.is_empty())
}

/// Which part of a subject's table to write; all of it where nothing is chosen.
#[derive(Debug, Default, PartialEq)]
pub struct Choice<'a> {
    columns: Vec<&'a str>,
    series: Vec<&'a str>,
    at: Vec<f64>,
}

impl<'a> Choice<'a> {
    /// Reads `columns: first frame, relative RMSE; series: gather, path; at: 16, 256`, every part optional.
    fn parse(text: &'a str) -> std::result::Result<Choice<'a>, String> {
        let mut choice = Choice::default();
        for part in text.split(';').map(str::trim).filter(|p| !p.is_empty()) {
            let (key, values) = part.split_once(':').ok_or_else(|| format!("{part:?} has no colon"))?;
            let values = values.split(',').map(str::trim);
            match key.trim() {
                "columns" => choice.columns = values.collect(),
                "series" => choice.series = values.collect(),
                "at" => {
                    let number = |v: &str| v.parse().map_err(|_| format!("{v:?} is no number"));
                    choice.at = values.map(number).collect::<std::result::Result<_, _>>()?;
                }
                other => return Err(format!("{other:?} is not one of columns, series, at")),
            }
        }
        Ok(choice)
    }
}

/// One row a point: medians, and ranges in parentheses.
pub fn table(subject: &Subject, choice: &Choice) -> String {
    let mut names = columns(subject);
    if !choice.columns.is_empty() {
        names = choice.columns.clone();
    }
    let varied = has_parameter(subject);
    let shown = |s: &&Series| choice.series.is_empty() || choice.series.contains(&s.name.as_str());
    let (heads, lead) = if varied { ("| | ", 2) } else { ("| ", 1) };
    let mut out = format!("{heads}| {} |\n|{}\n", names.join(" | "), " --- |".repeat(names.len() + lead));
    for series in subject.series.iter().filter(shown) {
        for point in series.points.iter().filter(|p| choice.at.is_empty() || choice.at.contains(&p.parameter))
        {
            let _ = write!(out, "| {} |", series.name);
            if varied {
                let _ = write!(out, " {} |", parameter(point.parameter, &series.parameter));
            }
            for name in &names {
                let _ = write!(out, " {} |", cell(series, point, name).replace('|', "/"));
            }
            out.push('\n');
        }
    }
    out
}

/// A parameter's value with its name; the name alone where there is nothing to vary.
pub fn parameter(value: f64, name: &str) -> String {
    let number = text::value(value, crate::report::record::Unit::Count);
    if name.is_empty() { String::new() } else { format!("{name}: {number}") }
}

const END: &str = "<!-- /bench -->";

/// Replaces what stands between `<!-- bench GROUP/SUBJECT -->` and `<!-- /bench -->` with that subject's table,
/// everywhere in `old`. The mark may choose a part of it:
/// `<!-- bench images/cornell columns: first frame, relative RMSE; series: gather, path; at: 16, 256 -->`. Tables that the suite did not measure stay as they are; returns the names of those that
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
        let mark = old[begin + BEGIN.len()..inner - 3].trim();
        let (name, chosen) = mark.split_once(' ').unwrap_or((mark, ""));
        let choice = Choice::parse(chosen).map_err(|message| broken(&message))?;
        let Some(end) = old[inner..].find(END).map(|k| inner + k) else {
            return Err(broken(&format!("no {END} follows this mark")));
        };
        if old[inner..end].contains(BEGIN) {
            return Err(broken(&format!("no {END} before the next mark")));
        }
        new.push_str(&old[rest..inner]);
        match find(suite, name) {
            Some((group, subject)) => {
                let _ = write!(new, "\n{}\n", block(suite, group, subject, &choice));
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

fn block(suite: &Suite, group: &GroupRecord, subject: &Subject, choice: &Choice) -> String {
    let quick = if suite.machine.quick { " --quick" } else { "" };
    format!(
        "{}\nMedians and ranges by `twopass bench {}{quick} -o DIR`; {}.",
        table(subject, choice),
        group.name,
        text::machine(suite)
    )
}
