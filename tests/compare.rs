//! `twopass compare`: known images with known errors, every format, and what is refused.

use exr::prelude::{SpecificChannels, WritableImage};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use twopass::image::{Image, WriteOptions, png, read, write};

struct Folder(tempfile::TempDir);

/// Exit code, standard output and standard error.
type Run = (i32, String, String);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn compare(&self, args: &[&str]) -> Run {
        let run = Command::new(env!("CARGO_BIN_EXE_twopass"))
            .current_dir(self.0.path())
            .arg("compare")
            .args(args)
            .output()
            .unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        let (out, err) = (text(run.stdout), text(run.stderr));
        assert!(!err.contains("panicked"), "{args:?}: {err}");
        (run.status.code().expect("no signal"), out, err)
    }

    fn json(&self, args: &[&str]) -> Value {
        let (code, out, err) = self.compare(&[args, &["--json"]].concat());
        assert_eq!(code, 0, "{err}");
        serde_json::from_str(&out).expect("one JSON value")
    }
}

/// 24 x 16 pixels of one colour.
fn uniform(rgb: [f32; 3]) -> Image {
    let mut image = Image::new(24, 16);
    image.data.chunks_exact_mut(3).for_each(|p| p.copy_from_slice(&rgb));
    image
}

/// Without OpenImageIO.
fn write_exr(path: &Path, image: &Image) {
    let pixel = |at: exr::math::Vec2<usize>| {
        let [r, g, b] = image.get(at.x(), at.y());
        (r, g, b)
    };
    exr::prelude::Image::from_channels((image.width, image.height), SpecificChannels::rgb(pixel))
        .write()
        .to_file(path)
        .unwrap();
}

