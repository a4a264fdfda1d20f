//! Everything that `compare` tells about an image and its reference.

use super::compare::{Comparison, compare_channels};
use super::{Image, oiio};
use crate::error::{Error, Result};
use serde::Serialize;

/// Pixels of one image that are no numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotFinite {
    /// `image`, `reference` or `second reference`.
    pub image: &'static str,
    /// How many of the pixels that count have a channel that is infinite or NaN.
    pub pixels: usize,
    /// Column and row of the first, from the top left.
    pub first: [usize; 2],
}

/// The largest error of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Largest {
    /// Image minus reference, over the mean of the reference (all channels).
    pub error: f64,
    /// Column and row, from the top left.
    pub pixel: [usize; 2],
    /// 0 red, 1 green, 2 blue.
    pub channel: usize,
}

/// Errors of one channel, or of all together; relative to the mean of the reference over the same channels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Errors {
    /// Mean of the reference.
    pub reference_mean: f64,
    /// Root of the mean squared error (DESIGN section 2: free of the reference's noise where there are two halves).
    pub relative_rmse: f64,
    /// Standard error of `relative_rmse`, upwards.
    pub standard_error: f64,
    /// The estimate of the mean squared error, with its sign.
    pub relative_mse: f64,
    /// Mean of the image over that of the reference, minus 1.
    pub bias: f64,
    /// Mean of the magnitude of the error; holds the reference's noise.
    pub mean_absolute_error: f64,
}

/// An image against a reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Pixels that count.
    pub pixels: usize,
    /// Pixels that the mask leaves out.
    pub masked: usize,
    /// Pixels that are no numbers, by image; they are left out of everything else.
    pub not_finite: Vec<NotFinite>,
    /// Over all channels.
    #[serde(flatten)]
    pub all: Errors,
    /// Red, green, blue; none where the reference's channel has no mean to be relative to.
    pub channels: [Option<Errors>; 3],
    /// The largest error.
    pub maximum: Largest,
    /// Mean LDR-FLIP (Andersson et al. 2020, 67 pixels a degree) of the images as shown: 0 equal, 1 as unlike as can be.
    pub flip: f64,
}

/// What else decides a comparison.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options<'a> {
    /// Which pixels count, row by row; all without it.
    pub mask: Option<&'a [bool]>,
    /// Exposure of the perceptual metric \[EV\].
    pub exposure: f64,
}

impl Difference {
    /// Compares `x` with a reference, given once or as two independent halves.
    pub fn new(x: &Image, a: &Image, b: Option<&Image>, options: &Options) -> Result<Difference> {
        let named = [("image", Some(x)), ("reference", Some(a)), ("second reference", b)];
        let images = || named.iter().filter_map(|(name, image)| image.map(|image| (*name, image)));
        for (name, image) in images() {
            if (image.width, image.height) != (x.width, x.height) {
                return Err(Error::Usage(format!(
                    "the {name} has {} x {} pixels, but the image has {} x {}: only images of one size can be compared",
                    image.width, image.height, x.width, x.height
                )));
            }
        }
        if options.mask.is_some_and(|mask| mask.len() != x.pixel_count()) {
            return Err(Error::Usage("the mask is not of the image's size".into()));
        }
        let mut counts = options.mask.map_or_else(|| vec![true; x.pixel_count()], <[bool]>::to_vec);
        let masked = counts.iter().filter(|c| !**c).count();
        let asked = counts.clone();
        let mut not_finite = Vec::new();
        for (name, image) in images() {
            let bad: Vec<usize> = image
                .data
                .chunks_exact(3)
                .enumerate()
                .filter(|(i, p)| asked[*i] && !p.iter().all(|v| v.is_finite()))
                .map(|(i, _)| i)
                .collect();
            if let Some(&first) = bad.first() {
                let first = [first % x.width, first / x.width];
                not_finite.push(NotFinite { image: name, pixels: bad.len(), first });
            }
            bad.iter().for_each(|&i| counts[i] = false);
        }
        if asked.contains(&true) && !counts.contains(&true) {
            let names: Vec<_> = not_finite.iter().map(|n: &NotFinite| n.image).collect();
            let message =
                format!("no pixel is finite in the {}: nothing is left to compare", names.join(" and the "));
            return Err(Error::Usage(message));
        }
        let errors = |channels: &[usize]| -> Result<Errors> {
            let c = compare_channels([x, x], [a, b.unwrap_or(a)], Some(&counts), channels)?;
            Ok(Errors::new(&c, mean_absolute(x, a, b, &counts, channels)))
        };
        let all = errors(&[0, 1, 2])?;
        Ok(Difference {
            pixels: counts.iter().filter(|c| **c).count(),
            masked,
            not_finite,
            all,
            channels: [0, 1, 2].map(|c| errors(&[c]).ok()),
            maximum: largest(x, a, b, &counts, all.reference_mean),
            flip: flip(x, a, b, &counts, options.exposure)?,
        })
    }
}

