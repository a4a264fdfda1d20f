//! References: converged images in two independent halves, by the program's own unbiased path tracer and kept in a cache; by quality
//! `gather` where paths find too little light.

use super::Context;
use super::view::settings;
use crate::emitters::Emitters;
use crate::image::{self, Image, WriteOptions, mean_image, read_exr};
use crate::pipeline::{self, Pass1};
use crate::render::{Estimator, Method, Quality, Settings, render, sees_no_emitter};
use crate::scene::Camera;
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::path::PathBuf;

/// Seeds of the two halves, apart from those that rounds use.
const SEEDS: [u32; 2] = [0x5eed_000a, 0x5eed_000b];

/// A reference and what it can tell.
pub struct Reference {
    /// Two independent images.
    pub halves: [Image; 2],
    /// Their mean.
    pub mean: Image,
    /// Pixels that count: those that see no emitter directly.
    pub mask: Vec<bool>,
    /// Standard error of `mean`, RMS over its pixels and channels, relative to its mean.
    pub standard_error: f64,
    /// The smallest relative RMSE that [`crate::image::relative_rmse_halves`] tells from none with these halves, at two
    /// standard errors: far below `standard_error`, as errors of many pixels average.
    pub resolution: f64,
    /// Paths or samples a pixel in each half.
    pub spp: u32,
}

/// Settings of the path tracer.
pub fn path_settings(spp: u32, seed: u32) -> Settings {
    Settings {
        method: Method::Path,
        spp,
        gather_rays: 1,
        emitter_samples: 1,
        estimator: Estimator::Lobe(1),
        seed,
    }
}

/// The reference of a view with `spp` paths a pixel in each half, from the cache where it is there.
pub fn reference(
    context: &Context,
    visibility: &Visibility,
    emitters: &Emitters,
    camera: &Camera,
    spp: u32,
) -> Result<Reference> {
    let trace = |settings: &Settings, camera: &Camera| {
        render(visibility, emitters, None, camera, settings, &|_| ()).0
    };
    // What the tracer makes of a thumbnail is part of the key: a tracer that changed finds no old images.
    let probe = trace(&path_settings(16, SEEDS[0]), &Camera { size: [12, 12], ..camera.clone() });
    let mut key =
        format!("{:?} {spp} {:016x} {}", camera, visibility.scene().hash(), context.device.version());
    probe.data.iter().for_each(|v| key.push_str(&format!("{:08x}", v.to_bits())));
    let key = fnv(key.as_bytes());
    std::fs::create_dir_all(&context.settings.cache).map_err(|e| Error::io(&context.settings.cache, e))?;
    let mut halves = Vec::new();
    for (half, seed) in ["A", "B"].iter().zip(SEEDS) {
        let path: PathBuf = context.settings.cache.join(format!("{key:016x}_{half}.exr"));
        let known = read_exr(&path).ok().filter(|i| [i.width as u32, i.height as u32] == camera.size);
        halves.push(match known {
            Some(image) => image,
            None => {
                (context.observer)(&format!("reference {half}: {spp} paths a pixel"));
                let image = trace(&path_settings(spp, seed), camera);
                let metadata = vec![
                    ("twopass:scene".into(), format!("{:016x}", visibility.scene().hash())),
                    ("twopass:spp".into(), spp.to_string()),
                    ("twopass:seed".into(), seed.to_string()),
                ];
                image::write(&image, &path, &WriteOptions { exposure: 0.0, metadata })?;
                image
            }
        });
    }
    let Ok(halves) = <[Image; 2]>::try_from(halves) else {
        return Err(Error::scene("reference", "has not two halves"));
    };
    Ok(of_halves(halves, sees_no_emitter(visibility, emitters, camera), spp))
}

/// The reference of a view of the program's own scene `name`, and what it is made by, in words.
pub fn reference_of(
    name: &str,
    context: &Context,
    visibility: &Visibility,
    emitters: &Emitters,
    camera: &Camera,
) -> Result<(Reference, String)> {
    // Behind two doorways paths find too little light to tell anything.
    if name == "corridor" {
        let found = gathered(visibility, emitters, camera)?;
        let by = format!("by quality \"gather\", 2 x {} samples a pixel", found.spp);
        return Ok((found, by));
    }
    let spp = context.choose(384, 2048);
    let found = reference(context, visibility, emitters, camera, spp)?;
    Ok((found, format!("by path tracing, 2 x {spp} paths a pixel")))
}

