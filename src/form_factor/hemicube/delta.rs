//! Delta form factors: what each pixel of a hemi-cube sees of the hemisphere, cosine-weighted.

use std::f64::consts::TAU;

/// Exact delta form factors of the pixels of a hemi-cube with half-width and height 1, as running sums along
/// the rows: a span of pixels costs one subtraction.
///
/// A pixel at (x, y) of the top has the density `1 / (pi (1 + x^2 + y^2)^2)` and one at (y, z) of a side
/// `z / (pi (1 + y^2 + z^2)^2)` (Cohen and Greenberg 1985, section 3). They multiply that density at the pixel's
/// centre by its area; here it is integrated over the pixel in closed form, so that all pixels sum to 1 at
/// any resolution.
#[derive(Debug, Clone)]
pub struct DeltaFactors {
    resolution: usize,
    top: Vec<f64>,
    side: Vec<f64>,
}

impl DeltaFactors {
    /// The pixels of a hemi-cube with `resolution` pixels along each edge of its top, 1 or more.
    pub fn new(resolution: usize) -> DeltaFactors {
        let n = resolution.max(1);
        let edge = |k: usize| 2.0 * k as f64 / n as f64 - 1.0;
        let running = |row: &dyn Fn(f64) -> f64| -> Vec<f64> {
            // From the middle outwards would cancel less, but the error is far below that of the pixels.
            (0..=n).map(|i| row(edge(i)) - row(-1.0)).collect()
        };
        let top = |j: usize| running(&|x| corner(x, edge(j + 1)) - corner(x, edge(j)));
        let m = side_rows(n);
        let height = |k: usize| k as f64 / m as f64;
        let side = |j: usize| running(&|y| lean(y, height(j)) - lean(y, height(j + 1)));
        DeltaFactors {
            resolution: n,
            top: (0..n).flat_map(top).collect(),
            side: (0..m).flat_map(side).collect(),
        }
    }

    /// Pixels along each edge of the top.
    pub fn resolution(&self) -> usize {
        self.resolution
    }

    /// Delta form factor of pixels `from..to` of a row; `side` 0 is the top. Rows of a side count upwards.
    #[inline]
    pub fn span(&self, side: usize, row: usize, from: usize, to: usize) -> f64 {
        let sums = if side == 0 { &self.top } else { &self.side };
        let start = row * (self.resolution + 1);
        sums[start + to] - sums[start + from]
    }
}

/// Rows of pixels on each side: half as many as on the top, rounded up.
pub(super) fn side_rows(resolution: usize) -> usize {
    resolution.div_ceil(2)
}

/// Form factor from the centre to the part of the top between (0, 0) and (x, y), odd in both (Howell B-3
/// with the height as unit).
fn corner(x: f64, y: f64) -> f64 {
    let (p, q) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
    (x / p * (y / p).atan() + y / q * (x / q).atan()) / TAU
}

/// Form factor to the part of a side above height z and between 0 and y, odd in y (Howell B-4).
fn lean(y: f64, z: f64) -> f64 {
    let r = (1.0 + z * z).sqrt();
    (y / r).atan() / r / TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_pixels_sum_to_one_at_any_resolution() {
        for n in [1, 2, 3, 7, 64, 255, 256, 1000] {
            let delta = DeltaFactors::new(n);
            let top: f64 = (0..n).map(|j| delta.span(0, j, 0, n)).sum();
            let side: f64 = (0..side_rows(n)).map(|j| delta.span(1, j, 0, n)).sum();
            assert!((top + 4.0 * side - 1.0).abs() < 1e-13, "{n}: {}", top + 4.0 * side - 1.0);
            // The top of a cube of edge 2 and height 1 takes this share (Howell C-11's point form).
            assert!((top - 4.0 * corner(1.0, 1.0)).abs() < 1e-13);
        }
    }

    /// Every pixel against Simpson's rule on a fine grid within it.
    #[test]
    fn each_pixel_is_the_integral_of_the_kernel() {
        let (n, k) = (8usize, 64);
        let simpson = |i: usize| if i == 0 || i == k { 1.0 } else { 2.0 + 2.0 * (i % 2) as f64 };
        let integral = |f: &dyn Fn(f64, f64) -> f64, (x, y): (f64, f64), (w, h): (f64, f64)| -> f64 {
            let mut sum = 0.0;
            for i in 0..=k {
                for j in 0..=k {
                    let (s, t) = (i as f64 / k as f64, j as f64 / k as f64);
                    sum += simpson(i) * simpson(j) * f(x + s * w, y + t * h);
                }
            }
            sum * w * h / (9 * k * k) as f64
        };
        let delta = DeltaFactors::new(n);
        let pi = std::f64::consts::PI;
        let step = 2.0 / n as f64;
        for j in 0..n {
            for i in 0..n {
                let at = (i as f64 * step - 1.0, j as f64 * step - 1.0);
                let top = integral(&|x, y| 1.0 / (pi * (1.0 + x * x + y * y).powi(2)), at, (step, step));
                assert!((delta.span(0, j, i, i + 1) / top - 1.0).abs() < 1e-7);
                if j < n / 2 {
                    let at = (at.0, j as f64 * step);
                    let side = integral(&|y, z| z / (pi * (1.0 + y * y + z * z).powi(2)), at, (step, step));
                    assert!((delta.span(1, j, i, i + 1) / side - 1.0).abs() < 1e-7);
                }
            }
        }
    }
}
