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
//! where nothing is seen it is zero. Each emitter has its own: one that a wall hides leaves what another gives exact.
//!
//! Of scenes of few surfaces, geometry tells which emitters nothing can hide from a face, and which one surface hides from all of it: these
//! take no samples.
//!
//! Near emitters are sampled uniformly in solid angle (Arvo 1995), so that a weight is bounded however close the
//! emitter comes: at an edge that lamp and wall share, area samples have infinite variance.

use crate::color::{self, Rgb};
use crate::embree::{LANES, ShadowPacket};
use crate::emitters::Emitters;
use crate::form_factor::EmitterIrradiance;
use crate::form_factor::analytic::{Polygon, exchange};
use crate::form_factor::pairs::Surfaces;
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
/// Most faces that are joined to surfaces to be searched for what hides an emitter.
const MOST_FACES: usize = 10_000;
/// Sides of faces times emitters times surfaces beyond which nothing is searched: something may hide an emitter.
const MOST_CHECKED: usize = 1 << 23;
/// Samples that may be hidden where none of many was: their expectation is not more, with 95 % confidence.
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
    /// By side and lamp; empty where surfaces are too many to be searched.
    sights: Vec<Sight>,
}

/// How a whole emitter is seen from a whole face.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sight {
    /// Nothing is in between.
    Free,
    /// Something may be.
    Doubtful,
    /// One surface hides all of it.
    Hidden,
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

