//! Which sides of the faces light or a camera can reach at all.
//!
//! The inside of a closed box, or the outside of a room that is seen from within, needs no
//! elements: nothing that happens there can be seen. Particles walk from emitters and cameras and
//! mark the sides that they hit. A side that no particle found (it may be small) is then connected
//! by straight segments to points that were found: one free segment proves that it is reachable. Where none is free, rays aimed
//! close past edges find openings that are small for the scene: an opening has edges.
//! So a reachable side is missed only if it is hidden from every particle and every segment, and
//! a ray of pass 1 that lands on such a side says so (see `form_factor`).
//!
//! Sides that meet over edges of exactly two faces look into one space: they form a **sheet**, such as the inside of a
//! closed body. Sides of a sheet that nothing found share the segments of one, and of very many [`TRIED`] stand for all.
//! Once one of them is found, each side is tried by itself.

use super::offset::shared_edges;
use super::{SurfaceHit, Visibility};
use crate::bsdf::Specular;
use crate::geometry::Frame;
use crate::mesh::{Sides, side_index};
use crate::sampling::{cosine_hemisphere, seed_of, sobol};
use crate::scene::CameraFrame;
use crate::sets::Sets;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Rays aimed past edges from all sides that no particle found, the least from a side and the most from a sheet.
const AIMED: u32 = 1 << 19;
const AIMED_OF_ONE: (u32, u32) = (8, 1 << 12);
/// How far beside an edge they pass, as shares of the scene's radius: narrower gaps are cracks, not openings.
const ASIDE: (f64, f64) = (3e-4, 0.3);
/// Surfaces that a particle visits at most.
const STEPS: u32 = 12;
/// Distinct particles that must find a side: one that slipped through a crack proves nothing.
const PROOF: u32 = 3;
/// Rays tried from all sides that no particle found, and the least and most from one.
const RAYS: u32 = 1 << 20;
const RAYS_OF_ONE: (u32, u32) = (8, 64);
/// Segments tried from all sides that no particle found, the least from a side and the most from a sheet.
const SEGMENTS: u32 = 1 << 22;
const SEGMENTS_OF_ONE: (u32, u32) = (16, 1 << 14);
/// Points that segments lead to, at most.
const MOST_WITNESSES: usize = 1 << 16;
/// Segments closer to a surface than this cosine prove nothing.
const GRAZING: f64 = 1e-4;
/// Height over a face's plane, as a share of the scene's radius, that is rounding.
const PLANE: f64 = 1e-12;
/// Witnesses whose heights over a plane take as long as a segment.
const CHEAPER: usize = 32;
/// Most particles, where few found something.
const MOST_PARTICLES: u32 = 1 << 21;
/// Points that particles leave behind, at most about.
const MOST_SEEN: u32 = 1 << 19;
/// Sides tried of a sheet of which none was found.
const TRIED: u32 = 1 << 10;
/// Times that sides just found lead on to others.
const MOST_ROUNDS: u32 = 4;
/// Segments and aimed rays that lead on from sides just found: from one side at least, and for each that was found.
const ONWARD: (u32, u32) = (64, 4);
/// Witnesses tried from the point where a ray from such a side lands.
const STEPPING_STONES: u32 = 4;

