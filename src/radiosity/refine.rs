//! How wrong the light of each element is: where an adaptive mesh needs finer ones.
//!
//! What a mesh whose cells are all a level coarser would have shown is known: the same light, averaged over its larger cells and
//! interpolated between them. How far that is from what the elements show (the hierarchical surplus, over all of an element: at its
//! centroid alone, smooth light is nearly right whatever the level) bounds what the next level
//! would change: by theory a quarter of it where light is smooth, a half across an edge, and so alike for elements that
//! compete. Of it, what the noise of the elements explains says nothing about their size.
//!
//! What elements send on is their mean light. It is sent wrong where an element is brighter in one part and what its parts send is worth
//! more in one ([`Importance`]): by the covariance of both, which a coarser cell has over its quarters. Behind a lamp close under a
//! ceiling, where what is sent is lost and no light arrives, that is what matters.

use super::{Field, Importance, Solution, share_of_error};
use crate::color::{self, Rgb};
use crate::mesh::{Division, Mesh, NONE, Nodes};
use crate::scene::Scene;
use glam::DVec2;
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

/// How wrong one element's light is, as the coarser level lets expect up to a factor that all have in common.
#[derive(Debug, Clone, Copy, Default)]
pub struct ElementError {
    /// What it adds to the relative squared error of all light and of the pictures where it is shown.
    pub shown: f64,
    /// What it makes wrong of the light elsewhere, in relation to that light.
    pub sent: f64,
}

impl ElementError {
    fn plus(self, other: ElementError, times: f64) -> ElementError {
        ElementError { shown: self.shown + times * other.shown, sent: self.sent + times * other.sent }
    }

    /// Squared relative error of a sum, were all that is sent wrong in the same sense.
    fn square(self) -> f64 {
        self.shown + self.sent * self.sent
    }
}

/// The errors of all elements; zero on elements of level 0. `division` is that of the solution's mesh.
///
/// # Errors
/// As [`Mesh::divided`].
pub fn element_errors(
    scene: &Scene,
    division: &Division,
    solution: &Solution,
    importance: &Importance,
    reads: Reads,
) -> crate::Result<Vec<ElementError>> {
    let mesh = &solution.mesh;
    let field = match reads {
        Reads::Reflected => &solution.reflected,
        Reads::Indirect => &solution.indirect,
    };
    let sides = mesh.sides();
    let Importance { area, shown: weight, .. } = importance;
    let shown: Vec<Rgb> =
        (0..mesh.len() as u32).map(|e| at_centroid(field, (mesh, &solution.nodes), mesh, e)).collect();
    let sent: Vec<Rgb> = (0..mesh.len()).map(|e| solution.reflected_radiosity(e)).collect();
    let share = |e: usize| share_of_error(shown[e], sent[e]);
    let noise: Vec<f64> =
        (0..mesh.len()).map(|e| color::mean(solution.standard_error[e]) * share(e)).collect();
    let mut errors = vec![ElementError::default(); mesh.len()];
    for level in 1..=division.deepest() {
        let (coarse, within) = division.truncated(level - 1);
        let coarse = Mesh::divided(scene, &sides, &coarse, false)?;
        let parent: Vec<usize> = (0..mesh.len() as u32)
            .map(|e| {
                let (face, front, cell) = mesh.place(e);
                (coarse.first(face, front) + within[face as usize][cell as usize]) as usize
            })
            .collect();
        let mut covered = vec![0.0; coarse.len()];
        parent.iter().zip(area).for_each(|(p, a)| covered[*p] += a);
        let shown_means = means(&parent, (area, &covered), &shown);
        let sent_wrong = sent_errors(&parent, (area, &covered), &sent, &importance.sent);
        let nodes = Nodes::new(scene, &coarse);
        let open: Vec<f64> =
            covered.iter().enumerate().map(|(p, area)| area / coarse.area(p as u32)).collect();
        let mut variance = vec![0.0; coarse.len()];
        for (e, p) in parent.iter().enumerate().filter(|(_, p)| covered[**p] > 0.0) {
            variance[*p] += (noise[e] * area[e] / covered[*p]).powi(2);
        }
        let before = Field::noisy(&coarse, &nodes, &open, &shown_means, &|p| variance[p].sqrt());
        // Sums over the quarters of each coarser cell: of the squares, and of what noise makes of them.
        let mut sums = vec![(0.0, 0.0); coarse.len()];
        for e in (0..mesh.len()).filter(|e| mesh.level(*e as u32) == level) {
            let fields = [(field, mesh, &solution.nodes), (&before, &coarse, &nodes)];
            let surplus = mean_square(mesh, e as u32, |face, u, v| {
                let [fine, before] =
                    fields.map(|(f, of, nodes)| f.at(of, nodes, face, u, v).unwrap_or_default());
                fine - before
            });
            let noise =
                color::mean(solution.standard_error[e] * solution.standard_error[e]) * share(e).powi(2);
            errors[e].shown = weight[e] * color::mean(surplus);
            sums[parent[e]].0 += errors[e].shown;
            sums[parent[e]].1 += weight[e] * if noise.is_finite() { noise } else { 0.0 };
            errors[e].sent = sent_wrong[e];
        }
        for e in (0..mesh.len()).filter(|e| mesh.level(*e as u32) == level) {
            let (square, noise) = sums[parent[e]];
            if square > 0.0 {
                errors[e].shown *= (1.0 - noise / square).max(0.0);
            }
        }
    }
    Ok(errors)
}

