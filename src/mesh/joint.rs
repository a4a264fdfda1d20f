//! Where faces continue each other, and where other faces stand on the edge between them.
//!
//! Light that is interpolated between nodes goes on from a face to one that continues it: from the floor before a doorway to that
//! behind it. Where a wall stands on their common edge, it must not: the light on either side of the wall has nothing to do with that on
//! the other. Nodes on such an edge are set apart by [`Sectors`]; about the free end of a wall faces stay connected.

use super::{Mesh, NONE};
use crate::scene::{Face, Scene};
use crate::sets::Sets;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

/// Cosine of the largest angle between faces of one plane (0.08 degrees).
const COPLANAR: f64 = 1.0 - 1e-6;
/// Distance to the plane of a wall up to which an edge lies in it, and to its edges, as a share of the scene's radius: files round to
/// some six digits.
const TOUCHING: f64 = 2e-6;
/// Cosine between a wall and what it stands on beyond which it is none, but a face that nearly continues it.
const SLANT: f64 = 0.999;
/// Pairs of an edge and a face beyond which only faces that have the whole edge in common are walls.
const MOST_PAIRS: usize = 1 << 23;

/// A place, rounded to a lattice ([`quantise`]).
pub(super) type Place = [i64; 3];

/// An edge that two faces have in common which continue each other.
pub(super) struct Joint {
    /// Face and edge number of either; they run along it in opposite directions.
    pub ends: [(u32, usize); 2],
    /// Parts on which other faces stand, from 0 to 1 along the first one's edge; apart from each other and in order.
    walls: Vec<[f64; 2]>,
}

impl Joint {
    /// Whether a wall stands on both sides of a point, 0 to 1 along the edge: that of an end of the edge needs but one.
    fn is_within_wall(&self, t: f64, eps: f64) -> bool {
        let within = |[a, b]: &[f64; 2]| (t > a + eps || *a <= eps) && (t < b - eps || *b >= 1.0 - eps);
        self.walls.iter().any(within)
    }

    /// Whether a wall stands on all of it.
    fn is_walled(&self, eps: f64) -> bool {
        self.walls.iter().any(|[a, b]| *a <= eps && *b >= 1.0 - eps)
    }

    /// Start and vector of the first one's edge.
    fn edge(&self, scene: &Scene) -> (DVec3, DVec3) {
        let (face, edge) = self.ends[0];
        let face = &scene.faces[face as usize];
        let corners = if face.is_triangle() { 3 } else { 4 };
        let [start, end] = [edge, (edge + 1) % corners].map(|c| scene.corner(face, c));
        (start, end - start)
    }
}

/// Nodes nearer to each other are one \[m\].
pub(super) fn quantum(scene: &Scene) -> f64 {
    1e-7 * scene.radius.max(f64::MIN_POSITIVE)
}

/// Rounds a position to a lattice; the irrational shift keeps decimal coordinates off its borders.
pub(super) fn quantise(p: DVec3, quantum: f64) -> Place {
    let q = p / quantum + DVec3::splat(0.381_966_011_250_105);
    [q.x.floor() as i64, q.y.floor() as i64, q.z.floor() as i64]
}

/// A patch number for each face, and the edges along which faces of a patch meet.
pub(super) fn patches(scene: &Scene) -> (Vec<u32>, Vec<Joint>) {
    let mut joints = Vec::new();
    let quantum = quantum(scene);
    let mut welded: FxHashMap<Place, u32> = FxHashMap::default();
    let weld: Vec<u32> = scene
        .vertices
        .iter()
        .map(|v| {
            let next = welded.len() as u32;
            *welded.entry(quantise(*v, quantum)).or_insert(next)
        })
        .collect();
    let ends = |face: &Face, c: usize| {
        let corners = if face.is_triangle() { 3 } else { 4 };
        (weld[face.vertices[c] as usize], weld[face.vertices[(c + 1) % corners] as usize])
    };
    let mut edges: FxHashMap<(u32, u32), Vec<(u32, usize)>> = FxHashMap::default();
    for (k, face) in scene.faces.iter().enumerate() {
        for c in 0..if face.is_triangle() { 3 } else { 4 } {
            let (a, b) = ends(face, c);
            // Neighbours of one orientation run along their common edge in opposite directions.
            if let Some(others) = edges.get(&(b, a)) {
                for &(other, corner) in others {
                    if continuous(scene, face, c, &scene.faces[other as usize], corner) {
                        joints.push(Joint { ends: [(k as u32, c), (other, corner)], walls: Vec::new() });
                    }
                }
            }
            edges.entry((a, b)).or_default().push((k as u32, c));
        }
    }
    let search = joints.len().saturating_mul(scene.faces.len()) <= MOST_PAIRS;
    joints.par_iter_mut().for_each(|joint| {
        let (face, edge) = joint.ends[0];
        let (a, b) = ends(&scene.faces[face as usize], edge);
        let on_it = [(a, b), (b, a)].into_iter().filter_map(|e| edges.get(&e)).flatten();
        joint.walls = if on_it.map(|(k, _)| *k).any(|k| is_wall(scene, joint, k)) {
            vec![[0.0, 1.0]]
        } else if search {
            walls(scene, joint)
        } else {
            Vec::new()
        };
    });
    let mut sets = Sets::new(scene.faces.len());
    for joint in &joints {
        let eps = TOUCHING * scene.radius / joint.edge(scene).1.length();
        if !joint.is_walled(eps) {
            sets.join(joint.ends[0].0, joint.ends[1].0);
        }
    }
    (sets.names(), joints)
}

