//! Exact form factors between polygons, nothing between them.
//!
//! Three ways to the same integral, chosen by how far the polygons are apart:
//!
//! - Gauss rules on both polygons where these are far apart for their size. Nothing cancels, so factors of
//!   1e-8 and less keep their digits;
//! - a Gauss rule on one, small for its distance, and Lambert's formula for the other;
//! - the double contour integral where they come close or touch.
//!
//! A Gauss rule of n points along a length 2 h converges like `rho^(-2 n)`, `rho = g + sqrt(1 + g^2)`, where g h is the
//! distance of the nearest singularity in the complex plane: the kernel is analytic within the Bernstein ellipse
//! of that rho, and no singularity is nearer than the other polygon.

mod contour;
mod lambert;
mod polygon;
mod quadrature;

pub use lambert::{differential, lambert};
pub use polygon::{Cut, MOST_CORNERS, Polygon};

use contour::contour;
use quadrature::{MOST_ORDER, kernel, points};

/// Relative accuracy of [`exchange`] where nobody needs less.
pub const EXACT: f64 = 1e-11;

/// Exchange area `A_a F_ab = A_b F_ba` [m^2] of two polygons' fronts, nothing between them; what lies behind
/// either one's plane does not take part. `tolerance`: relative error, at least 1e-11.
///
/// Touching polygons, shared edges and corners are fine; polygons that face away from each other
/// or lie in one plane give 0.
pub fn exchange(a: &Polygon, b: &Polygon, tolerance: f64) -> f64 {
    match facing(a, b) {
        Some((a, b)) => exchange_facing(&a, &b, tolerance),
        None => 0.0,
    }
}

/// [`exchange`] of polygons that lie in front of each other's planes, as [`facing`] leaves them.
pub fn exchange_facing(a: &Polygon, b: &Polygon, tolerance: f64) -> f64 {
    clipped(a, b, tolerance, SPLITS)
}

/// The parts of two polygons that lie in front of each other's planes.
pub fn facing(a: &Polygon, b: &Polygon) -> Option<(Polygon, Polygon)> {
    let part = |of: &Polygon, by: &Polygon| match of.before(by.corners()[0], by.normal) {
        Cut::All => Some(*of),
        Cut::Nothing => None,
        Cut::Part(p) => Some(p),
    };
    let b = part(b, a)?;
    Some((part(a, &b)?, b))
}

/// How often a pair may be halved where the contour integral cancels.
const SPLITS: u32 = 3;

/// [`exchange`] of polygons that lie in front of each other's planes.
fn clipped(a: &Polygon, b: &Polygon, tolerance: f64, splits: u32) -> f64 {
    let (ma, mb) = (a.middle(), b.middle());
    let (ra, rb) = (a.radius(ma), b.radius(mb));
    let gap = ma.distance(mb) - ra - rb;
    let [na, nb] = [ra, rb].map(|r| order(gap / r, tolerance));
    let fast = tolerance > 1e-9;
    // Costs, measured: a kernel 3 ns, a point of Lambert's formula 100, a contour 20,000 or, roughly, 5,000.
    let (most_kernels, most_points) = if fast { (1500, 49) } else { (8000, 144) };
    if na.max(nb) <= MOST_ORDER && na * na * nb * nb <= most_kernels {
        return kernel(a, b, [na, nb]);
    }
    if na.min(nb).pow(2) <= most_points && na.max(nb) > 3 {
        let (small, large, n) = if na <= nb { (a, b, na) } else { (b, a, nb) };
        let mut sum = 0.0;
        points(small, n, |p, w| sum += w * lambert(p, small.normal, large.corners()));
        return sum;
    }
    let mut whole = contour(a, b, if fast { 1e-6 } else { EXACT });
    if fast && 1e-6 * whole.magnitude > tolerance * whole.value {
        whole = contour(a, b, EXACT);
    }
    let rounding = 4.0 * f64::EPSILON * whole.magnitude;
    if rounding <= tolerance * whole.value || splits == 0 {
        return whole.value.max(0.0);
    }
    let (halved, other) = if ra >= rb { (a, b) } else { (b, a) };
    halved.halves().iter().flatten().map(|h| clipped(h, other, tolerance, splits - 1)).sum()
}

/// Points along a length whose half is `1/gap` of the distance of the other polygon, for this
/// relative error; beyond [`MOST_ORDER`] where there are not enough.
fn order(gap: f64, tolerance: f64) -> usize {
    if gap <= 0.1 {
        return MOST_ORDER + 1;
    }
    let rho = gap + (1.0 + gap * gap).sqrt();
    ((CONSTANT / tolerance).ln() / (2.0 * rho.ln()) + 1.0).ceil() as usize
}

/// Largest error of a rule over `rho^(2 - 2 n)`, measured over random pairs with room to spare (see the tests). One order
/// goes to cosines that vanish at an edge, which grow by up to rho within the ellipse, and to the weight of the
/// collapsed rule.
const CONSTANT: f64 = 1.0;
