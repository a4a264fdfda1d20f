//! An image of a given error: chooses quality, elements, rays and samples, and says what was achieved.
//!
//! The error is the relative RMSE of DESIGN section 2: the root of the mean squared error over the mean, over the pixels that
//! see no emitter directly. Its square has two parts, which need different remedies and are found apart:
//! - *discretisation*, what stays however many rays are cast: from a pilot on few pixels;
//! - *noise* of both passes: the picture is the mean of two halves, independent in both passes, and the noise of
//!   their mean is half their difference. More pairs of halves are added until the sum is small enough.
//!
//! Decisions rest on counts of rays, never on times, so that they are the same on every machine.

mod pilot;

use crate::emitters::Emitters;
use crate::image::Image;
use crate::mesh::Sides;
use crate::pipeline::{Event, Observer, Pass1, Pass1Result, Stage, merge, solve_reached, stage};
use crate::radiosity::UNCERTAIN;
use crate::render::{Method, Quality, Settings, render};
use crate::sampling::seed_of;
use crate::scene::Camera;
use crate::visibility::Visibility;
use crate::{Error, Result};
use pilot::{Noise, Pilot, Square};
use serde::Serialize;

/// Share of the error asked for that is aimed at.
const AIM: f64 = 0.7;
/// Share of it at which the estimate counts as met: what is left covers the estimate's own error.
const MET: f64 = 0.8;
/// Most of the squared aim that discretisation may take.
const SYSTEMATIC: f64 = 0.7;
/// Most of the squared aim that the standard error of the squared discretisation may take: beyond it, nobody knows.
const UNSURE: f64 = 0.25;
/// Most work of the pilot's next step to learn whether a plan will do, over the work of that plan.
const KNOWING: f64 = 1.0;
/// Most work of it, over that of the next level, before which it comes: finer elements do not make noise smaller.
const EAGER: f64 = 2.0;
/// Part of a plan's rays and samples that the first pair of halves gets, where these are many: what is missing is known better
/// from its noise than from the pilot's.
const FIRST: u32 = 4;
/// Samples of a plan from which these are many.
const MANY_SAMPLES: u32 = 16;
/// Time of an element of pass 1 in rays of its row, beside these. Measured: 35 and 0.24 microseconds.
const ELEMENT: f64 = 150.0;
/// Time of a ray of pass 2 over that of one of pass 1, whose packets are coherent. Measured: 0.32 and 0.19 microseconds.
const RAY: f64 = 1.7;
/// Time of a sample of pass 2 beside its rays, in rays of pass 1.
const SAMPLE: f64 = 1.8;
/// Time of a ray of pass 1 over specular surfaces, or that samples an emitter, over that of one of an element's own.
/// Measured: 0.7 and 0.24 microseconds.
const SINGLE: f64 = 3.0;
/// Largest share of a plan's cost at which another, with what it takes to know it, is worth looking for.
const HOPE: f64 = 0.5;
/// The least error that can be hoped for, over that asked for, from which nothing is tried.
const HOPELESS: f64 = 2.0;
/// Levels that the pilot looks ahead, for finer elements that might do.
const AHEAD: u32 = 3;
/// Least and most of what is left of a squared error on the next level, as far as can be told from two.
const FALL: (f64, f64) = (0.1, 0.7);
/// Fewest rays an element in a half.
const FEWEST_RAYS: f64 = 64.0;
/// Most rays an element in a half.
const MOST_RAYS: f64 = (1 << 17) as f64;
/// Most samples a pixel in all.
const MOST_SAMPLES: u32 = 4096;
/// Most elements.
const MOST_ELEMENTS: usize = 1 << 19;
/// Largest growth of work from one pair of halves to the next.
const GROWTH: f64 = 8.0;

/// A scene that is ready for rays, and what is to be seen of it.
pub struct View<'a, 's> {
    /// Scene and tree.
    pub visibility: &'a Visibility<'s>,
    /// Its emitters.
    pub emitters: &'a Emitters,
    /// Sides that light or a camera can reach.
    pub reached: Sides,
    /// The camera.
    pub camera: &'a Camera,
    /// What pass 2 does apart from quality, samples and seed.
    pub settings: Settings,
    /// Memory that pass 1 may take \[bytes\]; none: whatever it needs.
    pub limit: Option<u64>,
}

