//! What the tests of several files share: scenes written as files, solves, statistics.
#![allow(dead_code)] // each test file uses its own part

pub mod factor_files;
pub mod program;

use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Once;
use twopass::color::Rgb;
use twopass::embree::Device;
use twopass::emitters::Emitters;
use twopass::pipeline::{self, Pass1, Pass1Result};
use twopass::radiosity::Solution;
use twopass::scene::{Scene, load};
use twopass::visibility::Visibility;

pub type Point = [f64; 3];

/// Largest |t| allowed where standard errors come from 16 independent randomisations: 15 degrees
/// of freedom, exceeded by chance in 0.12 % of comparisons.
pub const T15: f64 = 4.0;
/// Seeds for standard errors of what has none of its own.
pub const SEEDS: u32 = 16;

/// A device; says once which Embree runs.
pub fn device() -> Device {
    static SAID: Once = Once::new();
    let device = Device::new(2).expect("Embree");
    SAID.call_once(|| eprintln!("Embree {}", device.version()));
    device
}

/// A folder beside the repository, or none with a note that the test is skipped.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: ../shared/{name} is not there");
    None
}

/// Entries of an oracle file, if that is there.
pub fn oracle(name: &str) -> Option<Vec<Value>> {
    let text = std::fs::read_to_string(shared(&format!("oracle/{name}"))?).expect("oracle file");
    let document: Value = serde_json::from_str(&text).expect("JSON");
    document["entries"].as_array().cloned()
}

/// The entries of one kind; at least one.
pub fn of_kind<'a>(entries: &'a [Value], kind: &str) -> Vec<&'a Value> {
    let found: Vec<&Value> = entries.iter().filter(|e| e["kind"] == kind).collect();
    assert!(!found.is_empty(), "no {kind} in the oracle");
    found
}

pub fn numbers(v: &Value) -> Vec<f64> {
    match v.as_array() {
        Some(list) => list.iter().map(|x| x.as_f64().expect("number")).collect(),
        None => vec![v.as_f64().expect("number")],
    }
}

pub fn polygon(v: &Value) -> Vec<Point> {
    v.as_array().expect("points").iter().map(|p| numbers(p).try_into().expect("3 numbers")).collect()
}

/// A scene as files.
#[derive(Default)]
pub struct Files {
    vertices: usize,
    obj: String,
    toml: String,
}

impl Files {
    pub fn material(&mut self, name: &str, entries: &str) -> &mut Files {
        let _ = writeln!(self.toml, "[materials.\"{name}\"]\n{entries}");
        self
    }

    /// A diffuse material that emits `e` [W m^-2] from its front.
    pub fn diffuse(&mut self, name: &str, rho: &[f64], e: &[f64]) -> &mut Files {
        let rgb = |v: &[f64], scale: f64| -> Vec<f64> { (0..3).map(|k| v[k % v.len()] * scale).collect() };
        let pi = std::f64::consts::PI;
        self.material(name, &format!("diffuse = {:?}\nemission = {:?}", rgb(rho, 1.0), rgb(e, 1.0 / pi)))
    }

    pub fn polygon(&mut self, object: &str, material: &str, points: &[Point]) -> &mut Files {
        let _ = writeln!(self.obj, "o {object}\nusemtl {material}");
        for [x, y, z] in points {
            let _ = writeln!(self.obj, "v {x:?} {y:?} {z:?}");
        }
        let ids: Vec<String> = (1..=points.len()).map(|k| (self.vertices + k).to_string()).collect();
        let _ = writeln!(self.obj, "f {}", ids.join(" "));
        self.vertices += points.len();
        self
    }

    /// Adds tables of the scene file.
    pub fn toml(&mut self, text: &str) -> &mut Files {
        let _ = writeln!(self.toml, "{text}");
        self
    }

    pub fn load(&self) -> Scene {
        let directory = tempfile::tempdir().expect("temporary directory");
        let write = |name: &str, text: &str| {
            std::fs::write(directory.path().join(name), text).expect("temporary file");
        };
        write("s.obj", &self.obj);
        write("s.toml", &format!("geometry = [\"s.obj\"]\n{}", self.toml));
        load(&directory.path().join("s.toml")).expect("scene")
    }
}