/// The sides that light or a camera can reach.
///
/// `cameras` with their image sizes are sources beside the emitters. With light from outside
/// (`environment` not black) so is every side from which a ray escapes. Without any source at all
/// every side counts as reachable.
pub fn reachable_sides(visibility: &Visibility, cameras: &[(CameraFrame, [u32; 2])], seed: u32) -> Sides {
    let scene = visibility.scene();
    let emitters: Vec<(u32, bool)> = (0..scene.faces.len() as u32)
        .flat_map(|f| [(f, true), (f, false)])
        .filter(|&(f, front)| scene.material(&scene.faces[f as usize]).emitted(front).max_element() > 0.0)
        .collect();
    let outside = scene.environment.max_element() > 0.0;
    if emitters.is_empty() && cameras.is_empty() && !outside {
        return Sides::all(scene);
    }
    let particles = (scene.faces.len() as u32).saturating_mul(8).clamp(1 << 15, MOST_PARTICLES);
    // How many particles found each side: sums, whatever their order.
    let found: Vec<AtomicU32> = (0..2 * scene.faces.len()).map(|_| AtomicU32::new(0)).collect();
    let count = |side: usize| found[side].load(Ordering::Relaxed);
    // Returns the places where every so many-th particle landed.
    let send = |range: std::ops::Range<u32>| -> Vec<(u32, DVec3)> {
        let sources = emitters.len() + cameras.len();
        let range = if sources > 0 { range } else { 0..0 };
        let stride = (range.len() as u32 * STEPS).div_ceil(MOST_SEEN).max(1);
        let walk = |k: u32| {
            let source = k as usize % sources;
            let walker = Walker { visibility, seed: seed_of(&[seed, k, 0x7ea]) };
            let mut sides = match emitters.get(source) {
                Some(&(face, front)) => walker.walk_from_face(face, front, k / sources as u32),
                None => {
                    let (frame, size) = &cameras[source - emitters.len()];
                    walker.walk_from_camera(frame, *size, k / sources as u32)
                }
            };
            sides.sort_unstable_by_key(|(side, _)| *side);
            sides.dedup_by_key(|(side, _)| *side);
            sides.iter().for_each(|(side, _)| {
                found[*side as usize].fetch_add(1, Ordering::Relaxed);
            });
            if k % stride == 0 { sides } else { Vec::new() }
        };
        range.into_par_iter().with_min_len(1024).flat_map_iter(walk).collect()
    };
    let mut seen = send(0..particles);
    for &(face, front) in &emitters {
        found[side_index(face, front)].store(PROOF, Ordering::Relaxed);
    }
    let mut reached: Vec<bool> = (0..found.len()).map(|side| count(side) >= PROOF).collect();
    connect(visibility, &mut reached, &seen, outside, seed);
    // A side that one or two particles found, and no segment, lies behind a crack or a keyhole: more of them tell.
    let mut sent = particles;
    while sent < MOST_PARTICLES && (0..reached.len()).any(|side| !reached[side] && count(side) > 0) {
        let next = sent.saturating_mul(4).min(MOST_PARTICLES);
        seen.extend(send(sent..next).into_iter().filter(|(side, _)| !reached[*side as usize]));
        sent = next;
        let mut news = false;
        for (side, r) in reached.iter_mut().enumerate().filter(|(side, r)| !**r && count(*side) >= PROOF) {
            *r = count(side) >= PROOF;
            news = true;
        }
        if news {
            connect(visibility, &mut reached, &seen, outside, seed_of(&[seed, sent]));
        }
    }
    Sides(reached)
}

/// A side that nothing found, and how many of its sheet that are tried too stand for it.
#[derive(Clone, Copy)]
struct Missing {
    side: u32,
    share: u32,
}

/// The sides to try of those that nothing found, in order: all, but of large sheets of which none was found a few.
fn to_try(reached: &[bool], sheet: &[u32]) -> Vec<Missing> {
    let missing = || (0..reached.len()).filter(|s| !reached[*s]);
    // Sides not found by sheet; none where some side was.
    let mut left = vec![0u32; reached.len()];
    missing().for_each(|s| left[sheet[s] as usize] += 1);
    (0..reached.len()).filter(|s| reached[*s]).for_each(|s| left[sheet[s] as usize] = 0);
    let mut turn = vec![0u32; reached.len()];
    let chosen = |s: usize| {
        let k = sheet[s] as usize;
        let every = left[k].div_ceil(TRIED).max(1);
        turn[k] += 1;
        let share = left[k].div_ceil(every).max(1);
        ((turn[k] - 1) % every == 0).then_some(Missing { side: s as u32, share })
    };
    missing().filter_map(chosen).collect()
}

