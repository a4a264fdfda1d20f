//! Small scenes as files: what the cases are made of.

use crate::Result;
use crate::error::Error;
use crate::scene::{Scene, load};
use std::f64::consts::PI;
use std::fmt::Write;

/// A point in the scene file's coordinates.
pub type Point = [f64; 3];

/// A scene file and its geometry as text.
#[derive(Debug, Clone, Default)]
pub struct SceneText {
    vertices: usize,
    obj: String,
    materials: String,
    head: String,
}

impl SceneText {
    /// An empty scene.
    pub fn new() -> SceneText {
        SceneText::default()
    }

    /// Adds top-level keys and tables other than materials; they come first in the file.
    pub fn head(mut self, text: &str) -> SceneText {
        let _ = writeln!(self.head, "{text}");
        self
    }

    /// Adds a material with the entries of its table.
    pub fn material(mut self, name: &str, entries: &str) -> SceneText {
        let _ = writeln!(self.materials, "[materials.\"{name}\"]\n{entries}");
        self
    }

    /// Adds a diffuse grey material that emits `exitance` [W m^-2] from its front.
    pub fn diffuse(self, name: &str, albedo: f64, exitance: f64) -> SceneText {
        let e = exitance / PI;
        self.material(name, &format!("diffuse = {albedo:?}\nemission = {e:?}"))
    }

    /// Adds a polygon.
    pub fn polygon(mut self, object: &str, material: &str, points: &[Point]) -> SceneText {
        self.push(object, material, points);
        self
    }

    /// Adds many polygons of one object.
    pub fn polygons(mut self, object: &str, material: &str, polygons: &[Vec<Point>]) -> SceneText {
        for points in polygons {
            self.push(object, material, points);
        }
        self
    }

    fn push(&mut self, object: &str, material: &str, points: &[Point]) {
        let _ = writeln!(self.obj, "o {object}\nusemtl {material}");
        for [x, y, z] in points {
            let _ = writeln!(self.obj, "v {x:?} {y:?} {z:?}");
        }
        let ids: Vec<String> = (1..=points.len()).map(|k| (self.vertices + k).to_string()).collect();
        let _ = writeln!(self.obj, "f {}", ids.join(" "));
        self.vertices += points.len();
    }

    /// Adds the six sides of a box, each an object `x0` ... `z1` with prefix `name`.
    pub fn cuboid(
        mut self,
        name: &str,
        material: impl Fn(&str) -> String,
        origin: Point,
        size: Point,
        inside: bool,
    ) -> SceneText {
        for (side, points) in box_sides(origin, size, inside) {
            self.push(&format!("{name}{side}"), &material(side), &points);
        }
        self
    }

    /// Moves, turns and scales all points: `p -> move_to + scale * rotation(p)`.
    pub fn transformed(&self, f: impl Fn(Point) -> Point) -> SceneText {
        let mut out = self.clone();
        out.obj.clear();
        for line in self.obj.lines() {
            match line.strip_prefix("v ") {
                Some(rest) => {
                    let mut numbers = rest.split(' ').filter_map(|x| x.parse().ok());
                    let p = [(); 3].map(|()| numbers.next().unwrap_or(0.0));
                    let [x, y, z] = f(p);
                    let _ = writeln!(out.obj, "v {x:?} {y:?} {z:?}");
                }
                None => {
                    let _ = writeln!(out.obj, "{line}");
                }
            }
        }
        out
    }

    /// Loads the scene from a temporary folder.
    ///
    /// # Errors
    /// As [`load`]; the folder cannot be written.
    pub fn load(&self) -> Result<Scene> {
        let folder = tempfile::tempdir().map_err(|e| Error::io("temporary folder", e))?;
        let path = folder.path().join("case.toml");
        let toml = format!("geometry = [\"case.obj\"]\n{}\n{}", self.head, self.materials);
        for (path, text) in [(folder.path().join("case.obj"), &self.obj), (path.clone(), &toml)] {
            std::fs::write(&path, text).map_err(|e| Error::io(&path, e))?;
        }
        load(&path)
    }
}

