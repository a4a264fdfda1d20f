//! Error of images over the time they take, for every method, against converged references.

use super::foreign::references;
use super::frames::frames;
use super::pictures::{Kept, pictures};
use super::reference::sees_specular;
use super::view::{ERROR, FIRST, FLIP, NEXT, SPP, View, pass1, settings, with_view};
use super::{Context, Measurements};
use crate::Result;
use crate::pipeline::Pass1;
use crate::radiosity::Solution;
use crate::render::{Estimator, Method, Quality, Settings};
use crate::report::record::{Chart, Figure, PARAMETER, Point, Subject, Unit};

pub fn run(context: &Context) -> Result<Measurements> {
    let mut found = Measurements::default();
    for name in ["cornell", "gallery"] {
        with_view(context, name, |(view, _)| scene(view, name, &mut found))?;
    }
    found.subjects.push(references(context)?);
    Ok(found)
}

fn scene(stage: &View, name: &str, found: &mut Measurements) -> Result<()> {
    let View { visibility, camera, reference, .. } = *stage;
    let mut subject = Subject::new(
        name,
        format!("{name}, {} x {} pixels", camera.size[0], camera.size[1]),
        "How wrong a picture is after how long, for every method. \"mesh\", \"direct\" and \"gather\" are the two-pass qualities: they \
         first solve the scene once (pass 1), then render frames from that solution (pass 2). \"path\" is path tracing, which starts \
         anew for every frame. The relative RMSE is the root mean squared error of the pixels over the mean of the reference; \
         pixels that see a lamp directly are left out.",
    );
    let kept = methods(stage, &mut subject)?;
    elements(stage, &mut subject)?;
    let floor = Some(("smallest error the reference tells".to_string(), reference.resolution));
    let floored = |mut chart: Chart| {
        chart.floor = floor.clone();
        chart
    };
    subject.charts.push(floored(
        Chart::new(
            "First frame: error over time",
            FIRST,
            ERROR,
            "Time from a loaded scene to the picture, pass 1 included. Along each line the samples a pixel grow (for \"mesh, finer \
             elements\" the elements). A two-pass line that goes flat has reached what its elements can show; path tracing has no \
             such floor.",
        )
        .guide("theory of random sampling: -1/2", -0.5),
    ));
    subject.charts.push(floored(
        Chart::new(
            "Following frames: error over time",
            NEXT,
            ERROR,
            "The same pictures when the solution of pass 1 is kept, as for the second and every later view of a scene.",
        )
        .only(&["mesh", "direct", "gather", "path"])
        .guide("theory of random sampling: -1/2", -0.5),
    ));
    subject.charts.push(
        Chart::new(
            "Following frames: perceived difference over time",
            NEXT,
            FLIP,
            "FLIP (Andersson et al. 2020) predicts how much of a difference one sees when the picture and the reference take turns on \
             a screen: 0 none, 1 as much as can be. It sees the reference's own noise, too, which sets its floor here.",
        )
        .only(&["mesh", "direct", "gather", "path"]),
    );
    subject.charts.push(floored(
        Chart::new(
            "Error over samples a pixel",
            PARAMETER,
            ERROR,
            "Independent random samples would give a slope of -1/2. A pixel's samples here are one low-discrepancy (Owen-scrambled \
             Sobol) sequence, which does better where the light varies smoothly over the pixel and no worse elsewhere. Slopes \
             nearer 0 tell of the floor that the elements set.",
        )
        .only(&["mesh", "direct", "gather", "path"])
        .fitted(&subject.series)
        .guide("random sampling: -1/2", -0.5),
    ));
    subject.notes.push(format!(
        "Reference: 2 x {} paths a pixel by this program's own path tracer; standard error {:.2} % (RMS over the pixels, relative to \
         the mean). Its two halves are independent, so their product tells errors down to {:.2} %.",
        reference.spp,
        100.0 * reference.standard_error,
        100.0 * reference.resolution
    ));
    subject.strips = pictures(stage, &subject, &kept, name)?;
    found.figures.extend(figures(name, &subject));
    found.subjects.push(subject);
    found.subjects.push(frames(stage, name)?);
    if visibility.scene().materials.iter().any(|m| m.is_specular() && !m.is_glass()) {
        found.subjects.push(lobes(stage, name)?);
    }
    Ok(())
}