/// How wrong the picture is, and what was chosen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Achieved {
    /// Relative RMSE asked for.
    pub asked: f64,
    /// Whether the estimate says so, with one standard error of its part by elements.
    pub met: bool,
    /// Estimate of the picture's relative RMSE.
    pub relative_rmse: f64,
    /// Its part by noise of both passes.
    pub noise: f64,
    /// Its part by the size of elements and by the quality; where that is not known well, the most that it may be, by one standard error.
    pub discretisation: f64,
    /// Standard error of the squared discretisation.
    pub discretisation_squared_error: f64,
    /// `mesh`, `direct` or `gather`.
    pub quality: &'static str,
    /// Largest element edge \[m\].
    pub element_size: f64,
    /// Elements.
    pub elements: usize,
    /// Independent solutions of pass 1.
    pub solves: u32,
    /// Rays an element, in all solutions together.
    pub rays: u64,
    /// Samples a pixel in all.
    pub spp: u32,
    /// Pixels of the pilot.
    pub pilot_pixels: usize,
    /// Element sizes of the pilot \[m\].
    pub pilot_element_sizes: Vec<f64>,
    /// Rays that the pilot cast.
    pub pilot_rays: u64,
}

/// The picture, what is known of its error, and the last solution of pass 1 with its settings.
pub struct Rendered {
    /// The mean of all halves.
    pub image: Image,
    /// The most of its two halves' [`crate::render::Traced::dropped`].
    pub dropped: f64,
    /// How wrong it is.
    pub achieved: Achieved,
    /// Pass 1 of the last half.
    pub pass1: Pass1Result,
    /// Its settings.
    pub settings: Pass1,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Work of one half of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Plan {
    /// Index in [`Quality::ALL`].
    quality: usize,
    level: usize,
    bias: Square,
    rays: u32,
    spp: u32,
    /// Of both halves, in rays of pass 1.
    cost: f64,
}

/// Renders a picture whose relative RMSE is at most `error`, within (0, 1), as far as can be told.
///
/// # Errors
/// As pass 1 ([`solve_reached`]); where no pixel has light from anything but lamps in view; and where the most work that is tried leaves
/// an error of more than twice that asked for.
pub fn render_to_error(
    view: &View,
    error: f64,
    seed: u32,
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Rendered> {
    let mask = pilot::mask(view);
    let (pilot, plan) = stage("pilot", 0, observer, stages, || {
        let found = prepare(view, &mask, error, seed);
        let cast = found.as_ref().map_or(0, |f| f.0.cast);
        (found, cast)
    })?;
    finish(view, (&pilot, plan), &mask, error, seed, observer, stages)
}

/// Refines the pilot's elements until the cheapest plan is known.
fn prepare<'a, 's>(
    view: &'a View<'a, 's>,
    mask: &[bool],
    error: f64,
    seed: u32,
) -> Result<(Pilot<'a, 's>, Plan)> {
    let mut pilot = Pilot::new(view, mask, error, seed);
    let dark = "no pixel shows light but that of lamps in view: an error relative to their mean has no meaning (--error)";
    if pilot.pixels.is_empty() {
        return Err(Error::Usage(dark.into()));
    }
    let aim = (AIM * error).powi(2);
    loop {
        let finer = pilot.refine()?;
        if pilot.mean().is_nan() || pilot.mean() <= 0.0 {
            return Err(Error::Usage(dark.into()));
        }
        if finer && pilot.levels.len() < 2 {
            continue;
        }
        let least = pilot.least();
        if least > HOPELESS * error {
            return Err(Error::Usage(format!(
                "--error {error} is out of reach: {MOST_SAMPLES} samples a pixel and {MOST_RAYS} rays an element, the most that is \
                 tried, leave an error of {least:.1e} at least: ask for a larger error"
            )));
        }
        let early = finer && pilot.levels.len() < 3;
        // Where nobody knows, more rays may tell what finer elements do not, and sooner.
        while let Some((noise, cost)) = worth_knowing(&pilot, view.camera, aim).filter(|_| !early) {
            if cost > EAGER * pilot.cost_to_refine() || !pilot.sharpen(noise)? {
                break;
            }
        }
        let best = cheapest(&pilot, view.camera, aim, UNSURE);
        let last = &pilot.levels[pilot.levels.len() - 1];
        let useless = best.is_some_and(|b| !early && !worth_refining(&pilot, view.camera, aim, b.cost));
        if !finer || useless || 4 * last.elements > MOST_ELEMENTS {
            break;
        }
    }
    while let Some((noise, _)) = worth_knowing(&pilot, view.camera, aim) {
        if !pilot.sharpen(noise)? {
            break;
        }
    }
    let plan = cheapest(&pilot, view.camera, aim, UNSURE)
        .or_else(|| cheapest(&pilot, view.camera, aim, f64::INFINITY))
        .unwrap_or_else(|| least_wrong(&pilot, view.camera, aim));
    Ok((pilot, plan))
}

/// Whether finer elements might lead to a plan that saves more than it takes to know it, if errors go on to fall as they do.
fn worth_refining(pilot: &Pilot, camera: &Camera, aim: f64, cost: f64) -> bool {
    let last = pilot.levels.len() - 1;
    (0..Quality::ALL.len()).any(|quality| {
        let [before, mut bias] = [last - 1, last].map(|level| pilot.bias(quality, level).value.max(0.0));
        let falls = (bias / before.max(f64::MIN_POSITIVE)).clamp(FALL.0, FALL.1);
        let (mut on_the_way, mut step) = (0.0, pilot.cost_to_refine());
        (1..=AHEAD).any(|finer| {
            (on_the_way, step, bias) = (on_the_way + step, 4.0 * step, bias * falls);
            let variance = aim - bias;
            bias <= SYSTEMATIC * aim
                && on_the_way < HOPE * cost
                && on_the_way + fill(pilot, camera, (quality, last, finer), variance).cost < HOPE * cost
        })
    })
}

/// Where no plan is known to do: what hides whether the cheapest does that might, and what it costs to know, unless that is
/// more than the plan itself.
fn worth_knowing(pilot: &Pilot, camera: &Camera, aim: f64) -> Option<(Noise, f64)> {
    if cheapest(pilot, camera, aim, UNSURE).is_some() {
        return None;
    }
    let hopes = pilot.biases().filter_map(|(q, l, bias)| {
        let may_do = bias.value - 2.0 * bias.error <= SYSTEMATIC * aim && !bias.is_known(aim, UNSURE);
        let cost = || fill(pilot, camera, (q, l, 0), (1.0 - 0.5 * SYSTEMATIC) * aim).cost;
        may_do.then(|| (cost(), pilot.sharper(q, l)))
    });
    let affordable = hopes.filter(|(plan, (_, cost))| *cost <= KNOWING * plan);
    affordable.map(|h| h.1).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// The cheapest plan that should meet a squared error, of those whose discretisation is known to a share `unsure` of it.
fn cheapest(pilot: &Pilot, camera: &Camera, aim: f64, unsure: f64) -> Option<Plan> {
    let all = pilot.biases();
    let enough = all.filter(|(_, _, bias)| bias.safe() <= SYSTEMATIC * aim && bias.is_known(aim, unsure));
    let plans = enough.map(|(q, l, bias)| Plan { bias, ..fill(pilot, camera, (q, l, 0), aim - bias.safe()) });
    plans.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Variance that is small beside a systematic error which leaves too little of a squared aim: noise far below an error that stays would
/// be in vain.
fn beside(bias: Square, aim: f64) -> f64 {
    (1.0 - SYSTEMATIC) * aim.max(AIM * AIM * bias.safe())
}

/// Where nothing meets the aim: the plan with the smallest systematic error.
fn least_wrong(pilot: &Pilot, camera: &Camera, aim: f64) -> Plan {
    let best = pilot.biases().min_by(|a, b| a.2.safe().total_cmp(&b.2.safe()));
    let (quality, level, bias) = best.unwrap_or_default();
    Plan { bias, ..fill(pilot, camera, (quality, level, 0), beside(bias, aim)) }
}

/// Rays and samples whose noise takes the given variance at the least cost, on a level or so many levels `finer`.
fn fill(pilot: &Pilot, camera: &Camera, (quality, level, finer): (usize, usize, u32), variance: f64) -> Plan {
    let pixels = f64::from(camera.size[0]) * f64::from(camera.size[1]);
    let of_pass1 = pilot.noise_of_pass1(quality, level);
    let ray = pilot.levels[level].cost_of_ray() * f64::from(4u32.pow(finer));
    let element = ELEMENT * pilot.levels[level].elements as f64 * f64::from(4u32.pow(finer));
    let bias = Square::default();
    let sample = (SAMPLE + RAY * pilot.rays_per_sample(quality)) * pixels;
    let plan = |spp: u32| {
        // Two halves: their mean has half the variance of each.
        let noise = 0.5 * pilot.noise(quality, spp);
        let rest = variance - noise;
        // Where samples alone cannot do, pass 1 need not be better than they are.
        let rays = 0.5 * of_pass1 / if rest > 0.0 { rest } else { noise };
        let rays = rays.clamp(FEWEST_RAYS, MOST_RAYS).ceil();
        let cost = 2.0 * (ray * rays + element + sample * f64::from(spp));
        (rest > 0.0, Plan { quality, level, bias, rays: rays as u32, spp, cost })
    };
    let mut best: Option<Plan> = None;
    let mut spp = 1;
    while spp <= MOST_SAMPLES / 2 {
        let (enough, plan) = plan(spp);
        if enough && best.is_none_or(|b| plan.cost < b.cost) {
            best = Some(plan);
        }
        // Steps of at most an eighth.
        spp += (spp / 8).max(1);
    }
    best.unwrap_or_else(|| plan(MOST_SAMPLES / 2).1)
}

/// Halves added up, each weighted by its samples a pixel.
struct Halves {
    sums: [Vec<f64>; 2],
    weight: f64,
}

impl Halves {
    fn add(&mut self, images: &[Image; 2], spp: u32) {
        for (sum, image) in self.sums.iter_mut().zip(images) {
            sum.resize(image.data.len(), 0.0);
            sum.iter_mut().zip(&image.data).for_each(|(s, v)| *s += f64::from(*v) * f64::from(spp));
        }
        self.weight += f64::from(spp);
    }

    /// The images of both halves.
    fn images(&self, [width, height]: [u32; 2]) -> [Image; 2] {
        [0, 1].map(|k| {
            let mut image = Image::new(width as usize, height as usize);
            let values = image.data.iter_mut().zip(&self.sums[k]);
            values.for_each(|(v, s)| *v = (s / self.weight) as f32);
            image
        })
    }
}

/// Adds pairs of halves until their noise is small enough.
fn finish(
    view: &View,
    (pilot, plan): (&Pilot, Plan),
    mask: &[bool],
    error: f64,
    seed: u32,
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Rendered> {
    let level = &pilot.levels[plan.level];
    let [width, height] = view.camera.size;
    let mut halves = Halves { sums: [Vec::new(), Vec::new()], weight: 0.0 };
    let part = if plan.spp >= MANY_SAMPLES { FIRST } else { 1 };
    let (mut rays, mut spp) = ((plan.rays / part).max(FEWEST_RAYS as u32), plan.spp / part);
    let (mut all_rays, mut all_spp, mut pair) = (0u64, 0u32, 0u32);
    let mut most_rays = MOST_RAYS;
    let mut warnings: Vec<String> = Vec::new();
    let mut dropped = 0.0f64;
    loop {
        let mut half = |half: u32, stages: &mut Vec<Stage>| -> Result<(Image, Pass1Result, Pass1)> {
            let seed = seed_of(&[seed, pair, half, 0xacc0]);
            let settings = Pass1 { rays, element_size: Some(level.element_size), seed };
            let (limit, reached) = (view.limit, &view.reached);
            let mut own = Vec::new();
            let result =
                solve_reached(limit, view.visibility, view.emitters, reached, &settings, observer, &mut own)?;
            let method = Method::TwoPass(Quality::ALL[plan.quality]);
            let picture = Settings { method, spp, seed, ..view.settings };
            let pixels = u64::from(width) * u64::from(height);
            let (image, traced) = stage("trace", pixels, observer, &mut own, || {
                let advance = |n| observer(Event::Advance(n));
                let solution = Some(&result.solution);
                let (image, traced) =
                    render(view.visibility, view.emitters, solution, view.camera, &picture, &advance);
                ((image, traced), traced.rays)
            });
            merge(stages, own);
            dropped = dropped.max(traced.dropped);
            Ok((image, result, settings))
        };
        let both = half(0, stages).and_then(|first| Ok((first, half(1, stages)?)));
        // Rays take memory too: where there is none for so many, more pairs of halves have fewer each.
        if matches!(both, Err(Error::Usage(_))) && f64::from(rays) > FEWEST_RAYS {
            rays = (rays / 2).max(FEWEST_RAYS as u32);
            most_rays = f64::from(rays);
            continue;
        }
        let ((first, other, _), (second, pass1, settings)) = both?;
        for w in other.warnings.iter().chain(&pass1.warnings) {
            // A half may be as noisy as it likes: the noise of the picture is measured.
            if !w.starts_with(UNCERTAIN) && !warnings.contains(w) {
                warnings.push(w.clone());
            }
        }
        let images = [first, second];
        halves.add(&images, spp);
        all_rays += 2 * u64::from(rays);
        all_spp += 2 * spp;
        pair += 1;
        let together = halves.images(view.camera.size);
        let (square, mean) = pilot::difference(&together[0], &together[1], mask);
        let noise = 0.25 * square / (mean * mean);
        // Where nobody knows, the worst is said.
        let known = plan.bias.is_known((AIM * error).powi(2), UNSURE);
        let bias = if known { plan.bias.value.max(0.0) } else { plan.bias.safe() };
        let total = (noise + bias).sqrt();
        let met = noise + plan.bias.safe() <= (MET * error).powi(2);
        // Where the systematic part alone is too large, noise need only be small beside it.
        let aim = (AIM * error).powi(2);
        let variance = (aim - plan.bias.safe()).max(beside(plan.bias, aim));
        if met || noise <= variance || all_spp >= MOST_SAMPLES {
            let achieved = Achieved {
                asked: error,
                met: noise + plan.bias.safe() <= error * error,
                relative_rmse: total,
                noise: noise.sqrt(),
                discretisation: bias.sqrt(),
                discretisation_squared_error: plan.bias.error,
                quality: Quality::ALL[plan.quality].name(),
                element_size: level.element_size,
                elements: level.elements,
                solves: 2 * pair,
                rays: all_rays,
                spp: all_spp,
                pilot_pixels: pilot.pixels.len(),
                pilot_element_sizes: pilot.levels.iter().map(|l| l.element_size).collect(),
                pilot_rays: pilot.cast,
            };
            warnings.extend(missed(&achieved));
            let mut image = Image::new(width as usize, height as usize);
            let both = together[0].data.iter().zip(&together[1].data);
            image.data.iter_mut().zip(both).for_each(|(v, (a, b))| *v = 0.5 * (a + b));
            return Ok(Rendered { image, dropped, achieved, pass1, settings, warnings });
        }
        // Variance of this pair's mean, and what the next one's must be so that together they are good enough.
        let (square, _) = pilot::difference(&images[0], &images[1], mask);
        let own = 0.25 * square / (mean * mean);
        let needed = 1.0 / (1.0 / variance - 1.0 / noise);
        let growth = (own / needed).powf(1.0 / pilot.fall(plan.quality, spp, own)).clamp(0.125, GROWTH);
        let grow = |n: u32, most: f64| (f64::from(n) * growth).ceil().min(most) as u32;
        rays = grow(rays, most_rays).max(FEWEST_RAYS as u32);
        spp = grow(spp, f64::from((MOST_SAMPLES - all_spp).div_ceil(2)));
    }
}

/// What to say where the picture is worse than asked.
fn missed(a: &Achieved) -> Option<String> {
    (!a.met).then(|| {
        let (why, help) = if a.discretisation_squared_error > UNSURE * (AIM * a.asked).powi(2) {
            ("how wrong elements of this size are is not known better", "ask for a larger error")
        } else if a.discretisation > a.noise {
            ("finer elements would take too much memory or time", "allow more with --max-memory")
        } else {
            ("more samples would take too long", "ask for a larger error")
        };
        format!(
            "--error {} is not met: the picture's error is about {:.4} (noise {:.4}, elements {:.4}) after {} samples a \
             pixel on {} elements; {why}: {help}",
            a.asked, a.relative_rmse, a.noise, a.discretisation, a.spp, a.elements
        )
    })
}
