//! The error of an image against a reference, and readers that share nothing with the writer.

use super::Image;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// How far an image is from a reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Root of the mean squared error over the mean of the reference; 0 where the estimate of the
    /// squared error is negative, which is noise about an error too small to see.
    pub relative_rmse: f64,
    /// Standard error of `relative_rmse`, upwards, taking pixels as independent.
    pub standard_error: f64,
    /// The estimate of the mean squared error over the squared mean of the reference, with its sign.
    pub relative_mse: f64,
    /// Mean of the image over the mean of the reference, minus 1.
    pub mean_bias: f64,
    /// Pixels that count.
    pub pixels: usize,
    /// Mean of the reference over those pixels.
    pub reference_mean: f64,
}

/// Compares `x` with a noisy reference given as two independent halves.
///
/// The mean of `(x - a)(x - b)` estimates the squared error of `x` without the noise of the
/// reference, however large that is: the noises of the halves are independent and average out.
/// `mask` tells which pixels count, row by row; all do without it.
pub fn relative_rmse_halves(x: &Image, a: &Image, b: &Image, mask: Option<&[bool]>) -> Result<Comparison> {
    for (name, image) in [("image", x), ("reference", a), ("second reference", b)] {
        check(name, image, x, mask)?;
    }
    compare_channels([x, x], [a, b], mask, &[0, 1, 2])
}

/// How far two renderers' expectations are apart, free of the noise of both: `x` and `a` each as two independent halves.
pub fn relative_rmse_of_halves(x: [&Image; 2], a: [&Image; 2], mask: Option<&[bool]>) -> Result<Comparison> {
    for (name, image) in [("second image", x[1]), ("reference", a[0]), ("second reference", a[1])] {
        check(name, image, x[0], mask)?;
    }
    check("image", x[0], x[0], mask)?;
    compare_channels(x, a, mask, &[0, 1, 2])
}

/// The comparison over some of the channels, of images that were checked.
pub(super) fn compare_channels(
    x: [&Image; 2],
    a: [&Image; 2],
    mask: Option<&[bool]>,
    channels: &[usize],
) -> Result<Comparison> {
    let (mut n, mut product, mut squares) = (0usize, 0.0, 0.0);
    let (mut image_sum, mut reference_sum) = (0.0, 0.0);
    let share = 1.0 / channels.len() as f64;
    for i in (0..x[0].pixel_count()).filter(|i| mask.is_none_or(|mask| mask[*i])) {
        let mut error = 0.0;
        for k in channels {
            let at = |image: &Image| f64::from(image.data[3 * i + k]);
            let (x0, x1, a0, a1) = (at(x[0]), at(x[1]), at(a[0]), at(a[1]));
            error += (x0 - a0) * (x1 - a1) * share;
            image_sum += 0.5 * (x0 + x1) * share;
            reference_sum += 0.5 * (a0 + a1) * share;
        }
        n += 1;
        product += error;
        squares += error * error;
    }
    if n == 0 {
        return Err(Error::Usage("the mask leaves no pixel to compare".into()));
    }
    let count = n as f64;
    let mean = reference_sum / count;
    // Also refuses NaN, which infinite sums would give.
    if !(mean > 0.0 && mean.is_finite()) {
        return Err(Error::Usage(format!(
            "the mean of the reference is {mean}: no error is relative to that"
        )));
    }
    let mse = product / count / (mean * mean);
    let variance = (squares / count - (product / count).powi(2)).max(0.0) / count;
    let mse_error = variance.sqrt() / (mean * mean);
    let relative_rmse = mse.max(0.0).sqrt();
    Ok(Comparison {
        relative_rmse,
        standard_error: (mse.max(0.0) + mse_error).sqrt() - relative_rmse,
        relative_mse: mse,
        mean_bias: image_sum / reference_sum - 1.0,
        pixels: n,
        reference_mean: mean,
    })
}

