//! Sampling the light sources, straight and by their mirror images.
//!
//! A flat perfect mirror shows the sources where their mirror images are: the paper's way to
//! couple specular and diffuse surfaces. Each sampled point of an emitter is also reflected in
//! every mirror plane, and counts where the image is seen through the mirror's outline.
//!
//! Radiance everywhere is radiance over index squared ([`crate::bsdf`]), that of an emitter embedded in glass
//! too: its power is what its material says, and of the radiance inside, `1 / n^2` is seen from outside.

use crate::color::{self, Rgb};
use crate::medium::Media;
use crate::mesh::side_index;
use crate::scene::{FaceFrame, MIRROR_ALPHA, Scene};
use crate::visibility::Visibility;
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// With more mirror planes than this (a faceted ball, say) images are not worth their cost.
const MAX_MIRRORS: usize = 32;
/// Cells along a mirror plane at most: slender faces lie in many.
const MOST_CELLS: f64 = 64.0;
/// A receiver this near to a mirror's plane, as a share of the scene's radius, is part of it.
const ON_MIRROR: f64 = 1e-9;
const NONE: u32 = u32::MAX;
/// As many emitting sides as are few: their light is calculated one by one for every element.
const FEW: usize = 16;
/// Share of the samples that lamps (all of an object that has one material) get in equal parts, whatever their power: the
/// strongest may be in another room, and what lights this one would never be sampled.
const FOR_EACH: f64 = 0.25;

/// All emitting sides of a scene, and the planes of its flat mirrors.
#[derive(Debug, Clone)]
pub struct Emitters {
    sides: Vec<EmitterSide>,
    cumulative: Vec<f64>,
    index: Vec<u32>,
    mirrors: Vec<MirrorPlane>,
    mirror_of: Vec<u32>,
}

#[derive(Debug, Clone, Copy)]
struct EmitterSide {
    face: u32,
    front: bool,
    /// Over the squared index of the medium [W m^-2 sr^-1].
    radiance: Rgb,
    /// Squared index of the medium in front of it: above 1 inside of glass.
    index2: f64,
    normal: DVec3,
    /// Probability of choosing the side over its area [m^-2].
    density: f64,
    frame: FaceFrame,
}

#[derive(Debug, Clone)]
struct MirrorPlane {
    normal: DVec3,
    offset: f64,
    faces: Vec<u32>,
    cells: Cells,
}

/// A grid over the faces of one plane: a mirror may be of very many.
#[derive(Debug, Clone, Default)]
struct Cells {
    /// Vectors in the plane by which places become cells [m^-1].
    axes: [DVec3; 2],
    /// What the first cell begins at, in cells.
    low: [f64; 2],
    count: [usize; 2],
    /// Where the faces of each cell begin, and the end.
    first: Vec<u32>,
    faces: Vec<u32>,
}

impl Cells {
    /// About as many cells as faces.
    fn new(scene: &Scene, normal: DVec3, faces: &[u32]) -> Cells {
        let (u, v) = normal.any_orthonormal_pair();
        let bounds = |f: u32, axis: DVec3| {
            let along = (0..4).map(|k| scene.corner(&scene.faces[f as usize], k).dot(axis));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
        };
        let whole = [u, v].map(|axis| {
            let both = faces.iter().map(|f| bounds(*f, axis));
            both.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], [c, d]| [a.min(c), b.max(d)])
        });
        let [width, height] = whole.map(|[a, b]| (b - a).max(f64::MIN_POSITIVE));
        let along = |l: f64, across: f64| {
            let count = (faces.len() as f64 * l / across).sqrt().ceil();
            count.clamp(1.0, MOST_CELLS) as usize
        };
        let count = [along(width, height), along(height, width)];
        let scale = [count[0] as f64 / width, count[1] as f64 / height];
        let mut cells = Cells {
            axes: [u * scale[0], v * scale[1]],
            low: [whole[0][0] * scale[0], whole[1][0] * scale[1]],
            count,
            first: Vec::new(),
            faces: Vec::new(),
        };
        let mut within: Vec<Vec<u32>> = vec![Vec::new(); count[0] * count[1]];
        for f in faces {
            // A little wider than the face: a place on its edge may fall into the next cell.
            let [x, y] = [0, 1].map(|k| {
                let [a, b] = bounds(*f, cells.axes[k]).map(|x| x - cells.low[k]);
                cells.index(k, a - 1e-6)..=cells.index(k, b + 1e-6)
            });
            y.for_each(|y| x.clone().for_each(|x| within[y * count[0] + x].push(*f)));
        }
        cells.first = vec![0];
        for faces in within {
            cells.faces.extend(faces);
            cells.first.push(cells.faces.len() as u32);
        }
        cells
    }

    /// The cell along an axis at a distance from the first one's beginning, in cells.
    fn index(&self, axis: usize, place: f64) -> usize {
        (place.max(0.0) as usize).min(self.count[axis] - 1)
    }

    /// The faces, in order, on which a place of the plane may be.
    fn near(&self, place: DVec3) -> &[u32] {
        let [x, y] = [0, 1].map(|k| self.index(k, place.dot(self.axes[k]) - self.low[k]));
        let cell = y * self.count[0] + x;
        &self.faces[self.first[cell] as usize..self.first[cell + 1] as usize]
    }
}

