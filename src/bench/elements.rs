//! Uniform and adaptive elements: how wrong quality `mesh` is with how many of them, after how long.

use super::reference::Reference;
use super::view::{ERROR, View, settings, with_view};
use super::{Context, Measurements};
use crate::Result;
use crate::adaptive;
use crate::image::relative_rmse_of_halves;
use crate::pipeline::{self, Pass1};
use crate::radiosity::{Reads, Solution};
use crate::render::{Method, Quality};
use crate::report::record::{Chart, Figure, Subject, Unit};
use std::time::Instant;

const ELEMENTS: &str = "elements";
const APART: &str = "error without noise";
const TIME: &str = "pass 1";
const MORE: &str = "uniform elements at that error, over these";
const LONGER: &str = "their time over this";
const UNIFORM: &str = "uniform";
const ADAPTIVE: &str = "adaptive";

/// Samples a pixel of the pictures that are compared: as good as all, beside the elements' error.
const SAMPLES: u32 = 256;

/// What is measured of a scene.
struct Plan {
    name: &'static str,
    rays: u32,
    /// Largest edges \[m\]: of uniform elements, of the finest adaptive ones.
    sizes: [&'static [f64]; 2],
}

pub fn run(context: &Context) -> Result<Measurements> {
    let quick: &[Plan] = &[Plan { name: "cornell", rays: 256, sizes: [&[0.08, 0.056, 0.04], &[0.04]] }];
    let full: &[Plan] = &[
        Plan {
            name: "cornell",
            rays: 4096,
            sizes: [&[0.08, 0.056, 0.04, 0.028, 0.02, 0.014, 0.012], &[0.04, 0.02, 0.014, 0.01, 0.007]],
        },
        Plan {
            name: "corridor",
            rays: 16_384,
            sizes: [&[0.4, 0.28, 0.2, 0.17, 0.14, 0.12], &[0.28, 0.2, 0.14, 0.1]],
        },
    ];
    let mut found = Measurements::default();
    context
        .choose(quick, full)
        .iter()
        .try_for_each(|plan| with_view(context, plan.name, |view| scene(view, plan, &mut found)))?;
    Ok(found)
}

fn scene((stage, by): (&View, &str), plan: &Plan, found: &mut Measurements) -> Result<()> {
    let View { context, reference, .. } = *stage;
    let mut subject = Subject::new(
        plan.name,
        format!("{}, {} rays an element", plan.name, plan.rays),
        "How wrong quality \"mesh\" is with uniform and with adaptive elements. \"error without noise\" is what two solutions of the same \
         elements have in common, whose rays are independent: what more rays would not mend. The time of adaptive elements \
         contains that of all the passes that look where they are to be divided.",
    );
    for round in 0..context.choose(1, 2) {
        let seed = context.settings.seed.wrapping_add(2 * round);
        (context.observer)(&format!("elements: {}, seed {seed}", plan.name));
        for (series, sizes) in [UNIFORM, ADAPTIVE].into_iter().zip(plan.sizes) {
            for size in sizes {
                let pass = Pass1 { rays: plan.rays, element_size: Some(*size), seed };
                measure(stage, &mut subject, series, &pass)?;
            }
        }
    }
    compare(&mut subject, found);
    subject.notes.push(format!(
        "Reference {by}; it tells errors down to {:.2} %. Uniform elements at an error are interpolated between those measured.",
        100.0 * reference.resolution
    ));
    let floor = Some(("smallest error the reference tells".to_string(), reference.resolution));
    for (title, x, about) in [
        ("Error over elements", ELEMENTS, "Left is fewer elements for the same picture."),
        (
            "Error over time",
            TIME,
            "Adaptive elements are found by solving several times. Where they lie to the left, the elements that they save make up for it.",
        ),
    ] {
        let mut chart = Chart::new(title, x, APART, about);
        chart.floor = floor.clone();
        subject.charts.push(chart);
    }
    found.subjects.push(subject);
    Ok(())
}

/// Solves and shows elements twice with independent rays, and adds what came of it.
fn measure(stage: &View, subject: &mut Subject, series: &str, pass: &Pass1) -> Result<()> {
    let View { visibility, emitters, camera, reference: Reference { halves: [a, b], mask, .. }, .. } = stage;
    let cameras = std::slice::from_ref(*camera);
    let start = Instant::now();
    let stages = &mut Vec::new();
    let first = if series == ADAPTIVE {
        let what = (pass, Reads::Reflected);
        adaptive::solve(None, visibility, emitters, cameras, what, &|_| (), stages)?.0.solution
    } else {
        pipeline::solve(visibility, emitters, cameras, pass, &|_| (), stages)?.solution
    };
    let seconds = start.elapsed().as_secs_f64();
    let other = Pass1 { seed: pass.seed.wrapping_add(1), ..*pass };
    let reached = pipeline::reached(visibility, cameras, pass.seed, &|_| ());
    let what = (&reached, first.mesh.clone(), None);
    let second = pipeline::solve_mesh(None, visibility, emitters, what, &other, &|_| (), stages)?.solution;
    let show = |solution: &Solution, seed: u32| {
        stage.frame(&settings(Method::TwoPass(Quality::Mesh), SAMPLES, seed), Some(solution)).image
    };
    let (x, y) = (show(&first, pass.seed), show(&second, other.seed));
    let apart = relative_rmse_of_halves([&x, &y], [a, b], Some(mask))?.relative_rmse;
    let point = subject.series(series, "largest edge [m]").at(pass.element_size.unwrap_or_default());
    point.push(ELEMENTS, Unit::Count, first.mesh.len() as f64);
    point.push(APART, Unit::Share, apart);
    point.push(ERROR, Unit::Share, stage.compare(&x, mask)?.relative_rmse);
    point.push(TIME, Unit::Seconds, seconds);
    point.unresolved = point.summary(APART).is_some_and(|s| s.median < stage.reference.resolution);
    Ok(())
}

/// Adds to each setting of adaptive elements how many uniform ones are as good, and how long these take.
fn compare(subject: &mut Subject, found: &mut Measurements) {
    let [uniform, adaptive] = &mut subject.series[..] else { return };
    for point in adaptive.points.iter_mut().filter(|p| !p.unresolved) {
        let median = |q: &str| point.summary(q).map_or(0.0, |s| s.median);
        let (elements, error, time) = (median(ELEMENTS), median(APART), median(TIME));
        let at = |wanted: &str| match uniform.where_reached(ELEMENTS, (APART, error), wanted) {
            Some((value, false)) => Some(value),
            _ => None,
        };
        if let (Some(n), Some(t)) = (at(ELEMENTS), at(TIME)) {
            point.push(MORE, Unit::Plain, n / elements);
            point.push(LONGER, Unit::Plain, t / time);
            found.figures.push(Figure {
                label: format!(
                    "times as many uniform elements as adaptive ones for equal pictures: {}, {:.0} adaptive elements, {:.1} % off",
                    subject.name,
                    elements,
                    100.0 * error
                ),
                unit: Unit::Plain,
                samples: vec![n / elements],
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors that halve with every four times as many uniform elements, and adaptive ones within and beyond their range.
    #[test]
    fn uniform_elements_are_interpolated_at_equal_error() {
        let mut subject = Subject::new("room", "A room", "");
        for (series, size, elements, error, time) in [
            (UNIFORM, 0.4, 1000.0, 0.08, 1.0),
            (UNIFORM, 0.2, 4000.0, 0.04, 4.0),
            (UNIFORM, 0.1, 16_000.0, 0.02, 16.0),
            (ADAPTIVE, 0.4, 100.0, 0.16, 0.5),
            (ADAPTIVE, 0.2, 2000.0, 0.08 / 8f64.sqrt(), 16.0),
            (ADAPTIVE, 0.1, 9000.0, 0.01, 32.0),
        ] {
            let point = subject.series(series, "").at(size);
            point.push(ELEMENTS, Unit::Count, elements);
            point.push(APART, Unit::Share, error);
            point.push(TIME, Unit::Seconds, time);
        }
        let mut found = Measurements::default();
        compare(&mut subject, &mut found);
        let told = |k: usize, q: &str| subject.series[1].points[k].summary(q).map(|s| s.median);
        // Half way from 4,000 to 16,000 elements on a logarithmic scale: 8,000, in 8 s.
        for (quantity, expected) in [(MORE, 4.0), (LONGER, 0.5)] {
            let value = told(1, quantity).expect("a ratio");
            assert!((value - expected).abs() < 1e-9, "{quantity}: {value}");
            assert_eq!((told(0, quantity), told(2, quantity)), (None, None));
        }
        assert_eq!(found.figures.len(), 1);
    }
}
