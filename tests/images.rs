//! Images of the reference scenes against two independent halves of a path-traced reference.
//!
//! `mean((x - a)(x - b))` is free of the reference's noise (see `image::compare`). Settings are cheaper
//! than the defaults where said. Seeds are fixed; the standard errors of the relative RMSE over the
//! pixels are 0.02 to 0.15 % of the mean, and two of them count as error (left by chance in 2.3 %).

mod common;

use common::*;
use twopass::emitters::Emitters;
use twopass::image::{Comparison, read_exr, read_mask_npy, relative_rmse_halves};
use twopass::pipeline::{self, Pass1};
use twopass::render::{Estimator, Method, Quality, Settings, render};
use twopass::scene::load;
use twopass::visibility::Visibility;

/// Renders a reference scene and compares; none where the scenes are not there.
fn compare(name: &str, rays: u32, settings: &Settings) -> Option<Comparison> {
    let folder = shared("scenes")?;
    let scene = load(&folder.join(format!("{name}.toml"))).expect("scene");
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let emitters = Emitters::new(&visibility);
    let solution = matches!(settings.method, Method::TwoPass(_)).then(|| {
        let pass1 = Pass1 { rays, ..Pass1::of(&scene) };
        pipeline::solve(&visibility, &emitters, &scene.cameras, &pass1, &|_| {}, &mut Vec::new())
            .expect("solution")
            .solution
    });
    let (image, _) = render(&visibility, &emitters, solution.as_ref(), &scene.cameras[0], settings, &|_| {});
    let half = |h: &str| read_exr(&folder.join(format!("{name}_{h}.exr"))).expect("reference");
    let mask = read_mask_npy(&folder.join(format!("{name}_mask.npy")), 256, 256).expect("mask");
    let c = relative_rmse_halves(&image, &half("A"), &half("B"), Some(&mask)).expect("comparison");
    eprintln!(
        "{name} {:?} {} spp, {rays} rays: relative RMSE {:.2} % + {:.2} %, mean {:+.2} %",
        settings.method,
        settings.spp,
        100.0 * c.relative_rmse,
        100.0 * c.standard_error,
        100.0 * c.mean_bias
    );
    Some(c)
}

fn settings(method: Method, spp: u32) -> Settings {
    Settings { method, spp, gather_rays: 32, emitter_samples: 4, estimator: Estimator::Lobe(4), seed: 0 }
}

/// At most `limit`, two standard errors of the estimate included.
fn within(c: Option<Comparison>, limit: f64) {
    if let Some(c) = c {
        assert!(c.relative_rmse + 2.0 * c.standard_error <= limit, "{c:?}");
        assert!(c.mean_bias.abs() < 0.01, "{c:?}");
    }
}

#[test]
fn diffuse_box_interpolated() {
    within(compare("ours/cornell_diffuse", 512, &settings(Method::TwoPass(Quality::Mesh), 4)), 0.10);
}

#[test]
fn diffuse_box_with_fresh_direct_light() {
    within(compare("ours/cornell_diffuse", 512, &settings(Method::TwoPass(Quality::Direct), 8)), 0.04);
}

/// Default settings of both passes.
#[test]
fn diffuse_box_gathered() {
    within(compare("ours/cornell_diffuse", 1024, &settings(Method::TwoPass(Quality::Gather), 16)), 0.022);
}

#[test]
fn mirror_box_with_fresh_direct_light() {
    within(compare("ours/cornell_mirror", 512, &settings(Method::TwoPass(Quality::Direct), 8)), 0.04);
}

/// Files as others publish them.
#[test]
fn published_box_with_fresh_direct_light() {
    within(compare("mcguire/original", 512, &settings(Method::TwoPass(Quality::Direct), 8)), 0.04);
}

/// The path tracer has no bias: the mean of the image, with 22 to 28 % noise a pixel at 16 samples, has a standard
/// error near 0.1 %, the reference's mean one below 0.02 %; 0.5 % are left by chance in less than 1 of 10,000.
#[test]
fn path_tracer_has_the_reference_mean() {
    for name in ["ours/cornell_diffuse", "ours/cornell_glossy"] {
        let Some(c) = compare(name, 0, &settings(Method::Path, 16)) else { return };
        assert!(c.mean_bias.abs() < 0.005, "{name}: {c:?}");
    }
}
