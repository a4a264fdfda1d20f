//! Splits a polygon into what Embree holds: triangles and planar convex quads.

use glam::{DVec2, DVec3};

/// A quad counts as planar, and as a parallelogram, when its fourth corner is within this share of its size of where the other
/// three put it.
const QUAD_TOLERANCE: f64 = 1e-7;
/// A quad is cut into triangles where the cells of its grid would differ in area by more than this.
const UNEVEN: f64 = 4.0;
/// A polygon counts as planar when its corners are within this share of its size of its plane.
const PLANAR_TOLERANCE: f64 = 1e-3;
/// Less than this share of the squared size is no area: rounding of coordinates makes as much.
pub(super) const AREA_TOLERANCE: f64 = 1e-12;

/// What a polygon was split into.
#[derive(Debug, Default)]
pub(super) struct Split {
    /// Corner numbers of each face; a triangle repeats its third. Empty: the polygon has no area.
    pub faces: Vec<[usize; 4]>,
    /// A corner lies far from the plane of the others.
    pub bent: bool,
    /// Edges cross, so that no split covers the polygon once.
    pub crossed: bool,
}

/// Area vector of a polygon (Newell): along the right-hand normal, as long as the area.
pub(super) fn area_vector(points: &[DVec3]) -> DVec3 {
    let Some(&origin) = points.first() else { return DVec3::ZERO };
    // Relative to a corner: far from the coordinates' origin the products would cancel.
    let pairs = points.windows(2).map(|p| (p[0] - origin).cross(p[1] - origin));
    0.5 * pairs.sum::<DVec3>()
}

/// Splits a polygon whose consecutive corners differ. The faces keep its orientation.
///
/// Quads are cut from their first corner where that diagonal lies inside, as other renderers
/// do, so that a quad that is not planar has the same shape everywhere. Convex polygons of more corners become a strip of
/// quads, other ones triangles.
pub(super) fn split(points: &[DVec3]) -> Split {
    let size = extent(points);
    let area = area_vector(points);
    if points.len() < 3 || area.length() <= AREA_TOLERANCE * size * size {
        return Split::default();
    }
    if let [_, _, _] = points {
        return Split { faces: vec![[0, 1, 2, 2]], ..Split::default() };
    }
    let normal = area.normalize();
    let middle = points.iter().sum::<DVec3>() / points.len() as f64;
    let bent = points.iter().any(|&p| (p - middle).dot(normal).abs() > PLANAR_TOLERANCE * size);
    if let &[a, b, c, d] = points {
        if stays_whole([a, b, c, d], size) {
            return Split { faces: vec![[0, 1, 2, 3]], ..Split::default() };
        }
        for faces in [[[0, 1, 2, 2], [0, 2, 3, 3]], [[1, 2, 3, 3], [1, 3, 0, 0]]] {
            let inside = |f: &[usize; 4]| {
                let [p, q, r] = [points[f[0]], points[f[1]], points[f[2]]];
                0.5 * (q - p).cross(r - p).dot(normal) > AREA_TOLERANCE * size * size
            };
            if faces.iter().all(inside) {
                return Split { faces: faces.to_vec(), bent, crossed: false };
            }
        }
    }
    // Corners far from one plane would leave no quad whole.
    let strip = if points.len() > 4 && !bent { super::strip::cut(points, normal, size) } else { None };
    match strip {
        Some(faces) => Split { faces, ..Split::default() },
        None => clip_ears(points, normal, size, bent),
    }
}

/// Whether a quad is planar and convex, and not so uneven that its grid would have cells of very different areas.
pub(super) fn stays_whole(corners: [DVec3; 4], size: f64) -> bool {
    let [a, b, _, d] = corners;
    if is_parallelogram(corners) {
        return true;
    }
    let normal = (b - a).cross(d - a).normalize_or_zero();
    let off = (corners[2] - a).dot(normal).abs();
    // Area over that at the first corner, at all of them: in between it is bilinear.
    let skew = super::frame::skew(corners);
    let densities = [1.0, 1.0 + skew.x, 1.0 + skew.y, 1.0 + skew.x + skew.y];
    let least = densities.into_iter().fold(f64::INFINITY, f64::min);
    let most = densities.into_iter().fold(0.0, f64::max);
    off <= QUAD_TOLERANCE * size && least > 0.0 && most <= UNEVEN * least
}

