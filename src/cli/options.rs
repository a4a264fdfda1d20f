//! Which options go together: what cannot be done is refused before any work, and what has no effect is named.

use super::args::{
    EnforceArg, EstimatorArg, FactorMethodArg, FormFactorArgs, MethodArg, MirrorArg, RenderArgs, ViewArg,
};
use super::form_factors::{Format, is_stdout};
use crate::render::Quality;
use crate::{Error, Result, image};
use clap::ValueEnum;
use std::path::PathBuf;

/// Most pixels along the top of a hemi-cube that is looked at.
const MOST_VIEW_PIXELS: u32 = 1024;

/// Refuses what `render` cannot do together.
pub fn of_render(args: &RenderArgs) -> Result<()> {
    let refuse = |message: &str| Err(Error::Usage(message.into()));
    if args.exposure.is_some_and(|e| !e.is_finite()) {
        return refuse("--exposure must be a finite number");
    }
    if args.solution.is_some() && !matches!(args.method, MethodArg::TwoPass | MethodArg::Radiosity) {
        return refuse("--solution is for --method two-pass and radiosity: others have no pass 1");
    }
    if args.error.is_some() && args.method != MethodArg::TwoPass {
        return refuse("--error is for --method two-pass");
    }
    if args.adaptive.adaptive == Some(true)
        && !matches!(args.method, MethodArg::TwoPass | MethodArg::Radiosity)
    {
        return refuse("--adaptive is for --method two-pass and radiosity");
    }
    Ok(())
}

/// Options of `render` that have no effect with the others, at this quality, which the scene file may say, or in a scene that has no
/// `glossy` surface: a warning for each.
pub fn idle_of_render(args: &RenderArgs, quality: Quality, glossy: bool) -> Vec<String> {
    use MethodArg::{Directional, Radiosity, TwoPass, Whitted};
    // What has elements, what solves for light within memory, and what samples emitters and lobes anew at each surface.
    let (divide, solve, shade) =
        (&[TwoPass, Radiosity, Directional][..], &[TwoPass, Radiosity][..], &[TwoPass, Whitted][..]);
    let given = [
        ("--rays", args.pass1.rays.is_some(), divide),
        ("--element-size", args.pass1.elements.element_size.is_some(), divide),
        ("--max-memory", args.memory.max_memory.is_some(), solve),
        ("--quality", args.quality.is_some(), &[TwoPass]),
        ("--gather-rays", args.gather_rays.is_some(), &[TwoPass]),
        ("--emitter-samples", args.emitter_samples.is_some(), shade),
        ("--lobe", args.lobe.is_some(), shade),
        ("--lobe-rays", args.lobe_rays.is_some(), shade),
        ("--frustum-grid", args.frustum_grid.is_some(), shade),
        ("--directions", args.directions.is_some(), &[Directional]),
    ];
    let name = |m: &MethodArg| m.to_possible_value().map(|v| v.get_name().to_string()).unwrap_or_default();
    let other_method = |(option, _, methods): &(&str, bool, &[MethodArg])| {
        let methods: Vec<String> = methods.iter().map(name).collect();
        format!(
            "{option} has no effect with --method {}: it is for {}",
            name(&args.method),
            methods.join(", ")
        )
    };
    let idle = given.iter().filter(|(_, given, methods)| *given && !methods.contains(&args.method));
    let mut idle: Vec<String> = idle.map(other_method).collect();
    let shades = shade.contains(&args.method);
    let frustum = args.lobe == Some(EstimatorArg::Frustum);
    if shades && !glossy {
        let lobes = [
            ("--lobe", args.lobe.is_some()),
            ("--lobe-rays", args.lobe_rays.is_some()),
            ("--frustum-grid", args.frustum_grid.is_some()),
        ];
        let names: Vec<_> = lobes.iter().filter(|l| l.1).map(|l| l.0).collect();
        if let [first, others @ ..] = &names[..] {
            let names = others.iter().fold(first.to_string(), |all, name| format!("{all}, {name}"));
            let verb = if others.is_empty() { "has" } else { "have" };
            idle.push(format!("{names} {verb} no effect: the scene has no glossy surface"));
        }
    }
    if shades && frustum && args.lobe_rays.is_some() {
        idle.push("--lobe-rays has no effect with --lobe frustum: that has --frustum-grid".into());
    }
    if shades && !frustum && args.frustum_grid.is_some() {
        idle.push("--frustum-grid has no effect without --lobe frustum".into());
    }
    if args.method == TwoPass && args.gather_rays.is_some() && quality != Quality::Gather {
        idle.push(format!(
            "--gather-rays has no effect at quality {}: it is for --quality gather",
            quality.name()
        ));
    }
    if args.exposure.is_some() && !args.output.iter().any(|o| image::has_exposure(o)) {
        idle.push("--exposure has no effect on images that hold radiance: it is for .png and .jpg".into());
    }
    idle
}

