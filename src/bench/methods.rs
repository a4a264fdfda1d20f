//! The methods that the two-pass method joins or was set against, on one scene: a strip of pictures with time and error
//! under each, and what directions cost where reflections are sharp.

use super::pictures::{exposure, side_by_side};
use super::reference::{Reference, reference, sees_specular};
use super::scenes::{Glossy, glossy_cornell};
use super::view::{ERROR, FIRST, Frame, SPP, View, settings};
use super::{Context, Measurements};
use crate::Result;
use crate::emitters::Emitters;
use crate::image::{Image, png, srgb_bytes};
use crate::pipeline::{self, Pass1};
use crate::render::{Method, Quality, render_directional};
use crate::report::record::{Chart, Figure, PARAMETER, Picture, Series, Strip, Subject, Unit};
use crate::report::text;
use crate::visibility::Visibility;
use std::time::Instant;

const DIRECTIONS: &str = "directions";
const STORED: &str = "values stored for directions";
/// What elements and directions blur: the error that the mean of many solutions would keep.
const BLUR: &str = "relative RMSE without noise";
/// Samples a pixel of pictures by directional radiosity, which interpolate between its elements and directions.
const FRAME_SPP: u32 = 16;
const TWO_PASS: Method = Method::TwoPass(Quality::Gather);

pub fn run(context: &Context) -> Result<Measurements> {
    let mut figures = Vec::new();
    let all = methods(context, &mut figures)?;
    let sharp = sharpness(context, &mut figures)?;
    Ok(Measurements { figures, subjects: vec![all, sharp] })
}

/// A scene with its view and reference, handed to `work`.
fn with_view<T>(
    context: &Context,
    (roughness, with, width, spp): (f64, Glossy, u32, u32),
    work: impl FnOnce(&View) -> Result<T>,
) -> Result<T> {
    let scene = glossy_cornell(roughness, with)?;
    let visibility = Visibility::new(context.device, &scene)?;
    let emitters = Emitters::new(&visibility);
    let mut camera = scene.camera(None)?.clone();
    camera.size = [width, width];
    let reference = reference(context, &visibility, &emitters, &camera, spp)?;
    work(&View {
        context,
        visibility: &visibility,
        emitters: &emitters,
        camera: &camera,
        reference: &reference,
    })
}

/// Directional radiosity: the frame, the seconds before it, values stored for directions and bytes held.
fn directional(view: &View, pass1: &Pass1, directions: u32) -> Result<(Frame, f64, f64, f64)> {
    let cameras = std::slice::from_ref(view.camera);
    let what = (pass1, directions);
    let start = Instant::now();
    let solved =
        pipeline::solve_directional(view.visibility, view.emitters, cameras, what, &|_| (), &mut Vec::new())?;
    let before = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let sampling = (FRAME_SPP, pass1.seed);
    let (image, traced) =
        render_directional(view.visibility, view.emitters, &solved, view.camera, sampling, &|_| ());
    let frame = Frame { image, seconds: start.elapsed().as_secs_f64(), rays: traced.rays };
    Ok((frame, before, solved.directional_values() as f64, solved.bytes))
}

/// A picture of the strip: its series, what it varies and at which value, and its image in sRGB.
struct Shown {
    series: &'static str,
    parameter: &'static str,
    at: f64,
    first: f64,
    rgb: Vec<u8>,
}