/// Whether a face stands on the edge between two others, if it meets it.
fn is_wall(scene: &Scene, joint: &Joint, k: u32) -> bool {
    let normal = scene.faces[k as usize].normal;
    joint
        .ends
        .iter()
        .all(|(face, _)| *face != k && normal.dot(scene.faces[*face as usize].normal).abs() < SLANT)
}

/// The parts of the edge between two faces on which others stand.
fn walls(scene: &Scene, joint: &Joint) -> Vec<[f64; 2]> {
    let (start, along) = joint.edge(scene);
    let (near, length) = (TOUCHING * scene.radius, along.length());
    let mut parts: Vec<[f64; 2]> = Vec::new();
    for (k, face) in scene.faces.iter().enumerate() {
        let corner = scene.corner(face, 0);
        let height = |p: DVec3| (p - corner).dot(face.normal).abs();
        if height(start) > near || height(start + along) > near || !is_wall(scene, joint, k as u32) {
            continue;
        }
        let corners = if face.is_triangle() { 3 } else { 4 };
        let mut part = [0.0f64, 1.0];
        for c in 0..corners {
            let (p, q) = (scene.corner(face, c), scene.corner(face, (c + 1) % corners));
            let inward = face.normal.cross(q - p).normalize_or_zero();
            // Within the face at t where this is not below zero.
            let (from, change) = ((start - p).dot(inward) + near, along.dot(inward));
            if change.abs() <= near {
                part[1] = if from < 0.0 { -1.0 } else { part[1] };
            } else if change > 0.0 {
                part[0] = part[0].max(-from / change);
            } else {
                part[1] = part[1].min(-from / change);
            }
        }
        if (part[1] - part[0]) * length > 8.0 * near {
            parts.push(part);
        }
    }
    parts.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut apart: Vec<[f64; 2]> = Vec::new();
    for part in parts {
        match apart.last_mut() {
            Some(last) if part[0] <= last[1] + near / length => last[1] = last[1].max(part[1]),
            _ => apart.push(part),
        }
    }
    apart
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

/// Which faces of a patch are connected at nodes where a wall stands.
pub(super) struct Sectors {
    /// The faces that have a node at a place on a walled edge, and their sectors: above 0, and one for those connected there.
    at: FxHashMap<Place, Vec<(u32, u32)>>,
}

impl Sectors {
    /// For the nodes of a mesh.
    pub fn new(scene: &Scene, mesh: &Mesh, patches: &[u32], joints: &[Joint]) -> Sectors {
        let quantum = quantum(scene);
        let split = |j: &&Joint| {
            !j.walls.is_empty() && patches[j.ends[0].0 as usize] == patches[j.ends[1].0 as usize]
        };
        let split: Vec<&Joint> = joints.iter().filter(split).collect();
        let mut sectors = Sectors { at: FxHashMap::default() };
        if split.is_empty() {
            return sectors;
        }
        let points = |face: u32| {
            let frame = scene.face_frame(&scene.faces[face as usize]);
            let has_nodes = [true, false].iter().any(|front| mesh.first(face, *front) != NONE);
            let points = if has_nodes { mesh.grid(face).node_points() } else { Vec::new() };
            points.into_iter().map(move |uv| frame.at(uv))
        };
        let mut points_of: FxHashMap<Place, DVec3> = FxHashMap::default();
        for (joint, face) in split.iter().flat_map(|j| j.ends.map(|e| (j, e.0))) {
            let within = |p: &DVec3| passes(scene, joint, *p) == Some(true);
            points_of.extend(points(face).filter(within).map(|p| (quantise(p, quantum), p)));
        }
        let torn: FxHashSet<u32> = split.iter().map(|j| patches[j.ends[0].0 as usize]).collect();
        for face in (0..scene.faces.len() as u32).filter(|f| torn.contains(&patches[*f as usize])) {
            for place in points(face).map(|p| quantise(p, quantum)) {
                if points_of.contains_key(&place) {
                    sectors.at.entry(place).or_default().push((face, 0));
                }
            }
        }
        let mut joints_of: FxHashMap<u32, Vec<&Joint>> = FxHashMap::default();
        for joint in joints.iter().filter(|j| torn.contains(&patches[j.ends[0].0 as usize])) {
            joints_of.entry(joint.ends[0].0).or_default().push(joint);
        }
        for (place, faces) in &mut sectors.at {
            let mut sets = Sets::new(faces.len());
            for k in 0..faces.len() {
                for joint in joints_of.get(&faces[k].0).into_iter().flatten() {
                    let other = faces.iter().position(|f| f.0 == joint.ends[1].0);
                    if let (Some(other), Some(false)) = (other, passes(scene, joint, points_of[place])) {
                        sets.join(k as u32, other as u32);
                    }
                }
            }
            for k in 0..faces.len() {
                faces[k].1 = 1 + faces[sets.find(k as u32) as usize].0;
            }
        }
        sectors
    }

    /// The sector of a face at a place: 0 where no wall stands.
    pub fn of(&self, face: u32, place: &Place) -> u32 {
        let Some(faces) = self.at.get(place) else { return 0 };
        // A face without a node there has a sector of its own: a wall is on all its sides.
        faces.iter().find(|f| f.0 == face).map_or(1 + face, |f| f.1)
    }
}

/// Whether there is a wall where an edge passes a point; none where it does not.
fn passes(scene: &Scene, joint: &Joint, p: DVec3) -> Option<bool> {
    let (start, along) = joint.edge(scene);
    let (near, length) = (TOUCHING * scene.radius, along.length());
    let t = (p - start).dot(along) / (length * length);
    let eps = near / length;
    let meets = t >= -eps && t <= 1.0 + eps && (start + t * along - p).length() <= near;
    meets.then(|| joint.is_within_wall(t, 2.0 * eps))
}
