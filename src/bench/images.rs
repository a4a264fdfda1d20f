//! Error of images over the time they take, for every method, against converged references.

use super::record::{Chart, Figure, PARAMETER, Picture, Strip, Subject, Unit};
use super::reference::{Reference, path_settings, reference, sees_specular};
use super::{Context, Measurements, embedded};
use crate::color;
use crate::emitters::Emitters;
use crate::image::{
    Comparison, Image, error_within, png, read_exr, read_mask_npy, relative_rmse_halves,
    relative_rmse_of_halves, signed_difference, srgb_bytes,
};
use crate::pipeline::{self, Pass1};
use crate::radiosity::Solution;
use crate::render::{Estimator, Method, Quality, Settings, render};
use crate::scene::{Camera, load};
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::path::Path;
use std::time::Instant;

const FIRST: &str = "first frame";
const NEXT: &str = "following frame";
const ERROR: &str = "relative RMSE";
const SPP: &str = "samples a pixel";

const QUALITIES: [(&str, Quality); 3] =
    [("mesh", Quality::Mesh), ("direct", Quality::Direct), ("gather", Quality::Gather)];

pub fn run(context: &Context) -> Result<Measurements> {
    let mut found = Measurements::default();
    for name in ["cornell", "gallery"] {
        scene(context, name, &mut found)?;
    }
    found.subjects.push(references(context)?);
    Ok(found)
}

fn settings(method: Method, spp: u32, seed: u32) -> Settings {
    match method {
        Method::Path => path_settings(spp, seed),
        _ => {
            Settings { method, spp, gather_rays: 32, emitter_samples: 4, estimator: Estimator::Lobe(4), seed }
        }
    }
}

/// One scene, ready to be rendered over and over.
struct Stage<'a, 's> {
    context: &'a Context<'a>,
    visibility: &'a Visibility<'s>,
    emitters: &'a Emitters,
    camera: &'a Camera,
    reference: &'a Reference,
}

/// A frame and what it cost.
struct Frame {
    image: Image,
    seconds: f64,
    rays: u64,
}

impl Stage<'_, '_> {
    fn frame(&self, settings: &Settings, solution: Option<&Solution>) -> Frame {
        let start = Instant::now();
        let (image, rays) = render(self.visibility, self.emitters, solution, self.camera, settings, &|_| ());
        Frame { image, seconds: start.elapsed().as_secs_f64(), rays }
    }

    /// Pass 1 with its wall time \[s\].
    fn solve(&self, pass1: &Pass1) -> Result<(Solution, f64)> {
        let start = Instant::now();
        let cameras = std::slice::from_ref(self.camera);
        let stages = &mut Vec::new();
        let solved = pipeline::solve(self.visibility, self.emitters, cameras, pass1, &|_| (), stages)?;
        Ok((solved.solution, start.elapsed().as_secs_f64()))
    }

    fn compare(&self, image: &Image, mask: &[bool]) -> Result<Comparison> {
        let [a, b] = &self.reference.halves;
        relative_rmse_halves(image, a, b, Some(mask))
    }

    /// Adds a frame's time and error to a point; `pass1` is the time before the first frame.
    fn record(
        &self,
        subject: &mut Subject,
        (series, parameter, at): (&str, &str, f64),
        frame: &Frame,
        pass1: f64,
        mask: &[bool],
    ) -> Result<()> {
        let c = self.compare(&frame.image, mask)?;
        let point = subject.series(series, parameter).at(at);
        point.push(FIRST, Unit::Seconds, pass1 + frame.seconds);
        point.push(NEXT, Unit::Seconds, frame.seconds);
        point.push(ERROR, Unit::Share, c.relative_rmse);
        point.push("standard error", Unit::Share, c.standard_error);
        point.push("bias", Unit::Share, c.mean_bias);
        point.push("rays of a frame", Unit::Count, frame.rays as f64);
        let error = point.summary(ERROR).map_or(0.0, |s| s.median);
        point.unresolved = error < self.reference.resolution;
        Ok(())
    }
}

