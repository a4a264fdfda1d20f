//! `twopass render`.

use super::args::{AdaptiveArgs, ElementArgs, EstimatorArg, MethodArg, Pass1Args, QualityArg, RenderArgs};
use super::frames::{Pattern, check_range, refuse_pattern};
use super::progress::Progress;
use super::{check_outputs, length, options};
use crate::accuracy::{Achieved, View, render_to_error};
use crate::adaptive::{self, Adapted};
use crate::color::Rgb;
use crate::embree::Device;
use crate::emitters::Emitters;
use crate::image::{self, Image, WriteOptions};
use crate::medium;
use crate::memory::Factors;
use crate::pipeline::{self, Pass1, Pass1Result, Stage};
use crate::radiosity::{Directional, Kept, Reads, Solution};
use crate::render::{
    Estimator, GATHER_RAYS, Method, Quality, Renderer, Settings, cut_off, render_directional,
};
use crate::report::{KeptReport, Pass1Report, Report, Versions, command_line};
use crate::scene::{Camera, Features, Scene, load};
use crate::sequence::{FrameTime, render_frames};
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::path::PathBuf;
use std::sync::LazyLock;

/// Emitter samples a sample where nobody says otherwise.
const EMITTER_SAMPLES: u32 = 4;
/// Cells along the frustum's grid where nobody says otherwise.
const FRUSTUM_GRID: u32 = 10;
/// Rays over a glossy lobe where nobody says otherwise.
const LOBE_RAYS: u32 = 4;
/// Directions a hemisphere of directional radiosity where nobody says otherwise.
const DIRECTIONS: u32 = 256;

pub fn run(args: &RenderArgs) -> Result<()> {
    let patterns = outputs(args)?;
    options::of_render(args)?;
    let progress = Progress::new(args.common.quiet);
    let observer = &|e| progress.tell(e);
    let mut stages: Vec<Stage> = Vec::new();
    let scene = pipeline::stage("load", 0, observer, &mut stages, || (load(&args.scene), 0))?;
    scene.warnings.iter().for_each(|w| progress.warn(w));
    let cameras = cameras(args, &scene)?;
    let glossy = Features::of(&scene).glossy;
    let idle = options::idle_of_render(args, quality(args.quality, &scene), glossy);
    idle.iter().for_each(|w| progress.warn(w));
    let left_out = left_out(args.method, &scene);
    left_out.iter().for_each(|w| progress.warn(w));
    check_outputs(scene.files.iter().chain(&args.solution), &files(args, &patterns, &cameras))?;
    cameras.iter().take(1).try_for_each(|c| fits(&args.output, c.1.size))?;
    let kept = args.solution.as_ref().map(|path| {
        pipeline::stage("solution", 0, observer, &mut stages, || (Solution::read_npz(&scene, path), 0))
    });
    let kept = kept.transpose()?;

    // Beside pass 1, which does not need it.
    let _preparing = image::prepare();
    let device = Device::new(rayon::current_num_threads())?;
    let visibility =
        pipeline::stage("build", 0, observer, &mut stages, || (Visibility::new(&device, &scene), 0))?;
    let emitters = Emitters::new(&visibility);
    pipeline::require_light(&scene, &emitters)?;
    let versions = Versions::new(&device);
    let mut warnings: Vec<String> = scene.warnings.iter().cloned().chain(left_out).collect();
    let ready = Ready {
        args,
        visibility: &visibility,
        emitters: &emitters,
        cameras: &cameras,
        kept: kept.as_ref(),
        progress: &progress,
    };
    let first = ready
        .before_the_view(&mut stages, &mut warnings)
        .map_err(|e| of_element_size(&args.pass1.elements, &scene, e))?;
    let pictures = ready.pictures(&first, &patterns, &versions, &mut stages)?;
    if let Some(w) = pictures.dropped.and_then(cut_off) {
        progress.warn(&w);
        warnings.push(w);
    }
    let mut report = Report::new(&scene, versions, args.common.seed, stages, warnings);
    report.dropped = pictures.dropped;
    report.frames = pictures.frames;
    ready.complete(&mut report, first);
    if let Some(path) = &args.report {
        report.write(path)?;
    }
    Ok(())
}

