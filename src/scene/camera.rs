//! Pinhole cameras.

use super::Scene;
use super::document::{Section, nearest};
use super::path::CameraPath;
use crate::error::{Error, Result};
use glam::{DVec2, DVec3, Vec3};

/// Largest width or height of an image in pixels.
const MAX_SIZE: u32 = 65_536;

/// Most pixels of an image: three gigabytes of samples.
const MAX_PIXELS: u64 = 1 << 28;

/// Where the eye is farther from the scene's centre than so many of its radii, its rays start at the scene: single precision would
/// place them worse at the eye.
const FAR: f64 = 4.0;

/// Radius about the scene's centre at which they start then, over that of the scene: outside of all faces as they are rounded.
const AROUND: f64 = 1.001;

pub(super) const KEYS: [&str; 7] = ["name", "origin", "target", "up", "fov", "size", "keyframe"];

/// A pinhole camera as the scene file states it, validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Name for `--camera`.
    pub name: String,
    /// Where the eye is, in the scene file's coordinates and units.
    pub origin: DVec3,
    /// What the middle of the image shows, in the scene file's coordinates and units.
    pub target: DVec3,
    /// Which way is up in the image; neither zero nor along the view.
    pub up: DVec3,
    /// Vertical field of view in degrees, within (0, 180).
    pub fov: f64,
    /// Width and height in pixels, at least 1.
    pub size: [u32; 2],
}

/// A camera placed in a scene: turns image coordinates into view rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraFrame {
    origin: DVec3,
    forward: DVec3,
    /// A pixel's step to the right, on the plane one metre ahead.
    right: DVec3,
    /// A pixel's step down, on the same plane.
    down: DVec3,
    half: [f64; 2],
    /// Radius of the sphere about the scene's centre at which rays start \[m\]; none: at the eye.
    start: Option<f64>,
}

/// Whether an image of that many pixels across and down can be made.
pub fn within_size([width, height]: [u32; 2]) -> bool {
    let side = 1..=MAX_SIZE;
    side.contains(&width) && side.contains(&height) && u64::from(width) * u64::from(height) <= MAX_PIXELS
}

impl Camera {
    /// Reads `[camera]` and its keyframes; `index` (from 0) names a camera that has no name when there are several.
    /// What the camera itself leaves out of origin and target is the first keyframe's.
    pub(super) fn read(
        mut section: Section<'_>,
        index: Option<usize>,
        warnings: &mut Vec<String>,
    ) -> Result<(Camera, Option<CameraPath>)> {
        let name = match section.get("name") {
            Some(entry) => entry.text()?.to_string(),
            None => index.map_or("camera".into(), |i| (i + 1).to_string()),
        };
        section.label = format!("camera \"{name}\"");
        section.warn_unknown(&KEYS, warnings);
        let keyframes = section.get("keyframe").map_or(Ok(Vec::new()), |e| e.sections())?;
        let required = |key: &str| {
            let first = keyframes.first().and_then(|k| k.get(key));
            let missing = || section.missing(key, &KEYS, &format!("add {key} = [x, y, z]"));
            section.get(key).or(first).ok_or_else(missing)?.vector()
        };
        let camera = Camera {
            origin: required("origin")?,
            target: required("target")?,
            up: section.get("up").map_or(Ok(DVec3::Y), |e| e.vector())?,
            fov: section.get("fov").map_or(Ok(45.0), |e| e.field_of_view())?,
            size: section.get("size").map_or(Ok([512, 512]), |e| match e.size(MAX_SIZE)? {
                size if within_size(size) => Ok(size),
                [w, h] => Err(e.error(format!("must make at most {MAX_PIXELS} pixels, is {w} x {h}"))),
            })?,
            name,
        };
        camera.check().map_err(|what| section.error(what))?;
        let path = if section.get("keyframe").is_some() {
            Some(CameraPath::read(&camera, &section, keyframes, warnings)?)
        } else {
            None
        };
        Ok((camera, path))
    }

