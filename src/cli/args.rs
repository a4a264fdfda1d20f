//! Arguments as typed.

use crate::sampling::MOST_SAMPLES;
use crate::scene::within_size;
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use std::ops::{Range, RangeInclusive};
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
    /// Measure the error of an image against a reference.
    Compare(CompareArgs),
    /// Measure speed beside error and write a report.
    Bench(BenchArgs),
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
    #[command(flatten)]
    pub elements: ElementArgs,
}

#[derive(Debug, ClapArgs)]
pub struct ElementArgs {
    /// Largest edge of an element, in scene units [default: the scene file's, or from the scene's extent].
    #[arg(long, value_name = "L", value_parser = length, allow_negative_numbers = true)]
    pub element_size: Option<f64>,
}

#[derive(Debug, ClapArgs)]
pub struct AdaptiveArgs {
    /// Refine elements only where the light that the image reads asks for it: for what the scene's cameras see, and a tenth as much
    /// for all surfaces; --element-size is then the size of the finest [default: the scene file's, or false].
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub adaptive: Option<bool>,
}

#[derive(Debug, ClapArgs)]
pub struct MemoryArgs {
    /// Memory that pass 1 may take, such as 500M or 6G [default: three quarters of what is free]. Where the matrix of form
    /// factors does not fit, rays are cast again for each multiplication: slower, with the same radiosity as far as it is solved and
    /// standard errors within a few per cent, but without making the exchange of nearly white scenes reciprocal.
    #[arg(long, value_name = "SIZE", value_parser = crate::memory::parse_size, allow_negative_numbers = true)]
    pub max_memory: Option<u64>,
}

impl MemoryArgs {
    /// Bytes; none where neither the user nor the system says.
    pub fn limit(&self) -> Option<u64> {
        self.max_memory.or_else(crate::memory::allowed)
    }
}

