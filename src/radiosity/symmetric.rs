//! The linear system of pass 1 where the exchange is reciprocal, by conjugate gradients.
//!
//! `A = 1 - F rho` is self-adjoint and positive in the inner product with weights `a_i rho_i` (a the open area): that of
//! the symmetric system `a rho - rho S rho`, in terms of irradiances. Conjugate gradients in that product take steps in
//! proportion to the square root of the condition number, one multiplication each.
//!
//! What is slow is the mean light of rooms that exchange little with each other. A coarse space holds it: groups
//! of elements (sides of faces, or runs of them) with one unknown each. The preconditioner `1 + Z E^-1 Z^T W` solves for these exactly
//! (an additive coarse correction; Toselli and Widlund 2005, section 2.5), after which the number of steps hardly
//! depends on the albedo or on how small an opening is.

use super::Transport;
use super::exchange::{Exchange, MANY};
use super::regions::runs;
use super::solve::{combine, ratio, subtract};
use crate::color::Rgb;
use rayon::prelude::*;

/// Most groups of elements: their matrix is factorised.
const MOST_GROUPS: usize = 192;
/// Pivots below this share of their diagonal are rounding.
const LEAST_PIVOT: f64 = 1e-13;

/// A reciprocal exchange, ready to be solved.
pub(super) struct Symmetric<'a, 'm> {
    exchange: &'a Exchange<'m>,
    transport: &'a Transport,
    /// Weights of the inner product, `a_i rho_i` [m^2].
    weight: Vec<Rgb>,
    pub groups: Groups,
    /// Cholesky factor of the groups' matrix, by channel.
    coarse: [Cholesky; 3],
}

impl<'a, 'm> Symmetric<'a, 'm> {
    /// Prepares the groups ([`Groups::new`]). None where the exchange is not reciprocal.
    pub fn new(
        exchange: &'a Exchange<'m>,
        transport: &'a Transport,
        side: &[u32],
        regions: impl FnOnce() -> Vec<u32>,
    ) -> Option<Symmetric<'a, 'm>> {
        let balance = exchange.balance()?;
        let rho = &transport.reflectance;
        let weight: Vec<Rgb> = rho.iter().zip(&balance.open).map(|(r, a)| *r * *a).collect();
        let groups = Groups::new(side, regions);
        let mut matrix = balance.by_groups(&groups.of, groups.count, rho);
        for (i, g) in groups.of.iter().enumerate() {
            matrix[usize::from(*g) * (groups.count + 1)] +=
                weight[i] * (Rgb::ONE - rho[i] * balance.target[i]);
        }
        let coarse = [0, 1, 2].map(|c| Cholesky::new(matrix.iter().map(|m| m[c]).collect(), groups.count));
        Some(Symmetric { exchange, transport, weight, groups, coarse })
    }

    /// `A x`.
    fn apply(&self, x: &[Rgb]) -> Vec<Rgb> {
        subtract(x, &self.exchange.gather(&self.transport.reflect(x)))
    }

    /// Improves `x` until `done(x, r)` or for `most` multiplications; returns these and their number. Of residuals, those of black
    /// elements mean nothing: one bounce more settles them.
    pub fn solve(
        &self,
        b: &[Rgb],
        mut x: Vec<Rgb>,
        done: impl Fn(&[Rgb], &[Rgb]) -> bool,
        most: usize,
    ) -> (Vec<Rgb>, usize) {
        let mut r = self.without_black(subtract(b, &self.apply(&x)));
        let (mut count, mut p, mut last) = (1, Vec::new(), Rgb::ZERO);
        while count < most && !done(&x, &r) {
            let z = self.precondition(&r);
            let next = self.dot(&r, &z);
            p = if p.is_empty() { z } else { combine(&z, ratio(next, last), &p) };
            let q = self.without_black(self.apply(&p));
            let alpha = ratio(next, self.dot(&p, &q));
            if alpha == Rgb::ZERO {
                break;
            }
            x = combine(&x, alpha, &p);
            r = combine(&r, -alpha, &q);
            last = next;
            count += 1;
        }
        (x, count)
    }

    /// The norm that belongs to the inner product.
    pub fn norm(&self, r: &[Rgb]) -> Rgb {
        self.dot(r, r).map(f64::sqrt)
    }

    fn without_black(&self, mut r: Vec<Rgb>) -> Vec<Rgb> {
        r.par_iter_mut().zip(&self.weight).with_min_len(MANY).for_each(|(r, w)| {
            *r = Rgb::select(w.cmpgt(Rgb::ZERO), *r, Rgb::ZERO);
        });
        r
    }