/// Every method over its samples a pixel.
fn methods(stage: &View, subject: &mut Subject) -> Result<Vec<Kept>> {
    let context = stage.context;
    // Of the default samples, in sixteenths.
    let two_pass: &[u32] = context.choose(&[1, 4, 16], &[1, 4, 16, 64]);
    let path: &[u32] = context.choose(&[4, 16, 64, 256], &[1, 4, 16, 64, 256, 512]);
    let mut kept = Vec::new();
    let mask = &stage.reference.mask;
    let first = pass1(context, stage.visibility.scene());
    // Warm-up: both passes once, small.
    let (solution, _) = stage.solve(&Pass1 { rays: 64, ..first })?;
    stage.frame(&settings(Method::TwoPass(Quality::Gather), 1, 0), Some(&solution));
    for round in 0..context.choose(1, 2) {
        let seed = context.settings.seed.wrapping_add(round);
        (context.observer)(&format!("images: {}, seed {seed}", subject.name));
        let (solution, before) = stage.solve(&Pass1 { seed, ..first })?;
        let mut one =
            |name: &'static str, method, spp: u32, solution: Option<&Solution>, before| -> Result<()> {
                let frame = stage.frame(&settings(method, spp, seed), solution);
                stage.record(subject, (name, SPP, f64::from(spp)), &frame, before, mask)?;
                if round == 0 {
                    kept.push(Kept { series: name, spp, first: before + frame.seconds, image: frame.image });
                }
                Ok(())
            };
        for quality in Quality::ALL {
            let method = Method::TwoPass(quality);
            for share in two_pass {
                let spp = method.default_spp() * share / 16;
                one(quality.name(), method, spp, Some(&solution), before)?;
            }
        }
        for &spp in path {
            one("path", Method::Path, spp, None, 0.0)?;
        }
    }
    Ok(kept)
}

/// `mesh` over the size of its elements.
fn elements(stage: &View, subject: &mut Subject) -> Result<()> {
    let defaults = pass1(stage.context, stage.visibility.scene());
    let Some(size) = defaults.element_size else { return Ok(()) };
    let factors: &[f64] = stage.context.choose(&[4.0, 2.0], &[4.0, 2.0, 1.0, 0.5]);
    let seed = stage.context.settings.seed;
    (stage.context.observer)(&format!("images: {}, elements", subject.name));
    for factor in factors {
        let settings_of = Pass1 { element_size: Some(size * factor), seed, ..defaults };
        let (solution, seconds) = stage.solve(&settings_of)?;
        let frame = stage.frame(&settings(Method::TwoPass(Quality::Mesh), 16, seed), Some(&solution));
        let at = ("mesh, finer elements", "elements", solution.mesh.len() as f64);
        stage.record(subject, at, &frame, seconds, &stage.reference.mask)?;
    }
    Ok(())
}