/// Sums over the samples of an emitter in one randomisation.
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
        let mut lamps = Lamps { visibility, mesh, lamps, sights: Vec::new() };
        if scene.faces.len() > MOST_FACES {
            return Some(lamps);
        }
        let surfaces = Surfaces::new(scene);
        let faces: Vec<Polygon> = scene.faces.iter().map(|f| Polygon::of_face(scene, f)).collect();
        if 2 * faces.len() * lamps.lamps.len() * surfaces.polygons.len() > MOST_CHECKED {
            return Some(lamps);
        }
        let sights = |side: usize| {
            let (face, front) = (side / 2, side % 2 == 0);
            let polygon = &faces[face];
            let seen_from = if front { *polygon } else { Polygon::new(polygon.corners(), -polygon.normal) };
            let has_elements = mesh.first(face as u32, front) != NONE;
            let sight = |lamp: &Lamp| match has_elements {
                true => sight(&surfaces, scene.radius, (&seen_from, face as u32), lamp),
                false => Sight::Doubtful,
            };
            lamps.lamps.iter().map(sight).collect::<Vec<Sight>>()
        };
        lamps.sights = (0..2 * faces.len()).into_par_iter().flat_map_iter(sights).collect();
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
        let strength: &Vec<f64> =
            &exact.iter().zip(&self.lamps).map(|(e, l)| e * color::mean(l.radiance)).collect();
        let (face, front, _) = self.mesh.place(element);
        let first = side_index(face, front) * self.lamps.len();
        let sight = &|k: usize| self.sights.get(first + k).copied().unwrap_or(Sight::Doubtful);
        let whole = |k: usize| exact[k] * self.lamps[k].radiance;
        let of_kind = |kind: Sight| {
            let lit = move |k: &usize| strength[*k] > 0.0 && sight(*k) == kind;
            (0..self.lamps.len()).filter(lit)
        };
        let free: Rgb = of_kind(Sight::Free).map(whole).sum();
        let total: f64 = of_kind(Sight::Doubtful).map(|k| strength[k]).sum();
        if total <= 0.0 {
            let straight = EmitterIrradiance { straight: free, ..Default::default() };
            return vec![straight; batches as usize];
        }
        // Of a weak emitter a small part may be above the horizon: samples of it must not be too few to say which.
        let weak = EVENLY / of_kind(Sight::Doubtful).count() as f64;
        let mut shares = vec![0.0; self.lamps.len()];
        of_kind(Sight::Doubtful).for_each(|k| shares[k] = weak + (1.0 - EVENLY) * strength[k] / total);
        let chosen = Chosen { shares };
        let mut points = ScrambledPoints::default();
        // By randomisation and emitter.
        let sums: Vec<Vec<Sums>> = (0..batches)
            .map(|b| {
                let seed = seed_of(&[seed, element, b, 0x1a3]);
                table.scramble(&Scramble::new(seed), &mut points);
                self.batch(element, &chosen, &points, seed)
            })
            .collect();
        let n = f64::from(count.max(1));
        let mut found = vec![free; batches as usize];
        let mut most = Rgb::ZERO;
        for k in of_kind(Sight::Doubtful) {
            let whole = whole(k);
            let estimate = |b: usize| {
                // The share seen by the others; by the only one, where it is alone.
                let others =
                    || sums.iter().enumerate().filter(|(o, _)| *o != b || sums.len() == 1).map(|(_, s)| s[k]);
                let (all, seen): (Rgb, Rgb) = (others().map(|s| s.all).sum(), others().map(|s| s.seen).sum());
                let beta = color::mean(seen) / color::mean(all);
                // Where the others took no sample of the emitter: nothing is known to hide it.
                let beta = if beta.is_finite() { beta } else { 1.0 };
                sums[b][k].seen / n + beta * (whole - sums[b][k].all / n)
            };
            let of_lamp: Vec<Rgb> = (0..sums.len()).map(estimate).collect();
            // No more than all of an emitter can be seen, and no less than nothing. All randomisations move alike: their spread is
            // true.
            let mean = of_lamp.iter().sum::<Rgb>() / of_lamp.len() as f64;
            let moved = mean.clamp(Rgb::ZERO, whole) - mean;
            found.iter_mut().zip(&of_lamp).for_each(|(found, h)| *found += *h + moved);
            most = most.max(whole / chosen.shares[k]);
        }
        // Where no sample met what hides an emitter, all randomisations agree and may yet be wrong: what n samples missed covers less
        // than 3 / n (95 %) of all that they look at. The spread of as much on the whole side: nothing but the standard error sees it.
        let all = f64::from(batches) * n * (self.mesh.grid(face).len() as f64).sqrt();
        let doubt = most * (MISSED * (f64::from(batches) - 1.0).sqrt() / all);
        let paired = 2 * (found.len() / 2);
        found[..paired].chunks_exact_mut(2).for_each(|pair| {
            pair[0] += doubt;
            pair[1] -= doubt;
        });
        found.into_iter().map(|straight| EmitterIrradiance { straight, ..Default::default() }).collect()
    }

    /// Sums of one randomisation, by emitter.
    fn batch(&self, element: u32, chosen: &Chosen, points: &ScrambledPoints, seed: u32) -> Vec<Sums> {
        let scene = self.visibility.scene();
        let place = self.mesh.place_of(scene, element);
        let (face, normal) = (place.face, place.normal);
        let mut sums = vec![Sums::default(); self.lamps.len()];
        let mut packet = ShadowPacket::new();
        let mut pending = [(0, Rgb::ZERO); LANES];
        let mut used = 0;
        let flush = |packet: &mut ShadowPacket, pending: &[(usize, Rgb)], sums: &mut [Sums]| {
            let blocked = self.visibility.occluded16(packet, false);
            for (k, (which, weight)) in pending.iter().enumerate() {
                let sums = &mut sums[*which];
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
                pending[used] = (which, lamp.radiance * (cos / (density * share)));
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

/// How a lamp is seen from a face (its polygon with the normal of the side, and its number) among all `surfaces`.
fn sight(surfaces: &Surfaces, radius: f64, (from, face): (&Polygon, u32), lamp: &Lamp) -> Sight {
    let eps = surfaces.eps.max(1e-9 * radius);
    let ahead = |of: &Polygon, c: &DVec3| (*c - of.corners()[0]).dot(of.normal) > eps;
    let own = [face, lamp.face].map(|face| surfaces.of_face[face as usize] as usize);
    let others = surfaces.polygons.iter().enumerate().filter(|(k, _)| !own.contains(k));
    let mut sight = Sight::Free;
    for (_, screen) in others {
        let height = |c: &DVec3| (*c - screen.corners()[0]).dot(screen.normal);
        let ends = || from.corners().iter().chain(lamp.polygon.corners());
        // A face hides nothing that has both of them on one side of its plane, or that lies behind either one's plane.
        let may = screen.corners().iter().any(|c| ahead(from, c))
            && screen.corners().iter().any(|c| ahead(&lamp.polygon, c))
            && ends().any(|c| height(c) > eps)
            && ends().any(|c| height(c) < -eps);
        if !may {
            continue;
        }
        if hides(screen, from, &lamp.polygon, eps) {
            return Sight::Hidden;
        }
        sight = Sight::Doubtful;
    }
    sight
}

/// Whether a face meets every line between two others: they lie on either side of its plane, and the lines between their corners cross
/// that within it. Every other line crosses it between these.
fn hides(screen: &Polygon, a: &Polygon, b: &Polygon, eps: f64) -> bool {
    let (o, n) = (screen.corners()[0], screen.normal);
    let holds =
        |c: DVec3| screen.edges().all(|(p, q)| (q - p).cross(c - p).dot(n) >= -eps * (q - p).length());
    let heights = |of: &Polygon| of.corners().iter().map(|c| (*c, (*c - o).dot(n))).collect::<Vec<_>>();
    let (mut near, mut far) = (heights(a), heights(b));
    if near.iter().any(|c| c.1 > eps) {
        std::mem::swap(&mut near, &mut far);
    }
    if near.iter().any(|c| c.1 > eps) || far.iter().any(|c| c.1 < -eps) {
        return false;
    }
    near.iter().all(|(p, below)| {
        far.iter().all(|(q, above)| {
            let (below, above) = (below.min(0.0), above.max(0.0));
            above - below > eps && holds((*p * above - *q * below) / (above - below))
        })
    })
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

    /// A wall hides a lamp where no line leads past it: from the floor at its foot too, but not where it ends a little below the lines
    /// to the lamp's far corners, nor what is on its own side.
    #[test]
    fn walls_hide_what_is_behind_them() {
        let polygon = |c: [[f64; 3]; 4], n: DVec3| Polygon::new(&c.map(DVec3::from), n);
        let floor = polygon([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], DVec3::Z);
        let lamp =
            polygon([[2.4, 0.4, 1.0], [2.4, 0.6, 1.0], [2.6, 0.6, 1.0], [2.6, 0.4, 1.0]], DVec3::NEG_Z);
        let wall = |x: f64, top: f64| {
            polygon([[x, 0.0, 0.0], [x, 1.0, 0.0], [x, 1.0, top], [x, 0.0, top]], DVec3::X)
        };
        // From the far end of the floor, lines to the near edge of the lamp are highest above the wall's foot: 1 / 2.4.
        for (x, top, hidden) in
            [(1.0, 1.0, true), (1.0, 0.4167, true), (1.0, 0.4166, false), (2.0, 1.0, true), (0.5, 1.0, false)]
        {
            for (a, b) in [(&floor, &lamp), (&lamp, &floor)] {
                for wall in [wall(x, top), wall(x, top).turned()] {
                    assert_eq!(hides(&wall, a, b, 1e-9), hidden, "wall at {x}, up to {top}");
                }
            }
        }
        assert!(!hides(&wall(-1.0, 1.0), &floor, &lamp, 1e-9));
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
