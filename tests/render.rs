//! Pass 2 against exact radiances and against the other methods.
//!
//! Images are repeated with 16 seeds, for pass 1 and pass 2 alike; the spread gives standard errors
//! with 15 degrees of freedom, so a right program leaves four of them in 0.12 % of comparisons.

mod common;

use common::*;
use rayon::ThreadPoolBuilder;
use std::f64::consts::PI;
use twopass::emitters::Emitters;
use twopass::image::Image;
use twopass::pipeline::{self, Pass1};
use twopass::render::{Estimator, Method, Quality, Settings, render};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

const MESH: Method = Method::TwoPass(Quality::Mesh);
const DIRECT: Method = Method::TwoPass(Quality::Direct);
const GATHER: Method = Method::TwoPass(Quality::Gather);

/// Both passes with one seed.
fn picture(scene: &Scene, camera: &str, pass1: (u32, f64), settings: &Settings) -> Image {
    let device = device();
    let visibility = Visibility::new(&device, scene).expect("tree");
    let emitters = Emitters::new(scene);
    let camera = scene.camera(Some(camera)).expect("camera");
    let solution = matches!(settings.method, Method::TwoPass(_) | Method::Radiosity).then(|| {
        let pass1 = Pass1 { rays: pass1.0, element_size: Some(pass1.1), seed: settings.seed };
        let cameras = &scene.cameras;
        pipeline::solve(&visibility, &emitters, cameras, &pass1, &|_| {}, &mut Vec::new())
            .expect("solution")
            .solution
    });
    render(&visibility, &emitters, solution.as_ref(), camera, settings, &|_| {}).0
}

fn settings(method: Method, spp: u32) -> Settings {
    Settings { method, spp, gather_rays: 32, emitter_samples: 4, estimator: Estimator::Lobe(4), seed: 0 }
}

fn pictures(scene: &Scene, camera: &str, pass1: (u32, f64), settings: &Settings) -> Vec<Image> {
    (0..SEEDS).map(|seed| picture(scene, camera, pass1, &Settings { seed, ..*settings })).collect()
}

/// Mean of all pixels and channels.
fn mean(image: &Image) -> f64 {
    image.data.iter().map(|v| f64::from(*v)).sum::<f64>() / image.data.len() as f64
}

fn means(images: &[Image]) -> Vec<f64> {
    images.iter().map(mean).collect()
}

fn camera(name: &str, origin: Point, target: Point, up: Point, fov: f64, size: u32) -> String {
    format!(
        "[[camera]]\nname = \"{name}\"\norigin = {origin:?}\ntarget = {target:?}\nup = {up:?}\nfov = {fov:?}\n\
         size = [{size}, {size}]"
    )
}

/// A closed box with E = 1 and rho = 0.5 on all walls: radiance 2/pi wherever one looks.
///
/// 16 seeds of 16 x 16 pixels. The mean is within four standard errors and 0.2 %; of the 256
/// pixels at most 3 (expected 0.3; more by chance below 1 in 3000) are more than four of their own standard
/// errors away, and none more than the stated share.
///
/// Direct quality samples emitters only, with 1/r^2: where two emitting walls meet its variance is
/// infinite and standard errors mean nothing, so it looks at the middle of a wall.
#[test]
fn white_furnace() {
    let mut files = Files::default();
    files.diffuse("m", &[0.5], &[1.0]);
    for (name, points) in box_faces([0.0; 3], [1.0, 1.25, 0.75], true) {
        files.polygon(name, "m", &points);
    }
    files.toml(&camera("corners", [0.2, 0.3, 0.4], [1.0, 1.0, 0.1], [0.0, 0.0, 1.0], 90.0, 16));
    files.toml(&camera("wall", [0.2, 0.6, 0.4], [1.0, 0.6, 0.375], [0.0, 0.0, 1.0], 30.0, 16));
    let scene = files.load();
    let exact = 2.0 / PI;
    for (method, spp, limit) in
        [(MESH, 1, 5e-3), (DIRECT, 16, 0.15), (GATHER, 4, 0.03), (Method::Path, 64, 0.1)]
    {
        let view = if method == DIRECT { "wall" } else { "corners" };
        let images = pictures(&scene, view, (1024, 0.25), &settings(method, spp));
        let (m, e) = mean_error(&means(&images));
        let (mut far, mut worst): (u32, f64) = (0, 0.0);
        for k in 0..images[0].data.len() / 3 {
            let values: Vec<f64> = images.iter().map(|i| f64::from(i.data[3 * k])).collect();
            let (m, e) = mean_error(&values);
            far += u32::from((m - exact).abs() > T15 * e + 1e-6 * exact);
            worst = worst.max((m / exact - 1.0).abs());
        }
        eprintln!(
            "{method:?}: mean {:+.4} % +- {:.4} %, worst pixel {:.2} %, {far} of 256 beyond four standard errors",
            100.0 * (m / exact - 1.0),
            100.0 * e / exact,
            100.0 * worst
        );
        assert!((m - exact).abs() <= T15 * e + 1e-6 && (m / exact - 1.0).abs() < 2e-3, "{method:?}");
        assert!(far <= 3 && worst < limit, "{method:?}: {far}, {worst}");
    }
}

