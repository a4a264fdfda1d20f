//! Lamps, surfaces and cameras inside of glass: their medium's index is the product of those of all bodies about them.
//!
//! Seeds are fixed; a right program leaves four standard errors, with 15 degrees of freedom, in 0.12 % of comparisons.

mod common;

use common::*;
use std::f64::consts::PI;
use twopass::emitters::Emitters;
use twopass::pipeline::{self, Pass1};
use twopass::render::{Estimator, Method, Quality, Settings, render, render_directional};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

const GLASS: &str = "diffuse = 0\nspecular_transmission = 1\nior";
const METHODS: [Method; 4] =
    [Method::Whitted, Method::Path, Method::TwoPass(Quality::Gather), Method::Radiosity];

/// Mean of a picture by each seed, of the scene's first camera; no diffuse light is asked for.
fn means(scene: &Scene, method: Method, spp: u32) -> Vec<f64> {
    let device = device();
    let visibility = Visibility::new(&device, scene).expect("tree");
    let emitters = Emitters::new(&visibility);
    let of_seed = |seed| {
        let estimator = Estimator::Lobe(4);
        let settings = Settings { method, spp, gather_rays: 4, emitter_samples: 4, estimator, seed };
        let camera = &scene.cameras[0];
        let image = render(&visibility, &emitters, None, camera, &settings, &|_| {}).0;
        image.data.iter().map(|v| f64::from(*v)).sum::<f64>() / image.data.len() as f64
    };
    (0..SEEDS).map(of_seed).collect()
}

fn plate(files: &mut Files, material: &str, half: f64, z: f64, up: bool) {
    let mut points = vec![[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]];
    if !up {
        points.reverse();
    }
    files.polygon(material, material, &points);
}

/// A box of some material about the origin.
fn body(files: &mut Files, material: &str, half: f64, inwards: bool) {
    for (name, points) in box_faces([-half; 3], [2.0 * half; 3], inwards) {
        files.polygon(&format!("{material}-{name}"), material, &points);
    }
}

fn camera(files: &mut Files, z: f64) {
    let view = "target = [0, 0, 0]\nup = [0, 1, 0]\nfov = 0.1\nsize = [4, 4]";
    files.toml(&format!("[camera]\norigin = [0, 0, {z:?}]\n{view}"));
}

/// Black lamps of radiance 1 in bodies within bodies, seen from outside at normal incidence. Of two surfaces with transmittances T1 and
/// T2 and nothing bright but what is behind them, T1 T2 / (1 - R1 R2) comes through, and `1 / n^2` of that leaves, where n is the index
/// at the lamp. The innermost body is stated by its index in relation to the one about it; a cavity also as a body with its normals
/// turned into it. 3 x 4 comparisons (1.4 % chance of any by chance).
#[test]
fn lamps_in_bodies_within_bodies() {
    let reflectance = |n: f64| ((n - 1.0) / (n + 1.0)).powi(2);
    for (name, inner, inwards, index) in [
        ("glass", 1.2, false, 1.8),
        ("air", 1.0 / 1.5, false, 1.0),
        ("cavity", 1.5, true, 1.0),
        ("bubble", 0.5, false, 0.75),
    ] {
        let mut files = Files::default();
        files.material("outer", &format!("{GLASS} = 1.5")).material("inner", &format!("{GLASS} = {inner}"));
        files.diffuse("light", &[0.0], &[PI]);
        body(&mut files, "outer", 0.8, false);
        body(&mut files, "inner", 0.5, inwards);
        plate(&mut files, "light", 0.2, 0.0, true);
        camera(&mut files, 4.0);
        let scene = files.load();
        let (r1, r2) = (reflectance(1.5), reflectance(inner));
        let exact = (1.0 - r1) * (1.0 - r2) / (1.0 - r1 * r2) / (index * index);
        for method in &METHODS[..3] {
            let (m, e) = mean_error(&means(&scene, *method, 16));
            eprintln!("{name}, {method:?}: {m:.5} +- {e:.5}, exact {exact:.5}");
            assert!((m - exact).abs() <= T15 * e + 1e-4, "{name}, {method:?}: {m} {exact}");
        }
    }
}

/// In a room a window of a single sheet that is not said to be thin, or glass whose normals point into it, is seen from a lamp by a few
/// rays of many: the lamp lies in the room all the same, and so does the camera that looks at it.
#[test]
fn glass_that_is_no_body_dims_no_lamp() {
    for (name, half) in [("window", 0.0), ("small", 0.15), ("large", 0.3), ("larger", 0.4)] {
        let mut files = Files::default();
        files.material("glass", &format!("{GLASS} = 1.5"));
        files.diffuse("light", &[0.0], &[PI]).diffuse("white", &[0.7], &[0.0]);
        for (wall, points) in box_faces([-1.0; 3], [2.0; 3], true) {
            let is_window = name == "window" && wall == "x0";
            if is_window {
                // Its front is outside.
                let points: Vec<Point> = points.into_iter().rev().collect();
                files.polygon("glass", "glass", &points);
            } else {
                files.polygon(wall, "white", &points);
            }
        }
        if half > 0.0 {
            body(&mut files, "glass", half, true);
        }
        plate(&mut files, "light", 0.25, -0.97, true);
        let view = "target = [0, 0, -0.97]\nfov = 8\nsize = [2, 2]";
        files.toml(&format!("[camera]\norigin = [0.0, 0.9, 0.0]\n{view}"));
        let scene = files.load();
        for method in [Method::Path, Method::Whitted] {
            for m in means(&scene, method, 1) {
                assert!((m - 1.0).abs() < 1e-6, "{name}, {method:?}: {m}");
            }
        }
    }
}

