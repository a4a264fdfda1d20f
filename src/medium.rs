//! In what medium a point lies.
//!
//! Glass states its index in relation to what is about it, so the indices of bodies within bodies multiply. A ray that goes straight
//! on through all surfaces to the outside, whose index is 1, leaves every body that it began in: those that it leaves without having
//! entered them before, by the front of the same glass, are the ones that its start lies in. Where glass does not close a body, rays of
//! one place disagree, and vote.

use crate::geometry::Frame;
use crate::sampling;
use crate::scene::{Face, Material, Scene};
use crate::visibility::{SurfaceHit, Visibility};
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Rays that find the medium in front of a side.
const OF_SIDE: u32 = 32;
/// Rays that find the medium about a point.
const OF_POINT: u32 = 128;
/// Fewest and most rays that tell how an object lies in others, and rays a face between the two.
const OF_OBJECT: (usize, usize, usize) = (64, 4096, 4);
/// So many rays that are unsure weigh as much as one that is not: from the bottom of a basin, few rays meet the water's surface.
const UNSURE: u32 = 30;
/// Surfaces on one way at most.
const LONGEST: u32 = 10_000;
/// Objects named in a warning.
const NAMED: usize = 5;
/// Indices closer than this are the same, but for rounding.
const SAME: f64 = 1e-6;

/// The glass of a scene that bends light.
#[derive(Debug, Clone)]
pub(crate) struct Media {
    /// Corners of a box about all of it: what lies beyond changes nothing.
    bounds: [Vec3; 2],
}

/// What a straight ray met on its way to the outside.
#[derive(Debug, Default)]
struct Way {
    /// Indices of the bodies that it left and had not entered.
    left: Vec<f64>,
    /// Indices of those that it entered and has not left.
    entered: Vec<f64>,
    /// Something opaque lay in between.
    opaque: bool,
    /// It left the first of them before anything opaque.
    straight: bool,
}

impl Way {
    fn cross(&mut self, material: &Material, front: bool) {
        self.opaque |= !material.lets_through();
        if !material.bends() {
            return;
        }
        if front {
            self.entered.push(material.ior);
        } else if let Some(k) = self.entered.iter().rposition(|ior| *ior == material.ior) {
            self.entered.remove(k);
        } else {
            // Where two kinds of glass touch and have one surface there, what is left is not what was entered.
            let entered: f64 = self.entered.drain(..).product();
            self.straight |= !self.opaque;
            self.left.push(material.ior / entered);
        }
    }

    /// Not sure that it began outside, where it found no glass to leave but something opaque: glass that stands on what is opaque has no
    /// face there. Nor that it began inside, where it came to the glass that it left through something opaque, as from beside a basin,
    /// or entered glass for good: this may be the far side of glass that is turned outside in.
    fn is_unsure(&self) -> bool {
        if self.left.is_empty() { self.opaque } else { !self.straight || !self.entered.is_empty() }
    }

    /// Index of the medium that it began in.
    fn index(&self) -> f64 {
        let index: f64 = self.left.iter().product();
        if (index - 1.0).abs() < SAME { 1.0 } else { index }
    }
}

impl Media {
    /// None without glass that bends light: the index is 1 everywhere.
    pub(crate) fn new(scene: &Scene) -> Option<Media> {
        let faces = scene.faces.iter().filter(|f| scene.material(f).bends());
        let corners = faces.flat_map(|f| f.vertices.map(|v| scene.vertices[v as usize].as_vec3()));
        let bounds = corners.map(|c| [c, c]).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
        // Rays start a little off the faces.
        let margin = Vec3::splat(1e-3 * scene.radius as f32);
        Some(Media { bounds: [bounds[0] - margin, bounds[1] + margin] })
    }

    /// Whether all glass lies off a ray.
    fn is_past(&self, origin: Vec3, direction: Vec3) -> bool {
        let [low, high] = self.bounds.map(|corner| (corner - origin) / direction);
        // A ray along a side of the box within its plane gives NaN, which `min` and `max` leave out.
        let (enter, leave) = (low.min(high).max_element(), low.max(high).min_element());
        leave < enter.max(0.0)
    }

    /// Follows a ray beyond a surface, and that surface.
    fn beyond(&self, visibility: &Visibility, mut hit: SurfaceHit, direction: Vec3) -> Way {
        let scene = visibility.scene();
        let mut way = Way::default();
        for _ in 0..LONGEST {
            way.cross(scene.material(&scene.faces[hit.face as usize]), hit.front);
            let at = visibility.point(&hit);
            let origin = visibility.leave(hit.face, at.point, -at.geometric);
            if self.is_past(origin, direction) {
                break;
            }
            let Some(next) = visibility.closest(origin, direction, hit.face) else { break };
            hit = next;
        }
        way
    }

    /// The way of a ray that leaves a face, or begins at no face.
    fn way(&self, visibility: &Visibility, origin: Vec3, direction: Vec3, from: u32) -> Way {
        let hit = visibility.closest(origin, direction, from);
        hit.map_or(Way::default(), |hit| self.beyond(visibility, hit, direction))
    }

