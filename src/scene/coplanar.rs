//! Faces that lie in one plane and overlap.
//!
//! A ray that meets two surfaces at one distance hits either at random, and light counts twice: a lamp
//! drawn into the plane of the ceiling, a box that stands on the floor, a wall that two rooms both have. Of each
//! overlap one face keeps its part and the others are cut. Emitters keep theirs first, bodies of glass last: where one stands
//! on a table, the table's top is seen through it, in optical contact. Of two alike the smaller polygon keeps its part: what
//! was put on a larger surface was meant to be seen. A translucent face on an opaque one (a paper lantern that stands on a floor) is one
//! surface with it where they touch, [`Material::coated`], of its own object and with the front of what it lies on.
//! Faces back to back that cover each other, as a lamp that shines up and one that shines down, or the wall of two rooms, are two sides of
//! a thin body: both are kept, and one is moved off the other, to where rays can tell them apart.
//! What glass stands on is divided along the glass's outline: the radiosity within differs by the index squared, and elements
//! must not lie half within.

use super::faces::Made;
use super::{Face, Material, polygon};
use glam::{DVec2, DVec3, Vec2Swizzles};
use rustc_hash::FxHashMap;

/// An overlap of less than this share of the smaller face is rounding of a common edge.
const LEAST_OVERLAP: f64 = 1e-7;
/// Planes are compared where their normals agree in a lattice of this size.
const NORMAL_CELL: f64 = 1e-3;
/// And their distances from the centre in one of this share of the scene's radius.
const DISTANCE_CELL: f64 = 1e-4;
/// Faces of one plane that are many.
const MANY: usize = 1 << 10;
/// Faces that cut one without its being halved first.
const CUTTERS: usize = 64;
/// Distance of planes that rays cannot tell apart, as a share of coordinates: see `visibility`'s offsets.
const APART: f64 = 8.0 / 16_777_216.0;

/// What was cut.
#[derive(Debug, Default)]
pub(super) struct Cut {
    /// Object of each face that lost a part.
    pub objects: Vec<u32>,
    /// Object of each face that overlaps another but could not be cut: it has shading normals.
    pub kept: Vec<u32>,
    /// Object of each translucent face that became one surface with an opaque one.
    pub joined: Vec<u32>,
    /// Object of each face that was moved off one that it is back to back with.
    pub parted: Vec<u32>,
    /// Object of the smaller of two faces that are not in one plane but nearer to each other than rays can tell.
    pub narrow: Vec<u32>,
}

/// How two faces lie that may be in one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Overlap {
    /// In different planes, or with no more than an edge in common.
    Apart,
    /// One before the other, nearer than rays start from both.
    Narrow,
    /// In one plane, as far as rays can tell, with more than an edge in common.
    OnePlane,
}

/// What becomes of a face.
#[derive(Debug, Default)]
struct Change {
    /// Faces that keep what it has in common with them.
    winners: Vec<u32>,
    /// Translucent faces that lie on it, and those of glass that stand on it.
    tops: Vec<u32>,
}

/// Materials of surfaces in contact.
struct Coated<'a> {
    known: &'a [Material],
    made: Vec<Material>,
    /// Of the material on top and what it lies on.
    numbers: FxHashMap<(u32, u32), u32>,
}

impl Coated<'_> {
    fn number(&mut self, top: u32, base: u32) -> u32 {
        let next = (self.known.len() + self.made.len()) as u32;
        *self.numbers.entry((top, base)).or_insert_with(|| {
            let base = base as usize;
            let below = self.known.get(base).unwrap_or_else(|| &self.made[base - self.known.len()]);
            let top = &self.known[top as usize];
            // Under glass the same material under another name: interpolated light does not cross over to another material.
            let made = match top.bends() {
                true => Material { name: format!("{} under {}", below.name, top.name), ..below.clone() },
                false => below.coated(top),
            };
            self.made.push(made);
            next
        })
    }
}

/// Convex parts of a face.
pub(super) type Pieces = Vec<(Vec<DVec3>, Made)>;

