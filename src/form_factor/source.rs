//! The rays of an element, 16 at a time.

use crate::embree::RayLanes;
use crate::geometry::Frame;
use crate::mesh::Mesh;
use crate::sampling::{Scramble, SobolTable, seed_of};
use crate::visibility::Visibility;
use glam::{DVec3, Vec3};

/// One element's rays: origins and the frame of their directions, in single precision.
pub(super) struct Source {
    origin: Vec3,
    a: Vec3,
    b: Vec3,
    x: Vec3,
    y: Vec3,
    z: Vec3,
    triangle: bool,
    pub(super) face: u32,
    pub(super) normal: DVec3,
    pub(super) area: f64,
}

impl Source {
    pub(super) fn new(visibility: &Visibility, mesh: &Mesh, element: u32) -> Source {
        let scene = visibility.scene();
        let (face, _, cell) = mesh.place(element);
        let (p0, e1, e2) = scene.face_frame(&scene.faces[face as usize]);
        let grid = mesh.grid(face);
        let (o, a, b) = visibility.inside_cell(face, grid.cell_frame(cell));
        let normal = mesh.normal(scene, element);
        let frame = Frame::new(normal);
        let edge = |d: glam::DVec2| (d.x * e1 + d.y * e2).as_vec3();
        Source {
            origin: visibility.leave(face, p0 + o.x * e1 + o.y * e2, normal),
            a: edge(a),
            b: edge(b),
            x: frame.x.as_vec3(),
            y: frame.y.as_vec3(),
            z: frame.z.as_vec3(),
            triangle: grid.triangle,
            face,
            normal,
            area: mesh.area(element),
        }
    }

    /// The rays of 16 points of the unit hypercube: origin from the first two, direction from the others.
    #[inline]
    pub(super) fn rays(&self, p: &[[f32; 16]; 4]) -> RayLanes {
        let mut rays = RayLanes { origin: [[0.0; 16]; 3], direction: [[0.0; 16]; 3] };
        let (mut s, mut t) = (p[0], p[1]);
        if self.triangle {
            for k in 0..16 {
                // [`crate::sampling::triangle`] without a branch.
                let (u, v) = (p[0][k], p[1][k]);
                let half = 0.5 * u.min(v);
                (s[k], t[k]) = if v > u { (half, v - half) } else { (u - half, half) };
            }
        }
        let (mut dx, mut dy, mut dz) = ([0.0; 16], [0.0; 16], [0.0; 16]);
        for k in 0..16 {
            (dx[k], dy[k]) = disc(p[2][k], p[3][k]);
            dz[k] = (1.0 - dx[k] * dx[k] - dy[k] * dy[k]).max(0.0).sqrt();
        }
        for c in 0..3 {
            let (o, a, b) = (self.origin[c], self.a[c], self.b[c]);
            let (x, y, z) = (self.x[c], self.y[c], self.z[c]);
            for k in 0..16 {
                rays.origin[c][k] = o + s[k] * a + t[k] * b;
                rays.direction[c][k] = dx[k] * x + dy[k] * y + dz[k] * z;
            }
        }
        rays
    }
}

/// Lane `k` of 16 rays.
#[inline]
pub(super) fn lane(rays: &RayLanes, k: usize) -> (Vec3, Vec3) {
    let at = |v: &[[f32; 16]; 3]| Vec3::new(v[0][k], v[1][k], v[2][k]);
    (at(&rays.origin), at(&rays.direction))
}

/// [`crate::sampling::concentric_disc`] in single precision; the angle stays within 45 degrees, where
/// short polynomials give sine and cosine to 1e-7.
#[inline]
fn disc(u: f32, v: f32) -> (f32, f32) {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    let swap = a.abs() <= b.abs();
    let (r, q) = if swap { (b, a) } else { (a, b) };
    // The centre has no angle; any will do.
    let phi = std::f32::consts::FRAC_PI_4 * (q / if r == 0.0 { 1.0 } else { r });
    let p2 = phi * phi;
    let sin = phi * (1.0 + p2 * (-1.0 / 6.0 + p2 * (1.0 / 120.0 + p2 * (-1.0 / 5040.0))));
    let cos = 1.0 + p2 * (-0.5 + p2 * (1.0 / 24.0 + p2 * (-1.0 / 720.0 + p2 * (1.0 / 40320.0))));
    if swap { (r * sin, r * cos) } else { (r * cos, r * sin) }
}

/// The rays that [`super::cast`] casts from an element in the first randomisation of its row, 16 at a time in the
/// same order: for measurements of single parts of that work.
pub fn element_rays(
    visibility: &Visibility,
    mesh: &Mesh,
    element: u32,
    table: &SobolTable,
    seed: u32,
) -> Vec<RayLanes> {
    let source = Source::new(visibility, mesh, element);
    let scramble = Scramble::new(seed_of(&[seed, element, 0]));
    (0..table.len().div_ceil(16)).map(|k| source.rays(&table.block(k, &scramble))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_disc_matches_the_exact_one() {
        for i in 0..=64 {
            for j in 0..=64 {
                let (u, v) = (i as f32 / 64.0, j as f32 / 64.0);
                let exact = crate::sampling::concentric_disc(f64::from(u), f64::from(v));
                let (x, y) = disc(u, v);
                assert!((f64::from(x) - exact.x).abs() < 1e-6 && (f64::from(y) - exact.y).abs() < 1e-6);
            }
        }
    }
}