/// The sheet of every side, named by one of its sides.
fn sheets_of(visibility: &Visibility) -> Vec<u32> {
    let scene = visibility.scene();
    let mut sets = Sets::new(2 * scene.faces.len());
    for edge in shared_edges(scene).chunk_by(|a, b| a.0 == b.0) {
        let [(_, a, i), (_, b, k)] = edge else { continue };
        // Neighbours of one orientation run along their edge in opposite directions.
        let start =
            |face: u32, corner: u8| scene.corner(&scene.faces[face as usize], corner.into()).as_vec3();
        let turned = u32::from(start(*a, *i) == start(*b, *k));
        (0..2).for_each(|side| sets.join(2 * a + side, 2 * b + (side ^ turned)));
    }
    sets.names()
}

/// Adds the sides from which some segment to a point that was found, or a ray to the outside, is free.
fn connect(visibility: &Visibility, reached: &mut [bool], seen: &[(u32, DVec3)], outside: bool, seed: u32) {
    let scene = visibility.scene();
    // Points as particles found them, not one a side: a finely divided object would provide them all.
    let stride = seen.len().div_ceil(MOST_WITNESSES).max(1);
    let witnesses: Vec<Place> = seen
        .iter()
        .filter(|(side, _)| reached[*side as usize])
        .step_by(stride)
        .map(|(side, p)| {
            let face = side / 2;
            let normal = scene.faces[face as usize].normal * if side % 2 == 0 { 1.0 } else { -1.0 };
            Place { face, point: *p, normal }
        })
        .collect();
    if reached.iter().all(|r| *r) {
        return;
    }
    let sheet = sheets_of(visibility);
    let mut witnesses = witnesses;
    let mut most = u32::MAX;
    for _ in 0..MOST_ROUNDS {
        let tried = to_try(reached, &sheet);
        let sheets = tried.iter().map(|m| 1.0 / f64::from(m.share)).sum::<f64>().max(1.0);
        let share = |all: u32, (least, of_one): (u32, u32), share: u32| {
            let of_sheet = (f64::from(all) / sheets).min(f64::from(of_one));
            ((of_sheet / f64::from(share)) as u32).max(least).min(most)
        };
        let try_one = |m: Missing| {
            let work = Work {
                rays: (RAYS / tried.len() as u32).clamp(RAYS_OF_ONE.0, RAYS_OF_ONE.1),
                segments: share(SEGMENTS, SEGMENTS_OF_ONE, m.share),
                aimed: share(AIMED, AIMED_OF_ONE, m.share),
                outside,
            };
            Some((m.side as usize, connects(visibility, m.side, &witnesses, &work, seed)?))
        };
        let news: Vec<(usize, Place)> = tried.par_iter().filter_map(|m| try_one(*m)).collect();
        if news.is_empty() {
            return;
        }
        // What was found only now shows the way to others; segments to the rest were tried.
        most = (ONWARD.1 * news.len() as u32).max(ONWARD.0);
        news.iter().for_each(|(s, _)| reached[*s] = true);
        witnesses = news.into_iter().map(|(_, place)| place).collect();
    }
}

/// What is tried from one side that no particle found.
struct Work {
    rays: u32,
    segments: u32,
    aimed: u32,
    /// Light comes from outside: a ray that leaves the scene is proof.
    outside: bool,
}