fn write_pfm(path: &Path, image: &Image) {
    let mut bytes = format!("PF\n{} {}\n-1.0\n", image.width, image.height).into_bytes();
    for row in image.data.chunks_exact(3 * image.width).rev() {
        row.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    fs::write(path, bytes).unwrap();
}

fn near(value: &Value, expected: f64, tolerance: f64) {
    let value = value.as_f64().expect("a number");
    assert!((value - expected).abs() <= tolerance, "{value}, expected {expected}");
}

#[test]
fn known_errors_in_words_and_json() {
    let folder = Folder::new();
    write_exr(&folder.path("a.exr"), &uniform([1.0, 0.5, 0.25]));
    write_exr(&folder.path("x.exr"), &uniform([1.1, 0.5, 0.25]));
    let v = folder.json(&["x.exr", "a.exr"]);
    let mean = 1.75 / 3.0;
    near(&v["relative_rmse"], (0.01f64 / 3.0).sqrt() / mean, 1e-6);
    near(&v["bias"], 0.1 / 1.75, 1e-6);
    near(&v["mean_absolute_error"], 0.1 / 3.0 / mean, 1e-6);
    near(&v["maximum"]["error"], 0.1 / mean, 1e-6);
    near(&v["channels"][0]["relative_rmse"], 0.1, 1e-6);
    near(&v["channels"][1]["relative_rmse"], 0.0, 0.0);
    near(&v["reference_mean"], mean, 1e-6);
    assert_eq!((v["pixels"].as_u64(), v["masked"].as_u64()), (Some(384), Some(0)));
    let (code, out, _) = folder.compare(&["x.exr", "a.exr"]);
    assert_eq!(code, 0);
    assert!(out.contains("relative RMSE        9.8974 %"), "{out}");
    assert!(out.contains("bias                 +5.7143 %") && out.contains("mean FLIP"), "{out}");
}

/// Noise of +-0.5 on a reference of 1 hides an error of 2 % from one half but not from two.
#[test]
fn two_halves_see_below_the_noise() {
    let folder = Folder::new();
    let mut state = 7u64;
    let mut noisy = || {
        let mut image = Image::new(128, 128);
        for v in &mut image.data {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *v = 1.0 + 0.5 * ((state >> 40) as f32 / (1 << 23) as f32 - 1.0);
        }
        image
    };
    write_exr(&folder.path("a.exr"), &noisy());
    write_exr(&folder.path("b.exr"), &noisy());
    let mut x = Image::new(128, 128);
    x.data.fill(1.02);
    write_exr(&folder.path("x.exr"), &x);
    assert!(folder.json(&["x.exr", "a.exr"])["relative_rmse"].as_f64().unwrap() > 0.2);
    let v = folder.json(&["x.exr", "a.exr", "b.exr"]);
    // The seed is fixed; four standard errors are left by chance in fewer than 1 of 10,000.
    near(&v["relative_rmse"], 0.02, 4.0 * v["standard_error"].as_f64().unwrap());
    assert!(v["standard_error"].as_f64().unwrap() < 0.03);
    near(&v["bias"], 0.02, 0.005);
}

/// OpenEXR, PFM and Radiance hold the same linear values, PNG the nearest of 256 steps.
#[test]
fn every_format_is_read() {
    let folder = Folder::new();
    let image = uniform([0.5, 0.25, 0.125]);
    write_exr(&folder.path("a.exr"), &image);
    write_pfm(&folder.path("a.pfm"), &image);
    write(&image, &folder.path("a.hdr"), &WriteOptions::default()).unwrap();
    write(&image, &folder.path("a.png"), &WriteOptions::default()).unwrap();
    for (name, tolerance) in [("a.pfm", 0.0), ("a.hdr", 0.01), ("a.png", 0.01)] {
        let v = folder.json(&[name, "a.exr"]);
        near(&v["relative_rmse"], 0.0, tolerance);
    }
    let (code, _, err) = folder.compare(&["none.pfm", "a.exr"]);
    assert_eq!(code, 1);
    assert!(err.contains("none.pfm"), "{err}");
    fs::write(folder.path("bad.pfm"), "PF\n24 16\n-1.0\nshort").unwrap();
    let (code, _, err) = folder.compare(&["bad.pfm", "a.exr"]);
    assert!(code == 1 && err.contains("bad.pfm") && err.contains("holds 5 bytes"), "{err}");
}

#[test]
fn sizes_that_differ_are_refused() {
    let folder = Folder::new();
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    write_exr(&folder.path("small.exr"), &Image::new(8, 8));
    let (code, out, err) = folder.compare(&["a.exr", "small.exr", "--diff", "d.png"]);
    assert_eq!((code, out.as_str()), (2, ""));
    assert!(err.contains("the reference has 8 x 8 pixels, but the image has 24 x 16"), "{err}");
    assert!(!folder.path("d.png").exists());
    let (code, _, err) = folder.compare(&["a.exr", "a.exr", "small.exr"]);
    assert!(code == 2 && err.contains("the second reference has 8 x 8"), "{err}");
    let (code, _, err) = folder.compare(&["a.exr", "a.exr", "--mask", "small.exr"]);
    assert!(code == 2 && err.contains("the mask small.exr has 8 x 8"), "{err}");
    for name in ["d.jpg", "a.exr"] {
        let (code, _, err) = folder.compare(&["a.exr", "a.exr", "--diff", name]);
        assert!(code == 2 && err.contains(".png"), "{err}");
    }
    write(&uniform([1.0; 3]), &folder.path("a.png"), &WriteOptions::default()).unwrap();
    let (code, _, err) = folder.compare(&["a.png", "a.exr", "--diff", "a.png"]);
    assert!(code == 2 && err.contains("a.png"), "{err}");
    // A reference without light has nothing to be relative to.
    write_exr(&folder.path("black.exr"), &uniform([0.0; 3]));
    let (code, _, err) = folder.compare(&["a.exr", "black.exr"]);
    assert!(code == 2 && err.contains("mean of the reference is 0"), "{err}");
}

/// An error within the masked pixels alone, masked by a NumPy file and by an image.
#[test]
fn masks_of_both_kinds() {
    let folder = Folder::new();
    let (mut x, mut mask) = (uniform([1.0; 3]), Image::new(24, 16));
    mask.data.fill(1.0);
    for k in 0..16 {
        x.set(5, k, [4.0; 3]);
        mask.set(5, k, [0.0; 3]);
    }
    write_exr(&folder.path("x.exr"), &x);
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    write(&mask, &folder.path("m.png"), &WriteOptions::default()).unwrap();
    let mut npy =
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '|b1', 'fortran_order': False, 'shape': (16, 24), }".to_vec();
    npy.resize(127, b' ');
    npy.push(b'\n');
    npy.extend((0..16 * 24).map(|k| u8::from(k % 24 != 5)));
    fs::write(folder.path("m.npy"), npy).unwrap();
    assert!(folder.json(&["x.exr", "a.exr"])["relative_rmse"].as_f64().unwrap() > 0.5);
    for mask in ["m.png", "m.npy"] {
        let v = folder.json(&["x.exr", "a.exr", "--mask", mask]);
        near(&v["relative_rmse"], 0.0, 0.0);
        near(&v["flip"], 0.0, 0.0);
        assert_eq!((v["pixels"].as_u64(), v["masked"].as_u64()), (Some(368), Some(16)));
    }
}