/// A point on an emitter.
#[derive(Debug, Clone, Copy)]
pub struct EmitterSample {
    /// Position.
    pub point: DVec3,
    /// Unit normal towards the emitting side.
    pub normal: DVec3,
    /// Emitted radiance over the squared index of the medium [W m^-2 sr^-1].
    pub radiance: Rgb,
    /// Density per area of the emitters [m^-2].
    pub density: f64,
    /// The emitting face.
    pub face: u32,
    /// Number of the emitting side, below [`Emitters::len`].
    pub side: usize,
}

/// How light came from an emitter to a receiver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Passage {
    /// In a straight line.
    Straight,
    /// By one flat mirror whose images are sampled.
    Image,
    /// By any other specular chain.
    Chain,
}

/// Geometry of one connection from a receiver to an emitter.
#[derive(Debug, Clone, Copy)]
pub struct Connection {
    /// Unit direction at the receiver.
    pub direction: DVec3,
    /// Irradiance at the receiver for one sample, before visibility [W m^-2].
    pub irradiance: Rgb,
    /// Density of the sample per solid angle at the receiver [sr^-1].
    pub density: f64,
}

impl Emitters {
    /// The emitters and flat mirrors of a scene.
    pub fn new(visibility: &Visibility) -> Emitters {
        let scene = visibility.scene();
        let media = Media::new(scene);
        let mut sides = Vec::new();
        let mut index = vec![NONE; 2 * scene.faces.len()];
        for (k, face) in scene.faces.iter().enumerate() {
            for front in [true, false] {
                let radiance = scene.material(face).emitted(front);
                if radiance.max_element() > 0.0 {
                    index[side_index(k as u32, front)] = sides.len() as u32;
                    let normal = if front { face.normal } else { -face.normal };
                    let index2 = |m: &Media| m.side_index2(visibility, k as u32, normal);
                    let index2 = media.as_ref().map_or(1.0, index2);
                    let radiance = radiance / index2;
                    sides.push(EmitterSide {
                        face: k as u32,
                        front,
                        radiance,
                        index2,
                        normal,
                        density: 0.0,
                        frame: scene.face_frame(face),
                    });
                }
            }
        }
        let power: Vec<f64> = sides
            .iter()
            .map(|s| scene.faces[s.face as usize].area * s.index2 * color::mean(s.radiance))
            .collect();
        let (mut sum, mut cumulative) = (0.0, Vec::with_capacity(sides.len()));
        let chances = chances(scene, &sides, &power);
        for (side, chance) in sides.iter_mut().zip(chances) {
            sum += chance;
            cumulative.push(sum);
            side.density = chance / scene.faces[side.face as usize].area;
        }
        let (mirrors, mirror_of) = mirror_planes(scene);
        Emitters { sides, cumulative, index, mirrors, mirror_of }
    }

    /// Power that all emitters send out \[W\].
    pub fn power(&self, scene: &Scene) -> Rgb {
        let power = |s: &EmitterSide| PI * s.radiance * s.index2 * scene.faces[s.face as usize].area;
        self.sides.iter().map(power).sum()
    }

    /// The scene has no emitter.
    pub fn is_empty(&self) -> bool {
        self.sides.is_empty()
    }

