//! `twopass form-factors`.

use super::args::{FactorMethodArg, FormFactorArgs, MirrorArg};
use super::check_outputs;
use super::progress::Progress;
use super::render::pass1;
use crate::embree::Device;
use crate::form_factor::{Casting, ObjectTable, cast, cast_images};
use crate::mesh::{Mesh, Sides, default_element_size};
use crate::output::write_whole;
use crate::pipeline::{self, Event, Stage};
use crate::report::{FactorReport, Report, Versions};
use crate::scene::load;
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::io::Write;
use std::time::Instant;

/// Independent randomisations: enough that four standard errors hold almost always (15 degrees of freedom).
const BATCHES: u32 = 16;

pub fn run(args: &FormFactorArgs) -> Result<()> {
    let FactorMethodArg::Ray = args.method;
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
    let size = settings.element_size.unwrap_or_else(|| default_element_size(&scene));
    let start = Instant::now();
    let sides = if args.mirror == MirrorArg::None {
        Sides::fronts(&scene)
    } else {
        Sides::fronts(&scene).without_purely_specular(&scene)
    };
    let mesh = Mesh::new(&scene, &sides, size, true)?;
    let matrix = pipeline::stage("form-factors", mesh.len() as u64, observer, &mut stages, || {
        let advance = |n| progress.tell(Event::Advance(n));
        if args.mirror == MirrorArg::Image {
            let work = (settings.rays, BATCHES);
            let matrix = cast_images(&visibility, &mesh, work, settings.seed, &advance);
            let rays = matrix.as_ref().map_or(0, |m| m.rays);
            return (matrix, rays);
        }
        let casting = Casting {
            rays: settings.rays,
            batches: BATCHES,
            seed: settings.seed,
            specular: args.mirror == MirrorArg::Chain,
            reached: None,
            emitters: None,
            progress: &advance,
        };
        let (matrix, _) = cast(&visibility, &mesh, &casting);
        let rays = matrix.rays;
        (Ok(matrix), rays)
    })?;
    let seconds = start.elapsed().as_secs_f64();
    pipeline::stage("write", 0, observer, &mut stages, || {
        (write(args, to_stdout, &scene, &mesh, &matrix, seconds), 0)
    })?;
    if let Some(path) = &args.report {
        let mut report =
            Report::new(&scene, Versions::new(&device), args.common.seed, stages, scene.warnings.clone());
        report.elements = mesh.len();
        report.form_factors = Some(FactorReport::new(&scene, &mesh, &matrix));
        report.write(path)?;
    }
    Ok(())
}

fn write(
    args: &FormFactorArgs,
    to_stdout: bool,
    scene: &crate::scene::Scene,
    mesh: &Mesh,
    matrix: &crate::form_factor::ExchangeMatrix,
    seconds: f64,
) -> Result<()> {
    if !args.by_object {
        return write_whole(&args.output, &matrix.to_npz()?);
    }
    let table = ObjectTable::new(scene, mesh, matrix, seconds);
    let text = serde_json::to_string(&table).map_err(|e| Error::parse(&args.output, None, e.to_string()))?;
    if to_stdout {
        // A closed pipe is the reader's choice, but it must not look like success.
        let mut out = std::io::stdout();
        let written = writeln!(out, "{text}").and_then(|()| out.flush());
        return written.map_err(|e| Error::io("standard output", e));
    }
    write_whole(&args.output, format!("{text}\n").as_bytes())
}