/// Which materials keep their part before others, the lowest first.
fn precedence(material: &Material) -> u8 {
    match () {
        () if material.is_emitter() => 0,
        () if material.bends() => 2,
        () => 1,
    }
}

/// Cuts overlapping faces; new points are added to `points`, and materials of surfaces in contact to `materials`.
pub(super) fn cut(faces: &mut Vec<Face>, points: &mut Vec<DVec3>, materials: &mut Vec<Material>) -> Cut {
    let mut result = Cut::default();
    let used = || faces.iter().flat_map(|f| f.vertices).map(|v| points[v as usize]);
    let (low, high) =
        (used().fold(DVec3::INFINITY, DVec3::min), used().fold(DVec3::NEG_INFINITY, DVec3::max));
    let (center, radius) = (0.5 * low + 0.5 * high, 0.5 * (high - low).length());
    let mut polygon_area: FxHashMap<u32, f64> = FxHashMap::default();
    for f in faces.iter() {
        *polygon_area.entry(f.polygon).or_default() += f.area;
    }
    let mut planes: FxHashMap<[i64; 4], Vec<u32>> = FxHashMap::default();
    for (k, f) in faces.iter().enumerate() {
        planes.entry(plane_key(f, points, center, radius)).or_default().push(k as u32);
    }
    let mut groups: Vec<Vec<u32>> = planes.into_values().filter(|g| g.len() > 1).collect();
    groups.sort_unstable();
    let mut replaced: Vec<(u32, Pieces)> = Vec::new();
    let mut parted: Vec<(u32, DVec3)> = Vec::new();
    let mut bulk = None;
    let mut coated = Coated { known: materials, made: Vec::new(), numbers: FxHashMap::default() };
    for group in groups {
        let mut flats: Vec<Flat> = group.iter().map(|&k| Flat::new(k, faces, points, center)).collect();
        sweep(&mut flats);
        let rank = |k: u32| {
            let f = &faces[k as usize];
            (precedence(&materials[f.material as usize]), polygon_area[&f.polygon], k)
        };
        // Whether a translucent face joins an opaque one: parts of faces with shading normals cannot.
        let joins = |a: u32, b: u32| {
            let [a, b] = [a, b].map(|k| &faces[k as usize]);
            let flat = a.normals.is_none() && b.normals.is_none();
            flat && materials[a.material as usize].can_coat(&materials[b.material as usize])
        };
        // Whether glass stands on what neither refracts nor shines.
        let immerses = |glass: u32, base: u32| {
            let [a, b] = [glass, base].map(|k| &faces[k as usize]);
            let [glass, base] = [a, b].map(|f| &materials[f.material as usize]);
            a.normals.is_none()
                && b.normals.is_none()
                && glass.bends()
                && !base.is_glass()
                && !base.is_emitter()
        };
        // Whether two faces are the two sides of a thin body, and not one surface drawn twice.
        let back_to_back = |a: u32, b: u32| {
            let [f, g] = [a, b].map(|k| &faces[k as usize]);
            let [one, other] = [f, g].map(|f| &materials[f.material as usize]);
            let twice = (f.object, f.material) == (g.object, g.material) && one.is_alike_on_both_sides();
            // One sheet, not two that light goes through one after the other.
            let sheet = one.lets_through() && other.lets_through();
            f.normal.dot(g.normal) < 0.0 && !(joins(a, b) || one.bends() || other.bends() || twice || sheet)
        };
        let mut changes: FxHashMap<u32, Change> = FxHashMap::default();
        for (i, a) in flats.iter().enumerate() {
            for b in flats[i + 1..].iter().take_while(|b| b.low.x < a.high.x) {
                if faces[a.face as usize].polygon == faces[b.face as usize].polygon
                    || b.low.cmpge(a.high).any()
                    || a.low.cmpge(b.high).any()
                {
                    continue;
                }
                let overlap = overlap(a.face, b.face, faces, points, center);
                if overlap == Overlap::Narrow {
                    let smaller = [a.face, b.face].map(|k| &faces[k as usize]).into_iter();
                    let smaller = smaller.min_by(|a, b| a.area.total_cmp(&b.area));
                    result.narrow.extend(smaller.map(|f| f.object));
                }
                if overlap == Overlap::OnePlane {
                    let (x, y) = (rank(a.face), rank(b.face));
                    let [a_joins, b_joins] = [joins(a.face, b.face), joins(b.face, a.face)];
                    let a_wins = b_joins || !a_joins && (x.0, x.1, x.2) < (y.0, y.1, y.2);
                    let (winner, loser) = if a_wins { (a.face, b.face) } else { (b.face, a.face) };
                    changes.entry(loser).or_default().winners.push(winner);
                    if a_joins || b_joins || immerses(loser, winner) {
                        changes.entry(winner).or_default().tops.push(loser);
                    }
                }
            }
        }
        let mut changes: Vec<_> = changes.into_iter().collect();
        changes.sort_unstable_by_key(|change| change.0);
        for (k, change) in changes {
            let face = &faces[k as usize];
            let whole: Pieces =
                vec![(corners(face, points), Made { object: face.object, material: face.material })];
            let without = |pieces, winners: &[u32]| left_of(pieces, (face, faces, points), winners);
            let (backs, others): (Vec<u32>, Vec<u32>) =
                change.winners.iter().partition(|w| back_to_back(k, **w));
            let open = without(whole, &others);
            let mut pieces = without(open.clone(), &backs);
            if pieces.is_empty() && !open.is_empty() && change.tops.is_empty() {
                let apart = 2.0 * APART * (face.normal.abs().dot(0.5 * (high - low)) + 2.0 * radius);
                let by_bulk = materials[face.material as usize].is_alike_on_both_sides()
                    && backs.iter().all(|b| faces[*b as usize].object != face.object);
                let bulk = bulk.get_or_insert_with(|| bulks(faces, points))[&face.object];
                let offset = apart * gap_side(face, bulk, points, by_bulk) * face.normal;
                if others.is_empty() {
                    parted.push((k, offset));
                } else {
                    let moved = |p: Vec<DVec3>| p.iter().map(|q| *q + offset).collect();
                    result.parted.push(face.object);
                    replaced.push((k, open.into_iter().map(|(p, made)| (moved(p), made)).collect()));
                }
                continue;
            }
            if face.normals.is_some() && !pieces.is_empty() {
                result.kept.push(face.object);
                continue;
            }
            for &c in &change.tops {
                let coat = &faces[c as usize];
                let cutter = flatten(face, &corners(coat, points));
                for (piece, made) in std::mem::take(&mut pieces) {
                    let (outside, common) = subtract(face, &piece, &cutter);
                    pieces.extend(outside.into_iter().map(|p| (p, made)));
                    if let Some(common) = common {
                        // What is looked at is the sheet, but through glass what lies below.
                        let through = materials[coat.material as usize].bends();
                        let object = if through { made.object } else { coat.object };
                        let material = coated.number(coat.material, made.material);
                        pieces.push((common, Made { object, material }));
                    }
                }
            }
            let by = |joined: bool| change.winners.iter().any(|w| joins(k, *w) == joined);
            if by(false) {
                result.objects.push(face.object);
            }
            if by(true) {
                result.joined.push(face.object);
            }
            replaced.push((k, pieces));
        }
    }
    let made = coated.made;
    materials.extend(made);
    parted.sort_unstable_by_key(|p| p.0);
    result.parted.extend(parted.iter().map(|p| faces[p.0 as usize].object));
    part(faces, points, &parted);
    if !replaced.is_empty() {
        replace(faces, points, replaced);
    }
    result
}

