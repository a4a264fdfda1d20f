//! Sparse rows of form factors, with their independent randomisations kept apart.

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
    /// Start of each (row, batch), and the end.
    pub(super) start: Vec<u64>,
    pub(super) columns: Vec<u32>,
    pub(super) values: Vec<f32>,
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
        self.columns.len()
    }

    /// Bytes that the matrix occupies.
    pub fn bytes(&self) -> usize {
        self.columns.len() * 4
            + self.values.len() * 4
            + self.start.len() * 8
            + self.summary.len() * size_of::<RowSummary>()
    }

    /// Column and value (by channel) of each entry of one randomisation of a row.
    pub fn batch(&self, row: usize, batch: usize) -> impl Iterator<Item = (usize, Rgb)> + '_ {
        let k = row * self.batches + batch;
        (self.start[k] as usize..self.start[k + 1] as usize)
            .map(|e| (self.columns[e] as usize, self.value(e)))
    }

    /// Entries of all randomisations of a row, which share a row's rays; a column may come several times.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (usize, Rgb)> + '_ {
        let (a, b) = (self.start[row * self.batches], self.start[(row + 1) * self.batches]);
        (a as usize..b as usize).map(|e| (self.columns[e] as usize, self.value(e)))
    }

    #[inline]
    fn value(&self, entry: usize) -> Rgb {
        if self.channels == 1 {
            Rgb::splat(f64::from(self.values[entry]))
        } else {
            let v = &self.values[3 * entry..3 * entry + 3];
            Rgb::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
        }
    }

    /// `F x`: irradiance [W m^-2] from radiosities [W m^-2], by rows, on all cores; the order of
    /// each row's sum is fixed, so the result does not depend on the number of threads.
    pub fn multiply(&self, x: &[Rgb]) -> Vec<Rgb> {
        (0..self.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|row| {
                let (a, b) =
                    (self.start[row * self.batches] as usize, self.start[(row + 1) * self.batches] as usize);
                self.dot(a, b, x)
            })
            .collect()
    }

    /// Row `row` times `x`, one value for each independent randomisation (each an estimate of the whole).
    pub fn multiply_batches(&self, row: usize, x: &[Rgb]) -> Vec<Rgb> {
        (row * self.batches..(row + 1) * self.batches)
            .map(|k| self.dot(self.start[k] as usize, self.start[k + 1] as usize, x) * self.batches as f64)
            .collect()
    }

    /// Row `row` times `x` from one independent randomisation, an estimate of the whole.
    pub fn multiply_batch(&self, row: usize, batch: usize, x: &[Rgb]) -> Rgb {
        let k = row * self.batches + batch;
        self.dot(self.start[k] as usize, self.start[k + 1] as usize, x) * self.batches as f64
    }

    #[inline]
    fn dot(&self, a: usize, b: usize, x: &[Rgb]) -> Rgb {
        if self.channels == 1 {
            let pairs = self.columns[a..b].iter().zip(&self.values[a..b]);
            pairs.fold(Rgb::ZERO, |sum, (j, f)| sum + f64::from(*f) * x[*j as usize])
        } else {
            (a..b).fold(Rgb::ZERO, |sum, e| sum + self.value(e) * x[self.columns[e] as usize])
        }
    }

    /// Largest departure of a row from closure: factors to opaque diffuse surfaces, escaped,
    /// absorbed and dropped shares sum to 1. `keep` is the share that each element's surface
    /// passes on specularly (a ray that goes on is counted at every diffuse surface on its way).
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

    /// Departure from reciprocity between objects: `sum |G_ab - G_ba| / sum (G_ab + G_ba)` of the exchange
    /// areas `G_ab = sum of A_i F_ij` [m^2], i on object a and j on b.
    pub fn reciprocity_residual(&self, scene: &Scene, mesh: &Mesh) -> f64 {
        let n = scene.objects.len();
        let object: Vec<usize> =
            (0..self.len()).map(|e| scene.faces[mesh.place(e as u32).0 as usize].object as usize).collect();
        let mut exchange = std::collections::BTreeMap::<(usize, usize), f64>::new();
        for row in 0..self.len() {
            let s = &self.summary[row];
            let area = mesh.area(row as u32) * s.exposed * s.index2;
            for (j, f) in self.row(row) {
                *exchange.entry((object[row], object[j])).or_default() += area * f.x;
            }
        }
        let (mut difference, mut sum) = (0.0, 0.0);
        for a in 0..n {
            for b in 0..a {
                let at = |k| exchange.get(&k).copied().unwrap_or(0.0);
                let (ab, ba) = (at((a, b)), at((b, a)));
                difference += (ab - ba).abs();
                sum += ab + ba;
            }
        }
        if sum > 0.0 { difference / sum } else { 0.0 }
    }
}