fn scene(context: &Context, name: &str, found: &mut Measurements) -> Result<()> {
    let scene = embedded(name)?;
    let width = context.choose(64, 192);
    let mut camera = scene.camera(None)?.clone();
    camera.size = [width, width * camera.size[1] / camera.size[0]];
    let visibility = Visibility::new(context.device, &scene)?;
    let emitters = Emitters::new(&scene);
    let reference = reference(context, &visibility, &emitters, &camera, context.choose(1024, 2048))?;
    let stage = Stage {
        context,
        visibility: &visibility,
        emitters: &emitters,
        camera: &camera,
        reference: &reference,
    };
    let mut subject = Subject::new(
        name,
        format!("{name}, {} x {} pixels", camera.size[0], camera.size[1]),
        "How wrong a picture is after how long, for every method. \"mesh\", \"direct\" and \"gather\" are the two-pass qualities: they \
         first solve the scene once (pass 1), then render frames from that solution (pass 2). \"path\" is path tracing, which starts \
         anew for every frame. The relative RMSE is the root mean squared error of the pixels over the mean of the reference; \
         pixels that see a lamp directly are left out.",
    );
    let kept = methods(&stage, &mut subject)?;
    let defaults = Pass1::of(&scene);
    elements(&stage, &mut subject, &defaults)?;
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
        .guide("theory of random sampling: -1/2", -0.5),
    ));
    let sampled: Vec<_> = subject.series.iter().filter(|s| s.parameter == SPP).cloned().collect();
    subject.charts.push(floored(
        Chart::new(
            "Error over samples a pixel",
            PARAMETER,
            ERROR,
            "Independent random samples would give a slope of -1/2. A pixel's samples here are one low-discrepancy (Owen-scrambled \
             Sobol) sequence, which does better where the light varies smoothly over the pixel and no worse elsewhere. Slopes \
             nearer 0 tell of the floor that the elements set.",
        )
        .fitted(&sampled)
        .guide("random sampling: -1/2", -0.5),
    ));
    subject.notes.push(format!(
        "Reference: 2 x {} paths a pixel by this program's own path tracer; standard error {:.2} % (RMS over the pixels, relative to \
         the mean). Its two halves are independent, so their product tells errors down to {:.2} %.",
        reference.spp,
        100.0 * reference.standard_error,
        100.0 * reference.resolution
    ));
    subject.strips = pictures(&stage, &subject, &kept, name)?;
    found.figures.extend(figures(name, &subject));
    found.subjects.push(subject);
    if scene.materials.iter().any(|m| m.is_specular() && !m.is_glass()) {
        found.subjects.push(lobes(&stage, name)?);
    }
    Ok(())
}

/// A picture of the first round with what it cost, for the strips.
struct Kept {
    series: &'static str,
    spp: u32,
    first: f64,
    image: Image,
}

/// Every method over its samples a pixel.
fn methods(stage: &Stage, subject: &mut Subject) -> Result<Vec<Kept>> {
    let context = stage.context;
    let two_pass: &[u32] = context.choose(&[1, 4, 16], &[1, 4, 16, 64]);
    let path: &[u32] = context.choose(&[4, 16, 64, 256], &[1, 4, 16, 64, 256, 512]);
    let mut kept = Vec::new();
    let mask = &stage.reference.mask;
    let first = Pass1::of(stage.visibility.scene());
    // Warm-up: both passes once, small.
    let (solution, _) = stage.solve(&Pass1 { rays: 64, ..first })?;
    stage.frame(&settings(Method::TwoPass(Quality::Gather), 1, 0), Some(&solution));
    for round in 0..context.choose(2, 3) {
        let seed = context.settings.seed.wrapping_add(round);
        (context.observer)(&format!("images: {}, seed {seed}", subject.name));
        let (solution, pass1) = stage.solve(&Pass1 { seed, ..first })?;
        let mut one =
            |name: &'static str, method, spp: u32, solution: Option<&Solution>, before| -> Result<()> {
                let frame = stage.frame(&settings(method, spp, seed), solution);
                stage.record(subject, (name, SPP, f64::from(spp)), &frame, before, mask)?;
                if round == 0 {
                    kept.push(Kept { series: name, spp, first: before + frame.seconds, image: frame.image });
                }
                Ok(())
            };
        for (name, quality) in QUALITIES {
            for &spp in two_pass {
                one(name, Method::TwoPass(quality), spp, Some(&solution), pass1)?;
            }
        }
        for &spp in path {
            one("path", Method::Path, spp, None, 0.0)?;
        }
    }
    Ok(kept)
}

/// `mesh` over the size of its elements.
fn elements(stage: &Stage, subject: &mut Subject, defaults: &Pass1) -> Result<()> {
    let Some(size) = defaults.element_size else { return Ok(()) };
    let factors: &[f64] = stage.context.choose(&[4.0, 2.0, 1.0], &[4.0, 2.0, 1.0, 0.5]);
    for round in 0..stage.context.choose(1, 3) {
        let seed = stage.context.settings.seed.wrapping_add(round);
        (stage.context.observer)(&format!("images: {}, elements, seed {seed}", subject.name));
        for factor in factors {
            let pass1 = Pass1 { element_size: Some(size * factor), seed, ..*defaults };
            let (solution, seconds) = stage.solve(&pass1)?;
            let frame = stage.frame(&settings(Method::TwoPass(Quality::Mesh), 16, seed), Some(&solution));
            let at = ("mesh, finer elements", "elements", solution.mesh.len() as f64);
            stage.record(subject, at, &frame, seconds, &stage.reference.mask)?;
        }
    }
    Ok(())
}