/// A point of a side from which some segment to a witness, or a ray to the outside, is free.
fn connects(
    visibility: &Visibility,
    side: u32,
    witnesses: &[Place],
    work: &Work,
    seed: u32,
) -> Option<Place> {
    let scene = visibility.scene();
    let face = &scene.faces[side as usize / 2];
    let normal = face.normal * if side % 2 == 0 { 1.0 } else { -1.0 };
    let frame = scene.face_frame(face);
    let stone_is_free = |hit: &SurfaceHit, choice: f64| {
        let stone = visibility.point(hit);
        let stone = Place { face: stone.face, point: stone.point, normal: stone.geometric };
        (0..STEPPING_STONES).any(|i| {
            let r = (choice + f64::from(i) / f64::from(STEPPING_STONES)).fract();
            free(visibility, &stone, witnesses, r)
        })
    };
    // From the back of a room's wall, say, no segment leads anywhere: looking at all witnesses tells, where that is less work.
    let eps = PLANE * scene.radius;
    let ahead = |w: &Place| (w.point - frame.origin).dot(normal) > eps;
    let none_ahead = work.segments as usize > witnesses.len() / CHEAPER && !witnesses.iter().any(ahead);
    let segments = if none_ahead { 0 } else { work.segments };
    let found = (0..segments.max(work.rays)).find_map(|k| {
        let p = sobol(k, 0, seed_of(&[seed, side, 0xc0]));
        let uv = frame.uniform(p[0], p[1]);
        let uv = visibility.inside(side / 2, uv.x, uv.y);
        let here = Place { face: side / 2, point: frame.at(uv.into()), normal };
        if k >= work.rays {
            return free(visibility, &here, witnesses, p[2]).then_some(here);
        }
        let origin = visibility.leave(here.face, here.point, normal);
        let q = sobol(k, 0, seed_of(&[seed, side, 0xc1]));
        let d = Frame::new(normal).to_scene(cosine_hemisphere(q[0], q[1])).as_vec3();
        if free(visibility, &here, witnesses, p[2]) {
            return Some(here);
        }
        let Some(hit) = visibility.closest(origin, d, side / 2) else { return work.outside.then_some(here) };
        // Most witnesses may lie behind a small face: from where its light goes, they can be seen.
        stone_is_free(&hit, q[2]).then_some(here)
    });
    if found.is_some() {
        return found;
    }
    // An opening has edges: rays that pass close beside one find a keyhole that random segments miss.
    let mut proofs = 0;
    (0..work.aimed).find_map(|k| {
        let p = sobol(k, 0, seed_of(&[seed, side, 0xc2]));
        let uv = frame.uniform(p[0], p[1]);
        let uv = visibility.inside(side / 2, uv.x, uv.y);
        let here = Place { face: side / 2, point: frame.at(uv.into()), normal };
        let target = beside_an_edge(visibility, sobol(k, 1, seed_of(&[seed, side, 0xc2])), p[2]);
        let d = (target - here.point).try_normalize()?;
        if d.dot(normal) <= GRAZING {
            return None;
        }
        let origin = visibility.leave(here.face, here.point, normal);
        proofs += u32::from(match visibility.closest(origin, d.as_vec3(), here.face) {
            Some(hit) => stone_is_free(&hit, p[3]),
            None => work.outside,
        });
        (proofs >= PROOF).then_some(here)
    })
}

/// A point in the plane of some face, a little outside one of its edges; `p` in [0, 1)^4 chooses face, edge and place along it,
/// and `q` in [0, 1) the distance.
fn beside_an_edge(visibility: &Visibility, p: [f64; 4], q: f64) -> DVec3 {
    let scene = visibility.scene();
    let face = &scene.faces[((p[0] * scene.faces.len() as f64) as usize).min(scene.faces.len() - 1)];
    let count = if face.is_triangle() { 3 } else { 4 };
    let edge = ((p[1] * count as f64) as usize).min(count - 1);
    let (a, b) = (scene.corner(face, edge), scene.corner(face, (edge + 1) % count));
    let outward = (b - a).cross(face.normal).normalize_or_zero();
    // All scales alike.
    let distance = scene.radius * ASIDE.0 * (ASIDE.1 / ASIDE.0).powf(q);
    a + p[2] * (b - a) + distance * outward
}

