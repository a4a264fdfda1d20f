//! Every sample of a suite, one a line.

use crate::report::record::Suite;
use crate::{Error, Result};
use serde::Serialize;

#[derive(Serialize)]
struct Line<'a> {
    group: &'a str,
    subject: &'a str,
    series: &'a str,
    /// What the series varies, and its value here.
    parameter: &'a str,
    at: f64,
    quantity: &'a str,
    unit: crate::report::record::Unit,
    /// The error here is smaller than the reference can tell.
    unresolved: bool,
    /// Which run, from 0.
    run: usize,
    sample: f64,
    /// What numbers do not tell: `column: text; column: text`.
    words: &'a str,
}

/// The suite as CSV, with a header.
pub fn to_csv(suite: &Suite) -> Result<Vec<u8>> {
    let failed = |message: String| Error::parse("bench.csv", None, message);
    let mut writer = csv::Writer::from_writer(Vec::new());
    for group in &suite.groups {
        for subject in &group.subjects {
            for series in &subject.series {
                let words: Vec<String> = series.words.iter().map(|(k, v)| format!("{k}: {v}")).collect();
                let words = words.join("; ");
                for point in &series.points {
                    for m in &point.measured {
                        for (run, &sample) in m.samples.iter().enumerate() {
                            let line = Line {
                                group: &group.name,
                                subject: &subject.name,
                                series: &series.name,
                                parameter: &series.parameter,
                                at: point.parameter,
                                quantity: &m.quantity,
                                unit: m.unit,
                                unresolved: point.unresolved,
                                run,
                                sample,
                                words: &words,
                            };
                            writer.serialize(line).map_err(|e| failed(e.to_string()))?;
                        }
                    }
                }
            }
        }
    }
    writer.into_inner().map_err(|e| failed(e.to_string()))
}
