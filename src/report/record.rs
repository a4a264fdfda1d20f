//! What a benchmark leaves behind: plain data, every sample kept. The modules beside this one make files of it.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// The unit of a quantity; decides how it is written, never what is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Unit {
    /// Wall time \[s\].
    Seconds,
    /// A share of a whole, written in per cent.
    Share,
    /// Rays per second \[s^-1\].
    RaysPerSecond,
    /// Bytes.
    Bytes,
    /// Things counted.
    Count,
    /// A number without a unit: a ratio, an exponent.
    Plain,
}

/// One quantity at one point, with a sample of every run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Its name: `first frame`, `relative RMSE`.
    pub quantity: String,
    /// Its unit.
    pub unit: Unit,
    /// One value a run, in the order measured.
    pub samples: Vec<f64>,
}

/// Median and range of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// The middle one; the mean of the middle two of an even number.
    pub median: f64,
    /// The smallest.
    pub low: f64,
    /// The largest.
    pub high: f64,
}

impl Summary {
    /// Of at least one sample.
    pub fn of(samples: &[f64]) -> Option<Summary> {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (low, high) = (*sorted.first()?, *sorted.last()?);
        let half = sorted.len() / 2;
        let median =
            if sorted.len() % 2 == 1 { sorted[half] } else { 0.5 * (sorted[half - 1] + sorted[half]) };
        Some(Summary { median, low, high })
    }
}

/// One setting of what a series varies, and all that was measured there.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The value of the series' parameter.
    pub parameter: f64,
    /// The error is smaller than the reference can tell: drawn hollow, no figure to quote.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unresolved: bool,
    /// What was measured.
    pub measured: Vec<Measured>,
}

impl Point {
    /// A point without measurements.
    pub fn at(parameter: f64) -> Point {
        Point { parameter, ..Point::default() }
    }

    /// Adds a sample to a quantity, which is new or known.
    pub fn push(&mut self, quantity: &str, unit: Unit, sample: f64) {
        match self.measured.iter_mut().find(|m| m.quantity == quantity) {
            Some(known) => known.samples.push(sample),
            None => self.measured.push(Measured { quantity: quantity.into(), unit, samples: vec![sample] }),
        }
    }

    /// A quantity by name.
    pub fn get(&self, quantity: &str) -> Option<&Measured> {
        self.measured.iter().find(|m| m.quantity == quantity)
    }

    /// Median and range of a quantity; [`PARAMETER`] is what the series varies.
    pub fn summary(&self, quantity: &str) -> Option<Summary> {
        if quantity == PARAMETER {
            let p = self.parameter;
            return Some(Summary { median: p, low: p, high: p });
        }
        Summary::of(&self.get(quantity)?.samples)
    }
}

/// The name by which a chart asks for what its series vary.
pub const PARAMETER: &str = "parameter";

/// One method or case over its parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Its name in legends and tables.
    pub name: String,
    /// What its points vary: `samples a pixel`.
    pub parameter: String,
    /// Points in increasing order of the parameter.
    pub points: Vec<Point>,
    /// What numbers do not tell: name and text of columns of their own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub words: Vec<(String, String)>,
}

impl Series {
    /// A series without points.
    pub fn new(name: impl Into<String>, parameter: &str) -> Series {
        Series { name: name.into(), parameter: parameter.into(), points: Vec::new(), words: Vec::new() }
    }

    /// The point at a parameter, made where it does not exist.
    pub fn at(&mut self, parameter: f64) -> &mut Point {
        let k = self.points.iter().position(|p| p.parameter == parameter).unwrap_or_else(|| {
            self.points.push(Point::at(parameter));
            self.points.len() - 1
        });
        &mut self.points[k]
    }

    /// The value of `wanted` where `error` comes down to `level` as `cost` grows: between the points interpolated on logarithmic
    /// axes, over those alone that are better than all cheaper ones. Medians of resolved points; none where the series does not
    /// get there. With it, whether the cheapest point is good enough already.
    pub fn where_reached(
        &self,
        cost: &str,
        (error, level): (&str, f64),
        wanted: &str,
    ) -> Option<(f64, bool)> {
        let mut points: Vec<[f64; 3]> = self
            .points
            .iter()
            .filter(|p| !p.unresolved)
            .filter_map(|p| {
                let median = |q: &str| p.summary(q).map(|s| s.median);
                Some([median(cost)?, median(error)?, median(wanted)?])
            })
            .collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut best = f64::INFINITY;
        points.retain(|p| {
            let better = p[1] < best;
            best = best.min(p[1]);
            better
        });
        let k = points.iter().position(|p| p[1] <= level)?;
        let (b, a) = (points[k], points[k.saturating_sub(1)]);
        if k == 0 || b[1] <= 0.0 || a[2] <= 0.0 || b[2] <= 0.0 {
            return Some((b[2], k == 0));
        }
        let t = (a[1] / level).ln() / (a[1] / b[1]).ln();
        Some((a[2] * (b[2] / a[2]).powf(t), false))
    }

