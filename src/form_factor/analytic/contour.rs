//! The double contour integral.
//!
//! `A_1 F_12 = 1/(2 pi) sum over edges of cos(e_1, e_2) int int ln r ds dt` (Sparrow 1963; the inner integral along
//! an edge is closed, Schroeder and Hanrahan 1993, section 3). The outer integral runs over pieces that end
//! where the edges come close, by Gauss rules where they stay apart and by the double exponential rule
//! (Takahasi and Mori 1974) where they touch: the integrand then ends like `s ln s`.

use super::polygon::Polygon;
use super::quadrature::gauss;
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::OnceLock;

/// The integral, and the sum of the magnitudes that it is made of, both [m^2].
pub struct Contour {
    /// `A_1 F_12`.
    pub value: f64,
    /// Rounding costs some 1e-16 of this.
    pub magnitude: f64,
}

/// Integrates around both polygons, each wholly in front of the other's plane, to about `tolerance` of
/// the magnitude.
pub fn contour(a: &Polygon, b: &Polygon, tolerance: f64) -> Contour {
    // Any unit of length will do, since closed contours do not see it; this keeps the logarithms small.
    let unit = a.middle().distance(b.middle()).max(f64::MIN_POSITIVE);
    let (mut value, mut magnitude) = (0.0, 0.0);
    for (p0, p1) in a.edges() {
        for (q0, q1) in b.edges() {
            let pair = EdgePair::new([p0 / unit, p1 / unit], [q0 / unit, q1 / unit]);
            let term = pair.cosine * if pair.cosine == 0.0 { 0.0 } else { pair.integral(tolerance) };
            value += term;
            magnitude += term.abs();
        }
    }
    let scale = unit * unit / (2.0 * PI);
    Contour { value: value * scale, magnitude: magnitude * scale }
}

struct EdgePair {
    p: [DVec3; 2],
    q: [DVec3; 2],
    /// Unit directions and lengths.
    u: DVec3,
    v: DVec3,
    length: f64,
    other: f64,
    cosine: f64,
}

impl EdgePair {
    fn new(p: [DVec3; 2], q: [DVec3; 2]) -> EdgePair {
        let (d, e) = (p[1] - p[0], q[1] - q[0]);
        let (length, other) = (d.length(), e.length());
        if length == 0.0 || other == 0.0 {
            return EdgePair { p, q, u: d, v: e, length, other, cosine: 0.0 };
        }
        let (u, v) = (d / length, e / other);
        EdgePair { p, q, u, v, length, other, cosine: u.dot(v) }
    }

    /// `int ln r dt` along the other edge, less its length (whose sum around a contour is none),
    /// from the point at `offset` from the end `end` of this edge.
    ///
    /// The foot's height `h` above the other edge's line and the distances `a`, `b` along it give
    /// `[x ln(x^2 + h^2) / 2]_a^b + h (atan(b/h) - atan(a/h))`.
    #[inline]
    fn inner(&self, end: usize, offset: f64) -> f64 {
        let w0 = self.q[0] - self.p[end] - offset * self.u;
        let w1 = self.q[1] - self.p[end] - offset * self.u;
        let (a, b) = (w0.dot(self.v), w1.dot(self.v));
        // From the nearer end: less rounding.
        let near = if a.abs() < b.abs() { w0 } else { w1 };
        let h2 = near.cross(self.v).length_squared();
        let term = |x: f64| if x == 0.0 { 0.0 } else { 0.5 * x * (x * x + h2).ln() };
        let h = h2.sqrt();
        term(b) - term(a) + h * (h * self.other).atan2(h2 + a * b)
    }

    /// The outer integral.
    fn integral(&self, tolerance: f64) -> f64 {
        let (s, gap) = self.closest();
        // Distance of the nearest singularity over half the length gives the order (Bernstein ellipse).
        let order = match gap / self.length {
            r if r >= 3.0 => 8,
            r if r >= 1.0 => 12,
            r if r >= 0.4 => 24,
            _ => return self.pieces(s, tolerance),
        };
        let order = if tolerance > 1e-9 { order / 2 } else { order };
        let rule = gauss(order);
        self.length * rule.iter().map(|(x, w)| w * self.inner(0, x * self.length)).sum::<f64>()
    }

