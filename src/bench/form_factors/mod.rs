//! Form factors: error over time of rays, hemi-cubes and closed forms, from fast to precise.

mod cases;
mod compare;
mod light;
mod truth;

use super::{Context, Measurements, pool, thread_counts, threads_in_words};
use crate::Result;
use crate::form_factor::pairs::{PairFactors, PairWork};
use crate::form_factor::{
    AtSpecular, Casting, Enforce, Estimates, ExchangeMatrix, Factors, Found, HemicubeSettings, Request, cast,
    cast_random, cast_rows, correct, estimate, hemicube,
};
use crate::pipeline::BATCHES;
use crate::report::record::{Chart, PARAMETER, Subject, Unit};
use crate::visibility::Visibility;
use cases::{Answer, Configuration, configurations};
use light::Light;
use std::time::Instant;
use truth::{Truth, closure, pair_work, reciprocity};

const TIME: &str = "time";
const RMS: &str = "RMS error";
const LARGEST: &str = "largest error";
const RADIOSITY: &str = "RMS error of reflected radiosity";
const CLOSURE: &str = "closure residual";
const RECIPROCITY: &str = "reciprocity residual";
const DIRECTIONS: &str = "directions an element";
/// Factor below which [`Method::Pairs`] counts errors as shares of this one.
const FLOOR: f64 = 1e-4;

/// A way to form factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    /// Hemisphere rays from independent random points.
    Random,
    /// Hemisphere rays from Owen-scrambled Sobol points.
    Sobol,
    /// The same, both directions' estimates combined.
    Reciprocity,
    /// Hemisphere rays, and pair by pair what these are bad at: what [`estimate`] makes of a number of rays.
    Automatic,
    /// Exact unoccluded factors times visible fractions, until an error is met.
    Pairs,
    /// Closed forms.
    Exact,
    /// One hemi-cube at the centre.
    Centre,
    /// n x n hemi-cubes of so many pixels along an edge.
    Grid(u32),
    /// The same, each turned at random about the normal and placed at random within its part.
    Turned(u32),
}

impl Method {
    fn name(self) -> String {
        match self {
            Method::Random => "rays, random".into(),
            Method::Sobol => "rays, Sobol".into(),
            Method::Reciprocity => "rays, Sobol, reciprocity".into(),
            Method::Automatic => "rays, automatic".into(),
            Method::Pairs => "rays, pair by pair".into(),
            Method::Exact => "exact".into(),
            Method::Centre => "hemi-cube, centre".into(),
            Method::Grid(pixels) => format!("hemi-cubes n x n, {pixels} px"),
            Method::Turned(pixels) => format!("hemi-cubes n x n, {pixels} px, turned"),
        }
    }

