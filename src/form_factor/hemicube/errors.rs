//! Measured estimates of the hemi-cube's own errors, apart from each other.

use super::{Beside, DeltaFactors, Drawer, HemicubeSettings, place_in_grid, turn};
use crate::form_factor::analytic::{Polygon, differential};
use crate::mesh::Mesh;
use crate::sampling::seed_of;
use crate::scene::Scene;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Most elements that the estimates look at, evenly spaced among all.
const SAMPLE: usize = 128;
/// Hemi-cubes along one side of the finer grid that stands for the whole element.
const FINE: u32 = 4;

/// Estimates of the errors of single factors of a hemi-cube matrix, over a sample of its rows: root mean square over
/// all factors that either estimate has above zero, and largest, absolute.
///
/// - **Aliasing**: two hemi-cubes at one point, turned about the normal by random angles, differ by the errors of both;
///   theirs divided by the root of two is one's own, and is divided by the root of the cubes that a row has.
/// - **Proximity** and **visibility from a point**: the row against the mean over a finer grid of points. With the
///   unoccluded factors L of both (Lambert's formula, no pixels) and the visible shares V = F / L, the difference is `F - F' =
///   V' (L - L') + (V - V') L`. The first term is what a nearer point of view would change if nothing were hidden: proximity. The second is
///   what is hidden from one and not from the other: visibility, and with it what is left of aliasing.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct HemicubeErrors {
    /// Elements looked at.
    pub rows: usize,
    /// Factors looked at.
    pub factors: usize,
    /// Root mean square error from aliasing.
    pub aliasing_rms: f64,
    /// Largest error from aliasing.
    pub aliasing_largest: f64,
    /// Root mean square error from proximity.
    pub proximity_rms: f64,
    /// Largest error from proximity.
    pub proximity_largest: f64,
    /// Root mean square error from visibility.
    pub visibility_rms: f64,
    /// Largest error from visibility.
    pub visibility_largest: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    square: f64,
    largest: f64,
}

impl Sum {
    fn add(&mut self, error: f64) {
        self.square += error * error;
        self.largest = self.largest.max(error.abs());
    }
}

impl HemicubeErrors {
    /// Measures a sample of the rows.
    pub fn measure(scene: &Scene, mesh: &Mesh, settings: &HemicubeSettings) -> HemicubeErrors {
        let n = mesh.len().min(SAMPLE);
        let elements: Vec<u32> = (0..n).map(|k| ((k * mesh.len() + mesh.len() / 2) / n) as u32).collect();
        let deltas = DeltaFactors::new(settings.resolution as usize);
        let rows: Vec<(usize, [Sum; 3])> = elements
            .par_iter()
            .map_init(|| Drawer::new(scene, mesh, &deltas), |drawer, &element| row(drawer, element, settings))
            .collect();
        let (mut factors, mut sums) = (0, [Sum::default(); 3]);
        for (count, row) in rows {
            factors += count;
            for (sum, part) in sums.iter_mut().zip(row) {
                *sum = Sum { square: sum.square + part.square, largest: sum.largest.max(part.largest) };
            }
        }
        let rms = |s: Sum| (s.square / factors.max(1) as f64).sqrt();
        let [aliasing, proximity, visibility] = sums;
        HemicubeErrors {
            rows: n,
            factors,
            aliasing_rms: rms(aliasing),
            aliasing_largest: aliasing.largest,
            proximity_rms: rms(proximity),
            proximity_largest: proximity.largest,
            visibility_rms: rms(visibility),
            visibility_largest: visibility.largest,
        }
    }
}

/// Number of factors, and sums of aliasing, proximity and visibility.
fn row(drawer: &mut Drawer, element: u32, settings: &HemicubeSettings) -> (usize, [Sum; 3]) {
    let (scene, mesh) = (drawer.scene, drawer.mesh);
    let grid = settings.grid;
    // Own: the row as it is asked for, without rotations. Fine: a grid four times as dense in its stead.
    let own = mean(drawer, element, grid, false, 0);
    let fine = mean(drawer, element, FINE * grid, true, settings.seed);
    let first = mean(drawer, element, 1, true, settings.seed ^ 1);
    let second = mean(drawer, element, 1, true, settings.seed ^ 2);
    let normal = mesh.normal(scene, element);
    let (coarse_points, fine_points) =
        (points(scene, mesh, element, grid), points(scene, mesh, element, FINE * grid));
    let cubes = (settings.cubes_per_element() as f64).sqrt();
    let mut sums = [Sum::default(); 3];
    let columns: BTreeSet<u32> =
        [&own, &fine, &first, &second].iter().flat_map(|r| r.keys().copied()).collect();
    for &j in &columns {
        let at = |r: &BTreeMap<u32, f64>| r.get(&j).copied().unwrap_or(0.0);
        sums[0].add((at(&first) - at(&second)) / std::f64::consts::SQRT_2 / cubes);
        let target = Polygon::of_element(scene, mesh, j);
        let unoccluded = |points: &[DVec3]| -> f64 {
            points.iter().map(|p| differential(*p, normal, &target)).sum::<f64>() / points.len() as f64
        };
        let (l, l_fine) = (unoccluded(&coarse_points), unoccluded(&fine_points));
        let share = if l_fine > 0.0 { (at(&fine) / l_fine).min(1.0) } else { 0.0 };
        let proximity = share * (l - l_fine);
        sums[1].add(proximity);
        sums[2].add(at(&own) - at(&fine) - proximity);
    }
    (columns.len(), sums)
}

/// Row of one element as the mean over a grid of hemi-cubes, turned at random or not.
fn mean(drawer: &mut Drawer, element: u32, grid: u32, turned: bool, seed: u32) -> BTreeMap<u32, f64> {
    for cube in 0..grid * grid {
        let angle = turned.then(|| turn(seed_of(&[seed, element, cube])));
        let share = 1.0 / f64::from(grid * grid);
        drawer.cube(element, place_in_grid(grid, cube, None), angle, share, &mut Beside::default());
    }
    let row = drawer.touched.iter().map(|&j| (j, drawer.weight[j as usize])).collect();
    for j in drawer.touched.drain(..) {
        drawer.weight[j as usize] = 0.0;
    }
    row
}

/// Points of the grid on an element.
fn points(scene: &Scene, mesh: &Mesh, element: u32, grid: u32) -> Vec<DVec3> {
    (0..grid * grid)
        .map(|cube| super::stand(scene, mesh, element, place_in_grid(grid, cube, None), None).0)
        .collect()
}