/// Quality `gather` of two independent solutions. What is wrong with their elements is in both, and not told by them.
fn gathered(visibility: &Visibility, emitters: &Emitters, camera: &Camera) -> Result<Reference> {
    let spp = 1024;
    let half = |seed: u32| -> Result<Image> {
        let (cameras, stages) = (std::slice::from_ref(camera), &mut Vec::new());
        let pass1 = Pass1 { rays: 8192, element_size: Some(0.1), seed };
        let solution = pipeline::solve(visibility, emitters, cameras, &pass1, &|_| (), stages)?.solution;
        let settings = settings(Method::TwoPass(Quality::Gather), spp, seed);
        Ok(render(visibility, emitters, Some(&solution), camera, &settings, &|_| ()).0)
    };
    let halves = [half(SEEDS[0])?, half(SEEDS[1])?];
    Ok(of_halves(halves, sees_no_emitter(visibility, emitters, camera), spp))
}

fn of_halves(halves: [Image; 2], mask: Vec<bool>, spp: u32) -> Reference {
    let (standard_error, resolution) = noise(&halves, &mask);
    let mean = mean_image(&halves[0], Some(&halves[1]));
    Reference { mean, halves, mask, standard_error, resolution, spp }
}

fn fnv(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3))
}

/// Relative standard error of the mean of two halves, and the smallest error that they can tell.
///
/// With `d = a - b`, `d^2 / 4` estimates the variance of their mean in a pixel. The estimate of an exact image's
/// squared error is the mean of products of two such independent noises, whose variance is the square of a half's,
/// `E[d^4] / 12` for Gaussian noise.
fn noise(halves: &[Image; 2], mask: &[bool]) -> (f64, f64) {
    let (mut square, mut fourth, mut sum, mut n) = (0.0, 0.0, 0.0, 0.0);
    for i in (0..mask.len()).filter(|i| mask[*i]) {
        let mut pixel = 0.0;
        for c in 0..3 {
            let (a, b) = (f64::from(halves[0].data[3 * i + c]), f64::from(halves[1].data[3 * i + c]));
            pixel += (a - b).powi(2) / 3.0;
            sum += 0.5 * (a + b) / 3.0;
        }
        square += pixel;
        // Taking the channels of a pixel as wholly dependent: the larger estimate.
        fourth += pixel * pixel;
        n += 1.0;
    }
    let mean = sum / n;
    let variance_of_mse = fourth / 12.0 / (n * n);
    ((square / n / 4.0).sqrt() / mean, (2.0 * variance_of_mse.sqrt()).sqrt() / mean)
}

/// Which pixels show nothing but glossy or mirroring surfaces at first sight.
pub fn sees_specular(visibility: &Visibility, camera: &Camera) -> Vec<bool> {
    let frame = camera.frame(visibility.scene());
    let scene = visibility.scene();
    let [width, height] = camera.size;
    (0..width * height)
        .map(|k| {
            let (x, y) = (f64::from(k % width), f64::from(k / width));
            [(0.1, 0.1), (0.9, 0.1), (0.5, 0.5), (0.1, 0.9), (0.9, 0.9)].iter().all(|(u, v)| {
                let (origin, direction) = frame.ray(x + u, y + v);
                let hit = visibility.closest(origin, direction.as_vec3(), u32::MAX);
                hit.is_some_and(|hit| scene.material(&scene.faces[hit.face as usize]).is_specular())
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uniform noise of known size: its standard error, and a resolution far below it.
    #[test]
    fn noise_of_two_halves() {
        let mut state = 1u64;
        let mut noisy = || {
            let mut image = Image::new(100, 100);
            for pixel in image.data.chunks_exact_mut(3) {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                pixel.fill(2.0 + 0.4 * ((state >> 40) as f32 / (1 << 23) as f32 - 1.0));
            }
            image
        };
        let halves = [noisy(), noisy()];
        let (error, resolution) = noise(&halves, &[true; 10_000]);
        // A half's standard deviation is 0.4 / sqrt(3) of 2; the mean's smaller by sqrt(2).
        let expected = 0.4 / 3f64.sqrt() / 2f64.sqrt() / 2.0;
        assert!((error / expected - 1.0).abs() < 0.03, "{error} {expected}");
        // sqrt(2 v / sqrt(n)) with the variance v of a half; the uniform distribution's d^4 is 12/5 v^2 * 12 / 12.
        assert!(resolution < 0.3 * error && resolution > 0.1 * error, "{resolution} {error}");
    }
}
