//! Pairs with too many bodies between for cells: what hemisphere rays of both elements found.

use super::{BATCHES, PairFactors, Shared};
use crate::color;
use crate::form_factor::ExchangeMatrix;
use crate::form_factor::table::mean_error;
use rayon::prelude::*;

/// What the rays of one element add.
struct Found {
    /// By other element: exchange area and its standard error [m^2].
    pairs: Vec<(u32, f64, f64)>,
    /// By object: exchange area [m^2] and its variance.
    objects: Vec<(u32, f64, f64)>,
}

impl PairFactors {
    /// Fills in the pairs `left[i]` of each element i with later ones.
    ///
    /// `N` rays of element i find `A_i F_ij` with a variance of `A_i^2 F_ij / N`, which is `A_i` times what both directions have
    /// in common: weights are the inverse of areas, so they do not depend on what the rays found, and
    /// `A_i F_ij = (F_ij + F_ji) / (1 / A_i + 1 / A_j)`. The two sets of rays are independent.
    pub(super) fn take_left(&mut self, shared: &Shared, left: &[Vec<u32>], matrix: &ExchangeMatrix) {
        let mut partners = left.to_vec();
        for (i, left) in left.iter().enumerate() {
            self.counts.hemisphere += left.len() as u64;
            left.iter().for_each(|j| partners[*j as usize].push(i as u32));
        }
        let cast = |e: usize| self.only.as_ref().is_none_or(|only| only[e]);
        let weight = |i: usize, j: usize| {
            let both = cast(i) && cast(j);
            1.0 / (1.0 / self.areas[i] + if both { 1.0 / self.areas[j] } else { 0.0 })
        };
        let find = |(i, partners): (usize, &Vec<u32>)| {
            let mut found = Found { pairs: Vec::new(), objects: Vec::new() };
            if partners.is_empty() || !cast(i) {
                return found;
            }
            let batches = matrix.batches();
            let mut all = vec![0.0; self.n * batches];
            for batch in 0..batches {
                for (j, f) in matrix.batch(i, batch) {
                    all[j * batches + batch] = batches as f64 * color::mean(f);
                }
            }
            let mut objects = vec![[0.0; BATCHES]; shared.objects];
            for j in partners {
                let (object, factors) =
                    (shared.elements[*j as usize].object, &all[*j as usize * batches..][..batches]);
                let weight = weight(i, *j as usize);
                let (mean, error) = mean_error(factors);
                if mean > 0.0 {
                    found.pairs.push((*j, weight * mean, weight * error));
                    objects[object as usize].iter_mut().zip(factors).for_each(|(s, f)| *s += weight * f);
                }
            }
            for (object, sums) in objects.iter().enumerate() {
                let (mean, error) = mean_error(&sums[..batches]);
                if mean > 0.0 {
                    found.objects.push((object as u32, mean, error * error));
                }
            }
            found
        };
        let found: Vec<Found> = partners.par_iter().enumerate().map(find).collect();
        for (i, found) in found.into_iter().enumerate() {
            for (j, mean, error) in found.pairs {
                if let Some(k) = self.index(i, j as usize) {
                    self.exchange[k] += mean;
                    self.error[k] = f64::from(self.error[k]).hypot(error) as f32;
                }
            }
            let a = shared.elements[i].object as usize;
            found
                .objects
                .iter()
                .for_each(|&(b, mean, variance)| self.add_objects((a, b as usize), mean, variance));
        }
    }
}
