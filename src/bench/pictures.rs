//! Strips of pictures: every method after about the same time, and its errors in false colours.

use super::reference::Reference;
use super::view::{ERROR, View};
use crate::Result;
use crate::color;
use crate::image::canvas::{BLACK, Canvas, LETTER, WHITE};
use crate::image::{Image, error_within, mean_image, png, signed_difference, srgb_bytes};
use crate::render::{Method, Quality};
use crate::report::record::{Picture, Strip, Subject};

/// A picture of the first round with what it cost, for the strips.
pub(super) struct Kept {
    pub series: &'static str,
    pub spp: u32,
    /// Wall time of the first frame \[s\].
    pub first: f64,
    pub image: Image,
}

/// Exposure [EV] that brings the mean of the reference to a middle grey.
pub(super) fn exposure(reference: &Reference) -> f64 {
    let pixels = reference.mean.data.chunks_exact(3).zip(&reference.mask).filter(|p| *p.1);
    let (sum, n) = pixels.fold((0.0, 0.0), |(s, n), (p, _)| {
        (s + color::mean(color::Rgb::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))), n + 1.0)
    });
    (0.22f64 * n / sum).log2()
}

/// The reference beside every method after about the same time, and their errors in false colours.
pub(super) fn pictures(stage: &View, subject: &Subject, kept: &[Kept], name: &str) -> Result<Vec<Strip>> {
    let most = Method::TwoPass(Quality::Gather).default_spp();
    let gather = kept.iter().filter(|k| k.series == "gather" && k.spp <= most).map(|k| k.first);
    let budget = gather.fold(0.0, f64::max);
    let mut chosen: Vec<&Kept> = Vec::new();
    for series in ["mesh", "direct", "gather", "path"] {
        let off = |k: &&Kept| (k.first / budget).ln().abs();
        let best = kept.iter().filter(|k| k.series == series).min_by(|a, b| off(a).total_cmp(&off(b)));
        chosen.extend(best);
    }
    let reference = stage.reference;
    let ev = exposure(reference);
    let [width, height] = stage.camera.size.map(|n| n as usize);
    let shown = |image: &Image| png(width, height, &srgb_bytes(image, ev));
    let file = |what: &str| format!("pictures/images-{name}-{what}.png");
    let caption = |k: &Kept| {
        let series = subject.series.iter().find(|s| s.name == k.series);
        let point = series.and_then(|s| s.points.iter().find(|p| p.parameter == f64::from(k.spp)));
        let error = point.and_then(|p| p.get(ERROR)).map_or(0.0, |m| m.samples[0]);
        format!("{}, {} samples a pixel: {:.2} s, error {:.2} %", k.series, k.spp, k.first, 100.0 * error)
    };
    let mut plain = vec![Picture {
        caption: format!("reference, {} paths a pixel", 2 * reference.spp),
        file: file("reference"),
        png: shown(&reference.mean)?,
    }];
    let mean = stage.compare(&reference.mean, &reference.mask)?.reference_mean;
    let within = |k: &&Kept| error_within(&k.image, &reference.mean, Some(&reference.mask), 0.98) / mean;
    // One scale for all, set by the methods in the middle: a noisy one may leave it.
    let mut scales: Vec<f64> = chosen.iter().map(within).collect();
    scales.sort_by(f64::total_cmp);
    let scale = scales.get(scales.len() / 2).copied().filter(|s| *s > 0.0).unwrap_or(1.0);
    let colours = |image: &Image, right: &Image| {
        png(width, height, &signed_difference(image, right, Some(&reference.mask), scale * mean))
    };
    // Half the difference of the halves is as noisy as their mean.
    let half = mean_image(&reference.halves[0], Some(&reference.mean));
    let mut errors = vec![Picture {
        caption: "noise of the reference itself".into(),
        file: file("reference-error"),
        png: colours(&half, &mean_image(&reference.halves[1], Some(&reference.mean)))?,
    }];
    for k in chosen {
        plain.push(Picture { caption: caption(k), file: file(k.series), png: shown(&k.image)? });
        errors.push(Picture {
            caption: k.series.to_string(),
            file: file(&format!("{}-error", k.series)),
            png: colours(&k.image, &reference.mean)?,
        });
    }
    Ok(vec![
        Strip {
            title: "Pictures after about the same time".into(),
            about: format!("First frames that took about {budget:.2} s, pass 1 included, beside the reference."),
            scale: None,
            pictures: plain,
            whole: None,
        },
        Strip {
            title: "Their errors".into(),
            about: "Picture minus reference: blue is too dark, red too bright, white right; grey pixels see a lamp and do not count. \
                    Speckles are noise, which more samples remove; areas of one colour are what the elements cannot show, which \
                    finer elements remove."
                .into(),
            scale: Some(scale),
            pictures: errors,
            whole: None,
        },
    ])
}

