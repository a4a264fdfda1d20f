//! Grid nodes shared between the cells of one smooth surface.
//!
//! A node is shared by cells of the same patch only: faces that meet along an edge, have the same
//! material and lie in one plane (or carry equal shading normals along the edge). So a value that
//! is interpolated between nodes never bleeds over a crease, between materials or to the far side,
//! and it is continuous over each patch: where neighbours divide their common edge differently, the
//! finer one's nodes on the edge hang between the nodes of the coarser one.

use super::{Lattice, Mesh, NONE, side_index};
use crate::color::Rgb;
use crate::scene::{Face, Scene};
use crate::sets::Sets;
use glam::DVec3;
use rustc_hash::FxHashMap;

/// Cosine of the largest angle between faces of one plane (0.08 degrees).
const COPLANAR: f64 = 1.0 - 1e-6;

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

/// Patch, side and place of a node.
type Key = (u32, bool, [i64; 3]);

/// An edge that two faces of a patch share: face and edge number of either, which run along it in
/// opposite directions.
type Joint = [(u32, usize); 2];

impl Nodes {
    /// Numbers the nodes of a mesh.
    pub fn new(scene: &Scene, mesh: &Mesh) -> Nodes {
        let (patches, joints) = patches(scene);
        let quantum = 1e-7 * scene.radius.max(f64::MIN_POSITIVE);
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
                    let key = (patches[k], front, quantise(frame.at(uv), quantum));
                    let next = seen.len() as u32;
                    ids.push(*seen.entry(key).or_insert(next));
                }
            }
        }
        let count = seen.len();
        let mut nodes = Nodes { first, ids, count, hanging: Vec::new(), steep: Vec::new() };
        for face in uneven(mesh, &joints) {
            nodes.hang(scene, mesh, face, (patches[face as usize], quantum), &seen);
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
        (patch, quantum): (u32, f64),
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
                    let key = (patch, front, quantise(frame.at(uv), quantum));
                    let Some(&node) = seen.get(&key) else { continue };
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
        let [a, b] = joint.map(|(face, edge)| {
            let grid = mesh.grid(face);
            (grid.lattice.edge_cells(edge), grid.is_adaptive())
        });
        if a.1 || b.1 || a.0 != b.0 {
            uneven.extend(joint.map(|(face, _)| face));
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
        let [a, b] = joint.map(|end| direction(grids, end));
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

/// Rounds a position to a lattice; the irrational shift keeps decimal coordinates off its borders.
fn quantise(p: DVec3, quantum: f64) -> [i64; 3] {
    let q = p / quantum + DVec3::splat(0.381_966_011_250_105);
    [q.x.floor() as i64, q.y.floor() as i64, q.z.floor() as i64]
}

/// A patch number for each face, and the edges along which faces of a patch meet.
fn patches(scene: &Scene) -> (Vec<u32>, Vec<Joint>) {
    let mut joints = Vec::new();
    let quantum = 1e-7 * scene.radius.max(f64::MIN_POSITIVE);
    let mut welded: FxHashMap<[i64; 3], u32> = FxHashMap::default();
    let weld: Vec<u32> = scene
        .vertices
        .iter()
        .map(|v| {
            let next = welded.len() as u32;
            *welded.entry(quantise(*v, quantum)).or_insert(next)
        })
        .collect();
    let mut sets = Sets::new(scene.faces.len());
    let mut edges: FxHashMap<(u32, u32), Vec<(u32, usize)>> = FxHashMap::default();
    for (k, face) in scene.faces.iter().enumerate() {
        let corners = if face.is_triangle() { 3 } else { 4 };
        for c in 0..corners {
            let (a, b) = (weld[face.vertices[c] as usize], weld[face.vertices[(c + 1) % corners] as usize]);
            // Neighbours of one orientation run along their common edge in opposite directions.
            if let Some(others) = edges.get(&(b, a)) {
                for &(other, corner) in others {
                    if continuous(scene, face, c, &scene.faces[other as usize], corner) {
                        sets.join(k as u32, other);
                        joints.push([(k as u32, c), (other, corner)]);
                    }
                }
            }
            edges.entry((a, b)).or_default().push((k as u32, c));
        }
    }
    (sets.names(), joints)
}

/// Whether radiosity is continuous from `a` to `b` over the edge that starts at the given corners.
fn continuous(scene: &Scene, a: &Face, ca: usize, b: &Face, cb: usize) -> bool {
    if a.material != b.material {
        return false;
    }
    if a.polygon == b.polygon || a.normal.dot(b.normal) > COPLANAR {
        return true;
    }
    let (Some(na), Some(nb)) = (a.normals, b.normals) else { return false };
    let at = |normals: [u32; 4], face: &Face, c: usize| {
        let corners = if face.is_triangle() { 3 } else { 4 };
        scene.normals[normals[c % corners] as usize]
    };
    let same = |x: DVec3, y: DVec3| x.dot(y) > 1.0 - 1e-4;
    a.normal.dot(b.normal) > 0.5
        && same(at(na, a, ca), at(nb, b, cb + 1))
        && same(at(na, a, ca + 1), at(nb, b, cb))
}