/// Frustum and importance sampling of glossy lobes with equal numbers of rays, where the view meets glossy surfaces.
fn lobes(stage: &View, name: &str) -> Result<Subject> {
    let context = stage.context;
    let specular = sees_specular(stage.visibility, stage.camera);
    let mask: Vec<bool> = specular.iter().zip(&stage.reference.mask).map(|(a, b)| *a && *b).collect();
    let count = mask.iter().filter(|m| **m).count();
    let mut subject = Subject::new(
        &format!("{name}-lobes"),
        format!("{name}: two estimators of glossy reflection"),
        format!(
            "Only the {count} pixels that show glossy or mirroring surfaces. \"frustum\" is the estimator of the 1987 paper: a square \
             pyramid about the mirror direction, divided into n x n cells, one ray a cell. \"lobe\" is importance sampling of the \
             same lobe with the same number of rays. 4 samples a pixel, diffuse light by \"direct\" everywhere."
        ),
    );
    if count < 32 {
        subject.notes.push("too few such pixels: skipped".into());
        return Ok(subject);
    }
    let grids: &[u32] = context.choose(&[1, 2, 4], &[1, 2, 4, 8]);
    let (solution, before) = stage.solve(&pass1(context, stage.visibility.scene()))?;
    for round in 0..context.choose(2, 5) {
        let seed = context.settings.seed.wrapping_add(round);
        (context.observer)(&format!("images: {}, seed {seed}", subject.name));
        for &n in grids {
            for (series, estimator) in [("frustum", Estimator::Frustum(n)), ("lobe", Estimator::Lobe(n * n))]
            {
                let base = settings(Method::TwoPass(Quality::Direct), 4, seed);
                let frame = stage.frame(&Settings { estimator, ..base }, Some(&solution));
                let at = (series, "rays over the lobe", f64::from(n * n));
                stage.record(&mut subject, at, &frame, before, &mask)?;
            }
        }
    }
    subject.charts.push(Chart::new(
        "Following frames: error over time",
        NEXT,
        ERROR,
        "Along each line the rays over a lobe grow. Where both lines flatten, the diffuse light seen in the reflection limits the \
         picture, not the lobe. The frustum keeps a small error of its own: it leaves out 1 % of the lobe's weight.",
    ));
    Ok(subject)
}

/// Seconds that `path` needs for a given error, interpolated between its points on logarithmic axes, or beyond them with
/// the slope -1/2.
fn path_seconds(subject: &Subject, round: usize, error: f64) -> Option<f64> {
    let path = subject.series.iter().find(|s| s.name == "path")?;
    let at = |p: &Point, q: &str| p.get(q).and_then(|m| m.samples.get(round)).copied();
    let known: Vec<(f64, f64)> = path
        .points
        .iter()
        .filter_map(|p| Some((at(p, ERROR)?, at(p, NEXT)?)))
        .filter(|p| p.0 > 0.0)
        .collect();
    let last = *known.last()?;
    if error < last.0 {
        return Some(last.1 * (last.0 / error).powi(2));
    }
    let pair = known.windows(2).find(|w| error <= w[0].0 && error >= w[1].0)?;
    let t = (error / pair[0].0).ln() / (pair[1].0 / pair[0].0).ln();
    Some(pair[0].1 * (pair[1].1 / pair[0].1).powf(t))
}

/// How much faster than path tracing the two-pass method is at its own error.
fn figures(name: &str, subject: &Subject) -> Vec<Figure> {
    let spp = Method::TwoPass(Quality::Gather).default_spp();
    let Some(gather) = subject.series.iter().find(|s| s.name == "gather") else { return Vec::new() };
    let Some(point) = gather.points.iter().find(|p| p.parameter == f64::from(spp)) else { return Vec::new() };
    let samples = |q: &str| point.get(q).map(|m| m.samples.clone()).unwrap_or_default();
    let errors = samples(ERROR);
    let ratio = |quantity: &str| -> Vec<f64> {
        let own = samples(quantity);
        let pairs = errors.iter().zip(&own).enumerate();
        pairs.filter_map(|(k, (e, s))| Some(path_seconds(subject, k, *e)? / s)).collect()
    };
    let figure = |label: String, unit, samples: Vec<f64>| Figure { label, unit, samples };
    let mut list = vec![figure(
        format!("relative RMSE of {name} by gather, {spp} samples a pixel"),
        Unit::Share,
        errors.clone(),
    )];
    for (quantity, frame) in [(FIRST, "the first frame"), (NEXT, "a following frame")] {
        let label = format!(
            "times faster than path tracing to the same error: {name}, {frame}, gather, {spp} samples a pixel"
        );
        list.push(figure(label, Unit::Plain, ratio(quantity)));
    }
    list.retain(|f| !f.samples.is_empty());
    list
}
