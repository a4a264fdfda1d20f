//! Grid nodes shared between the cells of one smooth surface.
//!
//! A node is shared by cells of the same patch only: faces that meet along an edge, have the same
//! material and lie in one plane (or carry equal shading normals along the edge). So a value that
//! is interpolated between nodes never bleeds over a crease, between materials, under a wall that stands on the edge or to the far
//! side, and it is continuous over each patch elsewhere: where neighbours divide their common edge differently, the
//! finer one's nodes on the edge hang between the nodes of the coarser one.

use super::joint::{Joint, Place, Sectors, patches, quantise, quantum};
use super::{Lattice, Mesh, NONE, side_index};
use crate::color::Rgb;
use crate::scene::Scene;
use crate::sets::Sets;
use glam::DVec3;
use rustc_hash::FxHashMap;

/// Global node numbers of every side that has elements.
#[derive(Debug, Clone)]
pub struct Nodes {
    /// Start of each side's nodes in `ids`, or [`NONE`].
    first: Vec<u32>,
    ids: Vec<u32>,
    count: usize,
    /// In the order in which they are set: ends before what hangs between them.
    hanging: Vec<Hanging>,
    /// Cells (by face) whose neighbours over some edge have less than half its length, and which edge: 0 along u, 1 along v.
    pub(super) steep: Vec<(u32, u32, usize)>,
}

/// A node within a coarser neighbour's edge: its value is the mean of two nodes of that edge.
#[derive(Debug, Clone, Copy)]
struct Hanging {
    node: u32,
    ends: [u32; 2],
}

/// Patch, side and place of a node, and where a wall stands its sector ([`Sectors`]).
type Key = (u32, bool, Place, u32);

impl Nodes {
    /// Numbers the nodes of a mesh.
    pub fn new(scene: &Scene, mesh: &Mesh) -> Nodes {
        let (patches, joints) = patches(scene);
        let quantum = quantum(scene);
        let sectors = Sectors::new(scene, mesh, &patches, &joints);
        let mut seen: FxHashMap<Key, u32> = FxHashMap::default();
        let (mut first, mut ids) = (vec![NONE; 2 * scene.faces.len()], Vec::new());
        for (k, face) in scene.faces.iter().enumerate() {
            let frame = scene.face_frame(face);
            for front in [true, false] {
                if mesh.first(k as u32, front) == NONE {
                    continue;
                }
                first[side_index(k as u32, front)] = ids.len() as u32;
                for uv in mesh.grid(k as u32).node_points() {
                    let place = quantise(frame.at(uv), quantum);
                    let key = (patches[k], front, place, sectors.of(k as u32, &place));
                    let next = seen.len() as u32;
                    ids.push(*seen.entry(key).or_insert(next));
                }
            }
        }
        let count = seen.len();
        let mut nodes = Nodes { first, ids, count, hanging: Vec::new(), steep: Vec::new() };
        for face in uneven(mesh, &joints) {
            let key = |front: bool, place: DVec3| {
                let place = quantise(place, quantum);
                (patches[face as usize], front, place, sectors.of(face, &place))
            };
            nodes.hang(scene, mesh, face, key, &seen);
        }
        nodes.order();
        nodes
    }

    /// Finds the nodes that hang within the edges of a face's cells.
    fn hang(
        &mut self,
        scene: &Scene,
        mesh: &Mesh,
        face: u32,
        key: impl Fn(bool, DVec3) -> Key,
        seen: &FxHashMap<Key, u32>,
    ) {
        let frame = scene.face_frame(&scene.faces[face as usize]);
        let grid = mesh.grid(face);
        let points = grid.node_points();
        let edges = grid.open_edges();
        for front in [true, false].into_iter().filter(|front| mesh.first(face, *front) != NONE) {
            for (cell, axis, ends) in &edges {
                // Halves of the edge, and halves of these wherever a node divides them.
                let whole = ends.map(|e| (self.id(face, front, e) as u32, points[e as usize]));
                let mut pending = vec![(whole, 1)];
                while let Some(([a, b], depth)) = pending.pop() {
                    let uv = 0.5 * (a.1 + b.1);
                    let Some(&node) = seen.get(&key(front, frame.at(uv))) else { continue };
                    self.hanging.push(Hanging { node, ends: [a.0, b.0] });
                    if depth > 1 {
                        self.steep.push((face, *cell, *axis));
                    }
                    pending.extend([([a, (node, uv)], depth + 1), ([(node, uv), b], depth + 1)]);
                }
            }
        }
    }

