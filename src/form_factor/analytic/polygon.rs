//! Convex planar polygons, cut by planes.

use crate::mesh::Mesh;
use crate::scene::{Face, Scene};
use glam::DVec3;

/// Most corners that a polygon keeps: four of an element, and one more for each plane that cuts it.
pub const MOST_CORNERS: usize = 12;

/// Corners within this share of the coordinates' size of a plane lie on it: rounding, not geometry.
const ON_PLANE: f64 = 1e-15;

/// Shares of a diagonal that a parallelogram's corner may be off by: rounding, not geometry.
const PARALLEL: f64 = 1e-12;

/// A convex planar polygon, counter-clockwise seen from the front.
#[derive(Debug, Clone, Copy)]
pub struct Polygon {
    corners: [DVec3; MOST_CORNERS],
    len: usize,
    /// Unit normal of the front.
    pub normal: DVec3,
}

/// Which part of a polygon lies in front of a plane.
#[allow(clippy::large_enum_variant)] // lives on the stack for a moment, in loops that must not allocate
pub enum Cut {
    /// All of it.
    All,
    /// Nothing.
    Nothing,
    /// This part.
    Part(Polygon),
}

impl Polygon {
    /// A polygon from its corners.
    pub fn new(corners: &[DVec3], normal: DVec3) -> Polygon {
        let mut all = [DVec3::ZERO; MOST_CORNERS];
        all[..corners.len()].copy_from_slice(corners);
        Polygon { corners: all, len: corners.len(), normal }
    }

    /// A face of a scene.
    pub fn of_face(scene: &Scene, face: &Face) -> Polygon {
        let all = [0, 1, 2, 3].map(|k| scene.corner(face, k));
        Polygon::new(&all[..if face.is_triangle() { 3 } else { 4 }], face.normal)
    }

    /// The cell that an element covers.
    pub fn of_element(scene: &Scene, mesh: &Mesh, element: u32) -> Polygon {
        let (face, front, cell) = mesh.place(element);
        let face_ref = &scene.faces[face as usize];
        let grid = mesh.grid(face);
        let polygon = if grid.len() == 1 {
            Polygon::of_face(scene, face_ref)
        } else {
            let frame = scene.face_frame(face_ref);
            let (o, a, b) = grid.cell_frame(cell);
            let at = |uv: glam::DVec2| frame.at(uv);
            let corners =
                [at(o), at(o + a), at(if grid.is_triangle() { o + b } else { o + a + b }), at(o + b)];
            Polygon::new(&corners[..if grid.is_triangle() { 3 } else { 4 }], face_ref.normal)
        };
        if front { polygon } else { polygon.turned() }
    }

    /// The same seen from behind.
    pub fn turned(mut self) -> Polygon {
        self.corners[..self.len].reverse();
        self.normal = -self.normal;
        self
    }

    /// The corners.
    #[inline]
    pub fn corners(&self) -> &[DVec3] {
        &self.corners[..self.len]
    }

