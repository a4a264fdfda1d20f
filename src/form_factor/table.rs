//! Form factors between objects, with standard errors.

use super::ExchangeMatrix;
use super::analytic::Polygon;
use super::export::sides;
use super::pairs::PairFactors;
use crate::color;
use crate::mesh::Mesh;
use crate::scene::Scene;
use rayon::prelude::*;
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
    /// JSON) where a single randomisation gives none. Where none of the rays from a met b, it is what one ray would have
    /// counted, and 0 where no face of b can lie before a face of a.
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
        let mut standard_errors = statistic(&|e| mean_error(e).1);
        if matrix.rays_per_row > 0 {
            let mut one_ray = vec![0.0f64; n];
            for e in 0..mesh.len() {
                let share = mesh.area(e as u32) / areas[object(e)];
                one_ray[object(e)] = one_ray[object(e)].max(share / f64::from(matrix.rays_per_row));
            }
            let faces = Faces::new(scene, mesh, &sides.of_element, n);
            standard_errors.par_iter_mut().enumerate().for_each(|(a, row)| {
                for (b, error) in row.iter_mut().enumerate() {
                    if *error == 0.0 && estimates[a][b].iter().all(|e| *e == 0.0) && faces.may_meet(a, b) {
                        *error = one_ray[a];
                    }
                }
            });
        }
        ObjectTable {
            objects: sides.names,
            areas,
            form_factors: statistic(&|e| mean_error(e).0),
            standard_errors,
            escaped,
            rays: matrix.rays_per_row,
            seconds,
            rows: None,
            written: "raw",
        }
    }

    /// [`ObjectTable::new`] with both directions' estimates combined.
    ///
    /// `A_a F_ab` and `A_b F_ba` estimate the same exchange area; their weights are the inverse of what `N` independent rays
    /// would give as variance, `A^2 F (1 - F) / N`, with the mean of both for `A F`. The weights do not see
    /// the spread of the randomisations, nor the smaller estimate: these would favour what happens to be small.
    /// Rows then close within their errors only.
    pub fn combined(scene: &Scene, mesh: &Mesh, matrix: &ExchangeMatrix, seconds: f64) -> ObjectTable {
        let mut table = ObjectTable::new(scene, mesh, matrix, seconds);
        let mut elements = vec![0.0; table.objects.len()];
        sides(scene, mesh).of_element.iter().for_each(|side| elements[*side as usize] += 1.0);
        for a in 0..elements.len() {
            for b in 0..a {
                let (area, f) = (&table.areas, &mut table.form_factors);
                let exchange = [area[a] * f[a][b], area[b] * f[b][a]];
                let mean = 0.5 * (exchange[0] + exchange[1]);
                if mean == 0.0 {
                    // Neither met the other: what the better one says.
                    let e = &mut table.standard_errors;
                    let error = (area[a] * e[a][b]).min(area[b] * e[b][a]);
                    (e[a][b], e[b][a]) = (error / area[a], error / area[b]);
                    continue;
                }
                let variance = |k: usize, f: f64| area[k] * mean * (1.0 - f).max(0.0) / elements[k];
                let (va, vb) = (variance(a, f[a][b]), variance(b, f[b][a]));
                let share = if va + vb > 0.0 { vb / (va + vb) } else { 0.5 };
                let both = share * exchange[0] + (1.0 - share) * exchange[1];
                let e = &mut table.standard_errors;
                let error = (share * area[a] * e[a][b]).hypot((1.0 - share) * area[b] * e[b][a]);
                (f[a][b], f[b][a]) = (both / area[a], both / area[b]);
                (e[a][b], e[b][a]) = (error / area[a], error / area[b]);
            }
        }
        table
    }

    /// The same from factors found pair by pair; `rows` tells where the rest of the rays went.
    pub fn of_pairs(
        scene: &Scene,
        mesh: &Mesh,
        pairs: &PairFactors,
        rows: Option<&ExchangeMatrix>,
        seconds: f64,
    ) -> ObjectTable {
        let sides = sides(scene, mesh);
        let n = sides.names.len();
        let (mut areas, mut escaped) = (vec![0.0; n], vec![0.0; n]);
        for e in 0..mesh.len() {
            let a = sides.of_element[e] as usize;
            areas[a] += mesh.area(e as u32);
            escaped[a] += mesh.area(e as u32) * pairs.rest(e, rows).escaped.x;
        }
        escaped.iter_mut().zip(&areas).for_each(|(e, a)| *e /= a);
        let between = |a: usize| (0..n).map(move |b| pairs.between_objects(a, b));
        ObjectTable {
            objects: sides.names,
            form_factors: (0..n).map(|a| between(a).map(|(g, _)| g / areas[a]).collect()).collect(),
            standard_errors: (0..n).map(|a| between(a).map(|(_, e)| e / areas[a]).collect()).collect(),
            areas,
            escaped,
            rays: rows.map_or(0, |r| r.rays_per_row),
            seconds,
            rows: None,
            written: "raw",
        }
    }
}

/// The faces of each object's side that takes part.
struct Faces {
    of: Vec<Vec<Polygon>>,
    /// Light from any of them may come to any other by specular surfaces, or nobody looks whether it does.
    all: bool,
    eps: f64,
}

/// Faces beyond which all objects are taken to face each other.
const MOST_FACES: usize = 1 << 12;
/// What counts as in one plane, as a share of the scene's radius.
const IN_PLANE: f64 = 1e-9;

impl Faces {
    fn new(scene: &Scene, mesh: &Mesh, of_element: &[u32], n: usize) -> Faces {
        let mut of = vec![Vec::new(); n];
        let mut last = None;
        for (e, object) in of_element.iter().enumerate() {
            // The elements of one side of a face come in a row.
            let side = mesh.side(e as u32);
            if last.replace(side) != Some(side) {
                let (face, front, _) = mesh.place(e as u32);
                let polygon = Polygon::of_face(scene, &scene.faces[face as usize]);
                of[*object as usize].push(if front { polygon } else { polygon.turned() });
            }
        }
        let specular = scene.faces.iter().any(|f| scene.material(f).is_specular());
        let all = specular || of.iter().map(Vec::len).sum::<usize>() > MOST_FACES;
        Faces { of, all, eps: IN_PLANE * scene.radius }
    }

    /// Whether a ray from a may meet b, as far as the planes of their faces tell.
    fn may_meet(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.of[a], &self.of[b]);
        if a.is_empty() || b.is_empty() {
            return false;
        }
        let before = |p: &Polygon, q: &Polygon| p.reaches_before(q.corners()[0], q.normal, self.eps);
        self.all || a.iter().any(|p| b.iter().any(|q| before(p, q) && before(q, p)))
    }
}

/// Mean of independent estimates and its standard error; not a number for a single one.
pub(super) fn mean_error(e: &[f64]) -> (f64, f64) {
    let n = e.len() as f64;
    let mean = e.iter().sum::<f64>() / n;
    let spread: f64 = e.iter().map(|x| (x - mean) * (x - mean)).sum();
    (mean, (spread / (n * (n - 1.0))).sqrt())
}
