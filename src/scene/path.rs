//! Cameras that move: keyframes, and the views between them.
//!
//! Origin, target, up and field of view each follow a cubic Hermite curve over time, one piece from keyframe to
//! keyframe. Its velocity at a keyframe has the direction that the centripetal Catmull-Rom curve has there (half-way
//! between the chords' directions; Yuksel, Schaefer and Keyser 2011) and, on a straight line, the harmonic mean of the
//! mean speeds before and after (Fritsch and Butland 1984). So velocity is continuous in time, a steady motion stays steady
//! however the keyframes are spaced, what rests between two keyframes does rest, and a number never leaves the range of
//! the keyframes beside it.

use super::Scene;
use super::camera::Camera;
use super::document::{Entry, Section};
use crate::error::{Error, Result};
use glam::DVec3;
use std::ops::RangeInclusive;

/// Largest number of a frame.
pub const LAST_FRAME: u32 = 1_000_000;

/// Views along a path that stand for it where pass 1 asks what a camera can see.
const VIEW_POINTS: u32 = 8;

pub(super) const KEYS: [&str; 5] = ["frame", "origin", "target", "up", "fov"];

/// What a keyframe sets, or the velocity of all that by frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct View {
    origin: DVec3,
    target: DVec3,
    up: DVec3,
    /// The field of view in degrees, in x.
    fov: DVec3,
}

/// A camera's way through its keyframes, validated: every frame of it can be looked through.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath {
    camera: Camera,
    /// Frames in rising order, with the view and its velocity.
    keyframes: Vec<(u32, View, View)>,
}

impl CameraPath {
    /// Reads `[[camera.keyframe]]`: what a keyframe leaves out is the camera's own.
    pub(super) fn read(
        camera: &Camera,
        section: &Section<'_>,
        keyframes: Vec<Section<'_>>,
        warnings: &mut Vec<String>,
    ) -> Result<CameraPath> {
        let mut views: Vec<(u32, View)> = Vec::with_capacity(keyframes.len());
        for mut keyframe in keyframes {
            keyframe.label = format!("{}, keyframe", section.label);
            keyframe.warn_unknown(&KEYS, warnings);
            let entry = keyframe.get("frame");
            let entry = entry.ok_or_else(|| keyframe.missing("frame", &KEYS, "add frame = NUMBER"))?;
            let frame = entry.count_from(0, LAST_FRAME)?;
            if let Some((last, _)) = views.last().filter(|(last, _)| frame <= *last) {
                let message =
                    format!("must be greater than that of the keyframe before ({last}), is {frame}");
                return Err(entry.error(message));
            }
            let vector = |key: &str, other: DVec3| keyframe.get(key).map_or(Ok(other), |e: Entry| e.vector());
            let view = View {
                origin: vector("origin", camera.origin)?,
                target: vector("target", camera.target)?,
                up: vector("up", camera.up)?,
                fov: DVec3::X * keyframe.get("fov").map_or(Ok(camera.fov), |e| e.field_of_view())?,
            };
            views.push((frame, view));
        }
        if views.is_empty() {
            return Err(section
                .error("keyframe is an empty list; add [[camera.keyframe]] with frame, origin and target"));
        }
        let path = CameraPath::new(camera, &views);
        for frame in path.frames() {
            let what = |what: &str| section.error(format!("in frame {frame}: {what}"));
            path.at(frame).check().map_err(what)?;
        }
        Ok(path)
    }

    fn new(camera: &Camera, views: &[(u32, View)]) -> CameraPath {
        let velocity = |part: fn(&View) -> DVec3| {
            let points: Vec<(f64, DVec3)> = views.iter().map(|(f, v)| (f64::from(*f), part(v))).collect();
            velocities(&points)
        };
        let (origin, target, up, fov) =
            (velocity(|v| v.origin), velocity(|v| v.target), velocity(|v| v.up), velocity(|v| v.fov));
        let keyframes = views.iter().enumerate().map(|(k, (frame, view))| {
            (*frame, *view, View { origin: origin[k], target: target[k], up: up[k], fov: fov[k] })
        });
        CameraPath { camera: camera.clone(), keyframes: keyframes.collect() }
    }

    /// Name of the camera that moves.
    pub fn name(&self) -> &str {
        &self.camera.name
    }

