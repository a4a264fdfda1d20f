//! What the light of each element is worth to all surfaces and to the pictures of the scene's cameras.
//!
//! Elements show their light and send it on. Of a mean of the light shown, with weights w_i, the radiosity sent by an element j makes
//! up as much as the irradiance that j would have, did every i emit `rho_i w_i`: importance is transported as light is (Smits, Arvo
//! and Salesin 1992, "An importance-driven radiosity algorithm").

use super::{Solution, System};
use crate::Result;
use crate::color::{self, Rgb};
use crate::mesh::NONE;
use crate::scene::Scene;

/// Largest error of the importance over the largest importance.
const TOLERANCE: f64 = 1e-6;

/// What the light of all surfaces counts where there are pictures, which count 1. Their light makes pictures right too: in
/// `scenes/corridor`, 2,700 elements show 2.4 % of error, not 3.1 %, without their noise.
const SURFACES: f64 = 0.1;

/// Where rays of one camera meet diffuse surfaces: face, front side and (u, v) there.
pub type View = Vec<(u32, bool, [f32; 2])>;

/// What the light of each element is worth: that of all pictures counts as 1, and the scene's reflected light as a tenth, or as 1
/// without pictures.
#[derive(Debug, Clone)]
pub struct Importance {
    /// Open areas \[m^2\].
    pub area: Vec<f64>,
    /// What the square of an error of its shown light makes of the relative squared error of all light and of the pictures
    /// \[W^-2 m^4\].
    pub shown: Vec<f64>,
    /// What power sent from it brings to the light of all surfaces and pictures, in relation to that light \[W^-1\].
    pub sent: Vec<Rgb>,
}

impl Importance {
    /// Of a solution of `system`; `views` is what cameras see.
    ///
    /// # Errors
    /// The adjoint system has no solution.
    pub fn new(scene: &Scene, solution: &Solution, system: &System, views: &[View]) -> Result<Importance> {
        let mesh = &solution.mesh;
        let n = mesh.len();
        let System { open, transport, exchange, .. } = system;
        let area: Vec<f64> = (0..n).map(|e| open[e] * mesh.area(e as u32)).collect();
        let light: Vec<f64> = (0..n).map(|e| color::mean(solution.reflected_radiosity(e))).collect();
        let (mut shown, mut interest) = (vec![0.0; n], vec![0.0; n]);
        let mut add = |weight: &[f64], share: f64| {
            let (mut mean, mut square) = (0.0, 0.0);
            for (w, b) in weight.iter().zip(&light) {
                (mean, square) = (mean + w * b, square + w * b * b);
            }
            if mean > 0.0 && square > 0.0 {
                for e in (0..n).filter(|e| area[*e] > 0.0) {
                    shown[e] += share * weight[e] / square;
                    interest[e] += share * weight[e] / (mean * area[e]);
                }
            }
        };
        add(&area, if views.is_empty() { 1.0 } else { SURFACES });
        for view in views {
            let mut rays = vec![0.0; n];
            for (face, front, [u, v]) in view {
                if mesh.first(*face, *front) != NONE {
                    rays[mesh.element(*face, *front, *u, *v) as usize] += 1.0;
                }
            }
            add(&rays, 1.0 / views.len() as f64);
        }
        // What is shown is irradiance reflected or let through.
        let interest: Vec<Rgb> = interest.into_iter().map(Rgb::splat).collect();
        let source = exchange.gather(&transport.reflect(&interest));
        let (sent, _) = system.solve(&system.acceleration(scene, mesh), &source, TOLERANCE)?;
        Ok(Importance { area, shown, sent })
    }
}
