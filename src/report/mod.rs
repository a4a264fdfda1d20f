//! What a run did, as data: the `--report` file (DESIGN section 6). In the modules, what a benchmark suite measured:
//! its records ([`suite`]) as CSV, Markdown tables, plots and a page of HTML.

pub mod csv;
pub mod html;
pub mod markdown;
pub mod plot;
pub mod record;
pub mod suite;
pub(crate) mod text;

use crate::accuracy::Achieved;
use crate::adaptive::Adapted;
use crate::color::Rgb;
use crate::form_factor::pairs::PairCounts;
use crate::form_factor::{Correction, Factors as WrittenFactors, Found, HemicubeErrors, HemicubeSettings};
use crate::memory::Factors;
use crate::mesh::Mesh;
use crate::output::write_whole;
use crate::pipeline::{Pass1, Pass1Result, Residuals, Stage};
use crate::radiosity::Ledger;
use crate::scene::{Features, Scene};
use crate::sequence::FrameTime;
use crate::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// Versions of what ran.
#[derive(Debug, Clone, Serialize)]
pub struct Versions {
    /// This program.
    pub twopass: &'static str,
    /// Embree.
    pub embree: String,
    /// OpenImageIO.
    pub openimageio: String,
}

impl Versions {
    /// The versions that run now.
    pub fn new(device: &crate::embree::Device) -> Versions {
        Versions {
            twopass: env!("CARGO_PKG_VERSION"),
            embree: device.version(),
            openimageio: crate::image::version(),
        }
    }
}

/// Summary of the standard errors of the elements' radiosity.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct StandardErrors {
    /// Root mean square over the elements, weighted by area, over the area-weighted mean of the reflected radiosity.
    pub relative_rms: f64,
    /// Largest [W m^-2].
    pub largest: f64,
}

/// Pass 1 in numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Pass1Report {
    /// What was asked for.
    pub settings: Pass1,
    /// How elements were adapted to the light, where they were.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<Adapted>,
    /// Largest element edge used \[m\].
    pub element_size: f64,
    /// Elements.
    pub elements: usize,
    /// Whether form factors were kept in a matrix or cast again for each multiplication.
    pub factors: Factors,
    /// Entries of the matrix; 0 without one.
    pub stored_factors: usize,
    /// Bytes of the matrix; 0 without one.
    pub matrix_bytes: usize,
    /// Closure, reciprocity and the like.
    pub residuals: Residuals,
    /// Power balance \[W\].
    pub energy: Ledger,
    /// Multiplications with the matrix.
    pub iterations: usize,
    /// Relative residual of the solve.
    pub solve_residual: f64,
    /// Standard errors.
    pub standard_errors: StandardErrors,
}

impl Pass1Report {
    /// Collects the numbers of a solve.
    pub fn new(settings: &Pass1, result: &Pass1Result) -> Pass1Report {
        let s = &result.solution;
        let area = |e: usize| s.mesh.area(e as u32);
        let (mut square, mut mean, mut total, mut largest) = (0.0, 0.0, 0.0, 0.0f64);
        for e in 0..s.mesh.len() {
            let error = s.standard_error[e];
            square += area(e) * error.length_squared() / 3.0;
            mean += area(e) * crate::color::mean(s.irradiance[e] * albedo(s, e));
            total += area(e);
            largest = largest.max(error.max_element());
        }
        let relative_rms = if mean > 0.0 { (square / total).sqrt() / (mean / total) } else { 0.0 };
        Pass1Report {
            settings: *settings,
            adaptive: None,
            element_size: s.mesh.element_size,
            elements: s.mesh.len(),
            factors: result.factors,
            stored_factors: result.stored,
            matrix_bytes: result.matrix_bytes,
            residuals: result.residuals,
            energy: s.ledger,
            iterations: s.convergence.iterations,
            solve_residual: s.convergence.residual,
            standard_errors: StandardErrors { relative_rms, largest },
        }
    }
}

/// Form factors in numbers.
#[derive(Debug, Clone, Serialize)]
pub struct FactorReport {
    /// `ray`, `hemicube` or `analytic`.
    pub method: &'static str,
    /// Rays an element; 0 where none are cast.
    pub rays_per_element: u32,
    /// Entries of the matrix.
    pub stored_factors: usize,
    /// Bytes of the matrix.
    pub matrix_bytes: usize,
    /// Largest departure of a row from closure, escaped and absorbed shares included.
    pub closure: f64,
    /// Departure from reciprocity between objects; none where only some rows were computed.
    pub reciprocity: Option<f64>,
    /// Share of what leaves all elements that left the scene.
    pub escaped: f64,
    /// Share of what leaves all elements that landed on sides without elements.
    pub absorbed: f64,
    /// Which matrix was written: `raw`, `reciprocity` or `closure`.
    pub written: &'static str,
    /// How far the written matrix is from the raw one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correction: Option<Correction>,
    /// How hemi-cubes were drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hemicube: Option<HemicubeSettings>,
    /// The hemi-cube's own errors, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hemicube_errors: Option<HemicubeErrors>,
    /// How pairs of elements were found, where the factors were found pair by pair.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pairs: Option<PairCounts>,
    /// Largest relative standard error of a factor above the floor, where an error was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub largest_relative_error: Option<f64>,
}