/// The floor under a small square light: Lambert's closed form for a point below the middle.
///
/// Whitted's method and the direct part of the path tracer; the light and the floor are black
/// to each other's reflections (the light reflects nothing, the floor is alone), so two-pass agrees too.
#[test]
fn direct_light_under_a_square() {
    let (half, height, rho, e) = (0.25, 0.8, 0.6, 3.0);
    let mut files = Files::default();
    files.diffuse("light", &[0.0], &[e]).diffuse("floor", &[rho], &[0.0]);
    let (a, h) = (half, height);
    files.polygon("light", "light", &[[-a, a, h], [a, a, h], [a, -a, h], [-a, -a, h]]);
    files.polygon(
        "floor",
        "floor",
        &[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]],
    );
    // A narrow view: the irradiance changes by less than 1e-6 over it.
    files.toml(&camera("c", [1.5, 0.0, 1.0], [0.0; 3], [0.0, 0.0, 1.0], 0.01, 8));
    let scene = files.load();
    let x = half / height;
    let corner = 2.0 * x / (1.0 + x * x).sqrt() * (x / (1.0 + x * x).sqrt()).atan() / (2.0 * PI);
    let exact = rho / PI * e * 4.0 * corner;
    for method in [Method::Whitted, Method::Path, DIRECT, GATHER] {
        let images = pictures(&scene, "c", (256, 0.5), &settings(method, 64));
        let mut worst = Worst::default();
        worst.check(&format!("{method:?}"), &means(&images), exact, 2e-3);
        eprintln!("{method:?} under a light: {worst:?}");
    }
}

/// A room with a floor of the given roughness, lit by an emitting wall and a small lamp.
fn glossy_room(roughness: f64, size: u32) -> Scene {
    let mut files = Files::default();
    files.diffuse("grey", &[0.5], &[0.0]).diffuse("red", &[0.6, 0.2, 0.1], &[0.0]);
    files.diffuse("bright", &[0.3], &[1.0]);
    files.material("floor", &format!("diffuse = 0.2\nspecular = 0.6\nroughness = {roughness:?}"));
    for (name, points) in box_faces([0.0; 3], [1.0; 3], true) {
        let material = match name {
            "x0" => "red",
            "y1" => "bright",
            "z0" => "floor",
            _ => "grey",
        };
        files.polygon(name, material, &points);
    }
    files.toml(&camera("c", [0.5, 0.1, 0.6], [0.5, 0.7, 0.0], [0.0, 0.0, 1.0], 50.0, size));
    files.load()
}