/// Options of `form-factors` that have no effect with the others: a warning for each.
pub fn idle_of_form_factors(args: &FormFactorArgs) -> Vec<String> {
    let rays = args.pass1.rays.is_some();
    let viewed = args.view.is_some();
    let idle = [
        (viewed && rays, "--rays has no effect with --view, which finds no factors"),
        (viewed && args.error.is_some(), "--error has no effect with --view, which finds no factors"),
        (
            viewed && args.method != FactorMethodArg::Ray,
            "--method has no effect with --view, which finds no factors",
        ),
        (
            !viewed && rays && args.method == FactorMethodArg::Analytic,
            "--rays has no effect with --method analytic, whose factors are exact",
        ),
        (
            args.floor.is_some() && args.error.is_none(),
            "--floor has no effect without --error: it is the smallest factor that has that error",
        ),
    ];
    idle.iter().filter(|i| i.0).map(|i| i.1.into()).collect()
}

/// Refuses what `form-factors` cannot do together.
pub fn of_form_factors(args: &FormFactorArgs, outputs: &[(PathBuf, Format)]) -> Result<()> {
    let refuse = |message: &str| Err(Error::Usage(message.into()));
    let h = &args.hemicube;
    let view_cube = args.view.is_some() && args.view_as == ViewArg::Hemicube;
    if args.method != FactorMethodArg::Hemicube {
        let given = [
            ("--resolution", h.resolution.is_some() && !view_cube),
            ("--hemicube-grid", h.hemicube_grid.is_some()),
            ("--rotate", h.rotate.is_some()),
            ("--hemicube-errors", h.hemicube_errors),
        ];
        if let Some((option, _)) = given.iter().find(|g| g.1) {
            return Err(Error::Usage(format!("{option} belongs to --method hemicube")));
        }
    } else if args.pass1.rays.is_some() {
        return refuse(
            "--method hemicube casts no rays: use --resolution and --hemicube-grid instead of --rays",
        );
    }
    if args.method == FactorMethodArg::Analytic && (args.two_sided || args.rows.is_some()) {
        return refuse("--method analytic finds all rows of the fronts: leave out --rows and --two-sided");
    }
    let plain = args.method == FactorMethodArg::Ray && args.mirror == MirrorArg::None;
    if args.error.is_some() && (!plain || args.two_sided || args.rows.is_some()) {
        return refuse("--error belongs to --method ray without --mirror, --two-sided and --rows");
    }
    if args.method != FactorMethodArg::Ray && args.mirror != MirrorArg::None {
        return refuse("--mirror belongs to --method ray");
    }
    if args.mirror == MirrorArg::Image && args.rows.is_some() {
        return refuse("--mirror image finds all rows: leave out --rows, or use --mirror chain");
    }
    if h.hemicube_errors && args.report.is_none() {
        return refuse("--hemicube-errors are written to a report: add --report FILE.json");
    }
    if args.rows.is_some() && args.enforce != EnforceArg::None {
        return refuse("--enforce moves all rows together: leave out --rows");
    }
    if args.rows.is_some() && outputs.iter().any(|o| o.1 == Format::View3d) {
        return refuse("View3D's format holds all rows: leave out --rows, or write .npz, .csv or .json");
    }
    if args.view.is_some() {
        if h.resolution.is_some_and(|n| n > MOST_VIEW_PIXELS) {
            return Err(Error::Usage(format!(
                "--view unfolds a hemi-cube of {MOST_VIEW_PIXELS} pixels at most: lower --resolution"
            )));
        }
        if args.by_object || args.rows.is_some() || args.enforce != EnforceArg::None {
            return refuse(
                "--view draws one element's view and no matrix: leave out --by-object, --rows and --enforce",
            );
        }
        if let Some((path, _)) = outputs.iter().find(|o| o.1 != Format::Picture) {
            return Err(Error::Usage(format!(
                "{}: --view draws a picture; write .png, .exr, .tif or .jpg",
                path.display()
            )));
        }
    }
    if outputs.iter().filter(|o| is_stdout(&o.0)).count() > 1 {
        return refuse("-o -: standard output is given twice");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::args::{Args, Command};
    use super::*;
    use clap::Parser;

    fn parsed(options: &str) -> RenderArgs {
        let words = "twopass render s.toml -o a.exr".split(' ').chain(options.split_whitespace());
        match Args::try_parse_from(words).expect(options).command {
            Command::Render(args) => args,
            _ => unreachable!("render was asked for"),
        }
    }

    #[test]
    fn lobes_need_a_glossy_surface() {
        let said = |options: &str| idle_of_render(&parsed(options), Quality::Mesh, false);
        assert_eq!(said("--lobe frustum"), ["--lobe has no effect: the scene has no glossy surface"]);
        assert_eq!(said("--lobe-rays 9"), ["--lobe-rays has no effect: the scene has no glossy surface"]);
        let both = "--lobe, --frustum-grid have no effect: the scene has no glossy surface";
        assert_eq!(said("--lobe frustum --frustum-grid 9"), [both]);
        assert_eq!(said(""), [""; 0]);
    }

    fn idle(options: &str) -> Vec<String> {
        let args = parsed(options);
        of_render(&args).expect(options);
        idle_of_render(&args, Quality::Mesh, true)
    }

    #[test]
    fn options_without_effect_are_named() {
        let options = [
            ("--rays 9", "two-pass radiosity directional"),
            ("--element-size 9", "two-pass radiosity directional"),
            ("--max-memory 1G", "two-pass radiosity"),
            ("--quality mesh", "two-pass"),
            ("--emitter-samples 9", "two-pass whitted"),
            ("--lobe lobe", "two-pass whitted"),
            ("--lobe-rays 9", "two-pass whitted"),
            ("--lobe frustum", "two-pass whitted"),
            ("--directions 9", "directional"),
            ("--spp 9", "two-pass radiosity whitted path directional"),
        ];
        for (option, methods) in options {
            for method in ["two-pass", "radiosity", "whitted", "path", "directional"] {
                let said = idle(&format!("{option} --method {method}"));
                let reads = methods.split(' ').any(|m| m == method);
                assert_eq!(said.is_empty(), reads, "{option} --method {method}: {said:?}");
                let name = option.split(' ').next().unwrap_or_default();
                let whom = format!("{name} has no effect with --method {method}: it is for");
                assert!(reads || said.len() == 1 && said[0].starts_with(&whom), "{said:?}");
            }
        }
        for (options, parts) in [
            ("--gather-rays 9", ["--gather-rays", "quality mesh"]),
            ("--frustum-grid 9", ["--frustum-grid", "--lobe frustum"]),
            ("--lobe lobe --frustum-grid 9", ["--frustum-grid", "--lobe frustum"]),
            ("--lobe frustum --lobe-rays 9", ["--lobe-rays", "--lobe frustum"]),
            ("--exposure 1", ["--exposure", ".png"]),
            ("--exposure 1 -o b.tif -o c.hdr", ["--exposure", ".png"]),
        ] {
            let said = idle(options);
            assert!(said.len() == 1 && parts.iter().all(|p| said[0].contains(p)), "{options}: {said:?}");
        }
        assert!(idle("--exposure 1 -o b.JPG").is_empty());
    }
}
