//! How much memory pass 1 needs, before it takes any, and how much there is.

use crate::form_factor::Tiles;
use crate::mesh::Mesh;
use crate::{Error, Result};

/// Bytes of a mesh, a solution and the solver's vectors, an element. Measured: 1,500 to 1,900 with 4 randomisations.
const ELEMENT: f64 = 1700.0;
/// Of it for each randomisation beyond 4.
const RANDOMISATION: f64 = 270.0;
/// Of the solver's vectors where tiles serve several replicas together, beside the entries of the tiles themselves.
const TILED: f64 = 250.0;
/// Entries for each ray where chains count every surface that they touch.
const CHAIN: f64 = 2.0;
/// Bytes of a cell of the caustic map while it is made. Measured: 204.
const CELL: f64 = 210.0;
/// Bytes for each ray of an element, of a thread that casts 16 elements together: where they landed, and their points.
const RAY: f64 = 16.0 * 4.0 + 16.0;
/// Share of what is free that is taken where nobody says otherwise.
const SHARE: f64 = 0.75;

/// Memory that pass 1 needs \[bytes\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Need {
    /// Elements, solution and solver, the caustic map, and what threads hold while they cast.
    pub elements: f64,
    /// The matrix, at most.
    pub matrix: f64,
    /// Its entries once more by tiles, where these are worth it.
    pub tiles: f64,
}

/// What pass 1 does within its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plan {
    /// What is done with form factors.
    pub factors: Factors,
    /// Whether entries that are kept may be ordered by tiles.
    pub tiles: bool,
}

/// What is done with form factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Factors {
    /// Kept in a matrix.
    Kept,
    /// Cast again for each multiplication: slower, without a matrix, with the same factors, but never made reciprocal.
    CastAgain,
}

impl Need {
    /// The need of a mesh with `rays` rays an element in `batches` randomisations; `channels` values are kept for each entry
    /// where chains give weights, none where rays are counted. Particles fill a caustic map of `cells` cells; this many `threads` cast.
    pub fn new(
        mesh: &Mesh,
        (rays, batches): (u32, u32),
        channels: usize,
        cells: usize,
        threads: usize,
    ) -> Need {
        let n = mesh.len() as f64;
        let more = f64::from(batches.saturating_sub(4)) * RANDOMISATION;
        // A randomisation has no more entries than elements, nor than rays.
        let row = if channels == 0 {
            f64::from(rays).min(n * f64::from(batches))
        } else {
            (CHAIN * f64::from(rays)).min(n * f64::from(batches))
        };
        let tiles = match Tiles::are_worth(mesh.len(), batches as usize, channels == 0) {
            true => n * (4.0 * row + TILED),
            false => 0.0,
        };
        let casting = threads as f64 * f64::from(rays) * RAY;
        Need {
            elements: n * (ELEMENT + more) + cells as f64 * CELL + casting,
            matrix: n * row * 4.0 * (1 + channels) as f64,
            tiles,
        }
    }

    /// The fastest way that fits `limit` bytes.
    ///
    /// # Errors
    /// None does.
    pub fn choose(&self, limit: u64) -> Result<Plan> {
        let limit = limit as f64;
        let kept = self.elements + self.matrix;
        if kept <= limit {
            return Ok(Plan { factors: Factors::Kept, tiles: kept + self.tiles <= limit });
        }
        if self.elements <= limit {
            return Ok(Plan { factors: Factors::CastAgain, tiles: false });
        }
        Err(Error::Usage(format!(
            "pass 1 needs {} even without a matrix of form factors, but may take {}: choose a larger --element-size or fewer --rays, or \
             allow more with --max-memory",
            size(self.elements),
            size(limit)
        )))
    }
}

/// Three quarters of the memory that is free now; none where the system does not say.
pub fn allowed() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: f64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some((kib * 1024.0 * SHARE) as u64)
}

/// A number of bytes as typed: `500M`, `6GiB`, `1.5g`; without a unit, bytes. Units are powers of 1024.
pub fn parse_size(text: &str) -> std::result::Result<u64, String> {
    let lower = text.trim().to_ascii_lowercase();
    let end = lower.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(lower.len());
    let (number, unit) = lower.split_at(end);
    let power = match unit.trim() {
        "" | "b" => 0,
        "k" | "kb" | "kib" => 1,
        "m" | "mb" | "mib" => 2,
        "g" | "gb" | "gib" => 3,
        "t" | "tb" | "tib" => 4,
        _ => return Err("must be a size such as 500M or 6G".into()),
    };
    match number.parse::<f64>() {
        Ok(n) if n > 0.0 && n.is_finite() => Ok((n * 1024f64.powi(power)) as u64),
        _ => Err("must be a size above zero such as 500M or 6G".into()),
    }
}

/// A number of bytes in words.
pub fn size(bytes: f64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut k = 0;
    let mut value = bytes;
    while value >= 1024.0 && k + 1 < units.len() {
        value /= 1024.0;
        k += 1;
    }
    format!("{value:.1} {}", units[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_as_typed() {
        assert_eq!(parse_size("4096"), Ok(4096));
        assert_eq!(parse_size("1.5G"), Ok(3 << 29));
        assert_eq!(parse_size("500 MiB"), Ok(500 << 20));
        for bad in ["", "G", "-1G", "0", "1.5X", "1..5G", "1e3G"] {
            assert!(parse_size(bad).is_err(), "{bad:?}");
        }
        assert_eq!(size(1536.0 * 1024.0), "1.5 MiB");
    }

    #[test]
    fn the_fastest_way_that_fits() {
        let need = Need { elements: 1000.0, matrix: 9000.0, tiles: 500.0 };
        let plan = |factors, tiles| Some(Plan { factors, tiles });
        assert_eq!(need.choose(10_500).ok(), plan(Factors::Kept, true));
        assert_eq!(need.choose(10_499).ok(), plan(Factors::Kept, false));
        assert_eq!(need.choose(9_999).ok(), plan(Factors::CastAgain, false));
        let refused = need.choose(999).expect_err("too little").to_string();
        assert!(refused.contains("--max-memory") && refused.contains("1000.0 B"), "{refused}");
    }
}