/// Light of a scene that a method leaves out by what it is, in words.
fn left_out(method: MethodArg, scene: &Scene) -> Option<String> {
    (method == MethodArg::Whitted && scene.environment != Rgb::ZERO).then(|| {
        "--method whitted leaves out the environment's light on diffuse surfaces: they show that of emitters alone".into()
    })
}

/// All that there is before any light is found.
struct Ready<'a, 's> {
    args: &'a RenderArgs,
    visibility: &'a Visibility<'s>,
    emitters: &'a Emitters,
    /// With the numbers of their frames.
    cameras: &'a [(u32, Camera)],
    /// A solution that is used again.
    kept: Option<&'a Kept>,
    progress: &'a Progress,
}

/// What is found before a camera looks.
struct First {
    /// Settings of the pictures.
    settings: Settings,
    /// Pass 1 and its settings, where the method has one that was not kept.
    pass1: Option<(Pass1Result, Pass1)>,
    adapted: Option<Adapted>,
    directional: Option<Directional>,
    /// Where an error was asked for, the picture, the light that was dropped on the way, and how wrong it is.
    rendered: Option<(Image, f64, Achieved)>,
}

/// What became of the pictures.
#[derive(Default)]
struct Pictures {
    frames: Vec<FrameTime>,
    dropped: Option<f64>,
}

