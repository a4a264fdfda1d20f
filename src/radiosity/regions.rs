//! Parts of a scene that exchange no light.

use super::Transport;
use crate::color::Rgb;
use crate::form_factor::ExchangeMatrix;
use crate::mesh::{Mesh, NONE};
use crate::sets::Sets;
use rustc_hash::FxHashMap;
use std::cmp::Reverse;

/// The region of each element, whose side of a face `sides` tells, by a number that all of a region have in common: light never leaves
/// it.
pub(super) fn regions(
    sides: &[u32],
    mesh: &Mesh,
    matrix: &ExchangeMatrix,
    transport: &Transport,
) -> Vec<u32> {
    let mut sets = Sets::new(sides.iter().max().map_or(0, |side| *side as usize + 1));
    for (e, side) in sides.iter().enumerate() {
        matrix.at(e).batch(0).for_each(|(j, _)| sets.join(*side, sides[j]));
        let behind = mesh.opposite(e as u32);
        if behind != NONE && transport.transmittance[e] != Rgb::ZERO {
            sets.join(*side, sides[behind as usize]);
        }
    }
    let names = sets.names();
    sides.iter().map(|side| names[*side as usize]).collect()
}

/// Groups of equally many elements, `most` at most, each within one region: what a solve leaves undone in a bright room would otherwise
/// come into a dark one. The smallest of many regions share groups. The group of each element, and how many there are.
pub(super) fn runs(region: &[u32], most: usize) -> (Vec<u16>, usize) {
    let mut sizes: FxHashMap<u32, usize> = FxHashMap::default();
    region.iter().for_each(|r| *sizes.entry(*r).or_default() += 1);
    let mut order: Vec<u32> = (0..region.len() as u32).collect();
    order.sort_by_key(|e| (Reverse(sizes[&region[*e as usize]]), region[*e as usize]));
    let mut apart = (sizes.len() - 1).min(most / 2);
    let (slots, n) = (most - apart, region.len());
    let mut of = vec![0; n];
    let mut count = 0;
    for k in 1..n {
        let [before, e] = [order[k - 1], order[k]].map(|e| e as usize);
        let leaves = region[before] != region[e] && apart > 0;
        apart -= usize::from(leaves);
        if leaves || k * slots / n > (k - 1) * slots / n {
            count += 1;
        }
        of[e] = count;
    }
    (of, usize::from(count) + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_stay_within_regions() {
        // Two interleaved regions and a small one.
        let region: Vec<u32> = (0..100).map(|e| if e == 50 { 9 } else { e % 2 * 7 }).collect();
        let (patch, count) = runs(&region, 12);
        assert!(count <= 12 && patch.iter().all(|p| usize::from(*p) < count));
        for p in 0..count as u16 {
            let members: Vec<usize> = (0..100).filter(|e| patch[*e] == p).collect();
            assert!((1..=10).contains(&members.len()), "{members:?}");
            assert!(members.iter().all(|e| region[*e] == region[members[0]]), "{members:?}");
        }
        // More regions than patches.
        let (patch, count) = runs(&(0..100).collect::<Vec<u32>>(), 12);
        assert!(count <= 12 && patch.iter().all(|p| usize::from(*p) < count), "{count}");
        assert_eq!(runs(&[3; 20], 4), ((0..20).map(|e| e / 5).collect(), 4));
    }
}
