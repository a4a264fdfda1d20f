//! Pictures of signed errors.

use super::Image;

/// A diverging map from -1 (blue: too dark) over 0 (white) to 1 (red: too bright), clamped outside; sRGB bytes.
///
/// Lightness falls evenly to both ends, so the sign is told by hue and the size by lightness (the scheme of Moreland,
/// "Diverging color maps for scientific visualization", 2009; nodes after ColorBrewer's RdBu).
pub fn signed_colour(x: f64) -> [u8; 3] {
    const NODES: [[f64; 3]; 5] = [
        [247.0, 247.0, 247.0],
        [253.0, 199.0, 170.0],
        [232.0, 121.0, 95.0],
        [190.0, 32.0, 47.0],
        [103.0, 0.0, 31.0],
    ];
    const COLD: [[f64; 3]; 5] = [
        [247.0, 247.0, 247.0],
        [188.0, 218.0, 236.0],
        [104.0, 170.0, 208.0],
        [38.0, 104.0, 172.0],
        [5.0, 48.0, 97.0],
    ];
    let nodes = if x < 0.0 { COLD } else { NODES };
    let at = x.abs().min(1.0) * 4.0;
    let k = (at as usize).min(3);
    let t = at - k as f64;
    [0, 1, 2].map(|c| (nodes[k][c] * (1.0 - t) + nodes[k + 1][c] * t).round() as u8)
}

/// Error of `image` against `reference` in false colours: the mean of the channels' differences over `scale`.
/// Pixels that do not count (`mask`) are grey, those that are no numbers black. As bytes of sRGB, row by row.
pub fn signed_difference(image: &Image, reference: &Image, mask: Option<&[bool]>, scale: f64) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(image.data.len());
    for (i, (x, r)) in image.data.chunks_exact(3).zip(reference.data.chunks_exact(3)).enumerate() {
        let error: f64 = x.iter().zip(r).map(|(x, r)| f64::from(*x) - f64::from(*r)).sum::<f64>() / 3.0;
        let colour = match mask {
            Some(mask) if !mask[i] => [150; 3],
            _ if !error.is_finite() => [0; 3],
            _ => signed_colour(error / scale),
        };
        bytes.extend_from_slice(&colour);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_is_symmetric_in_lightness_and_clamped() {
        assert_eq!(signed_colour(0.0), [247; 3]);
        assert_eq!(signed_colour(9.0), signed_colour(1.0));
        assert_eq!(signed_colour(-9.0), [5, 48, 97]);
        let light = |c: [u8; 3]| 0.21 * f64::from(c[0]) + 0.72 * f64::from(c[1]) + 0.07 * f64::from(c[2]);
        for k in 1..=100 {
            let (x, y) = (f64::from(k - 1) / 100.0, f64::from(k) / 100.0);
            assert!(light(signed_colour(y)) < light(signed_colour(x)));
            assert!(light(signed_colour(-y)) < light(signed_colour(-x)));
            let (warm, cold) = (signed_colour(y), signed_colour(-y));
            assert!(warm[0] > warm[2] && cold[2] > cold[0]);
        }
    }

    #[test]
    fn errors_have_their_sign() {
        let (mut image, reference) = (Image::new(4, 1), Image::new(4, 1));
        image.set(0, 0, [0.1; 3]);
        image.set(1, 0, [-0.2; 3]);
        image.set(2, 0, [f32::NAN, 0.0, 0.0]);
        let bytes = signed_difference(&image, &reference, Some(&[true, true, true, false]), 0.1);
        let expected = [signed_colour(1.0), signed_colour(-1.0), [0; 3], [150; 3]].concat();
        assert_eq!(bytes, expected);
    }
}
