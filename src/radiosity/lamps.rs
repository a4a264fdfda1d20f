//! Light straight from a few emitters: exact but for what hides them.
//!
//! With nothing between, the mean irradiance of an element from a polygon of constant radiance is known to rounding
//! ([`exchange`]). Samples of the emitters find only what is hidden of it: with weights `w` whose mean is the exact
//! irradiance `E` and visibilities `V`, an estimate is
//!
//! ```text
//! mean(w V) + beta (E - mean(w))
//! ```
//!
//! for any `beta` that does not depend on these samples (a control variate; Owen 2013, section 8.9). `beta` is the share that
//! the *other* randomisations of the element saw, so the estimate has no bias; where everything is seen it is `E` itself, and
//! where nothing is seen it is zero.
//!
//! Near emitters are sampled uniformly in solid angle (Arvo 1995), so that a weight is bounded however close the
//! emitter comes: at an edge that lamp and wall share, area samples have infinite variance.

use crate::color::{self, Rgb};
use crate::embree::{LANES, ShadowPacket};
use crate::emitters::Emitters;
use crate::form_factor::EmitterIrradiance;
use crate::form_factor::analytic::{Polygon, exchange};
use crate::mesh::{Mesh, NONE, side_index};
use crate::sampling::{Scramble, ScrambledPoints, SobolTable, seed_of, sobol, unit};
use crate::scene::{FaceFrame, Scene};
use crate::visibility::Visibility;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Relative error of the irradiance with nothing between.
const ACCURACY: f64 = 1e-8;
/// Emitters within so many of their radii are sampled by solid angle.
const NEAR: f64 = 1.5;
/// Scenes of more faces are not searched for what may hide an emitter: something may.
const MOST_CHECKED: usize = 500;
/// Samples that may be hidden, of those of a side that were not.
const MISSED: f64 = 3.0;
/// Share of the samples that go to all emitters alike.
const EVENLY: f64 = 0.1;
/// Smaller solid angles lose too many digits to be sampled.
const LEAST_SOLID_ANGLE: f64 = 1e-6;

/// The emitters of a scene that has few ([`Emitters::are_few`]).
pub(super) struct Lamps<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    lamps: Vec<Lamp>,
    /// By side: something may hide a lamp from it.
    hidden: Vec<bool>,
}

struct Lamp {
    face: u32,
    polygon: Polygon,
    radiance: Rgb,
    middle: DVec3,
    radius: f64,
    area: f64,
    frame: FaceFrame,
}

/// Sums over the samples of one randomisation.
#[derive(Clone, Copy, Default)]
struct Sums {
    all: Rgb,
    seen: Rgb,
}

impl<'a, 's> Lamps<'a, 's> {
    /// The emitters, if they are few.
    pub fn of(visibility: &'a Visibility<'s>, mesh: &'a Mesh, emitters: &Emitters) -> Option<Lamps<'a, 's>> {
        let scene: &Scene = visibility.scene();
        let lamp = |(face, front, radiance): (u32, bool, Rgb)| {
            let f = &scene.faces[face as usize];
            let mut corners = Polygon::of_face(scene, f).corners().to_vec();
            if !front {
                corners.reverse();
            }
            let polygon = Polygon::new(&corners, if front { f.normal } else { -f.normal });
            let middle = polygon.middle();
            let (radius, frame) = (polygon.radius(middle), scene.face_frame(f));
            Lamp { face, polygon, radiance, middle, radius, area: f.area, frame }
        };
        let lamps: Vec<Lamp> = emitters.are_few().then(|| emitters.sides().map(lamp).collect())?;
        let mut lamps = Lamps { visibility, mesh, lamps, hidden: Vec::new() };
        let hidden = |side: u32| {
            let f = &scene.faces[side as usize / 2];
            let polygon = Polygon::of_face(scene, f);
            let front = side % 2 == 0;
            let seen_from = if front { polygon } else { Polygon::new(polygon.corners(), -f.normal) };
            mesh.first(side / 2, front) != NONE && lamps.may_be_hidden(&seen_from, side / 2)
        };
        lamps.hidden = (0..2 * scene.faces.len() as u32).into_par_iter().map(hidden).collect();
        Some(lamps)
    }

