//! Arguments as typed.

use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Two-pass global illumination (Wallace, Cohen and Greenberg 1987) and form factors on Embree.
#[derive(Debug, Parser)]
#[command(name = "twopass", version, about, propagate_version = true)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render an image of a scene.
    Render(RenderArgs),
    /// Solve pass 1 and write the radiosity of every element.
    Solve(SolveArgs),
    /// Compute form (view) factors.
    FormFactors(FormFactorArgs),
    /// Print what a scene holds, and what is modelled for it and what is not.
    Info(InfoArgs),
}

#[derive(Debug, ClapArgs)]
pub struct Common {
    /// Threads; all cores by default. Results do not depend on it.
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true)]
    pub threads: Option<usize>,
    /// Seed of every random choice.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u32,
    /// Print no progress; warnings stay.
    #[arg(long)]
    pub quiet: bool,
}

#[derive(Debug, ClapArgs)]
pub struct Pass1Args {
    /// Rays an element for form factors [default: 1024, or the scene file's].
    #[arg(long, value_name = "N", value_parser = count, allow_negative_numbers = true)]
    pub rays: Option<u32>,
    /// Largest edge of an element, in scene units [default: from the scene's extent].
    #[arg(long, value_name = "L", value_parser = length, allow_negative_numbers = true)]
    pub element_size: Option<f64>,
}

#[derive(Debug, ClapArgs)]
pub struct RenderArgs {
    /// Scene file (TOML).
    pub scene: PathBuf,
    /// Image to write: .exr, .tif, .hdr (linear radiance) or .png, .jpg (sRGB). May be given several times.
    #[arg(short, long, value_name = "IMAGE", required = true)]
    pub output: Vec<PathBuf>,
    /// Camera of the scene file [default: the first].
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// How light is found.
    #[arg(long, value_enum, default_value_t = MethodArg::TwoPass)]
    pub method: MethodArg,
    /// Where two-pass rendering takes diffuse light from [default: gather, or the scene file's].
    #[arg(long, value_enum)]
    pub quality: Option<QualityArg>,
    /// Samples a pixel [default: 16, 256 for path, or the scene file's].
    #[arg(long, value_name = "N", value_parser = count, allow_negative_numbers = true)]
    pub spp: Option<u32>,
    /// Hemisphere rays a sample at quality gather.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = count)]
    pub gather_rays: u32,
    /// Emitter samples a sample.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = count)]
    pub emitter_samples: u32,
    /// Estimator of glossy lobes.
    #[arg(long, value_enum, default_value_t = EstimatorArg::Lobe)]
    pub lobe: EstimatorArg,
    /// Cells along one side of the frustum's grid.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub frustum_grid: u32,
    /// Rays over the lobe at the first glossy surface, a sample.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = count)]
    pub lobe_rays: u32,
    /// Exposure of PNG and JPEG [EV].
    #[arg(long, value_name = "EV", default_value_t = 0.0, allow_negative_numbers = true)]
    pub exposure: f64,
    /// Write what the run did as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, ClapArgs)]
pub struct SolveArgs {
    /// Scene file (TOML) or OBJ file.
    pub scene: PathBuf,
    /// File to write (.npz).
    #[arg(short, long, value_name = "SOLUTION.npz")]
    pub output: PathBuf,
    /// Write what the run did as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, ClapArgs)]
pub struct FormFactorArgs {
    /// Scene file (TOML) or OBJ file. Faces are one-sided: front by the right-hand rule, opaque from both sides.
    pub scene: PathBuf,
    /// How factors are found.
    #[arg(long, value_enum, default_value_t = FactorMethodArg::Ray)]
    pub method: FactorMethodArg,
    /// Add rays until the standard error of every factor above the floor is at most this share of it.
    #[arg(long, value_name = "E", value_parser = share, allow_negative_numbers = true)]
    pub error: Option<f64>,
    /// Smallest factor that --error is for.
    #[arg(long, value_name = "F", default_value_t = 1e-3, value_parser = share, allow_negative_numbers = true)]
    pub floor: f64,
    /// One row and column for each object (`o`/`g` name) instead of each element.
    #[arg(long)]
    pub by_object: bool,
    /// File to write: .npz (scipy.sparse.load_npz), or .json with --by-object; "-" for JSON on standard output.
    #[arg(short, long, value_name = "FILE", default_value = "-")]
    pub output: PathBuf,
    /// Write what the run did as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, ClapArgs)]
pub struct InfoArgs {
    /// Scene file (TOML) or OBJ file.
    pub scene: PathBuf,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MethodArg {
    /// Both passes.
    TwoPass,
    /// Pass 1 alone.
    Radiosity,
    /// Classical ray tracing without diffuse interreflection.
    Whitted,
    /// Unbiased path tracing.
    Path,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum QualityArg {
    /// Interpolated radiosity: fastest.
    Mesh,
    /// Emitters sampled anew, the rest interpolated.
    Direct,
    /// Emitters sampled anew, the rest gathered.
    Gather,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EstimatorArg {
    /// The paper's grid of cells about the mirror direction.
    Frustum,
    /// Importance sampling.
    Lobe,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FactorMethodArg {
    /// Ray casting: hemisphere rays, and where the elements are few enough for the rays, pair by pair the exact
    /// unoccluded factor times the visible fraction.
    Ray,
    /// Exact factors, as if nothing were between two elements: occlusion is ignored.
    Analytic,
}

/// More threads than any machine has; far more would exhaust it.
const MOST_THREADS: usize = 1024;

fn threads(s: &str) -> Result<usize, String> {
    match s.parse() {
        Ok(n) if (1..=MOST_THREADS).contains(&n) => Ok(n),
        _ => Err(format!("must be a whole number from 1 to {MOST_THREADS}")),
    }
}

fn count(s: &str) -> Result<u32, String> {
    match s.parse::<u32>() {
        Ok(n) if n > 0 && n <= 1 << 30 => Ok(n),
        _ => Err("must be a whole number from 1 to 1073741824".into()),
    }
}

fn share(s: &str) -> Result<f64, String> {
    match s.parse::<f64>() {
        Ok(l) if l > 0.0 && l < 1.0 => Ok(l),
        _ => Err("must be a number between 0 and 1".into()),
    }
}

fn length(s: &str) -> Result<f64, String> {
    match s.parse::<f64>() {
        Ok(l) if l > 0.0 && l.is_finite() => Ok(l),
        _ => Err("must be a number above zero".into()),
    }
}
