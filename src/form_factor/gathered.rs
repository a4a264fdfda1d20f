//! Light of emitters that the rows' rays find on their way.

use super::ProjectionMap;
use crate::color::Rgb;
use crate::emitters::{Passage, mis_share};
use rayon::prelude::*;

/// Samples of the emitters that share their light with the hemisphere rays.
#[derive(Debug, Clone, Copy)]
pub struct EmitterWork<'a> {
    /// Samples of the emitters' area, an element.
    pub samples: u32,
    /// Particles from the emitters in all, for specular chains.
    pub particles: u32,
    /// Where they are sent; none: in proportion to the emitted light.
    pub projection: Option<&'a ProjectionMap>,
}

impl EmitterWork<'_> {
    /// Share of a chain's light that the particles account for, beside `rays` hemisphere rays of an element of `area` [m^2]. The particles
    /// have `density` per area of the emitters [m^-2], and `aimed` times the density of emitted light over directions.
    pub fn particle_share(&self, (density, aimed): (f64, f64), rays: u32, area: f64) -> f64 {
        mis_share(f64::from(self.particles), density * aimed, f64::from(rays), 1.0 / area)
    }
}

/// Irradiance from emitters that hemisphere rays found, by passage [W m^-2], over the whole
/// element, covered parts included.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EmitterIrradiance {
    /// In a straight line.
    pub straight: Rgb,
    /// By one flat mirror.
    pub image: Rgb,
    /// By other chains.
    pub chain: Rgb,
}

impl EmitterIrradiance {
    /// Adds irradiance that came by `passage`.
    pub fn add(&mut self, passage: Passage, irradiance: Rgb) {
        match passage {
            Passage::Straight => self.straight += irradiance,
            Passage::Image => self.image += irradiance,
            Passage::Chain => self.chain += irradiance,
        }
    }
}

impl std::ops::Mul<Rgb> for EmitterIrradiance {
    type Output = EmitterIrradiance;

    fn mul(self, f: Rgb) -> EmitterIrradiance {
        EmitterIrradiance { straight: self.straight * f, image: self.image * f, chain: self.chain * f }
    }
}

impl std::ops::AddAssign for EmitterIrradiance {
    fn add_assign(&mut self, other: EmitterIrradiance) {
        self.straight += other.straight;
        self.image += other.image;
        self.chain += other.chain;
    }
}

/// Irradiance from emitters by element, over the whole element, covered parts included.
#[derive(Debug, Clone)]
pub struct EmitterRows {
    pub(super) batches: usize,
    /// Mean over the randomisations, by element.
    pub mean: Vec<EmitterIrradiance>,
    /// The sum over all passages, by (element, randomisation) [W m^-2].
    pub(super) total: Vec<[f32; 3]>,
}

impl EmitterRows {
    /// No light on `n` elements.
    pub fn dark(n: usize, batches: usize) -> EmitterRows {
        EmitterRows {
            batches,
            mean: vec![EmitterIrradiance::default(); n],
            total: vec![[0.0; 3]; n * batches],
        }
    }

    pub(super) fn append(&mut self, other: &EmitterRows) {
        self.mean.extend_from_slice(&other.mean);
        self.total.extend_from_slice(&other.total);
    }

    /// The sum over all passages in one randomisation [W m^-2].
    pub fn total(&self, element: usize, batch: usize) -> Rgb {
        Rgb::from(self.total[element * self.batches + batch].map(f64::from))
    }

    /// Adds what `find` tells of each element, one value a randomisation, on all cores.
    pub fn add<T: IntoIterator<Item = EmitterIrradiance>>(&mut self, find: impl Fn(u32) -> T + Sync) {
        let rows = self.mean.par_iter_mut().zip(self.total.par_chunks_exact_mut(self.batches));
        rows.enumerate().with_min_len(16).for_each(|(element, (mean, totals))| {
            for (total, found) in totals.iter_mut().zip(find(element as u32)) {
                add_batch(mean, total, found, self.batches);
            }
        });
    }
}

pub(super) fn add_batch(
    mean: &mut EmitterIrradiance,
    total: &mut [f32; 3],
    found: EmitterIrradiance,
    batches: usize,
) {
    *mean += found * Rgb::splat(1.0 / batches as f64);
    let sum = found.straight + found.image + found.chain;
    total.iter_mut().zip(sum.to_array()).for_each(|(t, s)| *t += s as f32);
}
