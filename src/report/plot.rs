//! Charts as SVG, on logarithmic axes.

use super::text;
use crate::report::record::{Chart, GroupRecord, PARAMETER, Series, Subject, Summary, Unit};
use crate::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

const WIDTH: u32 = 900;
const HEIGHT: u32 = 480;
const LEGEND: u32 = 270;

/// Colours that most colour-blind people can tell apart (Okabe and Ito 2008).
const COLOURS: [RGBColor; 10] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(166, 118, 0),
    RGBColor(60, 60, 60),
    RGBColor(120, 80, 200),
    RGBColor(200, 20, 60),
    RGBColor(150, 160, 0),
];

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The file of a subject's `k`-th chart, relative to the folder of the records.
pub fn file(group: &GroupRecord, subject: &Subject, k: usize) -> String {
    format!("plots/{}-{}-{}.svg", group.name, subject.name, k + 1)
}

/// A point of a chart with its ranges.
struct Dot {
    x: Summary,
    y: Summary,
    unresolved: bool,
}

fn dots(series: &Series, chart: &Chart) -> Vec<Dot> {
    if !chart.shows(series) {
        return Vec::new();
    }
    let dot = |p: &crate::report::record::Point| {
        let (x, y) = (p.summary(&chart.x)?, p.summary(&chart.y)?);
        (x.low > 0.0 && y.median > 0.0).then_some(Dot { x, y, unresolved: p.unresolved })
    };
    let mut dots: Vec<Dot> = series.points.iter().filter_map(dot).collect();
    dots.sort_by(|a, b| a.x.median.total_cmp(&b.x.median));
    dots
}

/// The unit of a quantity, by its first measurement.
fn unit_of(subject: &Subject, quantity: &str) -> Unit {
    let points = subject.series.iter().flat_map(|s| &s.points);
    points.filter_map(|p| p.get(quantity)).map(|m| m.unit).next().unwrap_or(Unit::Count)
}

/// What stands beside an axis.
fn axis(subject: &Subject, chart: &Chart, quantity: &str) -> String {
    if quantity != PARAMETER {
        return quantity.into();
    }
    let drawn = subject.series.iter().find(|s| !dots(s, chart).is_empty());
    drawn.map_or_else(String::new, |s| s.parameter.clone())
}

/// Draws a chart of a subject; an empty text where there is nothing to draw.
pub fn to_svg(subject: &Subject, chart: &Chart) -> Result<String> {
    let lines: Vec<(&Series, Vec<Dot>)> =
        subject.series.iter().map(|s| (s, dots(s, chart))).filter(|l| !l.1.is_empty()).collect();
    if lines.is_empty() {
        return Ok(String::new());
    }
    let mut svg = String::new();
    draw(subject, chart, &lines, &mut svg)
        .map_err(|e| Error::scene(format!("chart {:?}", chart.title), e.to_string()))?;
    // Scales with the page; the size stays as its proportions.
    Ok(svg.replacen(&format!("width=\"{WIDTH}\" height=\"{HEIGHT}\" "), "role=\"img\" ", 1))
}

/// Smallest and largest, with some air on a logarithmic axis.
fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) =
        values.filter(|v| *v > 0.0).fold((f64::INFINITY, 0.0), |(a, b): (f64, f64), v| (a.min(v), b.max(v)));
    let air = (high / low).powf(0.08).max(1.3);
    (low / air, high * air)
}

/// Round numbers within a range: powers of ten where there are three, else with their halves and fifths, else whatever
/// multiples of a power of ten give at least three.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let of = |steps: &[f64]| -> Vec<f64> {
        let all = decades.clone().flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d)));
        all.filter(|t| (low..=high).contains(t)).collect()
    };
    let fine: Vec<f64> = (10..100).map(|k| f64::from(k) / 10.0).collect();
    let tries =
        [of(&[1.0]), of(&[1.0, 3.0]), of(&[1.0, 2.0, 5.0]), of(&[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0])];
    let thinned = |t: Vec<f64>| {
        let step = t.len().div_ceil(9);
        t.into_iter().step_by(step).collect()
    };
    tries.into_iter().find(|t| t.len() >= 3).map(thinned).unwrap_or_else(|| {
        let all = of(&fine);
        let step = all.len().div_ceil(6).max(1);
        all.into_iter().step_by(step).collect()
    })
}