/// What the elements of a regular mesh make wrong of the light elsewhere, in relation to that light, as blocks of two by two let
/// expect.
pub fn block_errors(solution: &Solution, importance: &Importance) -> Vec<f64> {
    let (mesh, area) = (&solution.mesh, &importance.area);
    let mut numbers = HashMap::new();
    let number = |e: u32| {
        let (face, front, cell) = mesh.place(e);
        let next = numbers.len();
        *numbers.entry((face, front, mesh.grid(face).lattice.block(cell))).or_insert(next)
    };
    let block: Vec<usize> = (0..mesh.len() as u32).map(number).collect();
    let mut covered = vec![0.0; numbers.len()];
    block.iter().zip(area).for_each(|(b, a)| covered[*b] += a);
    let sent: Vec<Rgb> = (0..mesh.len()).map(|e| solution.reflected_radiosity(e)).collect();
    sent_errors(&block, (area, &covered), &sent, &importance.sent)
}

/// What elements make wrong of the light elsewhere that send the mean of what their `group` sends: the covariance with what power
/// sent from each is worth. Groups have the open areas `covered`, elements `area`.
fn sent_errors(group: &[usize], areas: (&[f64], &[f64]), sent: &[Rgb], worth: &[Rgb]) -> Vec<f64> {
    let (sent_means, worth_means) = (means(group, areas, sent), means(group, areas, worth));
    let error = |e: usize| {
        let product = (sent[e] - sent_means[group[e]]) * (worth[e] - worth_means[group[e]]);
        areas.0[e] * color::mean(product.abs())
    };
    (0..group.len()).map(error).collect()
}

/// Means over the open areas of groups.
fn means(group: &[usize], (area, covered): (&[f64], &[f64]), of: &[Rgb]) -> Vec<Rgb> {
    let mut sums = vec![Rgb::ZERO; covered.len()];
    for (e, g) in group.iter().enumerate() {
        sums[*g] += area[e] * of[e];
    }
    let mean = |(sum, area): (&Rgb, &f64)| if *area > 0.0 { *sum / *area } else { Rgb::ZERO };
    sums.iter().zip(covered).map(mean).collect()
}

/// Mean over an element of the square of what `f` gives by side and place, linear on triangles and bilinear on quads.
fn mean_square(mesh: &Mesh, element: u32, f: impl Fn((u32, bool), f32, f32) -> Rgb) -> Rgb {
    let (face, front, cell) = mesh.place(element);
    let grid = mesh.grid(face);
    let (o, a, b) = grid.cell_frame(cell);
    let at = |uv: DVec2| f((face, front), uv.x as f32, uv.y as f32);
    let (f0, fa, fb) = (at(o), at(o + a), at(o + b));
    if grid.is_triangle() {
        let sum = f0 + fa + fb;
        return (f0 * f0 + fa * fa + fb * fb + sum * sum) / 12.0;
    }
    let fab = at(o + a + b);
    // Simpson's rule along both edges, exact for what is bilinear and squared.
    let line = |p: Rgb, q: Rgb| p * p + q * q + (p + q) * (p + q);
    (line(f0, fa) + line(fb, fab) + line(f0 + fb, fa + fab)) / 36.0
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
    /// Changes by the elements' errors; `rest` is the number of times; without `joins` none is joined. The sides of a face share its
    /// cells.
    pub fn new(mesh: &Mesh, division: &Division, errors: &[ElementError], rest: f64, joins: bool) -> Changes {
        let mut own: HashMap<(u32, u32), ElementError> = HashMap::new();
        let mut cells: Vec<(ElementError, (u32, u32))> = Vec::new();
        let (mut left, mut finest) = (ElementError::default(), ElementError::default());
        for e in 0..mesh.len() as u32 {
            let (face, front, cell) = mesh.place(e);
            if !front && mesh.first(face, true) != NONE {
                continue;
            }
            let mut error = errors[e as usize];
            let behind = if front { mesh.opposite(e) } else { NONE };
            if behind != NONE {
                error = error.plus(errors[behind as usize], 1.0);
            }
            own.insert((face, cell), error);
            let levels = division.levels_left(face, cell);
            finest = finest.plus(error, HALF.powi(levels.into()));
            if levels > 0 {
                cells.push((error, (face, cell)));
                left = left.plus(error, 1.0);
            }
        }
        let allowed = rest * finest.square();
        let now = left.square();
        let excess = if now > 0.0 { now / allowed } else { 0.0 };
        // What a cell has of the squared error, to first order.
        let slope = 2.0 * left.sent;
        let part = |e: &ElementError| e.shown + slope * e.sent;
        cells.retain(|(e, _)| part(e) > 0.0);
        cells.sort_by(|a, b| part(&b.0).total_cmp(&part(&a.0)).then(a.1.cmp(&b.1)));
        let mut divide = Vec::new();
        for (error, at) in cells {
            if left.square() <= allowed {
                break;
            }
            left = left.plus(error, -1.0);
            divide.push(at);
        }
        divide.sort_unstable();
        let all = |(face, cell): (u32, u32)| -> f64 {
            (cell..cell + 4).filter_map(|c| own.get(&(face, c))).map(part).sum()
        };
        let quarters = if joins { division.quarters() } else { Vec::new() };
        let mut quarters: Vec<_> = quarters.into_iter().map(|at| (all(at), at)).collect();
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