fn methods(context: &Context, figures: &mut Vec<Figure>) -> Result<Subject> {
    let (width, spp) = context.choose((40, 192), (96, 1024));
    with_view(context, (0.3, Glossy::Mirror, width, spp), |view| {
        let mut subject = Subject::new(
            "cornell-glossy",
            format!("Cornell box with a glossy floor and a mirror, {width} x {width} pixels"),
            "\"whitted\" is ray tracing with light from lamps alone; \"radiosity\" shows diffuse light alone; both converge to a wrong picture. \
             \"directional\" stores the radiance of every specular element for every cell of a hemisphere, and needs both finer elements and \
             more directions for a sharper picture. \"path\" is path tracing. \"two-pass\" is this program's default (quality gather). Times are \
             those of first frames, solving included.",
        );
        let element_size = Some(context.choose(0.1, 0.05));
        let rays = context.choose(256, 1024);
        let directions: &[u32] = context.choose(&[16, 64, 256], &[16, 64, 256, 1024]);
        let mut shown = Vec::new();
        for round in 0..context.choose(1, 3) {
            let seed = context.settings.seed.wrapping_add(round);
            (context.observer)(&format!("methods: seed {seed}"));
            let pass1 = Pass1 { rays, element_size, seed };
            if round == 0 {
                // Warm-up.
                let (solution, _) = view.solve(&Pass1 { rays: 16, ..pass1 })?;
                view.frame(&settings(TWO_PASS, 1, seed), Some(&solution));
            }
            let (solution, before) = view.solve(&pass1)?;
            let ev = exposure(view.reference);
            let mut keep = |series, parameter, at, first, frame: &Frame| {
                if round == 0 {
                    shown.push(Shown { series, parameter, at, first, rgb: srgb_bytes(&frame.image, ev) });
                }
            };
            let few = [1, 4, 16];
            let two_pass = [1, 4, 16].map(|share| TWO_PASS.default_spp() * share / 16);
            let many: &[u32] = context.choose(&[4, 16, 64], &[4, 16, 64, 256]);
            for (series, method, samples, solved) in [
                ("whitted", Method::Whitted, &few[..], false),
                ("radiosity", Method::Radiosity, &few, true),
                ("path", Method::Path, many, false),
                ("two-pass", TWO_PASS, &two_pass, true),
            ] {
                for &spp in samples {
                    let (given, before) = if solved { (Some(&solution), before) } else { (None, 0.0) };
                    let frame = view.frame(&settings(method, spp, seed), given);
                    let at = f64::from(spp);
                    view.record(&mut subject, (series, SPP, at), &frame, before, &view.reference.mask)?;
                    keep(series, SPP, at, before + frame.seconds, &frame);
                }
            }
            for &n in directions {
                let (frame, before, stored, bytes) = directional(view, &pass1, n)?;
                let at = f64::from(n);
                view.record(
                    &mut subject,
                    ("directional", DIRECTIONS, at),
                    &frame,
                    before,
                    &view.reference.mask,
                )?;
                let point = subject.series("directional", DIRECTIONS).at(at);
                point.push(STORED, Unit::Count, stored);
                point.push("memory for directions", Unit::Bytes, bytes);
                keep("directional", DIRECTIONS, at, before + frame.seconds, &frame);
            }
        }
        subject.strips.push(strip(view, &subject, shown)?);
        let mut chart = Chart::new(
            "First frame: error over time",
            FIRST,
            ERROR,
            "Along each line the samples a pixel grow, or the directions. A line that goes flat has reached what its method or its elements \
             can show.",
        )
        .guide("theory of random sampling: -1/2", -0.5);
        chart.floor = Some(("smallest error the reference tells".into(), view.reference.resolution));
        subject.charts.push(chart);
        subject.notes.push(reference_note(view.reference));
        figures.extend(at_equal_error(&mut subject));
        Ok(subject)
    })
}

fn reference_note(reference: &Reference) -> String {
    format!(
        "Reference: 2 x {} paths a pixel by this program's own path tracer; its halves tell errors down to {}.",
        reference.spp,
        text::value(reference.resolution, Unit::Share)
    )
}