#[test]
fn pixels_that_are_no_numbers_are_named() {
    let folder = Folder::new();
    let mut x = uniform([1.0; 3]);
    x.set(3, 2, [f32::NAN, 1.0, 1.0]);
    x.set(4, 2, [1.0, f32::INFINITY, 1.0]);
    write_exr(&folder.path("x.exr"), &x);
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    let (code, out, _) = folder.compare(&["x.exr", "a.exr"]);
    assert_eq!(code, 0);
    assert!(
        out.contains("2 pixels of the image are not finite, the first at (3, 2); they are left out"),
        "{out}"
    );
    let v = folder.json(&["x.exr", "a.exr"]);
    assert_eq!(v["not_finite"][0]["pixels"], 2);
    near(&v["relative_rmse"], 0.0, 0.0);
}

/// The file is named, and no mask that was not given.
#[test]
fn images_without_a_number_are_named() {
    let folder = Folder::new();
    write_exr(&folder.path("nan.exr"), &uniform([f32::NAN; 3]));
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    for args in [["nan.exr", "a.exr"], ["a.exr", "nan.exr"]] {
        let (code, out, err) = folder.compare(&args);
        assert_eq!((code, out.as_str()), (1, ""));
        assert!(err.contains("nan.exr: no pixel of it is finite") && !err.contains("mask"), "{err}");
    }
}

/// 24 x 16 pixels of sRGB 188, 137, 99 and alpha 64, by another writer: OpenImageIO's divides by alpha.
const RGBA: &[u8] =
    b"\x89PNG\x0d\x0a\x1a\x0a\x00\x00\x00\x0dIHDR\x00\x00\x00\x18\x00\x00\x00\x10\x08\x06\x00\x00\x00\x0c$\
    \xbf\x95\x00\x00\x00\x1eIDATx\xdac\xd8\xd3\x99\xec@K\xcc0j\xc1\xa8\x05\xa3\x16\x8cZ0j\xc1P\xb0\x00\
    \x00\x9b\xa4\xdc\x1f\xdd\x92\xd2\xa1\x00\x00\x00\x00IEND\xaeB`\x82";

/// Colours are compared as the file holds them, whatever its alpha says.
#[test]
fn alpha_changes_no_colour() {
    let folder = Folder::new();
    write(&uniform([0.5, 0.25, 0.125]), &folder.path("rgb.png"), &WriteOptions::default()).unwrap();
    fs::write(folder.path("rgba.png"), RGBA).unwrap();
    let pixel = |name: &str| read(&folder.path(name)).unwrap().get(5, 5);
    assert_eq!(pixel("rgba.png"), pixel("rgb.png"));
    near(&folder.json(&["rgba.png", "rgb.png"])["relative_rmse"], 0.0, 0.0);
}

/// One grey channel stands for three, as in other formats; other channels are named.
#[test]
fn exr_files_of_other_channels() {
    let folder = Folder::new();
    write_exr(&folder.path("a.exr"), &uniform([0.5; 3]));
    let file = |name: &str, channels: &[&str]| {
        let list = channels.iter().map(|c| {
            let samples = exr::prelude::FlatSamples::F32(vec![0.5; 24 * 16]);
            exr::prelude::AnyChannel::new(*c, samples)
        });
        let channels = exr::prelude::AnyChannels::sort(list.collect());
        exr::prelude::Image::from_channels((24, 16), channels).write().to_file(folder.path(name)).unwrap();
    };
    file("grey.exr", &["Y"]);
    file("grey_alpha.exr", &["Y", "A"]);
    for name in ["grey.exr", "grey_alpha.exr"] {
        near(&folder.json(&[name, "a.exr"])["relative_rmse"], 0.0, 0.0);
    }
    file("layers.exr", &["diffuse.R", "diffuse.G", "diffuse.B", "Z"]);
    file("chroma.exr", &["Y", "RY", "BY"]);
    for (name, found) in [("layers.exr", "Z, diffuse.B, diffuse.G, diffuse.R"), ("chroma.exr", "BY, RY, Y")] {
        let (code, _, err) = folder.compare(&[name, "a.exr"]);
        assert_eq!(code, 1);
        for part in [name, found, "R, G and B", "a file of their own"] {
            assert!(err.contains(part), "{err}");
        }
    }
}

