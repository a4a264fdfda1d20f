//! Which pixels count where an error is measured.

use crate::emitters::Emitters;
use crate::scene::{Camera, CameraFrame, FaceFrame};
use crate::visibility::Visibility;
use glam::{DVec2, DVec3, dvec2};
use rayon::prelude::*;

/// Rays along one side of a pixel.
const RAYS: u32 = 4;
/// Distance from an emitter's bounds in the picture up to which its rays are cast \[pixels\]: rounding.
const BESIDE: f64 = 0.01;
/// Height of a part of an emitter in the picture \[pixels\] from which no pixel's rays miss it: a triangle of that height holds a circle of
/// two thirds of it, and the rays of a pixel leave none of more than 0.36.
const FOUND: f64 = 1.0;
/// Width of the parts of an emitter of which a few points stand for the whole \[pixels\].
const PART: f64 = 0.5;
/// Width of those of which one point does \[pixels\].
const POINT: f64 = 1.0 / 16.0;
/// Halvings of an emitter at most, and of parts of which some lies behind the eye.
const HALVINGS: (u32, u32) = (40, 16);

/// Which pixels of an image see no emitter directly nor have a neighbour that does, row by row: errors are measured over them
/// (DESIGN section 2), as the edges of lamps would hide all else.
///
/// Emitters are looked for by rays of every pixel, and those that slip between such rays by points of the emitters.
pub fn sees_no_emitter(visibility: &Visibility, emitters: &Emitters, camera: &Camera) -> Vec<bool> {
    let frame = camera.frame(visibility.scene());
    let [width, height] = camera.size;
    let sees = |x: u32, y: u32| {
        (0..RAYS * RAYS).any(|k| {
            let at = |j: u32| (f64::from(j) + 0.5) / f64::from(RAYS);
            let direction = frame.direction(f64::from(x) + at(k % RAYS), f64::from(y) + at(k / RAYS));
            meets_emitter(visibility, emitters, &frame, direction)
        })
    };
    let may = within_bounds(visibility, emitters, &frame, camera.size);
    let mut seen: Vec<bool> = may
        .into_par_iter()
        .enumerate()
        .map(|(k, may)| may && sees(k as u32 % width, k as u32 / width))
        .collect();
    let slips = |(face, front, _)| {
        let look = Look { visibility, emitters, frame: &frame, size: camera.size, seen: &seen };
        look.emitter(face, front)
    };
    let sides: Vec<_> = emitters.sides().collect();
    let small: Vec<u32> = sides.into_par_iter().flat_map_iter(slips).collect();
    small.into_iter().for_each(|pixel| seen[pixel as usize] = true);
    let near = |k: u32, n: u32| k.saturating_sub(1)..(k + 2).min(n);
    (0..width * height)
        .map(|k| {
            let (x, y) = (k % width, k / width);
            !near(y, height).any(|j| near(x, width).any(|i| seen[(j * width + i) as usize]))
        })
        .collect()
}

/// The pixels within the bounds of some emitter in the picture, row by row: no other shows one.
fn within_bounds(
    visibility: &Visibility,
    emitters: &Emitters,
    frame: &CameraFrame,
    [width, height]: [u32; 2],
) -> Vec<bool> {
    let scene = visibility.scene();
    let (columns, rows) = (width as usize + 1, height as usize + 1);
    // How many bounds begin at a pixel less those that end before it, along both axes.
    let mut steps = vec![0i32; columns * rows];
    for (face, ..) in emitters.sides() {
        let face = &scene.faces[face as usize];
        let count = if face.is_triangle() { 3 } else { 4 };
        let corners: Option<Vec<DVec2>> = (0..count).map(|k| frame.pixel(scene.corner(face, k))).collect();
        // Of what lies partly behind the eye nothing is known.
        let corners = corners.unwrap_or_else(|| vec![DVec2::NEG_INFINITY, DVec2::INFINITY]);
        let low = corners.iter().fold(DVec2::INFINITY, |m, c| m.min(*c)) - BESIDE;
        let high = corners.iter().fold(DVec2::NEG_INFINITY, |m, c| m.max(*c)) + BESIDE;
        let within = |x: f64, n: u32| x.clamp(0.0, n.into()) as usize;
        let [from, to] = [low, high.ceil()].map(|p| [within(p.x, width), within(p.y, height)]);
        for (x, y, step) in
            [(from[0], from[1], 1), (to[0], from[1], -1), (from[0], to[1], -1), (to[0], to[1], 1)]
        {
            steps[y * columns + x] += step;
        }
    }
    for y in 0..rows {
        for x in 1..columns {
            steps[y * columns + x] += steps[y * columns + x - 1];
        }
    }
    for k in columns..columns * rows {
        steps[k] += steps[k - columns];
    }
    (0..height as usize).flat_map(|y| steps[y * columns..][..width as usize].iter().map(|n| *n > 0)).collect()
}

