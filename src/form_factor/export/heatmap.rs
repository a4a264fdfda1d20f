//! The matrix as a picture.

use super::Factors;
use crate::image::Image;
use crate::image::canvas::{BLACK, Canvas, LETTER, Srgb, WHITE, shortened, width};

/// Sides of the matrix in the picture, about: few nodes are drawn large, many are put together.
const LONGEST: usize = 1000;
/// Smallest cell that has room for its name.
const NAMED: usize = LETTER[1] + 1;
/// Longest name in letters.
const LETTERS: usize = 24;
/// Decades of the colour scale, at most.
const DECADES: f64 = 6.0;
/// Where no factor is above zero.
const NOTHING: Srgb = [225; 3];

/// The matrix as a heat map, rows from the top, colour by the logarithm of the factor, with a scale. Where nodes are more than
/// pixels, a pixel shows the mean of the factors that it covers, so dark lines of single factors stay visible.
/// Rows and columns are named where there is room, and numbered otherwise.
pub fn heat_map(factors: &Factors) -> Image {
    let (n, m) = (factors.nodes(), factors.rows.len());
    let cell = (LONGEST / n.max(1)).clamp(1, 64);
    let cell = if n * NAMED <= 2 * LONGEST { cell.max(NAMED) } else { cell };
    let group = n.div_ceil(LONGEST).max(1);
    let (across, down) = (n.div_ceil(group), m.div_ceil(group));
    let values = grouped(factors, group, across, down);
    let largest = values.iter().copied().fold(0.0, f64::max);
    let smallest = values.iter().copied().filter(|v| *v > 0.0).fold(largest, f64::min);
    let low = smallest.max(largest * 10f64.powf(-DECADES));
    let scale = Scale { low: if low < largest { low } else { 0.1 * largest }, high: largest };

    let named = cell >= NAMED && factors.by_object;
    let label = |node: usize| {
        let name = &factors.names[factors.object[node] as usize];
        if named { shortened(name, LETTERS) } else { node.to_string() }
    };
    let margin = (0..n).map(|k| width(&label(k))).max().unwrap_or(0) + 12;
    let (left, top) = (margin + LETTER[1] + 6, margin + 2 * LETTER[1] + 10);
    // Few rows of many columns are drawn taller than they are wide.
    let tall = cell.max((120 / down.max(1)).min(64));
    let (wide, high) = (across * cell, down * tall);
    let right = left + wide + 24;
    let mut canvas = Canvas::new((right + 120).max(left + 420), (top + high + 12).max(top + 200), WHITE);

    canvas.text(&title(factors, group), [6, 4], BLACK);
    canvas.text("to", [left + wide / 2, LETTER[1] + 8], BLACK);
    canvas.text_upwards("from", [4, top + high / 2 + 2 * LETTER[0]], BLACK);
    for row in 0..down {
        for column in 0..across {
            let color = scale.color(values[row * across + column]);
            canvas.fill([left + column * cell, top + row * tall], [cell, tall], color);
        }
    }
    // Every so many that labels do not touch.
    let step = if named { 1 } else { nice_step(n, 80 * group / cell) };
    let middle = |k: usize, size: usize| k / group * size + if size >= NAMED { size / 2 } else { 0 };
    for node in (0..n).step_by(step) {
        let (text, x) = (label(node), left + middle(node, cell));
        canvas.fill([x, top - 5], [1, 4], BLACK);
        canvas.text_upwards(&text, [x.saturating_sub(LETTER[1] / 2), top - 8], BLACK);
    }
    for node in factors.rows.clone().filter(|node| node % step == 0 || m == 1) {
        let (text, y) = (label(node), top + middle(node - factors.rows.start, tall));
        canvas.fill([left - 5, y], [4, 1], BLACK);
        canvas.text(&text, [left - 8 - width(&text).min(left - 8), y.saturating_sub(LETTER[1] / 2)], BLACK);
    }
    legend(&mut canvas, &scale, [right, top], high.clamp(150, 400));
    canvas.into_image()
}

fn title(factors: &Factors, group: usize) -> String {
    let what = if factors.by_object { "objects" } else { "elements" };
    let mean = if group > 1 { format!(", mean of {group} x {group}") } else { String::new() };
    format!("form factors between {} {what} ({}){mean}", factors.nodes(), factors.written)
}

/// Means over squares of `group * group` factors.
fn grouped(factors: &Factors, group: usize, across: usize, down: usize) -> Vec<f64> {
    let mut values = vec![0.0; across * down];
    for row in 0..factors.rows.len() {
        let (columns, row_values, _) = factors.row(row);
        for (j, value) in columns.iter().zip(row_values) {
            values[row / group * across + *j as usize / group] += value;
        }
    }
    let covered = |k: usize, count: usize| group.min(count - k * group) as f64;
    for (k, value) in values.iter_mut().enumerate() {
        *value /= covered(k / across, factors.rows.len()) * covered(k % across, factors.nodes());
    }
    values
}

/// 1, 2 or 5 times a power of ten, at least `least`.
fn nice_step(n: usize, least: usize) -> usize {
    let mut power = 1;
    while power < n.max(1) {
        for step in [power, 2 * power, 5 * power] {
            if step >= least {
                return step;
            }
        }
        power *= 10;
    }
    n.max(1)
}

struct Scale {
    low: f64,
    high: f64,
}

impl Scale {
    fn color(&self, value: f64) -> Srgb {
        if value <= 0.0 {
            return NOTHING;
        }
        let t = ((value / self.low).ln() / (self.high / self.low).ln()).clamp(0.0, 1.0);
        let c = colorous::VIRIDIS.eval_continuous(t);
        [c.r, c.g, c.b]
    }
}

fn legend(canvas: &mut Canvas, scale: &Scale, [x, y]: [usize; 2], height: usize) {
    canvas.text("form factor", [x, y.saturating_sub(LETTER[1] + 6)], BLACK);
    if scale.high <= 0.0 {
        canvas.text("all are zero", [x, y], BLACK);
        return;
    }
    let span = (scale.high / scale.low).ln();
    let at =
        |value: f64| y + ((1.0 - (value / scale.low).ln() / span) * (height - 1) as f64).round() as usize;
    for k in 0..height {
        let t = 1.0 - k as f64 / (height - 1) as f64;
        canvas.fill([x, y + k], [20, 1], scale.color(scale.low * (t * span).exp()));
    }
    let mut taken: Vec<usize> = Vec::new();
    let mut mark = |canvas: &mut Canvas, value: f64, text: String| {
        let row = at(value);
        if taken.iter().all(|t| t.abs_diff(row) > LETTER[1]) {
            taken.push(row);
            canvas.fill([x + 20, row], [5, 1], BLACK);
            canvas.text(&text, [x + 28, row.saturating_sub(LETTER[1] / 2)], BLACK);
        }
    };
    mark(canvas, scale.high, format!("{:.2e}", scale.high));
    mark(canvas, scale.low, format!("{:.2e}", scale.low));
    let mut decade = scale.low.log10().ceil() as i32;
    while 10f64.powi(decade) <= scale.high {
        mark(canvas, 10f64.powi(decade), format!("1e{decade}"));
        decade += 1;
    }
    canvas.fill([x, y + height + 10], [20, LETTER[1]], NOTHING);
    canvas.text("zero", [x + 28, y + height + 10], BLACK);
}
