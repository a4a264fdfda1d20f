//! Faces divided along the lines on which others stand.
//!
//! Elements that lie half within a room and half outside of it have the mean light of both, and interpolated light passes under the
//! wall: a ground on which a house of sheets stands lights its rooms. So a face is divided where a wall stands on it or passes through
//! it (Baum, Mann, Smith and Winget 1991, section 4.2): from border to border, that its parts meet along whole edges.
//!
//! Closed bodies hide what they stand on: no light is in there that could come out, and elements half below them have the light of the
//! other half. They divide nothing, unless they have a lamp inside.

use super::coplanar::{Pieces, corners, replace};
use super::faces::Made;
use super::{Face, Material, polygon};
use crate::sets::Sets;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

/// Distance up to which a point lies in a plane or on a line, as a share of the scene's radius: files round to some six digits.
const TOUCHING: f64 = 2e-6;
/// Cosine between two faces beyond which none stands on the other.
const SLANT: f64 = 0.999;
/// Part of a line through a face on which others must stand: a ball that is sunk in a floor would cut it to slivers.
const LEAST_SHARE: f64 = 0.1;
/// How far from the face they must reach, as a share of the scene's radius: frames and legs of furniture part no rooms, and the scenes of
/// this project with many of them had up to twice as many faces.
const LEAST_HEIGHT: f64 = 0.1;
/// Most lines that divide a face, those on which others stand longest.
const MOST_LINES: usize = 16;
/// A face is not divided where a part would have less than this share of it.
const LEAST_PART: f64 = 1e-5;
/// Nor where its parts would have so many times its elements, and so many more: a slender triangle is divided as finely across as along.
const MOST_ELEMENTS: (f64, f64) = (2.0, 64.0);
/// Scenes of more faces are left as they are: every face is looked at from every other.
const MOST_FACES: usize = 4096;

/// Keeps decimal coordinates off the borders of a lattice.
const SHIFT: f64 = 0.381_966_011_250_105;

/// A line through a face.
struct Line {
    origin: DVec3,
    along: DVec3,
    /// Parts on which others stand, from the origin along it \[m\].
    parts: Vec<[f64; 2]>,
}

/// Divides diffuse faces without shading normals; new points are added to `points`.
pub(super) fn divide(faces: &mut Vec<Face>, points: &mut Vec<DVec3>, materials: &[Material]) {
    if faces.len() > MOST_FACES {
        return;
    }
    let used = || faces.iter().flat_map(|f| f.vertices).map(|v| points[v as usize]);
    let (low, high) =
        (used().fold(DVec3::INFINITY, DVec3::min), used().fold(DVec3::NEG_INFINITY, DVec3::max));
    let radius = 0.5 * (high - low).length();
    let (near, least) = (TOUCHING * radius, LEAST_HEIGHT * radius);
    let outlines: Vec<Vec<DVec3>> = faces.iter().map(|f| corners(f, points)).collect();
    let bodies = Bodies::new(faces, &outlines, materials, near);
    // That of elements where none is asked for.
    let size = (faces.iter().map(|f| f.area).sum::<f64>() / 3000.0).sqrt();
    let pieces = |(k, face): (usize, &Face)| {
        let material = &materials[face.material as usize];
        if !material.is_diffuse() || material.is_emitter() || face.normals.is_some() {
            return None;
        }
        let mut parting: FxHashMap<u32, bool> = FxHashMap::default();
        let mut parts = |other: usize| {
            let (body, plane) = (bodies.of[other], (outlines[k][0], face.normal));
            let parts = || bodies.height(body, plane) >= least && !bodies.is_closed_by(body, plane, near);
            *parting.entry(body).or_insert_with(parts)
        };
        let stands = |(other, f): &(usize, &Face)| f.normal.dot(face.normal).abs() < SLANT && parts(*other);
        let chord = |(other, _): (usize, &Face)| chord(face, &outlines[k], &outlines[other], near);
        let meets = |(other, _): &(usize, &Face)| meets(&outlines[*other], outlines[k][0], face.normal, near);
        let stand = faces.iter().enumerate().filter(meets).filter(stands).filter_map(chord);
        let pieces = cut(face, &outlines[k], lines(face, &outlines[k], stand, near), (near, size));
        let made = Made { object: face.object, material: face.material };
        (pieces.len() > 1).then(|| (k as u32, pieces.into_iter().map(|p| (p, made)).collect()))
    };
    let divided: Vec<(u32, Pieces)> = faces.par_iter().enumerate().filter_map(pieces).collect();
    if !divided.is_empty() {
        replace(faces, points, divided);
    }
}