    /// Start and end of every edge.
    #[inline]
    pub fn edges(&self) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
        (0..self.len).map(|k| (self.corners[k], self.corners[if k + 1 == self.len { 0 } else { k + 1 }]))
    }

    /// Mean of the corners.
    pub fn middle(&self) -> DVec3 {
        self.corners().iter().sum::<DVec3>() / self.len as f64
    }

    /// Largest distance of a corner from `point`.
    pub fn radius(&self, point: DVec3) -> f64 {
        self.corners().iter().map(|c| c.distance_squared(point)).fold(0.0, f64::max).sqrt()
    }

    /// Area [m^2].
    pub fn area(&self) -> f64 {
        let o = self.corners[0];
        let sum: DVec3 =
            (1..self.len - 1).map(|k| (self.corners[k] - o).cross(self.corners[k + 1] - o)).sum();
        0.5 * sum.length()
    }

    /// The point for (s, t) uniform in the unit square; uniform in area.
    pub fn point(&self, s: f64, t: f64) -> DVec3 {
        let o = self.corners[0];
        if let [_, a, c, b] = *self.corners() {
            // Parallelograms, as most elements are, keep points as evenly spread as they come.
            let (a, b) = (a - o, b - o);
            if (o + a + b - c).abs().max_element() <= PARALLEL * (c - o).abs().max_element() {
                return o + s * a + t * b;
            }
        }
        let triangle = |k: usize| {
            let (a, b) = (self.corners[k] - o, self.corners[k + 1] - o);
            (a, b, a.cross(b).length())
        };
        let last = self.len - 2;
        let mut rest = s * (1..=last).map(|k| triangle(k).2).sum::<f64>();
        let mut k = 1;
        let (mut a, mut b, mut area) = triangle(k);
        while rest > area && k < last {
            rest -= area;
            k += 1;
            (a, b, area) = triangle(k);
        }
        // The share of the triangle that is used up says how far from the first corner.
        let away = if area > 0.0 { (rest / area).clamp(0.0, 1.0).sqrt() } else { 0.0 };
        o + away * ((1.0 - t) * a + t * b)
    }

    /// Whether some of the polygon lies more than `eps` in front of the plane through `point`.
    #[inline]
    pub fn reaches_before(&self, point: DVec3, normal: DVec3, eps: f64) -> bool {
        self.corners().iter().any(|c| (*c - point).dot(normal) > eps)
    }

    /// Whether all of the polygon lies well in front of another one's plane.
    #[inline]
    pub fn lies_before(&self, other: &Polygon) -> bool {
        let o = other.corners[0];
        self.corners().iter().all(|c| {
            let r = *c - o;
            r.dot(other.normal) > ON_PLANE * r.abs().max_element()
        })
    }

    /// The part in front of the plane through `point` with this normal (of any length).
    #[inline]
    pub fn before(&self, point: DVec3, normal: DVec3) -> Cut {
        let mut distance = [0.0; MOST_CORNERS];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let scale = ON_PLANE * normal.abs().max_element();
        for (d, c) in distance.iter_mut().zip(self.corners()) {
            let r = *c - point;
            *d = r.dot(normal);
            if d.abs() <= scale * r.abs().max_element() {
                *d = 0.0;
            }
            low = low.min(*d);
            high = high.max(*d);
        }
        if low >= 0.0 {
            return if high > 0.0 { Cut::All } else { Cut::Nothing };
        }
        if high <= 0.0 {
            return Cut::Nothing;
        }
        let mut part = Polygon { len: 0, ..*self };
        for k in 0..self.len {
            let next = if k + 1 == self.len { 0 } else { k + 1 };
            let (d, e) = (distance[k], distance[next]);
            if d >= 0.0 {
                part.push(self.corners[k]);
            }
            if (d < 0.0 && e > 0.0) || (d > 0.0 && e < 0.0) {
                // From the end that lies in front, so that both sides of a cut get the same corner.
                let (p, q, d, e) = if d > 0.0 {
                    (self.corners[k], self.corners[next], d, e)
                } else {
                    (self.corners[next], self.corners[k], e, d)
                };
                part.push(p + d / (d - e) * (q - p));
            }
        }
        if part.len < 3 { Cut::Nothing } else { Cut::Part(part) }
    }

    /// Adds a corner. Beyond [`MOST_CORNERS`] (seven cuts, each taking a corner of its own) the
    /// last corner gives way: the polygon loses the sliver between.
    fn push(&mut self, corner: DVec3) {
        if self.len == MOST_CORNERS {
            self.len -= 1;
        }
        self.corners[self.len] = corner;
        self.len += 1;
    }

    /// Two halves, cut across the longest edge through the middle.
    pub fn halves(&self) -> [Option<Polygon>; 2] {
        let along = self.edges().map(|(a, b)| b - a).max_by(|a, b| a.length().total_cmp(&b.length()));
        self.halves_across(along.unwrap_or(DVec3::X))
    }

    /// The parts on either side of the plane through the middle with this normal.
    pub fn halves_across(&self, normal: DVec3) -> [Option<Polygon>; 2] {
        [normal, -normal].map(|n| match self.before(self.middle(), n) {
            Cut::All => Some(*self),
            Cut::Nothing => None,
            Cut::Part(p) => Some(p),
        })
    }
}