    /// From the first keyframe to the last.
    pub fn frames(&self) -> RangeInclusive<u32> {
        let end = |k: usize| self.keyframes.get(k).map_or(0, |k| k.0);
        end(0)..=end(self.keyframes.len().saturating_sub(1))
    }

    /// The camera in a frame; before the first keyframe and after the last it rests.
    pub fn at(&self, frame: u32) -> Camera {
        let next = self.keyframes.partition_point(|k| k.0 < frame).min(self.keyframes.len() - 1);
        let (end, to, _) = &self.keyframes[next];
        let view = if next == 0 || *end <= frame {
            *to
        } else {
            between(&self.keyframes[next - 1], &self.keyframes[next], f64::from(frame))
        };
        Camera {
            origin: view.origin,
            target: view.target,
            up: view.up,
            fov: view.fov.x,
            ..self.camera.clone()
        }
    }

    /// The frames that stand for the path, whichever are rendered: first and last, and some evenly between.
    fn view_points(&self) -> impl Iterator<Item = Camera> + '_ {
        let (first, last) = self.frames().into_inner();
        let steps = (last - first).min(VIEW_POINTS - 1);
        (0..=steps).map(move |k| {
            self.at(first + (u64::from(last - first) * u64::from(k) / u64::from(steps.max(1))) as u32)
        })
    }
}

/// The view at time `t` between two keyframes.
fn between(a: &(u32, View, View), b: &(u32, View, View), t: f64) -> View {
    let (start, end) = (f64::from(a.0), f64::from(b.0));
    let span = end - start;
    let s = (t - start) / span;
    let curve = |p: DVec3, v: DVec3, q: DVec3, w: DVec3| {
        // Hermite's cubic, as its distance from p: a curve that rests stays exactly there.
        let d = q - p;
        p + s * s * (3.0 - 2.0 * s) * d + span * s * (1.0 - s) * ((1.0 - s) * v - s * w)
    };
    View {
        origin: curve(a.1.origin, a.2.origin, b.1.origin, b.2.origin),
        target: curve(a.1.target, a.2.target, b.1.target, b.2.target),
        up: curve(a.1.up, a.2.up, b.1.up, b.2.up),
        fov: curve(a.1.fov, a.2.fov, b.1.fov, b.2.fov),
    }
}

/// Velocities at the points of a curve, each with its time (the module's description says which).
fn velocities(points: &[(f64, DVec3)]) -> Vec<DVec3> {
    let chords: Vec<DVec3> = points.windows(2).map(|w| (w[1].1 - w[0].1) / (w[1].0 - w[0].0)).collect();
    let inner = |k: usize| {
        let (a, b) = (chords[k - 1], chords[k]);
        let (speed_a, speed_b) = (a.length(), b.length());
        let product = speed_a * speed_b;
        if product > 0.0 { (a * speed_b + b * speed_a) / (speed_a + speed_b) } else { DVec3::ZERO }
    };
    // At the ends the curve is a parabola: no acceleration changes there.
    let end = |chord: DVec3, inner: DVec3| 1.5 * chord - 0.5 * inner;
    let n = points.len();
    (0..n)
        .map(|k| match (k, n) {
            (_, 1) => DVec3::ZERO,
            (_, 2) => chords[0],
            (0, _) => end(chords[0], inner(1)),
            (k, n) if k + 1 == n => end(chords[n - 2], inner(n - 2)),
            (k, _) => inner(k),
        })
        .collect()
}

impl Scene {
    /// The path of the camera of that name, or of the first.
    ///
    /// # Errors
    /// There is no such camera, or it has no keyframes.
    pub fn path(&self, name: Option<&str>) -> Result<&CameraPath> {
        let camera = self.camera(name)?;
        self.paths.iter().find(|p| p.name() == camera.name).ok_or_else(|| {
            let help = "has no keyframes; add [[camera.keyframe]] with frame, origin and target, one for each view on its way";
            Error::scene(format!("{}: camera \"{}\"", self.path.display(), camera.name), help)
        })
    }

