//! Cuts a convex polygon into a strip of quads between two chains of its corners.
//!
//! A triangle is divided as finely across as along. Those that ears leave of a polygon of many corners are slender and as long as
//! the polygon, and would take thousands of elements each; a quad as slender takes one row.

use super::polygon::{AREA_TOLERANCE, area_vector, stays_whole};
use glam::DVec3;
use std::f64::consts::PI;

/// A corner where edges turn by less, in radians, may as well lie in a row with its neighbours.
const LEAST_TURN: f64 = 1e-6;
/// So many strips are compared, and then those between the best one's neighbours.
const STRIPS: usize = 32;
/// Elements are counted as if so many went along the polygon.
const ALONG: f64 = 64.0;
/// A strip must be better by this share: of a regular polygon's, rounding would choose.
const BETTER: f64 = 1e-6;

/// The faces of a polygon in the plane across `normal`, `size` large, as corner numbers; a triangle repeats its third. None: it is
/// not strictly convex.
pub(super) fn cut(points: &[DVec3], normal: DVec3, size: f64) -> Option<Vec<[usize; 4]>> {
    if !is_convex(points, normal) {
        return None;
    }
    let n = points.len();
    let mut best = (0, f64::INFINITY);
    let mut compare = |axis: usize| {
        let found = elements(points, &strip(points, axis, size), size / ALONG);
        if found < (1.0 - BETTER) * best.1 {
            best = (axis, found);
        }
        best.0
    };
    // Half of a disc is best cut along its diameter.
    let longest = (0..n).fold((0, 0.0), |most, k| {
        let length = points[k].distance(points[(k + 1) % n]);
        if length > (1.0 + BETTER) * most.1 { (k, length) } else { most }
    });
    let mut axis = compare((2 * longest.0 + 1) % n);
    let mut step = n.div_ceil(STRIPS);
    for k in (0..n).step_by(step) {
        axis = compare(k);
    }
    while step > 1 {
        step = step.div_ceil(2);
        compare((axis + step) % n);
        axis = compare((axis + n - step) % n);
    }
    let mut faces = strip(points, axis, size);
    // At an end, corners of a polygon of very many are all but in a row.
    faces.retain(|f| {
        let corners = f.map(|c| points[c]);
        area_vector(&corners).dot(normal) > AREA_TOLERANCE * size * size
    });
    Some(faces)
}

/// Whether edges turn to the left at every corner, and once around in all.
fn is_convex(points: &[DVec3], normal: DVec3) -> bool {
    let n = points.len();
    let mut around = 0.0;
    for k in 0..n {
        let (a, b, c) = (points[(k + n - 1) % n], points[k], points[(k + 1) % n]);
        let (before, after) = (b - a, c - b);
        let turn = before.cross(after).dot(normal).atan2(before.dot(after));
        if turn.is_nan() || turn < LEAST_TURN {
            return false;
        }
        around += turn;
    }
    around < 3.0 * PI
}

/// The faces between chords from corner i to corner j with `i + j = axis`, modulo the number of corners.
fn strip(points: &[DVec3], axis: usize, size: f64) -> Vec<[usize; 4]> {
    let n = points.len();
    let mut faces = Vec::with_capacity(n / 2 + 1);
    // From a corner, or an edge, forwards and backwards. Numbers beyond the last corner start anew.
    let (mut i, mut j) = (axis.div_ceil(2), axis / 2 + n);
    while j - i >= 2 {
        let [a, b, c, d] = [i, i + 1, j - 1, j].map(|k| k % n);
        if a == d {
            faces.push([a, b, c, c]);
        } else if b == c {
            faces.push([a, b, d, d]);
        } else if stays_whole([a, b, c, d].map(|k| points[k]), size) {
            faces.push([a, b, c, d]);
        } else if points[a].distance_squared(points[c]) <= points[b].distance_squared(points[d]) {
            faces.extend([[a, b, c, c], [a, c, d, d]]);
        } else {
            faces.extend([[b, c, d, d], [b, d, a, a]]);
        }
        (i, j) = (i + 1, j - 1);
    }
    faces
}

/// How many elements with edges of at most `length` the faces take, about. Triangles of one polygon are all divided alike.
fn elements(points: &[DVec3], faces: &[[usize; 4]], length: f64) -> f64 {
    let along = |p: f64, q: f64| (p.max(q) / length).max(1.0);
    let (mut quads, mut triangles, mut finest) = (0.0, 0.0, 1.0f64);
    for face in faces {
        let [a, b, c, d] = face.map(|k| points[k]);
        let [ab, bc, da] = [(a, b), (b, c), (d, a)].map(|(p, q)| p.distance(q));
        if face[2] == face[3] {
            triangles += 1.0;
            finest = finest.max(along(ab.max(bc), da));
        } else {
            quads += along(ab, c.distance(d)) * along(bc, da);
        }
    }
    quads + triangles * finest * finest
}

#[cfg(test)]
mod tests {
    use super::super::polygon::tests::{area_of, random};
    use super::super::polygon::{Split, split};
    use super::*;
    use glam::{DQuat, DVec2, dvec3};
    use std::f64::consts::TAU;

    fn regular(n: usize, radii: [f64; 2]) -> Vec<DVec3> {
        let angle = |k: usize| TAU * k as f64 / n as f64;
        (0..n).map(|k| dvec3(radii[0] * angle(k).cos(), radii[1] * angle(k).sin(), 0.0)).collect()
    }