/// Faces x0, x1, y0, y1, z0, z1 of the box [0, size], seen from within (`inside`) or from without.
pub fn box_faces(origin: Point, size: Point, inside: bool) -> Vec<(&'static str, Vec<Point>)> {
    let names = ["x0", "x1", "y0", "y1", "z0", "z1"];
    let face = |k: usize| {
        let (axis, high) = (k / 2, k % 2 == 1);
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |s: f64, t: f64| {
            let mut p = origin;
            p[axis] += if high { size[axis] } else { 0.0 };
            p[a] += s * size[a];
            p[b] += t * size[b];
            p
        };
        // Counter-clockwise seen from +axis.
        let mut points = vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
        if high == inside {
            points.reverse();
        }
        points
    };
    names.iter().enumerate().map(|(k, n)| (*n, face(k))).collect()
}

/// Triangles of a sphere about the origin: an octahedron divided `n` times along each edge. Faces
/// look outwards, or inwards with `inside`.
pub fn sphere(radius: f64, n: usize, inside: bool) -> Vec<Vec<Point>> {
    let mut faces = Vec::new();
    let on = |p: Point| {
        let l = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
        p.map(|x| x / l * radius)
    };
    for octant in 0..8 {
        let sign = [0, 1, 2].map(|k| if octant >> k & 1 == 1 { -1.0 } else { 1.0 });
        let flip = sign[0] * sign[1] * sign[2] < 0.0;
        let at = |i: usize, j: usize| {
            let k = n - i - j;
            on([sign[0] * i as f64, sign[1] * j as f64, sign[2] * k as f64])
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

/// Pass 1 without a camera.
pub fn solve(scene: &Scene, rays: u32, element_size: f64, seed: u32) -> twopass::Result<Pass1Result> {
    let device = device();
    let visibility = Visibility::new(&device, scene)?;
    let settings = Pass1 { rays, element_size: Some(element_size), seed };
    pipeline::solve(&visibility, &Emitters::new(&visibility), &[], &settings, &|_| {}, &mut Vec::new())
}

/// Mean over the area of one side of an object.
pub fn object_mean(scene: &Scene, solution: &Solution, values: &[Rgb], object: &str, front: bool) -> Rgb {
    let (mut sum, mut area) = (Rgb::ZERO, 0.0);
    for (e, value) in values.iter().enumerate() {
        let (face, side, _) = solution.mesh.place(e as u32);
        if side == front && scene.objects[scene.faces[face as usize].object as usize] == object {
            sum += *value * solution.mesh.area(e as u32);
            area += solution.mesh.area(e as u32);
        }
    }
    assert!(area > 0.0, "object {object} has no elements there");
    sum / area
}

/// Mean and its standard error.
pub fn mean_error(samples: &[f64]) -> (f64, f64) {
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / n;
    let spread: f64 = samples.iter().map(|x| (x - mean) * (x - mean)).sum();
    (mean, (spread / (n * (n - 1.0))).sqrt())
}

/// Worst departures of several comparisons with exact values.
#[derive(Debug, Default)]
pub struct Worst {
    pub t: f64,
    pub relative: f64,
    pub count: usize,
}

impl Worst {
    /// Compares independent estimates with the exact value: at most [`T15`] standard errors away, and at
    /// most `relative` of the value. `floor` is the share of the value that rounding may cost.
    #[track_caller]
    pub fn check(&mut self, name: &str, samples: &[f64], exact: f64, relative: f64) {
        assert_eq!(samples.len(), SEEDS as usize);
        let (mean, error) = mean_error(samples);
        // Single-precision factors: a few 1e-7 of the value are rounding, not chance.
        let t = (mean - exact).abs() / (error + 1e-6 * exact.abs());
        let off = if exact == 0.0 { mean.abs() } else { (mean / exact - 1.0).abs() };
        self.t = self.t.max(t);
        self.relative = self.relative.max(off);
        self.count += 1;
        assert!(
            t <= T15 && off <= relative,
            "{name}: {mean:.6} +- {error:.1e}, exact {exact:.6}: {t:.1} standard errors, {:.3} %",
            100.0 * off
        );
    }
}

/// Directly opposed rectangles a x b at distance c (Howell C-11).
pub fn opposed(a: f64, b: f64, c: f64) -> f64 {
    let (x, y) = (a / c, b / c);
    let (x1, y1) = (1.0 + x * x, 1.0 + y * y);
    let terms = 0.5 * (x1 * y1 / (x1 + y1 - 1.0)).ln()
        + x * y1.sqrt() * (x / y1.sqrt()).atan()
        + y * x1.sqrt() * (y / x1.sqrt()).atan()
        - x * x.atan()
        - y * y.atan();
    2.0 / (std::f64::consts::PI * x * y) * terms
}

/// A number in [0, 1) that looks random (SplitMix64).
pub fn noise(k: u64) -> f64 {
    let mut z = (k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
