//! Gauss points on polygons, and the kernel of the form-factor integral between them.

use super::polygon::{MOST_CORNERS, Polygon};
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::OnceLock;

/// Highest order of the rules below.
pub const MOST_POINTS: usize = 24;
/// Highest order on polygons.
pub const MOST_ORDER: usize = 12;
/// Points on one polygon: its pieces times the square of the order.
const CAPACITY: usize = (MOST_CORNERS - 2) * MOST_ORDER * MOST_ORDER;

/// Nodes in [0, 1] and weights of the Gauss-Legendre rule with `n` points.
pub fn gauss(n: usize) -> &'static [(f64, f64)] {
    static RULES: OnceLock<Vec<Vec<(f64, f64)>>> = OnceLock::new();
    &RULES.get_or_init(|| (0..=MOST_POINTS).map(rule).collect())[n]
}

/// Newton's iteration on the Legendre polynomials.
fn rule(n: usize) -> Vec<(f64, f64)> {
    let order = n as f64;
    (0..n)
        .map(|k| {
            let mut x = -(PI * (k as f64 + 0.75) / (order + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..100 {
                let (mut p, mut q) = (1.0, 0.0);
                for j in 1..=n {
                    let j = j as f64;
                    (p, q) = (((2.0 * j - 1.0) * x * p - (j - 1.0) * q) / j, p);
                }
                slope = order * (x * p - q) / (x * x - 1.0);
                let step = p / slope;
                x -= step;
                if step.abs() < 1e-16 {
                    break;
                }
            }
            (0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// Calls `visit` with the points of a rule of `order` points each way and their weights [m^2], which add
/// up to the polygon's area. Parallelograms take the product rule, other polygons the collapsed one
/// on a fan of triangles.
#[inline]
pub fn points(polygon: &Polygon, order: usize, mut visit: impl FnMut(DVec3, f64)) {
    let rule = gauss(order);
    let c = polygon.corners();
    let o = c[0];
    if c.len() == 4 {
        let (a, b) = (c[1] - o, c[3] - o);
        let off = (o + a + b - c[2]).abs().max_element();
        if off <= 1e-15 * (a.abs() + b.abs()).max_element() {
            let area = a.cross(b).length();
            for &(s, ws) in rule {
                let p = o + s * a;
                for &(t, wt) in rule {
                    visit(p + t * b, area * ws * wt);
                }
            }
            return;
        }
    }
    for k in 1..c.len() - 1 {
        let (a, b) = (c[k] - o, c[k + 1] - c[k]);
        let area = a.cross(b).length();
        for &(s, ws) in rule {
            let p = o + s * a;
            for &(t, wt) in rule {
                visit(p + (s * t) * b, area * s * ws * wt);
            }
        }
    }
}

/// The points of one polygon, by coordinate.
struct Points {
    x: [f64; CAPACITY],
    y: [f64; CAPACITY],
    z: [f64; CAPACITY],
    weight: [f64; CAPACITY],
}

/// `integral over a and b of cos cos' / (pi r^2)` [m^2] by product rules of the given orders, at most
/// [`MOST_ORDER`].
pub fn kernel(a: &Polygon, b: &Polygon, orders: [usize; 2]) -> f64 {
    thread_local! {
        static POINTS: std::cell::RefCell<Box<Points>> = std::cell::RefCell::new(Box::new(Points {
            x: [0.0; CAPACITY], y: [0.0; CAPACITY], z: [0.0; CAPACITY], weight: [0.0; CAPACITY],
        }));
    }
    POINTS.with_borrow_mut(|stored| {
        let mut n = 0;
        points(b, orders[1], |q, w| {
            (stored.x[n], stored.y[n], stored.z[n], stored.weight[n]) = (q.x, q.y, q.z, w);
            n += 1;
        });
        let (x, y, z, weight) = (&stored.x[..n], &stored.y[..n], &stored.z[..n], &stored.weight[..n]);
        let (na, nb) = (a.normal, b.normal);
        let mut sum = 0.0;
        points(a, orders[0], |p, w| {
            let mut inner = 0.0;
            for k in 0..n {
                let (dx, dy, dz) = (x[k] - p.x, y[k] - p.y, z[k] - p.z);
                let r2 = dx * dx + dy * dy + dz * dz;
                let cos = (dx * na.x + dy * na.y + dz * na.z) * (dx * nb.x + dy * nb.y + dz * nb.z);
                inner -= weight[k] * cos / (r2 * r2);
            }
            sum += w * inner;
        });
        sum / PI
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rule of n points integrates polynomials up to degree 2 n - 1, and no further.
    #[test]
    fn gauss_rules_have_their_degree() {
        for n in 1..=MOST_POINTS {
            let moment = |d: usize| gauss(n).iter().map(|(x, w)| w * x.powi(d as i32)).sum::<f64>();
            for degree in 0..2 * n {
                assert!((moment(degree) * (degree + 1) as f64 - 1.0).abs() < 1e-13, "{n} {degree}");
            }
            if n < 8 {
                assert!((moment(2 * n) * (2 * n + 1) as f64 - 1.0).abs() > 1e-12, "{n}");
            }
        }
    }
}