/// What is left of pieces of a face without what it has in common with others.
fn left_of(pieces: Pieces, (face, faces, points): (&Face, &[Face], &[DVec3]), others: &[u32]) -> Pieces {
    let cutters: Vec<Vec<DVec2>> =
        others.iter().map(|k| flatten(face, &corners(&faces[*k as usize], points))).collect();
    let cutters: Vec<&[DVec2]> = cutters.iter().map(Vec::as_slice).collect();
    pieces
        .into_iter()
        .flat_map(|(p, made)| without(face, p, &cutters).into_iter().map(move |p| (p, made)))
        .collect()
}

/// The bounds of points in a plane.
fn bounds(p: &[DVec2]) -> [DVec2; 2] {
    let low = p.iter().copied().fold(DVec2::INFINITY, DVec2::min);
    [low, p.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max)]
}

/// What is left of a convex part of a face without those that cut it.
///
/// Each one cuts all pieces that those before it left. Where they are very many, as the houses of a town on their ground, the part is
/// halved first, so that few cut each part of it.
fn without(face: &Face, part: Vec<DVec3>, cutters: &[&[DVec2]]) -> Vec<Vec<DVec3>> {
    if cutters.len() > CUTTERS {
        let within = bounds(&flatten(face, &part));
        let axis = usize::from(within[1].y - within[0].y > within[1].x - within[0].x);
        let mut middles: Vec<f64> =
            cutters.iter().map(|c| bounds(c).map(|b| b[axis]).iter().sum::<f64>() / 2.0).collect();
        middles.sort_unstable_by(f64::total_cmp);
        let middle = middles[middles.len() / 2];
        let [low, high]: [Vec<&[DVec2]>; 2] = [
            cutters.iter().copied().filter(|c| bounds(c)[0][axis] < middle).collect(),
            cutters.iter().copied().filter(|c| bounds(c)[1][axis] > middle).collect(),
        ];
        // The half of the plane below the middle, wide enough for all of the part.
        let [from, to] =
            [within[0] - DVec2::ONE * face.area.sqrt(), within[1] + DVec2::ONE * face.area.sqrt()];
        let mut edge = to;
        edge[axis] = middle;
        let half_plane = [from, DVec2::new(edge.x, from.y), edge, DVec2::new(from.x, edge.y)];
        let (above, below) = subtract(face, &part, &half_plane);
        let enough = 3 * low.len().max(high.len()) <= 2 * cutters.len();
        if let (true, Some(below), [above]) = (enough, below, &above[..]) {
            let mut pieces = without(face, below, &low);
            pieces.extend(without(face, above.clone(), &high));
            return pieces;
        }
    }
    cutters.iter().fold(vec![part], |pieces, cutter| {
        pieces.into_iter().flat_map(|p| subtract(face, &p, cutter).0).collect()
    })
}