impl<'s> Ready<'_, 's> {
    fn scene(&self) -> &'s Scene {
        self.visibility.scene()
    }

    /// Pass 1, or what the method has in its place.
    fn before_the_view(&self, stages: &mut Vec<Stage>, warnings: &mut Vec<String>) -> Result<First> {
        let &Ready { args, visibility, emitters, cameras, kept, progress } = self;
        let observer = &|e| progress.tell(e);
        let scene = self.scene();
        // Not the camera at hand: pass 1 is the same whichever view is rendered, and as `solve` has it.
        let view_points = scene.view_points();
        let pass1_settings = pass1(&args.pass1, scene, args.common.seed);
        let settings = settings(args, scene);
        let mut first = First { settings, pass1: None, adapted: None, directional: None, rendered: None };
        let mut warn = |found: &[String]| {
            found.iter().for_each(|w| progress.warn(w));
            warnings.extend_from_slice(found);
        };
        warn(&medium::warnings(visibility));
        if let Some(error) = args.error {
            let reach = || pipeline::reached(visibility, &view_points, args.common.seed, observer);
            let view = View {
                visibility,
                emitters,
                reached: pipeline::building(stages, reach),
                camera: &cameras[0].1,
                settings,
                limit: args.memory.limit(),
            };
            let found = render_to_error(&view, error, args.common.seed, observer, stages)?;
            tell_factors(progress, &found.pass1);
            warn(&found.warnings);
            tell_accuracy(progress, &found.achieved);
            first.settings.spp = found.achieved.spp;
            first.pass1 = Some((found.pass1, found.settings));
            first.rendered = Some((found.image, found.dropped, found.achieved));
        } else if args.method == MethodArg::Directional {
            let what = (&pass1_settings, args.directions.unwrap_or(DIRECTIONS));
            let solution =
                pipeline::solve_directional(visibility, emitters, &view_points, what, observer, stages)?;
            progress.line(&format!(
                "{} elements, {} directional values, {:.1} MiB, {} iterations",
                solution.elements(),
                solution.directional_values(),
                solution.bytes / f64::from(1 << 20),
                solution.iterations
            ));
            first.directional = Some(solution);
        } else if let Some(kept) = kept {
            let views: Vec<&Camera> = cameras.iter().map(|c| &c.1).collect();
            warn(&pipeline::without_elements(visibility, &kept.solution.mesh, &views));
        } else if matches!(settings.method, Method::TwoPass(_) | Method::Radiosity) {
            let reads = reads(&args.adaptive, scene, settings.method);
            let of = (visibility, emitters, &view_points[..]);
            let (result, adapted) =
                pass1_of(of, (&pass1_settings, reads), args.memory.limit(), observer, stages)?;
            tell_factors(progress, &result);
            warn(&result.warnings);
            first.adapted = adapted;
            first.pass1 = Some((result, pass1_settings));
        }
        Ok(first)
    }

    /// The solution that pass 2 reads.
    fn solution<'f>(&'f self, first: &'f First) -> Option<&'f Solution> {
        self.kept.map(|k| &k.solution).or(first.pass1.as_ref().map(|p| &p.0.solution))
    }

    /// Pass 2: renders what is not rendered yet, and writes it.
    fn pictures(
        &self,
        first: &First,
        patterns: &[Pattern],
        versions: &Versions,
        stages: &mut Vec<Stage>,
    ) -> Result<Pictures> {
        let &Ready { args, visibility, emitters, cameras, progress, .. } = self;
        let observer = &|e| progress.tell(e);
        let advance = |n| progress.tell(pipeline::Event::Advance(n));
        let (settings, size) = (&first.settings, cameras[0].1.size);
        let renderer =
            LazyLock::new(|| Renderer::new(visibility, emitters, self.solution(first), size, settings));
        let picture = |camera: &Camera| match &first.directional {
            Some(solution) => {
                let samples = (settings.spp, settings.seed);
                render_directional(visibility, emitters, solution, camera, samples, &advance)
            }
            None => renderer.render(camera, &advance),
        };

        image::ready()?;
        let exposure = args.exposure.unwrap_or(0.0);
        let options = WriteOptions { exposure, metadata: metadata(args, versions, settings) };
        let pixels: u64 = cameras.iter().map(|(_, c)| u64::from(c.size[0]) * u64::from(c.size[1])).sum();
        let mut pictures = Pictures::default();
        if args.frames.is_some() {
            pictures.frames = pipeline::stage("trace", pixels, observer, stages, || {
                let trace = |frame: u32| {
                    let k = (frame - cameras[0].0) as usize;
                    progress.tell(pipeline::Event::Item(k as u64 + 1, cameras.len() as u64));
                    picture(&cameras[k].1)
                };
                let write = |frame: u32, image: &Image| {
                    patterns.iter().try_for_each(|p| image::write(image, &p.file(frame), &options))
                };
                let times = render_frames(cameras.iter().map(|c| c.0), trace, write);
                let rays = times.iter().flatten().map(|t| t.rays).sum();
                (times, rays)
            })?;
            pictures.dropped = pictures.frames.iter().map(|f| f.dropped).reduce(f64::max);
            tell_frames(progress, &pictures.frames, stages.last());
            // Mostly beside `trace`, on a thread of its own.
            let seconds = pictures.frames.iter().map(|f| f.write_seconds).sum();
            stages.push(Stage { name: "write", seconds, rays: 0 });
            return Ok(pictures);
        }
        let traced;
        let image = match &first.rendered {
            Some((image, dropped, _)) => {
                pictures.dropped = Some(*dropped);
                image
            }
            None => {
                traced = pipeline::stage("trace", pixels, observer, stages, || {
                    let (image, traced) = picture(&cameras[0].1);
                    pictures.dropped = Some(traced.dropped);
                    (image, traced.rays)
                });
                &traced
            }
        };
        pipeline::stage("write", 0, observer, stages, || {
            (args.output.iter().try_for_each(|output| image::write(image, output, &options)), 0)
        })?;
        Ok(pictures)
    }

    /// Says what pass 1 came to, on the terminal and in the report.
    fn complete(&self, report: &mut Report, first: First) {
        let progress = self.progress;
        let elements = self.solution(&first).map_or(0, |s| s.mesh.len());
        report.elements = first.directional.as_ref().map_or(elements, Directional::elements);
        report.accuracy = first.rendered.map(|r| r.2);
        if let Some((result, settings)) = &first.pass1 {
            let mut pass1 = Pass1Report::new(settings, result);
            pass1.adaptive = first.adapted;
            tell_adapted(progress, &pass1);
            progress.line(&format!(
                "{} elements of at most {} m, standard error {:.2} %, energy residual {:.2} %",
                pass1.elements,
                length(pass1.element_size),
                100.0 * pass1.standard_errors.relative_rms,
                100.0 * pass1.energy.residual.abs().max_element()
            ));
            report.pass1 = Some(pass1);
        }
        if let (Some(kept), Some(path)) = (self.kept, &self.args.solution) {
            let file = path.display().to_string();
            let mesh = &kept.solution.mesh;
            progress.line(&format!(
                "{} elements of at most {} m, solved before",
                mesh.len(),
                length(mesh.element_size)
            ));
            report.solution = Some(KeptReport { file, about: kept.about.clone() });
        }
    }
}

/// Refuses pictures of more pixels across or down than their formats can hold; those of a camera are of one size.
fn fits(outputs: &[PathBuf], size: [u32; 2]) -> Result<()> {
    outputs.iter().try_for_each(|o| image::fits(o, size.map(|n| n as usize)))
}