fn label(h: HPos, v: VPos) -> TextStyle<'static> {
    TextStyle {
        font: ("sans-serif", 13).into_font(),
        color: RGBColor(60, 60, 60).to_backend_color(),
        pos: Pos::new(h, v),
    }
}

fn draw(
    subject: &Subject,
    chart: &Chart,
    lines: &[(&Series, Vec<Dot>)],
    svg: &mut String,
) -> std::result::Result<(), DrawingAreaErrorKind<std::io::Error>> {
    let all = || lines.iter().flat_map(|l| &l.1);
    let (x0, x1) = bounds(all().flat_map(|d| [d.x.low, d.x.high]));
    let floor = chart.floor.as_ref().map(|f| f.1);
    let (y0, y1) = bounds(all().flat_map(|d| [d.y.low.max(0.3 * d.y.median), d.y.high]).chain(floor));
    let root = SVGBackend::with_string(svg, (WIDTH, HEIGHT)).into_drawing_area();
    let (left, right) = root.split_horizontally(WIDTH - LEGEND);
    let (ux, uy) = (unit_of(subject, &chart.x), unit_of(subject, &chart.y));
    let mut plot = ChartBuilder::on(&left)
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(86)
        .build_cartesian_2d((x0..x1).log_scale(), (y0..y1).log_scale())?;
    plot.configure_mesh()
        .disable_mesh()
        .x_label_formatter(&|_| String::new())
        .y_label_formatter(&|_| String::new())
        .x_desc(axis(subject, chart, &chart.x))
        .y_desc(axis(subject, chart, &chart.y))
        .axis_desc_style(("sans-serif", 15))
        .draw()?;
    // Own ticks: those of the logarithmic axis are whole powers of ten, of which a narrow range has none.
    for x in ticks(x0, x1) {
        plot.draw_series([PathElement::new([(x, y0), (x, y1)], BLACK.mix(0.12))])?;
        let (at, bottom) = (plot.backend_coord(&(x, y0)).0, plot.backend_coord(&(x, y0)).1);
        root.draw(&Text::new(text::tick(x, ux), (at, bottom + 6), label(HPos::Center, VPos::Top)))?;
    }
    for y in ticks(y0, y1) {
        plot.draw_series([PathElement::new([(x0, y), (x1, y)], BLACK.mix(0.12))])?;
        let (edge, at) = plot.backend_coord(&(x0, y));
        root.draw(&Text::new(text::tick(y, uy), (edge - 6, at), label(HPos::Right, VPos::Center)))?;
    }
    if let Some(level) = floor {
        let dashes = DashedLineSeries::new([(x0, level), (x1, level)], 8, 5, BLACK.mix(0.6).stroke_width(1));
        plot.draw_series(dashes)?;
    }
    for (_, slope) in &chart.guides {
        // Through the middle of the drawing, so far as it stays inside.
        let (mx, my) = ((x0 * x1).sqrt(), (y0 * y1).sqrt());
        let steps = (0..=200).map(|k| x0 * (x1 / x0).powf(f64::from(k) / 200.0));
        let inside: Vec<(f64, f64)> =
            steps.map(|x| (x, my * (x / mx).powf(*slope))).filter(|p| p.1 > y0 && p.1 < y1).collect();
        if let (Some(&a), Some(&b)) = (inside.first(), inside.last()) {
            plot.draw_series(DashedLineSeries::new([a, b], 2, 4, BLACK.mix(0.5).stroke_width(1)))?;
            // At the line's right end, on its outer side.
            let vertical = if *slope < 0.0 { VPos::Bottom } else { VPos::Top };
            plot.draw_series([Text::new(format!("{slope}"), b, label(HPos::Right, vertical))])?;
        }
    }
    for (k, (_, dots)) in lines.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        plot.draw_series(LineSeries::new(
            dots.iter().map(|d| (d.x.median, d.y.median)),
            colour.stroke_width(2),
        ))?;
        for d in dots {
            let low = d.y.low.max(y0);
            for ends in
                [[(d.x.median, low), (d.x.median, d.y.high)], [(d.x.low, d.y.median), (d.x.high, d.y.median)]]
            {
                plot.draw_series(std::iter::once(PathElement::new(ends, colour.mix(0.5).stroke_width(1))))?;
            }
            let style = if d.unresolved { WHITE.filled() } else { colour.filled() };
            let at = (d.x.median, d.y.median);
            plot.draw_series([Circle::new(at, 4, style), Circle::new(at, 4, colour.stroke_width(2))])?;
        }
    }
    legend(&right, chart, lines)?;
    root.present()
}