/// Compares `x` with a reference that is exact, or whose noise may count as error.
pub fn relative_rmse(x: &Image, reference: &Image, mask: Option<&[bool]>) -> Result<Comparison> {
    relative_rmse_halves(x, reference, reference, mask)
}

/// Refuses an image that is not like `first`, or has a counting pixel that is no number.
fn check(name: &str, image: &Image, first: &Image, mask: Option<&[bool]>) -> Result<()> {
    if (image.width, image.height) != (first.width, first.height) {
        return Err(Error::Usage(format!(
            "the {name} has {} x {} pixels, but the image has {} x {}",
            image.width, image.height, first.width, first.height
        )));
    }
    if image.channels != 3 || image.data.len() != 3 * image.pixel_count() {
        return Err(Error::Usage(format!("the {name} is not an RGB image")));
    }
    if let Some(mask) = mask.filter(|mask| mask.len() != image.pixel_count()) {
        return Err(Error::Usage(format!(
            "the mask has {} pixels, but the image has {} x {}",
            mask.len(),
            image.width,
            image.height
        )));
    }
    let counts = |i: usize| mask.is_none_or(|mask| mask[i]);
    let bad =
        image.data.chunks_exact(3).enumerate().find(|(i, p)| counts(*i) && p.iter().any(|v| !v.is_finite()));
    if let Some((i, pixel)) = bad {
        let (x, y) = (i % image.width, i / image.width);
        return Err(Error::Usage(format!("pixel ({x}, {y}) of the {name} is not finite: {pixel:?}")));
    }
    Ok(())
}

/// Reads the first RGB layer of an OpenEXR file, or else the first grey one (Y), without OpenImageIO.
pub fn read_exr(path: &Path) -> Result<Image> {
    use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, read};
    let open = || File::open(path).map(BufReader::new).map_err(|e| Error::io(path, e));
    let failed = |e| match e {
        exr::error::Error::Io(source) => Error::io(path, source),
        other => Error::Image { path: path.into(), message: other.to_string() },
    };
    let layers = || read().no_deep_data().largest_resolution_level();
    let new = |size: exr::math::Vec2<usize>| Image::new(size.width(), size.height());
    let file = open()?;
    match channels_of(path) {
        // Whatever is wrong with the file is told by who reads it whole.
        None | Some(Channels::Rgb) => {
            let set = |image: &mut Image, at: exr::math::Vec2<usize>, (r, g, b): (f32, f32, f32)| {
                image.set(at.x(), at.y(), [r, g, b]);
            };
            let layers = layers().rgb_channels(|size, _| new(size), set).first_valid_layer().all_attributes();
            Ok(layers.from_buffered(file).map_err(failed)?.layer_data.channel_data.pixels)
        }
        Some(Channels::Grey) => {
            let set = |image: &mut Image, at: exr::math::Vec2<usize>, (y,): (f32,)| {
                image.set(at.x(), at.y(), [y; 3]);
            };
            let channels =
                layers().specific_channels().required("Y").collect_pixels(|size, _| new(size), set);
            let layers = channels.first_valid_layer().all_attributes();
            Ok(layers.from_buffered(file).map_err(failed)?.layer_data.channel_data.pixels)
        }
        Some(Channels::Other(names)) => {
            let message = format!(
                "holds the channels {names}, but no layer of R, G and B, nor a grey one of Y alone: write those that are meant \
                 to a file of their own, with these names"
            );
            Err(Error::Image { path: path.into(), message })
        }
    }
}

/// What of an OpenEXR file can be read.
enum Channels {
    Rgb,
    Grey,
    /// Neither, with the names of all.
    Other(String),
}

