//! The paper's estimator of a glossy lobe: a grid of cells about the mirror direction.

use crate::bsdf::{Specular, ggx};
use crate::color::Rgb;
use crate::sampling::concentric_disc;
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Share of the lobe that the frustum holds (Wallace, Cohen and Greenberg 1987, section 4.2).
const HELD: f64 = 0.99;

/// Directions (local frame) and weights of an n x n frustum, one jittered ray a cell, and of one ray for
/// what lies outside it; through glass, as many again for the transmitted lobe.
///
/// The square of cells is wrapped about the mirror direction, or the refracted one, by the facets that lead there: a
/// cell holds facets of equal share of the distribution of slopes. So cells follow the lobe's own shape, also
/// at grazing angles, where a pyramid of equal cells would spend most rays on almost nothing (GGX has
/// long tails). Weights are exact, not normalised: their expected sum is what the lobe scatters. `jitter(cell)` gives two
/// numbers in [0, 1) for each cell and, at n x n, for the rest.
pub(super) fn frustum(surface: &Specular, n: u32, jitter: impl Fn(u32) -> (f64, f64)) -> Vec<(DVec3, Rgb)> {
    let (_, wo) = surface.local();
    let alpha = surface.alpha();
    let mut rays = Vec::with_capacity((n * n) as usize + 1);
    if wo.z <= 0.0 {
        return rays;
    }
    let visible = ggx::masking(wo, alpha) / wo.z;
    for cell in 0..=n * n {
        let (j, k) = jitter(cell);
        // The share of D(h) cos(h) about the normal that facets of less slope have, and where the facet turns to.
        let (share, turn, part) = if cell < n * n {
            let u = (f64::from(cell % n) + j) / f64::from(n);
            let v = (f64::from(cell / n) + k) / f64::from(n);
            let disc = concentric_disc(u, v);
            let turn = disc.try_normalize().unwrap_or(DVec2::X);
            (HELD * disc.length_squared(), turn, HELD / f64::from(n * n))
        } else {
            (HELD + (1.0 - HELD) * j, DVec2::from_angle(TAU * k), 1.0 - HELD)
        };
        let slope = alpha * (share / (1.0 - share)).sqrt() * turn;
        let h = DVec3::new(slope.x, slope.y, 1.0).normalize();
        let cos = wo.dot(h);
        if cos <= 0.0 {
            continue;
        }
        let weight = visible * part * cos / h.z;
        let lobes = surface.of_facet(wo, h).into_iter().filter(|(_, albedo)| *albedo != Rgb::ZERO);
        rays.extend(lobes.map(|(wi, albedo)| (wi, weight * albedo)));
    }
    rays
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::color;
    use crate::sampling::sobol;
    use crate::scene::Material;

    /// The frustum and the rest make up the lobe, with any weighting over its directions: reflection
    /// and transmission, roughness 0.05 to 1, down to grazing angles. The moments are those of 65,536 visible normals
    /// (errors below 1e-3) and of 4,096 grids of 10 x 10; 0.4 % of the albedo is allowed.
    #[test]
    fn frustum_and_the_rest_are_the_lobe() {
        for roughness in [0.05, 0.2, 0.4, 0.7, 1.0] {
            for (transmission, thin) in [(0.0, false), (1.0, false), (1.0, true)] {
                let m = Material {
                    specular: Rgb::splat(1.0 - transmission),
                    specular_transmission: Rgb::splat(transmission),
                    thin,
                    roughness,
                    ..Material::new("m")
                };
                for cos in [1.0, 0.5, 0.1, 0.02] {
                    let wo = DVec3::new((1.0f64 - cos * cos).sqrt(), 0.0, cos);
                    let surface = Specular::new(&m, wo, DVec3::Z, DVec3::Z, true);
                    let (frame, _) = surface.local();
                    let moments = |wi: DVec3, w: Rgb| color::mean(w) * DVec3::new(1.0, wi.x, wi.z);
                    let whole: DVec3 = (0..65_536)
                        .filter_map(|k| {
                            let u = sobol(k, 0, 7);
                            surface.sample_glossy([u[0], u[1], u[2]])
                        })
                        .map(|s| moments(frame.to_local(s.direction), s.weight) / 65_536.0)
                        .sum();
                    let grids: DVec3 = (0..4096)
                        .flat_map(|k| {
                            frustum(&surface, 10, |c| {
                                let u = sobol(k, 0, c);
                                (u[0], u[1])
                            })
                        })
                        .map(|(wi, w)| moments(wi, w) / 4096.0)
                        .sum();
                    let off = (grids - whole).abs().max_element();
                    assert!(off < 4e-3, "roughness {roughness} {cos} {transmission}: {grids} {whole}");
                }
            }
        }
    }
}