    /// The exponent `k` of `y ~ x^k` by least squares on logarithms of medians, over the points that are
    /// resolved and positive; none with less than three.
    pub fn exponent(&self, x: &str, y: &str) -> Option<Exponent> {
        let logs: Vec<(f64, f64)> = self
            .points
            .iter()
            .filter(|p| !p.unresolved)
            .filter_map(|p| Some((p.summary(x)?.median, p.summary(y)?.median)))
            .filter(|(x, y)| *x > 0.0 && *y > 0.0)
            .map(|(x, y)| (x.ln(), y.ln()))
            .collect();
        let n = logs.len() as f64;
        let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
        let sxx: f64 = logs.iter().map(|p| (p.0 - mx).powi(2)).sum();
        if logs.len() < 3 || sxx <= 0.0 {
            return None;
        }
        let value = logs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / sxx;
        let left: f64 = logs.iter().map(|p| (p.1 - my - value * (p.0 - mx)).powi(2)).sum();
        Some(Exponent {
            series: self.name.clone(),
            value,
            standard_error: (left / (n - 2.0) / sxx).sqrt(),
            points: logs.len(),
        })
    }
}

/// A fitted exponent of a series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Exponent {
    /// The series.
    pub series: String,
    /// `k` of `y ~ x^k`.
    pub value: f64,
    /// Standard error of the fit.
    pub standard_error: f64,
    /// Points it was fitted to.
    pub points: usize,
}

/// How a subject's series are drawn: `y` over `x`, both by name and both logarithmic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// What the chart shows and how to read it, for someone who has not read the code.
    pub about: String,
    /// Quantity along x, or [`PARAMETER`].
    pub x: String,
    /// Quantity along y.
    pub y: String,
    /// The series that are drawn, by name; all where none is named.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub series: Vec<String>,
    /// Label and value of a dashed horizontal line: the noise of a reference.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floor: Option<(String, f64)>,
    /// Label and exponent of dotted guides: what theory lets expect.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub guides: Vec<(String, f64)>,
    /// Fitted exponents, by series.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exponents: Vec<Exponent>,
}

impl Chart {
    /// A chart of `y` over `x`.
    pub fn new(title: &str, x: &str, y: &str, about: &str) -> Chart {
        Chart {
            title: title.into(),
            about: about.into(),
            x: x.into(),
            y: y.into(),
            series: Vec::new(),
            floor: None,
            guides: Vec::new(),
            exponents: Vec::new(),
        }
    }

    /// Draws only these series.
    pub fn only(mut self, names: &[&str]) -> Chart {
        self.series = names.iter().map(|n| n.to_string()).collect();
        self
    }

    /// Whether a series is drawn.
    pub fn shows(&self, series: &Series) -> bool {
        self.series.is_empty() || self.series.contains(&series.name)
    }

    /// Fits the exponent of every series that is drawn and has enough points.
    pub fn fitted(mut self, series: &[Series]) -> Chart {
        let drawn = series.iter().filter(|s| self.shows(s));
        self.exponents = drawn.filter_map(|s| s.exponent(&self.x, &self.y)).collect();
        self
    }

    /// Adds a guide of the given slope.
    pub fn guide(mut self, label: &str, slope: f64) -> Chart {
        self.guides.push((label.into(), slope));
        self
    }
}

/// A picture of a strip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Text below it.
    pub caption: String,
    /// Its file, relative to the folder of the records.
    pub file: String,
    /// The file's bytes (PNG).
    #[serde(skip)]
    pub png: Vec<u8>,
}

/// Pictures side by side.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Strip {
    /// Heading.
    pub title: String,
    /// What to look for.
    pub about: String,
    /// Largest magnitude of the false colours, where the strip shows errors [share of the reference's mean].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// The pictures.
    pub pictures: Vec<Picture>,
    /// All of them with their captions as one picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub whole: Option<Picture>,
}

