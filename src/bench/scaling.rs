//! Time, rate and memory over the number of elements, on one thread and on all.

use super::{Context, Measurements, embedded, pool, thread_counts, threads_in_words};
use crate::Result;
use crate::emitters::Emitters;
use crate::pipeline::{self, Pass1, Stage};
use crate::report::record::{Chart, Figure, PARAMETER, Subject, Unit};
use crate::visibility::Visibility;

/// Rays an element.
const RAYS: u32 = 64;
const TIME: &str = "pass 1";

pub fn run(context: &Context) -> Result<Measurements> {
    let scene = embedded("cornell")?;
    let visibility = Visibility::new(context.device, &scene)?;
    let emitters = Emitters::new(&visibility);
    let area: f64 = scene.faces.iter().map(|f| f.area).sum();
    let counts: &[f64] = context.choose(&[1e3, 1e4, 3e4], &[1e3, 1e4, 1e5, 1e6]);
    let mut subject = Subject::new(
        "cornell",
        format!("cornell, {RAYS} rays an element"),
        "Pass 1 (form factors and the solution) with more and more elements of the same scene. Rays meet the scene's faces, not its \
         elements, so a ray costs the same however fine the elements are. Time should grow in proportion to the elements.",
    );
    let all = context.threads();
    let mut rate = Vec::new();
    let threads = thread_counts(context);
    let mut speedup = Vec::new();
    // Warm-up.
    let small = Pass1 {
        rays: RAYS,
        element_size: Some((2.55 * area / counts[0]).sqrt()),
        seed: context.settings.seed,
    };
    pipeline::solve(&visibility, &emitters, &[], &small, &|_| (), &mut Vec::new())?;
    for &count in counts {
        // Two-sided faces and cells shorter than asked for make 2.55 times as many as the area alone.
        let element_size = Some((2.55 * area / count).sqrt());
        // A million elements take a minute.
        let runs = if count > 2e5 { 2 } else { 3 };
        for round in 0..runs {
            let seed = context.settings.seed.wrapping_add(round);
            let mut seconds = Vec::new();
            for &n in &threads {
                let pool = pool(n)?;
                (context.observer)(&format!("scaling: about {count} elements, {n} threads, seed {seed}"));
                let mut stages: Vec<Stage> = Vec::new();
                let settings = Pass1 { rays: RAYS, element_size, seed };
                let start = std::time::Instant::now();
                let result = pool.install(|| {
                    pipeline::solve(&visibility, &emitters, &[], &settings, &|_| (), &mut stages)
                })?;
                let total = start.elapsed().as_secs_f64();
                let series = threads_in_words(n);
                let point = subject.series(&series, "elements").at(result.solution.mesh.len() as f64);
                point.push(TIME, Unit::Seconds, total);
                for stage in &stages {
                    let name = if stage.name == "solve" { "of it solution" } else { "of it form factors" };
                    point.push(name, Unit::Seconds, stage.seconds);
                    if stage.rays > 0 {
                        point.push("rays a second", Unit::RaysPerSecond, stage.rays as f64 / stage.seconds);
                        if n == all && count == counts[counts.len() - 1] {
                            rate.push(stage.rays as f64 / stage.seconds);
                        }
                    }
                }
                point.push("matrix", Unit::Bytes, result.matrix_bytes as f64);
                seconds.push(total);
            }
            if let [one, many] = seconds[..] {
                let size = subject.series[0].points.last().map_or(count, |p| p.parameter);
                let point = subject.series(&threads_in_words(all), "elements").at(size);
                point.push("speed-up by threads", Unit::Plain, one / many);
                if count == counts[counts.len() - 1] {
                    speedup.push(one / many);
                }
            }
        }
    }
    let chart = Chart::new(
        "Time over elements",
        PARAMETER,
        TIME,
        "A slope of 1 is time in proportion to the number of elements. Small scenes lie above the line: what does not depend on the \
         elements (finding which surfaces light can reach) shows there.",
    );
    subject.charts.push(chart.fitted(&subject.series).guide("in proportion: 1", 1.0));
    let chart = Chart::new(
        "Memory over elements",
        PARAMETER,
        "matrix",
        "The matrix of form factors. It holds at most one entry a ray, so it too grows in proportion. What a whole run of the program \
         needs is the group memory's to tell.",
    );
    subject.charts.push(chart.fitted(&subject.series).guide("in proportion: 1", 1.0));
    let last = counts[counts.len() - 1];
    let mut figures = vec![Figure {
        label: format!("rays a second of pass 1 with about {last} elements, {all} threads"),
        unit: Unit::RaysPerSecond,
        samples: rate,
    }];
    if !speedup.is_empty() {
        figures.push(Figure {
            label: format!("times faster on {all} threads than on one (pass 1, about {last} elements)"),
            unit: Unit::Plain,
            samples: speedup,
        });
    }
    Ok(Measurements { figures, subjects: vec![subject] })
}
