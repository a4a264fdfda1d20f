//! A second, coarse grid for the linear system of pass 1.
//!
//! Gathering, `K = F rho`, makes smooth irradiance of whatever radiosity there is: an equation of the second kind,
//! of which patches of many elements hold all but a small part. With R the mean over each patch and P its
//! value at all of a patch's elements, `M = 1 - P R K P R` is close to `A = 1 - K`, and
//!
//! ```text
//! M^-1 = 1 + P ((1 - R K P)^-1 - 1) R
//! ```
//!
//! takes a dense matrix of patches alone (Hackbusch, Multi-Grid Methods and Applications, 1985, chapter 16). Preconditioned
//! by it, a step gains what several do without.

use super::Transport;
use super::exchange::MANY;
use super::regions::runs;
use crate::color::Rgb;
use crate::form_factor::ExchangeMatrix;
use crate::mesh::{Mesh, NONE};
use crate::scene::Scene;
use rayon::prelude::*;

/// Most patches: their matrix is inverted.
const MOST_PATCHES: usize = 512;
/// Elements of a patch. Measured (Cornell box of 3,441 to 20,500 elements, gallery): solves take the least time with 100 to 200 and
/// a third more with 32.
const OF_A_PATCH: usize = 100;
/// Of fewer elements, how many times their number the cube of the number of patches may be: the steps that a grid saves take a time
/// in proportion to the elements, the inverse of its matrix one to that cube.
const MOST_WORK: usize = 512;

/// Patches and what they exchange.
pub(super) struct Coarse {
    /// Patch of each element.
    patch: Vec<u16>,
    /// Part of each element in its patch's mean.
    part: Vec<f32>,
    /// `(1 - R K P)^-1 - 1` by channel, row by row.
    bounced: [Vec<f64>; 3],
    /// Elements of all patches, those of a patch together, and where each patch's begin.
    members: Vec<u32>,
    first: Vec<usize>,
}

impl Coarse {
    /// Of the factors between a mesh's elements, and their [`patches`].
    pub fn new(
        mesh: &Mesh,
        matrix: &ExchangeMatrix,
        transport: &Transport,
        (patch, count): (Vec<u16>, usize),
    ) -> Coarse {
        let mut first = vec![0; count + 1];
        patch.iter().for_each(|p| first[usize::from(*p) + 1] += 1);
        (0..count).for_each(|p| first[p + 1] += first[p]);
        let mut members = vec![0; patch.len()];
        let mut next = first.clone();
        for (e, p) in patch.iter().enumerate() {
            members[next[usize::from(*p)]] = e as u32;
            next[usize::from(*p)] += 1;
        }
        let weight = |e: u32| mesh.area(e) * matrix.summary[e as usize].exposed;
        let mut part = vec![0.0; patch.len()];
        for of_patch in first.windows(2).map(|f| &members[f[0]..f[1]]) {
            let sum: f64 = of_patch.iter().map(|e| weight(*e)).sum();
            if sum > 0.0 {
                of_patch.iter().for_each(|e| part[*e as usize] = (weight(*e) / sum) as f32);
            }
        }
        let mut coarse = Coarse { patch, part, bounced: Default::default(), members, first };
        let mean = |values: &[Rgb]| coarse.means(values);
        let (reflected, passed) = (mean(&transport.reflectance), mean(&transport.transmittance));
        // A patch may be smaller than the elements of an adaptive mesh and have none, or few that let light through.
        let passes = |e: &&u32| transport.transmittance[**e as usize] != Rgb::ZERO;
        let behind: Vec<usize> = (0..count)
            .map(|p| match coarse.of_patch(p).iter().find(passes).map_or(NONE, |e| mesh.opposite(*e)) {
                NONE => p,
                e => usize::from(coarse.patch[e as usize]),
            })
            .collect();
        let gathered: Vec<Vec<Rgb>> =
            (0..count).into_par_iter().map(|p| coarse.gathered(matrix, p)).collect();
        let of_channel = |c: usize| {
            let mut system = vec![0.0; count * count];
            for (row, factors) in system.chunks_exact_mut(count).zip(&gathered) {
                for (q, f) in factors.iter().enumerate() {
                    row[q] -= f[c] * reflected[q][c];
                    row[behind[q]] -= f[c] * passed[q][c];
                }
            }
            (0..count).for_each(|p| system[p * (count + 1)] += 1.0);
            invert(&mut system, count);
            (0..count).for_each(|p| system[p * (count + 1)] -= 1.0);
            system
        };
        let mut bounced: Vec<Vec<f64>> = (0..3).into_par_iter().map(of_channel).collect();
        coarse.bounced = std::array::from_fn(|c| std::mem::take(&mut bounced[c]));
        coarse
    }