    /// Whether it can be looked through; otherwise what is wrong.
    pub(super) fn check(&self) -> std::result::Result<(), &'static str> {
        let view = (self.target - self.origin).try_normalize();
        let view = view.ok_or("origin and target are the same point, or too far apart")?;
        let up =
            self.up.try_normalize().ok_or("up must not be zero, nor too long or short to be measured")?;
        if view.cross(up).length() < 1e-6 {
            return Err("looks along its up vector; choose another up");
        }
        Ok(())
    }

    /// Places the camera in the scene's metres.
    pub fn frame(&self, scene: &Scene) -> CameraFrame {
        let forward = (self.target - self.origin).normalize_or(DVec3::NEG_Z);
        let right = forward.cross(self.up.normalize_or(DVec3::Y)).normalize_or(DVec3::X);
        let [width, height] = self.size.map(f64::from);
        let pixel = 2.0 * (0.5 * self.fov.to_radians()).tan() / height;
        let origin = self.origin * scene.unit - scene.center;
        CameraFrame {
            origin,
            forward,
            right: right * pixel,
            down: forward.cross(right) * pixel,
            half: [0.5 * width, 0.5 * height],
            start: (origin.length() > FAR * scene.radius).then_some(AROUND * scene.radius),
        }
    }
}

impl CameraFrame {
    /// The eye in metres, relative to the scene's centre.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Unit direction through continuous pixel coordinates: x to the right, y down, pixel (0, 0)
    /// covers [0, 1)^2 in the image's top left corner.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        let on_plane = self.forward + (x - self.half[0]) * self.right + (y - self.half[1]) * self.down;
        on_plane.normalize()
    }

    /// Continuous pixel coordinates at which a point [m, relative to the scene's centre] is seen; none behind the eye.
    pub fn pixel(&self, point: DVec3) -> Option<DVec2> {
        let from_eye = point - self.origin;
        let depth = from_eye.dot(self.forward);
        let across = |step: DVec3| from_eye.dot(step) / (depth * step.length_squared());
        let half = DVec2::from(self.half);
        (depth > 0.0).then(|| half + DVec2::new(across(self.right), across(self.down)))
    }

    /// The ray through continuous pixel coordinates: where it starts in single precision [m, relative to the scene's centre], and its
    /// unit direction. An eye far outside of the scene is not where its rays start: lengths along them are not those from the eye.
    #[inline]
    pub fn ray(&self, x: f64, y: f64) -> (Vec3, DVec3) {
        let direction = self.direction(x, y);
        (self.start(direction), direction)
    }

    /// Where a ray from the eye in a unit direction starts.
    #[inline]
    pub fn start(&self, direction: DVec3) -> Vec3 {
        let ahead = -self.origin.dot(direction);
        match self.start {
            Some(radius) if ahead > 0.0 => {
                // From the point nearest to the centre: the way from the eye is the longer, and the less exact.
                let nearest = self.origin + ahead * direction;
                let back = (radius * radius - nearest.length_squared()).max(0.0).sqrt();
                (nearest - back * direction).as_vec3()
            }
            _ => self.origin.as_vec3(),
        }
    }
}