    /// Cuts at the points of closest approach to the other edge and its ends.
    fn pieces(&self, closest: f64, tolerance: f64) -> f64 {
        let mut cuts = [0.0, self.length, closest, 0.0, 0.0];
        for k in 0..2 {
            cuts[3 + k] = (self.q[k] - self.p[0]).dot(self.u);
        }
        cuts.sort_by(f64::total_cmp);
        let least = 1e-13 * self.length;
        let (mut start, mut sum) = (0.0, 0.0);
        for cut in cuts {
            if cut > start + least && (cut < self.length - least || cut == self.length) {
                sum += self.double_exponential(start, cut, tolerance);
                start = cut;
            }
        }
        sum
    }

    /// The integral from `from` to `to`, which may end in singularities.
    fn double_exponential(&self, from: f64, to: f64, tolerance: f64) -> f64 {
        let half = 0.5 * (to - from);
        // Offsets count from the nearer end, so that points close to it keep their digits.
        let at = |x: f64, back: bool| {
            let s = if back { to - x } else { from + x };
            if s > 0.5 * self.length {
                let rest = self.length - to;
                let from_end = if back { rest + x } else { self.length - s };
                self.inner(1, -from_end)
            } else {
                self.inner(0, s)
            }
        };
        let levels = nodes();
        let mut sum = 0.5 * PI * at(half, false);
        let mut last = f64::INFINITY;
        for (level, nodes) in levels.iter().enumerate() {
            for &(distance, weight) in nodes {
                let x = distance * half;
                sum += weight * (at(x, false) + at(x, true));
            }
            let value = half * sum * 0.5f64.powi(level as i32 + 1);
            // Each level adds about as many digits as there were; half as many are counted on.
            if (value - last).abs() <= 0.1 * tolerance.powf(0.8) * half * self.other && level >= 2 {
                return value;
            }
            last = value;
        }
        last
    }

    /// Where this edge comes closest to the other, and how close.
    fn closest(&self) -> (f64, f64) {
        let w = self.p[0] - self.q[0];
        let (b, d, e) = (self.cosine, self.u.dot(w), self.v.dot(w));
        let det = 1.0 - b * b;
        let clamp = |s: f64| s.clamp(0.0, self.length);
        let mut best = (0.0, f64::INFINITY);
        let mut consider = |s: f64, t: f64| {
            let (s, t) = (clamp(s), t.clamp(0.0, self.other));
            let gap = (w + s * self.u - t * self.v).length();
            if gap < best.1 {
                best = (s, gap);
            }
        };
        if det > 1e-14 {
            let s = clamp((b * e - d) / det);
            consider(s, b * s + e);
            let t = ((e - b * d) / det).clamp(0.0, self.other);
            consider(b * t - d, t);
        }
        for (s, t) in
            [(0.0, e), (self.length, b * self.length + e), (-d, 0.0), (b * self.other - d, self.other)]
        {
            consider(s, t);
        }
        best
    }
}

/// Distances of the nodes from the end of an interval of half-length 1, and weights, by level: level k
/// halves the step of the level before and holds the new nodes only; its step is `2^-(k + 1)`.
fn nodes() -> &'static [Vec<(f64, f64)>] {
    static NODES: OnceLock<Vec<Vec<(f64, f64)>>> = OnceLock::new();
    NODES.get_or_init(|| {
        (0..7)
            .map(|level| {
                let step = 0.5f64.powi(level + 1);
                (1..)
                    .map(|k| (k, f64::from(k) * step))
                    .take_while(|(_, t)| *t < 3.3)
                    .filter(|(k, _)| level == 0 || k % 2 == 1)
                    .map(|(_, t)| {
                        let q = (-PI * t.sinh()).exp();
                        (2.0 * q / (1.0 + q), 0.5 * PI * t.cosh() * 4.0 * q / ((1.0 + q) * (1.0 + q)))
                    })
                    .collect()
            })
            .collect()
    })
}