/// All methods side by side: directional radiosity with its fewest and its most directions, whatever else took about as
/// long as the two-pass picture with its default samples.
fn strip(view: &View, subject: &Subject, shown: Vec<Shown>) -> Result<Strip> {
    let [width, height] = view.camera.size.map(|n| n as usize);
    let of = |series: &str| shown.iter().filter(|s| s.series == series).collect::<Vec<_>>();
    let budget =
        of("two-pass").iter().find(|s| s.at == f64::from(TWO_PASS.default_spp())).map_or(1.0, |s| s.first);
    let near = |series: &str| {
        let off = |s: &&Shown| (s.first / budget).ln().abs();
        of(series).into_iter().min_by(|a, b| off(a).total_cmp(&off(b)))
    };
    let directional = of("directional");
    let chosen = [
        near("whitted"),
        near("radiosity"),
        directional.first().copied(),
        directional.last().copied().filter(|_| directional.len() > 1),
        near("path"),
        near("two-pass"),
    ];
    let reference = srgb_bytes(&view.reference.mean, exposure(view.reference));
    let mut pictures = vec![(
        "reference".to_string(),
        reference,
        vec!["reference".to_string(), format!("{} paths a pixel", 2 * view.reference.spp)],
    )];
    for s in chosen.into_iter().flatten() {
        let series = subject.series.iter().find(|x| x.name == s.series);
        let point = series.and_then(|x| x.points.iter().find(|p| p.parameter == s.at));
        // Of the run that is shown.
        let sample = |q: &str| point.and_then(|p| p.get(q)).map(|m| text::value(m.samples[0], m.unit));
        let lines = vec![
            s.series.to_string(),
            format!("{} {}", text::value(s.at, Unit::Count), s.parameter),
            sample(FIRST).unwrap_or_default(),
            format!("relative RMSE {}", sample(ERROR).unwrap_or_default()),
        ];
        pictures.push((format!("{}-{}", s.series, s.at), s.rgb.clone(), lines));
    }
    let file = |what: &str| format!("pictures/methods-{what}.png");
    let drawn: Vec<(Vec<u8>, Vec<String>)> = pictures.iter().map(|p| (p.1.clone(), p.2.clone())).collect();
    let title = "Every method, with its time and error".to_string();
    let whole =
        Picture { caption: title.clone(), file: file("strip"), png: side_by_side([width, height], &drawn)? };
    let pictures = pictures
        .into_iter()
        .map(|(name, rgb, lines)| {
            Ok(Picture { caption: lines.join(", "), file: file(&name), png: png(width, height, &rgb)? })
        })
        .collect::<Result<Vec<_>>>()?;
    let about = "First frames that took about as long as the two-pass picture with its default samples, and directional radiosity with its \
                 fewest and its most directions. Whitted's ray tracing leaves black what no lamp lights. Radiosity leaves black what only reflects. \
                 Directional radiosity blurs the mirror over its cells and elements.";
    Ok(Strip { title, about: about.into(), scale: None, pictures, whole: Some(whole) })
}

/// How much longer the others take to the error that two-pass has with a quarter of its default samples.
fn at_equal_error(subject: &mut Subject) -> Vec<Figure> {
    let spp = TWO_PASS.default_spp() / 4;
    let find = |name: &str| subject.series.iter().find(|s| s.name == name);
    let Some(point) = find("two-pass").and_then(|s| s.points.iter().find(|p| p.parameter == f64::from(spp)))
    else {
        return Vec::new();
    };
    let (Some(error), Some(time)) = (point.summary(ERROR), point.summary(FIRST)) else { return Vec::new() };
    let (mut notes, mut figures) = (Vec::new(), Vec::new());
    for name in ["whitted", "radiosity", "directional", "path"] {
        let Some(series) = find(name) else { continue };
        let words = match series.where_reached(FIRST, (ERROR, error.median), FIRST) {
            Some((seconds, _)) => {
                if name == "path" {
                    figures.push(Figure {
                        label: "times as long takes path tracing to the error of two-pass, first frame (glossy floor and mirror)".into(),
                        unit: Unit::Plain,
                        samples: vec![seconds / time.median],
                    });
                }
                format!("{name} after {}", text::value(seconds, Unit::Seconds))
            }
            None => {
                let errors = series.points.iter().filter_map(|p| p.summary(ERROR)).map(|s| s.median);
                let least = errors.fold(f64::INFINITY, f64::min);
                format!("{name} never (its least error is {})", text::value(least, Unit::Share))
            }
        };
        notes.push(words);
    }
    let note = format!(
        "Two-pass with {spp} samples a pixel has an error of {} after {}. The others get there: {}.",
        text::value(error.median, Unit::Share),
        text::value(time.median, Unit::Seconds),
        notes.join("; ")
    );
    subject.notes.push(note);
    figures
}