#[derive(Debug, ClapArgs)]
pub struct RenderArgs {
    /// Scene file (TOML).
    pub scene: PathBuf,
    /// Image to write: .exr, .tif, .hdr (linear radiance) or .png, .jpg (sRGB). May be given several times. With --frames the
    /// name says where the frame's number goes: out.%04d.exr (printf's, as for OpenImageIO and ffmpeg) or out_####.exr (one #
    /// a digit, as in Blender).
    #[arg(short, long, value_name = "IMAGE", required = true)]
    pub output: Vec<PathBuf>,
    /// Camera of the scene file [default: the first].
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Frames A to B of the camera's path ([[camera.keyframe]] in the scene file), both rendered; or one frame A. Pass 1 is
    /// solved once for all.
    #[arg(long, value_name = "A..B", value_parser = frames, allow_hyphen_values = true)]
    pub frames: Option<RangeInclusive<u32>>,
    /// Take pass 1 from a file that `twopass solve` wrote for this scene instead of solving. The picture is the same to the
    /// bit.
    #[arg(long, value_name = "FILE.npz", conflicts_with_all = ["rays", "element_size", "adaptive", "max_memory"])]
    pub solution: Option<PathBuf>,
    /// Pixels across and down [default: the camera's]
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<[u32; 2]>,
    /// Choose quality, elements, rays and samples so that the image's relative RMSE is at most this, and say what was
    /// achieved; the scene file's own choices are left aside, and pixels that see an emitter directly do not count.
    #[arg(long, value_name = "E", value_parser = share, allow_negative_numbers = true, conflicts_with_all = [
        "rays", "element_size", "adaptive", "spp", "quality", "gather_rays", "emitter_samples", "solution", "frames"
    ])]
    pub error: Option<f64>,
    /// How light is found.
    #[arg(long, value_enum, default_value_t = MethodArg::TwoPass)]
    pub method: MethodArg,
    /// Where two-pass rendering takes diffuse light from [default: gather, or the scene file's].
    #[arg(long, value_enum)]
    pub quality: Option<QualityArg>,
    /// Samples a pixel [default: 32 at quality gather, 256 for path, 16 otherwise, or the scene file's]. At quality gather, a pixel that sees a mirror or glass
    /// takes eight for each of them, with an eighth of the hemisphere rays.
    #[arg(long, value_name = "N", value_parser = count, allow_negative_numbers = true)]
    pub spp: Option<u32>,
    /// Hemisphere rays a sample at quality gather, on average: bright light from few directions gets up to eight times as many, what is
    /// dark or even half [default: 16].
    #[arg(long, value_name = "N", value_parser = count)]
    pub gather_rays: Option<u32>,
    /// Emitter samples a sample [default: 4].
    #[arg(long, value_name = "N", value_parser = count)]
    pub emitter_samples: Option<u32>,
    /// Estimator of glossy lobes [default: lobe].
    #[arg(long, value_enum)]
    pub lobe: Option<EstimatorArg>,
    /// Cells along one side of the grid of --lobe frustum [default: 10].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    pub frustum_grid: Option<u32>,
    /// Rays over the lobe at the first glossy surface, a sample, for --lobe lobe [default: 4].
    #[arg(long, value_name = "N", value_parser = count)]
    pub lobe_rays: Option<u32>,
    /// Directions a hemisphere, about, for --method directional [default: 256].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub directions: Option<u32>,
    /// Exposure of PNG and JPEG [EV] [default: 0].
    #[arg(long, value_name = "EV", allow_negative_numbers = true)]
    pub exposure: Option<f64>,
    /// Write what the run did as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub adaptive: AdaptiveArgs,
    #[command(flatten)]
    pub memory: MemoryArgs,
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
    /// Quality of the images that --adaptive refines elements for [default: gather, or the scene file's].
    #[arg(long, value_enum)]
    pub quality: Option<QualityArg>,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub adaptive: AdaptiveArgs,
    #[command(flatten)]
    pub memory: MemoryArgs,
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
    /// What specular surfaces do. With chain or image, factors are extended ones: they count each diffuse surface
    /// that light meets on its way, and a purely specular surface has no factors of its own.
    #[arg(long, value_enum, default_value_t = MirrorArg::None)]
    pub mirror: MirrorArg,
    /// Add rays until the standard error of every factor above the floor is at most this share of it.
    #[arg(long, value_name = "E", value_parser = share, allow_negative_numbers = true)]
    pub error: Option<f64>,
    /// Smallest factor that --error is for [default: 0.001].
    #[arg(long, value_name = "F", value_parser = share, allow_negative_numbers = true)]
    pub floor: Option<f64>,
    /// One row and column for each object (`o`/`g` name) instead of each element. Without --element-size, elements are so few that
    /// every pair is looked at, where that is possible.
    #[arg(long)]
    pub by_object: bool,
    /// Both sides of every face take part; backs come as objects `NAME:back` after all fronts.
    #[arg(long)]
    pub two_sided: bool,
    /// Only rows A to B - 1 (elements, or objects with --by-object, counted from 0) are computed and written, as they are among
    /// all.
    #[arg(long, value_name = "A..B", value_parser = rows, allow_hyphen_values = true)]
    pub rows: Option<Range<usize>>,
    /// Move the factors as little as their standard errors allow so that they obey reciprocity, or reciprocity and closure; factors without a
    /// standard error stay where the others can close the rows.
    #[arg(long, value_enum, default_value_t = EnforceArg::None)]
    pub enforce: EnforceArg,
    /// File to write; may be given several times: .npz (scipy.sparse.load_npz; numpy.load finds area, escaped, absorbed,
    /// standard_error (of hemi-cubes with --rotate alone), objects and each element's object beside the matrix), .csv, .json,
    /// .vf or .out (View3D's text format), or a picture of the matrix (.png, ...). "-" for JSON on standard output, the default
    /// with --by-object.
    #[arg(short, long, value_name = "FILE")]
    pub output: Vec<PathBuf>,
    /// Draw what an element sees (its number, or an object's name for the one in its middle) to -o IMAGE; no matrix.
    #[arg(long, value_name = "ELEMENT|OBJECT")]
    pub view: Option<String>,
    /// How --view lays the hemisphere flat.
    #[arg(long, value_enum, default_value_t = ViewArg::Fisheye, requires = "view")]
    pub view_as: ViewArg,
    /// Write what the run did as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    pub pass1: Pass1Args,
    #[command(flatten)]
    pub common: Common,
    #[command(flatten)]
    pub hemicube: HemicubeArgs,
}

/// Options of `--method hemicube` alone.
#[derive(Debug, ClapArgs)]
#[command(next_help_heading = "Hemi-cube")]
pub struct HemicubeArgs {
    /// Pixels along each edge of the hemi-cube's top [default: 256].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(crate::form_factor::MOST_PIXELS)))]
    pub resolution: Option<u32>,
    /// N x N hemi-cubes over each element instead of one at its centre.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub hemicube_grid: Option<u32>,
    /// N independent random rotations of every hemi-cube about the normal, which make noise of aliasing around it; from 2 on they give
    /// standard errors, of that noise and (with a grid) of what its points miss. Factors of what lies near the horizon keep a bias, since
    /// rotations do not change heights above it, and standard errors do not show that: --resolution lowers it [default: none].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub rotate: Option<u32>,
    /// Measure the errors of aliasing, proximity and visibility from a point on a sample of rows, for --report.
    #[arg(long)]
    pub hemicube_errors: bool,
}