    /// Irradiance on an element in each of `batches` independent randomisations of the samples `table` [W m^-2].
    pub fn light(
        &self,
        element: u32,
        (batches, table): (u32, &SobolTable),
        seed: u32,
    ) -> Vec<EmitterIrradiance> {
        let count = table.len() as u32;
        let scene = self.visibility.scene();
        let cell = Polygon::of_element(scene, self.mesh, element);
        let place = self.mesh.place(element).0;
        let area = self.mesh.area(element);
        // With nothing between, by emitter.
        let exact: Vec<f64> = self
            .lamps
            .iter()
            .map(|l| if l.face == place { 0.0 } else { exchange(&cell, &l.polygon, ACCURACY) / area * PI })
            .collect();
        let strength: Vec<f64> =
            exact.iter().zip(&self.lamps).map(|(e, l)| e * color::mean(l.radiance)).collect();
        let total: f64 = strength.iter().sum();
        if total <= 0.0 {
            return vec![EmitterIrradiance::default(); batches as usize];
        }
        let whole: Rgb = exact.iter().zip(&self.lamps).map(|(e, l)| *e * l.radiance).sum();
        // Of a weak emitter a small part may be above the horizon: samples of it must not be too few to say which.
        let weak = EVENLY / strength.iter().filter(|s| **s > 0.0).count() as f64;
        let share = |s: &f64| if *s > 0.0 { weak + (1.0 - EVENLY) * s / total } else { 0.0 };
        let chosen = Chosen { shares: strength.iter().map(share).collect() };
        let mut points = ScrambledPoints::default();
        let sums: Vec<Sums> = (0..batches)
            .map(|b| {
                let seed = seed_of(&[seed, element, b, 0x1a3]);
                table.scramble(&Scramble::new(seed), &mut points);
                self.batch(element, &chosen, &points, seed)
            })
            .collect();
        // Where something may hide an emitter and no sample met it, all randomisations agree and may yet be wrong: what n samples
        // missed covers less than 3 / n (95 %). The spread of as much on the whole side: nothing but the standard error sees it.
        let doubt = |b: usize| {
            let (face, front, _) = self.mesh.place(element);
            let side = self.hidden[side_index(face, front)];
            let paired = 2 * (sums.len() / 2);
            if !side || b >= paired {
                return Rgb::ZERO;
            }
            let all = f64::from(batches * count.max(1)) * (self.mesh.grid(face).len() as f64).sqrt();
            whole * (MISSED * ((batches - 1) as f64).sqrt() / all * if b % 2 == 0 { 1.0 } else { -1.0 })
        };
        let combine = |b: usize| {
            // The share seen by the others; by the only one, where it is alone.
            let others =
                || sums.iter().enumerate().filter(|(k, _)| *k != b || sums.len() == 1).map(|(_, s)| s);
            let (all, seen): (Rgb, Rgb) = (others().map(|s| s.all).sum(), others().map(|s| s.seen).sum());
            let beta = color::mean(seen) / color::mean(all);
            let beta = if beta.is_finite() { beta } else { 0.0 };
            let n = f64::from(count.max(1));
            let straight = sums[b].seen / n + beta * (whole - sums[b].all / n) + doubt(b);
            EmitterIrradiance { straight, ..Default::default() }
        };
        let mut found: Vec<EmitterIrradiance> = (0..sums.len()).map(combine).collect();
        // No more than all of an emitter can be seen, and no less than nothing. All randomisations move alike: their spread is true.
        let mean = found.iter().map(|f| f.straight).sum::<Rgb>() / found.len() as f64;
        let moved = mean.clamp(Rgb::ZERO, whole) - mean;
        found.iter_mut().for_each(|f| f.straight += moved);
        found
    }

    /// Whether some face could hide part of an emitter from a side of a face. A face cannot that has both of them on one
    /// side of its plane, or that lies behind either one's plane.
    fn may_be_hidden(&self, from: &Polygon, face: u32) -> bool {
        let scene = self.visibility.scene();
        if scene.faces.len() > MOST_CHECKED {
            return true;
        }
        let eps = 1e-9 * scene.radius;
        let ahead = |of: &Polygon, c: &DVec3| (*c - of.corners()[0]).dot(of.normal) > eps;
        self.lamps.iter().filter(|l| l.face != face).any(|lamp| {
            scene.faces.iter().enumerate().any(|(k, f)| {
                if k as u32 == face || k as u32 == lamp.face {
                    return false;
                }
                let screen = Polygon::of_face(scene, f);
                let ends = || from.corners().iter().chain(lamp.polygon.corners());
                let height = |c: &DVec3| (*c - screen.corners()[0]).dot(screen.normal);
                screen.corners().iter().any(|c| ahead(from, c))
                    && screen.corners().iter().any(|c| ahead(&lamp.polygon, c))
                    && ends().any(|c| height(c) > eps)
                    && ends().any(|c| height(c) < -eps)
            })
        })
    }