/// Whether a quad is a parallelogram but for rounding.
pub(super) fn is_parallelogram(corners: [DVec3; 4]) -> bool {
    let [a, b, c, d] = corners;
    (a - b + c - d).length() <= QUAD_TOLERANCE * extent(&corners)
}

/// Ear clipping on the polygon's own plane.
fn clip_ears(points: &[DVec3], normal: DVec3, size: f64, bent: bool) -> Split {
    let (x, y) = normal.any_orthonormal_pair();
    // A right-handed frame keeps a counter-clockwise polygon counter-clockwise.
    let y = if x.cross(y).dot(normal) < 0.0 { -y } else { y };
    // Relative to a corner and to the size: the clipper must see no cancellation.
    let flat = |&p: &DVec3| {
        let p = (p - points[0]) / size;
        [p.dot(x), p.dot(y)]
    };
    let plane: Vec<[f64; 2]> = points.iter().map(flat).collect();
    let mut corners: Vec<u32> = Vec::new();
    earcut::Earcut::new().earcut(plane.iter().copied(), &[], &mut corners);

    let mut faces = Vec::with_capacity(corners.len() / 3);
    let mut covered = 0.0;
    for ear in corners.chunks_exact(3) {
        let [a, b, c] = [ear[0] as usize, ear[1] as usize, ear[2] as usize];
        let [p, q, r] = [a, b, c].map(|i| DVec2::from(plane[i]));
        let area = 0.5 * (q - p).perp_dot(r - p);
        if area.abs() > AREA_TOLERANCE {
            faces.push(if area > 0.0 { [a, b, c, c] } else { [a, c, b, b] });
            covered += area.abs();
        }
    }
    let whole = area_vector(points).length() / (size * size);
    Split { faces, bent, crossed: (covered - whole).abs() > 1e-6 * whole }
}

