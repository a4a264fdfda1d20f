//! The paper's estimator of a glossy lobe: a grid of cells about the mirror direction.

use crate::bsdf;
use crate::geometry::{Frame, reflect};
use crate::sampling::{self, concentric_disc};
use glam::{DVec2, DVec3};
use std::f64::consts::PI;
use std::sync::OnceLock;

/// Share of the lobe that the frustum holds (Wallace, Cohen and Greenberg 1987, section 4.2).
const HELD: f64 = 0.99;

/// Directions (local frame) and weights of an n x n frustum seen from `wo`: one jittered ray a cell.
///
/// The square of cells is wrapped about the mirror direction so that the cells' solid angles follow the lobe of
/// normal incidence: GGX has long tails, and a pyramid of equal cells that holds 99 % of it would
/// spend most rays on almost nothing. Weights are lobe times cosine times solid angle, not yet
/// normalised; zero below the horizon. `jitter(cell)` gives two numbers in [0, 1).
pub(super) fn frustum(
    wo: DVec3,
    alpha: f64,
    n: u32,
    jitter: impl Fn(u32) -> (f64, f64),
) -> Vec<(DVec3, f64)> {
    let axis = Frame::new(reflect(wo, DVec3::Z));
    (0..n * n)
        .map(|cell| {
            let (j, k) = jitter(cell);
            let u = (f64::from(cell % n) + j) / f64::from(n);
            let v = (f64::from(cell / n) + k) / f64::from(n);
            let disc = concentric_disc(u, v);
            // Radius squared is the share of the lobe inside; tan^2 of the half angle follows from
            // GGX's distribution of slopes.
            let share = HELD * disc.length_squared();
            let tan2 = alpha * alpha * share / (1.0 - share);
            let cos_half2 = 1.0 / (1.0 + tan2);
            let cos = 2.0 * cos_half2 - 1.0;
            let sin = (1.0 - cos * cos).max(0.0).sqrt();
            let turn = disc.try_normalize().unwrap_or(DVec2::X);
            let wi = axis.to_scene(DVec3::new(sin * turn.x, sin * turn.y, cos));
            if wi.z <= 0.0 {
                return (wi, 0.0);
            }
            // d(cos)/d(share), over the share's density 1 on the unit disc of area pi.
            let t = alpha * alpha;
            let slope = 2.0 * cos_half2 * cos_half2 * t / ((1.0 - share) * (1.0 - share));
            let solid_angle = 2.0 * PI * HELD * slope / f64::from(n * n);
            (wi, bsdf::ggx_reflect(wo, wi, alpha) * solid_angle)
        })
        .collect()
}

const TABLE: usize = 33;

/// Directional albedo of the GGX lobe for a specular albedo of 1: what single scattering keeps.
///
/// Interpolated from a table over the cosine and the roughness, made once from 1,024 points an entry.
pub(super) fn albedo(cos: f64, alpha: f64) -> f64 {
    static ALBEDO: OnceLock<Vec<f64>> = OnceLock::new();
    let table = ALBEDO.get_or_init(|| {
        (0..TABLE * TABLE)
            .map(|k| {
                let cos = ((k % TABLE) as f64 / (TABLE - 1) as f64).max(1e-3);
                let alpha = ((k / TABLE) as f64 / (TABLE - 1) as f64).powi(2).max(1e-4);
                let wo = DVec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
                let sum: f64 = (0..1024)
                    .map(|i| {
                        let u = sampling::sobol(i, 0, 1);
                        bsdf::sample_ggx(wo, alpha, u[0], u[1]).map_or(0.0, |s| s.1)
                    })
                    .sum();
                sum / 1024.0
            })
            .collect()
    });
    let x = cos.clamp(0.0, 1.0) * (TABLE - 1) as f64;
    let y = alpha.clamp(0.0, 1.0).sqrt() * (TABLE - 1) as f64;
    let (i, j) = ((x as usize).min(TABLE - 2), (y as usize).min(TABLE - 2));
    let (s, t) = (x - i as f64, y - j as f64);
    let at = |i: usize, j: usize| table[j * TABLE + i];
    (at(i, j) * (1.0 - s) + at(i + 1, j) * s) * (1.0 - t)
        + (at(i, j + 1) * (1.0 - s) + at(i + 1, j + 1) * s) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The frustum's weights add up to the lobe's albedo, less the 1 % left out of it.
    #[test]
    fn frustum_weights_integrate_the_lobe() {
        for alpha in [0.01, 0.1, 0.3, 0.6] {
            for cos in [1.0, 0.7, 0.4] {
                let wo = DVec3::new((1.0f64 - cos * cos).sqrt(), 0.0, cos);
                let sum: f64 = frustum(wo, alpha, 200, |c| {
                    let u = sampling::sobol(c % 65_536, 0, c / 65_536);
                    (u[0], u[1])
                })
                .iter()
                .map(|c| c.1)
                .sum();
                let expected = albedo(cos, alpha);
                assert!(
                    sum < expected + 0.01 && sum > 0.93 * expected,
                    "alpha {alpha} cos {cos}: {sum} {expected}"
                );
            }
        }
    }

    #[test]
    fn albedo_of_a_mirror_is_one() {
        assert!((albedo(0.8, 0.0) - 1.0).abs() < 1e-3);
        assert!(albedo(0.3, 1.0) < 1.0);
    }
}
