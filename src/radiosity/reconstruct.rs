//! From one value an element to a value at every point.
//!
//! Values are brought to the nodes that cells of one patch share, and interpolated between them:
//! bilinear on parallelograms, linear on triangles. So the result never mixes patches,
//! and is continuous over each as far as its nodes are shared (see [`Nodes`]).

use crate::color::Rgb;
use crate::mesh::{Mesh, NONE, Nodes};

/// Times that the nodes are corrected so that cells keep their means: plain averages flatten
/// gradients at the borders of a patch.
const CORRECTIONS: usize = 2;

/// A quantity on the nodes.
#[derive(Debug, Clone)]
pub struct Field {
    nodes: Vec<[f32; 3]>,
}

impl Field {
    /// Brings one value an element to the nodes; `open` is each element's uncovered share, its weight.
    /// Nodes never go below zero nor beyond the values of the cells around them by more than these differ.
    pub fn new(mesh: &Mesh, nodes: &Nodes, open: &[f64], values: &[Rgb]) -> Field {
        Field::corrected(mesh, nodes, open, values, CORRECTIONS)
    }

    /// Like [`Field::new`] without the correction, which would sharpen noise as well.
    pub fn smooth(mesh: &Mesh, nodes: &Nodes, open: &[f64], values: &[Rgb]) -> Field {
        Field::corrected(mesh, nodes, open, values, 0)
    }

    fn corrected(mesh: &Mesh, nodes: &Nodes, open: &[f64], values: &[Rgb], corrections: usize) -> Field {
        let corners: Vec<([usize; 4], f64)> = (0..mesh.len() as u32)
            .map(|e| {
                let (face, front, cell) = mesh.place(e);
                let grid = mesh.grid(face);
                let ids = grid.cell_nodes(cell).map(|k| nodes.id(face, front, k));
                (ids, if grid.is_triangle() { 3.0 } else { 4.0 })
            })
            .collect();
        // Near values count for more: those of smaller cells.
        let share: Vec<f64> =
            (0..mesh.len()).map(|e| open[e] * f64::from(1u32 << mesh.level(e as u32))).collect();
        let mut weight = vec![0.0; nodes.count()];
        let mut low = vec![Rgb::INFINITY; nodes.count()];
        let mut high = vec![Rgb::ZERO; nodes.count()];
        for (e, (ids, count)) in corners.iter().enumerate().filter(|(e, _)| open[*e] > 0.0) {
            for &id in &ids[..*count as usize] {
                weight[id] += share[e];
                low[id] = low[id].min(values[e]);
                high[id] = high[id].max(values[e]);
            }
        }
        let spread = |per_element: &dyn Fn(usize) -> Rgb| -> Vec<Rgb> {
            let mut sum = vec![Rgb::ZERO; nodes.count()];
            for (e, (ids, count)) in corners.iter().enumerate().filter(|(e, _)| open[*e] > 0.0) {
                let v = per_element(e) * share[e];
                for &id in &ids[..*count as usize] {
                    sum[id] += v;
                }
            }
            for (s, w) in sum.iter_mut().zip(&weight) {
                *s = if *w > 0.0 { *s / *w } else { Rgb::ZERO };
            }
            sum
        };
        let mut field = spread(&|e| values[e]);
        nodes.settle(&mut field);
        for _ in 0..corrections {
            let missing = spread(&|e| {
                let (ids, count) = &corners[e];
                values[e] - ids[..*count as usize].iter().map(|&id| field[id]).sum::<Rgb>() / *count
            });
            for (k, v) in field.iter_mut().enumerate().filter(|(k, _)| weight[*k] > 0.0) {
                let margin = high[k] - low[k];
                *v = (*v + missing[k]).clamp((low[k] - margin).max(Rgb::ZERO), high[k] + margin);
            }
            nodes.settle(&mut field);
        }
        Field { nodes: field.iter().map(|v| v.as_vec3().to_array()).collect() }
    }

    /// A field of known values.
    pub(super) fn of_nodes(nodes: Vec<[f32; 3]>) -> Field {
        Field { nodes }
    }

    /// The values on the nodes.
    pub(super) fn nodes(&self) -> &[[f32; 3]] {
        &self.nodes
    }

    /// The value at (u, v) of a side; none where the side has no elements.
    #[inline]
    pub fn at(&self, mesh: &Mesh, nodes: &Nodes, (face, front): (u32, bool), u: f32, v: f32) -> Option<Rgb> {
        if mesh.first(face, front) == NONE {
            return None;
        }
        let found = self.read(nodes, nodes.first(face, front), &mesh.grid(face).interpolation(u, v));
        Some(Rgb::new(found[0].into(), found[1].into(), found[2].into()))
    }

    /// The value between nodes of a side that has elements: `first` of [`Nodes::first`], and [`crate::mesh::Grid::interpolation`].
    #[inline]
    pub fn read(&self, nodes: &Nodes, first: u32, (local, weights): &([u32; 4], [f32; 4])) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for (local, weight) in local.iter().zip(weights) {
            let value = &self.nodes[nodes.number(first + local)];
            sum.iter_mut().zip(value).for_each(|(s, v)| *s += weight * v);
        }
        sum
    }
}
