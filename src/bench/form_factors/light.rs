//! What errors of form factors do to light: the radiosity that they lead to.

use super::cases::Configuration;
use super::truth::Truth;
use crate::form_factor::Factors;

/// Change of the light in one bounce, as a share of the first, at which no more are followed.
const SETTLED: f64 = 1e-8;
/// Most bounces that are followed.
const MOST_BOUNCES: usize = 10_000;

/// A scene's emitters and reflectances, averaged over the channels, and the right answer.
pub(super) struct Light {
    /// Radiosity that each element emits [W m^-2].
    emission: Vec<f64>,
    reflectance: Vec<f64>,
    areas: Vec<f64>,
    /// Reflected radiosity of each element by the right factors [W m^-2].
    right: Vec<f64>,
}

impl Light {
    /// None where the scene has no emitters, or where not all of the right factors are known.
    pub fn new(configuration: &Configuration, truth: &Truth) -> Option<Light> {
        let (scene, mesh) = (&configuration.scene, &configuration.mesh);
        let elements = 0..mesh.len() as u32;
        let material = |e: u32| scene.material(&scene.faces[mesh.place(e).0 as usize]);
        let grey = |c: crate::color::Rgb| c.element_sum() / 3.0;
        let mut light = Light {
            emission: elements.clone().map(|e| grey(material(e).emission)).collect(),
            reflectance: elements.clone().map(|e| grey(material(e).diffuse)).collect(),
            areas: elements.map(|e| mesh.area(e)).collect(),
            right: Vec::new(),
        };
        if truth.rows().len() < mesh.len() || light.emission.iter().all(|e| *e == 0.0) {
            return None;
        }
        light.right = light.reflected(|i, from| {
            let (row, factors) = &truth.rows()[i];
            debug_assert_eq!(*row, i);
            factors.iter().zip(from).map(|(f, b)| f * b).sum()
        });
        Some(light)
    }

    /// Root mean square error over the surface of the reflected radiosity that these factors lead to, as a share of its own root
    /// mean square.
    pub fn error(&self, factors: &Factors) -> f64 {
        let found = self.reflected(|i, from| {
            let (columns, values, _) = factors.row(i);
            columns.iter().zip(values).map(|(j, f)| f * from[*j as usize]).sum()
        });
        let mean =
            |square: &dyn Fn(usize) -> f64| (0..found.len()).map(|i| self.areas[i] * square(i)).sum::<f64>();
        let off = mean(&|i| (found[i] - self.right[i]).powi(2));
        (off / mean(&|i| self.right[i].powi(2))).sqrt()
    }

    /// Reflected radiosity [W m^-2], bounce by bounce; `gather` gives the irradiance of an element from all radiosities.
    fn reflected(&self, gather: impl Fn(usize, &[f64]) -> f64) -> Vec<f64> {
        let n = self.emission.len();
        let (mut last, mut sum) = (self.emission.clone(), vec![0.0; n]);
        let size = |b: &[f64]| b.iter().zip(&self.areas).map(|(b, a)| a * b.abs()).sum::<f64>();
        let least = SETTLED * size(&last);
        for _ in 0..MOST_BOUNCES {
            let next: Vec<f64> = (0..n).map(|i| self.reflectance[i] * gather(i, &last)).collect();
            sum.iter_mut().zip(&next).for_each(|(s, b)| *s += b);
            last = next;
            if size(&last) <= least {
                break;
            }
        }
        sum
    }
}