    fn of_patch(&self, p: usize) -> &[u32] {
        &self.members[self.first[p]..self.first[p + 1]]
    }

    /// Mean factors from a patch's elements to all patches, by one randomisation: that of many rows is enough.
    fn gathered(&self, matrix: &ExchangeMatrix, p: usize) -> Vec<Rgb> {
        let mut sums = vec![Rgb::ZERO; self.first.len() - 1];
        for e in self.of_patch(p) {
            let part = f64::from(self.part[*e as usize]) * matrix.batches() as f64;
            let row = matrix.at(*e as usize);
            row.batch(0).for_each(|(j, f)| sums[usize::from(self.patch[j])] += part * f);
        }
        sums
    }

    /// Mean over each patch.
    pub fn means(&self, values: &[Rgb]) -> Vec<Rgb> {
        let part = |e: &u32| f64::from(self.part[*e as usize]) * values[*e as usize];
        let mean = |p: usize| self.of_patch(p).iter().map(part).sum();
        (0..self.first.len() - 1).into_par_iter().map(mean).collect()
    }

    /// `M^-1 r`.
    pub fn precondition(&self, r: &[Rgb]) -> Vec<Rgb> {
        let means = self.means(r);
        let n = means.len();
        let bounced = |p: usize| {
            let of_channel = |c: usize| {
                let row = &self.bounced[c][p * n..(p + 1) * n];
                row.iter().zip(&means).map(|(b, m)| b * m[c]).sum()
            };
            Rgb::new(of_channel(0), of_channel(1), of_channel(2))
        };
        let bounced: Vec<Rgb> = (0..n).into_par_iter().map(bounced).collect();
        let both = r.par_iter().zip(&self.patch).with_min_len(MANY);
        both.map(|(r, p)| *r + bounced[usize::from(*p)]).collect()
    }
}

/// The patch of each element, and how many there are: equal parts of sides of faces, or elements of one of the regions
/// ([`super::regions`]) where sides are many.
pub(super) fn patches(scene: &Scene, mesh: &Mesh, regions: impl FnOnce() -> Vec<u32>) -> (Vec<u16>, usize) {
    let (n, sides) = (mesh.len(), mesh.sides().count());
    let enough = n / OF_A_PATCH;
    let most = (((MOST_WORK * n) as f64).cbrt() as usize).max(enough).min(MOST_PATCHES);
    if 2 * sides > most {
        return runs(&regions(), most);
    }
    let most = enough.max(2 * sides).min(most);
    let area: f64 = (0..n as u32).map(|e| mesh.area(e)).sum();
    let mut size = (area / most as f64).sqrt();
    loop {
        // At the latest when each side is a patch of its own, these are few enough.
        match Mesh::patches(scene, &mesh.sides(), size) {
            Ok(coarse) if coarse.len() <= most => {
                let patch = |e: u32| {
                    let (face, front, cell) = mesh.place(e);
                    let uv = mesh.grid(face).centroid(cell);
                    coarse.element(face, front, uv.x as f32, uv.y as f32) as u16
                };
                return ((0..n as u32).into_par_iter().map(patch).collect(), coarse.len());
            }
            _ => size *= 1.1,
        }
    }
}

/// Inverts a matrix of `n` rows in place by Gauss and Jordan, without pivoting: for diagonally dominant ones.
fn invert(a: &mut [f64], n: usize) {
    for k in 0..n {
        let pivot = 1.0 / a[k * n + k];
        a[k * n + k] = 1.0;
        a[k * n..(k + 1) * n].iter_mut().for_each(|v| *v *= pivot);
        let row = a[k * n..(k + 1) * n].to_vec();
        for (_, other) in a.chunks_exact_mut(n).enumerate().filter(|(i, _)| *i != k) {
            let factor = std::mem::take(&mut other[k]);
            other.iter_mut().zip(&row).for_each(|(v, r)| *v -= factor * r);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inverse_undoes_its_matrix() {
        let n = 7;
        let a: Vec<f64> =
            (0..n * n).map(|k| if k % (n + 1) == 0 { 1.0 } else { -((k * 37 % 11) as f64) / 80.0 }).collect();
        let mut inverse = a.clone();
        invert(&mut inverse, n);
        for (i, j) in (0..n * n).map(|k| (k / n, k % n)) {
            let dot: f64 = (0..n).map(|k| a[i * n + k] * inverse[k * n + j]).sum();
            assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-13, "{i} {j} {dot}");
        }
    }
}
