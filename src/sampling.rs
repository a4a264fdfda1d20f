//! Low-discrepancy points and the maps from the unit square to areas and directions.
//!
//! The points are Sobol's with hash-based Owen scrambling (Burley 2020) from `sobol_burley`.

use glam::{DVec2, DVec3};
use pulp::Arch;
use sobol_burley::parts;

/// Longest sequence that `sobol_burley` holds; longer runs use several randomisations.
pub const MAX_POINTS: u32 = 1 << 16;
/// Most rays of an element, or samples of a pixel, that may be asked for.
pub const MOST_SAMPLES: u32 = 1 << 30;

/// Mixes integers to a well-distributed 32-bit seed (PCG-style avalanche).
pub fn seed_of(parts: &[u32]) -> u32 {
    let mut h = 0x9e37_79b9u32;
    for &p in parts {
        h ^= p.wrapping_mul(0x85eb_ca6b);
        h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
        h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
        h ^= h >> 16;
    }
    h
}

/// Four dimensions of point `index` of the sequence with this seed, in [0, 1). After [`MAX_POINTS`] points
/// an independent sequence follows.
#[inline]
pub fn sobol(index: u32, set: u32, seed: u32) -> [f64; 4] {
    let [a, b, c, d] = points(index, set, seed);
    [a.into(), b.into(), c.into(), d.into()]
}

/// The first four dimensions as [`sobol`] has them, in units of 2^-32 (the lower 9 bits are zero): for points that several
/// estimates share and shift (exclusive or), each by bits of its own.
#[inline(always)]
pub fn sobol_bits(index: u32, seed: u32) -> [u32; 4] {
    // In [1, 2) the fraction's bits are the number's own.
    let [a, b, c, d] = points(index, 0, seed);
    [(a + 1.0).to_bits() << 9, (b + 1.0).to_bits() << 9, (c + 1.0).to_bits() << 9, (d + 1.0).to_bits() << 9]
}

#[inline(always)]
fn points(index: u32, set: u32, seed: u32) -> [f32; 4] {
    let seed = if index < MAX_POINTS { seed } else { seed_of(&[seed, index / MAX_POINTS]) };
    sobol_burley::sample_4d(index % MAX_POINTS, set, seed)
}

/// Leading bits of the first two dimensions that may be shared by the shifts of several estimates of `points` points each:
/// each cell of that size holds equally many points, one of each run of as many points as there are cells (Sobol's first two
/// dimensions are a (0, 2)-sequence), also after the order has been shuffled by [`sobol`].
pub fn cell_bits(points: u32) -> [u32; 2] {
    let bits = points.trailing_zeros().min(MAX_POINTS.ilog2());
    [bits.div_ceil(2), bits / 2]
}

/// The upper bits of an integer in units of 2^-32, as a number in [0, 1).
#[inline(always)]
pub fn unit(x: u32) -> f32 {
    f32::from_bits(0x3f80_0000 | x >> 9) - 1.0
}

/// The first `n` Sobol points in four dimensions, before scrambling, in an order in which
/// neighbours share an elementary interval of dimensions 2 and 3 (the direction).
///
/// Owen scrambling permutes elementary intervals as a whole, so the order sorts the scrambled
/// points of every seed too: 16 consecutive points lie within a fraction 16/n of the square.
pub struct SobolTable {
    /// Bit-reversed coordinates by dimension.
    reversed: [Vec<u32>; 4],
    shared_bits: u32,
}

impl SobolTable {
    /// The first `n` points, 1 <= n <= [`MAX_POINTS`].
    pub fn new(n: u32) -> SobolTable {
        SobolTable::of(n, |i, d| parts::sobol_rev(i.reverse_bits(), d))
    }

    /// `n` independent random points in the same order, for comparison: scrambled, they stay independent and uniform, and
    /// different scramblings of them are independent of each other.
    pub fn random(n: u32, seed: u32) -> SobolTable {
        SobolTable::of(n, |i, d| seed_of(&[seed, i, d, 0x9d]))
    }

