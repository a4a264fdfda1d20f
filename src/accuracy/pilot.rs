//! What a few pixels tell before the picture is rendered: how wrong each quality is on elements of each size, and how
//! noisy.
//!
//! The same pixels are rendered at every quality on a ladder of element sizes, from two independent solutions of pass 1. A
//! quality's systematic error on a level is the mean over the pixels of products of two independent differences from a
//! reference, so noise cancels out (as in [`crate::image::relative_rmse_halves`]). The reference is what gathering tends
//! to as elements become finer: its values on the two finest levels, extrapolated. Every difference is taken
//! between pictures with the same view rays, which cancels most of the noise beforehand.

use super::{ELEMENT, FALL, MOST_ELEMENTS, MOST_RAYS, MOST_SAMPLES, RAY, SAMPLE, SINGLE, View};
use crate::color::Rgb;
use crate::image::Image;
use crate::mesh::{Mesh, default_element_size};
use crate::pipeline::{Pass1, Stage, solve_reached};
use crate::radiosity::Solution;
use crate::render::{Method, Quality, Settings, Traced, render_pixels, sees_no_emitter};
use crate::sampling::seed_of;
use crate::{Error, Result};

/// Pixels looked at, about.
const PIXELS: usize = 4096;
/// From this error on, half of them and fewer samples will do.
const COARSE: f64 = 0.025;
/// Below this error, more rays and samples are needed.
const FINE: f64 = 0.006;
/// Element size of the first level over [`default_element_size`]: some hundred elements in a simple room.
const COARSEST: f64 = 4.0;
/// Differences between two levels of gathered pictures over those between the next coarser two, 2^-p where errors fall as the
/// element size to the power p: the least and the most that are believed, and what is taken where noise hides it. Measured: 0.4 to
/// 0.5 in one room, up to 0.75 with coarse elements among many objects.
const SHRINK: (f64, f64, f64) = (0.44, 0.67, 0.5);
/// Elements of the level that has [`Pilot::fewest_rays`].
const MANY: f64 = 1024.0;
/// Share of the pixels at which noise is measured where that is dear.
const SHARE: usize = 4;
/// Samples a pixel at which noise is measured; the last at fewer pixels.
const LADDER: [u32; 3] = [1, 4, 16];

/// Means of the products of two lists of differences, by pixel, with the standard error.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Square {
    /// The estimate, with its sign.
    pub value: f64,
    /// Its standard error, taking pixels as independent.
    pub error: f64,
}

impl Square {
    /// What may be counted on: the estimate, where it is not below zero, and one standard error.
    pub fn safe(&self) -> f64 {
        self.value.max(0.0) + self.error
    }

    /// Its standard error is at most a share `unsure` of a squared aim.
    pub fn is_known(&self, aim: f64, unsure: f64) -> bool {
        self.error <= unsure * aim
    }
}

/// What hides a systematic error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Noise {
    /// Rays of elements.
    Pass1,
    /// Samples of pixels.
    Pass2,
}

impl Noise {
    /// Factors of rays an element and of samples a pixel with which there is less of it.
    fn growth(self) -> (u32, u32) {
        match self {
            Noise::Pass1 => (4, 1),
            Noise::Pass2 => (1, 4),
        }
    }
}

/// Values of the pilot's pixels at one quality.
struct Sampled {
    /// From two independent runs of both passes.
    runs: [Vec<Rgb>; 2],
    /// Pass 1 of the second run, pass 2 of the first, at the pixels of [`Pilot::few`].
    crossed: Vec<Rgb>,
    /// Rays cast for a sample of a pixel.
    rays: f64,
}

/// One element size.
pub(super) struct Level {
    /// Largest element edge \[m\].
    pub element_size: f64,
    /// Elements.
    pub elements: usize,
    /// Rays of pass 1 for each ray an element.
    rays: f64,
    /// Rays an element.
    rays_each: u32,
    /// Two independent ones.
    solutions: [Solution; 2],
    /// By quality.
    sampled: [Sampled; 3],
}

impl Level {
    /// What a ray an element costs, with all that it brings about \[rays\].
    pub fn cost_of_ray(&self) -> f64 {
        let own = self.elements as f64;
        own + SINGLE * (self.rays - own).max(0.0)
    }
}

/// All that is known before the picture is rendered; squared errors are relative to the squared mean of the pixels.
pub(super) struct Pilot<'a, 's> {
    view: &'a View<'a, 's>,
    seed: u32,
    /// Rays an element where there are many elements.
    fewest_rays: u32,
    spp: u32,
    pub pixels: Vec<[u32; 2]>,
    /// One in [`SHARE`] of them.
    few: Vec<[u32; 2]>,
    pub levels: Vec<Level>,
    /// Variance of a pixel at each of [`LADDER`]'s samples, by quality.
    noise: [[f64; LADDER.len()]; 3],
    /// Rays cast.
    pub cast: u64,
}

