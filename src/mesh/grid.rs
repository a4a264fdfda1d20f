//! The cells of one face: those of a regular lattice, or larger ones that its cells make up.

use super::lattice::{CellAt, CellFrame, Lattice, MOST_ALONG};
use super::{MOST_ELEMENTS, NONE};
use glam::DVec2;
use std::sync::Arc;

/// Most times that a cell of level 0 is divided along either edge.
pub(super) const MOST_LEVELS: u8 = 12;

/// How often a cell of level 0 was halved along u and along v; equal on a triangle, whose cells are quartered.
pub type Levels = [u8; 2];

/// A cell of an adaptive face: it has this place in the lattice of cells of its own size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    pub at: CellAt,
    pub levels: Levels,
}

/// The cells of one face.
///
/// An adaptive face has cells of several sizes: on a quad each is one of level 0 or a half of a larger one, on a triangle one of
/// level 0 or a quarter of a larger one, congruent to it. They are numbered by where they begin on the Z-order curve, triangles
/// depth first, so that neighbours have near numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// The cells of a regular face; of an adaptive one, the lattice of the finest of its cells over the whole face.
    pub lattice: Lattice,
    leaves: Option<Arc<Leaves>>,
}

/// The cells of an adaptive face.
#[derive(Debug, PartialEq)]
struct Leaves {
    /// Which cell a cell of the lattice is in.
    of: Vec<u32>,
    cells: Vec<Leaf>,
    /// (u, v) of the nodes.
    nodes: Vec<DVec2>,
}

/// A cell, in a lattice coarser by `2^shift` along u and v.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Leaf {
    cell: Cell,
    shift: Levels,
    corners: [u32; 4],
}

impl From<Lattice> for Grid {
    fn from(lattice: Lattice) -> Grid {
        Grid { lattice, leaves: None }
    }
}

impl Grid {
    /// The grid of these cells, which cover the lattice `base` of level 0 once; none where their finest are more than a scene may have.
    pub(super) fn divided(base: Lattice, cells: &[Cell]) -> Option<Grid> {
        let most = |axis: usize| cells.iter().map(|c| c.levels[axis]).max();
        let deepest = [most(0)?, most(1)?];
        if deepest == [0, 0] {
            return Some(base.into());
        }
        let [nu, nv] = [u64::from(base.nu) << deepest[0], u64::from(base.nv) << deepest[1]];
        if nu.max(nv) > u64::from(MOST_ALONG) || nu * nv > u64::from(MOST_ELEMENTS) {
            return None;
        }
        let lattice = Lattice { nu: nu as u32, nv: nv as u32, triangle: base.triangle };
        let leaf = |cell: &Cell| {
            let shift = [0, 1].map(|axis| deepest[axis] - cell.levels[axis]);
            Leaf { cell: *cell, shift, corners: [0; 4] }
        };
        let cells = cells.iter().map(leaf).collect();
        let mut leaves = Leaves { of: vec![NONE; lattice.len() as usize], cells, nodes: Vec::new() };
        leaves.number(&lattice);
        Some(Grid { lattice, leaves: Some(Arc::new(leaves)) })
    }

    /// Number of cells.
    pub fn len(&self) -> u64 {
        self.leaves.as_ref().map_or(self.lattice.len(), |l| l.cells.len() as u64)
    }

    /// Never true: a grid holds at least one cell.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The face is a triangle.
    #[inline]
    pub fn is_triangle(&self) -> bool {
        self.lattice.triangle
    }

    /// Cells may differ in size.
    #[inline]
    pub fn is_adaptive(&self) -> bool {
        self.leaves.is_some()
    }

    /// How often a cell of level 0 was divided for this one.
    pub fn levels(&self, cell: u32) -> Levels {
        self.leaves.as_ref().map_or([0, 0], |l| l.cells[cell as usize].cell.levels)
    }

    /// Share of the face that a cell has, in (u, v).
    pub fn share(&self, cell: u32) -> f64 {
        let whole = self.lattice.len() as f64;
        let cells = |l: &Arc<Leaves>| {
            let [u, v] = l.cells[cell as usize].shift;
            (1u64 << (u + v)) as f64
        };
        self.leaves.as_ref().map_or(1.0, cells) / whole
    }

    /// The cell at (u, v), both in [0, 1], u + v <= 1 on a triangle; rounding outside is clamped.
    #[inline]
    pub fn cell(&self, u: f32, v: f32) -> u32 {
        self.holding(self.lattice.cell(u, v))
    }

    /// The cell that a cell of the lattice is in.
    #[inline]
    pub fn holding(&self, cell: u32) -> u32 {
        self.leaves.as_ref().map_or(cell, |l| l.of[cell as usize])
    }

    /// A cell's origin and its two edge vectors in (u, v).
    pub fn cell_frame(&self, cell: u32) -> CellFrame {
        let Some(leaves) = &self.leaves else { return self.lattice.cell_frame(cell) };
        let leaf = &leaves.cells[cell as usize];
        let [nu, nv] = [self.lattice.nu >> leaf.shift[0], self.lattice.nv >> leaf.shift[1]];
        Lattice { nu, nv, ..self.lattice }.frame(leaf.cell.at)
    }

    /// (u, v) of a cell's point for (s, t) uniform in the unit square; uniform in (u, v).
    #[inline]
    pub fn cell_point(&self, frame: &CellFrame, s: f64, t: f64) -> DVec2 {
        self.lattice.cell_point(frame, s, t)
    }

    /// (u, v) of a cell's centroid.
    pub fn centroid(&self, cell: u32) -> DVec2 {
        let (o, a, b) = self.cell_frame(cell);
        o + (a + b) / if self.lattice.triangle { 3.0 } else { 2.0 }
    }