    /// Every view that pass 1 considers, whichever of them is rendered: all cameras, and views along their paths.
    pub fn view_points(&self) -> Vec<Camera> {
        let moving = self.paths.iter().flat_map(CameraPath::view_points);
        self.cameras.iter().cloned().chain(moving).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn path(points: &[(u32, DVec3)]) -> CameraPath {
        let camera = Camera {
            name: "c".into(),
            origin: DVec3::ZERO,
            target: DVec3::Z,
            up: DVec3::Y,
            fov: 40.0,
            size: [8, 8],
        };
        let view = |origin: DVec3| View {
            origin,
            target: origin + DVec3::Z,
            up: DVec3::Y,
            fov: DVec3::X * (40.0 + origin.x),
        };
        let views: Vec<(u32, View)> = points.iter().map(|&(frame, origin)| (frame, view(origin))).collect();
        CameraPath::new(&camera, &views)
    }

    /// Where the curve is at a time between frames.
    fn origin(path: &CameraPath, t: f64) -> DVec3 {
        let next = path.keyframes.partition_point(|k| f64::from(k.0) < t).clamp(1, path.keyframes.len() - 1);
        between(&path.keyframes[next - 1], &path.keyframes[next], t).origin
    }

    const BENDS: [(u32, DVec3); 5] = [
        (0, DVec3::ZERO),
        (10, dvec3(3.0, 0.0, 0.0)),
        (12, dvec3(3.0, 2.0, 0.5)),
        (40, dvec3(-1.0, 2.0, 4.0)),
        (41, dvec3(-1.5, 2.0, 4.0)),
    ];

    #[test]
    fn goes_through_its_keyframes_exactly() {
        let path = path(&BENDS);
        for (frame, point) in BENDS {
            assert_eq!((path.at(frame).origin, path.at(frame).fov), (point, 40.0 + point.x));
        }
        assert_eq!((path.at(50).origin, path.frames()), (BENDS[4].1, 0..=41));
    }

    /// One-sided differences over 1e-5 frames on both sides of each keyframe: their error is 1e-5 accelerations.
    #[test]
    fn velocity_is_continuous() {
        let path = path(&BENDS);
        for (frame, _) in &BENDS[1..4] {
            let (t, h) = (f64::from(*frame), 1e-5);
            let before = (origin(&path, t) - origin(&path, t - h)) / h;
            let after = (origin(&path, t + h) - origin(&path, t)) / h;
            assert!((before - after).length() < 1e-3, "{frame}: {before} {after}");
            assert!(before.length() > 0.1, "{before}");
        }
    }

    #[test]
    fn steady_motion_stays_steady_and_rest_rests() {
        let v = dvec3(0.5, -0.25, 0.125);
        let steady = path(&[0, 3, 4, 50, 100].map(|f| (f, f64::from(f) * v)));
        for t in 0..1000 {
            let t = f64::from(t) * 0.1;
            assert!((origin(&steady, t) - t * v).length() < 1e-12, "{t}");
        }
        let b = dvec3(4.0, 1.0, 2.0);
        let resting = path(&[(0, DVec3::ZERO), (10, b), (30, b), (31, 3.0 * b)]);
        assert!((10..=30).all(|f| resting.at(f).origin == b));
    }

    /// A number stays between the keyframes beside it.
    #[test]
    fn a_number_does_not_overshoot() {
        let path = path(
            &[0.0, 1.0, 1.1, 9.0, 8.9, 8.9, 0.0]
                .iter()
                .enumerate()
                .map(|(k, x)| (10 * k as u32, DVec3::X * *x))
                .collect::<Vec<_>>(),
        );
        for pair in path.keyframes.windows(2) {
            let (low, high) = (pair[0].1.fov.x.min(pair[1].1.fov.x), pair[0].1.fov.x.max(pair[1].1.fov.x));
            for frame in pair[0].0..=pair[1].0 {
                let fov = path.at(frame).fov;
                assert!((low - 1e-12..=high + 1e-12).contains(&fov), "{frame}: {fov}");
            }
        }
    }

    #[test]
    fn views_that_stand_for_a_path() {
        let all =
            |points: &[(u32, DVec3)]| path(points).view_points().map(|c| c.origin.x).collect::<Vec<_>>();
        assert_eq!(all(&[(5, DVec3::X)]), [1.0]);
        assert_eq!(all(&[(5, DVec3::ZERO), (8, 3.0 * DVec3::X)]), [0.0, 1.0, 2.0, 3.0]);
        let long = all(&[(0, DVec3::ZERO), (700, 7.0 * DVec3::X)]);
        assert_eq!((long.len(), long[0], long[7]), (8, 0.0, 7.0));
    }
}
