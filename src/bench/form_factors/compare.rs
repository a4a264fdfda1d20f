//! Who is faster at equal error, and why: computed from the records.

use super::{DIRECTIONS, Method, RADIOSITY, RMS, TIME, series_name};
use crate::bench::{Context, Measurements, threads_in_words};
use crate::report::record::{Chart, Figure, PARAMETER, Point, Subject, Unit};
use crate::report::text;

/// RMS errors at which methods are compared.
const LEVELS: [f64; 11] = [3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5];
const CUBES: [Method; 4] = [Method::Centre, Method::Grid(8), Method::Grid(32), Method::Turned(8)];
const RAYS: [Method; 4] = [Method::Sobol, Method::Reciprocity, Method::Automatic, Method::Pairs];

const HEMISPHERE: &str = "hemisphere rays";
const BEST_RAYS: &str = "best ray-cast";
const BEST_CUBES: &str = "best hemi-cube";
const SPEED: &str = "hemisphere rays: times as fast as the best hemi-cube";
const BEST_SPEED: &str = "best ray-cast: times as fast as the best hemi-cube";

/// RMS error of reflected radiosity at which methods are compared.
const LIGHT_LEVEL: f64 = 0.01;

/// What a method needs for an error.
#[derive(Debug, Clone, PartialEq)]
struct Need {
    series: String,
    seconds: f64,
    /// Directions an element.
    directions: Option<f64>,
    /// The fastest setting of the sweep is good enough: anything faster was not tried.
    at_once: bool,
}

/// What a method needs for this error or less; none where its sweep does not get there.
fn need(subject: &Subject, method: Method, threads: usize, error: (&str, f64)) -> Option<Need> {
    let name = series_name(method, threads);
    let series = subject.series.iter().find(|s| s.name == name)?;
    // What is too good for the answer to tell is as good as the answer at least.
    let beyond = |wanted| {
        let good = |p: &&Point| p.unresolved && p.summary(error.0).is_some_and(|e| e.median <= error.1);
        let all = series.points.iter().filter(good);
        let first = all.filter_map(|p| Some((p.summary(TIME)?.median, p.summary(wanted)?.median)));
        first.min_by(|a, b| a.0.total_cmp(&b.0)).map(|p| (p.1, false))
    };
    let at = |wanted| series.where_reached(TIME, error, wanted).or_else(|| beyond(wanted));
    let (seconds, at_once) = at(TIME)?;
    let directions = at(DIRECTIONS).map(|d| d.0);
    Some(Need { series: method.name(), seconds, directions, at_once })
}

/// The fastest of several methods.
fn best(subject: &Subject, methods: &[Method], threads: usize, error: (&str, f64)) -> Option<Need> {
    let all = methods.iter().filter_map(|m| need(subject, *m, threads, error));
    all.min_by(|a, b| a.seconds.total_cmp(&b.seconds))
}

/// Smallest error that any of these methods was measured with.
fn finest(subject: &Subject, methods: &[Method], threads: usize, error: &str) -> Option<f64> {
    let names: Vec<String> = methods.iter().map(|m| series_name(*m, threads)).collect();
    let points = subject.series.iter().filter(|s| names.contains(&s.name)).flat_map(|s| &s.points);
    points.filter_map(|p| p.summary(error)).map(|s| s.median).min_by(f64::total_cmp)
}

/// One level of a configuration at which rays and hemi-cubes meet.
struct Meeting {
    level: f64,
    /// Hemisphere rays, where they get there.
    rays: Option<Need>,
    /// The best of all ray-cast methods.
    best: Need,
    cubes: Need,
}

impl Meeting {
    /// Hemisphere rays get there, but later than the best hemi-cube.
    fn rays_are_slower(&self) -> bool {
        self.rays.as_ref().is_some_and(|r| r.seconds > self.cubes.seconds)
    }
}

/// Levels that rays and hemi-cubes both reach, but those for which the fastest setting of each will do.
fn meetings(subject: &Subject, threads: usize) -> Vec<Meeting> {
    let meeting = |level| {
        Some(Meeting {
            level,
            rays: need(subject, Method::Sobol, threads, (RMS, level)),
            best: best(subject, &RAYS, threads, (RMS, level))?,
            cubes: best(subject, &CUBES, threads, (RMS, level))?,
        })
    };
    LEVELS.into_iter().filter_map(meeting).filter(|m| !(m.best.at_once && m.cubes.at_once)).collect()
}

