//! Names of the frames of `twopass render --frames`.

use crate::scene::CameraPath;
use crate::{Error, Result};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// A file name with a place for the frame's number.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    folder: PathBuf,
    before: String,
    /// Digits at least, filled up with zeros.
    digits: usize,
    after: String,
}

impl Pattern {
    /// Finds `%04d`, `%d` or a run of `#` in the last component of a path.
    pub fn new(path: &Path) -> Result<Pattern> {
        let refuse = |what: &str| {
            let help = "write %04d (or ####) where the frame's number goes, once, as in out.%04d.exr";
            Err(Error::Usage(format!("{}: {what}; {help}", path.display())))
        };
        let Some(name) = path.file_name().and_then(|n| n.to_str()) else {
            return refuse("is no file name in UTF-8");
        };
        let (printf, hashes) = (printf_places(name), hash_places(name));
        match [printf, hashes].concat()[..] {
            [] => refuse("has no place for the number of a frame"),
            [(start, end, digits)] => Ok(Pattern {
                folder: path.parent().unwrap_or(Path::new("")).into(),
                before: name[..start].into(),
                digits,
                after: name[end..].into(),
            }),
            _ => refuse("has several places for the number of a frame"),
        }
    }

    /// The file of a frame.
    pub fn file(&self, frame: u32) -> PathBuf {
        self.folder.join(format!("{}{frame:0digits$}{}", self.before, self.after, digits = self.digits))
    }
}

/// Refuses a single image with a name for frames.
pub fn refuse_pattern(path: &Path) -> Result<()> {
    let name = path.file_name().map(|n| n.to_string_lossy()).unwrap_or_default();
    if printf_places(&name).is_empty() {
        return Ok(());
    }
    let help = "has a place for the number of a frame: add --frames A..B, or choose another name";
    Err(Error::Usage(format!("{} {help}", path.display())))
}

/// Start, end and least digits of each `%d` or `%0Nd`.
fn printf_places(name: &str) -> Vec<(usize, usize, usize)> {
    let place = |(start, _): (usize, &str)| {
        let rest = &name[start + 1..];
        let width = &rest[..rest.find('d')?];
        let digits = match width {
            "" => 1,
            w => w.strip_prefix('0')?.parse().ok().filter(|n| (1..=9).contains(n))?,
        };
        Some((start, start + width.len() + 2, digits))
    };
    name.match_indices('%').filter_map(place).collect()
}

/// Start, end and length of each run of `#`.
fn hash_places(name: &str) -> Vec<(usize, usize, usize)> {
    let mut places: Vec<(usize, usize, usize)> = Vec::new();
    for (at, _) in name.match_indices('#') {
        match places.last_mut() {
            Some((_, end, digits)) if *end == at => (*end, *digits) = (at + 1, *digits + 1),
            _ => places.push((at, at + 1, 1)),
        }
    }
    places
}

/// Refuses frames that the path does not have.
pub fn check_range(path: &CameraPath, frames: &RangeInclusive<u32>) -> Result<()> {
    let (first, last) = path.frames().into_inner();
    if *frames.start() >= first && *frames.end() <= last {
        return Ok(());
    }
    Err(Error::Usage(format!(
        "--frames {}..{}: the keyframes of camera \"{}\" go from frame {first} to frame {last}",
        frames.start(),
        frames.end(),
        path.name()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_the_number() {
        let file = |p: &str, k| Pattern::new(Path::new(p)).map(|p| p.file(k).display().to_string()).ok();
        assert_eq!(file("a/out.%04d.exr", 7).as_deref(), Some("a/out.0007.exr"));
        assert_eq!(file("out%d.exr", 12345).as_deref(), Some("out12345.exr"));
        assert_eq!(file("frame_###.png", 7).as_deref(), Some("frame_007.png"));
        assert_eq!(file("é#.png", 77).as_deref(), Some("é77.png"));
        for bad in
            ["out.exr", "%04d/out.exr", "a#b#.exr", "a%d#.exr", "%4d.exr", "%0d.exr", "%99d.exr", "100%.exr"]
        {
            assert_eq!(file(bad, 1), None, "{bad}");
        }
        assert!(
            refuse_pattern(Path::new("a.%04d.exr")).is_err() && refuse_pattern(Path::new("a#1.exr")).is_ok()
        );
    }
}