/// Twice the same noise is no second half.
#[test]
fn one_reference_is_not_two() {
    let folder = Folder::new();
    write_exr(&folder.path("x.exr"), &uniform([1.1; 3]));
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    fs::copy(folder.path("a.exr"), folder.path("copy.exr")).unwrap();
    for second in ["a.exr", "./a.exr"] {
        let (code, _, err) = folder.compare(&["x.exr", "a.exr", second]);
        assert!(code == 2 && err.contains("given as both references"), "{err}");
    }
    let (code, out, _) = folder.compare(&["x.exr", "a.exr", "copy.exr"]);
    assert!(code == 0 && out.contains("the references are equal"), "{out}");
    assert!(!out.contains("free of the references' noise"), "{out}");
}

#[test]
fn masks_that_are_cut_off() {
    let folder = Folder::new();
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    let mut npy =
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '|b1', 'fortran_order': False, 'shape': (16, 24), }".to_vec();
    npy.resize(127, b' ');
    npy.push(b'\n');
    npy.extend([1; 100]);
    for length in [npy.len(), 40] {
        fs::write(folder.path("m.npy"), &npy[..length]).unwrap();
        let (code, _, err) = folder.compare(&["a.exr", "a.exr", "--mask", "m.npy"]);
        assert!(code == 1 && err.contains("m.npy: ends too early: it is shorter"), "{err}");
    }
}

/// Too bright on the left, right in the middle, too dark on the right, at a given and at the found scale.
#[test]
fn the_picture_shows_signs() {
    let folder = Folder::new();
    let mut x = uniform([1.0; 3]);
    for y in 0..16 {
        for k in 0..8 {
            x.set(k, y, [1.2; 3]);
            x.set(23 - k, y, [0.8; 3]);
        }
    }
    write_exr(&folder.path("x.exr"), &x);
    write_exr(&folder.path("a.exr"), &uniform([1.0; 3]));
    let (code, out, err) = folder.compare(&["x.exr", "a.exr", "--diff", "d.png"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("d.png: dark blue -20.0000 % of the mean"), "{out}");
    let picture = read(&folder.path("d.png")).unwrap();
    let [left, middle, right] = [0, 12, 23].map(|k| picture.get(k, 8));
    assert!(left[0] > 5.0 * left[2] && right[2] > 5.0 * right[0], "{left:?} {right:?}");
    assert!(middle.iter().all(|v| *v > 0.9), "{middle:?}");
    // Half of a wider scale: paler.
    folder.json(&["x.exr", "a.exr", "--diff", "e.png", "--diff-scale", "0.8"]);
    let pale = read(&folder.path("e.png")).unwrap().get(0, 8);
    assert!(pale[2] > 2.0 * left[2] && pale[0] > pale[2], "{pale:?} {left:?}");
    assert!(png(0, 3, &[]).is_err());
}

/// The other renderer's halves: equal but for noise.
#[test]
fn reference_scenes() {
    let folder = Folder::new();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes/ours");
    if !scenes.is_dir() {
        eprintln!("skipped: ../shared/scenes is not there");
        return;
    }
    let name = |end: &str| scenes.join(format!("cornell_diffuse_{end}")).display().to_string();
    let v = folder.json(&[&name("A.exr"), &name("A.exr"), &name("B.exr"), "--mask", &name("mask.npy")]);
    // (A - A)(A - B) is zero everywhere.
    near(&v["relative_rmse"], 0.0, 0.0);
    let v = folder.json(&[&name("A.exr"), &name("B.exr"), "--mask", &name("mask.npy")]);
    // The mean of both has a standard error of 1.6 %: a half has sqrt(2), their difference twice that.
    near(&v["relative_rmse"], 0.032, 0.004);
    assert!(v["flip"].as_f64().unwrap() < 0.1);
}