/// Emitted = absorbed + escaped where a white body lies in glass, in glass in glass, or in air in glass, and the same where it is the
/// glass that is inside which reflects diffusely. 3 x 5 comparisons within four standard errors of the residual (1.8 % chance of any by
/// chance), and no warning about the balance.
#[test]
fn ledger_with_bodies_within_bodies() {
    let cases = [
        (1.3, "", true),
        (1.0 / 1.5, "", true),
        (1.3, "diffuse = 0.2", false),
        (1.3, "diffuse = 0.2", true),
        (1.0 / 1.5, "diffuse = 0.1", true),
    ];
    for (k, (inner, diffuse, stone)) in cases.into_iter().enumerate() {
        let mut files = Files::default();
        let through = if diffuse.is_empty() { 1.0 } else { 0.7 };
        let entries = format!("{diffuse}\nspecular_transmission = {through}\nior = {inner}");
        files.material("outer", &format!("{GLASS} = 1.5")).material("inner", &entries);
        files.diffuse("white", &[0.8, 0.6, 0.4], &[0.0]).diffuse("light", &[0.0], &[5.0]);
        for (wall, points) in box_faces([-1.0; 3], [2.0; 3], true) {
            files.polygon(wall, "white", &points);
        }
        body(&mut files, "outer", 0.7, false);
        body(&mut files, "inner", 0.55, false);
        if stone {
            body(&mut files, "white", 0.35, false);
        }
        plate(&mut files, "light", 0.25, 0.95, false);
        let found = solve(&files.load(), 512, 0.25, 4 + k as u32).expect("solution");
        let (off, error) = (found.solution.ledger.residual, found.solution.ledger.residual_error);
        eprintln!("{k}: residual {off:.5}, standard error {error:.5}");
        for c in 0..3 {
            assert!(off[c].abs() <= T15 * error[c] && error[c] < 4e-3, "{k}: {off} +- {error}");
        }
        assert!(!found.warnings.iter().any(|w| w.contains("balance")), "{:?}", found.warnings);
    }
}

/// A camera inside of glass of index n sees a lamp in the same glass as it is, and one outside as `n^2 (1 - F) / (1 - F^2)` of that, with
/// the light that goes to and fro in the glass; by every method. 7 comparisons (0.8 % chance of any by chance).
#[test]
fn cameras_in_glass_see_radiance() {
    for (name, lamp_z, exact) in [("inside", -0.5, 1.0), ("outside", -1.5, 2.25 * 0.96 / (1.0 - 0.0016))] {
        let mut files = Files::default();
        files.material("glass", &format!("{GLASS} = 1.5"));
        files.diffuse("light", &[0.0], &[PI]).diffuse("grey", &[0.5], &[0.0]);
        body(&mut files, "glass", 1.0, false);
        plate(&mut files, "light", 0.2, lamp_z, true);
        plate(&mut files, "grey", 0.2, -3.0, false);
        camera(&mut files, 0.5);
        let scene = files.load();
        // Pass 1 alone takes no account of what glass shows.
        let methods = if name == "inside" { &METHODS[..] } else { &METHODS[..3] };
        for method in methods {
            let (m, e) = mean_error(&means(&scene, *method, 16));
            eprintln!("{name}, {method:?}: {m:.5} +- {e:.5}, exact {exact:.5}");
            assert!((m - exact).abs() <= T15 * e + 1e-4, "{name}, {method:?}: {m} {exact}");
        }
        let device = device();
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let emitters = Emitters::new(&visibility);
        let what = (&Pass1 { rays: 256, element_size: Some(0.5), seed: 0 }, 64);
        let cameras = &scene.cameras;
        let solve =
            pipeline::solve_directional(&visibility, &emitters, cameras, what, &|_| {}, &mut Vec::new());
        if name == "inside" {
            let solution = solve.expect("solution");
            let image = render_directional(&visibility, &emitters, &solution, &cameras[0], (1, 0), &|_| {}).0;
            assert!(image.data.iter().all(|v| (v - 1.0).abs() < 1e-6), "{:?}", image.data);
        }
    }
}

/// A basin with opaque walls, filled with water that has a surface alone, in a room that shines: a camera beside it is in air and
/// sees the walls' radiance of 1, though rays that go through the basin's sides leave water above.
#[test]
fn cameras_beside_a_basin_are_in_air() {
    for (origin, target) in [([1.6, 0.2, 0.5], [2.0, 2.0, 0.4]), ([1.6, 0.2, 0.8], [2.0, 2.0, 2.0])] {
        let mut files = Files::default();
        files.diffuse("wall", &[0.0], &[PI]).diffuse("side", &[0.5], &[0.0]);
        files.material("water", &format!("{GLASS} = 1.33"));
        for (name, points) in box_faces([-2.0, -2.0, 0.0], [4.0, 4.0, 3.0], true) {
            files.polygon(name, "wall", &points);
        }
        for (name, points) in box_faces([-0.8, -0.8, 0.0], [1.6, 1.6, 1.0], false).into_iter().take(4) {
            files.polygon(&format!("side-{name}"), "side", &points);
        }
        let surface = [[-0.8, -0.8, 0.9], [0.8, -0.8, 0.9], [0.8, 0.8, 0.9], [-0.8, 0.8, 0.9]];
        files.polygon("water", "water", &surface);
        let view = "up = [0, 0, 1]\nfov = 20\nsize = [4, 4]";
        files.toml(&format!("[camera]\norigin = {origin:?}\ntarget = {target:?}\n{view}"));
        let seen = means(&files.load(), Method::Whitted, 4);
        assert!(seen.iter().all(|mean| (mean - 1.0).abs() < 1e-5), "{origin:?}: {seen:?}");
    }
}