impl<'a, 's> Pilot<'a, 's> {
    /// Looks at pixels of the mask; `error` is what will be asked of the picture.
    pub fn new(view: &'a View<'a, 's>, mask: &[bool], error: f64, seed: u32) -> Pilot<'a, 's> {
        // So many that the systematic error is known to well below the one asked for.
        let (pixels, rays, spp) = match error {
            e if e < FINE => (PIXELS, 1024, 16),
            e if e < COARSE => (PIXELS, 256, 8),
            _ => (PIXELS / 2, 128, 4),
        };
        let pixels = choose_pixels(view.camera.size, mask, pixels, seed);
        let few = pixels.iter().step_by(SHARE).copied().collect();
        let noise = Default::default();
        let levels = Vec::new();
        Pilot { view, seed, fewest_rays: rays, spp, pixels, few, levels, noise, cast: 0 }
    }

    /// Rays of each of so many elements. Few elements have much noise in common between the pixels of each.
    fn rays_of(&self, elements: f64) -> u32 {
        let more = (MANY / elements.max(1.0)).sqrt().clamp(0.5, 4.0);
        (f64::from(self.fewest_rays) * more) as u32 / 16 * 16
    }

    /// What another level costs: two solves of four times as many elements \[rays\].
    pub fn cost_to_refine(&self) -> f64 {
        self.levels.last().map_or(0.0, |l| {
            let elements = 4.0 * l.elements as f64;
            2.0 * (4.0 * l.cost_of_ray() * f64::from(self.rays_of(elements)) + elements * ELEMENT)
        })
    }

    /// What to have four times as many of, so that a systematic error is better known, and what that costs \[rays\];
    /// infinite where there are as many as there may be.
    pub fn sharper(&self, quality: usize, level: usize) -> (Noise, f64) {
        let fine = self.levels.len() - 1;
        let of_pass1: f64 = [(quality, level), (2, fine)]
            .map(|(q, l)| self.noise_of_pass1(q, l) / f64::from(self.levels[l].rays_each))
            .iter()
            .sum();
        // Gathered pictures differ by their elements alone: their samples are the same.
        let of_pass2 = if quality == 2 { 0.0 } else { self.noise(2, self.spp) };
        let noise = if of_pass1 > of_pass2 { Noise::Pass1 } else { Noise::Pass2 };
        let (more_rays, more_samples) = noise.growth();
        if f64::from(4 * self.fewest_rays * more_rays) > MOST_RAYS || self.spp * more_samples > MOST_SAMPLES {
            return (noise, f64::INFINITY);
        }
        let samples = 2.25 * self.pixels.len() as f64 * f64::from(self.spp * more_samples);
        let pass2: f64 = (0..3).map(|q| samples * (SAMPLE + RAY * self.rays_per_sample(q))).sum();
        let pass1 = |l: &Level| match noise {
            Noise::Pass1 => {
                2.0 * (l.cost_of_ray() * f64::from(l.rays_each * more_rays) + l.elements as f64 * ELEMENT)
            }
            Noise::Pass2 => 0.0,
        };
        let cost = self.levels.iter().map(|l| pass1(l) + pass2).sum();
        (noise, cost)
    }

    /// Looks at all levels anew with less of a noise; `false` where memory forbids it.
    pub fn sharpen(&mut self, noise: Noise) -> Result<bool> {
        let (more_rays, more_samples) = noise.growth();
        self.fewest_rays *= more_rays;
        self.spp *= more_samples;
        let levels = std::mem::take(&mut self.levels);
        for level in levels {
            match noise {
                Noise::Pass1 if !self.refine()? => return Ok(false),
                Noise::Pass1 => (),
                Noise::Pass2 => {
                    let sampled = self.sample(&level.solutions);
                    self.levels.push(Level { sampled, ..level });
                }
            }
        }
        Ok(true)
    }