/// Puts a summary before the configurations, and its sentences below each.
pub(super) fn compared(context: &Context, mut subjects: Vec<Subject>) -> Measurements {
    let threads = context.threads();
    let mut summary = Subject::new(
        "equal-error",
        format!("Time to equal RMS error, {}", threads_in_words(threads)),
        "What hemisphere rays (Sobol points), the best of all ray-cast methods and the best of all hemi-cubes need for the same RMS error, \
         interpolated between the points of their sweeps below. Errors that one of them does not reach are left out.",
    );
    let (mut slower, mut all_slower) = (Vec::new(), Vec::new());
    let mut fastest: Vec<f64> = Vec::new();
    for subject in &mut subjects {
        let found = meetings(subject, threads);
        for m in &found {
            let point = summary.series(&subject.name, "RMS error, %").at(100.0 * m.level);
            if let Some(rays) = &m.rays {
                point.push(HEMISPHERE, Unit::Seconds, rays.seconds);
                point.push(SPEED, Unit::Plain, m.cubes.seconds / rays.seconds);
            }
            point.push(BEST_RAYS, Unit::Seconds, m.best.seconds);
            point.push(BEST_CUBES, Unit::Seconds, m.cubes.seconds);
            point.push(BEST_SPEED, Unit::Plain, m.cubes.seconds / m.best.seconds);
        }
        if let Some(m) = found.last() {
            fastest.push(m.cubes.seconds / m.best.seconds);
        }
        if found.iter().any(Meeting::rays_are_slower) {
            slower.push(subject.name.clone());
        }
        if found.iter().any(|m| m.best.seconds > m.cubes.seconds) {
            all_slower.push(subject.name.clone());
        }
        let faces = subject.title.rsplit(", ").next().unwrap_or_default().to_string();
        let sentences = sentences(subject, &found, threads, &faces);
        subject.notes.extend(sentences);
    }
    let count = subjects.len();
    let listed = |names: &[String]| if names.is_empty() { "none".into() } else { names.join(", ") };
    summary.notes.push(format!(
        "Hemisphere rays are slower than the best hemi-cube at one equal RMS error or more on {} of {count} configurations: {}.",
        slower.len(),
        listed(&slower)
    ));
    summary.notes.push(format!(
        "The best of all ray-cast methods, both directions' estimates combined and pair by pair included, is slower there on {} of {count}: \
         {}. What the reasons are stands below each configuration.",
        all_slower.len(),
        listed(&all_slower)
    ));
    for quantity in [SPEED, BEST_SPEED] {
        let about = "Above 1 the rays are faster. Towards the left the errors get smaller.";
        summary.charts.push(Chart::new(quantity, PARAMETER, quantity, about));
    }
    let figures = vec![
        Figure {
            label: format!(
                "times as fast as the best hemi-cube: the best ray-cast form factors at the smallest RMS error that both reach, one value \
                 for each of {} configurations",
                fastest.len()
            ),
            unit: Unit::Plain,
            samples: fastest,
        },
        Figure {
            label: format!(
                "of {count} configurations where plain hemisphere rays are slower than the best hemi-cube at some equal RMS error"
            ),
            unit: Unit::Count,
            samples: vec![slower.len() as f64],
        },
    ];
    subjects.insert(0, summary);
    Measurements { figures: figures.into_iter().filter(|f| !f.samples.is_empty()).collect(), subjects }
}

fn percent(share: f64) -> String {
    text::value(share, Unit::Share)
}

fn times(x: f64) -> String {
    text::value(x, Unit::Plain)
}

/// `3.00 times as fast as`, or `1.20 times slower than`.
fn speed(own: f64, other: f64) -> String {
    if own <= other {
        format!("{} times as fast as", times(other / own))
    } else {
        format!("{} times slower than", times(own / other))
    }
}