/// Area \[m^2\] and centroid \[m\] of each object.
fn bulks(faces: &[Face], points: &[DVec3]) -> FxHashMap<u32, (f64, DVec3)> {
    let mut bulks: FxHashMap<u32, (f64, DVec3)> = FxHashMap::default();
    for f in faces {
        let corners = corners(f, points);
        let (area, moment) = bulks.entry(f.object).or_default();
        *area += f.area;
        *moment += f.area * corners.iter().sum::<DVec3>() / corners.len() as f64;
    }
    bulks.values_mut().for_each(|(area, moment)| *moment /= *area);
    bulks
}

/// To which side of its plane a face goes that is back to back with others: 1 to its front, -1 to its back.
///
/// Where both sides reflect, the walls of a room may have been drawn with either one inside: the wall that two rooms have goes to where the
/// rest of its own room lies. Where the front alone shows anything, and where nothing lies on either side, the front decides.
fn gap_side(face: &Face, (area, centroid): (f64, DVec3), points: &[DVec3], by_bulk: bool) -> f64 {
    let height = (centroid - points[face.vertices[0] as usize]).dot(face.normal);
    if by_bulk && height < -1e-3 * area.sqrt() { -1.0 } else { 1.0 }
}

/// Moves faces. Neighbours that move alike keep what corners they share.
fn part(faces: &mut [Face], points: &mut Vec<DVec3>, parted: &[(u32, DVec3)]) {
    let mut numbers: FxHashMap<(u32, [i32; 3]), u32> = FxHashMap::default();
    for &(k, moved) in parted {
        let face = &mut faces[k as usize];
        let direction = moved.normalize().to_array().map(|x| (1024.0 * x).round() as i32);
        face.vertices = face.vertices.map(|v| {
            *numbers.entry((v, direction)).or_insert_with(|| {
                points.push(points[v as usize] + moved);
                points.len() as u32 - 1
            })
        });
    }
}