    /// Adds the next finer level; `false` where memory forbids it. The first two are needed.
    pub fn refine(&mut self) -> Result<bool> {
        let scene = self.view.visibility.scene();
        let element_size =
            COARSEST * default_element_size(scene, false) * 0.5f64.powi(self.levels.len() as i32);
        let rays_each = self.rays_of(Mesh::uniform_len(scene, &self.view.reached, element_size) as f64);
        let mut stages: Vec<Stage> = Vec::new();
        let mut solve = |run| {
            let settings =
                Pass1 { rays: rays_each, element_size: Some(element_size), seed: self.seed_of(run) };
            let &View { visibility, emitters, ref reached, limit, .. } = self.view;
            solve_reached(limit, visibility, emitters, reached, &settings, &|_| (), &mut stages)
        };
        let solutions = match (solve(0), solve(1)) {
            (Ok(first), Ok(second)) => [first.solution, second.solution],
            (Err(Error::Usage(_)), _) | (_, Err(Error::Usage(_))) if self.levels.len() > 1 => {
                return Ok(false);
            }
            (Err(e), _) | (_, Err(e)) => return Err(e),
        };
        let rays = stages.iter().map(|s| s.rays).sum::<u64>();
        if self.cast == 0 {
            self.measure_noise(&solutions[0]);
        }
        self.cast += rays;
        let sampled = self.sample(&solutions);
        let rays = rays as f64 / f64::from(2 * rays_each);
        let elements = solutions[0].mesh.len();
        self.levels.push(Level { element_size, elements, rays, rays_each, solutions, sampled });
        Ok(true)
    }

    /// Renders the pixels at every quality.
    fn sample(&mut self, solutions: &[Solution; 2]) -> [Sampled; 3] {
        Quality::ALL.map(|quality| {
            let one = |solution, run, pixels| self.render(quality, (solution, pixels), self.spp, run);
            let (first, cast) = one(&solutions[0], 0, &self.pixels);
            let (second, more) = one(&solutions[1], 1, &self.pixels);
            let (crossed, rest) = one(&solutions[1], 0, &self.few);
            self.cast += cast.rays + more.rays + rest.rays;
            let samples = (self.pixels.len() * self.spp as usize).max(1);
            // Looks are those of the whole picture.
            let rays = (cast.rays - cast.looks) as f64 / samples as f64;
            Sampled { runs: [first, second], crossed, rays }
        })
    }

    fn seed_of(&self, run: u32) -> u32 {
        seed_of(&[self.seed, run, 0x9170])
    }

    fn render(
        &self,
        quality: Quality,
        (solution, pixels): (&Solution, &[[u32; 2]]),
        spp: u32,
        run: u32,
    ) -> (Vec<Rgb>, Traced) {
        let View { visibility, emitters, camera, settings, .. } = *self.view;
        let settings =
            Settings { method: Method::TwoPass(quality), spp, seed: self.seed_of(run), ..settings };
        render_pixels(visibility, emitters, Some(solution), (camera, pixels), &settings)
    }

    fn measure_noise(&mut self, solution: &Solution) {
        for (q, quality) in Quality::ALL.into_iter().enumerate() {
            for (k, spp) in LADDER.into_iter().enumerate() {
                let pixels = if k + 1 < LADDER.len() { &self.pixels } else { &self.few };
                let (a, cast) = self.render(quality, (solution, pixels), spp, 2);
                let (b, more) = self.render(quality, (solution, pixels), spp, 3);
                self.cast += cast.rays + more.rays;
                let mean = mean(&a).max(f64::MIN_POSITIVE);
                self.noise[q][k] = 0.5 * product(&minus(&a, &b), &minus(&a, &b)).value / (mean * mean);
            }
        }
    }

    /// Mean of the pixels on the finest level [W m^-2 sr^-1].
    pub fn mean(&self) -> f64 {
        self.levels.last().map_or(0.0, |l| mean(&l.sampled[2].runs[0]))
    }

    /// Variance of a pixel by pass 2 with so many samples, relative: by the power law between measured points, and beyond them.
    pub fn noise(&self, quality: usize, spp: u32) -> f64 {
        let v = &self.noise[quality];
        let k = LADDER[1..].iter().position(|n| spp <= *n).unwrap_or(LADDER.len() - 2);
        let (n, m) = (f64::from(LADDER[k]), f64::from(LADDER[k + 1]));
        if v[k + 1] <= 0.0 || v[k] <= 0.0 {
            return v[k + 1].max(v[k]);
        }
        let power = (v[k] / v[k + 1]).ln() / (m / n).ln();
        v[k + 1] * (m / f64::from(spp)).powf(power.clamp(1.0, 2.0))
    }

    /// The power of its work with which the variance of a pair of halves falls, of `spp` samples a pixel each and a `variance` of their
    /// mean: that of pass 2 falls as it did in the pilot, the rest as of independent rays.
    pub fn fall(&self, quality: usize, spp: u32, variance: f64) -> f64 {
        let [now, then] = [spp, 2 * spp].map(|spp| 0.5 * self.noise(quality, spp));
        let share = (now / variance).min(1.0);
        if share.is_nan() || then <= 0.0 { 1.0 } else { 1.0 + share * ((now / then).log2() - 1.0).max(0.0) }
    }

