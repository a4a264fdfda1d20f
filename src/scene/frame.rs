//! The points of a face by (u, v).

use super::{Face, Scene};
use crate::sampling;
use glam::{DVec2, DVec3};

/// Where a face lies: at (u, v) is `origin + u e1 + v e2 + u v twist`, bilinear between the corners of a quad.
///
/// A parallelogram and a triangle have no twist; other quads are planar and convex, and so is every cell between lines of equal u
/// and v.
#[derive(Debug, Clone, Copy)]
pub struct FaceFrame {
    /// The first corner [m, relative to the scene's centre].
    pub origin: DVec3,
    /// From there to the second corner, along u \[m\].
    pub e1: DVec3,
    /// From there to the last corner, along v \[m\].
    pub e2: DVec3,
    /// From where the third corner of a parallelogram would be to where it is \[m\].
    pub twist: DVec3,
    /// The twist in multiples of `e1` and `e2`.
    skew: DVec2,
    triangle: bool,
}

/// What a quad's twist is in multiples of its edges at its first corner.
pub(super) fn skew([a, b, c, d]: [DVec3; 4]) -> DVec2 {
    affine((b - a, d - a), (a - b) + (c - d))
}

/// A vector of the plane of two others in multiples of these.
fn affine((e1, e2): (DVec3, DVec3), d: DVec3) -> DVec2 {
    let n = e1.cross(e2);
    DVec2::new(d.cross(e2).dot(n), e1.cross(d).dot(n)) / n.length_squared()
}

/// (u, v) of the point `a` multiples of `e1` and `b` of `e2` away from the origin.
///
/// `u v` solves a quadratic equation, of whose roots the one that goes to `a b` without a skew is meant. Beyond the lines on which
/// edges meet that are opposite each other there is none.
fn bilinear(skew: DVec2, at: DVec2) -> DVec2 {
    let (half, product) = (0.5 * (1.0 + at.x * skew.y + at.y * skew.x), at.x * at.y);
    at - skew * (product / (half + (half * half - skew.x * skew.y * product).sqrt()))
}

/// (u, v) of [`FaceFrame`] from what Embree counts on a quad: to it, that is two triangles that meet along the diagonal from the
/// second to the last corner.
#[inline(always)]
pub fn from_halves([cx, cy]: [f32; 2], u: f32, v: f32) -> (f32, f32) {
    let beyond = (u + v - 1.0).max(0.0);
    from_affine([cx, cy], u + cx * beyond, v + cy * beyond)
}

/// (u, v) of [`FaceFrame`] of the point `a` multiples of `e1` and `b` of `e2` away from the origin.
#[inline(always)]
pub fn from_affine([cx, cy]: [f32; 2], a: f32, b: f32) -> (f32, f32) {
    let (half, product) = (0.5 * (1.0 + a * cy + b * cx), a * b);
    let uv = product / (half + (half * half - cx * cy * product).max(0.0).sqrt());
    (a - cx * uv, b - cy * uv)
}

/// x in [0, 1] for `r` uniform there, with a density that goes linearly from `1 - slope` at 0 to `1 + slope` at 1.
fn linear(slope: f64, r: f64) -> f64 {
    let start = 1.0 - slope;
    2.0 * r / (start + (start * start + 4.0 * slope * r).sqrt())
}

impl FaceFrame {
    /// The point at (u, v) [m, relative to the scene's centre].
    #[inline]
    pub fn at(&self, uv: DVec2) -> DVec3 {
        self.origin + uv.x * self.e1 + uv.y * self.e2 + (uv.x * uv.y) * self.twist
    }

    /// The face is a quad, but no parallelogram: areas in (u, v) are none on the face.
    #[inline]
    pub fn is_twisted(&self) -> bool {
        self.skew != DVec2::ZERO
    }

    /// Area at (u, v), over the mean on the face.
    #[inline]
    pub fn density(&self, uv: DVec2) -> f64 {
        (1.0 + self.skew.y * uv.x + self.skew.x * uv.y) / (1.0 + 0.5 * (self.skew.x + self.skew.y))
    }

    /// (u, v) for (s, t) uniform in the unit square; uniform in area.
    #[inline]
    pub fn uniform(&self, s: f64, t: f64) -> DVec2 {
        match self.triangle {
            true => sampling::triangle(s, t).into(),
            false => self.even((DVec2::ZERO, DVec2::X, DVec2::Y), s, t),
        }
    }

    /// (s, t) of the point `origin + s a + t b` of a rectangle in (u, v), `a` along u and `b` along v, for numbers that are uniform
    /// in the unit square; uniform in area.
    #[inline]
    pub fn even(&self, (origin, a, b): (DVec2, DVec2, DVec2), s: f64, t: f64) -> DVec2 {
        if !self.is_twisted() {
            return DVec2::new(s, t);
        }
        let [along_s, along_t] = self.slopes((origin, a, b));
        let s = linear(along_s, s);
        DVec2::new(s, linear(along_t / (1.0 + (2.0 * s - 1.0) * along_s), t))
    }