fn sentences(subject: &Subject, found: &[Meeting], threads: usize, faces: &str) -> Vec<String> {
    let mut said = Vec::new();
    let seconds = |n: &Need| text::value(n.seconds, Unit::Seconds);
    let met: Vec<(&Meeting, &Need)> = found.iter().filter_map(|m| Some((m, m.rays.as_ref()?))).collect();
    let slower = |m: &(&Meeting, &Need)| m.0.rays_are_slower();
    let levels = |wanted: bool| {
        let of = met.iter().filter(|m| slower(m) == wanted).map(|m| percent(m.0.level));
        of.collect::<Vec<_>>().join(", ")
    };
    let which = match (levels(true), levels(false)) {
        (s, f) if s.is_empty() && f.is_empty() => None,
        (s, f) if s.is_empty() => {
            Some(format!("faster than the best hemi-cube at every RMS error that both reach ({f})"))
        }
        (s, f) if f.is_empty() => {
            Some(format!("slower than the best hemi-cube at every RMS error that both reach ({s})"))
        }
        (s, f) => Some(format!("slower than the best hemi-cube at RMS errors of {s}, and faster at {f}")),
    };
    said.extend(which.map(|w| format!("Hemisphere rays are {w}.")));
    // Where it is worst for the rays; the finest error where they always win.
    let ratio = |m: &(&Meeting, &Need)| m.1.seconds / m.0.cubes.seconds;
    let worst = met.iter().filter(|m| slower(m)).max_by(|a, b| ratio(a).total_cmp(&ratio(b))).or(met.last());
    if let Some((m, rays)) = worst {
        said.push(format!(
            "At {} the rays take {}, {} the best hemi-cube ({}, {}).{}",
            percent(m.level),
            seconds(rays),
            speed(rays.seconds, m.cubes.seconds),
            m.cubes.series,
            seconds(&m.cubes),
            why(rays, &m.cubes, faces)
        ));
    }
    if let Some(last) = found.last().filter(|m| m.best.series != Method::Sobol.name()) {
        said.push(format!(
            "At {}, the smallest RMS error that any ray-cast method and hemi-cubes both reach, \"{}\" takes {}, {} the best hemi-cube ({}).",
            percent(last.level),
            last.best.series,
            seconds(&last.best),
            speed(last.best.seconds, last.cubes.seconds),
            last.cubes.series
        ));
    }
    let light = |methods: &[Method]| best(subject, methods, threads, (RADIOSITY, LIGHT_LEVEL));
    if let Some(rays) = light(&RAYS) {
        let against = match light(&CUBES) {
            Some(cubes) => format!(
                "{} the best hemi-cube ({}, {})",
                speed(rays.seconds, cubes.seconds),
                cubes.series,
                seconds(&cubes)
            ),
            None => format!(
                "and no hemi-cube gets there within the sweeps' time ({} at best)",
                finest(subject, &CUBES, threads, RADIOSITY).map_or("-".into(), percent)
            ),
        };
        said.push(format!(
            "For reflected radiosity within {} (RMS) of the answer's, \"{}\" takes {}, {against}.",
            percent(LIGHT_LEVEL),
            rays.series,
            seconds(&rays)
        ));
    }
    let exact = series_name(Method::Exact, threads);
    let exact = subject.series.iter().find(|s| s.name == exact).and_then(|s| s.points.first());
    if let Some((time, error)) = exact.and_then(|p| Some((p.summary(TIME)?, p.summary(RMS)?))) {
        said.push(format!(
            "Nothing lies between these elements: closed forms take {} for an RMS error of {}.",
            text::value(time.median, Unit::Seconds),
            percent(error.median)
        ));
    }
    let of = |methods: &[Method]| finest(subject, methods, threads, RMS).map_or("-".into(), percent);
    said.push(format!(
        "Smallest RMS error within the sweeps' time: {} by hemisphere rays, {} by the best ray-cast method, {} by hemi-cubes.",
        of(&[Method::Sobol]),
        of(&RAYS),
        of(&CUBES)
    ));
    said
}

