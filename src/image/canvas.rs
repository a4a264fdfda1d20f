//! Pixels and letters for diagrams: an [`Image`] that `embedded-graphics` draws on.

use super::Image;
use crate::color::srgb_decode;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::iso_8859_1::FONT_7X13;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{DrawTarget, Drawable, OriginDimensions, Pixel, Point, RgbColor, Size};
use embedded_graphics::text::{Baseline, Text};
use std::convert::Infallible;

/// Width and height of a letter.
pub(crate) const LETTER: [usize; 2] = [7, 13];

/// An sRGB colour.
pub(crate) type Srgb = [u8; 3];
pub(crate) const WHITE: Srgb = [255; 3];
pub(crate) const BLACK: Srgb = [0; 3];

/// A picture under way, in sRGB.
pub(crate) struct Canvas {
    pub width: usize,
    pub height: usize,
    pixels: Vec<Srgb>,
}

impl Canvas {
    pub fn new(width: usize, height: usize, background: Srgb) -> Canvas {
        Canvas { width, height, pixels: vec![background; width * height] }
    }

    /// Colours a pixel; nothing outside.
    pub fn set(&mut self, x: usize, y: usize, color: Srgb) {
        if x < self.width && y < self.height {
            self.pixels[y * self.width + x] = color;
        }
    }

    pub fn fill(&mut self, [x, y]: [usize; 2], [w, h]: [usize; 2], color: Srgb) {
        for row in y..(y + h).min(self.height) {
            for column in x..(x + w).min(self.width) {
                self.set(column, row, color);
            }
        }
    }

    /// Writes text with its top left corner at (x, y).
    pub fn text(&mut self, text: &str, [x, y]: [usize; 2], color: Srgb) {
        let style = MonoTextStyle::new(&FONT_7X13, Rgb888::new(color[0], color[1], color[2]));
        let at = Point::new(x as i32, y as i32);
        let Ok(_) = Text::with_baseline(text, at, style, Baseline::Top).draw(self);
    }

    /// Writes text upwards, its first letter's bottom left corner at (x, y).
    pub fn text_upwards(&mut self, text: &str, [x, y]: [usize; 2], color: Srgb) {
        let mut flat = Canvas::new(width(text), LETTER[1], WHITE);
        flat.text(text, [0, 0], BLACK);
        for v in 0..flat.height {
            for u in 0..flat.width.min(y + 1) {
                if flat.pixels[v * flat.width + u] == BLACK {
                    self.set(x + v, y - u, color);
                }
            }
        }
    }

    /// The picture's bytes, as [`super::png`] expects them.
    pub fn into_bytes(self) -> Vec<u8> {
        self.pixels.into_flattened()
    }

    /// The picture as linear radiance, as [`crate::image::write`] expects it.
    pub fn into_image(self) -> Image {
        let linear: Vec<f32> = (0..256).map(|v| srgb_decode(f64::from(v) / 255.0) as f32).collect();
        let data = self.pixels.iter().flatten().map(|&v| linear[usize::from(v)]).collect();
        Image { width: self.width, height: self.height, channels: 3, data }
    }
}

/// Width of a text in pixels.
pub(crate) fn width(text: &str) -> usize {
    LETTER[0] * text.chars().count()
}

/// A text that fits in so many letters: long ones end in dots.
pub(crate) fn shortened(text: &str, letters: usize) -> String {
    if text.chars().count() <= letters {
        return text.into();
    }
    text.chars().take(letters.saturating_sub(2)).chain("..".chars()).collect()
}

/// Colour of the k-th of several things: ten well-known ones, then hues that no neighbour has.
pub(crate) fn category(k: usize) -> Srgb {
    match colorous::TABLEAU10.get(k) {
        Some(c) => [c.r, c.g, c.b],
        None => {
            let hue = (k as f64 * 0.618_033_988_749_895).fract();
            let c = colorous::SINEBOW.eval_continuous(hue);
            [c.r, c.g, c.b]
        }
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, c) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(at.x), usize::try_from(at.y)) {
                self.set(x, y, [c.r(), c.g(), c.b()]);
            }
        }
        Ok(())
    }
}
