//! How wrong the light of each element is: where an adaptive mesh needs finer ones.
//!
//! Light is interpolated between the nodes of elements. What that misses along an edge of a cell, the second difference of the light
//! shown tells, by steps of that edge: over its cell, light that changes as a square is wrong by a mean square of a 120th of the
//! difference's. Of it, what the noise of the elements explains says nothing about their size. Beside the edge of a face, where
//! other faces meet it, light falls off faster than any square, and no difference can be taken about the last cell: what the next ones
//! say counts more there.
//!
//! What elements send on is their mean light. It is sent wrong where an element is brighter in one part and what its parts send is worth
//! more in one ([`Importance`]): by the covariance of both. Behind a lamp close under a
//! ceiling, where what is sent is lost and no light arrives, that is what matters.
//!
//! Errors are by how much those of a cell of twice the length would be larger, which is what joining it with its neighbour would cost.

use super::{Field, Importance, Solution, share_of_error};
use crate::color::{self, Rgb};
use crate::emitters::Emitters;
use crate::mesh::{CellFrame, Division, NONE, Siblings};
use glam::DVec2;
use rayon::prelude::*;
use std::collections::HashMap;

/// Mean square of what interpolation misses more over a cell of twice the length, over the squared second difference.
const MISSED: f64 = (4.0 - 1.0) * (4.0 - 1.0) / 120.0;

/// Covariance over a cell of twice the length, less that of the cell, over the product of the differences from end to end.
const COVARIANCE: f64 = (4.0 - 1.0) / 12.0;

/// Times that errors beside the edge of a quad count, where other faces meet it: those beside an edge of a triangle may have its
/// like behind it. Cornell box and corridor, quality mesh: with 1 a tenth to a fourth more elements at equal error.
const BESIDE_EDGE: f64 = 4.0;

/// Variance of a second difference of values of variance 1.
const OF_DIFFERENCE: f64 = 1.0 + 4.0 + 1.0;

/// Times its variance that a squared difference must be to say anything.
const SIGNIFICANT: f64 = 2.0;

/// Where Gauss's rule of two points has them on an interval of length 1 about 0.
const GAUSS: [f64; 2] = [-0.288_675_134_594_812_9, 0.288_675_134_594_812_9];

/// What pass 2 reads of pass 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reads {
    /// All reflected light ([`Solution::reflected`]).
    Reflected,
    /// What it does not sample from emitters anew ([`Solution::indirect`]).
    Indirect,
}

/// How wrong one element's light is for want of division along one edge, up to a factor that all have in common.
#[derive(Debug, Clone, Copy, Default)]
pub struct ElementError {
    /// What it adds to the relative squared error of all light and of the pictures where it is shown.
    pub shown: f64,
    /// What it makes wrong of the light elsewhere, in relation to that light.
    pub sent: f64,
    /// The same with its sign: what it adds to that light, or takes from it.
    pub net: f64,
}

impl ElementError {
    pub(super) fn plus(self, other: ElementError, times: f64) -> ElementError {
        ElementError {
            shown: self.shown + times * other.shown,
            sent: self.sent + times * other.sent,
            net: self.net + times * other.net,
        }
    }
}

/// A cell or one that several would make up: face, front side, members, and centroid and edges in (u, v).
struct Part<'a> {
    side: (u32, bool),
    members: &'a [u32],
    frame: CellFrame,
}

/// What tells the errors of a solution's elements.
pub struct Judge<'a> {
    solution: &'a Solution,
    importance: &'a Importance,
    /// What pictures show.
    field: &'a Field,
    /// All of the standard error is that of what pictures show.
    all_noise: bool,
    /// What sent power is worth.
    worth: Field,
}