    /// Number of emitting sides.
    pub fn len(&self) -> usize {
        self.sides.len()
    }

    /// Whether pass 1 calculates the straight light of each emitter by itself: rows' rays then leave it alone.
    pub fn are_few(&self) -> bool {
        (1..=FEW).contains(&self.sides.len())
    }

    /// Face, side and radiance (over the squared index of the medium) of every emitting side.
    pub fn sides(&self) -> impl Iterator<Item = (u32, bool, Rgb)> + '_ {
        self.sides.iter().map(|s| (s.face, s.front, s.radiance))
    }

    /// The emitters have sampled mirror images.
    pub fn has_images(&self) -> bool {
        !self.mirrors.is_empty() && !self.sides.is_empty()
    }

    /// Whether a face is part of a flat mirror whose images are sampled.
    pub fn is_image_mirror(&self, face: u32) -> bool {
        self.mirror_of.get(face as usize).is_some_and(|m| *m != NONE)
    }

    /// Radiance (over the squared index of the medium) and area density of the side that a ray met; none if it does not
    /// emit.
    #[inline]
    pub fn at(&self, face: u32, front: bool) -> Option<(Rgb, f64)> {
        match self.index[side_index(face, front)] {
            NONE => None,
            k => Some((self.sides[k as usize].radiance, self.sides[k as usize].density)),
        }
    }

    /// A point of any side: its lamp is chosen by power for the most part, within a lamp sides by power; `u` in [0, 1)^3.
    pub fn sample(&self, u: [f64; 3]) -> Option<EmitterSample> {
        let k = self.cumulative.partition_point(|c| *c <= u[0]).min(self.sides.len().checked_sub(1)?);
        Some(self.on_side(k, [u[1], u[2]]))
    }

    /// A point of an emitting side, uniform over its area; `u` in [0, 1)^2. Its density is that among all sides.
    pub fn on_side(&self, k: usize, u: [f64; 2]) -> EmitterSample {
        let side = &self.sides[k];
        EmitterSample {
            point: side.frame.at(side.frame.uniform(u[0], u[1])),
            normal: side.normal,
            radiance: side.radiance,
            density: side.density,
            face: side.face,
            side: k,
        }
    }

    /// Chance that [`Emitters::sample`] chooses a side.
    pub fn chance(&self, k: usize) -> f64 {
        self.cumulative[k] - if k > 0 { self.cumulative[k - 1] } else { 0.0 }
    }

    /// Number and normal of an emitting side; none if it does not emit.
    pub fn side(&self, face: u32, front: bool) -> Option<(usize, DVec3)> {
        match self.index[side_index(face, front)] {
            NONE => None,
            k => Some((k as usize, self.sides[k as usize].normal)),
        }
    }

    /// Calls `found(face, window, connection)` for every mirror plane in which the receiver at `point` with
    /// unit normal `normal` sees the image of a sampled emitter point, visibility aside.
    pub fn images(
        &self,
        scene: &Scene,
        point: DVec3,
        normal: DVec3,
        sample: &EmitterSample,
        mut found: impl FnMut(u32, DVec3, Connection),
    ) {
        for mirror in &self.mirrors {
            let (a, b) =
                (mirror.normal.dot(point) - mirror.offset, mirror.normal.dot(sample.point) - mirror.offset);
            // Both in front, or both behind; a point of the mirror itself sees no image in it.
            if a * b <= 0.0 || a.abs() < ON_MIRROR * scene.radius {
                continue;
            }
            let flip = -2.0 * mirror.normal.dot(sample.normal);
            let image = EmitterSample {
                point: sample.point - 2.0 * b * mirror.normal,
                normal: sample.normal + flip * mirror.normal,
                ..*sample
            };
            let Some(connection) = connect(point, normal, &image) else { continue };
            let window = point + (image.point - point) * (a / (a + b));
            let front = a > 0.0;
            let face = mirror.cells.near(window).iter().copied().find(|&f| {
                let face = &scene.faces[f as usize];
                scene.face_frame(face).contains(window)
                    && (scene.material(face).two_sided || front == (face.normal.dot(mirror.normal) > 0.0))
            });
            if let Some(face) = face {
                let albedo = scene.material(&scene.faces[face as usize]).specular;
                found(face, window, Connection { irradiance: connection.irradiance * albedo, ..connection });
            }
        }
    }

    /// Whether the two legs of a connection by a mirror are free.
    pub fn image_visible(
        &self,
        v: &Visibility,
        origin: Vec3,
        face: u32,
        window: DVec3,
        s: &EmitterSample,
    ) -> bool {
        let n = v.scene().faces[face as usize].normal;
        let side = if n.dot(origin.as_dvec3() - window) > 0.0 { n } else { -n };
        v.unoccluded(&v.segment(origin, face, window, side))
            && v.unoccluded(&v.segment(v.leave(face, window, side), s.face, s.point, s.normal))
    }
}

