//! A suite as one HTML file that needs no other: plots as SVG and pictures as data inside it, no script.

use super::{markdown, plot, text};
use crate::Result;
use crate::report::record::{GroupRecord, Strip, Subject, Suite};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::fmt::Write;

const STYLE: &str = include_str!("report.css");

/// Text with what HTML would read as its own taken out.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The report.
pub fn to_html(suite: &Suite) -> Result<String> {
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>twopass benchmarks</title>\n<link rel=\"icon\" href=\"data:,\">\n<style>\n{STYLE}</style>\n</head>\n<body>\n"
    );
    front_page(&mut out, suite);
    for group in &suite.groups {
        group_section(&mut out, group)?;
    }
    out.push_str("</body>\n</html>\n");
    Ok(out)
}

fn front_page(out: &mut String, suite: &Suite) {
    let m = &suite.machine;
    let _ = write!(
        out,
        "<header>\n<h1>twopass: speed beside error</h1>\n<p class=\"lead\">Every number here was measured by the command below. \
         A value is the median of repeated runs; parentheses give their smallest and largest. Every sample is in \
         <code>bench.csv</code> and <code>bench.json</code> beside this file.</p>\n<pre>{}</pre>\n<table class=\"machine\">\n",
        escape(&text::command(suite))
    );
    let mut row = |name: &str, value: &str| {
        let _ = writeln!(out, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(value));
    };
    row("Processor", &format!("{}, {} of {} threads used", m.cpu, m.threads, m.cores));
    for (name, version) in &m.versions {
        row(name, version);
    }
    row("Seed", &m.seed.to_string());
    row("Date", &m.date);
    if m.quick {
        row("Quick", "yes: smaller scenes and fewer runs than the full suite; do not quote these numbers");
    }
    out.push_str(
        "</table>\n</header>\n<section>\n<h2>The figures that matter</h2>\n<div class=\"figures\">\n",
    );
    for group in &suite.groups {
        for figure in &group.figures {
            let all = text::samples(&figure.samples, figure.unit);
            let (median, range) = all.split_once(" (").unwrap_or((&all, ""));
            let _ = writeln!(
                out,
                "<a class=\"figure\" href=\"#{}\"><b>{}</b><i>{}</i><span>{}</span></a>",
                escape(&group.name),
                escape(median),
                escape(range.trim_end_matches(')')),
                escape(&figure.label)
            );
        }
    }
    out.push_str("</div>\n<h2>Contents</h2>\n<ul>\n");
    for group in &suite.groups {
        let _ = write!(
            out,
            "<li><a href=\"#{0}\">{1}</a> ({2:.0} s)",
            escape(&group.name),
            escape(&group.title),
            group.seconds
        );
        let subjects: Vec<String> = group
            .subjects
            .iter()
            .map(|s| {
                format!("<a href=\"#{}-{}\">{}</a>", escape(&group.name), escape(&s.name), escape(&s.title))
            })
            .collect();
        let _ = writeln!(out, ": {}</li>", subjects.join(", "));
    }
    out.push_str("</ul>\n<h2>How to read the plots</h2>\n<p>Both axes are logarithmic: a straight line is a power law, and its slope \
        is printed beside its name, with the standard error of the fit. Thin lines through a point are the range of its runs. In plots of error \
        over time, further down and further left is better. A hollow point is an error that the reference cannot tell from its own noise: \
        the true error may be smaller.</p>\n</section>\n");
}

fn group_section(out: &mut String, group: &GroupRecord) -> Result<()> {
    let _ = writeln!(
        out,
        "<section id=\"{}\">\n<h2>{}</h2>\n<p class=\"lead\">{}</p>",
        escape(&group.name),
        escape(&group.title),
        escape(&group.about)
    );
    for subject in &group.subjects {
        let _ = writeln!(
            out,
            "<article id=\"{}-{}\">\n<h3>{}</h3>\n<p>{}</p>",
            escape(&group.name),
            escape(&subject.name),
            escape(&subject.title),
            escape(&subject.about)
        );
        for chart in &subject.charts {
            let svg = plot::to_svg(subject, chart)?;
            if !svg.is_empty() {
                let _ = writeln!(
                    out,
                    "<figure class=\"plot\"><h4>{}</h4>{svg}<figcaption>{}</figcaption></figure>",
                    escape(&chart.title),
                    escape(&chart.about)
                );
            }
        }
        for strip in &subject.strips {
            strip_of(out, strip);
        }
        for note in &subject.notes {
            let _ = writeln!(out, "<p class=\"note\">{}</p>", escape(note));
        }
        table(out, subject);
        out.push_str("</article>\n");
    }
    out.push_str("</section>\n");
    Ok(())
}

fn strip_of(out: &mut String, strip: &Strip) {
    let _ = writeln!(out, "<h4>{}</h4>\n<p>{}</p>", escape(&strip.title), escape(&strip.about));
    out.push_str("<div class=\"strip\">\n");
    for picture in &strip.pictures {
        let _ = writeln!(
            out,
            "<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>",
            escape(&picture.caption),
            STANDARD.encode(&picture.png)
        );
    }
    out.push_str("</div>\n");
    if let Some(scale) = strip.scale {
        let percent = 100.0 * scale;
        let _ = writeln!(
            out,
            "<div class=\"scale\"><span>-{percent:.1} % of the mean (too dark)</span>\
             <span class=\"bar\" style=\"background:linear-gradient(to right,{})\"></span>\
             <span>+{percent:.1} % (too bright)</span></div>",
            gradient()
        );
    }
}

/// The false colours as stops of a gradient.
fn gradient() -> String {
    let stop = |k: i32| {
        let [r, g, b] = crate::image::signed_colour(f64::from(k) / 8.0);
        format!("rgb({r},{g},{b})")
    };
    (-8..=8).map(stop).collect::<Vec<_>>().join(",")
}

fn table(out: &mut String, subject: &Subject) {
    let names = markdown::columns(subject);
    if names.is_empty() {
        return;
    }
    let rows: usize = subject.series.iter().map(|s| s.points.len()).sum();
    let varied = markdown::has_parameter(subject);
    // Where nothing is drawn, the table is what there is to see.
    let open = if subject.charts.is_empty() { " open" } else { "" };
    let _ = write!(
        out,
        "<details{open}><summary>Table of {rows} rows</summary>\n<div class=\"wide\"><table>\n<tr><th></th>{}",
        if varied { "<th></th>" } else { "" }
    );
    for name in &names {
        let _ = write!(out, "<th>{}</th>", escape(name));
    }
    out.push_str("</tr>\n");
    for series in &subject.series {
        for point in &series.points {
            let _ = write!(out, "<tr><td>{}</td>", escape(&series.name));
            if varied {
                let at = markdown::parameter(point.parameter, &series.parameter);
                let _ = write!(out, "<td>{}</td>", escape(&at));
            }
            for name in &names {
                let every = point.get(name).map(|m| format!("{:?}", m.samples)).unwrap_or_default();
                let cell = markdown::cell(series, point, name);
                let _ = write!(out, "<td title=\"{}\">{}</td>", escape(&every), escape(&cell));
            }
            out.push_str("</tr>\n");
        }
    }
    out.push_str("</table></div></details>\n");
}