/// Checks what can be checked without the scene; the names of the frames, where a path is rendered.
fn outputs(args: &RenderArgs) -> Result<Vec<Pattern>> {
    let inputs = [&args.scene].into_iter().chain(&args.solution);
    let Some(frames) = &args.frames else {
        args.output.iter().try_for_each(|o| refuse_pattern(o))?;
        args.output.iter().try_for_each(|o| image::supported(o))?;
        check_outputs(inputs, args.output.iter().chain(&args.report))?;
        return Ok(Vec::new());
    };
    let patterns: Vec<Pattern> = args.output.iter().map(|o| Pattern::new(o)).collect::<Result<_>>()?;
    let first: Vec<PathBuf> = patterns.iter().map(|p| p.file(*frames.start())).collect();
    first.iter().try_for_each(|o| image::supported(o))?;
    check_outputs(inputs, first.iter().chain(&args.report))?;
    Ok(patterns)
}

/// All files that will be written: those of every frame may meet each other or the report, or be folders.
fn files(args: &RenderArgs, patterns: &[Pattern], cameras: &[(u32, Camera)]) -> Vec<PathBuf> {
    let pictures = patterns.iter().flat_map(|p| cameras.iter().map(|c| p.file(c.0)));
    let named = if args.frames.is_some() { &[][..] } else { &args.output };
    pictures.chain(named.iter().chain(&args.report).cloned()).collect()
}

/// The camera, or that of each frame, with their numbers.
fn cameras(args: &RenderArgs, scene: &Scene) -> Result<Vec<(u32, Camera)>> {
    let name = args.camera.as_deref();
    let mut cameras = match &args.frames {
        None => vec![(0, scene.camera(name)?.clone())],
        Some(frames) => {
            let path = scene.path(name)?;
            check_range(path, frames)?;
            frames.clone().map(|f| (f, path.at(f))).collect()
        }
    };
    for (_, camera) in &mut cameras {
        camera.size = args.size.unwrap_or(camera.size);
    }
    Ok(cameras)
}

/// Says how fast frames came, and whether the encoder held them up.
fn tell_frames(progress: &Progress, frames: &[FrameTime], stage: Option<&Stage>) {
    let seconds = stage.map_or(0.0, |s| s.seconds);
    let write: f64 = frames.iter().map(|f| f.write_seconds).sum();
    progress.line(&format!(
        "{} frames, {:.2} a second; the encoder was busy {:.0} % of the time",
        frames.len(),
        frames.len() as f64 / seconds,
        100.0 * write / seconds
    ));
}

/// Says how wrong the picture is and what was chosen for it.
fn tell_accuracy(progress: &Progress, a: &Achieved) {
    progress.line(&format!(
        "error {:.2} % (noise {:.2} %, elements {:.2} %) for {:.2} % asked: quality {}, elements of at most {} m, {} rays an \
         element, {} samples a pixel",
        100.0 * a.relative_rmse,
        100.0 * a.noise,
        100.0 * a.discretisation,
        100.0 * a.asked,
        a.quality,
        length(a.element_size),
        a.rays,
        a.spp
    ));
}

/// Says where form factors were not kept: the solve takes longer than a user may expect.
pub fn tell_factors(progress: &Progress, result: &Pass1Result) {
    if result.factors == Factors::CastAgain {
        progress.line(
            "the matrix of form factors would not fit the memory (--max-memory): its rays were cast again for each \
             multiplication",
        );
    }
}

/// Says how many elements a uniform mesh would have.
pub fn tell_adapted(progress: &Progress, pass1: &Pass1Report) {
    let Some(adapted) = &pass1.adaptive else { return };
    progress.line(&format!(
        "{} elements in {} {}, the finest of at most {} m; uniform ones would be {}",
        pass1.elements,
        adapted.elements.len(),
        if adapted.elements.len() == 1 { "pass" } else { "passes" },
        length(pass1.element_size),
        adapted.uniform_elements
    ));
}

/// What an adaptive mesh is refined for, where one is asked for.
pub fn reads(args: &AdaptiveArgs, scene: &Scene, method: Method) -> Option<Reads> {
    let adaptive = args.adaptive.unwrap_or(scene.radiosity.adaptive);
    adaptive.then_some(match method {
        Method::Radiosity | Method::TwoPass(Quality::Mesh) => Reads::Reflected,
        _ => Reads::Indirect,
    })
}

