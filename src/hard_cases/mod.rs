//! Cases on which radiosity, form factors and single-precision rays are known to break, with their answers.
//!
//! Each [`Case`] builds its scene, runs the program and compares with an answer that does not come from
//! the same code: a closed form, an invariant such as the furnace, or quadrature ([`exact`]).

pub mod build;
pub mod exact;
mod geometry;
mod specular;
mod transport;
mod work;

use crate::Result;
use crate::color::Rgb;
use crate::embree::Device;
use crate::emitters::Emitters;
use crate::error::Error;
use crate::image::Image;
use crate::pipeline::{self, Pass1, Pass1Result};
use crate::render;
use crate::scene::Scene;
use crate::visibility::Visibility;
use std::time::Instant;

/// One case.
#[derive(Clone, Copy)]
pub struct Case {
    /// `geometry`, `transport` or `work`.
    pub group: &'static str,
    /// What it is called in tables.
    pub name: &'static str,
    /// What is known to go wrong on it.
    pub breaks: &'static str,
    /// Where the answer comes from.
    pub answer: &'static str,
    /// Relative error that is allowed however small the standard error is.
    pub limit: f64,
    /// How long it takes.
    pub pace: Pace,
    /// Runs it.
    pub run: fn() -> Result<Outcome>,
}

/// How long a case takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Less than a second.
    Fast,
    /// Seconds: left out of quick runs of the benchmark suite.
    Seconds,
    /// Minutes: left out of tests too.
    Minutes,
}

/// What a case came to.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// A number was compared.
    Number {
        /// Relative error.
        error: f64,
        /// The program's own standard error, relative; 0 where none applies.
        standard_error: f64,
    },
    /// The program refused or warned, as it should, in these words.
    Said(String),
}

/// A case's outcome and its time.
#[derive(Debug, Clone)]
pub struct Measured {
    /// The case.
    pub case: &'static str,
    /// Its outcome, or what went wrong.
    pub outcome: std::result::Result<Outcome, String>,
    /// Wall time \[s\].
    pub seconds: f64,
}

impl Case {
    /// Runs the case and measures its time.
    pub fn measure(&self) -> Measured {
        let start = Instant::now();
        let outcome = (self.run)().map_err(|e| e.to_string());
        Measured { case: self.name, outcome, seconds: start.elapsed().as_secs_f64() }
    }

    /// Whether an outcome is right: within `limit` or four standard errors, whichever is larger.
    pub fn passes(&self, measured: &Measured) -> bool {
        match measured.outcome {
            Ok(Outcome::Number { error, standard_error }) => error <= self.limit.max(4.0 * standard_error),
            Ok(Outcome::Said(_)) => true,
            Err(_) => false,
        }
    }
}

/// All cases in the order of tables.
pub fn cases() -> Vec<Case> {
    [geometry::CASES, transport::CASES, specular::CASES, work::CASES].concat()
}

/// Pass 1 of a scene without a camera.
fn solve(scene: &Scene, rays: u32, element_size: Option<f64>, seed: u32) -> Result<Pass1Result> {
    let device = Device::new(0)?;
    let visibility = Visibility::new(&device, scene)?;
    let settings = Pass1 { rays, element_size, seed };
    pipeline::solve(&visibility, &Emitters::new(&visibility), &[], &settings, &|_| (), &mut Vec::new())
}

/// An image by a method, after pass 1 where the method needs it.
fn picture(
    scene: &Scene,
    method: render::Method,
    spp: u32,
    (rays, element_size): (u32, Option<f64>),
    seed: u32,
) -> Result<Image> {
    let device = Device::new(0)?;
    let visibility = Visibility::new(&device, scene)?;
    let emitters = Emitters::new(&visibility);
    let camera = scene.camera(None)?.clone();
    let settings = Pass1 { rays, element_size, seed };
    let needs_solution = !matches!(method, render::Method::Whitted | render::Method::Path);
    let solution = if needs_solution {
        let cameras = std::slice::from_ref(&camera);
        let r = pipeline::solve(&visibility, &emitters, cameras, &settings, &|_| (), &mut Vec::new())?;
        Some(r.solution)
    } else {
        None
    };
    let settings = render::Settings {
        method,
        spp,
        gather_rays: 16,
        emitter_samples: 4,
        estimator: render::Estimator::Lobe(4),
        seed,
    };
    Ok(render::render(&visibility, &emitters, solution.as_ref(), &camera, &settings, &|_| ()).0)
}

/// Compares the mean radiosities of objects' fronts with their answers: the worst, measured by what is allowed.
fn compare(result: &Pass1Result, answers: &[(&str, f64)]) -> Result<Outcome> {
    let mut worst = (0.0, 0.0, -1.0);
    for (name, exact) in answers {
        let (mut area, mut sum, mut error) = (0.0, 0.0, 0.0);
        for o in result.solution.objects.iter().filter(|o| o.front && (name.is_empty() || o.name == *name)) {
            area += o.area;
            sum += o.area * o.radiosity.x;
            // Errors of one object's parts, and of objects that see each other, may be alike.
            error += o.area * o.standard_error.x;
        }
        if area == 0.0 {
            return Err(Error::scene(name.to_string(), "no elements there"));
        }
        let (off, se) = ((sum / area / exact - 1.0).abs(), error / area / exact);
        if off.is_nan() {
            return Err(Error::scene(name.to_string(), "the answer is not a number"));
        }
        let weight = off / f64::max(0.01, 4.0 * se);
        if weight > worst.2 {
            worst = (off, se, weight);
        }
    }
    Ok(Outcome::Number { error: worst.0, standard_error: worst.1 })
}

/// Solves and compares.
fn solved(
    text: &build::SceneText,
    rays: u32,
    element_size: Option<f64>,
    answers: &[(&str, f64)],
) -> Result<Outcome> {
    let scene = text.load()?;
    compare(&solve(&scene, rays, element_size, 1)?, answers)
}

/// The largest relative departure of any pixel from a constant.
fn departure(image: &Image, exact: f64) -> Outcome {
    let mut error: f64 = 0.0;
    for y in 0..image.height {
        for x in 0..image.width {
            for v in image.get(x, y) {
                let off = (f64::from(v) / exact - 1.0).abs();
                error = if off.is_nan() { f64::INFINITY } else { error.max(off) };
            }
        }
    }
    Outcome::Number { error, standard_error: 0.0 }
}

/// Expects an error, or a warning that holds all of `words`.
fn said<T>(result: Result<T>, warnings: &[String], words: &[&str]) -> Result<Outcome> {
    let holds = |m: &String| words.iter().all(|w| m.contains(w));
    let messages: Vec<String> =
        result.err().map(|e| e.to_string()).into_iter().chain(warnings.iter().cloned()).collect();
    match messages.iter().find(|m| holds(m)) {
        Some(m) => Ok(Outcome::Said(m.clone())),
        None => Err(Error::scene("case", format!("no message with {words:?} among {messages:?}"))),
    }
}

/// Mean of an image's pixels.
fn mean(image: &Image) -> f64 {
    let (mut sum, mut n) = (Rgb::ZERO, 0.0);
    for y in 0..image.height {
        for x in 0..image.width {
            sum += Rgb::from(image.get(x, y).map(f64::from));
            n += 1.0;
        }
    }
    crate::color::mean(sum / n)
}