/// A point of one side of a face.
struct Place {
    face: u32,
    point: DVec3,
    /// Towards the side.
    normal: DVec3,
}

/// Whether the segment from a place to the witness that `choice` in [0, 1) picks is free.
fn free(visibility: &Visibility, from: &Place, witnesses: &[Place], choice: f64) -> bool {
    let Some(to) = witnesses.get((choice * witnesses.len() as f64) as usize) else {
        return false;
    };
    let d = to.point - from.point;
    // Grazing segments could pass through contacts by rounding.
    let l = d.length();
    if d.dot(from.normal) <= GRAZING * l || -d.dot(to.normal) <= GRAZING * l {
        return false;
    }
    let origin = visibility.leave(from.face, from.point, from.normal);
    visibility.unoccluded(&visibility.segment(origin, to.face, to.point, to.normal))
}

struct Walker<'a, 's> {
    visibility: &'a Visibility<'s>,
    seed: u32,
}

impl Walker<'_, '_> {
    fn walk_from_face(&self, face: u32, front: bool, index: u32) -> Vec<(u32, DVec3)> {
        let scene = self.visibility.scene();
        let f = &scene.faces[face as usize];
        let p = sobol(index, 0, seed_of(&[face, 0x11]));
        let frame = scene.face_frame(f);
        let uv = frame.uniform(p[0], p[1]);
        let normal = if front { f.normal } else { -f.normal };
        let d = Frame::new(normal).to_scene(cosine_hemisphere(p[2], p[3]));
        let point = frame.at(self.visibility.inside(face, uv.x, uv.y).into());
        let mut sides = self.walk(self.visibility.leave(face, point, normal), d, face);
        sides.push((side_index(face, front) as u32, point));
        sides
    }

    fn walk_from_camera(&self, frame: &CameraFrame, size: [u32; 2], index: u32) -> Vec<(u32, DVec3)> {
        let p = sobol(index, 0, 0xca3);
        let (origin, d) = frame.ray(p[0] * f64::from(size[0]), p[1] * f64::from(size[1]));
        self.walk(origin, d, u32::MAX)
    }

    fn walk(&self, mut origin: Vec3, mut direction: DVec3, mut from: u32) -> Vec<(u32, DVec3)> {
        let scene = self.visibility.scene();
        let mut sides = Vec::new();
        for step in 0..STEPS {
            let Some(hit) = self.visibility.closest(origin, direction.as_vec3(), from) else { break };
            sides.push((side_index(hit.face, hit.front) as u32, self.visibility.point(&hit).point));
            let at = self.visibility.point(&hit);
            let material = scene.material(&scene.faces[hit.face as usize]);
            if !hit.front && !material.two_sided {
                break;
            }
            let p = sobol(step, 0, self.seed);
            let mut normal = at.geometric;
            from = hit.face;
            // Any way that light may go on is taken, whatever its weight: this asks whether, not how much.
            let specular = material.is_specular() && (p[3] < 0.5 || !material.is_diffuse());
            if specular {
                let q = sobol(step, 1, self.seed);
                let wo = -direction;
                let specular = Specular::new(material, wo, at.facing(wo), at.geometric, hit.front);
                let Some(s) = specular.sample([q[0], q[1], q[2]]) else { break };
                // A shading normal may have turned the direction of a wide lobe to the wrong side of the face.
                if (s.direction.dot(at.geometric) > 0.0) == s.transmitted {
                    break;
                }
                direction = s.direction;
                if s.transmitted {
                    normal = -normal;
                }
            } else {
                // A black surface scatters too: a camera may see what lies around it only.
                if material.is_translucent() && p[2] < 0.5 {
                    normal = -normal;
                }
                direction = Frame::new(normal).to_scene(cosine_hemisphere(p[0], p[1]));
            }
            origin = self.visibility.leave(hit.face, at.point, normal);
        }
        sides
    }
}