/// A corner, rounded to a lattice.
type Corner = [i64; 3];

/// Faces that hang together by their edges.
struct Bodies {
    /// The body of each face.
    of: Vec<u32>,
    /// Ends of the edges that but one face of a body has, or where what lets light through meets what does not.
    open: FxHashMap<u32, Vec<DVec3>>,
    /// Bodies that may have a lamp inside.
    lit: FxHashSet<u32>,
    /// The boxes around bodies.
    extent: FxHashMap<u32, [DVec3; 2]>,
}

impl Bodies {
    fn new(faces: &[Face], outlines: &[Vec<DVec3>], materials: &[Material], near: f64) -> Bodies {
        let weld = |p: DVec3| (p / near.max(f64::MIN_POSITIVE) + SHIFT).floor().to_array().map(|x| x as i64);
        let mut edges: FxHashMap<[Corner; 2], Vec<(u32, [DVec3; 2])>> = FxHashMap::default();
        for (k, p) in outlines.iter().enumerate() {
            for c in 0..p.len() {
                let ends = [p[c], p[(c + 1) % p.len()]];
                let mut key = ends.map(weld);
                key.sort_unstable();
                edges.entry(key).or_default().push((k as u32, ends));
            }
        }
        let mut sets = Sets::new(faces.len());
        edges.values().for_each(|on_it| on_it.windows(2).for_each(|w| sets.join(w[0].0, w[1].0)));
        let of = sets.names();
        let mut open: FxHashMap<u32, Vec<DVec3>> = FxHashMap::default();
        // A window in a wall is an opening too.
        let lets_through = |k: u32| materials[faces[k as usize].material as usize].lets_through();
        let is_open = |on_it: &&Vec<(u32, [DVec3; 2])>| {
            let windows = on_it.iter().filter(|(k, _)| lets_through(*k)).count();
            on_it.len() == 1 || (windows > 0 && windows < on_it.len())
        };
        for on_it in edges.values().filter(is_open) {
            on_it.iter().for_each(|(k, ends)| open.entry(of[*k as usize]).or_default().extend(ends));
        }
        let mut extent: FxHashMap<u32, [DVec3; 2]> = FxHashMap::default();
        for (body, p) in of.iter().zip(outlines) {
            let [low, high] = extent.entry(*body).or_insert([DVec3::INFINITY, DVec3::NEG_INFINITY]);
            p.iter().for_each(|p| (*low, *high) = (low.min(*p), high.max(*p)));
        }
        let lamps: Vec<(u32, DVec3)> = faces
            .iter()
            .enumerate()
            .filter(|(_, f)| materials[f.material as usize].is_emitter())
            .map(|(k, _)| (of[k], outlines[k].iter().sum::<DVec3>() / outlines[k].len() as f64))
            .collect();
        let has_lamp = |(body, [low, high]): &(&u32, &[DVec3; 2])| {
            lamps.iter().any(|(own, p)| own == *body || p.cmpge(*low).all() && p.cmple(*high).all())
        };
        let lit = extent.iter().filter(has_lamp).map(|(body, _)| *body).collect();
        Bodies { of, open, lit, extent }
    }