    /// Points from the reversed bits of coordinate d of point i.
    fn of(n: u32, reversed: impl Fn(u32, u32) -> u32) -> SobolTable {
        let n = n.clamp(1, MAX_POINTS);
        let mut order: Vec<(u64, u32)> = (0..n)
            .map(|i| {
                let bits = |d: u32| reversed(i, d).reverse_bits();
                (interleave(bits(2)) << 1 | interleave(bits(3)), i)
            })
            .collect();
        order.sort_unstable();
        let shared_bits = (1..=8)
            .take_while(|b| {
                // Sorted, the points of a cell follow each other: equally many in each cell means that each run is as long.
                let cell = |k: usize| order[k].0 >> (64 - 2 * b);
                let each = order.len() >> (2 * b);
                each << (2 * b) == order.len()
                    && each > 0
                    && (0..order.len()).all(|k| cell(k) == (k / each) as u64)
            })
            .count() as u32;
        let reversed = [0, 1, 2, 3].map(|d| order.iter().map(|(_, i)| reversed(*i, d)).collect());
        SobolTable { reversed, shared_bits }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.reversed[0].len()
    }

    /// Never true: a table holds at least one point.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The largest b for which each of the 4^b equal cells of the direction holds equally many points.
    pub fn shared_bits(&self) -> u32 {
        self.shared_bits
    }

    /// All points under one scrambling.
    pub fn scramble(&self, scramble: &Scramble, points: &mut ScrambledPoints) {
        for ((out, reversed), seed) in points.0.iter_mut().zip(&self.reversed).zip(scramble.0) {
            out.resize(reversed.len(), 0);
            // With what the processor can do: whole numbers, the same whatever it is.
            Arch::new().dispatch(|| {
                for (out, x) in out.iter_mut().zip(reversed) {
                    *out = parts::owen_scramble_rev(*x, seed).reverse_bits();
                }
            });
        }
    }
}

/// Points of a [`SobolTable`] under one scrambling, in the table's order.
#[derive(Debug, Default)]
pub struct ScrambledPoints([Vec<u32>; 4]);

impl ScrambledPoints {
    /// Coordinate `d` (0 to 3) of every point, in units of 2^-32.
    #[inline]
    pub fn coordinate(&self, d: usize) -> &[u32] {
        &self.0[d]
    }
}

/// One Owen scrambling of a [`SobolTable`]: independent seeds give independent randomisations.
pub struct Scramble([u32; 4]);

impl Scramble {
    /// The scrambling with this seed, different in each of the four dimensions.
    pub fn new(seed: u32) -> Scramble {
        Scramble([0, 1, 2, 3].map(|d| seed_of(&[seed, d])))
    }
}

/// Spreads the upper 32 bits so that two values can be interleaved, most significant bit first.
fn interleave(v: u32) -> u64 {
    let mut x = u64::from(v);
    for (shift, mask) in [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ] {
        x = (x | (x << shift)) & mask;
    }
    x
}

/// Unit square to unit disc, area-preserving (Shirley and Chiu 1997).
pub fn concentric_disc(u: f64, v: f64) -> DVec2 {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    if a == 0.0 && b == 0.0 {
        return DVec2::ZERO;
    }
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    let (r, phi) =
        if a.abs() > b.abs() { (a, FRAC_PI_4 * (b / a)) } else { (b, FRAC_PI_2 - FRAC_PI_4 * (a / b)) };
    DVec2::new(r * phi.cos(), r * phi.sin())
}

/// [`cosine_hemisphere`] in single precision; the angle on the disc stays within 45 degrees, where short polynomials give sine and
/// cosine to 1e-7.
#[inline(always)]
pub fn cosine_hemisphere_rough(u: f32, v: f32) -> [f32; 3] {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    let swap = a.abs() <= b.abs();
    let (r, q) = if swap { (b, a) } else { (a, b) };
    // The centre has no angle; any will do.
    let phi = std::f32::consts::FRAC_PI_4 * (q / if r == 0.0 { 1.0 } else { r });
    let p2 = phi * phi;
    let sin = phi * (1.0 + p2 * (-1.0 / 6.0 + p2 * (1.0 / 120.0 + p2 * (-1.0 / 5040.0))));
    let cos = 1.0 + p2 * (-0.5 + p2 * (1.0 / 24.0 + p2 * (-1.0 / 720.0 + p2 * (1.0 / 40320.0))));
    // The radius is known before the angle: what follows need not wait for sine and cosine.
    let z = (1.0 - r * r).sqrt();
    if swap { [r * sin, r * cos, z] } else { [r * cos, r * sin, z] }
}