impl Errors {
    fn new(c: &Comparison, mean_absolute: f64) -> Errors {
        Errors {
            reference_mean: c.reference_mean,
            relative_rmse: c.relative_rmse,
            standard_error: c.standard_error,
            relative_mse: c.relative_mse,
            bias: c.mean_bias,
            mean_absolute_error: mean_absolute / c.reference_mean,
        }
    }
}

/// Error of one sample against the mean of the references.
fn error(x: &Image, a: &Image, b: Option<&Image>, k: usize) -> f64 {
    let a_k = f64::from(a.data[k]);
    f64::from(x.data[k]) - b.map_or(a_k, |b| 0.5 * (a_k + f64::from(b.data[k])))
}

fn mean_absolute(x: &Image, a: &Image, b: Option<&Image>, counts: &[bool], channels: &[usize]) -> f64 {
    let mut sum = 0.0;
    let mut n = 0usize;
    for i in (0..counts.len()).filter(|i| counts[*i]) {
        for c in channels {
            sum += error(x, a, b, 3 * i + c).abs();
            n += 1;
        }
    }
    sum / n as f64
}

fn largest(x: &Image, a: &Image, b: Option<&Image>, counts: &[bool], mean: f64) -> Largest {
    let mut found = Largest { error: 0.0, pixel: [0, 0], channel: 0 };
    for i in (0..counts.len()).filter(|i| counts[*i]) {
        for channel in 0..3 {
            let e = error(x, a, b, 3 * i + channel) / mean;
            if e.abs() > found.error.abs() {
                found = Largest { error: e, pixel: [i % x.width, i / x.width], channel };
            }
        }
    }
    found
}

/// Mean of two images; `a` itself without a second.
pub fn mean_image(a: &Image, b: Option<&Image>) -> Image {
    let mut mean = a.clone();
    if let Some(b) = b {
        for (m, b) in mean.data.iter_mut().zip(&b.data) {
            *m = 0.5 * (*m + *b);
        }
    }
    mean
}

