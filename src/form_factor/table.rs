//! Form factors between objects, with standard errors.

use super::ExchangeMatrix;
use super::export::sides;
use crate::color;
use crate::mesh::Mesh;
use crate::scene::Scene;
use serde::Serialize;

/// A full table of form factors between the objects of a scene.
#[derive(Debug, Clone, Serialize)]
pub struct ObjectTable {
    /// Object names in the order of the files; with elements on backs, the backs of all follow as `NAME:back`.
    pub objects: Vec<String>,
    /// Area of each object [m^2].
    pub areas: Vec<f64>,
    /// `[a][b]`: factor from a to b.
    pub form_factors: Vec<Vec<f64>>,
    /// Standard error of each factor, from the spread of independent randomisations; NaN (null in
    /// JSON) where a single randomisation gives none.
    pub standard_errors: Vec<Vec<f64>>,
    /// Share of each object's rays that left the scene.
    pub escaped: Vec<f64>,
    /// Rays an element.
    pub rays: u32,
    /// Seconds that the computation took.
    pub seconds: f64,
    /// First and one past the last object whose rows there are, where these are not all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rows: Option<[usize; 2]>,
    /// `raw`, or which conditions a correction has enforced.
    pub written: &'static str,
}

impl ObjectTable {
    /// Sums a matrix over objects: `F_ab = sum over i in a of A_i / A_a sum over j in b of F_ij`.
    pub fn new(scene: &Scene, mesh: &Mesh, matrix: &ExchangeMatrix, seconds: f64) -> ObjectTable {
        let sides = sides(scene, mesh);
        let n = sides.names.len();
        let batches = matrix.batches();
        let object = |e: usize| sides.of_element[e] as usize;
        let mut areas = vec![0.0; n];
        for e in 0..mesh.len() {
            areas[object(e)] += mesh.area(e as u32);
        }
        let mut estimates = vec![vec![vec![0.0; batches]; n]; n];
        let mut escaped = vec![0.0; n];
        for e in 0..mesh.len() {
            let a = object(e);
            let share = mesh.area(e as u32) / areas[a];
            escaped[a] += share * color::mean(matrix.summary[e].escaped);
            for (batch, j, f) in (0..batches).flat_map(|b| matrix.batch(e, b).map(move |(j, f)| (b, j, f))) {
                estimates[a][object(j)][batch] += share * color::mean(f) * batches as f64;
            }
        }
        let statistic = |f: &dyn Fn(&[f64]) -> f64| -> Vec<Vec<f64>> {
            estimates.iter().map(|row| row.iter().map(|e| f(e)).collect()).collect()
        };
        let mean = |e: &[f64]| e.iter().sum::<f64>() / e.len() as f64;
        ObjectTable {
            objects: sides.names,
            areas,
            form_factors: statistic(&mean),
            standard_errors: statistic(&|e| {
                if e.len() < 2 {
                    return f64::NAN;
                }
                let m = mean(e);
                let spread: f64 = e.iter().map(|x| (x - m) * (x - m)).sum();
                (spread / (e.len() * (e.len() - 1)) as f64).sqrt()
            }),
            escaped,
            rays: matrix.rays_per_row,
            seconds,
            rows: None,
            written: "raw",
        }
    }
}
