//! Form factors, however they were found.

use super::estimate::MOST_RAYS;
use super::pairs::{self, FewPairs, PairFactors};
use super::{ExchangeMatrix, ObjectTable};
use crate::mesh::Mesh;
use crate::scene::Scene;

/// Factors by one of the estimators.
pub enum Estimates {
    /// Rows by hemisphere rays, and factors from and to emitters that take the place of their entries between elements.
    Rows(ExchangeMatrix, Option<FewPairs>),
    /// Factors found pair by pair, and rows that tell where the rest of the light goes; none where occlusion is ignored.
    Pairs(PairFactors, Option<ExchangeMatrix>),
}

/// Form factors by the estimator that fitted.
pub struct Found {
    /// The factors.
    pub estimates: Estimates,
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
        let rays = rows.rays;
        Found { estimates: Estimates::Rows(rows, None), achieved: None, rays, blocked: Vec::new() }
    }

    /// Rows by hemisphere rays, where there are any.
    pub fn rows(&self) -> Option<&ExchangeMatrix> {
        match &self.estimates {
            Estimates::Rows(rows, _) => Some(rows),
            Estimates::Pairs(_, rows) => rows.as_ref(),
        }
    }

    /// Factors found pair by pair, where these are the result.
    pub fn pairs(&self) -> Option<&PairFactors> {
        match &self.estimates {
            Estimates::Rows(..) => None,
            Estimates::Pairs(pairs, _) => Some(pairs),
        }
    }

    /// The factors between objects, from fronts alone; both directions' estimates combined.
    pub fn table(&self, scene: &Scene, mesh: &Mesh, seconds: f64) -> ObjectTable {
        match &self.estimates {
            Estimates::Pairs(pairs, rows) => {
                ObjectTable::of_pairs(scene, mesh, pairs, rows.as_ref(), seconds)
            }
            Estimates::Rows(rows, _) => ObjectTable::combined(scene, mesh, rows, seconds),
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
            let most = match self.pairs() {
                Some(found) if found.counts.cells > 0 => "the finest cells".to_string(),
                Some(_) => format!("{} points a pair", pairs::MOST_POINTS * pairs::BATCHES as u32),
                None => format!("{MOST_RAYS} rays an element"),
            };
            let each = self.pairs().filter(|found| found.is_asked());
            if let Some(m) = each.and_then(PairFactors::misses) {
                let (error, i, j) = m.worst;
                warnings.push(format!(
                    "--error {asked} not met by {} of {} factors above {}: their standard errors are larger, {error:.2e} at most \
                     (from element {i} to {j})",
                    m.count, m.of, m.floor
                ));
            } else if each.is_none() && achieved > asked {
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
        match &self.estimates {
            Estimates::Pairs(pairs, _) => {
                let c = pairs.counts;
                lines.push(format!(
                    "pairs of elements: {} averted, {} free, {} hidden, {} by cells, {} by shadows, {} by rays, {} from hemisphere rays",
                    c.averted, c.free, c.hidden, c.cells, c.shadows, c.rays, c.hemisphere
                ));
            }
            Estimates::Rows(rows, lamps) => {
                let lamps = lamps.as_ref().map_or(0, FewPairs::len);
                let besides = match lamps {
                    0 => String::new(),
                    _ => format!("; {lamps} elements of emitters pair by pair"),
                };
                lines.push(format!("hemisphere rays: {} an element{besides}", rows.rays_per_row));
            }
        }
        if let Some(achieved) = self.achieved {
            lines.push(format!("largest relative standard error above {floor}: {achieved:.2e}"));
        }
        lines
    }
}
