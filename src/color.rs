//! Linear RGB.

use glam::DVec3;

/// Linear RGB triple; radiance [W m^-2 sr^-1], radiosity [W m^-2] or a dimensionless reflectance.
pub type Rgb = DVec3;

/// Mean of the three channels: the weight by which energy decisions (Russian roulette, light
/// selection) are made. Not photometric luminance: no channel may be starved of samples.
pub fn mean(c: Rgb) -> f64 {
    (c.x + c.y + c.z) / 3.0
}

/// Whether the three channels are equal to a part in 1e9.
pub fn is_grey(c: Rgb) -> bool {
    c.max_element() - c.min_element() <= 1e-9 * c.max_element().abs()
}

/// sRGB transfer function (IEC 61966-2-1) of a linear value, clamped to `[0, 1]`.
pub fn srgb_encode(v: f64) -> f64 {
    let v = if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) };
    if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Linear value of an sRGB-encoded one: the inverse of [`srgb_encode`] on `[0, 1]`.
pub fn srgb_decode(v: f64) -> f64 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_of_known_values() {
        assert_eq!(srgb_encode(0.0), 0.0);
        assert!((srgb_encode(1.0) - 1.0).abs() < 1e-12);
        assert!((srgb_encode(0.5) - 0.735_356_983_052_49).abs() < 1e-9);
        assert_eq!(srgb_encode(f64::NAN), 0.0);
    }

    #[test]
    fn srgb_decode_inverts_encode() {
        for i in 0..=1000 {
            let v = f64::from(i) / 1000.0;
            assert!((srgb_decode(srgb_encode(v)) - v).abs() < 1e-6);
        }
    }
}
