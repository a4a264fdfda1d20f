//! The cells of one face: those of a regular lattice, or larger ones that its cells make up.

use super::lattice::{CellAt, CellFrame, Lattice, MOST_ALONG};
use super::{MOST_ELEMENTS, NONE};
use glam::DVec2;
use std::sync::Arc;

/// Most times that a cell of level 0 is divided.
pub(super) const MOST_LEVELS: u8 = 12;

/// The cells of one face.
///
/// An adaptive face has cells of several levels: each is one of level 0 or a quarter of one of the level below, congruent to
/// it. They are numbered depth first, so that neighbours have near numbers.
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

/// A cell: a lattice coarser by `2^shift` has it at (`iu`, `iv`).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Leaf {
    iu: u32,
    iv: u32,
    inverted: bool,
    shift: u8,
    level: u8,
    corners: [u32; 4],
}

impl From<Lattice> for Grid {
    fn from(lattice: Lattice) -> Grid {
        Grid { lattice, leaves: None }
    }
}

impl Grid {
    /// The grid whose cells have these levels, depth first, over a lattice of level 0; none where they do not fit it, or are
    /// more than a scene may have.
    pub(super) fn divided(base: Lattice, levels: &[u8]) -> Option<Grid> {
        let deepest = levels.iter().copied().max()?;
        if deepest == 0 {
            return (levels.len() as u64 == base.len()).then(|| base.into());
        }
        if deepest > MOST_LEVELS || base.len() << (2 * deepest) > u64::from(MOST_ELEMENTS) {
            return None;
        }
        let lattice = Lattice { nu: base.nu << deepest, nv: base.nv << deepest, triangle: base.triangle };
        if lattice.nu.max(lattice.nv) > MOST_ALONG {
            return None;
        }
        let mut cells = Vec::with_capacity(levels.len());
        let mut rest = levels.iter().copied().peekable();
        for cell in 0..base.len() as u32 {
            grow(base.triangle, (base.at(cell), 0), deepest, &mut rest, &mut cells)?;
        }
        if rest.next().is_some() {
            return None;
        }
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
    pub fn level(&self, cell: u32) -> u8 {
        self.leaves.as_ref().map_or(0, |l| l.cells[cell as usize].level)
    }

    /// Share of the face that a cell has, in (u, v).
    pub fn share(&self, cell: u32) -> f64 {
        let whole = self.lattice.len() as f64;
        self.leaves.as_ref().map_or(1.0, |l| (1u64 << (2 * l.cells[cell as usize].shift)) as f64) / whole
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
        self.coarser(leaf.shift).frame((leaf.iu, leaf.iv, leaf.inverted))
    }

    fn coarser(&self, shift: u8) -> Lattice {
        Lattice { nu: self.lattice.nu >> shift, nv: self.lattice.nv >> shift, ..self.lattice }
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

    /// Ends (local nodes) of cells' edges within which nodes of other cells may hang, each with its cell: along the borders of
    /// a regular face, all of an adaptive one.
    pub(super) fn open_edges(&self) -> Vec<(u32, [u32; 2])> {
        let corners = if self.lattice.triangle { 3 } else { 4 };
        if let Some(leaves) = &self.leaves {
            let edges = |(k, leaf): (usize, &Leaf)| {
                let c = leaf.corners;
                (0..corners).map(move |e| (k as u32, [c[e], c[(e + 1) % corners]]))
            };
            return leaves.cells.iter().enumerate().flat_map(edges).collect();
        }
        let node = |edge: usize, k: u32| self.lattice.edge_node(edge, k);
        let along = |edge: usize| {
            (0..self.lattice.edge_cells(edge)).map(move |k| (NONE, [node(edge, k), node(edge, k + 1)]))
        };
        (0..corners).flat_map(along).collect()
    }
}

impl Leaves {
    #[inline]
    fn interpolation(&self, lattice: &Lattice, u: f32, v: f32) -> ([u32; 4], [f32; 4]) {
        let leaf = &self.cells[self.of[lattice.cell(u, v) as usize] as usize];
        let s = (u * (lattice.nu >> leaf.shift) as f32 - leaf.iu as f32).clamp(0.0, 1.0);
        let t = (v * (lattice.nv >> leaf.shift) as f32 - leaf.iv as f32).clamp(0.0, 1.0);
        let (p, q) = (1.0 - s, 1.0 - t);
        let weights = if !lattice.triangle {
            [p * q, s * q, s * t, p * t]
        } else if leaf.inverted {
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
            let Leaf { iu, iv, inverted, shift, .. } = self.cells[k];
            enter(&mut self.of, lattice, (iu, iv, inverted), shift, k as u32);
            let corners = match (lattice.triangle, inverted) {
                (false, _) => [(iu, iv), (iu + 1, iv), (iu + 1, iv + 1), (iu, iv + 1)],
                (true, false) => [(iu, iv), (iu + 1, iv), (iu, iv + 1), (iu, iv + 1)],
                (true, true) => [(iu + 1, iv + 1), (iu, iv + 1), (iu + 1, iv), (iu + 1, iv)],
            };
            self.cells[k].corners = corners.map(|(iu, iv)| {
                let (iu, iv) = (iu << shift, iv << shift);
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

/// The four quarters of a cell, in a lattice of half the step.
fn quarters(triangle: bool, (iu, iv, inverted): CellAt) -> [CellAt; 4] {
    let (u, v) = (2 * iu, 2 * iv);
    match (triangle, inverted) {
        (false, _) => [(u, v, false), (u + 1, v, false), (u, v + 1, false), (u + 1, v + 1, false)],
        (true, false) => [(u, v, false), (u + 1, v, false), (u, v + 1, false), (u, v, true)],
        (true, true) => [(u + 1, v + 1, true), (u, v + 1, true), (u + 1, v, true), (u + 1, v + 1, false)],
    }
}

/// Takes the cells within one of level `level` from the levels that are left.
fn grow(
    triangle: bool,
    (at, level): (CellAt, u8),
    deepest: u8,
    rest: &mut std::iter::Peekable<impl Iterator<Item = u8>>,
    cells: &mut Vec<Leaf>,
) -> Option<()> {
    match *rest.peek()? {
        l if l < level => None,
        l if l == level => {
            rest.next();
            let (iu, iv, inverted) = at;
            cells.push(Leaf { iu, iv, inverted, shift: deepest - level, level, corners: [0; 4] });
            Some(())
        }
        _ => quarters(triangle, at)
            .iter()
            .try_for_each(|q| grow(triangle, (*q, level + 1), deepest, rest, cells)),
    }
}

/// Enters a cell in those of the lattice that make it up.
fn enter(of: &mut [u32], lattice: &Lattice, at: CellAt, shift: u8, cell: u32) {
    if shift == 0 {
        of[lattice.number(at) as usize] = cell;
        return;
    }
    quarters(lattice.triangle, at).iter().for_each(|q| enter(of, lattice, *q, shift - 1, cell));
}