    /// What its settings vary.
    fn parameter(self) -> &'static str {
        match self {
            Method::Random | Method::Sobol | Method::Reciprocity | Method::Automatic => "rays an element",
            Method::Pairs | Method::Exact => "relative accuracy asked for, 10^-",
            Method::Centre => "pixels along an edge",
            Method::Grid(_) | Method::Turned(_) => "hemi-cubes along an edge",
        }
    }

    /// Its settings from fast to precise, as far as anyone would go.
    fn settings(self) -> Vec<u32> {
        match self {
            Method::Random | Method::Sobol | Method::Reciprocity | Method::Automatic => {
                (2..=11).map(|k| 1 << (2 * k)).collect()
            }
            Method::Pairs => vec![1, 2, 3, 4],
            Method::Exact => vec![3, 5, 7, 9],
            Method::Centre => (2..=11).map(|k| 1 << k).collect(),
            Method::Grid(_) | Method::Turned(_) => (1..=7).map(|k| 1 << k).collect(),
        }
    }

    /// Directions that one element looks in, where it does.
    fn directions(self, setting: u32) -> Option<f64> {
        // A top of n x n pixels and four sides of half that.
        let cube = |n: u32| 3.0 * f64::from(n) * f64::from(n);
        match self {
            Method::Random | Method::Sobol | Method::Reciprocity => Some(f64::from(setting)),
            Method::Centre => Some(cube(setting)),
            Method::Grid(pixels) | Method::Turned(pixels) => Some(cube(pixels) * f64::from(setting).powi(2)),
            Method::Automatic | Method::Pairs | Method::Exact => None,
        }
    }

    /// The same result for every seed.
    fn is_fixed(self) -> bool {
        matches!(self, Method::Exact | Method::Centre | Method::Grid(_))
    }

    /// The factors and the time that they took [s]. Rays pay for the tree that they need; bringing all factors to one form
    /// afterwards costs none of them.
    fn find(
        self,
        context: &Context,
        configuration: &Configuration,
        setting: u32,
        seed: u32,
    ) -> Result<(Factors, f64)> {
        let (scene, mesh) = (&configuration.scene, &configuration.mesh);
        let n = mesh.len();
        let rows = configuration.sample.as_ref().map(|s| s.asked.as_slice());
        let scale = configuration.sample.as_ref().map_or(1.0, |s| n as f64 / s.len() as f64);
        let start = Instant::now();
        let tree = || Visibility::new(context.device, scene);
        let raw = |matrix: &ExchangeMatrix| Factors::of_elements(scene, mesh, (matrix, None), 0..n, 0.0);
        let of_matrix = |matrix: ExchangeMatrix| {
            let seconds = scale * start.elapsed().as_secs_f64();
            Ok((raw(&matrix), seconds))
        };
        let of_pairs = |pairs: PairFactors| {
            let seconds = start.elapsed().as_secs_f64();
            let rays = pairs.rays;
            let estimates = Estimates::Pairs(pairs, None);
            let found = Found { estimates, achieved: None, rays, blocked: Vec::new() };
            Ok((Factors::of_found(scene, mesh, &found, (false, 0..n), 0.0), seconds))
        };
        let casting = Casting {
            rays: setting,
            batches: BATCHES,
            seed,
            specular: AtSpecular::End,
            reached: None,
            emitters: None,
            progress: &|_| (),
        };
        let cubes = |resolution: u32, grid: u32, rotations: u32| {
            let settings = HemicubeSettings { resolution, grid, rotations, seed };
            hemicube(scene, mesh, &settings, rows, &|_| ())
        };
        match self {
            Method::Random => of_matrix(cast_random(&tree()?, mesh, &casting, rows)),
            Method::Sobol => of_matrix(cast_rows(&tree()?, mesh, &casting, rows).0),
            Method::Reciprocity => {
                let mut factors = raw(&cast(&tree()?, mesh, &casting).0);
                correct(&mut factors, Enforce::Reciprocity)?;
                Ok((factors, start.elapsed().as_secs_f64()))
            }
            Method::Automatic => {
                let request = Request {
                    rays: setting,
                    error: None,
                    floor: FLOOR,
                    by_object: false,
                    seed,
                    progress: &|_| (),
                };
                let found = estimate(&tree()?, mesh, &request);
                let seconds = start.elapsed().as_secs_f64();
                Ok((Factors::of_found(scene, mesh, &found, (false, 0..n), 0.0), seconds))
            }
            Method::Pairs => {
                let error = 10f64.powi(-(setting as i32));
                let work = pair_work(seed);
                // As [`estimate`] does where an error is asked for.
                let tolerance = work.tolerance.max(0.01 * error);
                let (error, cells) = (Some(error), Some(error));
                let work = PairWork { error, cells, tolerance, floor: FLOOR, ..work };
                of_pairs(PairFactors::new(&tree()?, mesh, &work))
            }
            Method::Exact => {
                let tolerance = 10f64.powi(-(setting as i32));
                let work = pair_work(seed);
                let work = PairWork { tolerance, unoccluded: true, ..work };
                of_pairs(PairFactors::new(&tree()?, mesh, &work))
            }
            Method::Centre => of_matrix(cubes(setting, 1, 0)),
            Method::Grid(pixels) => of_matrix(cubes(pixels, setting, 0)),
            Method::Turned(pixels) => of_matrix(cubes(pixels, setting, 1)),
        }
    }
}

pub fn run(context: &Context) -> Result<Measurements> {
    let mut subjects = Vec::new();
    for configuration in configurations(context)? {
        subjects.push(sweep(context, &configuration)?);
    }
    Ok(compare::compared(context, subjects))
}