    /// Puts the hanging nodes into the order in which they are set, each once.
    fn order(&mut self) {
        let mut free = vec![true; self.count];
        let mut pending: Vec<Hanging> = Vec::with_capacity(self.hanging.len());
        for h in self.hanging.drain(..) {
            // The edge between two cells of one size is found from both.
            if std::mem::replace(&mut free[h.node as usize], false) {
                pending.push(h);
            }
        }
        while !pending.is_empty() {
            let (ready, rest): (Vec<_>, Vec<_>) =
                pending.into_iter().partition(|h| h.ends.iter().all(|e| free[*e as usize]));
            if ready.is_empty() {
                // Nodes that hang on each other in a circle belong to no surface that can be divided so.
                self.hanging.extend(rest);
                return;
            }
            ready.iter().for_each(|h| free[h.node as usize] = true);
            self.hanging.extend(ready);
            pending = rest;
        }
    }

    /// Sets hanging nodes to what their coarser neighbours say.
    pub fn settle(&self, values: &mut [Rgb]) {
        for h in &self.hanging {
            let [a, b] = h.ends.map(|e| values[e as usize]);
            values[h.node as usize] = 0.5 * (a + b);
        }
    }

    /// Number of distinct nodes.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The node with local index `local` ([`super::Grid::cell_nodes`]) of a side that has elements.
    #[inline]
    pub fn id(&self, face: u32, front: bool, local: u32) -> usize {
        self.number(self.first(face, front) + local)
    }

    /// Where the nodes of a side begin, or [`NONE`]: to be added to a local index for [`Nodes::number`].
    #[inline]
    pub fn first(&self, face: u32, front: bool) -> u32 {
        self.first[side_index(face, front)]
    }

    /// The node at a place that [`Nodes::first`] leads to.
    #[inline]
    pub fn number(&self, place: u32) -> usize {
        self.ids[place as usize] as usize
    }
}

/// Faces that have a neighbour whose cells along the common edge may be finer, and those that are adaptive themselves.
fn uneven(mesh: &Mesh, joints: &[Joint]) -> Vec<u32> {
    let mut uneven: Vec<u32> = Vec::new();
    for joint in joints {
        let [a, b] = joint.ends.map(|(face, edge)| {
            let grid = mesh.grid(face);
            (grid.lattice.edge_cells(edge), grid.is_adaptive())
        });
        if a.1 || b.1 || a.0 != b.0 {
            uneven.extend(joint.ends.map(|(face, _)| face));
        }
    }
    uneven.extend((0..mesh.grids.len() as u32).filter(|k| mesh.grid(*k).is_adaptive()));
    uneven.sort_unstable();
    uneven.dedup();
    uneven
}

/// Makes the numbers of cells along the edges of each patch multiples of each other by powers of two, none
/// smaller than before: only then can a hanging node follow a coarser neighbour exactly.
pub(super) fn nest(scene: &Scene, grids: &mut [Lattice]) {
    let (_, joints) = patches(scene);
    // Opposite edges of a quad, and all edges of a triangle, have equal numbers of cells.
    let direction = |grids: &[Lattice], (face, edge): (u32, usize)| {
        2 * face + u32::from(!grids[face as usize].triangle && edge % 2 == 1)
    };
    let mut sets = Sets::new(2 * grids.len());
    for joint in &joints {
        let [a, b] = joint.ends.map(|end| direction(grids, end));
        sets.join(a, b);
    }
    let set = sets.names();
    let mut range = vec![(u32::MAX, 0u32); set.len()];
    for (k, set) in set.iter().enumerate() {
        let grid = &grids[k / 2];
        let cells = if k % 2 == 0 { grid.nu } else { grid.nv };
        let r = &mut range[*set as usize];
        *r = (r.0.min(cells), r.1.max(cells));
    }
    for (k, set) in set.iter().enumerate() {
        let (least, most) = range[*set as usize];
        let smallest = most.div_ceil(1 << (most / least).ilog2());
        let grid = &mut grids[k / 2];
        let cells = if k % 2 == 0 { &mut grid.nu } else { &mut grid.nv };
        let wanted = *cells;
        *cells = smallest;
        while *cells < wanted {
            *cells *= 2;
        }
        if grid.triangle {
            grid.nv = grid.nu;
        }
    }
}