/// Errors of the glossy floor by directional radiosity, over the directions and the floor's roughness.
fn sharpness(context: &Context, figures: &mut Vec<Figure>) -> Result<Subject> {
    let (width, spp) = context.choose((28, 192), (48, 1024));
    let roughnesses: &[f64] = context.choose(&[0.7, 0.3], &[0.8, 0.6, 0.4, 0.25]);
    let directions: &[u32] = context.choose(&[16, 64, 256], &[16, 64, 256, 1024]);
    let element_size = Some(context.choose(0.1, 0.05));
    let mut subject = Subject::new(
        "sharpness",
        "Directions and the sharpness of a highlight",
        "The same box without the mirror, lit by the whole of its ceiling (no lamp small enough to slip between directions), its floor \
         from rough to shiny and not diffuse, and only the pixels that show the floor. Every direction costs a value and a ray for \
         every specular element. A single solution has noise, as its rays are few, most where the lobe is wide; \
         the error without noise is the mean product of the errors of solutions with independent seeds: what the size of elements and directions blurs. \
         The two-pass method stands beside it with the same elements.",
    );
    for &roughness in roughnesses {
        with_view(context, (roughness, Glossy::Ceiling, width, spp), |view| {
            let specular = sees_specular(view.visibility, view.camera);
            let mask: Vec<bool> = specular.iter().zip(&view.reference.mask).map(|(a, b)| *a && *b).collect();
            let name = format!("directional, roughness {roughness}");
            let mut images = vec![Vec::new(); directions.len()];
            for round in 0..context.choose(2, 3) {
                let seed = context.settings.seed.wrapping_add(round);
                (context.observer)(&format!("methods: roughness {roughness}, seed {seed}"));
                let pass1 = Pass1 { rays: context.choose(256, 1024), element_size, seed };
                for (&n, images) in directions.iter().zip(&mut images) {
                    let (frame, before, stored, bytes) = directional(view, &pass1, n)?;
                    view.record(&mut subject, (&name, DIRECTIONS, f64::from(n)), &frame, before, &mask)?;
                    let point = subject.series(&name, DIRECTIONS).at(f64::from(n));
                    point.push(STORED, Unit::Count, stored);
                    point.push("memory for directions", Unit::Bytes, bytes);
                    images.push(frame.image);
                }
                let (solution, before) = view.solve(&pass1)?;
                let frame = view.frame(&settings(TWO_PASS, 4, seed), Some(&solution));
                view.record(
                    &mut subject,
                    ("two-pass, 4 samples a pixel", "roughness", roughness),
                    &frame,
                    before,
                    &mask,
                )?;
            }
            for (&n, images) in directions.iter().zip(&images) {
                let blur = without_noise(images, &view.reference.halves, &mask);
                subject.series(&name, DIRECTIONS).at(f64::from(n)).push(BLUR, Unit::Share, blur);
            }
            Ok(())
        })?;
    }
    let swept: Vec<String> = roughnesses.iter().map(|r| format!("directional, roughness {r}")).collect();
    let names: Vec<&str> = swept.iter().map(String::as_str).collect();
    for (title, y, about) in [
        (
            "What directions blur",
            BLUR,
            "The error without noise. The shinier the floor, the more directions until it comes down to what the elements can show.",
        ),
        (
            "Error of one solution",
            ERROR,
            "With its noise, which is largest where a wide lobe is sampled by few rays.",
        ),
        ("Time over directions", FIRST, "Links and values grow in proportion to the directions."),
    ] {
        subject.charts.push(Chart::new(title, PARAMETER, y, about).only(&names).fitted(&subject.series));
    }
    needed(&mut subject, roughnesses, figures);
    Ok(subject)
}