/// The paper's frustum and importance sampling estimate the same lobe integral: within four standard
/// errors of their difference over 16 seeds, with one known exception. The frustum leaves out 1 % of the
/// lobe and normalises, which costs up to 1 % of the contrast between the rest and what is seen there. At
/// roughness 0.2 that is 0.13 %, above the noise of 0.009 %: the same with 20 and 40 cells an edge, and
/// 0.015 % where the frustum holds 99.9 %.
#[test]
fn frustum_agrees_with_lobe_sampling() {
    let mut failures = Vec::new();
    for roughness in [0.05, 0.2, 0.4, 0.7, 1.0] {
        let scene = glossy_room(roughness, 16);
        let run = |estimator| {
            let s = Settings { estimator, ..settings(MESH, 4) };
            pictures(&scene, "c", (512, 0.25), &s)
        };
        let (f, l) = (run(Estimator::Frustum(10)), run(Estimator::Lobe(32)));
        // Both use the same solution for a seed: differences by seed cancel its noise.
        let differences: Vec<f64> = f.iter().zip(&l).map(|(f, l)| mean(f) / mean(l) - 1.0).collect();
        let (d, e) = mean_error(&differences);
        eprintln!("roughness {roughness}: frustum over lobe {:+.3} % +- {:.3} %", 100.0 * d, 100.0 * e);
        let truncated = if roughness == 0.2 { 0.01 } else { 0.0 };
        if d.abs() > T15 * e + truncated {
            failures.push(format!("roughness {roughness}: {:+.3} % +- {:.3} %", 100.0 * d, 100.0 * e));
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}

/// Under uniform light from everywhere both estimators give the lobe's albedo times its radiance: what the
/// frustum leaves out makes no difference, so only the tabulated albedo is compared, to 0.1 %.
#[test]
fn uniform_light_on_a_glossy_floor() {
    for roughness in [0.05, 0.2, 0.4, 0.7, 1.0] {
        let mut files = Files::default();
        files.material("floor", &format!("diffuse = 0\nspecular = 0.6\nroughness = {roughness:?}"));
        let points = [[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]];
        files.polygon("floor", "floor", &points).toml("[environment]\nradiance = 1.0");
        files.toml(&camera("c", [0.5, 0.1, 0.6], [0.5, 0.7, 0.0], [0.0, 0.0, 1.0], 50.0, 16));
        let scene = files.load();
        let run = |estimator| {
            let s = Settings { estimator, ..settings(Method::Whitted, 4) };
            mean_error(&means(&pictures(&scene, "c", (0, 0.0), &s)))
        };
        let ((f, ef), (l, el)) = (run(Estimator::Frustum(10)), run(Estimator::Lobe(32)));
        let (off, error) = (f / l - 1.0, ef.hypot(el) / l);
        eprintln!("uniform light, roughness {roughness}: {:+.4} % +- {:.4} %", 100.0 * off, 100.0 * error);
        assert!(l <= 0.6 + 1e-6 && off.abs() < 1e-3 + T15 * error, "{f} {l}");
    }
}

/// A mirror shows what a camera at the mirrored place sees, times its reflectance, left and right
/// exchanged. All that is seen are four black patches of different emission, so no light
/// differs between the scenes; pixels on an edge between patches are noisy, all others exact to 1e-5.
/// 256 pixels x 3 channels x 4 methods; of the 768 of a method at most 6 (expected 0.9 if all were noisy) may be
/// beyond four standard errors.
#[test]
fn mirror_shows_the_direct_view() {
    let albedo = [0.9, 0.8, 0.5];
    let build = |mirror: bool| {
        let mut files = Files::default();
        let radiosities = [[3.0, 1.0, 0.5], [0.2, 2.0, 1.0], [1.0, 0.1, 4.0], [2.0, 2.0, 0.3]];
        for (k, e) in radiosities.iter().enumerate() {
            let (y, z) = ([-4.0, 0.13][k % 2], [-3.0, 1.07][k / 2]);
            let (y1, z1) = ([0.13, 4.0][k % 2], [1.07, 5.0][k / 2]);
            let name = format!("patch{k}");
            let points = [[2.0, y, z], [2.0, y, z1], [2.0, y1, z1], [2.0, y1, z]];
            files.diffuse(&name, &[0.0], e).polygon(&name, &name, &points);
        }
        if mirror {
            files.material("mirror", &format!("diffuse = 0\nroughness = 0\nspecular = {albedo:?}"));
            let points = [[0.0, -3.0, -2.0], [0.0, 3.0, -2.0], [0.0, 3.0, 4.0], [0.0, -3.0, 4.0]];
            files.polygon("mirror", "mirror", &points);
        }
        let side = if mirror { 1.0 } else { -1.0 };
        files.toml(&camera("c", [side, 0.2, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], 40.0, 16));
        files.load()
    };
    let (reflected, straight) = (build(true), build(false));
    for method in [Method::Whitted, Method::Path, MESH, GATHER] {
        let run = |scene: &Scene| pictures(scene, "c", (64, 1.0), &settings(method, 4));
        let (a, b) = (run(&reflected), run(&straight));
        let (mut far, mut noisy) = (0, 0);
        for k in 0..768 {
            let (x, y, c) = (k / 3 % 16, k / 48, k % 3);
            let at = |images: &[Image], x: usize| {
                mean_error(&images.iter().map(|i| f64::from(i.get(x, y)[c])).collect::<Vec<_>>())
            };
            let ((ma, ea), (mb, eb)) = (at(&a, x), at(&b, 15 - x));
            let error = ea.hypot(albedo[c] * eb);
            assert!(mb > 0.0);
            noisy += u32::from(error > 1e-4 * mb);
            far += u32::from((ma - albedo[c] * mb).abs() > T15 * error + 1e-5 * mb);
        }
        eprintln!("mirror, {method:?}: {far} of 768 beyond four standard errors, {noisy} are noisy");
        assert!(far <= 6 && noisy < 400, "{method:?}: {far}, {noisy}");
    }
}

/// Two-pass and path tracing of a small room with a glossy and with a mirror floor. Gathering and
/// direct quality keep the bias of a coarse mesh: stated with each.
#[test]
fn two_pass_equals_path() {
    for roughness in [0.0, 0.5] {
        let scene = glossy_room(roughness, 16);
        let path = pictures(&scene, "c", (0, 0.0), &settings(Method::Path, 256));
        for (method, spp, relative) in [(GATHER, 4, 0.005), (DIRECT, 8, 0.01)] {
            let images = pictures(&scene, "c", (1024, 0.05), &settings(method, spp));
            let ((a, ea), (b, eb)) = (mean_error(&means(&images)), mean_error(&means(&path)));
            let (off, error) = (a / b - 1.0, ea.hypot(eb) / b);
            eprintln!("roughness {roughness} {method:?}: {:+.3} % +- {:.3} %", 100.0 * off, 100.0 * error);
            assert!(off.abs() <= relative && error < 0.003, "{method:?}: {off} +- {error}");
        }
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let scene = glossy_room(0.3, 40);
    for method in [MESH, DIRECT, GATHER, Method::Path, Method::Whitted, Method::Radiosity] {
        let run = |threads: usize, seed: u32| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let s = Settings { seed, ..settings(method, 2) };
            let image = pool.install(|| picture(&scene, "c", (64, 0.2), &s));
            image.data.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        let one = run(1, 3);
        assert!(one == run(2, 3), "{method:?}: 1 and 2 threads differ");
        assert!(one == run(2, 3), "{method:?}: two runs differ");
        assert!(one != run(2, 4), "{method:?}: another seed gives the same image");
    }
}
