//! The paper's estimator of a glossy lobe: a grid of cells about the mirror direction.

use crate::bsdf::{Scatter, Specular, ggx};
use crate::color::Rgb;
use crate::sampling::concentric_disc;
use glam::{DVec2, DVec3};

/// Share of the lobe that the frustum holds (Wallace, Cohen and Greenberg 1987, section 4.2).
const HELD: f64 = 0.99;

/// Directions (local frame) and weights of an n x n frustum: one jittered ray a cell, for the reflected
/// lobe and, through glass, as many for the transmitted one.
///
/// The square of cells is wrapped about the mirror direction, or the refracted one, by the facets that lead there: a
/// cell holds facets of equal share of the distribution of slopes. So cells follow the lobe's own shape, also
/// at grazing angles, where a pyramid of equal cells would spend most rays on almost nothing (GGX has
/// long tails). Weights are exact, not normalised: their expected sum is what the lobe scatters within the
/// frustum. `jitter(cell)` gives two numbers in [0, 1).
pub(super) fn frustum(surface: &Specular, n: u32, jitter: impl Fn(u32) -> (f64, f64)) -> Vec<(DVec3, Rgb)> {
    let (_, wo) = surface.local();
    let alpha = surface.alpha();
    let mut cells = Vec::with_capacity((n * n) as usize);
    if wo.z <= 0.0 {
        return cells;
    }
    let visible = ggx::masking(wo, alpha) * HELD / (wo.z * f64::from(n * n));
    for cell in 0..n * n {
        let (j, k) = jitter(cell);
        let u = (f64::from(cell % n) + j) / f64::from(n);
        let v = (f64::from(cell / n) + k) / f64::from(n);
        let disc = concentric_disc(u, v);
        // Radius squared is the share of D(h) cos(h) inside; tan^2 of the facet's slope follows.
        let share = HELD * disc.length_squared();
        let slope = alpha * (share / (1.0 - share)).sqrt();
        let turn = slope * disc.try_normalize().unwrap_or(DVec2::X);
        let h = DVec3::new(turn.x, turn.y, 1.0).normalize();
        let cos = wo.dot(h);
        if cos <= 0.0 {
            continue;
        }
        let weight = visible * cos / h.z;
        let lobes = surface.of_facet(wo, h).into_iter().filter(|(_, albedo)| *albedo != Rgb::ZERO);
        cells.extend(lobes.map(|(wi, albedo)| (wi, weight * albedo)));
    }
    cells
}

/// Whether a sample of the lobe lies outside the frustum.
pub(super) fn beyond(surface: &Specular, s: &Scatter) -> bool {
    let (frame, wo) = surface.local();
    surface.facet_normal(wo, frame.to_local(s.direction)).is_some_and(|h| {
        let tan2 = (h.x * h.x + h.y * h.y) / (h.z * h.z);
        let alpha = surface.alpha();
        tan2 > (alpha * alpha + tan2) * HELD
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::color;
    use crate::sampling::sobol;
    use crate::scene::Material;

    /// The frustum and the rest make up the lobe, with any weighting over its directions: reflection
    /// and transmission, roughness 0.05 to 1, down to grazing angles. The moments are those of 65,536 visible normals
    /// (errors below 1e-3) and of a grid of 200 x 200 with as many rays for the rest; 0.4 % of the albedo is allowed.
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
                    let (mut whole, mut rest) = (DVec3::ZERO, DVec3::ZERO);
                    for k in 0..65_536 {
                        let u = sobol(k, 0, 7);
                        let Some(s) = surface.sample_glossy([u[0], u[1], u[2]]) else { continue };
                        let m = moments(frame.to_local(s.direction), s.weight) / 65_536.0;
                        whole += m;
                        rest += m * f64::from(u8::from(beyond(&surface, &s)));
                    }
                    let held: DVec3 = frustum(&surface, 200, |c| {
                        let u = sobol(c, 0, 3);
                        (u[0], u[1])
                    })
                    .iter()
                    .map(|(wi, w)| moments(*wi, *w))
                    .sum();
                    let off = (held + rest - whole).abs().max_element();
                    assert!(off < 4e-3, "roughness {roughness} {cos} {transmission}: {held} {rest} {whole}");
                }
            }
        }
    }
}