/// Puts pieces in the places of the faces that they are left of.
pub(super) fn replace(faces: &mut Vec<Face>, points: &mut Vec<DVec3>, mut replaced: Vec<(u32, Pieces)>) {
    replaced.sort_unstable_by_key(|r| r.0);
    let mut rest = replaced.into_iter().peekable();
    for (k, face) in std::mem::take(faces).into_iter().enumerate() {
        let Some((_, pieces)) = rest.next_if(|r| r.0 == k as u32) else {
            faces.push(face);
            continue;
        };
        for (piece, Made { object, material }) in pieces {
            let first = points.len() as u32;
            let split = polygon::split(&piece);
            points.extend(&piece);
            faces.extend(split.faces.iter().map(|c| Face {
                vertices: c.map(|c| first + c as u32),
                normals: None,
                object,
                material,
                ..face
            }));
        }
    }
}

/// The extent of a face within its plane, on the two axes that its normal is furthest from.
struct Flat {
    face: u32,
    low: DVec2,
    high: DVec2,
}

impl Flat {
    fn new(k: u32, faces: &[Face], points: &[DVec3], center: DVec3) -> Flat {
        let f = &faces[k as usize];
        let n = f.normal.abs();
        let flat = |p: DVec3| {
            let p = p - center;
            if n.x >= n.y && n.x >= n.z {
                DVec2::new(p.y, p.z)
            } else if n.y >= n.z {
                DVec2::new(p.x, p.z)
            } else {
                DVec2::new(p.x, p.y)
            }
        };
        let p = corners(f, points);
        Flat {
            face: k,
            low: p.iter().map(|p| flat(*p)).fold(DVec2::INFINITY, DVec2::min),
            high: p.iter().map(|p| flat(*p)).fold(DVec2::NEG_INFINITY, DVec2::max),
        }
    }
}

/// Puts faces in the order in which a line that sweeps along the first axis meets them. Of very many that is the axis along which they are
/// shorter: boards have all in common along the other one.
fn sweep(flats: &mut [Flat]) {
    let extent = |axis: usize| flats.iter().map(|f| f.high[axis] - f.low[axis]).sum::<f64>();
    if flats.len() > MANY && extent(1) < extent(0) {
        flats.iter_mut().for_each(|f| (f.low, f.high) = (f.low.yx(), f.high.yx()));
    }
    flats.sort_by(|a, b| a.low.x.total_cmp(&b.low.x));
}

pub(super) fn corners(face: &Face, points: &[DVec3]) -> Vec<DVec3> {
    face.vertices[..if face.is_triangle() { 3 } else { 4 }].iter().map(|&v| points[v as usize]).collect()
}

/// 1 or -1, the other one for the opposite normal.
pub(super) fn sign(normal: DVec3) -> f64 {
    // The first component that is clearly not zero decides.
    normal.to_array().into_iter().find(|x| x.abs() > 1e-3).map_or(1.0, f64::signum)
}

/// The cell of a face's plane in a lattice; both orientations of a plane are one.
fn plane_key(face: &Face, points: &[DVec3], center: DVec3, radius: f64) -> [i64; 4] {
    let n = face.normal;
    let n = n * sign(n);
    let d = n.dot(points[face.vertices[0] as usize] - center) / radius.max(f64::MIN_POSITIVE);
    // The irrational shift keeps round numbers off the lattice's borders.
    let cell = |x: f64, size: f64| (x / size + 0.381_966_011_250_105).floor() as i64;
    [cell(n.x, NORMAL_CELL), cell(n.y, NORMAL_CELL), cell(n.z, NORMAL_CELL), cell(d, DISTANCE_CELL)]
}