/// Unit disc to unit square: the inverse of [`concentric_disc`].
pub fn concentric_square(d: DVec2) -> (f64, f64) {
    use std::f64::consts::FRAC_2_PI;
    let r = d.length();
    if r == 0.0 {
        return (0.5, 0.5);
    }
    let (a, b) = if d.x.abs() > d.y.abs() {
        let r = r.copysign(d.x);
        (r, r * 2.0 * FRAC_2_PI * (d.y / d.x).atan())
    } else {
        let r = r.copysign(d.y);
        (r * 2.0 * FRAC_2_PI * (d.x / d.y).atan(), r)
    };
    (0.5 * (a + 1.0), 0.5 * (b + 1.0))
}

/// Unit square to the cosine-weighted hemisphere about +z; density cos(theta) / pi.
pub fn cosine_hemisphere(u: f64, v: f64) -> DVec3 {
    let d = concentric_disc(u, v);
    DVec3::new(d.x, d.y, (1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Unit square to the triangle s, t >= 0, s + t <= 1, area-preserving (Heitz 2019).
#[inline]
pub fn triangle(u: f64, v: f64) -> (f64, f64) {
    if v > u {
        let s = u * 0.5;
        (s, v - s)
    } else {
        let t = v * 0.5;
        (u - t, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_holds_a_net_sorted_by_direction() {
        let table = SobolTable::new(256);
        for seed in [1, 77, 12345] {
            let scramble = Scramble::new(seed);
            let mut cells = [0; 256];
            let mut all = ScrambledPoints::default();
            table.scramble(&scramble, &mut all);
            let points: Vec<[f64; 4]> = (0..256)
                .map(|k| [0, 1, 2, 3].map(|d| f64::from(all.coordinate(d)[k]) / 4_294_967_296.0))
                .collect();
            for p in &points {
                assert!(p.iter().all(|x| (0.0..1.0).contains(x)));
                // Dimensions 0 and 1 form a (0, 8, 2)-net: one point in each 1/16 x 1/16 cell.
                cells[(p[0] * 16.0) as usize * 16 + (p[1] * 16.0) as usize] += 1;
            }
            assert_eq!(cells, [1; 256]);
            // Sixteen neighbours stay within one elementary interval of the direction.
            for block in 0..16 {
                let cell = |k: usize| {
                    let p = points[block * 16 + k];
                    ((p[2] * 4.0) as u32, (p[3] * 4.0) as u32)
                };
                assert!((1..16).all(|k| cell(k) == cell(0)), "block {block}");
            }
        }
    }

    /// Random points: the share of 64 of them in a box of volume 0.3 * 0.7 * 0.5 * 0.9 has the variance of independent
    /// points, p (1 - p) / n, over 4000 scramblings of one table; the same over those of 4000 tables. The standard error of
    /// a variance is sqrt(2/4000) = 2.2 %: four of them. Sobol points of the same number have a third of it.
    #[test]
    fn random_points_are_independent() {
        const RUNS: u32 = 4000;
        let (n, box_) = (64u32, [0.3f64, 0.7, 0.5, 0.9]);
        let p: f64 = box_.iter().product();
        let share = |table: &SobolTable, seed: u32| {
            let scramble = Scramble::new(seed_of(&[seed, 77]));
            let mut points = ScrambledPoints::default();
            table.scramble(&scramble, &mut points);
            let at = |d: usize, k: usize| f64::from(points.coordinate(d)[k]) / 4_294_967_296.0;
            let inside = |k: &usize| (0..4).all(|d| at(d, *k) < box_[d]);
            (0..n as usize).filter(inside).count() as f64 / f64::from(n)
        };
        let variance = |share: &dyn Fn(u32) -> f64| {
            let (mut sum, mut square) = (0.0, 0.0);
            for seed in 0..RUNS {
                let off = share(seed) - p;
                (sum, square) = (sum + off, square + off * off);
            }
            let (mean, mean_square) = (sum / f64::from(RUNS), square / f64::from(RUNS));
            // The mean is p within four standard errors.
            assert!(mean.abs() < 4.0 * (mean_square / f64::from(RUNS)).sqrt(), "{mean}");
            mean_square / (p * (1.0 - p) / f64::from(n))
        };
        let one = SobolTable::random(n, 5);
        for ratio in [variance(&|s| share(&one, s)), variance(&|s| share(&SobolTable::random(n, s), s))] {
            assert!((ratio - 1.0).abs() < 4.0 * 0.0224, "{ratio}");
        }
        let sobol = SobolTable::new(n);
        let ratio = variance(&|s| share(&sobol, s));
        assert!(ratio < 0.5, "{ratio}");
    }

    /// The cells of directions that elements share hold equally many points, and none finer do.
    #[test]
    fn shared_cells_are_equally_full() {
        for n in [1, 4, 16, 48, 63, 64, 100, 256, 1024] {
            let table = SobolTable::new(n);
            let mut points = ScrambledPoints::default();
            table.scramble(&Scramble::new(9), &mut points);
            let equal = |b: u32| {
                let mut cells = std::collections::HashMap::<(u32, u32), usize>::new();
                let leading = |d: usize, k: usize| points.coordinate(d)[k].checked_shr(32 - b).unwrap_or(0);
                (0..table.len()).for_each(|k| *cells.entry((leading(2, k), leading(3, k))).or_default() += 1);
                cells.len() == 1 << (2 * b) && cells.values().all(|c| *c == table.len() >> (2 * b))
            };
            let b = table.shared_bits();
            assert!((0..=b).all(equal) && !equal(b + 1), "{n} points: {b}");
        }
        assert_eq!(SobolTable::new(64).shared_bits(), 3);
    }

    #[test]
    fn the_rough_hemisphere_matches_the_exact_one() {
        for i in 0..=64 {
            for j in 0..=64 {
                let (u, v) = (i as f32 / 64.0, j as f32 / 64.0);
                let exact = cosine_hemisphere(f64::from(u), f64::from(v));
                let [x, y, z] = cosine_hemisphere_rough(u, v).map(f64::from);
                // At the rim z is the root of what rounding leaves of nothing; its square is exact to rounding everywhere.
                let off = (x - exact.x).abs().max((y - exact.y).abs()).max((z * z - exact.z * exact.z).abs());
                assert!(off < 1e-6, "{u} {v}: {x} {y} {z}");
            }
        }
    }

    #[test]
    fn bits_are_those_of_the_numbers() {
        for index in [0, 1, 77, 65_535, 65_536, 200_000] {
            let numbers = sobol_bits(index, 5).map(|x| f64::from(unit(x)));
            assert_eq!(numbers, sobol(index, 0, 5), "{index}");
        }
    }

    /// Cells that estimates may share hold equally many points of any such number; each run of as many points as there
    /// are cells has one in each.
    #[test]
    fn cells_hold_equally_many_points() {
        for n in [1u32, 2, 32, 48, 96, 128, 512] {
            let [a, b] = cell_bits(n);
            let each = 1 << (a + b);
            for run in (0..n).step_by(each) {
                let cells: std::collections::HashSet<(u32, u32)> = (run..run + each as u32)
                    .map(|k| sobol_bits(k, 3))
                    .map(|x| (x[0].checked_shr(32 - a).unwrap_or(0), x[1].checked_shr(32 - b).unwrap_or(0)))
                    .collect();
                assert_eq!(cells.len(), each, "{n} points, run {run}");
            }
        }
    }

    #[test]
    fn hemisphere_has_the_cosine_moments() {
        let (n, mut mean, mut second) = (4096u32, DVec3::ZERO, 0.0);
        for i in 0..n {
            let p = sobol(i, 0, 5);
            let w = cosine_hemisphere(p[0], p[1]);
            assert!((w.length() - 1.0).abs() < 1e-12 && w.z >= 0.0);
            mean += w / f64::from(n);
            second += w.z * w.z / f64::from(n);
        }
        assert!((mean.z - 2.0 / 3.0).abs() < 1e-3 && mean.x.abs() < 1e-3 && mean.y.abs() < 1e-3);
        assert!((second - 0.5).abs() < 1e-3);
    }

    #[test]
    fn triangle_map_is_uniform() {
        let n = 64;
        let (mut ms, mut mt) = (0.0, 0.0);
        for i in 0..n * n {
            let (s, t) = triangle(((i % n) as f64 + 0.5) / n as f64, ((i / n) as f64 + 0.5) / n as f64);
            assert!(s >= 0.0 && t >= 0.0 && s + t <= 1.0);
            ms += s;
            mt += t;
        }
        let scale = 1.0 / (n * n) as f64;
        assert!((ms * scale - 1.0 / 3.0).abs() < 1e-3 && (mt * scale - 1.0 / 3.0).abs() < 1e-3);
    }
}