/// Relative RMSE that the mean of ever more such images would keep: the mean over pairs of images and over the pixels
/// of `mask` of the product of their errors, each against another half of the reference; 0 where noise hides it.
fn without_noise(images: &[Image], halves: &[Image; 2], mask: &[bool]) -> f64 {
    let [a, b] = halves;
    let (mut square, mut mean, mut n) = (0.0, 0.0, 0.0);
    let pairs =
        (0..images.len()).flat_map(|i| (0..images.len()).filter(move |j| i != *j).map(move |j| (i, j)));
    for (i, j) in pairs {
        let (x, y) = (&images[i].data, &images[j].data);
        for k in (0..x.len()).filter(|k| mask[k / 3]) {
            let [x, y, a, b] = [x[k], y[k], a.data[k], b.data[k]].map(f64::from);
            square += (x - a) * (y - b);
            mean += 0.5 * (a + b);
            n += 1.0;
        }
    }
    if mean > 0.0 { (square.max(0.0) / n).sqrt() * n / mean } else { 0.0 }
}

/// Directions and time that each roughness needs for the smallest error that all of them reach.
fn needed(subject: &mut Subject, roughnesses: &[f64], figures: &mut Vec<Figure>) {
    let series_of = |subject: &Subject, r: f64| -> Option<Series> {
        subject.series.iter().find(|s| s.name == format!("directional, roughness {r}")).cloned()
    };
    let least = |s: &Series| {
        let errors = s.points.iter().filter_map(|p| p.summary(BLUR)).map(|s| s.median);
        errors.fold(f64::INFINITY, f64::min)
    };
    let all: Vec<Series> = roughnesses.iter().filter_map(|r| series_of(subject, *r)).collect();
    let level = all.iter().map(least).fold(0.0, f64::max);
    let name = "directional, to equal error";
    let mut needs = Vec::new();
    for (series, &roughness) in all.iter().zip(roughnesses) {
        let at = |wanted| series.where_reached(PARAMETER, (BLUR, level), wanted);
        let (Some((directions, at_once)), Some((seconds, _))) = (at(PARAMETER), at(FIRST)) else { continue };
        let point = subject.series(name, "roughness").at(roughness);
        point.push("directions needed", Unit::Count, directions);
        point.push("time needed", Unit::Seconds, seconds);
        let bound = if at_once { "at most " } else { "" };
        needs.push((
            roughness,
            (directions, at_once),
            format!("{bound}{} at roughness {roughness}", text::value(directions.round(), Unit::Count)),
        ));
    }
    if let (Some(first), Some(last)) = (needs.first(), needs.last()) {
        let words: Vec<&str> = needs.iter().map(|n| n.2.as_str()).collect();
        subject.notes.push(format!(
            "For an error without noise of {}, the least that every roughness reached, directional radiosity needs this many directions: {}.",
            text::value(level, Unit::Share),
            words.join(", ")
        ));
        figures.push(Figure {
            label: format!(
                "times as many directions{} needs directional radiosity at roughness {} as at {}, for equal error",
                if first.1.1 { ", or more," } else { "" },
                last.0,
                first.0
            ),
            unit: Unit::Plain,
            samples: vec![last.1.0 / first.1.0],
        });
    }
    let about = "Directions that directional radiosity needs for the same error without noise, the least that every roughness reached. Sharper towards the \
                 left; the solid angle of a lobe grows with the fourth power of its roughness.";
    let chart = Chart::new("Directions needed over roughness", PARAMETER, "directions needed", about);
    subject.charts.push(chart.only(&[name]).fitted(&subject.series));
    let about = "The two-pass method with 4 samples a pixel on the same pixels, from the same elements.";
    let chart = Chart::new("Two-pass: error over roughness", PARAMETER, ERROR, about);
    subject.charts.push(chart.only(&["two-pass, 4 samples a pixel"]));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points (parameter, time, error) of a series.
    fn add(subject: &mut Subject, name: &str, parameter: &str, points: &[(f64, f64, f64)]) {
        for &(at, seconds, error) in points {
            let point = subject.series(name, parameter).at(at);
            point.push(FIRST, Unit::Seconds, seconds);
            point.push(ERROR, Unit::Share, error);
            point.push(BLUR, Unit::Share, error);
        }
    }

    /// Images that are 10 % too bright, and noisy besides: noises of independent images cancel (one is +x, the other has
    /// no noise), the 10 % stay. A pixel outside of the mask is far off.
    #[test]
    fn noise_does_not_count_as_blur() {
        let image = |v: [f32; 4]| Image {
            width: 2,
            height: 2,
            channels: 3,
            data: v.iter().flat_map(|v| [*v; 3]).collect(),
        };
        let reference = [image([1.0; 4]), image([1.0; 4])];
        let images = [image([1.3, 0.9, 1.1, 9.0]), image([1.1, 1.1, 1.1, 9.0])];
        let mask = [true, true, true, false];
        // Mean of (0.3, -0.1, 0.1) * 0.1 = 0.01.
        assert!((without_noise(&images, &reference, &mask) - 0.1).abs() < 1e-6);
    }

    /// Errors that fall with the root of the directions, from 0.4 (rough) and 1.6 (sharp) at 16: to an error of 0.2 they need
    /// 64 and 1024.
    #[test]
    fn sharper_floors_need_more_directions() {
        let mut s = Subject::new("s", "t", "");
        let sweep =
            |first: f64| [16.0, 256.0, 1024.0].map(|n: f64| (n, n / 100.0, first * (16.0 / n).sqrt()));
        add(&mut s, "directional, roughness 0.8", DIRECTIONS, &sweep(0.4));
        add(&mut s, "directional, roughness 0.4", DIRECTIONS, &sweep(1.6));
        let mut figures = Vec::new();
        needed(&mut s, &[0.8, 0.4], &mut figures);
        let series = s.series.iter().find(|s| s.name == "directional, to equal error").expect("a series");
        let at = |k: usize, q: &str| series.points[k].get(q).expect("measured").samples[0];
        assert!(
            (at(0, "directions needed") - 64.0).abs() < 1e-9 && (at(0, "time needed") - 0.64).abs() < 1e-9
        );
        assert!((at(1, "directions needed") - 1024.0).abs() < 1e-9);
        assert!((figures[0].samples[0] - 16.0).abs() < 1e-9, "{figures:?}");
        assert!(
            s.notes[0].contains("20.0 %") && s.notes[0].contains("1,024 at roughness 0.4"),
            "{:?}",
            s.notes
        );
    }

    #[test]
    fn methods_are_compared_at_equal_error() {
        let mut s = Subject::new("s", "t", "");
        add(&mut s, "two-pass", SPP, &[(1.0, 0.5, 0.1), (8.0, 1.0, 0.05)]);
        add(&mut s, "path", SPP, &[(1.0, 0.1, 0.5), (100.0, 10.0, 0.05), (400.0, 40.0, 0.025)]);
        add(&mut s, "whitted", SPP, &[(1.0, 0.01, 0.7), (4.0, 0.04, 0.6)]);
        let figures = at_equal_error(&mut s);
        assert!((figures[0].samples[0] - 10.0).abs() < 1e-9, "{figures:?}");
        assert!(
            s.notes[0].contains("whitted never (its least error is 60.0 %); path after 10.0 s"),
            "{:?}",
            s.notes
        );
    }

    /// The box's floor and tall box, or ceiling, and nothing else, have the materials asked for.
    #[test]
    fn the_glossy_box_is_as_asked() {
        for (with, object, count) in [(Glossy::Mirror, "tall_box", 5), (Glossy::Ceiling, "ceiling", 8)] {
            let scene = glossy_cornell(0.3, with).expect("a scene");
            let changed = |name: &str| {
                let is = |f: &&crate::scene::Face| scene.objects[f.object as usize] == name;
                let faces: Vec<_> = scene.faces.iter().filter(is).collect();
                let other = faces.iter().filter(|f| scene.material(f).name != "white").count();
                (faces.len(), other)
            };
            let floor = changed("floor");
            assert!(floor.0 > 0 && floor.0 == floor.1, "{floor:?}");
            assert!(
                changed(object).1 >= count / 2 && changed(object).0 == changed(object).1,
                "{:?}",
                changed(object)
            );
            assert_eq!([changed("back_wall").1, changed("short_box").1], [0, 0]);
            let glossy =
                |m: &&crate::scene::Material| m.is_specular() && m.is_diffuse() == (with == Glossy::Mirror);
            assert_eq!(scene.materials.iter().filter(glossy).count(), 1);
        }
    }
}