/// Mean FLIP over the pixels that count. Pixels that do not are made equal in both images, so that they add nothing to
/// their neighbours either.
fn flip(x: &Image, a: &Image, b: Option<&Image>, counts: &[bool], exposure: f64) -> Result<f64> {
    let size =
        |n: usize| u32::try_from(n).map_err(|_| Error::Usage(format!("an edge of {n} pixels is too long")));
    let (width, height) = (size(x.width)?, size(x.height)?);
    let (mut test, mut reference) = (x.clone(), mean_image(a, b));
    for (i, _) in counts.iter().enumerate().filter(|(_, counts)| !**counts) {
        for image in [&mut test, &mut reference] {
            image.data[3 * i..3 * i + 3].fill(0.0);
        }
    }
    let shown =
        |image: &Image| nv_flip::FlipImageRgb8::with_data(width, height, &oiio::srgb_bytes(image, exposure));
    let map = nv_flip::flip(shown(&reference), shown(&test), nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
    let (sum, n) = map
        .iter()
        .zip(counts)
        .filter(|(_, counts)| **counts)
        .fold((0.0, 0usize), |(sum, n), (v, _)| (sum + f64::from(*v), n + 1));
    Ok(sum / n as f64)
}

/// The magnitude of error that a share of the counting pixels stays within, by the mean of their channels.
pub fn error_within(x: &Image, reference: &Image, mask: Option<&[bool]>, share: f64) -> f64 {
    let mut errors: Vec<f64> = (0..x.pixel_count())
        .filter(|i| mask.is_none_or(|m| m[*i]))
        .map(|i| (0..3).map(|c| error(x, reference, None, 3 * i + c)).sum::<f64>().abs() / 3.0)
        .filter(|e| e.is_finite())
        .collect();
    errors.sort_by(f64::total_cmp);
    let at = ((errors.len() as f64 * share) as usize).min(errors.len().saturating_sub(1));
    errors.get(at).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uniform(rgb: [f32; 3]) -> Image {
        let mut image = Image::new(40, 30);
        image.data.chunks_exact_mut(3).for_each(|p| p.copy_from_slice(&rgb));
        image
    }

    #[test]
    fn known_errors() {
        let (mut x, a) = (uniform([0.55, 0.4, 0.2]), uniform([0.5, 0.4, 0.2]));
        x.set(7, 3, [0.5, 0.4, 1.2]);
        let d = Difference::new(&x, &a, None, &Options::default()).unwrap();
        let n = 1200.0;
        let mean = 1.1 / 3.0;
        let mse = ((n - 1.0) * 0.05f64.powi(2) + 1.0) / (3.0 * n);
        assert!((d.all.relative_rmse - mse.sqrt() / mean).abs() < 1e-6, "{d:?}");
        let sum = (n - 1.0) * 0.05 + 1.0;
        assert!((d.all.mean_absolute_error - sum / (3.0 * n) / mean).abs() < 1e-6);
        assert!((d.all.bias - sum / (3.0 * n) / mean).abs() < 1e-6);
        let red = d.channels[0].unwrap();
        assert!((red.bias - 0.1 * (n - 1.0) / n).abs() < 1e-6);
        assert_eq!(d.channels[1].unwrap().relative_rmse, 0.0);
        assert_eq!((d.maximum.pixel, d.maximum.channel), ([7, 3], 2));
        assert!((d.maximum.error - 1.0 / mean).abs() < 1e-5);
        assert!(d.flip > 0.0 && d.flip < 1.0);
    }

    #[test]
    fn equal_images_do_not_differ() {
        let a = uniform([0.5, 0.25, 0.0]);
        let d = Difference::new(&a, &a, Some(&a), &Options::default()).unwrap();
        assert_eq!((d.all.relative_rmse, d.all.bias, d.maximum.error, d.flip), (0.0, 0.0, 0.0, 0.0));
        // A channel without light has no relative error.
        assert!(d.channels[2].is_none() && d.channels[1].is_some());
    }

    #[test]
    fn pixels_that_are_no_numbers_are_counted_and_left_out() {
        let (mut x, mut a) = (uniform([0.5; 3]), uniform([0.5; 3]));
        x.set(5, 2, [f32::NAN, 0.0, 0.0]);
        x.set(1, 9, [0.0, f32::INFINITY, 0.0]);
        a.set(0, 0, [f32::NEG_INFINITY; 3]);
        let mut mask = vec![true; 1200];
        mask[9 * 40 + 1] = false;
        let d = Difference::new(&x, &a, None, &Options { mask: Some(&mask), exposure: 0.0 }).unwrap();
        let expected = [
            NotFinite { image: "image", pixels: 1, first: [5, 2] },
            NotFinite { image: "reference", pixels: 1, first: [0, 0] },
        ];
        assert_eq!(d.not_finite, expected);
        assert_eq!((d.pixels, d.masked, d.all.relative_rmse, d.flip), (1197, 1, 0.0, 0.0));
    }

    #[test]
    fn where_no_pixel_is_left_the_cause_is_named() {
        let (grey, none) = (uniform([0.5; 3]), uniform([f32::NAN; 3]));
        let says = |x: &Image, a: &Image, mask: Option<&[bool]>| {
            Difference::new(x, a, None, &Options { mask, exposure: 0.0 }).unwrap_err().to_string()
        };
        assert_eq!(says(&none, &grey, None), "no pixel is finite in the image: nothing is left to compare");
        assert!(says(&none, &none, None).contains("in the image and the reference"));
        assert!(says(&grey, &grey, Some(&[false; 1200])).contains("the mask leaves no pixel"));
    }

    /// FLIP of black against white is near 1, and a masked block of it changes nothing elsewhere.
    #[test]
    fn flip_has_its_ends_and_its_mask() {
        let (black, white) = (uniform([0.0; 3]), uniform([1.0; 3]));
        let counts = vec![true; 1200];
        let far = flip(&black, &white, None, &counts, 0.0).unwrap();
        assert!(far > 0.9, "{far}");
        let mut x = uniform([0.5; 3]);
        let mut counts = counts;
        for k in 0..10 {
            x.set(k, 4, [9.0; 3]);
            counts[4 * 40 + k] = false;
        }
        assert_eq!(flip(&x, &uniform([0.5; 3]), None, &counts, 0.0).unwrap(), 0.0);
    }

    #[test]
    fn shares_of_errors() {
        let (mut x, a) = (uniform([0.5; 3]), uniform([0.5; 3]));
        (0..12).for_each(|k| x.set(k, 0, [0.8; 3]));
        assert_eq!(error_within(&x, &a, None, 0.95), 0.0);
        assert!((error_within(&x, &a, None, 0.999) - 0.3).abs() < 1e-6);
    }
}
