//! Which faces can come between two polygons: shafts (Haines and Wallace 1991).

use crate::form_factor::analytic::Polygon;
use glam::DVec3;

/// A polygon with the bounds that cheap tests want.
#[derive(Debug, Clone, Copy)]
pub struct Bounded {
    /// The polygon.
    pub polygon: Polygon,
    low: DVec3,
    high: DVec3,
}

impl Bounded {
    /// Bounds of a polygon.
    pub fn new(polygon: Polygon) -> Bounded {
        let corners = polygon.corners();
        let low = corners.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = corners.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        Bounded { polygon, low, high }
    }
}

/// The convex hull of two polygons that lie in front of each other's planes.
pub struct Shaft<'a> {
    a: &'a Polygon,
    b: &'a Polygon,
    low: DVec3,
    high: DVec3,
    /// Lengths below this are rounding [m].
    eps: f64,
    /// Planes with the hull behind them, found when they are first needed.
    sides: Option<Vec<(DVec3, DVec3)>>,
}

impl<'a> Shaft<'a> {
    /// The shaft between two polygons; `eps`: what counts as touching [m].
    pub fn new(a: &'a Polygon, b: &'a Polygon, eps: f64) -> Shaft<'a> {
        let corners = || a.corners().iter().chain(b.corners()).copied();
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        Shaft { a, b, low, high, eps, sides: None }
    }

    /// Whether a face may come between the polygons. False is certain: a plane separates the face from
    /// the hull, with at most `eps` of overlap. True is not.
    pub fn may_block(&mut self, face: &Bounded) -> bool {
        let (q, eps) = (&face.polygon, self.eps);
        let apart = (face.low + eps).cmpge(self.high) | (face.high - eps).cmple(self.low);
        if apart.any() && (self.high - self.low).min_element() > 2.0 * eps {
            return false;
        }
        if !q.reaches_before(self.a.corners()[0], self.a.normal, eps)
            || !q.reaches_before(self.b.corners()[0], self.b.normal, eps)
        {
            return false;
        }
        let o = q.corners()[0];
        for normal in [q.normal, -q.normal] {
            if !self.a.reaches_before(o, normal, eps) && !self.b.reaches_before(o, normal, eps) {
                return false;
            }
        }
        let (a, b) = (self.a, self.b);
        let sides = self.sides.get_or_insert_with(|| sides(a, b, eps));
        // At least one corner of the face must be inside each plane.
        sides.iter().all(|(point, normal)| q.reaches_before(*point, -*normal, eps))
    }
}

/// Planes through an edge of one polygon and a corner of the other that have both behind them.
fn sides(a: &Polygon, b: &Polygon, eps: f64) -> Vec<(DVec3, DVec3)> {
    let mut found = Vec::with_capacity(8);
    for (p, q) in [(a, b), (b, a)] {
        for (start, end) in p.edges() {
            let edge = end - start;
            for corner in q.corners() {
                let Some(normal) = edge.cross(*corner - start).try_normalize() else { continue };
                for normal in [normal, -normal] {
                    if !p.reaches_before(start, normal, eps) && !q.reaches_before(start, normal, eps) {
                        found.push((start, normal));
                    }
                }
            }
        }
    }
    found
}

/// Whether one face cuts every segment between two polygons.
///
/// The point where a segment meets the face's plane is a projective map of either end, so all such
/// points lie in the hull of those of the corners: it suffices that these lie in the face.
pub fn blocks_all(a: &Polygon, b: &Polygon, face: &Polygon) -> bool {
    let o = face.corners()[0];
    let side = |p: &Polygon| {
        let front = p.corners().iter().all(|c| (*c - o).dot(face.normal) > 0.0);
        let back = p.corners().iter().all(|c| (*c - o).dot(face.normal) < 0.0);
        f64::from(i8::from(front) - i8::from(back))
    };
    let sign = side(a);
    if sign == 0.0 || side(b) != -sign {
        return false;
    }
    a.corners().iter().all(|p| {
        face.edges().all(|(q0, q1)| {
            let outward = sign * (q0 - *p).cross(q1 - *p);
            b.corners().iter().all(|r| (*r - *p).dot(outward) <= 0.0)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(z: f64, low: f64, high: f64, up: bool) -> Polygon {
        let mut p = vec![
            DVec3::new(low, low, z),
            DVec3::new(high, low, z),
            DVec3::new(high, high, z),
            DVec3::new(low, high, z),
        ];
        if !up {
            p.reverse();
        }
        Polygon::new(&p, if up { DVec3::Z } else { -DVec3::Z })
    }

    #[test]
    fn faces_between_and_beside() {
        let (a, b) = (square(0.0, 0.0, 1.0, true), square(1.0, 0.0, 0.5, false));
        let blocks = |q: Polygon| Shaft::new(&a, &b, 1e-9).may_block(&Bounded::new(q));
        assert!(blocks(square(0.5, 0.2, 0.4, true)) && blocks(square(0.5, 0.7, 2.0, false)));
        // The shaft is 0.75 wide half-way; beyond are the planes of a and b and what lies in them.
        assert!(!blocks(square(0.5, 0.751, 0.9, true)) && blocks(square(0.5, 0.749, 0.9, true)));
        assert!(!blocks(square(1.0, 0.0, 0.5, true)) && !blocks(square(0.0, -5.0, 5.0, true)));
        assert!(!blocks(square(1.1, 0.0, 1.0, true)) && !blocks(square(-0.1, 0.0, 1.0, true)));
        assert!(blocks_all(&a, &b, &square(0.5, 0.0, 0.75, true)));
        assert!(blocks_all(&a, &b, &square(0.5, 0.0, 0.75, false)));
        assert!(!blocks_all(&a, &b, &square(0.5, 0.0, 0.74, true)));
        assert!(!blocks_all(&a, &b, &square(1.5, -9.0, 9.0, true)));
    }
}