/// Sides x0, x1, y0, y1, z0, z1 of a box, fronts inwards (`inside`) or outwards.
pub fn box_sides(origin: Point, size: Point, inside: bool) -> Vec<(&'static str, Vec<Point>)> {
    let names = ["x0", "x1", "y0", "y1", "z0", "z1"];
    let side = |k: usize| {
        let (axis, high) = (k / 2, k % 2 == 1);
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |s: f64, t: f64| {
            let mut p = origin;
            p[axis] += if high { size[axis] } else { 0.0 };
            p[a] += s * size[a];
            p[b] += t * size[b];
            p
        };
        // Counter-clockwise seen from the positive axis.
        let mut points = vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
        if high == inside {
            points.reverse();
        }
        points
    };
    names.iter().enumerate().map(|(k, n)| (*n, side(k))).collect()
}

/// A rectangle at height z, seen from above (`up`) or below.
pub fn plate([x0, x1]: [f64; 2], [y0, y1]: [f64; 2], z: f64, up: bool) -> Vec<Point> {
    let mut points = vec![[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]];
    if !up {
        points.reverse();
    }
    points
}

/// Triangles of a sphere about the origin: an octahedron divided `n` times along each edge, 8 n^2 in all. Fronts
/// look outwards, or inwards with `inside`.
pub fn sphere(radius: f64, n: usize, inside: bool) -> Vec<Vec<Point>> {
    let mut faces = Vec::with_capacity(8 * n * n);
    for octant in 0..8 {
        let sign = [0, 1, 2].map(|k| if octant >> k & 1 == 1 { -1.0 } else { 1.0 });
        let flip = sign[0] * sign[1] * sign[2] < 0.0;
        let at = |i: usize, j: usize| {
            let p = [sign[0] * i as f64, sign[1] * j as f64, sign[2] * (n - i - j) as f64];
            let l = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            p.map(|x| x / l * radius)
        };
        let mut add = |mut t: Vec<Point>| {
            if flip != inside {
                t.reverse();
            }
            faces.push(t);
        };
        for i in 0..n {
            for j in 0..n - i {
                add(vec![at(i + 1, j), at(i, j + 1), at(i, j)]);
                if i + j + 1 < n {
                    add(vec![at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
    }
    faces
}

/// A ball about `centre`.
pub fn ball(radius: f64, centre: Point) -> Vec<Vec<Point>> {
    let moved = |p: &Point| [0, 1, 2].map(|k| p[k] + centre[k]);
    sphere(radius, 8, false).iter().map(|t| t.iter().map(moved).collect()).collect()
}

/// A turn by `angle` (in radians) about a unit axis (Rodrigues).
pub fn turned(axis: Point, angle: f64) -> impl Fn(Point) -> Point {
    let (s, c) = angle.sin_cos();
    move |p| {
        let dot = axis[0] * p[0] + axis[1] * p[1] + axis[2] * p[2];
        let cross = [
            axis[1] * p[2] - axis[2] * p[1],
            axis[2] * p[0] - axis[0] * p[2],
            axis[0] * p[1] - axis[1] * p[0],
        ];
        [0, 1, 2].map(|k| p[k] * c + cross[k] * s + axis[k] * dot * (1.0 - c))
    }
}

/// A prism of length `length` over a triangle whose corner at the origin has the angle `degrees`, both of its legs
/// of length 1; closed, seen from within. Objects: `floor` and `roof` meet at that angle.
pub fn wedge_room(degrees: f64, length: f64) -> SceneText {
    let (s, c) = degrees.to_radians().sin_cos();
    let [o, a, b] = [[0.0, 0.0], [1.0, 0.0], [c, s]];
    let at = |p: [f64; 2], y: f64| [p[0], y, p[1]];
    SceneText::new()
        .polygon("floor", "m", &[at(o, 0.0), at(a, 0.0), at(a, length), at(o, length)])
        .polygon("roof", "m", &[at(o, 0.0), at(o, length), at(b, length), at(b, 0.0)])
        .polygon("back", "m", &[at(a, 0.0), at(b, 0.0), at(b, length), at(a, length)])
        .polygon("near", "m", &[at(o, 0.0), at(b, 0.0), at(a, 0.0)])
        .polygon("far", "m", &[at(o, length), at(a, length), at(b, length)])
}