/// Diagonal of the bounding box.
fn extent(points: &[DVec3]) -> f64 {
    let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    if points.is_empty() { 0.0 } else { (high - low).length() }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use glam::{DQuat, dvec3};
    use std::f64::consts::TAU;

    pub fn area_of(points: &[DVec3], face: &[usize; 4]) -> DVec3 {
        let corners = if face[2] == face[3] { &face[..3] } else { &face[..] };
        area_vector(&corners.iter().map(|&c| points[c]).collect::<Vec<_>>())
    }

    fn flat(points: &[[f64; 2]]) -> Vec<DVec3> {
        points.iter().map(|p| dvec3(p[0], p[1], 3.0)).collect()
    }

    #[test]
    fn area_vector_of_known_polygons() {
        let square = flat(&[[0.0, 0.0], [2.0, 0.0], [2.0, 3.0], [0.0, 3.0]]);
        assert_eq!(area_vector(&square), dvec3(0.0, 0.0, 6.0));
        let clockwise: Vec<_> = square.into_iter().rev().collect();
        assert_eq!(area_vector(&clockwise), dvec3(0.0, 0.0, -6.0));
        assert_eq!(area_vector(&[]), DVec3::ZERO);
    }

    #[test]
    fn planar_convex_quads_stay_whole() {
        let split_of = |p: [[f64; 2]; 4]| split(&flat(&p)).faces;
        assert_eq!(split_of([[0.0, 0.0], [2.0, 0.0], [3.0, 1.0], [1.0, 1.0]]), [[0, 1, 2, 3]]);
        assert_eq!(split_of([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]), [[0, 1, 2, 3]]);
        // At its upper edge, cells would be a fifth as large as at the lower one.
        let uneven = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.6, 1.0]];
        assert_eq!(split_of(uneven), [[0, 1, 2, 2], [0, 2, 3, 3]]);
        // Three corners in a row leave no quad between lines of equal (u, v).
        assert_eq!(split_of([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.0, 1.0]]).len(), 2);
        // 1e-8 of the size off the plane is rounding, 1e-6 is not.
        for (off, faces) in [(1e-8, 1), (1e-6, 2)] {
            let mut quad = flat(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]);
            quad[2].z += off;
            assert_eq!(split(&quad).faces.len(), faces);
        }
    }

    #[test]
    fn bent_quads_are_cut_from_their_first_corner() {
        let mut quad = flat(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        quad[3].z += 0.1;
        let bent = split(&quad);
        assert_eq!(bent.faces, [[0, 1, 2, 2], [0, 2, 3, 3]]);
        assert!(bent.bent && !bent.crossed);
        quad[3].z = 3.0 + 1e-4;
        assert!(!split(&quad).bent);
    }

    #[test]
    fn concave_quads_are_cut_inside() {
        // Reflex corners 1 and 0: the first can only be cut from there, the second from corner 0.
        let points = flat(&[[0.0, 0.0], [1.0, 0.9], [2.0, 0.0], [1.0, 3.0]]);
        for turn in 0..4 {
            let mut quad = points.clone();
            quad.rotate_left(turn);
            let cut = split(&quad);
            let parts: Vec<_> = cut.faces.iter().map(|f| area_of(&quad, f).z).collect();
            assert!(parts.iter().all(|&a| a > 0.0), "{turn}: {parts:?}");
            assert!((parts.iter().sum::<f64>() - 2.1).abs() < 1e-12, "{turn}: {parts:?}");
        }
    }

    #[test]
    fn what_has_no_area_gives_no_face() {
        assert!(split(&[]).faces.is_empty());
        assert!(split(&flat(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])).faces.is_empty());
        assert!(split(&flat(&[[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.7, 0.7]])).faces.is_empty());
        // Small is not degenerate.
        assert_eq!(split(&flat(&[[0.0, 0.0], [1e-9, 0.0], [0.0, 1e-9]])).faces.len(), 1);
    }

    #[test]
    fn crossed_edges_are_reported() {
        let pentagram: Vec<_> =
            (0..5).map(|k| 2.0 * k as f64 * TAU / 5.0).map(|a| [a.cos(), a.sin()]).collect();
        assert!(split(&flat(&pentagram)).crossed);
    }

    /// SplitMix64, in [0, 1).
    pub fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = *state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    #[test]
    fn splitting_keeps_area_and_normal_of_random_concave_polygons() {
        let mut state = 7;
        for round in 0..2000 {
            let corners = 4 + (random(&mut state) * 30.0) as usize;
            let scale = 10f64.powf(random(&mut state) * 12.0 - 6.0);
            let turn = DQuat::from_euler(
                glam::EulerRot::XYZ,
                TAU * random(&mut state),
                TAU * random(&mut state),
                TAU * random(&mut state),
            );
            let away = dvec3(random(&mut state), random(&mut state), random(&mut state)) * 100.0 * scale;
            let star: Vec<_> = (0..corners)
                .map(|k| {
                    let angle = TAU * (k as f64 + 0.8 * random(&mut state)) / corners as f64;
                    let radius = scale * (0.1 + 0.9 * random(&mut state));
                    turn * dvec3(radius * angle.cos(), radius * angle.sin(), 0.0) + away
                })
                .collect();
            let whole = area_vector(&star);
            let cut = split(&star);
            let parts: Vec<_> = cut.faces.iter().map(|f| area_of(&star, f)).collect();
            assert!(!cut.bent && !cut.crossed, "round {round}");
            assert!((parts.iter().sum::<DVec3>() - whole).length() < 1e-9 * whole.length(), "round {round}");
            let along = |p: &DVec3| p.dot(whole) > 0.0;
            assert!(parts.iter().all(along), "round {round}: a part is turned over");
            let covered: f64 = parts.iter().map(|p| p.length()).sum();
            assert!((covered - whole.length()).abs() < 1e-9 * covered, "round {round}");
        }
    }
}