impl Scene {
    /// The camera of that name, or the first.
    ///
    /// # Errors
    /// The scene has no camera, or none of that name.
    pub fn camera(&self, name: Option<&str>) -> Result<&Camera> {
        let what = || format!("scene {}", self.path.display());
        let Some(first) = self.cameras.first() else {
            let help = "has no camera; add to a scene file: [camera] with origin, target, up, fov and size";
            return Err(Error::scene(what(), help));
        };
        let Some(name) = name else { return Ok(first) };
        self.cameras.iter().find(|c| c.name == name).ok_or_else(|| {
            let names: Vec<_> = self.cameras.iter().map(|c| c.name.as_str()).collect();
            let hint = match nearest(name, names.iter().copied()) {
                Some(near) => format!("did you mean \"{near}\"? "),
                None => String::new(),
            };
            let message = format!("has no camera \"{name}\"; {hint}it has: {}", names.join(", "));
            Error::scene(what(), message)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn scene() -> Scene {
        let file = tempfile::Builder::new().suffix(".obj").tempfile().unwrap();
        std::fs::write(file.path(), "v 10 0 0\nv 12 0 0\nv 12 2 0\nv 10 2 0\nf 1 2 3 4\n").unwrap();
        super::super::load(file.path()).unwrap()
    }

    fn camera(fov: f64, size: [u32; 2]) -> Camera {
        let (origin, target) = (dvec3(11.0, 1.0, 5.0), dvec3(11.0, 1.0, 0.0));
        Camera { name: "c".into(), origin, target, up: dvec3(0.0, 2.0, 0.5), fov, size }
    }

    #[test]
    fn the_middle_of_the_image_shows_the_target() {
        let frame = camera(60.0, [640, 480]).frame(&scene());
        assert_eq!(frame.origin(), dvec3(0.0, 0.0, 5.0));
        assert!(frame.direction(320.0, 240.0).distance(DVec3::NEG_Z) < 1e-15);
    }

    #[test]
    fn image_axes_and_field_of_view() {
        let frame = camera(90.0, [200, 100]).frame(&scene());
        // Half of the vertical field is 45 degrees; the image is twice as wide as high.
        assert!(frame.direction(100.0, 0.0).distance(dvec3(0.0, 1.0, -1.0).normalize()) < 1e-15);
        assert!(frame.direction(100.0, 100.0).distance(dvec3(0.0, -1.0, -1.0).normalize()) < 1e-15);
        assert!(frame.direction(200.0, 50.0).distance(dvec3(2.0, 0.0, -1.0).normalize()) < 1e-15);
        assert!(frame.direction(0.0, 0.0).distance(dvec3(-2.0, 1.0, -1.0).normalize()) < 1e-15);
    }

    #[test]
    fn the_unit_scales_the_eye() {
        let mut scene = scene();
        scene.unit = 0.5;
        scene.center *= 0.5;
        assert_eq!(camera(60.0, [8, 8]).frame(&scene).origin(), dvec3(0.0, 0.0, 2.5));
    }

    /// Rays of a near eye start there, to the bit. Those of a far one meet the points that they are sent to as nearly as single
    /// precision tells points of the scene apart; from the eye itself they would miss them by up to 30 m.
    #[test]
    fn rays_of_far_eyes_start_at_the_scene() {
        let scene = scene();
        let frame = camera(60.0, [8, 8]).frame(&scene);
        assert_eq!(frame.ray(1.25, 2.5), (frame.origin().as_vec3(), frame.direction(1.25, 2.5)));
        for distance in [10.0, 1e3, 1e6, 1e9] {
            let away = dvec3(0.3, -0.5, 1.0).normalize() * distance;
            let far = Camera {
                origin: dvec3(11.0, 1.0, 0.0) + away,
                fov: 114.0 / distance,
                ..camera(60.0, [8, 8])
            };
            let frame = far.frame(&scene);
            for point in [dvec3(0.9, -0.7, 0.0), dvec3(-0.3, 0.2, 0.0), DVec3::ZERO] {
                let at = frame.pixel(point).expect("ahead");
                let (start, direction) = frame.ray(at.x, at.y);
                assert!(start.length() < 2.0, "{distance}: {start}");
                let (start, direction) = (start.as_dvec3(), direction.as_vec3().as_dvec3());
                let hit = start - start.z / direction.z * direction;
                let off = hit.distance(point);
                assert!(off < 1e-6 + 1e-15 * distance, "{distance}: {off:e}");
            }
        }
        // Away from the scene: nothing is ahead, and rays start at the eye.
        let behind = Camera {
            target: dvec3(11.0, 1.0, 200.0),
            origin: dvec3(11.0, 1.0, 100.0),
            ..camera(60.0, [8, 8])
        };
        let frame = behind.frame(&scene);
        assert_eq!(frame.ray(4.0, 4.0).0, frame.origin().as_vec3());
        assert_eq!(frame.pixel(DVec3::ZERO), None);
    }
}