/// Pictures of one size side by side as one, each with the lines of its caption below it: PNG.
pub(super) fn side_by_side(
    [width, height]: [usize; 2],
    pictures: &[(Vec<u8>, Vec<String>)],
) -> Result<Vec<u8>> {
    const GAP: usize = 8;
    // Wide enough for the longest line.
    let letters = pictures.iter().flat_map(|p| &p.1).map(|l| l.chars().count()).max().unwrap_or(0);
    let zoom = (letters * LETTER[0]).div_ceil(width.max(1)).max(1);
    let lines = pictures.iter().map(|p| p.1.len()).max().unwrap_or(0);
    let step = width * zoom + GAP;
    let below = GAP + height * zoom + GAP / 2;
    let mut canvas = Canvas::new(GAP + step * pictures.len(), below + lines * (LETTER[1] + 2) + GAP, WHITE);
    for (k, (bytes, caption)) in pictures.iter().enumerate() {
        let left = GAP + k * step;
        for (at, rgb) in bytes.chunks_exact(3).enumerate() {
            let corner = [left + at % width * zoom, GAP + at / width * zoom];
            canvas.fill(corner, [zoom; 2], [rgb[0], rgb[1], rgb[2]]);
        }
        for (line, text) in caption.iter().enumerate() {
            canvas.text(text, [left, below + line * (LETTER[1] + 2)], BLACK);
        }
    }
    let (w, h) = (canvas.width, canvas.height);
    png(w, h, &canvas.into_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::read;

    /// Two pictures of 4 x 3 pixels, zoomed until eight letters fit below, and what is written there.
    #[test]
    fn pictures_stand_side_by_side() {
        let plain = |rgb: [u8; 3]| rgb.repeat(12);
        let lines = |a: &str| vec![a.to_string(), "l".repeat(8)];
        let pictures = [(plain([255, 0, 0]), lines("one")), (plain([0, 0, 255]), lines(""))];
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("strip.png");
        std::fs::write(&path, side_by_side([4, 3], &pictures).expect("a picture")).expect("written");
        let image = read(&path).expect("read");
        // 56 / 4 = 14 fold; gaps of 8.
        let (wide, high) = (4 * 14, 3 * 14);
        assert_eq!((image.width, image.height), (8 + 2 * (wide + 8), 8 + high + 4 + 2 * 15 + 8));
        for (x, y, rgb) in [
            (8, 8, [1.0, 0.0, 0.0]),
            (8 + wide - 1, 8 + high - 1, [1.0, 0.0, 0.0]),
            (16 + wide, 8, [0.0, 0.0, 1.0]),
            (8 + wide, 8, [1.0; 3]),
        ] {
            assert_eq!(image.get(x, y), rgb, "{x} {y}");
        }
        // Letters below the first picture's first line; none below the second's.
        let ink = |left: usize| {
            let rows = 8 + high + 4..8 + high + 4 + 13;
            rows.flat_map(|y| (left..left + wide).map(move |x| (x, y)))
                .filter(|(x, y)| image.get(*x, *y)[0] < 0.5)
                .count()
        };
        assert!(ink(8) > 10 && ink(16 + wide) == 0, "{} {}", ink(8), ink(16 + wide));
    }
}
