//! Where the power of a solved scene went.

use super::Transport;
use super::uncertainty::Replicas;
use crate::color::Rgb;
use crate::emitters::Emitters;
use crate::form_factor::Rows;
use crate::mesh::Mesh;
use crate::scene::Scene;
use serde::Serialize;
use std::f64::consts::PI;

/// Power balance of a solution \[W\], by channel.
///
/// Emitted power either is absorbed by surfaces or escapes. The escaped and the specularly absorbed
/// parts are counted from the sending elements, the diffusely absorbed part at the receiving ones,
/// so `residual` measures how well the factors keep reciprocity.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Ledger {
    /// Leaving emitters.
    pub emitted: Rgb,
    /// Arriving from outside, but for what specular surfaces send out again.
    pub environment: Rgb,
    /// Taken by diffuse surfaces.
    pub absorbed: Rgb,
    /// Taken by specular and black surfaces.
    pub absorbed_specular: Rgb,
    /// Leaving the scene.
    pub escaped: Rgb,
    /// Dropped with specular chains that were cut.
    pub dropped: Rgb,
    /// (emitted + environment - absorbed - escaped - dropped) / (emitted + environment).
    pub residual: Rgb,
    /// Standard error of `residual`; NaN with a single randomisation.
    pub residual_error: Rgb,
}

impl Ledger {
    /// Number of its quantities.
    pub(super) const ROWS: usize = 8;

    /// Its quantities in the order in which they are declared.
    pub(super) fn rows(&self) -> [Rgb; Ledger::ROWS] {
        [
            self.emitted,
            self.environment,
            self.absorbed,
            self.absorbed_specular,
            self.escaped,
            self.dropped,
            self.residual,
            self.residual_error,
        ]
    }

    /// The ledger of these quantities, [`Ledger::ROWS`] of them.
    pub(super) fn of_rows(rows: &[Rgb]) -> Ledger {
        Ledger {
            emitted: rows[0],
            environment: rows[1],
            absorbed: rows[2],
            absorbed_specular: rows[3],
            escaped: rows[4],
            dropped: rows[5],
            residual: rows[6],
            residual_error: rows[7],
        }
    }

    #[allow(clippy::too_many_arguments)] // a solution's parts, before they are one
    pub(super) fn new(
        scene: &Scene,
        mesh: &Mesh,
        rows: Rows,
        emitters: &Emitters,
        transport: &Transport,
        emitted: &[Rgb],
        reflected: &[Rgb],
        irradiance: &[Rgb],
        replicas: &Replicas,
    ) -> Ledger {
        let mut sum = Ledger {
            emitted: emitters.power(scene),
            environment: Rgb::ZERO,
            absorbed: Rgb::ZERO,
            absorbed_specular: Rgb::ZERO,
            escaped: Rgb::ZERO,
            dropped: Rgb::ZERO,
            residual: Rgb::ZERO,
            residual_error: Rgb::ZERO,
        };
        // Share of the irradiance of each element that ends in the sums below.
        let mut taken = vec![Rgb::ZERO; mesh.len()];
        let mut left = vec![Rgb::ZERO; mesh.len()];
        let mut kept = vec![Rgb::ONE; mesh.len()];
        // A diffuse surface of glass passes radiance over index squared on to its other side as it is, not power.
        let open: Vec<f64> = rows.summary().iter().map(|s| s.exposed * s.index2).collect();
        for e in 0..mesh.len() {
            let s = &rows.summary()[e];
            // Radiance is carried over index squared.
            let area = mesh.area(e as u32) * s.exposed * s.index2;
            let material = scene.material(&scene.faces[mesh.place(e as u32).0 as usize]);
            if material.is_specular() {
                kept[e] -= crate::form_factor::pass_on(material);
            }
            let lost = kept[e] - transport.given_back(e, &open);
            sum.absorbed += area * irradiance[e] * lost;
            taken[e] = area * (lost + material.diffuse * (s.absorbed + s.escaped + s.dropped));
            let leaving = area * (emitted[e] + reflected[e]);
            left[e] = leaving;
            sum.absorbed_specular += leaving * s.absorbed;
            sum.escaped += leaving * s.escaped;
            sum.dropped += leaving * s.dropped;
            // What a surface passes on specularly is counted where it ends.
            sum.environment += area * kept[e] * s.escaped * scene.environment * PI;
        }
        let input = sum.emitted + sum.environment;
        let output = sum.absorbed + sum.absorbed_specular + sum.escaped + sum.dropped;
        let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
        let difference = input - output;
        sum.residual = Rgb::new(
            ratio(difference.x, input.x),
            ratio(difference.y, input.y),
            ratio(difference.z, input.z),
        );
        // Two sources of noise: the irradiances', and that of the shares of each row that no element takes, which are 1 less
        // what elements take.
        let error = replicas.of(|h| h.iter().zip(&taken).map(|(h, t)| *h * *t).sum());
        let shares: Rgb = rows
            .map(|e, row| {
                let samples: Vec<Rgb> = (0..row.batches()).map(|b| row.dot_batch(b, &kept)).collect();
                left[e] * left[e] * mean_variance(&samples)
            })
            .into_iter()
            .sum();
        let error = (error * error + shares).map(f64::sqrt);
        sum.residual_error =
            Rgb::new(ratio(error.x, input.x), ratio(error.y, input.y), ratio(error.z, input.z));
        sum
    }
}

/// Variance of the mean of independent samples; NaN for a single one.
fn mean_variance(samples: &[Rgb]) -> Rgb {
    let n = samples.len() as f64;
    let mean = samples.iter().copied().sum::<Rgb>() / n;
    let squares: Rgb = samples.iter().map(|s| (*s - mean) * (*s - mean)).sum();
    squares / (n * (n - 1.0))
}