    /// Faces lie as the polygon does and have its area in all; those of a convex polygon then cover it once if none overlap.
    fn assert_covers(points: &[DVec3], cut: &Split, what: &str) {
        assert!(!cut.bent && !cut.crossed, "{what}");
        let whole = area_vector(points);
        let parts: Vec<DVec3> = cut.faces.iter().map(|f| area_of(points, f)).collect();
        assert!(parts.iter().all(|p| p.dot(whole) > 0.0), "{what}: a part is turned over");
        assert!((parts.iter().sum::<DVec3>() - whole).length() < 1e-9 * whole.length(), "{what}");
        // Each edge of a face is the polygon's, or another face's backwards.
        let mut edges: Vec<[usize; 2]> = Vec::new();
        for f in &cut.faces {
            let corners = if f[2] == f[3] { &f[..3] } else { &f[..] };
            edges.extend((0..corners.len()).map(|k| [corners[k], corners[(k + 1) % corners.len()]]));
        }
        edges.sort_unstable();
        let n = points.len();
        assert!(edges.windows(2).all(|e| e[0] != e[1]), "{what}: an edge twice");
        for &[a, b] in &edges {
            let inner = edges.binary_search(&[b, a]).is_ok();
            assert_eq!((a + 1) % n != b, inner, "{what}: edge {a} to {b}");
        }
        for k in 0..n {
            assert!(edges.binary_search(&[k, (k + 1) % n]).is_ok(), "{what}: no edge at {k}");
        }
    }

    fn triangles(cut: &Split) -> usize {
        cut.faces.iter().filter(|f| f[2] == f[3]).count()
    }

    /// Of a regular polygon, a triangle is left at an end at most; of an ellipse, quads go along the shorter axis.
    #[test]
    fn regular_polygons_leave_hardly_a_triangle() {
        for n in 5..=1000 {
            let points = regular(n, [1.0, 1.0]);
            let cut = split(&points);
            assert!(triangles(&cut) <= 2, "{n}: {} triangles", triangles(&cut));
            assert!(cut.faces.len() <= n / 2, "{n}: {} faces", cut.faces.len());
            assert_covers(&points, &cut, &n.to_string());
        }
        let cut = split(&regular(100, [1.0, 0.1]));
        assert!(triangles(&cut) <= 2);
        let middle = cut.faces[cut.faces.len() / 2].map(|k| regular(100, [1.0, 0.1])[k]);
        assert!((middle[3] - middle[0]).length() < 0.21, "{middle:?}");
    }

    /// In any place, size and turn: the corners of random convex polygons, in the order of their edges' directions.
    #[test]
    fn random_convex_polygons_are_covered_once() {
        let mut state = 3;
        for round in 0..1000 {
            let n = 5 + (random(&mut state) * 60.0) as usize;
            let mut edges: Vec<DVec2> =
                (0..n).map(|_| DVec2::new(random(&mut state), random(&mut state)) - 0.5).collect();
            let mean = edges.iter().sum::<DVec2>() / n as f64;
            edges.iter_mut().for_each(|e| *e -= mean);
            edges.sort_by(|a, b| a.to_angle().total_cmp(&b.to_angle()));
            let scale = 10f64.powf(random(&mut state) * 12.0 - 6.0);
            let mut angle = || TAU * random(&mut state);
            let turn = DQuat::from_euler(glam::EulerRot::XYZ, angle(), angle(), angle());
            let away = dvec3(angle(), angle(), angle()) * 10.0 * scale;
            let mut at = DVec2::ZERO;
            let points: Vec<DVec3> = edges
                .iter()
                .map(|e| {
                    at += *e;
                    turn * dvec3(scale * at.x, scale * at.y, 0.0) + away
                })
                .collect();
            let cut = split(&points);
            assert_covers(&points, &cut, &format!("round {round}"));
            // The same polygon from another corner, and from behind.
            let mut other = points.clone();
            other.rotate_left(n / 3);
            assert_covers(&other, &split(&other), &format!("round {round}, turned"));
            other.reverse();
            assert_covers(&other, &split(&other), &format!("round {round}, from behind"));
        }
    }

    /// The half of a disc is cut along its diameter, wherever its corners begin.
    #[test]
    fn half_a_disc() {
        let mut points = regular(200, [1.0, 1.0]);
        points.truncate(101);
        for _ in 0..5 {
            points.rotate_left(23);
            let cut = split(&points);
            assert_covers(&points, &cut, "half");
            assert!(triangles(&cut) <= 2, "{}", triangles(&cut));
        }
    }

    /// Corners in a row, and dents, are not for strips; the polygon is covered all the same.
    #[test]
    fn others_are_not_cut_into_strips() {
        let flat = |p: &[[f64; 2]]| p.iter().map(|p| dvec3(p[0], p[1], 1.0)).collect::<Vec<_>>();
        let row = flat(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]);
        let dent = flat(&[[0.0, 0.0], [1.0, 0.5], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]);
        let star: Vec<_> = (0..5).map(|k| regular(5, [1.0, 1.0])[2 * k % 5]).collect();
        for points in [&row, &dent, &star] {
            assert!(cut(points, DVec3::Z, 2.0).is_none());
        }
        for points in [row, dent] {
            let cut = split(&points);
            assert_eq!(triangles(&cut), cut.faces.len());
            let covered: f64 = cut.faces.iter().map(|f| area_of(&points, f).z).sum();
            assert!((covered - area_vector(&points).z).abs() < 1e-12);
        }
    }

    /// Corners that are written with nine digits are as good; ten thousand of them take no time.
    #[test]
    fn many_rounded_corners() {
        for n in [24, 1000, 10_000] {
            let mut points = regular(n, [1.0, 1.0]);
            points.iter_mut().for_each(|p| *p = (*p * 1e9).round() / 1e9);
            let cut = split(&points);
            assert!(triangles(&cut) <= 2, "{n}: {} triangles", triangles(&cut));
            assert_covers(&points, &cut, &n.to_string());
        }
    }
}