    /// How far a body's box reaches from a plane at most \[m\].
    fn height(&self, body: u32, (corner, normal): (DVec3, DVec3)) -> f64 {
        let [low, high] = self.extent[&body];
        (0.5 * (low + high) - corner).dot(normal).abs() + 0.5 * (high - low).dot(normal.abs())
    }

    /// Whether a body is closed, but for what is open in the plane of a face that it stands on, and has no lamp.
    fn is_closed_by(&self, body: u32, (corner, normal): (DVec3, DVec3), near: f64) -> bool {
        let in_plane = |p: &DVec3| (*p - corner).dot(normal).abs() <= near;
        !self.lit.contains(&body) && self.open.get(&body).is_none_or(|open| open.iter().all(in_plane))
    }
}

/// Whether some of a polygon is on either side of a plane, or in it.
fn meets(polygon: &[DVec3], corner: DVec3, normal: DVec3, near: f64) -> bool {
    let height = |p: &DVec3| (*p - corner).dot(normal);
    !(polygon.iter().all(|p| height(p) > near) || polygon.iter().all(|p| height(p) < -near))
}

/// The line within a face along which another one that [`meets`] its plane touches it or passes through it.
fn chord(face: &Face, outline: &[DVec3], other: &[DVec3], near: f64) -> Option<[DVec3; 2]> {
    let height = |p: DVec3| (p - outline[0]).dot(face.normal);
    let heights: Vec<f64> = other.iter().map(|p| height(*p)).collect();
    let mut met: Vec<DVec3> = Vec::new();
    for k in 0..other.len() {
        let (p, q, a, b) =
            (other[k], other[(k + 1) % other.len()], heights[k], heights[(k + 1) % other.len()]);
        if a.abs() <= near {
            met.push(p - a * face.normal);
        } else if b.abs() > near && (a > 0.0) != (b > 0.0) {
            met.push(p + (q - p) * (a / (a - b)));
        }
    }
    let [start, end] =
        [*met.first()?, *met.iter().max_by(|p, q| p.distance(met[0]).total_cmp(&q.distance(met[0])))?];
    let within = clip(face, outline, start, end - start, 2.0 * near)?;
    let [a, b] = within.map(|t| t.clamp(0.0, 1.0));
    let chord = [a, b].map(|t| start + t * (end - start));
    (chord[0].distance(chord[1]) > 8.0 * near).then_some(chord)
}

/// The part of a line in a face's plane, `start + t along`, that is within it by some distance.
fn clip(face: &Face, outline: &[DVec3], start: DVec3, along: DVec3, inside: f64) -> Option<[f64; 2]> {
    let mut part = [f64::NEG_INFINITY, f64::INFINITY];
    for k in 0..outline.len() {
        let (p, q) = (outline[k], outline[(k + 1) % outline.len()]);
        let inward = face.normal.cross(q - p).normalize_or_zero();
        let (from, change) = ((start - p).dot(inward) - inside, along.dot(inward));
        if change.abs() <= 1e-12 * along.length() {
            if from < 0.0 {
                return None;
            }
        } else if change > 0.0 {
            part[0] = part[0].max(-from / change);
        } else {
            part[1] = part[1].min(-from / change);
        }
    }
    (part[0] < part[1]).then_some(part)
}