/// Every method on one configuration, on one thread and on all.
fn sweep(context: &Context, configuration: &Configuration) -> Result<Subject> {
    let n = configuration.mesh.len();
    let visibility = Visibility::new(context.device, &configuration.scene)?;
    (context.observer)(&format!("form-factors: {}, {n} elements, answer", configuration.name));
    let truth = Truth::new(&visibility, configuration)?;
    drop(visibility);
    let light = Light::new(configuration, &truth);
    let title = format!("{}: {n} elements, {} faces", configuration.title, configuration.scene.faces.len());
    let mut subject = Subject::new(configuration.name, title, configuration.about);
    let many = matches!(configuration.answer, Answer::Rows { .. });
    let rounds = if many { 1 } else { context.choose(1, 3) };
    let threads = thread_counts(context);
    let pools = threads.iter().map(|&n| pool(n)).collect::<Result<Vec<_>>>()?;
    let all = &pools[pools.len() - 1];
    for method in configuration.methods() {
        (context.observer)(&format!("form-factors: {}, {}", configuration.name, method.name()));
        // The warm-up decides how far the sweep goes: as long as a setting stays within its time.
        let mut settings = Vec::new();
        for setting in method.settings() {
            let first = context.settings.seed;
            let (_, seconds) = all.install(|| method.find(context, configuration, setting, first))?;
            if seconds > configuration.longest && !settings.is_empty() {
                break;
            }
            settings.push(setting);
        }
        for round in 0..rounds {
            let seed = context.settings.seed.wrapping_add(round);
            for &setting in &settings {
                for (pool, &threads) in pools.iter().zip(&threads) {
                    let (factors, seconds) =
                        pool.install(|| method.find(context, configuration, setting, seed))?;
                    record(
                        &mut subject,
                        configuration,
                        (&truth, light.as_ref()),
                        (method, setting, threads),
                        &factors,
                        seconds,
                    );
                }
            }
        }
    }
    subject.notes.push(format!("Answer: {}", truth.words));
    subject.notes.push(format!(
        "A sweep goes on as long as a setting takes no more than {} s on {}; every setting that was measured is in the records.",
        configuration.longest,
        threads_in_words(context.threads())
    ));
    charts(&mut subject, configuration, &threads, light.is_some());
    Ok(subject)
}

/// Adds one matrix to the records.
fn record(
    subject: &mut Subject,
    configuration: &Configuration,
    (truth, light): (&Truth, Option<&Light>),
    (method, setting, threads): (Method, u32, usize),
    factors: &Factors,
    seconds: f64,
) {
    let distance = truth.distance(factors);
    let series = series_name(method, threads);
    let point = subject.series(&series, method.parameter()).at(f64::from(setting));
    point.push(TIME, Unit::Seconds, seconds);
    // A result that no seed changes has one error; only its time varies.
    if point.get(RMS).is_none() || !method.is_fixed() {
        point.push(RMS, Unit::Share, distance.rms);
        point.push(LARGEST, Unit::Share, distance.largest);
        if let Some(light) = light {
            point.push(RADIOSITY, Unit::Share, light.error(factors));
        }
        // What lies outside is no result of these; where nothing does, their rows must close by themselves.
        if !matches!(method, Method::Automatic | Method::Pairs | Method::Exact) {
            point.push(CLOSURE, Unit::Plain, closure(factors));
        } else if configuration.closed {
            let sums = (0..factors.nodes()).map(|i| (factors.row(i).1.iter().sum::<f64>() - 1.0).abs());
            point.push(CLOSURE, Unit::Plain, sums.fold(0.0, f64::max));
        }
        let held = configuration.sample.as_ref().map(|s| s.asked.as_slice());
        point.push(RECIPROCITY, Unit::Share, reciprocity(factors, held));
        if let Some(directions) = method.directions(setting) {
            point.push(DIRECTIONS, Unit::Count, directions);
        }
    }
    point.unresolved = distance.unresolved;
}

fn series_name(method: Method, threads: usize) -> String {
    format!("{}, {}", method.name(), threads_in_words(threads))
}

fn charts(subject: &mut Subject, configuration: &Configuration, threads: &[usize], has_light: bool) {
    for &n in threads.iter().rev() {
        let names: Vec<String> = configuration.methods().into_iter().map(|m| series_name(m, n)).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        for (quantity, about) in [
            (
                RMS,
                "Root mean square error over all pairs of elements, as a share of the factors' own root mean square. Further down and \
                 further left is better.",
            ),
            (LARGEST, "The worst pair of elements, as a share of the largest factor."),
            (
                RADIOSITY,
                "Light of the scene's own emitters and reflectances, by these factors: the error of what surfaces reflect, root mean \
                 square over their area, as a share of its own root mean square.",
            ),
        ] {
            // The worst pair and the light are the same on any number of threads.
            if quantity != RMS && n != threads[threads.len() - 1] {
                continue;
            }
            if quantity == RADIOSITY && !has_light {
                continue;
            }
            let title = format!("{quantity} over time, {}", threads_in_words(n));
            subject.charts.push(Chart::new(&title, TIME, quantity, about).only(&names));
        }
    }
    let last = threads[threads.len() - 1];
    let drawn = [Method::Random, Method::Sobol].map(|m| series_name(m, last));
    let chart = Chart::new(
        "RMS error over rays",
        PARAMETER,
        RMS,
        "Random points give a slope of -1/2 by theory. Sobol points do better the smoother the visible part of an element is over the \
         hemisphere and the element; where a row has more entries than rays, each entry is hit once or never, and no points help.",
    );
    subject.charts.push(
        chart.only(&[&drawn[0], &drawn[1]]).fitted(&subject.series).guide("random sampling: -1/2", -0.5),
    );
}

#[cfg(test)]
mod tests;