#[derive(Debug, ClapArgs)]
pub struct CompareArgs {
    /// Image to judge: .exr, .pfm, .hdr, .png, .tif, .jpg.
    pub image: PathBuf,
    /// What it should be.
    pub reference: PathBuf,
    /// A second, independent reference: with both, the error is free of their noise.
    pub reference_b: Option<PathBuf>,
    /// Pixels that count: a NumPy file of booleans (.npy), or an image that is not black there.
    #[arg(long, value_name = "MASK")]
    pub mask: Option<PathBuf>,
    /// Picture of the signed error in false colours to write: blue is too dark, red too bright.
    #[arg(long, value_name = "OUT.png")]
    pub diff: Option<PathBuf>,
    /// Error at the ends of the colours of --diff, in units of the reference's mean [default: what 99 % of the pixels
    /// stay within].
    #[arg(long, value_name = "X", requires = "diff", value_parser = length, allow_negative_numbers = true)]
    pub diff_scale: Option<f64>,
    /// Exposure of the perceptual metric [EV]: radiance is multiplied by 2 to this power before it is shown.
    #[arg(long, value_name = "EV", default_value_t = 0.0, allow_negative_numbers = true)]
    pub exposure: f64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, ClapArgs)]
pub struct BenchArgs {
    /// Groups to run [default: all]. An unknown name lists them.
    pub names: Vec<String>,
    /// Folder of the records and the report.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Fewer and smaller measurements: two minutes instead of forty.
    #[arg(long)]
    pub quick: bool,
    /// Replace the tables in a Markdown file with those of the records in DIR. Measures nothing, unless groups are named: then
    /// with what these gave.
    #[arg(long, value_name = "README.md")]
    pub tables: Option<PathBuf>,
    /// Folder of cached references [default: twopass in the user's cache folder].
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Folder of scenes with another renderer's images (NAME.toml, NAME_A.exr, NAME_B.exr, NAME_mask.npy) to check
    /// references against [default: ../shared/scenes beside this program's sources, where it exists].
    #[arg(long, value_name = "DIR")]
    pub foreign: Option<PathBuf>,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, ClapArgs)]
pub struct InfoArgs {
    /// Scene file (TOML) or OBJ file.
    pub scene: PathBuf,
    #[command(flatten)]
    pub elements: ElementArgs,
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
    /// Directional radiosity (Immel, Cohen and Greenberg 1986): view-independent, small scenes only.
    Directional,
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
    /// Hemi-cubes drawn with a z-buffer (Cohen and Greenberg 1985).
    Hemicube,
    /// Exact factors, as if nothing were between two elements: occlusion is ignored.
    Analytic,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EnforceArg {
    /// The raw estimates.
    None,
    /// A_i F_ij = A_j F_ji.
    Reciprocity,
    /// Reciprocity, and rows that sum to 1 less what escapes.
    Closure,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ViewArg {
    /// Orthographic: equal areas are equal form factors.
    Fisheye,
    /// Unfolded hemi-cube.
    Hemicube,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MirrorArg {
    /// They block and absorb like any other surface: factors are plain geometry.
    None,
    /// Rays go on by reflection, refraction and glossy lobes.
    Chain,
    /// Flat mirrors are windows into a mirrored scene, as in the paper: an independent estimate, for flat perfect
    /// mirrors only.
    Image,
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
        Ok(n) if n > 0 && n <= MOST_SAMPLES => Ok(n),
        _ => Err(format!("must be a whole number from 1 to {MOST_SAMPLES}")),
    }
}

fn size(s: &str) -> Result<[u32; 2], String> {
    let parsed = s.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    match parsed {
        Some(size) if within_size(size) => Ok(size),
        _ => Err("must be WIDTHxHEIGHT, for example 640x480, of at most 65536 each and 2^28 pixels".into()),
    }
}

fn frames(s: &str) -> Result<RangeInclusive<u32>, String> {
    let (a, b) = s.split_once("..").unwrap_or((s, s));
    match (a.parse(), b.parse()) {
        (Ok(a), Ok(b)) if a <= b => Ok(a..=b),
        _ => {
            Err("must be A..B with whole numbers A <= B, both rendered, for example 1..100; or one number"
                .into())
        }
    }
}

fn rows(s: &str) -> Result<Range<usize>, String> {
    let parsed = s.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
    match parsed {
        Some(range) if range.start < range.end => Ok(range),
        _ => Err("must be A..B with whole numbers A < B: rows A to B - 1, counted from 0".into()),
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
