//! `twopass render`.

use super::args::{EstimatorArg, MethodArg, Pass1Args, QualityArg, RenderArgs};
use super::check_outputs;
use super::progress::Progress;
use crate::embree::Device;
use crate::emitters::Emitters;
use crate::image::{self, WriteOptions};
use crate::memory::Factors;
use crate::pipeline::{self, Pass1, Pass1Result, Stage};
use crate::render::{Estimator, Method, Quality, Settings, render, render_directional};
use crate::report::{Pass1Report, Report, Versions, command_line};
use crate::scene::{Scene, load};
use crate::visibility::Visibility;
use crate::{Error, Result};

pub fn run(args: &RenderArgs) -> Result<()> {
    for output in &args.output {
        image::supported(output)?;
    }
    check_outputs(&args.scene, args.output.iter().chain(&args.report))?;
    if !args.exposure.is_finite() {
        return Err(Error::Usage("--exposure must be a finite number".into()));
    }
    let progress = Progress::new(args.common.quiet);
    let observer = &|e| progress.tell(e);
    let mut stages: Vec<Stage> = Vec::new();
    let scene = pipeline::stage("load", 0, observer, &mut stages, || (load(&args.scene), 0))?;
    let mut warnings = scene.warnings.clone();
    scene.warnings.iter().for_each(|w| progress.warn(w));
    let mut camera = scene.camera(args.camera.as_deref())?.clone();
    camera.size = args.size.unwrap_or(camera.size);
    let settings = settings(args, &scene);

    let device = Device::new(rayon::current_num_threads())?;
    let visibility =
        pipeline::stage("build", 0, observer, &mut stages, || (Visibility::new(&device, &scene), 0))?;
    let emitters = Emitters::new(&visibility);
    pipeline::require_light(&scene, &emitters)?;
    let pass1_settings = pass1(&args.pass1, &scene, args.common.seed);
    let cameras = std::slice::from_ref(&camera);
    let pixels = u64::from(camera.size[0]) * u64::from(camera.size[1]);
    let advance = |n| progress.tell(pipeline::Event::Advance(n));
    let mut pass1 = None;
    let (picture, elements) = if args.method == MethodArg::Directional {
        let what = (&pass1_settings, args.directions);
        let solution =
            pipeline::solve_directional(&visibility, &emitters, cameras, what, observer, &mut stages)?;
        progress.line(&format!(
            "{} elements, {} directional values, {:.1} MiB, {} iterations",
            solution.elements(),
            solution.directional_values(),
            solution.bytes / f64::from(1 << 20),
            solution.iterations
        ));
        let picture = pipeline::stage("trace", pixels, observer, &mut stages, || {
            let samples = (settings.spp, settings.seed);
            render_directional(&visibility, &emitters, &solution, &camera, samples, &advance)
        });
        (picture, solution.elements())
    } else {
        if matches!(settings.method, Method::TwoPass(_) | Method::Radiosity) {
            let (limit, settings) = (args.memory.limit(), &pass1_settings);
            let result = pipeline::solve_within(
                limit,
                &visibility,
                &emitters,
                cameras,
                settings,
                observer,
                &mut stages,
            )?;
            tell_factors(&progress, &result);
            result.warnings.iter().for_each(|w| progress.warn(w));
            warnings.extend(result.warnings.iter().cloned());
            pass1 = Some(result);
        }
        let solution = pass1.as_ref().map(|p| &p.solution);
        let picture = pipeline::stage("trace", pixels, observer, &mut stages, || {
            render(&visibility, &emitters, solution, &camera, &settings, &advance)
        });
        (picture, solution.map_or(0, |s| s.mesh.len()))
    };

    let versions = Versions::new(&device);
    let options = WriteOptions { exposure: args.exposure, metadata: metadata(args, &versions, &settings) };
    pipeline::stage("write", 0, observer, &mut stages, || {
        (args.output.iter().try_for_each(|output| image::write(&picture, output, &options)), 0)
    })?;
    let mut report = Report::new(&scene, versions, args.common.seed, stages, warnings);
    report.elements = elements;
    if let Some(result) = &pass1 {
        let pass1 = Pass1Report::new(&pass1_settings, result);
        progress.line(&format!(
            "{} elements of at most {:.4} m, standard error {:.2} %, energy residual {:.2} %",
            pass1.elements,
            pass1.element_size,
            100.0 * pass1.standard_errors.relative_rms,
            100.0 * pass1.energy.residual.abs().max_element()
        ));
        report.pass1 = Some(pass1);
    }
    if let Some(path) = &args.report {
        report.write(path)?;
    }
    Ok(())
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

/// Settings of pass 1: the command line over the scene file over the defaults.
pub fn pass1(args: &Pass1Args, scene: &Scene, seed: u32) -> Pass1 {
    let mut settings = Pass1::of(scene);
    settings.seed = seed;
    if let Some(rays) = args.rays {
        settings.rays = rays;
    }
    if let Some(size) = args.element_size {
        settings.element_size = Some(size * scene.unit);
    }
    settings
}

fn settings(args: &RenderArgs, scene: &Scene) -> Settings {
    let quality = match (args.quality, scene.render.quality.as_deref()) {
        (Some(QualityArg::Mesh), _) | (None, Some("mesh")) => Quality::Mesh,
        (Some(QualityArg::Direct), _) | (None, Some("direct")) => Quality::Direct,
        _ => Quality::Gather,
    };
    let method = match args.method {
        // Directional radiosity has no settings of pass 2 but its samples.
        MethodArg::TwoPass | MethodArg::Directional => Method::TwoPass(quality),
        MethodArg::Radiosity => Method::Radiosity,
        MethodArg::Whitted => Method::Whitted,
        MethodArg::Path => Method::Path,
    };
    let default_spp = if method == Method::Path { 256 } else { 16 };
    Settings {
        method,
        spp: args.spp.or(scene.render.spp).unwrap_or(default_spp),
        gather_rays: args.gather_rays,
        emitter_samples: args.emitter_samples,
        estimator: match args.lobe {
            EstimatorArg::Frustum => Estimator::Frustum(args.frustum_grid),
            EstimatorArg::Lobe => Estimator::Lobe(args.lobe_rays),
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