fn overlap(a: u32, b: u32, faces: &[Face], points: &[DVec3], center: DVec3) -> Overlap {
    let (a, b) = (&faces[a as usize], &faces[b as usize]);
    let (pa, pb) = (corners(a, points), corners(b, points));
    // How far the other face's corners are from a face's plane, and how far they may be.
    let distance = |f: &Face, p: &[DVec3], other: &[DVec3]| {
        let most = p.iter().fold(DVec3::ZERO, |m, p| m.max((*p - center).abs()));
        let longest = p.iter().map(|q| q.distance(p[0])).fold(0.0, f64::max);
        let far = other.iter().map(|q| f.normal.dot(*q - p[0]).abs()).fold(0.0, f64::max);
        (far, APART * (f.normal.abs().dot(most) + longest))
    };
    let [(far_a, most_a), (far_b, most_b)] = [distance(a, &pa, &pb), distance(b, &pb, &pa)];
    let one_plane = far_a <= most_a && far_b <= most_b;
    // Rays start half that far from a face.
    if !one_plane && far_a.max(far_b) > 0.5 * (most_a + most_b) {
        return Overlap::Apart;
    }
    let mut common = flatten(a, &pb);
    let cutter = flatten(a, &pa);
    for k in 0..cutter.len() {
        common = half(&common, cutter[k], cutter[(k + 1) % cutter.len()], true);
    }
    match area(&common).abs() > LEAST_OVERLAP * a.area.min(b.area) {
        false => Overlap::Apart,
        true if one_plane => Overlap::OnePlane,
        true => Overlap::Narrow,
    }
}

/// Points in the plane of a face, counter-clockwise.
fn flatten(face: &Face, p: &[DVec3]) -> Vec<DVec2> {
    let (x, y) = face.normal.any_orthonormal_pair();
    // any_orthonormal_pair does not promise an orientation.
    let y = if x.cross(y).dot(face.normal) > 0.0 { y } else { -y };
    let mut flat: Vec<DVec2> = p.iter().map(|p| DVec2::new(p.dot(x), p.dot(y))).collect();
    if area(&flat) < 0.0 {
        flat.reverse();
    }
    flat
}

fn area(p: &[DVec2]) -> f64 {
    let Some(&o) = p.first() else { return 0.0 };
    0.5 * p.windows(2).map(|w| (w[0] - o).perp_dot(w[1] - o)).sum::<f64>()
}

/// The part of a convex polygon to the left (`inside`) or right of a line.
fn half(p: &[DVec2], a: DVec2, b: DVec2, inside: bool) -> Vec<DVec2> {
    let sign = if inside { 1.0 } else { -1.0 };
    let side = |q: DVec2| sign * (b - a).perp_dot(q - a);
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

/// What is left of a convex polygon in a face's plane without a convex part of that plane, in convex pieces, and what they
/// have in common.
fn subtract(face: &Face, piece: &[DVec3], cutter: &[DVec2]) -> (Vec<Vec<DVec3>>, Option<Vec<DVec3>>) {
    let (x, y) = face.normal.any_orthonormal_pair();
    let y = if x.cross(y).dot(face.normal) > 0.0 { y } else { -y };
    let origin = piece[0];
    let lift = |q: &DVec2| {
        let d = *q - DVec2::new(origin.dot(x), origin.dot(y));
        origin + d.x * x + d.y * y
    };
    let whole: Vec<DVec2> = piece.iter().map(|p| DVec2::new(p.dot(x), p.dot(y))).collect();
    let least = LEAST_OVERLAP * face.area;
    let mut rest = whole;
    let mut pieces = Vec::new();
    for k in 0..cutter.len() {
        let (a, b) = (cutter[k], cutter[(k + 1) % cutter.len()]);
        let outside = half(&rest, a, b, false);
        if area(&outside) > least {
            pieces.push(outside.iter().map(lift).collect());
        }
        rest = half(&rest, a, b, true);
    }
    // A sliver in common is rounding: the polygon stays in one piece.
    if area(&rest) <= least {
        (vec![piece.to_vec()], None)
    } else {
        (pieces, Some(rest.iter().map(lift).collect()))
    }
}

#[cfg(test)]
mod tests;
