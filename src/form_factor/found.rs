//! Form factors, however they were found.

use super::estimate::MOST_RAYS;
use super::pairs::{self, FewPairs, PairFactors};
use super::{ExchangeMatrix, ObjectTable};
use crate::mesh::Mesh;
use crate::scene::Scene;

/// Form factors by the estimator that fitted.
pub struct Found {
    /// Rows by hemisphere rays.
    pub rows: Option<ExchangeMatrix>,
    /// Factors found pair by pair, which take the place of the rows' entries.
    pub pairs: Option<PairFactors>,
    /// Factors from and to emitters, which take the place of the rows' entries between elements.
    pub lamps: Option<FewPairs>,
    /// Largest relative standard error of a factor above the floor, where an error was asked for.
    pub achieved: Option<f64>,
    /// Rays cast in all.
    pub rays: u64,
    /// Pairs of objects that something lies between, where that is ignored.
    pub blocked: Vec<(u32, u32)>,
}

impl Found {
    /// Factors found by rows alone.
    pub fn by_rows(rows: ExchangeMatrix) -> Found {
        Found {
            rays: rows.rays,
            rows: Some(rows),
            pairs: None,
            lamps: None,
            achieved: None,
            blocked: Vec::new(),
        }
    }

    /// The factors between objects, from fronts alone; both directions' estimates combined.
    pub fn table(&self, scene: &Scene, mesh: &Mesh, seconds: f64) -> ObjectTable {
        match (&self.pairs, &self.rows) {
            (Some(pairs), rows) => ObjectTable::of_pairs(scene, mesh, pairs, rows.as_ref(), seconds),
            (None, Some(rows)) => ObjectTable::combined(scene, mesh, rows, seconds),
            (None, None) => unreachable!("factors are found by rows or by pairs"),
        }
    }

    /// What the user should know, given the error that was asked for.
    pub fn warnings(&self, scene: &Scene, asked: Option<f64>) -> Vec<String> {
        let mut warnings = Vec::new();
        if !self.blocked.is_empty() {
            let name = |k: u32| format!("\"{}\"", scene.objects[k as usize]);
            let mut names: Vec<_> =
                self.blocked.iter().take(5).map(|&(a, b)| format!("{} - {}", name(a), name(b))).collect();
            if self.blocked.len() > names.len() {
                names.push(format!("and {} more", self.blocked.len() - names.len()));
            }
            warnings.push(format!(
                "occlusion is ignored, but something lies between {}: use --method ray",
                names.join(", ")
            ));
        }
        if let (Some(asked), Some(achieved)) = (asked, self.achieved) {
            if achieved > asked {
                let most = match &self.pairs {
                    Some(found) if found.counts.cells > 0 => "the finest cells".to_string(),
                    Some(_) => format!("{} points a pair", pairs::MOST_POINTS * pairs::BATCHES as u32),
                    None => format!("{MOST_RAYS} rays an element"),
                };
                warnings.push(format!(
                    "--error {asked} not met: {achieved:.2e} with {most}, the most that are tried"
                ));
            }
        }
        warnings
    }

    /// How the factors were found, a line each.
    pub fn lines(&self, floor: f64) -> Vec<String> {
        let mut lines = Vec::new();
        match (&self.pairs, &self.rows) {
            (Some(pairs), _) => {
                let c = pairs.counts;
                lines.push(format!(
                    "pairs of elements: {} averted, {} free, {} hidden, {} by cells, {} by shadows, {} by rays",
                    c.averted, c.free, c.hidden, c.cells, c.shadows, c.rays
                ));
            }
            (None, Some(rows)) => {
                let lamps = self.lamps.as_ref().map_or(0, FewPairs::len);
                let besides = match lamps {
                    0 => String::new(),
                    _ => format!("; {lamps} elements of emitters pair by pair"),
                };
                lines.push(format!("hemisphere rays: {} an element{besides}", rows.rays_per_row));
            }
            (None, None) => {}
        }
        if let Some(achieved) = self.achieved {
            lines.push(format!("largest relative standard error above {floor}: {achieved:.2e}"));
        }
        lines
    }
}
