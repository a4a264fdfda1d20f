//! `twopass solve`.

use super::args::SolveArgs;
use super::progress::Progress;
use super::render::{of_element_size, pass1, pass1_of, quality, reads, tell_adapted, tell_factors};
use super::{check_outputs, spare_inputs};
use crate::embree::Device;
use crate::emitters::Emitters;
use crate::medium;
use crate::output::write_whole;
use crate::pipeline::{self, Stage};
use crate::render::Method;
use crate::report::{Pass1Report, Report, Versions};
use crate::scene::load;
use crate::visibility::Visibility;
use crate::{Error, Result};

pub fn run(args: &SolveArgs) -> Result<()> {
    if args.output.extension().is_none_or(|e| e != "npz") {
        return Err(Error::Usage(format!("{}: a solution is written as .npz", args.output.display())));
    }
    let outputs = [&args.output].into_iter().chain(&args.report);
    check_outputs([&args.scene], outputs.clone())?;
    let progress = Progress::new(args.common.quiet);
    let observer = &|e| progress.tell(e);
    let mut stages: Vec<Stage> = Vec::new();
    let scene = pipeline::stage("load", 0, observer, &mut stages, || (load(&args.scene), 0))?;
    spare_inputs(&scene.files, outputs)?;
    scene.warnings.iter().for_each(|w| progress.warn(w));
    let settings = pass1(&args.pass1, &scene, args.common.seed);
    let quality = quality(args.quality, &scene);
    let reads = reads(&args.adaptive, &scene, Method::TwoPass(quality));
    if args.quality.is_some() && reads.is_none() {
        return Err(Error::Usage(
            "--quality is what --adaptive refines for: a solution of uniform elements suits every quality"
                .into(),
        ));
    }
    let device = Device::new(rayon::current_num_threads())?;
    let visibility =
        pipeline::stage("build", 0, observer, &mut stages, || (Visibility::new(&device, &scene), 0))?;
    let emitters = Emitters::new(&visibility);
    let limit = args.memory.limit();
    let cameras = scene.view_points();
    let what = (&visibility, &emitters, &cameras[..]);
    let (mut result, adapted) = pass1_of(what, (&settings, reads), limit, observer, &mut stages)
        .map_err(|e| of_element_size(&args.pass1.elements, &scene, e))?;
    tell_factors(&progress, &result);
    result.warnings.splice(0..0, medium::warnings(&visibility));
    result.warnings.iter().for_each(|w| progress.warn(w));
    let versions = Versions::new(&device);
    let mut pass1 = Pass1Report::new(&settings, &result);
    pass1.adaptive = adapted;
    tell_adapted(&progress, &pass1);
    let about = [
        ("settings".into(), serde_json::json!(settings)),
        ("versions".into(), serde_json::json!(versions)),
        ("pass1".into(), serde_json::json!(pass1)),
        ("adaptive".into(), serde_json::json!(reads.is_some())),
        // Uniform elements suit every quality.
        ("quality".into(), serde_json::json!(reads.map(|_| quality.name()))),
    ];
    pipeline::stage("write", 0, observer, &mut stages, || {
        let bytes = result.solution.to_npz(&scene, about.into_iter().collect());
        (bytes.and_then(|b| write_whole(&args.output, &b)), 0)
    })?;
    let warnings = scene.warnings.iter().chain(&result.warnings).cloned().collect();
    let mut report = Report::new(&scene, versions, args.common.seed, stages, warnings);
    report.elements = pass1.elements;
    report.pass1 = Some(pass1);
    if let Some(path) = &args.report {
        report.write(path)?;
    }
    Ok(())
}
