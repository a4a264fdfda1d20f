//! Extended form factors of flat mirrors by mirroring the environment, as Wallace, Cohen and Greenberg (1987,
//! section 3) did it: a second estimate, independent of the chains in `specular`.
//!
//! A flat mirror is a window into a mirrored copy of the scene. A ray of an element that crosses the
//! mirror's outline, and that nothing stops before, goes straight on in that copy; there it may cross the image of a
//! mirror again. The crossing is plain geometry (plane and outline in f64), the ray itself never bends:
//! each copy is the scene under one more reflection, and its visibility is asked by reflecting the ray's segment back.
//! No lobe is sampled and no chain followed; points and directions are Sobol points of their own.

use super::matrix::{ExchangeMatrix, RowSummary};
use super::rows::Builder;
use crate::color::{self, Rgb};
use crate::geometry::Frame;
use crate::mesh::{Mesh, NONE};
use crate::sampling::{MAX_POINTS, cosine_hemisphere, seed_of, sobol};
use crate::scene::{MIRROR_ALPHA, Scene};
use crate::visibility::Visibility;
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Images of images at most; what a ray still carries then is reported as dropped.
const MOST_IMAGES: u32 = 256;
/// A crossing this near to the origin, as a share of the scene's radius, is the mirror that the ray just passed.
const NEAR: f64 = 1e-7;

/// A flat mirror: one face.
struct Window {
    face: u32,
    albedo: Rgb,
    normal: DVec3,
    two_sided: bool,
}

/// The scene under reflections: a point `p` of the copy stands where `turn * p + shift` of the scene does.
#[derive(Clone, Copy)]
struct Copy {
    turn: DMat3,
    shift: DVec3,
}

impl Copy {
    fn point(&self, p: DVec3) -> DVec3 {
        self.turn * p + self.shift
    }

    /// One more reflection, in the plane `normal . p = offset` of the scene.
    fn reflected(&self, normal: DVec3, offset: f64) -> Copy {
        let flip =
            DMat3::IDENTITY - 2.0 * DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        Copy { turn: flip * self.turn, shift: flip * self.shift + 2.0 * offset * normal }
    }
}

/// Form factors from every element to every diffuse element, straight and by images in flat mirrors: `batches`
/// independent randomisations of at least `rays` rays in all, as [`super::cast`] with chains.
///
/// # Errors
/// Some surface is specular but no flat perfect mirror; the error names its material.
pub fn cast_images(
    visibility: &Visibility,
    mesh: &Mesh,
    (rays, batches): (u32, u32),
    seed: u32,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<ExchangeMatrix> {
    let scene = visibility.scene();
    let images = Images { visibility, mesh, windows: windows(scene)?, seed };
    let batches = batches.max(rays.div_ceil(MAX_POINTS)).clamp(1, rays.max(1));
    let per_batch = rays.max(1).div_ceil(batches);
    let coloured = images.windows.iter().any(|w| !color::is_grey(w.albedo));
    let rows: Vec<Row> = (0..mesh.len() as u32)
        .into_par_iter()
        .map(|element| {
            let row = images.row(element, batches, per_batch);
            progress(1);
            row
        })
        .collect();
    let channels = if coloured { 3 } else { 1 };
    let mut builder = Builder::new(false);
    let (mut blocks, mut summary, mut cast) = (Vec::new(), Vec::new(), 0);
    for row in rows {
        for batch in row.batches {
            for (j, weight) in batch {
                builder.push(j, &weight.as_vec3().to_array()[..channels]);
            }
            builder.end_batch();
        }
        builder.end_row(batches as usize, channels, 1.0);
        blocks.push(builder.finish());
        summary.push(row.summary);
        cast += row.rays;
    }
    Ok(ExchangeMatrix {
        batches: batches as usize,
        channels,
        rows_per_block: 1,
        blocks,
        summary,
        rays_per_row: batches * per_batch,
        rays: cast,
    })
}

fn windows(scene: &Scene) -> Result<Vec<Window>> {
    let mut windows = Vec::new();
    for (k, face) in scene.faces.iter().enumerate() {
        let m = scene.material(face);
        if !m.is_specular() {
            continue;
        }
        let trouble = match () {
            () if m.is_glass() => "is glass",
            () if m.alpha() >= MIRROR_ALPHA => "is glossy",
            () if face.normals.is_some() => "is on faces with shading normals",
            () => "",
        };
        if !trouble.is_empty() {
            return Err(Error::scene(
                format!("material \"{}\"", m.name),
                format!("{trouble}: images need flat perfect mirrors; use --mirror chain"),
            ));
        }
        let (face, albedo, two_sided) = (k as u32, m.specular, m.two_sided);
        windows.push(Window { face, albedo, normal: scene.faces[k].normal, two_sided });
    }
    Ok(windows)
}

struct Row {
    batches: Vec<BTreeMap<u32, Rgb>>,
    summary: RowSummary,
    rays: u64,
}

struct Images<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    windows: Vec<Window>,
    seed: u32,
}

