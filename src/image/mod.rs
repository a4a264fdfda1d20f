//! Images: one value, written and read through OpenImageIO, compared with a reference.

pub(crate) mod canvas;
mod compare;
mod difference;
mod false_colour;
mod oiio;
mod pfm;

pub use compare::{
    Comparison, read_exr, read_mask_npy, relative_rmse, relative_rmse_halves, relative_rmse_of_halves,
};
pub use difference::{Difference, Errors, Largest, NotFinite, Options, error_within, mean_image};
pub use false_colour::{signed_colour, signed_difference};
pub use oiio::{
    WriteOptions, fits, has_exposure, png, prepare, read, ready, srgb_bytes, supported, version, write,
};
pub use pfm::read_pfm;

use crate::Result;
use std::path::Path;

/// Reads an image by its extension: OpenEXR and PFM without OpenImageIO, all else through it; linear RGB.
pub fn read_any(path: &Path) -> Result<Image> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match extension.as_str() {
        "exr" => read_exr(path),
        "pfm" => read_pfm(path),
        _ => read(path),
    }
}

/// Linear RGB radiance, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples a pixel; 3 in every image that this crate makes or reads.
    pub channels: usize,
    /// `width * height * channels` samples, the channels of a pixel together.
    pub data: Vec<f32>,
}

impl Image {
    /// A black image.
    pub fn new(width: usize, height: usize) -> Image {
        Image { width, height, channels: 3, data: vec![0.0; width * height * 3] }
    }

    /// The pixel in column `x` of row `y` (0 at the top).
    #[inline]
    pub fn get(&self, x: usize, y: usize) -> [f32; 3] {
        let i = (y * self.width + x) * self.channels;
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// Replaces the pixel in column `x` of row `y` (0 at the top).
    #[inline]
    pub fn set(&mut self, x: usize, y: usize, pixel: [f32; 3]) {
        let i = (y * self.width + x) * self.channels;
        self.data[i..i + 3].copy_from_slice(&pixel);
    }

    /// Number of pixels.
    pub fn pixel_count(&self) -> usize {
        self.width * self.height
    }
}