impl FactorReport {
    /// Collects the numbers of form factors found by `method`; `some` where not all rows were computed.
    pub fn new(
        scene: &Scene,
        mesh: &Mesh,
        found: &Found,
        (method, some): (&'static str, bool),
        written: &WrittenFactors,
    ) -> FactorReport {
        let (rows, pairs) = (found.rows(), found.pairs());
        let by_rows = rows.map_or(0.0, |r| r.closure_residual(|_| Rgb::ZERO));
        // Pairs are reciprocal as they are.
        let reciprocity =
            rows.map_or(0.0, |r| if pairs.is_some() { 0.0 } else { r.reciprocity_residual(scene, mesh) });
        FactorReport {
            method,
            rays_per_element: rows.map_or(0, |r| r.rays_per_row),
            stored_factors: pairs.map_or(rows.map_or(0, |r| r.stored()), |p| p.stored()),
            matrix_bytes: rows.map_or(0, |r| r.bytes()) + pairs.map_or(0, |p| p.bytes()),
            closure: pairs.map_or(by_rows, |p| p.closure_residual(rows)),
            reciprocity: (!some).then_some(reciprocity),
            escaped: written.loss(&written.escaped).0,
            absorbed: written.loss(&written.absorbed).0,
            written: written.written,
            correction: None,
            hemicube: None,
            hemicube_errors: None,
            pairs: pairs.map(|p| p.counts),
            largest_relative_error: found.achieved,
        }
    }
}
/// Reflected radiosity over irradiance, where there is any.
fn albedo(s: &crate::radiosity::Solution, e: usize) -> crate::color::Rgb {
    let ratio = |b: f64, h: f64| if h > 0.0 { b / h } else { 0.0 };
    let (r, h) = (s.reflected_radiosity(e), s.irradiance[e]);
    crate::color::Rgb::new(ratio(r.x, h.x), ratio(r.y, h.y), ratio(r.z, h.z))
}

/// A solution that was not solved in this run.
#[derive(Debug, Clone, Serialize)]
pub struct KeptReport {
    /// The file.
    pub file: String,
    /// Its settings, versions and pass 1, as they were written.
    pub about: serde_json::Map<String, serde_json::Value>,
}

/// The whole report.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The command line.
    pub command: Vec<String>,
    /// The scene file.
    pub scene: String,
    /// Versions.
    pub versions: Versions,
    /// Threads used.
    pub threads: usize,
    /// Seed.
    pub seed: u32,
    /// Input polygons.
    pub polygons: usize,
    /// Faces that Embree holds.
    pub faces: usize,
    /// Elements of pass 1; 0 without it.
    pub elements: usize,
    /// What the scene needs.
    pub features: Features,
    /// Stages in order.
    pub stages: Vec<Stage>,
    /// Rays a second over the form-factor and trace stages.
    pub rays_per_second: f64,
    /// Pass 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pass1: Option<Pass1Report>,
    /// The file that pass 1 was taken from, and what was said about it there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub solution: Option<KeptReport>,
    /// How wrong the picture is, where an error was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<Achieved>,
    /// Share of the camera rays' weight that pass 2 cut off ([`crate::render::Traced`]), where a picture was rendered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dropped: Option<f64>,
    /// Frame by frame, where a path was rendered.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<FrameTime>,
    /// Form factors, where they are the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form_factors: Option<FactorReport>,
    /// Most memory held at once.
    pub peak_memory_bytes: u64,
    /// Warnings.
    pub warnings: Vec<String>,
}

impl Report {
    /// A report without pass 1.
    pub fn new(
        scene: &Scene,
        versions: Versions,
        seed: u32,
        stages: Vec<Stage>,
        warnings: Vec<String>,
    ) -> Report {
        let (rays, seconds) =
            stages.iter().filter(|s| s.rays > 0).fold((0, 0.0), |(r, t), s| (r + s.rays, t + s.seconds));
        Report {
            command: command_line(),
            scene: scene.path.display().to_string(),
            versions,
            threads: rayon::current_num_threads(),
            seed,
            polygons: scene.polygon_count,
            faces: scene.faces.len(),
            elements: 0,
            features: Features::of(scene),
            stages,
            rays_per_second: if seconds > 0.0 { rays as f64 / seconds } else { 0.0 },
            pass1: None,
            solution: None,
            accuracy: None,
            dropped: None,
            frames: Vec::new(),
            form_factors: None,
            peak_memory_bytes: peak_memory(),
            warnings,
        }
    }

    /// Writes the report as JSON, whole or not at all.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(|e| Error::Parse {
            path: path.into(),
            line: None,
            message: e.to_string(),
        })?;
        write_whole(path, format!("{text}\n").as_bytes())
    }
}

/// The process's arguments; what is not Unicode in them is replaced.
pub fn command_line() -> Vec<String> {
    std::env::args_os().map(|a| a.to_string_lossy().into_owned()).collect()
}

/// Peak resident memory of this process \[bytes\]; 0 where the system does not say.
pub fn peak_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}
