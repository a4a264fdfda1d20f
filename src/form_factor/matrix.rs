//! Sparse rows of form factors, with their independent randomisations kept apart.

use super::recast::Rows;
use super::rows::{Block, Row};
use crate::color::Rgb;
use crate::mesh::Mesh;
use crate::scene::Scene;
use rayon::prelude::*;

/// What became of the rays of one row that did not land on an element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowSummary {
    /// Share that left the scene.
    pub escaped: Rgb,
    /// Share lost where no element is: absorbed by black or purely specular surfaces.
    pub absorbed: Rgb,
    /// Share dropped where a specular chain was cut at its longest.
    pub dropped: Rgb,
    /// Share of the element that lies open; the rest is covered by other surfaces.
    pub exposed: f64,
    /// Mean squared index of refraction of the medium that its rays start in: above 1 for what lies inside of glass.
    /// Exchange there is reciprocal in `A_i n_i^2 F_ij`.
    pub index2: f64,
}

impl Default for RowSummary {
    fn default() -> RowSummary {
        RowSummary { escaped: Rgb::ZERO, absorbed: Rgb::ZERO, dropped: Rgb::ZERO, exposed: 0.0, index2: 1.0 }
    }
}

/// Form factors `F_ij` from element i (row) to element j (column), means over the open part of
/// each element; dimensionless.
///
/// Row i consists of [`ExchangeMatrix::batches`] independent randomisations, whose spread gives
/// standard errors. The values are shares of all rays of the row, so sums over a whole row are the
/// estimate itself.
#[derive(Debug, Clone)]
pub struct ExchangeMatrix {
    pub(super) batches: usize,
    /// 1 where one weight serves all channels, 3 where chains are coloured.
    pub(super) channels: usize,
    /// Every block but the last holds as many rows.
    pub(super) rows_per_block: usize,
    pub(super) blocks: Vec<Block>,
    /// One summary a row.
    pub summary: Vec<RowSummary>,
    /// Rays cast for each row.
    pub rays_per_row: u32,
    /// Rays cast in all, chains included.
    pub rays: u64,
}

impl ExchangeMatrix {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.summary.len()
    }

    /// No elements.
    pub fn is_empty(&self) -> bool {
        self.summary.is_empty()
    }

    /// Independent randomisations of each row.
    pub fn batches(&self) -> usize {
        self.batches
    }

    /// Number of stored entries.
    pub fn stored(&self) -> usize {
        self.blocks.iter().map(Block::stored).sum()
    }

    /// Bytes that the matrix occupies.
    pub fn bytes(&self) -> usize {
        let blocks: usize = self.blocks.iter().map(Block::bytes).sum();
        blocks + self.summary.len() * size_of::<RowSummary>()
    }

    /// Whether entries are counts of rays, without weights.
    pub(super) fn counts_rays(&self) -> bool {
        self.blocks.iter().all(Block::counts_rays)
    }

    /// A row with its randomisations.
    #[inline]
    pub fn at(&self, row: usize) -> Row<'_> {
        let (block, k) = (row / self.rows_per_block, row % self.rows_per_block);
        self.blocks[block].row(k, self.batches, self.channels)
    }

    /// Column and value (by channel) of each entry of one randomisation of a row; no column comes twice.
    pub fn batch(&self, row: usize, batch: usize) -> impl Iterator<Item = (usize, Rgb)> + '_ {
        self.at(row).batch(batch)
    }

    /// Entries of all randomisations of a row, which share a row's rays; a column may come several times.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, Rgb)> + '_ {
        self.at(row).entries()
    }

    /// `F x`: irradiance [W m^-2] from radiosities [W m^-2], by rows, on all cores; the order of
    /// each row's sum is fixed, so the result does not depend on the number of threads.
    pub fn multiply(&self, x: &[Rgb]) -> Vec<Rgb> {
        (0..self.len()).into_par_iter().with_min_len(64).map(|row| self.at(row).dot(x)).collect()
    }

    /// Largest departure of a row from closure ([`Check::closure`](super::Check)); `keep` is the share that each element's
    /// surface passes on specularly.
    pub fn closure_residual(&self, keep: impl Fn(u32) -> Rgb + Sync) -> f64 {
        let residual = |row: usize| {
            let s = &self.summary[row];
            if s.exposed == 0.0 {
                return 0.0;
            }
            let sum = self.row(row).fold(s.escaped + s.absorbed + s.dropped, |sum, (j, f)| {
                sum + f * (Rgb::ONE - keep(j as u32))
            });
            (sum - Rgb::ONE).abs().max_element()
        };
        (0..self.len()).into_par_iter().with_min_len(64).map(residual).reduce(|| 0.0, f64::max)
    }

    /// Departure from reciprocity between objects ([`Check::reciprocity`](super::Check)).
    pub fn reciprocity_residual(&self, scene: &Scene, mesh: &Mesh) -> f64 {
        Rows::Kept(self).check(scene, mesh, |_| Rgb::ZERO).reciprocity
    }
}