/// Names of the series with their exponents, and what the other lines are.
fn legend(
    area: &Area,
    chart: &Chart,
    lines: &[(&Series, Vec<Dot>)],
) -> std::result::Result<(), DrawingAreaErrorKind<std::io::Error>> {
    let style = |colour: RGBColor, size: i32| TextStyle {
        font: ("sans-serif", size).into_font(),
        color: colour.to_backend_color(),
        pos: Pos::new(HPos::Left, VPos::Center),
    };
    let mut y = 24;
    for (k, (series, _)) in lines.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        area.draw(&PathElement::new([(4, y), (24, y)], colour.stroke_width(2)))?;
        area.draw(&Circle::new((14, y), 4, colour.filled()))?;
        area.draw(&Text::new(series.name.clone(), (32, y), style(BLACK, 13)))?;
        y += 18;
        if let Some(e) = chart.exponents.iter().find(|e| e.series == series.name) {
            let fit = format!("slope {:+.2} ± {:.2}", e.value, e.standard_error);
            area.draw(&Text::new(fit, (32, y), style(RGBColor(90, 90, 90), 12)))?;
            y += 18;
        }
    }
    let grey = RGBColor(90, 90, 90);
    y += 8;
    for (label, _) in &chart.guides {
        for k in 0..5 {
            area.draw(&PathElement::new([(4 + 5 * k, y), (6 + 5 * k, y)], grey.stroke_width(1)))?;
        }
        area.draw(&Text::new(label.clone(), (32, y), style(grey, 12)))?;
        y += 18;
    }
    if let Some((label, _)) = &chart.floor {
        for k in 0..2 {
            area.draw(&PathElement::new([(4 + 12 * k, y), (12 + 12 * k, y)], grey.stroke_width(1)))?;
        }
        area.draw(&Text::new(label.clone(), (32, y), style(grey, 12)))?;
        y += 18;
    }
    if lines.iter().flat_map(|l| &l.1).any(|d| d.unresolved) {
        area.draw(&Circle::new((14, y), 4, grey.stroke_width(2)))?;
        area.draw(&Text::new("hollow: below the reference's noise", (32, y), style(grey, 12)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::ticks;

    #[test]
    fn ticks_are_round_and_enough() {
        assert_eq!(ticks(0.5, 2e3), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!(ticks(0.8, 12.0), [1.0, 3.0, 10.0]);
        assert_eq!(ticks(1.9, 9.0), [2.0, 3.0, 4.0, 5.0, 6.0, 8.0]);
        for (low, high) in [(4.1, 4.4), (0.0311, 0.047), (97.0, 123.0), (1e-9, 1e3)] {
            let t = ticks(low, high);
            assert!((3..14).contains(&t.len()), "{low} {high}: {t:?}");
            assert!(t.windows(2).all(|w| w[0] < w[1]) && t[0] >= low && t[t.len() - 1] <= high);
        }
    }
}