/// Whether a view ray meets an emitting side.
fn meets_emitter(
    visibility: &Visibility,
    emitters: &Emitters,
    frame: &CameraFrame,
    direction: DVec3,
) -> bool {
    let hit = visibility.closest(frame.start(direction), direction.as_vec3(), u32::MAX);
    hit.is_some_and(|hit| emitters.at(hit.face, hit.front).is_some())
}

/// A rectangle in (s, t) of the unit square, which stands for a part of an emitter.
#[derive(Clone, Copy)]
struct Part {
    low: DVec2,
    high: DVec2,
    halvings: u32,
}

impl Part {
    fn at(&self, s: f64, t: f64) -> DVec2 {
        self.low + dvec2(s, t) * (self.high - self.low)
    }

    /// Its halves across one axis.
    fn halves(&self, axis: usize) -> [Part; 2] {
        let middle = 0.5 * (self.low[axis] + self.high[axis]);
        let mut halves = [Part { halvings: self.halvings + 1, ..*self }; 2];
        halves[0].high[axis] = middle;
        halves[1].low[axis] = middle;
        halves
    }
}

/// What is needed to look for emitters that slip between the rays.
struct Look<'a, 's> {
    visibility: &'a Visibility<'s>,
    emitters: &'a Emitters,
    frame: &'a CameraFrame,
    size: [u32; 2],
    /// Pixels whose rays have found an emitter.
    seen: &'a [bool],
}

impl Look<'_, '_> {
    /// Pixels in which an emitting side is seen, apart from those of which that is known.
    fn emitter(&self, face: u32, front: bool) -> Vec<u32> {
        let scene = self.visibility.scene();
        let input = &scene.faces[face as usize];
        let shape = scene.face_frame(input);
        let triangle = input.is_triangle();
        let normal = if front { input.normal } else { -input.normal };
        let mut found = Vec::new();
        if normal.dot(self.frame.origin() - shape.origin) <= 0.0 {
            return found;
        }
        let place = |st: DVec2| place(&shape, triangle, st);
        let mut parts = vec![Part { low: DVec2::ZERO, high: DVec2::ONE, halvings: 0 }];
        while let Some(part) = parts.pop() {
            let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(s, t)| place(part.at(s, t)));
            let [a, b, c, d] = corners.map(|p| self.frame.pixel(p));
            let (Some(a), Some(b), Some(c), Some(d)) = (a, b, c, d) else {
                let before = corners.iter().any(|p| self.frame.pixel(*p).is_some());
                if before && part.halvings < HALVINGS.1 {
                    let along = [0, 1].map(|k| corners[k].distance(corners[k + 1]));
                    parts.extend(part.halves(usize::from(along[1] > along[0])));
                }
                continue;
            };
            if self.is_outside([a, b, c, d]) {
                continue;
            }
            let along = [a.distance(b).max(c.distance(d)), b.distance(c).max(d.distance(a))];
            let longest = along[0].max(along[1]);
            let doubled =
                [(d, a, b), (a, b, c), (b, c, d), (c, d, a)].map(|(p, q, r)| (q - p).perp_dot(r - q).abs());
            if doubled.iter().all(|x| *x >= FOUND * longest) {
                continue;
            }
            if longest > PART && part.halvings < HALVINGS.0 {
                parts.extend(part.halves(usize::from(along[1] > along[0])));
                continue;
            }
            let points: &[f64] = if longest > POINT { &[0.25, 0.75] } else { &[0.5] };
            for (s, t) in points.iter().flat_map(|s| points.iter().map(move |t| (*s, *t))) {
                let last = found.last().copied();
                found.extend(self.pixel_that_sees(place(part.at(s, t)), last));
            }
        }
        found
    }

    /// No pixel shows anything of a convex part with such corners.
    fn is_outside(&self, corners: [DVec2; 4]) -> bool {
        let low = corners.iter().fold(DVec2::INFINITY, |m, c| m.min(*c));
        let high = corners.iter().fold(DVec2::NEG_INFINITY, |m, c| m.max(*c));
        let size = dvec2(self.size[0].into(), self.size[1].into());
        high.min_element() < 0.0 || low.x >= size.x || low.y >= size.y
    }

    /// The pixel in which a point of an emitter is seen; none if that is `known` of the pixel, or if something hides the point.
    fn pixel_that_sees(&self, point: DVec3, known: Option<u32>) -> Option<u32> {
        let at = self.frame.pixel(point)?;
        let [width, height] = self.size.map(f64::from);
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < width && at.y < height) {
            return None;
        }
        let pixel = at.y as u32 * self.size[0] + at.x as u32;
        let direction = (point - self.frame.origin()).normalize();
        let sees = known != Some(pixel)
            && !self.seen[pixel as usize]
            && meets_emitter(self.visibility, self.emitters, self.frame, direction);
        sees.then_some(pixel)
    }
}

/// The point of a face for (s, t) of the unit square; the lines of equal s of a triangle meet nowhere but at s = 1.
fn place(shape: &FaceFrame, triangle: bool, st: DVec2) -> DVec3 {
    shape.at(if triangle { dvec2(st.x, st.y * (1.0 - st.x)) } else { st })
}