    fn dot(&self, a: &[Rgb], b: &[Rgb]) -> Rgb {
        let part = |k: usize| {
            let range = k * MANY..((k + 1) * MANY).min(a.len());
            range.map(|i| a[i] * b[i] * self.weight[i]).sum()
        };
        let parts: Vec<Rgb> = (0..a.len().div_ceil(MANY)).into_par_iter().map(part).collect();
        parts.iter().sum()
    }

    fn precondition(&self, r: &[Rgb]) -> Vec<Rgb> {
        let sums = self.groups.sums(r.iter().zip(&self.weight).map(|(r, w)| *r * *w));
        let solved = [0, 1, 2].map(|c| self.coarse[c].solve(sums.iter().map(|s| s[c]).collect()));
        let means: Vec<Rgb> =
            (0..sums.len()).map(|g| Rgb::new(solved[0][g], solved[1][g], solved[2][g])).collect();
        r.iter().zip(&self.groups.of).map(|(r, g)| *r + means[usize::from(*g)]).collect()
    }
}

/// Elements in groups: sides of faces as long as these are few, else equally many elements of one region.
pub(super) struct Groups {
    /// The group of each element.
    of: Vec<u16>,
    count: usize,
}

impl Groups {
    /// `side` tells the side of a face by element, in runs; `regions` by element what exchanges light ([`super::regions`]).
    pub fn new(side: &[u32], regions: impl FnOnce() -> Vec<u32>) -> Groups {
        let mut of = Vec::with_capacity(side.len());
        let (mut count, mut last) = (0usize, u32::MAX);
        for s in side {
            if *s != last {
                count += 1;
                last = *s;
            }
            of.push((count - 1).min(MOST_GROUPS) as u16);
        }
        if count > MOST_GROUPS {
            (of, count) = runs(&regions(), MOST_GROUPS);
        }
        Groups { of, count }
    }

    /// Sums over each group of what elements have.
    pub fn sums(&self, values: impl Iterator<Item = Rgb>) -> Vec<Rgb> {
        let mut sums = vec![Rgb::ZERO; self.count];
        self.of.iter().zip(values).for_each(|(g, v)| sums[usize::from(*g)] += v);
        sums
    }
}

/// `L L^T` of a positive semidefinite matrix; unknowns without a pivot stay zero.
struct Cholesky {
    n: usize,
    l: Vec<f64>,
}

impl Cholesky {
    fn new(mut a: Vec<f64>, n: usize) -> Cholesky {
        for k in 0..n {
            let diagonal = a[k * n + k];
            let pivot = (0..k).fold(diagonal, |d, m| d - a[k * n + m] * a[k * n + m]);
            let good = pivot > LEAST_PIVOT * diagonal && diagonal > 0.0;
            let root = if good { pivot.sqrt() } else { f64::INFINITY };
            a[k * n + k] = root;
            for i in k + 1..n {
                let v = (0..k).fold(a[i * n + k], |v, m| v - a[i * n + m] * a[k * n + m]);
                a[i * n + k] = v / root;
            }
        }
        Cholesky { n, l: a }
    }

    fn solve(&self, mut x: Vec<f64>) -> Vec<f64> {
        let n = self.n;
        for i in 0..n {
            let v = (0..i).fold(x[i], |v, k| v - self.l[i * n + k] * x[k]);
            x[i] = v / self.l[i * n + i];
        }
        for i in (0..n).rev() {
            let v = (i + 1..n).fold(x[i], |v, k| v - self.l[k * n + i] * x[k]);
            x[i] = v / self.l[i * n + i];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cholesky_solves_and_leaves_null_spaces_alone() {
        // Third unknown coupled to nothing.
        let a = vec![4.0, 1.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 0.0];
        let x = Cholesky::new(a, 3).solve(vec![9.0, 5.0, 1.0]);
        assert!((x[0] - 2.0).abs() < 1e-14 && (x[1] - 1.0).abs() < 1e-14 && x[2] == 0.0, "{x:?}");
    }

    #[test]
    fn groups_are_sides_or_runs() {
        let few = Groups::new(&[7, 7, 2, 2, 9], Vec::new);
        assert_eq!((few.of, few.count), (vec![0, 0, 1, 1, 2], 3));
        let many: Vec<u32> = (0..1000).collect();
        let Groups { of, count } = Groups::new(&many, || vec![0; 1000]);
        assert_eq!((count, of[0], of[999]), (MOST_GROUPS, 0, MOST_GROUPS as u16 - 1));
    }
}
