//! Error of an image over the time it takes, for every method, on the repository's Cornell box.
//!
//! `cargo bench --bench images [-- SIZE REFERENCE_SPP]` prints a Markdown table. The reference is the path tracer
//! in two independent halves, so errors below its own noise can be told (relative RMSE as in `twopass::image`);
//! pixels that see the light are left out. Times cover pass 1 and pass 2, not the reading of files.

use std::path::Path;
use std::time::Instant;
use twopass::embree::Device;
use twopass::emitters::Emitters;
use twopass::image::{Image, relative_rmse_halves};
use twopass::pipeline::{self, Pass1};
use twopass::render::{Estimator, Method, Quality, Settings, render};
use twopass::scene::{Scene, load};
use twopass::visibility::Visibility;

const ROUNDS: usize = 3;

fn settings(method: Method, spp: u32, seed: u32) -> Settings {
    Settings { method, spp, gather_rays: 32, emitter_samples: 4, estimator: Estimator::Lobe(4), seed }
}

fn main() {
    let numbers: Vec<u32> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let size = numbers.first().copied().unwrap_or(256);
    let reference_spp = numbers.get(1).copied().unwrap_or(4096);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell/cornell.toml");
    let mut scene = load(&path).expect("the scene of this repository");
    scene.cameras[0].size = [size, size];
    let device = Device::new(0).expect("Embree");
    println!(
        "Cornell box, {size} x {size}, {} threads, Embree {}; reference: 2 x {reference_spp} paths a pixel\n",
        rayon::current_num_threads(),
        device.version()
    );
    let halves =
        [1, 2].map(|seed| image(&device, &scene, settings(Method::Path, reference_spp, seed), None).0);
    // No pixel that sees the light, nor a neighbour of one: it may see a corner of it.
    let n = size as usize;
    let sees = |x: usize, y: usize| (0..3).any(|c| halves[0].get(x, y)[c].max(halves[1].get(x, y)[c]) > 3.0);
    let near = |k: usize| k.saturating_sub(1)..(k + 2).min(n);
    let mask: Vec<bool> = (0..n * n).map(|k| !near(k / n).any(|y| near(k % n).any(|x| sees(x, y)))).collect();
    println!(
        "| method | samples a pixel | pass 1 | pass 2 | relative RMSE | bias |\n| --- | --- | --- | --- | --- | --- |"
    );
    let rows = [
        ("two-pass, mesh", Method::TwoPass(Quality::Mesh), 16),
        ("two-pass, direct", Method::TwoPass(Quality::Direct), 16),
        ("two-pass, gather", Method::TwoPass(Quality::Gather), 16),
        ("two-pass, gather", Method::TwoPass(Quality::Gather), 64),
        ("path tracing", Method::Path, 64),
        ("path tracing", Method::Path, 256),
        ("path tracing", Method::Path, 1024),
    ];
    for (name, method, spp) in rows {
        let (mut first, mut second) = (Vec::new(), Vec::new());
        let mut last = None;
        for _ in 0..ROUNDS {
            let pass1 = matches!(method, Method::TwoPass(_)).then(|| Pass1::of(&scene));
            let (picture, one, two) = image(&device, &scene, settings(method, spp, 7), pass1);
            first.push(one);
            second.push(two);
            last = Some(picture);
        }
        let Some(picture) = last else { continue };
        let c = relative_rmse_halves(&picture, &halves[0], &halves[1], Some(&mask)).expect("equal sizes");
        for times in [&mut first, &mut second] {
            times.sort_by(f64::total_cmp);
        }
        let pass1 = if first[0] > 0.0 { format!("{:.2} s", first[ROUNDS / 2]) } else { "-".into() };
        println!(
            "| {name} | {spp} | {pass1} | {:.2} s | {:.2} % | {:+.2} % |",
            second[ROUNDS / 2],
            100.0 * c.relative_rmse,
            100.0 * c.mean_bias
        );
    }
}

/// An image, and the seconds that each pass took.
fn image(device: &Device, scene: &Scene, settings: Settings, pass1: Option<Pass1>) -> (Image, f64, f64) {
    let start = Instant::now();
    let visibility = Visibility::new(device, scene).expect("a tree");
    let emitters = Emitters::new(scene);
    let solution = pass1.map(|pass1| {
        let mut stages = Vec::new();
        pipeline::solve(&visibility, &emitters, &scene.cameras, &pass1, &|_| (), &mut stages)
            .expect("a solution")
    });
    let middle = Instant::now();
    let solved = solution.as_ref().map(|s| &s.solution);
    let (picture, _) = render(&visibility, &emitters, solved, &scene.cameras[0], &settings, &|_| ());
    let one = if solution.is_some() { (middle - start).as_secs_f64() } else { 0.0 };
    (picture, one, middle.elapsed().as_secs_f64())
}
