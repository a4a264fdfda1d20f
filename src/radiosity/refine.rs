//! How wrong the interpolated light of each element is: where an adaptive mesh needs finer ones.
//!
//! What a mesh whose cells are all a level coarser would have shown is known: the same light, averaged over its larger cells and
//! interpolated between them. How far that is from what the elements show (the hierarchical surplus) bounds what the next level
//! would change: by theory a quarter of it where light is smooth, a half across an edge, and so alike for elements that
//! compete. Of it, what the noise of the elements explains says nothing about their size.

use super::{Field, Solution};
use crate::color::{self, Rgb};
use crate::mesh::{Division, Mesh, NONE, Nodes};
use crate::scene::Scene;
use std::collections::HashMap;

/// What division leaves of an edge's squared error.
const HALF: f64 = 0.5;

/// Share of the error that may be left of which joining cells may add.
const NEEDLESS: f64 = 0.05;

/// What pass 2 reads of pass 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reads {
    /// All reflected light ([`Solution::reflected`]).
    Reflected,
    /// What it does not sample from emitters anew ([`Solution::indirect`]).
    Indirect,
}

/// For each element, the square of the error of its interpolated light, summed over its area (W^2 m^-2), as the coarser level
/// lets expect it up to a factor that all have in common; zero on elements of level 0. `division` is that of the solution's mesh, `open`
/// the elements' open shares.
///
/// # Errors
/// As [`Mesh::divided`].
pub fn element_errors(
    scene: &Scene,
    division: &Division,
    solution: &Solution,
    open: &[f64],
    reads: Reads,
) -> crate::Result<Vec<f64>> {
    let mesh = &solution.mesh;
    let field = match reads {
        Reads::Reflected => &solution.reflected,
        Reads::Indirect => &solution.indirect,
    };
    let sides = mesh.sides();
    let shown: Vec<Rgb> =
        (0..mesh.len() as u32).map(|e| at_centroid(field, (mesh, &solution.nodes), mesh, e)).collect();
    let mut errors = vec![0.0; mesh.len()];
    for level in 1..=division.deepest() {
        let (coarse, within) = division.truncated(level - 1);
        let coarse = Mesh::divided(scene, &sides, &coarse, false)?;
        let parent: Vec<usize> = (0..mesh.len() as u32)
            .map(|e| {
                let (face, front, cell) = mesh.place(e);
                (coarse.first(face, front) + within[face as usize][cell as usize]) as usize
            })
            .collect();
        let mut means = vec![Rgb::ZERO; coarse.len()];
        let mut covered = vec![0.0; coarse.len()];
        for (e, p) in parent.iter().enumerate() {
            let area = open[e] * mesh.area(e as u32);
            means[*p] += area * shown[e];
            covered[*p] += area;
        }
        for (p, (mean, area)) in means.iter_mut().zip(&mut covered).enumerate() {
            *mean = if *area > 0.0 { *mean / *area } else { Rgb::ZERO };
            *area /= coarse.area(p as u32);
        }
        let nodes = Nodes::new(scene, &coarse);
        let before = Field::new(&coarse, &nodes, &covered, &means);
        // Sums over the quarters of each coarser cell: of the squares, and of what noise makes of them.
        let mut sums = vec![(0.0, 0.0); coarse.len()];
        for e in (0..mesh.len()).filter(|e| mesh.level(*e as u32) == level) {
            let surplus = shown[e] - at_centroid(&before, (&coarse, &nodes), mesh, e as u32);
            let area = open[e] * mesh.area(e as u32);
            // Of the standard error a part of the light has its share.
            let whole = color::mean(solution.reflected_radiosity(e));
            let share = if whole > 0.0 { (color::mean(shown[e]) / whole).clamp(0.0, 1.0) } else { 1.0 };
            let noise = solution.standard_error[e] * share;
            let noise = color::mean(noise * noise);
            errors[e] = area * color::mean(surplus * surplus);
            sums[parent[e]].0 += errors[e];
            sums[parent[e]].1 += area * if noise.is_finite() { noise } else { 0.0 };
        }
        for e in (0..mesh.len()).filter(|e| mesh.level(*e as u32) == level) {
            let (square, noise) = sums[parent[e]];
            if square > 0.0 {
                errors[e] *= (1.0 - noise / square).max(0.0);
            }
        }
    }
    Ok(errors)
}

/// A field of any mesh at the centroid of an element of another.
fn at_centroid(field: &Field, (of, nodes): (&Mesh, &Nodes), mesh: &Mesh, element: u32) -> Rgb {
    let (face, front, cell) = mesh.place(element);
    let uv = mesh.grid(face).centroid(cell);
    field.at(of, nodes, (face, front), uv.x as f32, uv.y as f32).unwrap_or_default()
}

/// What to do with the cells of a division, by (face, cell) in order.
pub struct Changes {
    /// Cells to divide: the fewest that leave to others that may be divided no more than a number of times the error that the finest
    /// mesh would have, were it all along edges.
    pub divide: Vec<(u32, u32)>,
    /// First quarters of cells that need not have been divided.
    pub join: Vec<(u32, u32)>,
    /// How many times what may be left there is now.
    pub excess: f64,
}

impl Changes {
    /// Changes by the elements' errors; `rest` is the number of times. The sides of a face share its cells.
    pub fn new(mesh: &Mesh, division: &Division, errors: &[f64], rest: f64) -> Changes {
        let mut own: HashMap<(u32, u32), f64> = HashMap::new();
        let mut cells: Vec<(f64, (u32, u32))> = Vec::new();
        let (mut left, mut final_error) = (0.0, 0.0);
        for e in 0..mesh.len() as u32 {
            let (face, front, cell) = mesh.place(e);
            if !front && mesh.first(face, true) != NONE {
                continue;
            }
            let behind = if front { mesh.opposite(e) } else { NONE };
            let error = errors[e as usize] + if behind == NONE { 0.0 } else { errors[behind as usize] };
            own.insert((face, cell), error);
            let levels = division.levels_left(face, cell);
            final_error += error * HALF.powi(levels.into());
            if error > 0.0 && levels > 0 {
                cells.push((error, (face, cell)));
                left += error;
            }
        }
        let allowed = rest * final_error;
        let excess = if left > 0.0 { left / allowed } else { 0.0 };
        cells.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut divide = Vec::new();
        for (error, at) in cells {
            if left <= allowed {
                break;
            }
            left -= error;
            divide.push(at);
        }
        divide.sort_unstable();
        let all =
            |(face, cell): (u32, u32)| -> f64 { (cell..cell + 4).filter_map(|c| own.get(&(face, c))).sum() };
        let mut quarters: Vec<_> = division.quarters().into_iter().map(|at| (all(at), at)).collect();
        quarters.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut join, mut lost) = (Vec::new(), 0.0);
        for (error, at) in quarters {
            lost += error;
            if lost > NEEDLESS * allowed {
                break;
            }
            join.push(at);
        }
        join.sort_unstable();
        Changes { divide, join, excess }
    }
}