    fn batch(&self, element: u32, chosen: &Chosen, points: &ScrambledPoints, seed: u32) -> Sums {
        let scene = self.visibility.scene();
        let place = self.mesh.place_of(scene, element);
        let (face, normal) = (place.face, place.normal);
        let mut sums = Sums::default();
        let mut packet = ShadowPacket::new();
        let mut pending = [Rgb::ZERO; LANES];
        let mut used = 0;
        let flush = |packet: &mut ShadowPacket, pending: &[Rgb], sums: &mut Sums| {
            let blocked = self.visibility.occluded16(packet, false);
            for (k, weight) in pending.iter().enumerate() {
                sums.all += *weight;
                if blocked >> k & 1 == 0 {
                    sums.seen += *weight;
                }
            }
            packet.clear();
        };
        let coordinates = [0, 1, 2, 3].map(|d| points.coordinate(d));
        for k in 0..coordinates[0].len() {
            let p = coordinates.map(|x| f64::from(unit(x[k])));
            let point = self.visibility.start(&place, p[0], p[1]);
            // A single emitter takes no choice.
            let (which, share) =
                if self.lamps.len() == 1 { (0, 1.0) } else { chosen.pick(sobol(k as u32, 1, seed)[0]) };
            let lamp = &self.lamps[which];
            let Some((target, density)) = lamp.sample(point, p[2], p[3]) else { continue };
            let d = target - point;
            let cos = d.dot(normal) / d.length();
            if cos > 0.0 {
                let origin = self.visibility.leave(face, point, normal);
                packet.set(used, &self.visibility.segment(origin, lamp.face, target, lamp.polygon.normal));
                pending[used] = lamp.radiance * (cos / (density * share));
                used += 1;
                if used == LANES {
                    flush(&mut packet, &pending, &mut sums);
                    used = 0;
                }
            }
        }
        if used > 0 {
            flush(&mut packet, &pending[..used], &mut sums);
        }
        sums
    }
}

/// Chances of the emitters.
struct Chosen {
    shares: Vec<f64>,
}

impl Chosen {
    /// The emitter for `u` in [0, 1), and its chance.
    fn pick(&self, mut u: f64) -> (usize, f64) {
        let mut last = 0;
        for (k, share) in self.shares.iter().enumerate().filter(|(_, s)| **s > 0.0) {
            last = k;
            if u < *share {
                break;
            }
            u -= share;
        }
        (last, self.shares[last])
    }
}

impl Lamp {
    /// A point of the emitter as seen from `from`, and its density [sr^-1]; none where its front is not seen.
    fn sample(&self, from: DVec3, u: f64, v: f64) -> Option<(DVec3, f64)> {
        let c = self.polygon.corners();
        if (from - c[0]).dot(self.polygon.normal) <= 0.0 {
            return None;
        }
        if from.distance_squared(self.middle) < (NEAR * self.radius).powi(2) {
            let first = Triangle::new(from, [c[0], c[1], c[2]]);
            let second = c.get(3).map(|d| Triangle::new(from, [c[0], c[2], *d]));
            let total = first.solid_angle + second.as_ref().map_or(0.0, |t| t.solid_angle);
            if total > LEAST_SOLID_ANGLE {
                let x = u * total;
                let (triangle, u) = match &second {
                    Some(t) if x >= first.solid_angle => (t, (x - first.solid_angle) / t.solid_angle),
                    _ => (&first, x / first.solid_angle),
                };
                return Some((from + triangle.sample(u.min(1.0), v)?, 1.0 / total));
            }
        }
        let point = self.frame.at(self.frame.uniform(u, v));
        let d = from - point;
        let r2 = d.length_squared();
        Some((point, r2 * r2.sqrt() / (d.dot(self.polygon.normal) * self.area)))
    }
}

/// A triangle as seen from a point.
struct Triangle {
    corners: [DVec3; 3],
    units: [DVec3; 3],
    /// [sr]
    solid_angle: f64,
}

