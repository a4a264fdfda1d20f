//! `twopass form-factors`.

use super::args::{FactorMethodArg, FormFactorArgs};
use super::check_outputs;
use super::progress::Progress;
use super::render::pass1;
use crate::embree::Device;
use crate::form_factor::{Found, Request, estimate, unoccluded};
use crate::mesh::{Mesh, Sides, default_element_size};
use crate::output::write_whole;
use crate::pipeline::{self, Event, Stage};
use crate::report::{FactorReport, Report, Versions};
use crate::scene::load;
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::io::Write;
use std::time::Instant;

pub fn run(args: &FormFactorArgs) -> Result<()> {
    let to_stdout = args.output.as_os_str() == "-";
    let extension = args.output.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match (to_stdout, extension.as_str(), args.by_object) {
        (true, _, true) | (false, "json", true) | (false, "npz", false) => {}
        (true, _, false) | (false, "json", false) => {
            return Err(Error::Usage(
                "JSON holds one row an object: add --by-object, or write -o F.npz".into(),
            ));
        }
        (false, "npz", true) => {
            return Err(Error::Usage(
                "--by-object is written as JSON: -o F.json, or -o - for standard output".into(),
            ));
        }
        _ => return Err(Error::Usage(format!("{}: write .json or .npz", args.output.display()))),
    }
    let file = (!to_stdout).then_some(&args.output);
    check_outputs(&args.scene, file.into_iter().chain(&args.report))?;
    let progress = Progress::new(args.common.quiet);
    let observer = &|e| progress.tell(e);
    let mut stages: Vec<Stage> = Vec::new();
    let scene = pipeline::stage("load", 0, observer, &mut stages, || (load(&args.scene), 0))?;
    scene.warnings.iter().for_each(|w| progress.warn(w));
    let settings = pass1(&args.pass1, &scene, args.common.seed);
    let device = Device::new(rayon::current_num_threads())?;
    let visibility =
        pipeline::stage("build", 0, observer, &mut stages, || (Visibility::new(&device, &scene), 0))?;
    let asked = settings.element_size;
    let start = Instant::now();
    let fronts = Sides::fronts(&scene);
    let elements = |size: f64| Mesh::new(&scene, &fronts, size, true);
    // Factors between objects do not depend on elements: whole faces are exact and few.
    let whole = args.by_object && asked.is_none() && args.method == FactorMethodArg::Analytic;
    let mesh = elements(asked.unwrap_or(if whole { f64::MAX } else { default_element_size(&scene) }))?;
    let advance = |n| progress.tell(Event::Advance(n));
    let factors = pipeline::stage("form-factors", mesh.len() as u64, observer, &mut stages, || {
        let factors = match args.method {
            FactorMethodArg::Ray => {
                let request = Request {
                    rays: settings.rays,
                    error: args.error,
                    floor: args.floor,
                    by_object: args.by_object,
                    seed: settings.seed,
                    progress: &advance,
                };
                Ok(estimate(&visibility, &mesh, &request))
            }
            FactorMethodArg::Analytic => unoccluded(&visibility, &mesh, settings.seed, &advance),
        };
        let rays = factors.as_ref().map_or(0, |f| f.rays);
        (factors, rays)
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let mut warnings = scene.warnings.clone();
    warnings.extend(factors.warnings(&scene, args.error));
    warnings[scene.warnings.len()..].iter().for_each(|w| progress.warn(w));
    factors.lines(args.floor).iter().for_each(|l| progress.line(l));
    pipeline::stage("write", 0, observer, &mut stages, || {
        (write(args, to_stdout, &scene, &mesh, &factors, seconds), 0)
    })?;
    if let Some(path) = &args.report {
        let mut report = Report::new(&scene, Versions::new(&device), args.common.seed, stages, warnings);
        report.elements = mesh.len();
        report.form_factors = Some(FactorReport::new(&scene, &mesh, &factors));
        report.write(path)?;
    }
    Ok(())
}

fn write(
    args: &FormFactorArgs,
    to_stdout: bool,
    scene: &crate::scene::Scene,
    mesh: &Mesh,
    factors: &Found,
    seconds: f64,
) -> Result<()> {
    if !args.by_object {
        return write_whole(&args.output, &factors.to_npz()?);
    }
    let table = factors.table(scene, mesh, seconds);
    let text = serde_json::to_string(&table).map_err(|e| Error::parse(&args.output, None, e.to_string()))?;
    if to_stdout {
        // A closed pipe is the reader's choice, but it must not look like success.
        let mut out = std::io::stdout();
        let written = writeln!(out, "{text}").and_then(|()| out.flush());
        return written.map_err(|e| Error::io("standard output", e));
    }
    write_whole(&args.output, format!("{text}\n").as_bytes())
}
