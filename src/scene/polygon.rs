//! Splits a polygon into what Embree holds: triangles and planar parallelograms.

use glam::{DVec2, DVec3};

/// A quad counts as a parallelogram when its fourth corner is within this share of its size of
/// where the other three put it.
const PARALLELOGRAM_TOLERANCE: f64 = 1e-7;
/// A polygon counts as planar when its corners are within this share of its size of its plane.
const PLANAR_TOLERANCE: f64 = 1e-3;
/// Less than this share of the squared size is no area: rounding of coordinates makes as much.
const AREA_TOLERANCE: f64 = 1e-12;

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
/// do, so that a quad that is not planar has the same shape everywhere.
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
        if (a - b + c - d).length() <= PARALLELOGRAM_TOLERANCE * size {
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
    clip_ears(points, normal, size, bent)
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
    earcut::Earcut::new().earcut_slice(&plane, &[], &mut corners);

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
