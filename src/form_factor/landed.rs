//! Where the rays of a few elements landed, laid out for those who write and those who read.

use crate::mesh::NONE;
use std::ops::Range;

/// Points of a tile: 16 numbers fill a line of the processor's cache.
pub(super) const POINTS: usize = 16;

/// The elements on which the rays of a group of elements landed, [`NONE`] where no element is.
///
/// A packet brings the same few points of all elements of a part of the group; a row takes all points of one. In between there
/// are tiles: [`POINTS`] points of the first element of a part, of the second, and so on.
#[derive(Default)]
pub(super) struct Landed {
    columns: Vec<u32>,
    /// Tiles of a part.
    tiles: usize,
    /// By element of the group, its part.
    part: Vec<Range<usize>>,
}

impl Landed {
    /// Makes room for the rays of a group's parts; what was there is to be set again.
    pub(super) fn start(&mut self, parts: impl Iterator<Item = Range<usize>>, points: usize, batches: usize) {
        self.tiles = points.div_ceil(POINTS);
        self.part.clear();
        parts.for_each(|part| self.part.extend(part.clone().map(|_| part.clone())));
        if points % POINTS != 0 {
            // No ray fills the last tiles.
            self.columns.clear();
        }
        self.columns.resize(batches * self.part.len() * self.tiles * POINTS, NONE);
    }

    /// The tile that holds a point of a part, in one randomisation.
    #[inline(always)]
    pub(super) fn tile(&mut self, batch: usize, part: &Range<usize>, point: usize) -> &mut [u32] {
        let first = self.first(batch, part, point);
        &mut self.columns[first..first + part.len() * POINTS]
    }

    #[inline(always)]
    fn first(&self, batch: usize, part: &Range<usize>, point: usize) -> usize {
        let before = (batch * self.part.len() + part.start) * self.tiles;
        (before + part.len() * (point / POINTS)) * POINTS
    }

    /// Sets where one ray of the `k`-th element of the group landed.
    pub(super) fn set(&mut self, batch: usize, k: usize, point: usize, column: u32) {
        let part = self.part[k].clone();
        self.tile(batch, &part, point)[(k - part.start) * POINTS + point % POINTS] = column;
    }

    /// Where the rays of the `k`-th element of the group landed in one randomisation: runs of [`POINTS`], in order.
    pub(super) fn row(&self, batch: usize, k: usize) -> impl Iterator<Item = &[u32]> {
        let part = &self.part[k];
        let first = self.first(batch, part, 0) + (k - part.start) * POINTS;
        let step = part.len() * POINTS;
        (0..self.tiles).map(move |t| &self.columns[first + t * step..][..POINTS])
    }

    /// Numbers in a row.
    pub(super) fn row_len(&self) -> usize {
        self.tiles * POINTS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What packets write by tiles and what single rays write comes back by rows; a shorter group finds nothing of a longer one.
    #[test]
    fn rows_hold_what_was_set() {
        let mut landed = Landed::default();
        for (parts, points) in [(&[0..8, 8..10, 10..11][..], 48), (&[0..2, 2..4], 37), (&[0..8, 8..16], 16)] {
            let number = |batch: usize, k: usize, point: usize| (1000 * (16 * batch + k) + point) as u32;
            landed.start(parts.iter().cloned(), points, 2);
            for batch in 0..2 {
                for part in parts {
                    for point in 0..points {
                        for k in part.clone() {
                            if point % 3 == 0 {
                                landed.set(batch, k, point, number(batch, k, point));
                            } else {
                                let at = (k - part.start) * POINTS + point % POINTS;
                                landed.tile(batch, part, point)[at] = number(batch, k, point);
                            }
                        }
                    }
                }
            }
            let elements = parts.last().map_or(0, |p| p.end);
            for (batch, k) in (0..2).flat_map(|b| (0..elements).map(move |k| (b, k))) {
                let row: Vec<u32> = landed.row(batch, k).flatten().copied().collect();
                assert_eq!(row.len(), landed.row_len());
                assert!((0..points).all(|p| row[p] == number(batch, k, p)), "{points} points, element {k}");
                assert!(row[points..].iter().all(|c| *c == NONE));
            }
        }
    }
}