    /// Variance of a pixel by pass 1 with one ray an element, relative.
    pub fn noise_of_pass1(&self, quality: usize, level: usize) -> f64 {
        let Level { sampled, rays_each, .. } = &self.levels[level];
        let s = &sampled[quality];
        let first: Vec<Rgb> = s.runs[0].iter().step_by(SHARE).copied().collect();
        let d = minus(&first, &s.crossed);
        0.5 * f64::from(*rays_each) * product(&d, &d).value / self.mean().powi(2)
    }

    /// Rays of pass 2 for a sample of a pixel.
    pub fn rays_per_sample(&self, quality: usize) -> f64 {
        self.levels[0].sampled[quality].rays
    }

    /// The least relative RMSE that can be hoped for: by the noise of as many rays and samples as there may be, on elements as fine as
    /// there may be, if errors go on to fall as fast as is believed of any.
    pub fn least(&self) -> f64 {
        let Some(level) = self.levels.len().checked_sub(1) else { return 0.0 };
        let finer = (MOST_ELEMENTS / self.levels[level].elements.max(1)).max(1).ilog(4);
        let of = |quality| {
            let noise =
                self.noise(quality, MOST_SAMPLES / 2) + self.noise_of_pass1(quality, level) / MOST_RAYS;
            0.5 * noise + self.bias(quality, level).value.max(0.0) * FALL.0.powi(finer as i32)
        };
        (0..Quality::ALL.len()).map(of).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Squared systematic errors of every quality on every level.
    pub fn biases(&self) -> impl Iterator<Item = (usize, usize, Square)> {
        let all = (0..Quality::ALL.len()).flat_map(|q| (0..self.levels.len()).map(move |l| (q, l)));
        all.map(|(q, l)| (q, l, self.bias(q, l)))
    }

    /// By what times the difference of the two finest levels the gathered pictures of the finest are off: the geometric series of
    /// what is yet to come.
    fn beyond(&self) -> f64 {
        let gathered = |level: usize, run: usize| &self.levels[level].sampled[2].runs[run];
        let step = |fine: usize| {
            let [a, b] = [0, 1].map(|run| minus(gathered(fine, run), gathered(fine - 1, run)));
            a.iter().zip(&b).map(|(a, b)| a.dot(*b)).collect::<Vec<_>>()
        };
        let last = self.levels.len() - 1;
        let (least, most, otherwise) = SHRINK;
        let fall = if last >= 2 { ratio(&step(last), &step(last - 1)) } else { None };
        let shrink = match fall {
            Some(fall) if fall.value > 2.0 * fall.error => fall.safe().sqrt().clamp(least, most),
            _ => otherwise,
        };
        shrink / (1.0 - shrink)
    }

    /// Squared systematic error of a quality on a level, relative; needs two levels.
    pub fn bias(&self, quality: usize, level: usize) -> Square {
        let [.., coarse, fine] = &self.levels[..] else { return Square { value: f64::INFINITY, error: 0.0 } };
        let beyond = self.beyond();
        let differences: Vec<Vec<Rgb>> = (0..2)
            .map(|run| {
                let (fine, coarse) = (&fine.sampled[2].runs[run], &coarse.sampled[2].runs[run]);
                let x = &self.levels[level].sampled[quality].runs[run];
                let limit = fine.iter().zip(coarse).map(|(f, c)| *f + beyond * (*f - *c));
                x.iter().zip(limit).map(|(x, limit)| *x - limit).collect()
            })
            .collect();
        let square = product(&differences[0], &differences[1]);
        let mean = self.mean();
        let value = square.value / (mean * mean);
        // What is below zero tells of noise that pixels have in common, by elements that many of them see.
        Square { value, error: (square.error / (mean * mean)).max(-value) }
    }
}

/// The sum of one list over that of another, pixel by pixel, with the standard error: what few pixels lead both of is no doubt. None
/// where the other one's sum is not above zero.
fn ratio(a: &[f64], b: &[f64]) -> Option<Square> {
    let [sum, of] = [a, b].map(|x| x.iter().sum::<f64>());
    let value = sum / of;
    let spread = a.iter().zip(b).map(|(a, b)| (a - value * b).powi(2)).sum::<f64>();
    (of > 0.0).then(|| Square { value, error: spread.sqrt() / of })
}

fn minus(a: &[Rgb], b: &[Rgb]) -> Vec<Rgb> {
    a.iter().zip(b).map(|(a, b)| *a - *b).collect()
}

fn mean(a: &[Rgb]) -> f64 {
    a.iter().map(|v| crate::color::mean(*v)).sum::<f64>() / a.len().max(1) as f64
}

/// Mean over the pixels of the products of two differences, over the three channels. One pixel has no spread: the error is at least what
/// one of them with the larger of its two differences squared would make of the mean.
fn product(a: &[Rgb], b: &[Rgb]) -> Square {
    let n = a.len().max(1) as f64;
    let (mut sum, mut squares, mut larger) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let p = a.dot(*b) / 3.0;
        sum += p;
        squares += p * p;
        larger += a.length_squared().max(b.length_squared()) / 3.0;
    }
    let value = sum / n;
    let spread = ((squares / n - value * value).max(0.0) / n).sqrt();
    Square { value, error: spread.max(larger / (n * n)) }
}