impl Images<'_, '_> {
    fn row(&self, element: u32, batches: u32, per_batch: u32) -> Row {
        let place = self.mesh.place_of(self.visibility.scene(), element);
        let frame = Frame::new(place.normal);
        let scale = 1.0 / f64::from(batches * per_batch);
        let mut row = Row { batches: Vec::new(), summary: RowSummary::default(), rays: 0 };
        row.summary.exposed = 1.0;
        for batch in 0..batches {
            let mut sums = BTreeMap::new();
            let seed = seed_of(&[self.seed, element, batch, 0x1a6e]);
            for k in 0..per_batch {
                let u = sobol(k, 0, seed);
                let direction = frame.to_scene(cosine_hemisphere(u[2], u[3]));
                let start = self.visibility.start(&place, u[0], u[1]);
                self.look((start, place.normal, place.face), direction, scale, &mut sums, &mut row);
            }
            row.batches.push(sums);
        }
        row
    }

    /// One straight ray from `start` on `face`, through the scene and its copies.
    fn look(
        &self,
        (start, normal, mut from): (DVec3, DVec3, u32),
        direction: DVec3,
        scale: f64,
        sums: &mut BTreeMap<u32, Rgb>,
        row: &mut Row,
    ) {
        let mut copy = Copy { turn: DMat3::IDENTITY, shift: DVec3::ZERO };
        let mut weight = Rgb::splat(scale);
        // Where the ray enters this copy, and the side of the surface that it enters by, both in the scene.
        let (mut entry, mut side) = (start, normal);
        for _ in 0..MOST_IMAGES {
            let (origin, along) = (copy.point(start), copy.turn * direction);
            let leave = self.visibility.leave(from, entry, side);
            row.rays += 1;
            let crossing = self.crossing(origin, along, entry);
            if let Some((window, at)) = crossing {
                let facing = window.normal * if window.normal.dot(along) < 0.0 { 1.0 } else { -1.0 };
                if self.visibility.unoccluded(&self.visibility.segment(leave, window.face, at, facing)) {
                    // What the mirror takes itself, its element has where it has one: it is diffuse too, or shines.
                    let rest = weight * (Rgb::ONE - window.albedo);
                    if !self.count(window.face, facing == window.normal, at, weight, sums) {
                        row.summary.absorbed += rest;
                    }
                    weight -= rest;
                    if weight.max_element() <= 0.0 {
                        return;
                    }
                    copy = copy.reflected(window.normal, window.normal.dot(at));
                    (entry, side, from) = (at, facing, window.face);
                    continue;
                }
            }
            match self.visibility.closest(leave, along.as_vec3(), from) {
                None => row.summary.escaped += weight,
                Some(hit) => match self.mesh.element(hit.face, hit.front, hit.u, hit.v) {
                    NONE => row.summary.absorbed += weight,
                    j => *sums.entry(j).or_insert(Rgb::ZERO) += weight,
                },
            }
            return;
        }
        row.summary.dropped += weight;
    }

    /// Counts what meets an element of a mirror; false where it has none.
    fn count(&self, face: u32, front: bool, at: DVec3, weight: Rgb, sums: &mut BTreeMap<u32, Rgb>) -> bool {
        let scene = self.visibility.scene();
        let uv = scene.face_frame(&scene.faces[face as usize]).coordinates(at).as_vec2();
        let j = self.mesh.element(face, front, uv.x, uv.y);
        if j != NONE {
            *sums.entry(j).or_insert(Rgb::ZERO) += weight;
        }
        j != NONE
    }

    /// The first window that the straight line from `origin` crosses beyond `entry`, and where.
    fn crossing(&self, origin: DVec3, along: DVec3, entry: DVec3) -> Option<(&Window, DVec3)> {
        let scene = self.visibility.scene();
        let begin = (entry - origin).dot(along) + NEAR * scene.radius;
        let crossings = self.windows.iter().filter_map(|w| {
            let p0 = scene.corner(&scene.faces[w.face as usize], 0);
            let slope = w.normal.dot(along);
            // A one-sided mirror is black on its back.
            if slope == 0.0 || (slope > 0.0 && !w.two_sided) {
                return None;
            }
            let t = w.normal.dot(p0 - origin) / slope;
            let at = origin + t * along;
            (t > begin && scene.face_frame(&scene.faces[w.face as usize]).contains(at)).then_some((t, w, at))
        });
        crossings.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, w, at)| (w, at))
    }
}