/// Pass 1 with uniform elements, or with adaptive ones that suit what pass 2 reads.
pub fn pass1_of(
    (visibility, emitters, view_points): (&Visibility, &Emitters, &[Camera]),
    (settings, reads): (&Pass1, Option<Reads>),
    limit: Option<u64>,
    observer: pipeline::Observer,
    stages: &mut Vec<Stage>,
) -> Result<(Pass1Result, Option<Adapted>)> {
    let Some(reads) = reads else {
        let result =
            pipeline::solve_within(limit, visibility, emitters, view_points, settings, observer, stages)?;
        return Ok((result, None));
    };
    let what = (settings, reads);
    let (result, adapted) =
        adaptive::solve(limit, visibility, emitters, view_points, what, observer, stages)?;
    Ok((result, Some(adapted)))
}

/// Settings of pass 1: the command line over the scene file over the defaults.
pub fn pass1(args: &Pass1Args, scene: &Scene, seed: u32) -> Pass1 {
    let mut settings = Pass1::of(scene);
    settings.seed = seed;
    if let Some(rays) = args.rays {
        settings.rays = rays;
    }
    settings.element_size = element_size(&args.elements, scene);
    settings
}

/// Largest edge of an element \[m\]: the command line over the scene file.
pub fn element_size(args: &ElementArgs, scene: &Scene) -> Option<f64> {
    args.element_size.map(|size| size * scene.unit).or(scene.radiosity.element_size)
}

/// An error about too many elements, which advises `--element-size`, where the scene file chose their size: names its key.
pub fn of_element_size(args: &ElementArgs, scene: &Scene, error: Error) -> Error {
    const ADVICE: &str = ": choose a larger --element-size";
    let chosen = args.element_size.is_none() && scene.radiosity.element_size.is_some();
    match &error {
        Error::Usage(message) if chosen => match message.strip_suffix(ADVICE) {
            Some(what) => {
                let help = "choose a larger element_size there, or give --element-size";
                Error::parse(&scene.path, None, format!("[radiosity] element_size: {what}: {help}"))
            }
            None => error,
        },
        _ => error,
    }
}

/// The quality asked for: the command line over the scene file over the default.
pub fn quality(asked: Option<QualityArg>, scene: &Scene) -> Quality {
    match (asked, scene.render.quality.as_deref()) {
        (Some(QualityArg::Mesh), _) | (None, Some("mesh")) => Quality::Mesh,
        (Some(QualityArg::Direct), _) | (None, Some("direct")) => Quality::Direct,
        _ => Quality::Gather,
    }
}

fn settings(args: &RenderArgs, scene: &Scene) -> Settings {
    let quality = quality(args.quality, scene);
    let method = match args.method {
        // Directional radiosity has no settings of pass 2 but its samples.
        MethodArg::TwoPass | MethodArg::Directional => Method::TwoPass(quality),
        MethodArg::Radiosity => Method::Radiosity,
        MethodArg::Whitted => Method::Whitted,
        MethodArg::Path => Method::Path,
    };
    Settings {
        method,
        spp: args.spp.or(scene.render.spp).unwrap_or(method.default_spp()),
        gather_rays: args.gather_rays.unwrap_or(GATHER_RAYS),
        emitter_samples: args.emitter_samples.unwrap_or(EMITTER_SAMPLES),
        estimator: match args.lobe {
            Some(EstimatorArg::Frustum) => Estimator::Frustum(args.frustum_grid.unwrap_or(FRUSTUM_GRID)),
            _ => Estimator::Lobe(args.lobe_rays.unwrap_or(LOBE_RAYS)),
        },
        seed: args.common.seed,
    }
}

fn metadata(args: &RenderArgs, versions: &Versions, settings: &Settings) -> Vec<(String, String)> {
    [
        ("Software", format!("twopass {}", versions.twopass)),
        ("twopass:command", command_line().join(" ")),
        ("twopass:seed", args.common.seed.to_string()),
        ("twopass:spp", settings.spp.to_string()),
        ("twopass:embree", versions.embree.clone()),
        ("twopass:openimageio", versions.openimageio.clone()),
    ]
    .map(|(k, v)| (k.to_string(), v))
    .to_vec()
}