/// One pixel of each block of the image, of those that count.
fn choose_pixels([width, height]: [u32; 2], mask: &[bool], most: usize, seed: u32) -> Vec<[u32; 2]> {
    let count = mask.iter().filter(|m| **m).count();
    let step = ((count as f64 / most as f64).sqrt().ceil() as u32).max(1);
    let mut pixels = Vec::new();
    for y in (0..height).step_by(step as usize) {
        for x in (0..width).step_by(step as usize) {
            let k = seed_of(&[seed, x, y, 0x9171]);
            let at = [x + k % step, y + (k >> 8) % step];
            let inside = at[0] < width && at[1] < height;
            if inside && mask[(at[1] * width + at[0]) as usize] {
                pixels.push(at);
            }
        }
    }
    pixels
}

/// The pixels over which the error is meant: all that see no emitter directly.
pub(super) fn mask(view: &View) -> Vec<bool> {
    sees_no_emitter(view.visibility, view.emitters, view.camera)
}

/// Squared difference of two images over the pixels of a mask, and the mean of both.
pub(super) fn difference(a: &Image, b: &Image, mask: &[bool]) -> (f64, f64) {
    let (mut square, mut sum, mut n) = (0.0, 0.0, 0.0);
    for i in (0..mask.len()).filter(|i| mask[*i]) {
        for c in 3 * i..3 * i + 3 {
            let (a, b) = (f64::from(a.data[c]), f64::from(b.data[c]));
            square += (a - b) * (a - b);
            sum += 0.5 * (a + b);
            n += 1.0;
        }
    }
    (square / f64::max(n, 1.0), sum / f64::max(n, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As many pixels as one tell no spread: what they differ by is no better known than it is large, and with a thousand of them
    /// their spread alone counts.
    #[test]
    fn one_pixel_is_not_known_exactly() {
        let (a, b) = (Rgb::splat(0.02), Rgb::splat(-0.001));
        let one = product(&[a], &[b]);
        assert!((one.value + 2e-5).abs() < 1e-15 && (one.error - 4e-4).abs() < 1e-15, "{one:?}");
        assert!(!one.is_known(1e-4, 0.25));
        let many: Vec<Rgb> = (0..1000).map(|k| if k % 2 == 0 { a } else { -a }).collect();
        let found = product(&many, &vec![a; 1000]);
        let spread = 4e-4 / 1000f64.sqrt();
        assert!(found.value.abs() < 1e-15 && (found.error / spread - 1.0).abs() < 1e-9, "{found:?}");
    }

    /// One pixel leads both lists: their means are hardly known, their ratio is. What varies by itself counts.
    #[test]
    fn ratios_are_known_better_than_means() {
        let before: Vec<f64> = (0..100).map(|k| if k == 7 { 1000.0 } else { 1.0 }).collect();
        let same: Vec<f64> = before.iter().map(|b| 0.1 * b).collect();
        let found = ratio(&same, &before).expect("a sum above zero");
        assert!((found.value - 0.1).abs() < 1e-12 && found.error < 1e-12, "{found:?}");
        // 0.5 more or less by turns: the sum stays, and its standard error is 0.5 sqrt(100) = 5.
        let noisy: Vec<f64> = same.iter().enumerate().map(|(k, a)| a + 0.5 - (k % 2) as f64).collect();
        let found = ratio(&noisy, &before).expect("a sum above zero");
        assert!((found.value - 0.1).abs() < 1e-12 && (found.error - 5.0 / 1099.0).abs() < 1e-6, "{found:?}");
        assert_eq!(ratio(&same, &[0.0; 100]), None);
    }
}