/// Chance of choosing each emitting side: of a sample's light anywhere, the powers decide, but for [`FOR_EACH`].
fn chances(scene: &Scene, sides: &[EmitterSide], power: &[f64]) -> Vec<f64> {
    let lamp = |s: &EmitterSide| {
        let face = &scene.faces[s.face as usize];
        (face.object, face.material)
    };
    let mut of_lamp = BTreeMap::new();
    sides.iter().zip(power).for_each(|(s, p)| *of_lamp.entry(lamp(s)).or_insert(0.0) += p);
    let total: f64 = power.iter().sum();
    let equal = total / of_lamp.len() as f64;
    let share = |s: &EmitterSide| (1.0 - FOR_EACH) / total + FOR_EACH / total * (equal / of_lamp[&lamp(s)]);
    sides.iter().zip(power).map(|(s, p)| p * share(s)).collect()
}

/// The connection of a receiver with a sampled point, where each faces the other.
#[inline]
pub fn connect(point: DVec3, normal: DVec3, sample: &EmitterSample) -> Option<Connection> {
    let d = sample.point - point;
    let r2 = d.length_squared();
    let direction = d / r2.sqrt();
    let (cos_r, cos_e) = (direction.dot(normal), -direction.dot(sample.normal));
    if !(cos_r > 0.0 && cos_e > 0.0) {
        return None;
    }
    let density = sample.density * r2 / cos_e;
    Some(Connection { direction, irradiance: sample.radiance * (cos_r / density), density })
}

/// Power heuristic (Veach 1997, eq. 9.11): share of the technique with `n` samples of density `p` beside
/// one with `m` samples of density `q`.
///
/// Squares, not the plain balance: emitter samples are far better stratified than the few hemisphere rays that
/// happen to meet a small emitter, and even a small share of these would bring all their noise.
#[inline]
pub fn mis_share(n: f64, p: f64, m: f64, q: f64) -> f64 {
    if p.is_infinite() {
        return 1.0;
    }
    let (a, b) = (n * p, m * q);
    a * a / (a * a + b * b)
}

/// Density of a cosine-weighted direction [sr^-1].
#[inline]
pub fn cosine_density(cos: f64) -> f64 {
    cos.max(0.0) / PI
}

fn mirror_planes(scene: &Scene) -> (Vec<MirrorPlane>, Vec<u32>) {
    let mut planes: Vec<MirrorPlane> = Vec::new();
    let mut of = vec![NONE; scene.faces.len()];
    for (k, face) in scene.faces.iter().enumerate() {
        let m = scene.material(face);
        if m.specular == Rgb::ZERO || m.is_glass() || m.alpha() >= MIRROR_ALPHA || face.normals.is_some() {
            continue;
        }
        let offset = face.normal.dot(scene.corner(face, 0));
        let same = planes.iter().position(|p| {
            let c = p.normal.dot(face.normal);
            c.abs() > 1.0 - 1e-12 && (p.offset - offset * c.signum()).abs() < 1e-9 * scene.radius
        });
        let at = same.unwrap_or_else(|| {
            planes.push(MirrorPlane {
                normal: face.normal,
                offset,
                faces: Vec::new(),
                cells: Cells::default(),
            });
            planes.len() - 1
        });
        planes[at].faces.push(k as u32);
        of[k] = at as u32;
        if planes.len() > MAX_MIRRORS {
            return (Vec::new(), vec![NONE; scene.faces.len()]);
        }
    }
    planes.iter_mut().for_each(|p| p.cells = Cells::new(scene, p.normal, &p.faces));
    (planes, of)
}
