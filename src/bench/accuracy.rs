//! Images of a given error (`--error`): how wrong they are indeed, and what they say.

use super::view::{FIRST, View, settings, with_view};
use super::{Context, Measurements};
use crate::Result;
use crate::accuracy::{self, render_to_error};
use crate::pipeline;
use crate::render::{Method, Quality};
use crate::report::record::{Chart, Figure, PARAMETER, Subject, Unit};
use std::time::Instant;

const TRUE: &str = "true error";
const SAID: &str = "error said";
const SHARE: &str = "true over asked";

pub fn run(context: &Context) -> Result<Measurements> {
    let quick: &[(&str, &[f64])] = &[("cornell", &[0.1])];
    let full: &[(&str, &[f64])] = &[
        ("cornell", &[0.1, 0.05, 0.02, 0.01]),
        ("gallery", &[0.05, 0.02]),
        ("music_lesson", &[0.05]),
        ("corridor", &[0.05, 0.02]),
    ];
    let mut found = Measurements::default();
    let mut shares = Vec::new();
    for (name, asked) in context.choose(quick, full) {
        let subject = with_view(context, name, |view| scene(view, name, asked))?;
        let points = subject.series.iter().flat_map(|s| &s.points);
        shares.extend(points.filter_map(|p| p.get(SHARE)).flat_map(|m| m.samples.clone()));
        found.subjects.push(subject);
    }
    let figure = |label: &str, is: &dyn Fn(f64) -> bool| {
        let count = shares.iter().filter(|s| is(**s)).count();
        let label = format!("of {} images of a given error: {label}", shares.len());
        Figure { label, unit: Unit::Share, samples: vec![count as f64 / shares.len().max(1) as f64] }
    };
    found.figures.push(figure("the true error is at most the one asked for", &|s| s <= 1.0));
    found.figures.push(figure("it is below a third of that", &|s| s < 1.0 / 3.0));
    Ok(found)
}

fn scene((stage, by): (&View, &str), name: &str, errors: &[f64]) -> Result<Subject> {
    let View { context, visibility, emitters, camera, reference } = *stage;
    let mut subject = Subject::new(
        name,
        format!("{name}, {} x {} pixels", camera.size[0], camera.size[1]),
        "An image is asked for by its relative RMSE (`--error`): the program chooses quality, elements, rays and samples, and says how \
         wrong the image is. It aims below what is asked: a third to all of it is as it should be.",
    );
    for round in 0..context.choose(1, 3) {
        let seed = context.settings.seed.wrapping_add(round);
        for &asked in errors {
            (context.observer)(&format!("accuracy: {name}, {} % asked, seed {seed}", 100.0 * asked));
            let start = Instant::now();
            let view = accuracy::View {
                visibility,
                emitters,
                reached: pipeline::reached(visibility, std::slice::from_ref(camera), seed, &|_| ()),
                camera,
                settings: settings(Method::TwoPass(Quality::Gather), 1, seed),
                limit: None,
            };
            let made = render_to_error(&view, asked, seed, &|_| (), &mut Vec::new())?;
            let seconds = start.elapsed().as_secs_f64();
            let truth = stage.compare(&made.image, &reference.mask)?.relative_rmse;
            let point = subject.series("images", "relative RMSE asked for").at(asked);
            point.push(TRUE, Unit::Share, truth);
            point.push(SAID, Unit::Share, made.achieved.relative_rmse);
            point.push(SHARE, Unit::Plain, truth / asked);
            point.push(FIRST, Unit::Seconds, seconds);
            point.push("elements", Unit::Count, made.achieved.elements as f64);
            point.unresolved = point.summary(TRUE).is_some_and(|s| s.median < reference.resolution);
            if !made.achieved.met {
                subject.notes.push(format!("{} % with seed {seed}: said not to be met.", 100.0 * asked));
            }
        }
    }
    let about = "Along the dotted line the true error is in proportion to the one asked for.";
    subject
        .charts
        .push(Chart::new("True error over the one asked for", PARAMETER, TRUE, about).guide("1", 1.0));
    subject
        .notes
        .push(format!("Reference {by}; it tells errors down to {:.2} %.", 100.0 * reference.resolution));
    Ok(subject)
}
