//! Which elements lie inside of glass, in part or wholly.
//!
//! A ray that meets the back of a glass surface first began inside of it, and so did one that ends on a black surface there or meets the
//! front of a body in it; one that meets the front of other glass, escapes, or lands on an element of which no ray does so, outside. Where bodies inside of glass see each
//! other, stones in a tank of water or two of the tank's walls, a ray from one that lands on the other began where that one lies.

use super::RowSummary;

/// Rounds of handing on what is known.
const ROUNDS: usize = 64;

/// The rays of an element some of which began inside of glass.
pub(super) struct Immersed {
    pub element: u32,
    /// Rays that met the back of glass first, or what is black or glass inside of it.
    pub inside: u32,
    /// Sum of its squared indices less one.
    pub index2: f64,
    /// Rays whose start lies open.
    pub open: u32,
    /// Elements on which its rays landed straight away, one for each ray, in order; without those of glass.
    pub landed: Vec<u32>,
}

/// Completes the squared index of the medium of these elements, in order of elements.
pub(super) fn settle(summary: &mut [RowSummary], immersed: &[Immersed]) {
    // Of each, the others on which rays of it landed, with their numbers.
    let among = |e: u32| immersed.binary_search_by_key(&e, |i| i.element).ok();
    let seen: Vec<Vec<(usize, f64)>> = immersed
        .iter()
        .map(|i| {
            let runs = i.landed.chunk_by(|a, b| a == b);
            runs.filter_map(|run| Some((among(run[0])?, run.len() as f64))).collect()
        })
        .collect();
    let mut share: Vec<f64> = vec![1.0; immersed.len()];
    for _ in 0..ROUNDS {
        share = immersed
            .iter()
            .zip(&seen)
            .map(|(i, seen)| {
                let others: f64 = seen.iter().map(|(k, rays)| share[*k] * rays).sum();
                (f64::from(i.inside) + others) / f64::from(i.open)
            })
            .collect();
    }
    for (i, share) in immersed.iter().zip(share) {
        summary[i.element as usize].index2 = 1.0 + share * i.index2 / f64::from(i.inside);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_in_glass_counts_as_that() {
        let row = |element, inside, open, landed: &[u32]| Immersed {
            element,
            inside,
            index2: 1.25 * f64::from(inside),
            open,
            landed: landed.to_vec(),
        };
        let mut summary = vec![RowSummary::default(); 6];
        // 1 and 3 lie in glass of 1.5 and see each other; 5 lies a quarter in it and sees 0, outside, and 1.
        let all = [row(1, 2, 4, &[3, 3]), row(3, 1, 4, &[1, 1, 1]), row(5, 1, 8, &[0, 0, 0, 0, 0, 0, 1])];
        settle(&mut summary, &all);
        let index2: Vec<f64> = summary.iter().map(|s| s.index2).collect();
        for (found, right) in index2.iter().zip([1.0, 2.25, 1.0, 2.25, 1.0, 1.3125]) {
            assert!((found - right).abs() < 1e-12, "{index2:?}");
        }
    }
}