/// The ratio of times as a product: how many directions each needs, and what one costs.
fn why(by_rays: &Need, by_cubes: &Need, faces: &str) -> String {
    let (Some(rays), Some(cubes)) = (by_rays.directions, by_cubes.directions) else { return String::new() };
    let number = rays / cubes;
    let cost = by_rays.seconds / by_cubes.seconds / number;
    let mut text = format!(
        " They need {} times as many directions as the hemi-cubes have pixels ({} against {}), and a ray costs {} times what a pixel does.",
        times(number),
        text::value(rays, Unit::Count),
        text::value(cubes, Unit::Count),
        times(cost)
    );
    if by_rays.seconds <= by_cubes.seconds {
        return text;
    }
    if cost > 1.0 {
        text += &format!(
            " A face is drawn into all of its pixels at once ({faces} to draw), while each ray finds its own way through the tree."
        );
    }
    if number > 1.0 {
        text += " Pixels have exact weights and lie on a grid, so a factor errs only along the outlines of what is seen; a ray counts \
                 wholly or not at all, and errs wherever an element is smaller than the distance between rays.";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sweep of a method: (time, error, directions).
    fn add(subject: &mut Subject, method: Method, points: &[(f64, f64, f64)]) {
        for (k, (seconds, error, directions)) in points.iter().enumerate() {
            let point = subject.series(&series_name(method, 2), "n").at(k as f64);
            point.push(TIME, Unit::Seconds, *seconds);
            point.push(RMS, Unit::Share, *error);
            if *directions > 0.0 {
                point.push(DIRECTIONS, Unit::Count, *directions);
            }
        }
    }

    #[test]
    fn needs_lie_between_the_points_of_a_sweep() {
        let mut s = Subject::new("s", "t, 6 faces", "");
        // A slow point that is worse than a fast one counts for nothing.
        add(&mut s, Method::Sobol, &[(0.1, 0.4, 16.0), (0.3, 0.9, 8.0), (10.0, 0.004, 1600.0)]);
        let at = |level| need(&s, Method::Sobol, 2, (RMS, level));
        // Halfway between the errors 0.4 and 0.004 on logarithmic axes is halfway between the times.
        let n = at(0.04).expect("reached");
        assert!((n.seconds - 1.0).abs() < 1e-12, "{n:?}");
        assert!((n.directions.expect("has") - 160.0).abs() < 1e-9);
        assert!((at(0.5).expect("at once").seconds - 0.1).abs() < 1e-15);
        assert_eq!(at(0.001), None);
        assert_eq!(need(&s, Method::Centre, 2, (RMS, 0.1)), None);
        s.series[0].points[2].unresolved = true;
        // Its error is known to be no more than this: not between the points, but by then.
        let at = |level| need(&s, Method::Sobol, 2, (RMS, level));
        assert!((at(0.04).expect("a bound").seconds - 10.0).abs() < 1e-12);
        assert_eq!(at(0.001), None);
    }

    /// The sentences follow from the numbers: turned round, they say the opposite.
    #[test]
    fn the_slower_one_is_named_with_its_reason() {
        let fast = [(1e-3, 0.5, 100.0), (1e-1, 5e-3, 1e4)];
        let slow = [(4e-3, 0.5, 50.0), (4e-1, 5e-3, 5e3)];
        let made = |rays: &[(f64, f64, f64)], cubes: &[(f64, f64, f64)]| {
            let mut s = Subject::new("s", "t: 8 elements, 6 faces", "");
            add(&mut s, Method::Sobol, rays);
            add(&mut s, Method::Grid(8), cubes);
            add(&mut s, Method::Pairs, &[(1e-4, 1e-3, 0.0)]);
            let found = meetings(&s, 2);
            (found.len(), sentences(&s, &found, 2, "6 faces").join(" "))
        };
        let (count, text) = made(&slow, &fast);
        // 30, 10, 3 and 1 %.
        assert_eq!(count, 4);
        assert!(text.contains("slower than the best hemi-cube at every RMS error"), "{text}");
        assert!(text.contains("take 0.200 s, 4.00 times slower than the best"), "{text}");
        assert!(
            text.contains("0.500 times as many directions") && text.contains("costs 8.00 times"),
            "{text}"
        );
        assert!(text.contains("6 faces to draw") && !text.contains("exact weights"), "{text}");
        assert!(text.contains("\"rays, pair by pair\" takes 100 us"), "{text}");
        let (_, text) = made(&fast, &slow);
        assert!(text.contains("faster than the best hemi-cube at every RMS error"), "{text}");
        assert!(text.contains("4.00 times as fast as the best") && !text.contains("to draw"), "{text}");
        // Light within 1 %: after 0.2 s of rays; hemi-cubes stay at 4 %.
        let mut s = Subject::new("s", "t, 6 faces", "");
        for (method, seconds, error) in
            [(Method::Automatic, 0.1, 0.04), (Method::Automatic, 0.4, 2.5e-3), (Method::Centre, 0.3, 0.04)]
        {
            let point = s.series(&series_name(method, 2), "n").at(seconds);
            point.push(TIME, Unit::Seconds, seconds);
            point.push(RADIOSITY, Unit::Share, error);
        }
        let text = sentences(&s, &[], 2, "6 faces").join(" ");
        assert!(text.contains("\"rays, automatic\" takes 0.200 s, and no hemi-cube gets there"), "{text}");
        assert!(text.contains("(4.00 % at best)"), "{text}");
        // No common error but those that the fastest setting of each reaches.
        let (count, text) = made(&[(1.0, 0.5, 10.0)], &[(1.0, 0.9, 10.0)]);
        assert_eq!(count, 0);
        assert!(!text.contains("slower") && !text.contains("faster"), "{text}");
        assert!(text.contains("50.0 % by hemisphere rays, 0.100 % by the best"), "{text}");
        assert!(text.contains("90.0 % by hemi-cubes"), "{text}");
    }
}