impl Triangle {
    fn new(from: DVec3, corners: [DVec3; 3]) -> Triangle {
        let corners = corners.map(|c| c - from);
        let units = corners.map(|c| c.normalize_or_zero());
        let [a, b, c] = units;
        // van Oosterom and Strackee 1983.
        let solid_angle = 2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a));
        Triangle { corners, units, solid_angle }
    }

    /// The point of the triangle, seen from the origin, in a direction uniform in solid angle (Arvo 1995); none where
    /// rounding leaves nothing of it.
    fn sample(&self, u: f64, v: f64) -> Option<DVec3> {
        let [a, b, c] = self.units;
        let [ab, bc, ca] = [a.cross(b), b.cross(c), c.cross(a)].map(|n| n.try_normalize());
        let (ab, bc, ca) = (ab?, bc?, ca?);
        let angle = |x: DVec3, y: DVec3| x.cross(y).length().atan2(x.dot(y));
        let alpha = angle(ab, -ca);
        let part = u * (alpha + angle(bc, -ab) + angle(ca, -bc) - PI);
        // The sub-triangle a b c' has this solid angle.
        let (sin_alpha, cos_alpha) = alpha.sin_cos();
        let (s, t) = (part - alpha).sin_cos();
        let (p, q) = (t - cos_alpha, s + sin_alpha * a.dot(b));
        let cos_c = ((q * t - p * s) * cos_alpha - q) / ((q * s + p * t) * sin_alpha);
        let towards = |from: DVec3, to: DVec3| (to - to.dot(from) * from).normalize_or_zero();
        let cos_c = if cos_c.is_finite() { cos_c.clamp(-1.0, 1.0) } else { 1.0 };
        let moved = cos_c * a + (1.0 - cos_c * cos_c).sqrt() * towards(a, c);
        let z = 1.0 - v * (1.0 - moved.dot(b));
        let direction = z * b + (1.0 - z * z).max(0.0).sqrt() * towards(b, moved);
        // As a mean of the corners: rounding cannot lead outside.
        let [p, q, r] = self.corners;
        let weights = [q.cross(r), r.cross(p), p.cross(q)].map(|n| direction.dot(n));
        let sign = weights.iter().sum::<f64>().signum();
        let weights = weights.map(|w| (w * sign).max(0.0));
        let sum: f64 = weights.iter().sum();
        (sum > 0.0).then(|| (weights[0] * p + weights[1] * q + weights[2] * r) / sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embree::Device;
    use crate::form_factor::analytic::lambert;
    use crate::mesh::Sides;

    /// Where samples of an emitter miss what hides it, the estimate with the exact light as control variate may lie below zero; the
    /// mean over the randomisations may not, whatever the seed.
    #[test]
    fn no_light_is_below_zero() {
        let device = Device::new(1).expect("Embree");
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/kaleidoscope/kaleidoscope.toml");
        let scene = crate::scene::load(std::path::Path::new(path)).expect("a scene of the project");
        let visibility = Visibility::new(&device, &scene).expect("a tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.04, false).expect("a mesh");
        let emitters = Emitters::new(&visibility);
        let lamps = Lamps::of(&visibility, &mesh, &emitters).expect("few emitters");
        let (mut below, table) = (0, SobolTable::new(4));
        for element in 0..mesh.len() as u32 {
            let found = lamps.light(element, (4, &table), 1);
            let mean = found.iter().map(|f| f.straight).sum::<Rgb>() / 4.0;
            below += u32::from(found.iter().any(|f| f.straight.min_element() < 0.0));
            assert!(mean.min_element() >= -1e-12 * mean.abs().max_element(), "element {element}: {mean}");
        }
        assert!(below > 0, "no randomisation puts it to the test");
    }

    /// Means of cosines over samples in solid angle are Lambert's factor: near, far, and seen edge-on. 4,096 Sobol points: the
    /// bound is four times the standard error that independent points would have.
    #[test]
    fn samples_of_a_triangle_give_its_factor() {
        let corners = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]].map(DVec3::from);
        for from in [[0.2, 0.3, 0.4], [0.1, 0.1, 1e-3], [-0.5, 0.4, 2.0], [0.6, 0.6, 0.01]].map(DVec3::from) {
            let triangle = Triangle::new(from, corners);
            let normal = DVec3::new(0.1, 0.2, -1.0).normalize();
            let n = 4096;
            let (mut sum, mut squares) = (0.0, 0.0);
            for k in 0..n {
                let [u, v, ..] = sobol(k, 0, 7);
                let p = triangle.sample(u, v).expect("a point");
                assert!((p.z + from.z).abs() < 1e-12 && p.x + from.x > -1e-12 && p.y + from.y > -1e-12);
                let cos = p.normalize().dot(normal).max(0.0) * triangle.solid_angle / PI;
                sum += cos / f64::from(n);
                squares += cos * cos / f64::from(n);
            }
            let polygon = Polygon::new(&corners, DVec3::Z * -1.0);
            let exact = match polygon.before(from, normal) {
                crate::form_factor::analytic::Cut::All => lambert(from, normal, polygon.corners()),
                crate::form_factor::analytic::Cut::Part(p) => lambert(from, normal, p.corners()),
                crate::form_factor::analytic::Cut::Nothing => 0.0,
            }
            .abs();
            let bound = 4.0 * ((squares - sum * sum) / f64::from(n)).sqrt();
            assert!((sum - exact).abs() <= bound, "{from}: {sum} {exact} {bound}");
        }
    }
}