    /// How much [`FaceFrame::density`] changes from the middle of such a rectangle along half of `a` and of `b`, over what it is there.
    pub fn slopes(&self, (origin, a, b): (DVec2, DVec2, DVec2)) -> [f64; 2] {
        let middle = self.density(origin + 0.5 * (a + b));
        [a, b].map(|edge| 0.5 * (self.density(origin + edge) - self.density(origin)) / middle)
    }

    /// (u, v) of a point of the face's plane; not a number for some that are far from a quad.
    pub fn coordinates(&self, p: DVec3) -> DVec2 {
        let at = affine((self.e1, self.e2), p - self.origin);
        if self.is_twisted() { bilinear(self.skew, at) } else { at }
    }

    /// Whether a point of the face's plane is on the face.
    pub fn contains(&self, p: DVec3) -> bool {
        let uv = self.coordinates(p);
        uv.min_element() >= 0.0 && if self.triangle { uv.x + uv.y } else { uv.max_element() } <= 1.0
    }
}

impl Scene {
    /// Where a face lies.
    #[inline]
    pub fn face_frame(&self, face: &Face) -> FaceFrame {
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| self.corner(face, k));
        // What rounding left of a parallelogram is nothing.
        let twist = if face.skew == DVec2::ZERO { DVec3::ZERO } else { (a - b) + (c - d) };
        FaceFrame { origin: a, e1: b - a, e2: d - a, twist, skew: face.skew, triangle: face.is_triangle() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> ([DVec3; 4], FaceFrame) {
        let (x, y) = (DVec3::new(0.6, 0.0, 0.8), DVec3::new(-0.8, 0.0, 0.6));
        let corners = [(0.1, 0.2), (2.1, 0.0), (1.7, 1.3), (0.0, 0.9)].map(|(a, b)| a * x + b * y);
        let [a, b, c, d] = corners;
        let (twist, skew) = ((a - b) + (c - d), skew(corners));
        (corners, FaceFrame { origin: a, e1: b - a, e2: d - a, twist, skew, triangle: false })
    }

    fn grid(n: u32) -> impl Iterator<Item = DVec2> {
        (0..n * n).map(move |k| DVec2::new(f64::from(k % n) + 0.5, f64::from(k / n) + 0.5) / f64::from(n))
    }

    /// Points lead to their coordinates and back; what lies outside is not on the face.
    #[test]
    fn coordinates_of_points() {
        let (corners, frame) = quad();
        for (k, uv) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].into_iter().enumerate() {
            assert!(frame.at(uv.into()).distance(corners[k]) < 1e-15);
        }
        for uv in grid(20).map(|p| 1.4 * p - 0.2) {
            let found = frame.coordinates(frame.at(uv));
            assert!(found.distance(uv) < 1e-12, "{uv} {found}");
            assert_eq!(frame.contains(frame.at(uv)), uv.min_element() > 0.0 && uv.max_element() < 1.0);
        }
        assert!(!frame.contains(corners[0] + 50.0 * (corners[2] - corners[1])));
    }

    /// Where Embree's two triangles have a point, it is the same one.
    #[test]
    fn coordinates_of_halves() {
        let ([a, b, c, d], frame) = quad();
        for uv in grid(20) {
            let p = if uv.x + uv.y <= 1.0 {
                a + uv.x * (b - a) + uv.y * (d - a)
            } else {
                c + (1.0 - uv.x) * (d - c) + (1.0 - uv.y) * (b - c)
            };
            let (u, v) = from_halves(frame.skew.as_vec2().to_array(), uv.x as f32, uv.y as f32);
            let found = DVec2::new(u.into(), v.into());
            assert!(found.distance(frame.coordinates(p)) < 1e-6, "{uv} {found}");
        }
    }

    /// Equal parts of the unit square become equal areas: of the face, and of a cell.
    #[test]
    fn points_are_even_in_area() {
        let (corners, frame) = quad();
        let area_of = |at: &dyn Fn(f64, f64) -> DVec3, s: f64, t: f64, h: f64| {
            let (p, q) = (at(s + h, t + h) - at(s, t), at(s, t + h) - at(s + h, t));
            0.5 * p.cross(q).length()
        };
        let diagonals = (corners[2] - corners[0]).cross(corners[3] - corners[1]);
        let whole = 0.5 * diagonals.length();
        let cell = (DVec2::new(0.25, 0.5), DVec2::new(0.5, 0.0), DVec2::new(0.0, 0.25));
        let of_cell = |s: f64, t: f64| {
            let p = frame.even(cell, s, t);
            frame.at(cell.0 + p.x * cell.1 + p.y * cell.2)
        };
        let exact = area_of(&|s, t| frame.at(cell.0 + s * cell.1 + t * cell.2), 0.0, 0.0, 1.0);
        let middle = frame.density(cell.0 + 0.5 * (cell.1 + cell.2)) * 0.125 * whole;
        assert!((middle - exact).abs() < 1e-12);
        for p in grid(10).map(|p| p - 0.05) {
            let of_face = area_of(&|s, t| frame.at(frame.uniform(s, t)), p.x, p.y, 0.1);
            assert!((of_face / (0.01 * whole) - 1.0).abs() < 2e-3, "{p}: {of_face}");
            let of_cell = area_of(&of_cell, p.x, p.y, 0.1);
            assert!((of_cell / (0.01 * exact) - 1.0).abs() < 2e-3, "{p}: {of_cell}");
        }
    }
}