/// Frustum and importance sampling of glossy lobes with equal numbers of rays, where the view meets glossy surfaces.
fn lobes(stage: &Stage, name: &str) -> Result<Subject> {
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
    let (solution, pass1) = stage.solve(&Pass1::of(stage.visibility.scene()))?;
    for round in 0..context.choose(2, 5) {
        let seed = context.settings.seed.wrapping_add(round);
        (context.observer)(&format!("images: {}, seed {seed}", subject.name));
        for &n in grids {
            for (series, estimator) in [("frustum", Estimator::Frustum(n)), ("lobe", Estimator::Lobe(n * n))]
            {
                let base = settings(Method::TwoPass(Quality::Direct), 4, seed);
                let frame = stage.frame(&Settings { estimator, ..base }, Some(&solution));
                let at = (series, "rays over the lobe", f64::from(n * n));
                stage.record(&mut subject, at, &frame, pass1, &mask)?;
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

/// Exposure [EV] that brings the mean of the reference to a middle grey.
fn exposure(reference: &Reference) -> f64 {
    let pixels = reference.mean.data.chunks_exact(3).zip(&reference.mask).filter(|p| *p.1);
    let (sum, n) = pixels.fold((0.0, 0.0), |(s, n), (p, _)| {
        (s + color::mean(color::Rgb::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))), n + 1.0)
    });
    (0.22f64 * n / sum).log2()
}

/// The reference beside every method after about the same time, and their errors in false colours.
fn pictures(stage: &Stage, subject: &Subject, kept: &[Kept], name: &str) -> Result<Vec<Strip>> {
    let gather = kept.iter().filter(|k| k.series == "gather" && k.spp <= 16).map(|k| k.first);
    let budget = gather.fold(0.0, f64::max);
    let mut chosen: Vec<&Kept> = Vec::new();
    for series in ["mesh", "direct", "gather", "path"] {
        let off = |k: &&Kept| (k.first / budget).ln().abs();
        let best = kept.iter().filter(|k| k.series == series).min_by(|a, b| off(a).total_cmp(&off(b)));
        chosen.extend(best);
    }
    let reference = stage.reference;
    let ev = exposure(reference);
    let [width, height] = stage.camera.size.map(|n| n as usize);
    let shown = |image: &Image| png(width, height, &srgb_bytes(image, ev));
    let file = |what: &str| format!("pictures/images-{name}-{what}.png");
    let caption = |k: &Kept| {
        let series = subject.series.iter().find(|s| s.name == k.series);
        let point = series.and_then(|s| s.points.iter().find(|p| p.parameter == f64::from(k.spp)));
        let error = point.and_then(|p| p.get(ERROR)).map_or(0.0, |m| m.samples[0]);
        format!("{}, {} samples a pixel: {:.2} s, error {:.2} %", k.series, k.spp, k.first, 100.0 * error)
    };
    let mut plain = vec![Picture {
        caption: format!("reference, {} paths a pixel", 2 * reference.spp),
        file: file("reference"),
        png: shown(&reference.mean)?,
    }];
    let mut errors = Vec::new();
    let mean = stage.compare(&reference.mean, &reference.mask)?.reference_mean;
    let within = |k: &&Kept| error_within(&k.image, &reference.mean, Some(&reference.mask), 0.98) / mean;
    // One scale for all, set by the methods in the middle: a noisy one may leave it.
    let mut scales: Vec<f64> = chosen.iter().map(within).collect();
    scales.sort_by(f64::total_cmp);
    let scale = scales.get(scales.len() / 2).copied().filter(|s| *s > 0.0).unwrap_or(1.0);
    for k in chosen {
        plain.push(Picture { caption: caption(k), file: file(k.series), png: shown(&k.image)? });
        let colours = signed_difference(&k.image, &reference.mean, Some(&reference.mask), scale * mean);
        errors.push(Picture {
            caption: k.series.to_string(),
            file: file(&format!("{}-error", k.series)),
            png: png(width, height, &colours)?,
        });
    }
    Ok(vec![
        Strip {
            title: "Pictures after about the same time".into(),
            about: format!("First frames that took about {budget:.2} s, pass 1 included, beside the reference."),
            scale: None,
            pictures: plain,
        },
        Strip {
            title: "Their errors".into(),
            about: "Picture minus reference: blue is too dark, red too bright, white right; grey pixels see a lamp and do not count. \
                    Speckles are noise, which more samples remove; areas of one colour are what the elements cannot show, which \
                    finer elements remove."
                .into(),
            scale: Some(scale),
            pictures: errors,
        },
    ])
}

/// Seconds that `path` needs for a given error, interpolated between its points on logarithmic axes, or beyond them with
/// the slope -1/2.
fn path_seconds(subject: &Subject, round: usize, error: f64) -> Option<f64> {
    let path = subject.series.iter().find(|s| s.name == "path")?;
    let at = |p: &super::record::Point, q: &str| p.get(q).and_then(|m| m.samples.get(round)).copied();
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
    let Some(gather) = subject.series.iter().find(|s| s.name == "gather") else { return Vec::new() };
    let Some(point) = gather.points.iter().find(|p| p.parameter == 16.0) else { return Vec::new() };
    let samples = |q: &str| point.get(q).map(|m| m.samples.clone()).unwrap_or_default();
    let errors = samples(ERROR);
    let ratio = |quantity: &str| -> Vec<f64> {
        let own = samples(quantity);
        let pairs = errors.iter().zip(&own).enumerate();
        pairs.filter_map(|(k, (e, s))| Some(path_seconds(subject, k, *e)? / s)).collect()
    };
    let figure = |label: String, unit, samples: Vec<f64>| Figure { label, unit, samples };
    let mut list = vec![figure(
        format!("relative RMSE of {name} by gather, 16 samples a pixel"),
        Unit::Share,
        errors.clone(),
    )];
    for (quantity, frame) in [(FIRST, "the first frame"), (NEXT, "a following frame")] {
        let label = format!(
            "times faster than path tracing to the same error: {name}, {frame}, gather, 16 samples a pixel"
        );
        list.push(figure(label, Unit::Plain, ratio(quantity)));
    }
    list.retain(|f| !f.samples.is_empty());
    list
}

/// The path tracer against another renderer's images of known scenes.
fn references(context: &Context) -> Result<Subject> {
    let mut subject = Subject::new(
        "references",
        "The references themselves, against another renderer",
        "References made by the program under test could share its mistakes. Here its path tracer is set against images of the same \
         scenes by another renderer (Mitsuba 3), both as two independent halves, so that the noise of neither counts: what is left is \
         the difference of what the two converge to.",
    );
    let Some(folder) = &context.settings.foreign else {
        subject
            .notes
            .push("skipped: the other renderer's images are not there (--foreign names their folder)".into());
        return Ok(subject);
    };
    let names: &[&str] = context.choose(
        &["ours/cornell_diffuse"],
        &["ours/cornell_diffuse", "ours/cornell_glossy", "ours/cornell_mirror", "mcguire/original"],
    );
    let spp = context.choose(32, 256);
    for name in names {
        let file = |end: &str| folder.join(format!("{name}{end}"));
        if !file("_A.exr").is_file() {
            subject.notes.push(format!("skipped: {name} is not there"));
            continue;
        }
        foreign(context, &mut subject, name, &file, spp)?;
    }
    Ok(subject)
}

fn foreign(
    context: &Context,
    subject: &mut Subject,
    name: &str,
    file: &dyn Fn(&str) -> std::path::PathBuf,
    spp: u32,
) -> Result<()> {
    let scene = load(&file(".toml"))?;
    let camera = scene.camera(None)?;
    let visibility = Visibility::new(context.device, &scene)?;
    let emitters = Emitters::new(&scene);
    let own = reference(context, &visibility, &emitters, camera, spp)?;
    let half = |path: &Path| -> Result<Image> {
        let image = read_exr(path)?;
        if [image.width as u32, image.height as u32] != camera.size {
            return Err(Error::Image { path: path.into(), message: "is not of the camera's size".into() });
        }
        Ok(image)
    };
    let (a, b) = (half(&file("_A.exr"))?, half(&file("_B.exr"))?);
    let mask = read_mask_npy(&file("_mask.npy"), a.width, a.height)?;
    let c = relative_rmse_of_halves([&own.halves[0], &own.halves[1]], [&a, &b], Some(&mask))?;
    let point = subject.series(name, "paths a pixel in a half").at(f64::from(spp));
    point.push("difference (relative RMS)", Unit::Share, c.relative_rmse);
    point.push("standard error", Unit::Share, c.standard_error);
    point.push("difference of the means", Unit::Share, c.mean_bias);
    point.push("noise of ours", Unit::Share, own.standard_error);
    point.unresolved = c.relative_mse <= 0.0;
    Ok(())
}