    /// Local node indices of a cell's corners, as in [`Lattice::cell_nodes`].
    pub fn cell_nodes(&self, cell: u32) -> [u32; 4] {
        match &self.leaves {
            None => self.lattice.cell_nodes(cell),
            Some(l) => l.cells[cell as usize].corners,
        }
    }

    /// Local nodes as in [`Grid::cell_nodes`] of the cell at (u, v) as in [`Grid::cell`], and their weights in linear
    /// (triangles; the last one is zero) or bilinear interpolation there.
    #[inline]
    pub fn interpolation(&self, u: f32, v: f32) -> ([u32; 4], [f32; 4]) {
        match &self.leaves {
            None => self.lattice.interpolation(u, v),
            Some(leaves) => leaves.interpolation(&self.lattice, u, v),
        }
    }

    /// Number of nodes.
    pub fn node_count(&self) -> u32 {
        self.leaves.as_ref().map_or(self.lattice.node_count(), |l| l.nodes.len() as u32)
    }

    /// (u, v) of every node, in the order of [`Grid::cell_nodes`].
    pub fn node_points(&self) -> Vec<DVec2> {
        self.leaves.as_ref().map_or_else(|| self.lattice.node_points().collect(), |l| l.nodes.clone())
    }

    /// Ends (local nodes) of cells' edges within which nodes of other cells may hang, each with its cell and with 0 along u, 1
    /// along v: along the borders of a regular face, all of an adaptive one.
    pub(super) fn open_edges(&self) -> Vec<(u32, usize, [u32; 2])> {
        let corners = if self.lattice.triangle { 3 } else { 4 };
        if let Some(leaves) = &self.leaves {
            let edges = |(k, leaf): (usize, &Leaf)| {
                let c = leaf.corners;
                (0..corners).map(move |e| (k as u32, e % 2, [c[e], c[(e + 1) % corners]]))
            };
            return leaves.cells.iter().enumerate().flat_map(edges).collect();
        }
        let node = |edge: usize, k: u32| self.lattice.edge_node(edge, k);
        let along = |edge: usize| {
            let ends = move |k| [node(edge, k), node(edge, k + 1)];
            (0..self.lattice.edge_cells(edge)).map(move |k| (NONE, edge % 2, ends(k)))
        };
        (0..corners).flat_map(along).collect()
    }
}

impl Leaves {
    #[inline]
    fn interpolation(&self, lattice: &Lattice, u: f32, v: f32) -> ([u32; 4], [f32; 4]) {
        let leaf = &self.cells[self.of[lattice.cell(u, v) as usize] as usize];
        let (iu, iv, inverted) = leaf.cell.at;
        let s = (u * (lattice.nu >> leaf.shift[0]) as f32 - iu as f32).clamp(0.0, 1.0);
        let t = (v * (lattice.nv >> leaf.shift[1]) as f32 - iv as f32).clamp(0.0, 1.0);
        let (p, q) = (1.0 - s, 1.0 - t);
        let weights = if !lattice.triangle {
            [p * q, s * q, s * t, p * t]
        } else if inverted {
            [(s + t - 1.0).max(0.0), p, q, 0.0]
        } else {
            [(p - t).max(0.0), s, t, 0.0]
        };
        (leaf.corners, weights)
    }

    /// Numbers the nodes, and enters every cell in the lattice.
    fn number(&mut self, lattice: &Lattice) {
        let mut ids = vec![NONE; lattice.node_count() as usize];
        for k in 0..self.cells.len() {
            let Leaf { cell: Cell { at: (iu, iv, inverted), .. }, shift, .. } = self.cells[k];
            enter(&mut self.of, lattice, (iu, iv, inverted), shift, k as u32);
            let corners = match (lattice.triangle, inverted) {
                (false, _) => [(iu, iv), (iu + 1, iv), (iu + 1, iv + 1), (iu, iv + 1)],
                (true, false) => [(iu, iv), (iu + 1, iv), (iu, iv + 1), (iu, iv + 1)],
                (true, true) => [(iu + 1, iv + 1), (iu, iv + 1), (iu + 1, iv), (iu + 1, iv)],
            };
            self.cells[k].corners = corners.map(|(iu, iv)| {
                let (iu, iv) = (iu << shift[0], iv << shift[1]);
                let id = &mut ids[lattice.node(iu, iv) as usize];
                if *id == NONE {
                    *id = self.nodes.len() as u32;
                    let uv = (f64::from(iu) / f64::from(lattice.nu), f64::from(iv) / f64::from(lattice.nv));
                    self.nodes.push(uv.into());
                }
                *id
            });
        }
    }
}

/// The four quarters of a triangle's cell, in a lattice of half the step.
pub(super) fn quarters((iu, iv, inverted): CellAt) -> [CellAt; 4] {
    let (u, v) = (2 * iu, 2 * iv);
    if inverted {
        [(u + 1, v + 1, true), (u, v + 1, true), (u + 1, v, true), (u + 1, v + 1, false)]
    } else {
        [(u, v, false), (u + 1, v, false), (u, v + 1, false), (u, v, true)]
    }
}

/// Enters a cell in those of the lattice that make it up.
fn enter(of: &mut [u32], lattice: &Lattice, at: CellAt, [shift_u, shift_v]: Levels, cell: u32) {
    if lattice.triangle && shift_u > 0 {
        let shift = [shift_u - 1, shift_v - 1];
        quarters(at).iter().for_each(|q| enter(of, lattice, *q, shift, cell));
        return;
    }
    let (iu, iv, inverted) = at;
    for v in iv << shift_v..(iv + 1) << shift_v {
        for u in iu << shift_u..(iu + 1) << shift_u {
            of[lattice.number((u, v, inverted)) as usize] = cell;
        }
    }
}