impl Judge<'_> {
    /// Of elements and what they are worth.
    pub fn new<'a>(
        solution: &'a Solution,
        importance: &'a Importance,
        emitters: &Emitters,
        reads: Reads,
    ) -> Judge<'a> {
        let mesh = &solution.mesh;
        let field = match reads {
            Reads::Reflected => &solution.reflected,
            Reads::Indirect => &solution.indirect,
        };
        let open: Vec<f64> = (0..mesh.len()).map(|e| importance.area[e] / mesh.area(e as u32)).collect();
        let worth = Field::new(mesh, &solution.nodes, &open, &importance.sent);
        let all_noise = reads == Reads::Reflected || emitters.are_few();
        Judge { solution, importance, field, all_noise, worth }
    }

    /// The errors of all elements for want of division along either edge of their cells; those of a triangle, which are divided along
    /// both, are in the first. `division` is that of the solution's mesh.
    pub fn elements(&self, division: &Division) -> Vec<[ElementError; 2]> {
        let mesh = &self.solution.mesh;
        let of_element = |e: u32| {
            let (face, front, cell) = mesh.place(e);
            let grid = mesh.grid(face);
            let (_, a, b) = grid.cell_frame(cell);
            let part = Part { side: (face, front), members: &[cell], frame: (grid.centroid(cell), a, b) };
            let may = division.levels_left(face, cell).map(|levels| levels > 0);
            if grid.is_triangle() {
                [self.triangle(&part, may[0]), ElementError::default()]
            } else {
                [self.along(&part, 0, may[0]), self.along(&part, 1, may[1])]
            }
        };
        (0..mesh.len() as u32).into_par_iter().map(of_element).collect()
    }

    /// The error of the cell that siblings were divided from, were they joined, on both sides of their face.
    pub fn joined(&self, siblings: &Siblings) -> ElementError {
        let Siblings { face, cells, along } = siblings;
        let mesh = &self.solution.mesh;
        let grid = mesh.grid(*face);
        let centroid = cells.iter().map(|c| grid.centroid(*c)).sum::<DVec2>() / cells.len() as f64;
        let (_, a, b) = grid.cell_frame(cells[0]);
        let [u, v] = along.map(|joined| if joined { 2.0 } else { 1.0 });
        let sides = [true, false].into_iter().filter(|front| mesh.first(*face, *front) != NONE);
        let errors = sides.map(|front| {
            let part = Part { side: (*face, front), members: cells, frame: (centroid, u * a, v * b) };
            if grid.is_triangle() {
                self.triangle(&part, true)
            } else {
                self.along(&part, usize::from(along[1]), true)
            }
        });
        errors.fold(ElementError::default(), |sum, e| sum.plus(e, 1.0))
    }

    /// The error along an edge of a quad's cell, 0 or 1; where `divisible`, also of one that has not two others beside it.
    fn along(&self, part: &Part, edge: usize, divisible: bool) -> ElementError {
        let (centroid, a, b) = part.frame;
        let (along, across) = if edge == 0 { (a, b) } else { (b, a) };
        let square = GAUSS.map(|t| {
            let (difference, times) = self.second_difference(part, centroid + t * across, along, divisible);
            times * color::mean(difference * difference)
        });
        let [sent, net] = self.sent(part, along);
        ElementError { shown: self.shown(part, (square[0] + square[1]) / 2.0), sent, net }
    }

    /// The error along both edges of a triangle's cell.
    ///
    /// Between the corners of a triangle, what is missed at barycentric coordinates l is half the sum of `l_i l_k d_ik` with the second
    /// differences d along its three edges.
    fn triangle(&self, part: &Part, divisible: bool) -> ElementError {
        let (centroid, a, b) = part.frame;
        let differences = [a, b, b - a].map(|edge| {
            let (difference, times) = self.second_difference(part, centroid, edge, divisible);
            times.sqrt() * difference
        });
        let sum: Rgb = differences.iter().sum();
        let squares: Rgb = differences.iter().map(|d| d * d).sum();
        let square = color::mean(sum * sum + squares) / 6.0;
        let [along_a, along_b] = [a, b].map(|edge| self.sent(part, edge));
        let [sent, net] = [0, 1].map(|k| along_a[k] + along_b[k]);
        ElementError { shown: self.shown(part, square), sent, net }
    }

    /// What second differences of a mean `square` mean for what is shown.
    fn shown(&self, part: &Part, square: f64) -> f64 {
        let (solution, (centroid, ..)) = (self.solution, part.frame);
        let first = solution.mesh.first(part.side.0, part.side.1);
        let elements = || part.members.iter().map(|cell| (first + cell) as usize);
        let weight: f64 = elements().map(|e| self.importance.shown[e]).sum();
        if square <= 0.0 || weight <= 0.0 {
            return 0.0;
        }
        let shown = self.read(self.field, part.side, centroid);
        let variance = |e: usize| {
            let share =
                if self.all_noise { 1.0 } else { share_of_error(shown, solution.reflected_radiosity(e)) };
            color::mean(solution.standard_error[e] * solution.standard_error[e]) * share.powi(2)
        };
        let noise = elements().map(variance).sum::<f64>() / (part.members.len() as f64).powi(2);
        // Where noise hides what joining would cost, nothing is to be joined.
        let told = part.members.len() == 1 && noise.is_finite();
        let noise = if told { SIGNIFICANT * OF_DIFFERENCE * noise } else { 0.0 };
        MISSED * weight * (square - noise).max(0.0)
    }

    /// What sending the mean light of a cell makes wrong that changes along an edge: its size, and with its sign.
    fn sent(&self, part: &Part, edge: DVec2) -> [f64; 2] {
        let (centroid, ..) = part.frame;
        let change = |field: &Field| {
            let [a, b] = [-0.5, 0.5].map(|t| self.read(field, part.side, centroid + t * edge));
            b - a
        };
        let first = self.solution.mesh.first(part.side.0, part.side.1);
        let area: f64 = part.members.iter().map(|cell| self.importance.area[(first + cell) as usize]).sum();
        let product = change(&self.solution.reflected) * change(&self.worth);
        [color::mean(product.abs()), color::mean(product)].map(|mean| COVARIANCE * area * mean)
    }

    fn read(&self, field: &Field, side: (u32, bool), uv: DVec2) -> Rgb {
        let Solution { mesh, nodes, .. } = self.solution;
        field.at(mesh, nodes, side, uv.x as f32, uv.y as f32).unwrap_or_default()
    }

    /// The second difference of what is shown about a point by steps of `edge`, and how many times it counts.
    ///
    /// Where a step leads off the face or to an element that is covered, the difference is about the next point. Where both do, nothing
    /// but the difference from end to end is known, which says something of cells that may be divided alone.
    fn second_difference(&self, part: &Part, point: DVec2, edge: DVec2, divisible: bool) -> (Rgb, f64) {
        let (mesh, side) = (&self.solution.mesh, part.side);
        let triangle = mesh.grid(side.0).is_triangle();
        let at = |uv: DVec2| {
            let far = if triangle { uv.x + uv.y } else { uv.max_element() };
            let known = uv.min_element() >= 0.0
                && far <= 1.0
                && self.importance.area[mesh.element(side.0, side.1, uv.x as f32, uv.y as f32) as usize]
                    > 0.0;
            known.then(|| self.read(self.field, side, uv))
        };
        for shift in [0.0, 1.0, -1.0] {
            let values = [-1.0, 0.0, 1.0].map(|k| at(point + (k + shift) * edge));
            if let [Some(a), Some(b), Some(c)] = values {
                return (a - 2.0 * b + c, if shift == 0.0 || triangle { 1.0 } else { BESIDE_EDGE });
            }
        }
        // Just within the cell: rounding must not lead beyond the face.
        let ends = [-0.499, 0.499].map(|t| at(point + t * edge));
        match ends {
            [Some(a), Some(b)] if divisible => (b - a, BESIDE_EDGE),
            _ => (Rgb::ZERO, 0.0),
        }
    }
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
