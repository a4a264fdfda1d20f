//! The pairs of a few elements with all others, beside rows of hemisphere rays.

use super::{PairCounts, PairWork, Shared, rows};
use crate::color::{self, Rgb};
use crate::form_factor::RowSummary;
use crate::mesh::Mesh;
use crate::visibility::Visibility;
use rayon::prelude::*;

/// Exchange areas of a few elements with all elements.
pub struct FewPairs {
    /// The few, in order.
    elements: Vec<u32>,
    /// Number of elements in all.
    n: usize,
    /// `A_i F_ij` and its standard error, a row of all j for each i of the few [m^2].
    exchange: Vec<(f64, f32)>,
    /// How the pairs were found.
    pub counts: PairCounts,
    /// Rays cast.
    pub rays: u64,
}

impl FewPairs {
    /// Finds the pairs of `elements`, which are in order, with all; of those, where `only` names elements, the pairs that have one of
    /// them.
    pub fn new(
        visibility: &Visibility,
        mesh: &Mesh,
        (elements, only): (Vec<u32>, Option<&[bool]>),
        work: &PairWork,
    ) -> FewPairs {
        let shared = Shared::new(visibility, visibility.scene(), mesh, work);
        let n = mesh.len();
        let found: Vec<rows::Row> = elements
            .par_iter()
            .with_max_len(1)
            .map_init(rows::Scratch::default, |scratch, i| shared.row(scratch, *i as usize, 0..n, only))
            .collect();
        let mut few = FewPairs { elements, n, exchange: Vec::new(), counts: PairCounts::default(), rays: 0 };
        for row in found {
            few.exchange.extend(row.exchange.into_iter().zip(row.error));
            few.counts.add(&row.counts);
            few.rays += row.rays;
        }
        few
    }

    /// Number of the few.
    pub fn len(&self) -> usize {
        self.elements.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }

    /// Puts what is known into row `i`, of an element of `area` [m^2] whose hemisphere rays found `row` (factors and their
    /// standard errors by column, in order) and `summary`.
    ///
    /// What the rays found besides is scaled to what is left, so the row sums to what it did. Of independent rays that is
    /// unbiased: those that do not go to the few share their part by chance, however many they are.
    pub fn mend(&self, i: usize, area: f64, row: &mut Vec<(u32, f64, f64)>, summary: &mut RowSummary) {
        let share = |k: usize, j: usize| {
            let (exchange, error) = self.exchange[k * self.n + j];
            (exchange / area, f64::from(error) / area)
        };
        let total = |s: &RowSummary| color::mean(s.escaped + s.absorbed + s.dropped);
        let known: Vec<(u32, f64, f64)> = match self.elements.binary_search(&(i as u32)) {
            Ok(k) => {
                (0..self.n as u32).map(|j| (j, share(k, j as usize))).map(|(j, (f, e))| (j, f, e)).collect()
            }
            Err(_) => {
                let of = |(k, j): (usize, &u32)| {
                    let (f, e) = share(k, i);
                    (*j, f, e)
                };
                self.elements.iter().enumerate().map(of).collect()
            }
        };
        let sum = |row: &[(u32, f64, f64)]| row.iter().map(|r| r.1).sum::<f64>();
        let whole = sum(row) + total(summary);
        // Both are in order.
        let mut next = known.iter().map(|k| k.0).peekable();
        row.retain(|(j, ..)| {
            while next.next_if(|k| k < j).is_some() {}
            next.peek() != Some(j)
        });
        let (rest, left) = (sum(row) + total(summary), whole - sum(&known));
        if rest > 0.0 {
            let scale = (left / rest).max(0.0);
            row.iter_mut().for_each(|r| (r.1, r.2) = (scale * r.1, scale * r.2));
            for part in [&mut summary.escaped, &mut summary.absorbed, &mut summary.dropped] {
                *part *= Rgb::splat(scale);
            }
        }
        row.extend(known.into_iter().filter(|k| k.1 > 0.0));
        // Two runs in order: merged, not sorted.
        row.sort_by_key(|r| r.0);
    }
}