/// What channels an OpenEXR file has; none where its header cannot be read.
fn channels_of(path: &Path) -> Option<Channels> {
    let meta = exr::meta::MetaData::read_from_file(path, false).ok()?;
    let layers: Vec<Vec<String>> = meta
        .headers
        .iter()
        .map(|header| header.channels.list.iter().map(|c| c.name.to_string()).collect())
        .collect();
    let has = |layer: &[String], wanted: &[&str]| wanted.iter().all(|w| layer.iter().any(|name| name == w));
    if layers.iter().any(|layer| has(layer, &["R", "G", "B"])) {
        return Some(Channels::Rgb);
    }
    // With RY and BY it is a colour image of another kind.
    if layers.iter().any(|layer| has(layer, &["Y"])) && !layers.iter().any(|layer| has(layer, &["RY"])) {
        return Some(Channels::Grey);
    }
    Some(Channels::Other(layers.concat().join(", ")))
}

/// Reads a mask of `width` x `height` pixels from a NumPy file of booleans, of shape
/// (height, width).
pub fn read_mask_npy(path: &Path, width: usize, height: usize) -> Result<Vec<bool>> {
    let io = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::UnexpectedEof => {
            Error::parse(path, None, "ends too early: it is shorter than its header says")
        }
        _ => Error::io(path, e),
    };
    let refuse = |message: String| Err(Error::parse(path, None, message));
    let npy = npyz::NpyFile::new(BufReader::new(File::open(path).map_err(io)?)).map_err(io)?;
    if npy.shape() != [height as u64, width as u64] {
        return refuse(format!("has shape {:?}, but the image needs [{height}, {width}]", npy.shape()));
    }
    let columns_first = npy.order() == npyz::Order::Fortran;
    let data = match npy.try_data::<bool>() {
        Ok(data) => data.collect::<std::io::Result<Vec<bool>>>().map_err(io)?,
        Err(npy) => return refuse(format!("holds {}, not booleans", npy.dtype().descr())),
    };
    if columns_first {
        return Ok((0..height * width).map(|i| data[i % width * height + i / width]).collect());
    }
    Ok(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn uniform(value: f32) -> Image {
        let mut image = Image::new(100, 50);
        image.data.fill(value);
        image
    }

    /// A multiplicative congruential sequence in [-1, 1), enough to play noise.
    fn noise(image: &Image, amplitude: f32, seed: u64) -> Image {
        let mut state = seed;
        let mut image = image.clone();
        for v in &mut image.data {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *v += amplitude * ((state >> 40) as f32 / (1 << 23) as f32 - 1.0);
        }
        image
    }

    #[test]
    fn a_constant_offset_is_its_own_error() {
        let result = relative_rmse(&uniform(2.2), &uniform(2.0), None).unwrap();
        assert!((result.relative_rmse - 0.1).abs() < 1e-6);
        assert!((result.mean_bias - 0.1).abs() < 1e-6);
        assert!(result.standard_error < 1e-6);
        assert_eq!(result.pixels, 5000);
    }

    #[test]
    fn halves_see_below_the_noise_of_the_reference() {
        let (truth, x) = (uniform(1.0), uniform(1.02));
        let (a, b) = (noise(&truth, 0.5, 1), noise(&truth, 0.5, 2));
        let blind = relative_rmse(&x, &a, None).unwrap();
        assert!(blind.relative_rmse > 0.2);
        let seen = relative_rmse_halves(&x, &a, &b, None).unwrap();
        assert!((seen.relative_rmse - 0.02).abs() < 4.0 * seen.standard_error, "{seen:?}");
        assert!(seen.standard_error < 0.03);
        // The estimate of a perfect image is zero within its error, of either sign.
        let perfect = relative_rmse_halves(&truth, &a, &b, None).unwrap();
        assert!(perfect.relative_mse.abs() < 0.005, "{perfect:?}");
    }

    #[test]
    fn the_standard_error_is_the_spread() {
        let (truth, x) = (uniform(1.0), noise(&uniform(1.0), 0.2, 99));
        let runs: Vec<Comparison> = (0..40)
            .map(|i| {
                let (a, b) = (noise(&truth, 0.3, 2 * i + 1), noise(&truth, 0.3, 2 * i + 2));
                relative_rmse_halves(&x, &a, &b, None).unwrap()
            })
            .collect();
        let n = runs.len() as f64;
        let mean = runs.iter().map(|r| r.relative_rmse).sum::<f64>() / n;
        let spread = (runs.iter().map(|r| (r.relative_rmse - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let claimed = runs.iter().map(|r| r.standard_error).sum::<f64>() / n;
        // The claim also covers the sampling of the error over pixels, which these runs share.
        assert!(spread < 1.3 * claimed && claimed < 3.0 * spread, "{spread} {claimed}");
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let mut x = uniform(1.0);
        x.set(3, 0, [f32::NAN, 9.0, 9.0]);
        let mut mask = vec![true; 5000];
        mask[3] = false;
        let result = relative_rmse(&x, &uniform(1.0), Some(&mask)).unwrap();
        assert_eq!((result.relative_rmse, result.pixels), (0.0, 4999));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let (x, other) = (uniform(1.0), Image::new(50, 100));
        let text = |r: Result<Comparison>| r.unwrap_err().to_string();
        assert_eq!(
            text(relative_rmse(&x, &other, None)),
            "the reference has 50 x 100 pixels, but the image has 100 x 50"
        );
        assert!(text(relative_rmse_halves(&x, &x, &other, None)).contains("second reference"));
        assert!(text(relative_rmse(&x, &x, Some(&[true; 7]))).contains("the mask has 7 pixels"));
        assert!(text(relative_rmse(&x, &x, Some(&[false; 5000]))).contains("no pixel"));
        assert!(text(relative_rmse(&x, &uniform(0.0), None)).contains("mean of the reference is 0"));
        let mut bad = uniform(1.0);
        bad.set(7, 2, [1.0, f32::INFINITY, 1.0]);
        assert!(text(relative_rmse(&bad, &x, None)).contains("pixel (7, 2) of the image"));
    }

    fn npy(descr: &str, order: &str, shape: &str, data: &[u8]) -> tempfile::NamedTempFile {
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        while (10 + header.len() + 1) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(b"\x93NUMPY\x01\x00").unwrap();
        file.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
        file.write_all(header.as_bytes()).unwrap();
        file.write_all(data).unwrap();
        file
    }

    #[test]
    fn masks_of_numpy() {
        let expected = [true, false, true, false, false, true];
        let rows = npy("|b1", "False", "(2, 3)", &[1, 0, 1, 0, 0, 1]);
        assert_eq!(read_mask_npy(rows.path(), 3, 2).unwrap(), expected);
        let columns = npy("|b1", "True", "(2, 3)", &[1, 0, 0, 0, 1, 1]);
        assert_eq!(read_mask_npy(columns.path(), 3, 2).unwrap(), expected);

        let text = |r: Result<Vec<bool>>| r.unwrap_err().to_string();
        assert!(text(read_mask_npy(rows.path(), 2, 3)).contains("has shape [2, 3]"));
        let floats = npy("<f4", "False", "(2, 3)", &[0; 24]);
        assert!(text(read_mask_npy(floats.path(), 3, 2)).contains("not booleans"));
        let short = npy("|b1", "False", "(2, 3)", &[1, 0]);
        assert!(text(read_mask_npy(short.path(), 3, 2)).contains("shorter than its header says"));
        assert!(read_mask_npy(Path::new("none.npy"), 3, 2).is_err());
    }

    #[test]
    fn damaged_exr_files_are_errors() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        assert!(read_exr(file.path()).is_err());
        file.write_all(b"\x76\x2f\x31\x01 and nothing that follows from it").unwrap();
        assert!(read_exr(file.path()).unwrap_err().to_string().contains(&file.path().display().to_string()));
        assert!(matches!(read_exr(Path::new("none.exr")), Err(Error::Io { .. })));
    }
}