/// The lines on which enough stands, those on which others stand longest first.
fn lines(face: &Face, outline: &[DVec3], chords: impl Iterator<Item = [DVec3; 2]>, near: f64) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for [a, b] in chords {
        let off = |line: &Line, p: DVec3| (p - line.origin).cross(line.along).length();
        let known = lines.iter_mut().find(|line| off(line, a) <= 4.0 * near && off(line, b) <= 4.0 * near);
        match known {
            Some(line) => {
                let [s, t] = [a, b].map(|p| (p - line.origin).dot(line.along));
                line.parts.push([s.min(t), s.max(t)]);
            }
            None => {
                lines.push(Line { origin: a, along: (b - a).normalize(), parts: vec![[0.0, a.distance(b)]] })
            }
        }
    }
    let stood_on = |line: &Line| {
        let mut parts = line.parts.clone();
        parts.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let (mut sum, mut end) = (0.0, f64::NEG_INFINITY);
        for [a, b] in parts {
            sum += (b - a.max(end)).max(0.0);
            end = end.max(b);
        }
        sum
    };
    let mut found: Vec<(f64, Line)> = lines.into_iter().map(|line| (stood_on(&line), line)).collect();
    found.retain(|(length, line)| {
        let whole = clip(face, outline, line.origin, line.along, 0.0).map_or(0.0, |[a, b]| b - a);
        *length >= LEAST_SHARE * whole
    });
    // Faces are in order, so are lines of equal length.
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(MOST_LINES);
    found.into_iter().map(|(_, line)| line).collect()
}

/// The parts of a face that lines leave, convex; elements have about that `size`.
fn cut(face: &Face, outline: &[DVec3], lines: Vec<Line>, (near, size): (f64, f64)) -> Vec<Vec<DVec3>> {
    let area = |p: &[DVec3]| {
        let crosses = (1..p.len().max(2) - 1).map(|k| (p[k] - p[0]).cross(p[k + 1] - p[0]));
        0.5 * crosses.sum::<DVec3>().dot(face.normal)
    };
    let elements = |pieces: &[Vec<DVec3>]| pieces.iter().map(|p| elements(p, size)).sum::<f64>();
    let mut pieces = vec![outline.to_vec()];
    let most = MOST_ELEMENTS.0 * elements(&pieces) + MOST_ELEMENTS.1;
    for line in lines {
        let across = face.normal.cross(line.along);
        let halves = |piece: &Vec<DVec3>| -> Vec<Vec<DVec3>> {
            let parts: Vec<Vec<DVec3>> = [across, -across].map(|n| half(piece, line.origin, n, near)).into();
            let parts: Vec<Vec<DVec3>> = parts.into_iter().filter(|p| p.len() > 2).collect();
            if parts.len() < 2 { vec![piece.clone()] } else { parts }
        };
        let divided: Vec<Vec<DVec3>> = pieces.iter().flat_map(halves).collect();
        if divided.iter().all(|p| area(p) > LEAST_PART * face.area) && elements(&divided) <= most {
            pieces = divided;
        }
    }
    pieces
}

/// About how many elements of a size a convex polygon has.
fn elements(piece: &[DVec3], size: f64) -> f64 {
    let along = |a: usize, b: usize| (piece[a].distance(piece[b]) / size).ceil().max(1.0);
    let of_face = |&[a, b, c, d]: &[usize; 4]| match c == d {
        true => along(a, b).max(along(b, c)).max(along(c, a)).powi(2),
        false => along(a, b).max(along(c, d)) * along(b, c).max(along(d, a)),
    };
    polygon::split(piece).faces.iter().map(of_face).sum()
}

/// The part of a convex polygon to that side of a line to which `n` points; nothing where it is on the other side or on the line.
fn half(p: &[DVec3], origin: DVec3, n: DVec3, near: f64) -> Vec<DVec3> {
    let side = |q: DVec3| {
        let s = (q - origin).dot(n);
        if s.abs() <= near { 0.0 } else { s }
    };
    if p.iter().all(|q| side(*q) <= 0.0) {
        return Vec::new();
    }
    let mut out = Vec::with_capacity(p.len() + 1);
    for k in 0..p.len() {
        let (q, r) = (p[k], p[(k + 1) % p.len()]);
        let (s, t) = (side(q), side(r));
        if s >= 0.0 {
            out.push(q);
        }
        if (s > 0.0 && t < 0.0) || (s < 0.0 && t > 0.0) {
            out.push(q + (r - q) * (s / (s - t)));
        }
    }
    out
}
