//! The files of a suite: `bench.json` and `bench.csv` with every sample, `report.md`, `report.html`, plots and pictures.

use super::{csv, html, markdown, plot};
use crate::output::write_whole;
use crate::report::record::{Picture, Suite};
use crate::{Error, Result};
use std::fs;
use std::path::Path;

const RECORDS: &str = "bench.json";

/// Makes the folders that [`write()`] needs, for a command to refuse before anything is measured.
pub fn prepare(folder: &Path) -> Result<()> {
    for part in ["plots", "pictures"] {
        let path = folder.join(part);
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        crate::output::check(&path.join("probe"))?;
    }
    crate::output::check(&folder.join(RECORDS))
}

/// Writes all files of a suite into a folder.
pub fn write(suite: &Suite, folder: &Path) -> Result<()> {
    prepare(folder)?;
    let json = serde_json::to_string_pretty(suite)
        .map_err(|e| Error::parse(folder.join(RECORDS), None, e.to_string()))?;
    write_whole(&folder.join(RECORDS), format!("{json}\n").as_bytes())?;
    write_whole(&folder.join("bench.csv"), &csv::to_csv(suite)?)?;
    for group in &suite.groups {
        for subject in &group.subjects {
            for (k, chart) in subject.charts.iter().enumerate() {
                let svg = plot::to_svg(subject, chart)?;
                write_whole(&folder.join(plot::file(group, subject, k)), svg.as_bytes())?;
            }
            for picture in subject.strips.iter().flat_map(|s| s.pictures.iter().chain(&s.whole)) {
                write_whole(&folder.join(&picture.file), &picture.png)?;
            }
        }
    }
    write_whole(&folder.join("report.md"), markdown::to_markdown(suite).as_bytes())?;
    write_whole(&folder.join("report.html"), html::to_html(suite)?.as_bytes())
}

/// Reads the records of an earlier run back, pictures included.
pub fn read(folder: &Path) -> Result<Suite> {
    let path = folder.join(RECORDS);
    let text = fs::read_to_string(&path).map_err(|e| Error::io(&path, e))?;
    let mut suite: Suite =
        serde_json::from_str(&text).map_err(|e| Error::parse(&path, Some(e.line()), e.to_string()))?;
    let subjects = suite.groups.iter_mut().flat_map(|g| &mut g.subjects);
    let strips = subjects.flat_map(|s| &mut s.strips);
    for picture in strips.flat_map(|s| s.pictures.iter_mut().chain(&mut s.whole)) {
        load(picture, folder)?;
    }
    Ok(suite)
}

fn load(picture: &mut Picture, folder: &Path) -> Result<()> {
    let path = folder.join(&picture.file);
    picture.png = fs::read(&path).map_err(|e| Error::io(&path, e))?;
    Ok(())
}