/// One scene or case of a group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    /// Short name, unique in its group: `cornell`.
    pub name: String,
    /// Heading.
    pub title: String,
    /// What is measured here, for someone who has not read the code.
    pub about: String,
    /// What was measured.
    pub series: Vec<Series>,
    /// How it is drawn.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub charts: Vec<Chart>,
    /// What it looks like.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub strips: Vec<Strip>,
    /// What was found or left out, in sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

impl Subject {
    /// A subject without measurements.
    pub fn new(name: &str, title: impl Into<String>, about: impl Into<String>) -> Subject {
        Subject {
            name: name.into(),
            title: title.into(),
            about: about.into(),
            series: Vec::new(),
            charts: Vec::new(),
            strips: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The series of that name, made where it does not exist.
    pub fn series(&mut self, name: &str, parameter: &str) -> &mut Series {
        let k = self.series.iter().position(|s| s.name == name).unwrap_or_else(|| {
            self.series.push(Series::new(name, parameter));
            self.series.len() - 1
        });
        &mut self.series[k]
    }
}

/// A figure for the front page.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// What it is, as a sentence without its value.
    pub label: String,
    /// Its unit.
    pub unit: Unit,
    /// One value a run.
    pub samples: Vec<f64>,
}

/// All that one group measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroupRecord {
    /// The group's name on the command line.
    pub name: String,
    /// Heading.
    pub title: String,
    /// What the group measures.
    pub about: String,
    /// Wall time of the whole group \[s\].
    pub seconds: f64,
    /// The few figures that matter.
    pub figures: Vec<Figure>,
    /// Scene by scene, case by case.
    pub subjects: Vec<Subject>,
}

/// Where, when and how a suite ran.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// The command line.
    pub command: Vec<String>,
    /// Versions of this program, Embree, OpenImageIO and the compiler, by name.
    pub versions: Vec<(String, String)>,
    /// The processor's name.
    pub cpu: String,
    /// Processors that the system offers.
    pub cores: usize,
    /// Threads used where not said otherwise.
    pub threads: usize,
    /// First seed; runs after the first of a point use the next ones.
    pub seed: u32,
    /// Fewer and smaller measurements.
    pub quick: bool,
    /// When it began (UTC, RFC 3339).
    pub date: String,
}

/// A whole run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Suite {
    /// Where, when and how.
    pub machine: Machine,
    /// The groups in the order they ran.
    pub groups: Vec<GroupRecord>,
}

impl Suite {
    /// Refuses samples that are not finite: JSON has no word for them, and no median means anything with them.
    pub fn check(&self) -> Result<()> {
        for group in &self.groups {
            for subject in &group.subjects {
                for series in &subject.series {
                    for m in series.points.iter().flat_map(|p| &p.measured) {
                        if m.samples.is_empty() || !m.samples.iter().all(|s| s.is_finite()) {
                            let what = format!("{}/{}/{}", group.name, subject.name, series.name);
                            let message = format!("{}: samples {:?}", m.quantity, m.samples);
                            return Err(Error::scene(what, message));
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_ranges() {
        assert_eq!(Summary::of(&[3.0, 1.0, 2.0]), Some(Summary { median: 2.0, low: 1.0, high: 3.0 }));
        assert_eq!(Summary::of(&[4.0, 1.0]).map(|s| s.median), Some(2.5));
        assert_eq!(Summary::of(&[]), None);
    }

    /// `y = 3 x^-1/2` exactly; an unresolved point does not count.
    #[test]
    fn exponents() {
        let mut s = Series::new("s", "rays");
        for x in [1.0f64, 4.0, 16.0] {
            s.at(x).push("error", Unit::Share, 3.0 / x.sqrt());
        }
        s.at(64.0).push("error", Unit::Share, 1.0);
        assert!(s.exponent(PARAMETER, "error").is_some_and(|e| (e.value + 0.5).abs() > 0.1));
        s.at(64.0).unresolved = true;
        let e = s.exponent(PARAMETER, "error").expect("three points");
        assert!((e.value + 0.5).abs() < 1e-12 && e.standard_error < 1e-6 && e.points == 3);
        s.points.truncate(2);
        assert!(s.exponent(PARAMETER, "error").is_none());
    }
}
