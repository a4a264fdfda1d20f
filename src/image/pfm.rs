//! Portable float maps: `PF` (colour) or `Pf` (grey), rows from the bottom, byte order by the sign of the scale
//! (Debevec's HDRShop format).

use super::Image;
use crate::error::{Error, Result};
use std::path::Path;

/// Reads a PFM file as linear RGB; a grey sample is spread over the three channels.
pub fn read_pfm(path: &Path) -> Result<Image> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    parse(&bytes).map_err(|message| Error::Image { path: path.into(), message })
}

fn parse(bytes: &[u8]) -> std::result::Result<Image, String> {
    let mut rest = bytes;
    let mut word = || {
        let begin = rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(rest.len());
        let length = rest[begin..].iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len() - begin);
        let word = String::from_utf8_lossy(&rest[begin..begin + length]).into_owned();
        // One white-space character ends the header; the samples follow it.
        rest = &rest[(begin + length + 1).min(rest.len())..];
        word
    };
    let channels = match word().as_str() {
        "PF" => 3,
        "Pf" => 1,
        other => return Err(format!("is no PFM file: it begins with {other:?} instead of PF or Pf")),
    };
    let (width, height, scale) = (word(), word(), word());
    let size = |text: &str| text.parse::<usize>().ok().filter(|&n| n > 0 && n <= 1 << 24);
    let (Some(w), Some(h)) = (size(&width), size(&height)) else {
        return Err(format!("has the size {width:?} x {height:?}"));
    };
    let little = match scale.parse::<f64>() {
        Ok(s) if s != 0.0 && s.is_finite() => s < 0.0,
        _ => return Err(format!("has the scale {scale:?}; a number below or above 0 is expected")),
    };
    let needed = w.checked_mul(h).and_then(|n| n.checked_mul(4 * channels));
    if needed != Some(rest.len()) {
        return Err(format!(
            "holds {} bytes of samples, but {w} x {h} x {channels} need {needed:?}",
            rest.len()
        ));
    }
    let mut image = Image::new(w, h);
    for (k, sample) in rest.chunks_exact(4).enumerate() {
        let four = [sample[0], sample[1], sample[2], sample[3]];
        let value = if little { f32::from_le_bytes(four) } else { f32::from_be_bytes(four) };
        let (pixel, channel) = (k / channels, k % channels);
        let at = 3 * ((h - 1 - pixel / w) * w + pixel % w) + channel;
        image.data[at..at + if channels == 1 { 3 } else { 1 }].fill(value);
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_bytes_are_in_order() {
        let floats: Vec<f32> = (0..12).map(|k| k as f32).collect();
        let little: Vec<u8> = floats.iter().flat_map(|f| f.to_le_bytes()).collect();
        let image = parse(&[b"PF\n2 2\n-1.0\n".as_slice(), &little].concat()).unwrap();
        assert_eq!((image.get(0, 1), image.get(1, 0)), ([0.0, 1.0, 2.0], [9.0, 10.0, 11.0]));
        let big: Vec<u8> = floats[..4].iter().flat_map(|f| f.to_be_bytes()).collect();
        let grey = parse(&[b"Pf 2 2 1\n".as_slice(), &big].concat()).unwrap();
        assert_eq!((grey.get(1, 1), grey.get(0, 0)), ([1.0; 3], [2.0; 3]));
    }

    #[test]
    fn damaged_files_are_errors() {
        for (bytes, part) in [
            (b"".as_slice(), "no PFM file"),
            (b"P6\n1 1\n255\n", "no PFM file"),
            (b"PF\n0 1\n-1\n", "size"),
            (b"PF\n1 1\nx\n", "scale"),
            (b"PF\n1 1\n-1\n1234", "holds 4 bytes"),
            (b"PF", "size"),
        ] {
            let message = parse(bytes).unwrap_err();
            assert!(message.contains(part), "{message}");
        }
    }
}