    /// The way of the `k`-th ray from a side of a face.
    fn of_side(&self, visibility: &Visibility, face: u32, normal: DVec3, k: u32) -> Way {
        let place = visibility.scene().face_frame(&visibility.scene().faces[face as usize]);
        let [u, v, a, b] = sampling::sobol(k, 0, 0);
        let origin = visibility.leave(face, place.at(place.uniform(u, v)), normal);
        let direction = Frame::new(normal).to_scene(sampling::cosine_hemisphere(a, b)).as_vec3();
        self.way(visibility, origin, direction, face)
    }

    /// Squared index of the medium in front of a side of a face.
    pub(crate) fn side_index2(&self, visibility: &Visibility, face: u32, normal: DVec3) -> f64 {
        elected((0..OF_SIDE).map(|k| self.of_side(visibility, face, normal, k))).powi(2)
    }

    /// Squared index of the medium about a point.
    pub(crate) fn point_index2(&self, visibility: &Visibility, point: DVec3) -> f64 {
        if point.length() > visibility.scene().radius {
            return 1.0;
        }
        let ways = (0..OF_POINT).map(|k| {
            let [u, v, ..] = sampling::sobol(k, 0, 0);
            let (z, azimuth) = (1.0 - 2.0 * u, 2.0 * PI * v);
            let across = (1.0 - z * z).max(0.0).sqrt();
            let direction = DVec3::new(across * azimuth.cos(), across * azimuth.sin(), z);
            self.way(visibility, point.as_vec3(), direction.as_vec3(), u32::MAX)
        });
        elected(ways).powi(2)
    }

    /// Squared index of the medium that a ray came through to the surface of glass that it met.
    pub(crate) fn index2_before(&self, visibility: &Visibility, hit: &SurfaceHit, direction: Vec3) -> f64 {
        self.beyond(visibility, *hit, direction).index().powi(2)
    }

    /// By object: rays from the fronts of its glass leave other glass, so that it lies in that, as far as these tell.
    pub(crate) fn nested(&self, visibility: &Visibility) -> Vec<bool> {
        by_object(visibility.scene(), |faces| {
            let mut ways = self.ways_of_fronts(visibility, faces);
            ways.any(|way| !way.left.is_empty())
        })
    }

    /// By object: rays from the fronts of its glass enter glass for good, more of them than not. Its normals point inwards then.
    pub(crate) fn turned_inwards(&self, visibility: &Visibility) -> Vec<bool> {
        by_object(visibility.scene(), |faces| {
            let (mut all, mut enter) = (0, 0);
            for way in self.ways_of_fronts(visibility, faces) {
                all += 1;
                enter += usize::from(!way.entered.is_empty());
            }
            2 * enter > all
        })
    }

    fn ways_of_fronts(&self, visibility: &Visibility, faces: &[u32]) -> impl Iterator<Item = Way> {
        let (fewest, most, each) = OF_OBJECT;
        let rays = (each * faces.len()).clamp(fewest, most);
        (0..rays).map(move |k| {
            let face = faces[k * faces.len() / rays];
            let normal = visibility.scene().faces[face as usize].normal;
            self.of_side(visibility, face, normal, k as u32)
        })
    }
}

/// What a user should know of the glass of a scene, by name of the object.
pub(crate) fn warnings(visibility: &Visibility) -> Vec<String> {
    let scene = visibility.scene();
    let turned = Media::new(scene).map_or(Vec::new(), |media| media.turned_inwards(visibility));
    let mut names: Vec<String> = scene
        .objects
        .iter()
        .zip(turned)
        .filter(|(_, turned)| *turned)
        .map(|(o, _)| format!("object \"{o}\""))
        .collect();
    if names.is_empty() {
        return names;
    }
    if names.len() > NAMED {
        names.truncate(NAMED);
        names.push("...".into());
    }
    let what = "glass has normals that point into it: light takes its inside for the outside; flip them, or say `thin = true`";
    vec![format!("{what} ({})", names.join(", "))]
}

/// By object: what is so of its faces of glass that bends light; of no faces, nothing is.
fn by_object(scene: &Scene, is_so: impl Fn(&[u32]) -> bool) -> Vec<bool> {
    let mut faces = vec![Vec::new(); scene.objects.len()];
    let bends = |f: &Face| scene.material(f).bends();
    let glass = scene.faces.iter().enumerate().filter(|(_, f)| bends(f));
    glass.for_each(|(k, f)| faces[f.object as usize].push(k as u32));
    faces.iter().map(|f| !f.is_empty() && is_so(f)).collect()
}

/// The index that most ways of one place tell.
fn elected(ways: impl Iterator<Item = Way>) -> f64 {
    let mut votes = BTreeMap::new();
    let mut unsure = 0;
    for way in ways {
        let index = way.index();
        if way.is_unsure() {
            unsure += 1;
        } else {
            votes.entry((index / SAME).round() as i64).or_insert((index, 0)).1 += UNSURE;
        }
    }
    let all = unsure + votes.values().map(|(_, n)| n).sum::<u32>();
    let most = votes.into_values().max_by_key(|(_, n)| *n);
    most.filter(|(_, n)| 2 * n > all).map_or(1.0, |(index, _)| index)
}
