//! Many frames: pass 1 from a file, and cameras that move.

use std::fs;
use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use twopass::image::read_exr;

/// A box of one metre seen from within, a lamp under its ceiling and a screen in the middle.
const ROOM: &str = "o cube\nusemtl wall\n\
    v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
    f 1 5 6 2\nf 4 3 7 8\nf 1 2 3 4\nf 5 8 7 6\nf 1 4 8 5\nf 2 6 7 3\n\
    o panel\nusemtl lamp\n\
    v 0.3 0.9 0.3\nv 0.7 0.9 0.3\nv 0.7 0.9 0.7\nv 0.3 0.9 0.7\nf 9 10 11 12\n\
    o screen\nusemtl screen\n\
    v 0.2 0.1 0.4\nv 0.6 0.1 0.5\nv 0.6 0.6 0.5\nv 0.2 0.6 0.4\nf 13 14 15 16\n";
const CAMERA: &str = "[camera]\nfov = 60\nsize = [12, 8]\n\
    [[camera.keyframe]]\nframe = 1\norigin = [0.5, 0.4, 0.95]\ntarget = [0.5, 0.4, 0]\n\
    [[camera.keyframe]]\nframe = 5\norigin = [0.3, 0.5, 0.9]\ntarget = [0.6, 0.4, 0]\nfov = 50\n\
    [[camera.keyframe]]\nframe = 8\norigin = [0.7, 0.5, 0.9]\ntarget = [0.2, 0.4, 0]\n";
const LAMP: &str = "[materials.lamp]\nemission = [3, 2, 1]\n";
const QUICK: [&str; 4] = ["--rays", "64", "--element-size", "0.25"];
const PASS2: [&str; 4] = ["--spp", "2", "--quiet", "--seed=3"];

struct Files(tempfile::TempDir);

impl Files {
    fn new(materials: &str) -> Files {
        let files = Files(tempfile::tempdir().unwrap());
        files.scene(&format!("{CAMERA}{LAMP}{materials}"));
        fs::write(files.path("room.obj"), ROOM).unwrap();
        files
    }

    fn diffuse() -> Files {
        Files::new("[materials.wall]\ndiffuse = 0.5\n[materials.screen]\ndiffuse = [0.7, 0.3, 0.2]\n")
    }

    fn scene(&self, toml: &str) {
        fs::write(self.path("scene.toml"), format!("geometry = [\"room.obj\"]\n{toml}")).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Exit code and what was said.
    #[track_caller]
    fn run(&self, args: &[&[&str]]) -> (i32, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_twopass"))
            .current_dir(self.0.path())
            .args(args.concat())
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!said.contains("panicked"), "{args:?}: {said}");
        (output.status.code().expect("no signal"), said)
    }

    #[track_caller]
    fn done(&self, args: &[&[&str]]) -> String {
        let (code, said) = self.run(args);
        assert_eq!(code, 0, "{args:?}: {said}");
        said
    }

    #[track_caller]
    fn fails(&self, args: &[&[&str]], code: i32, parts: &[&str]) {
        let (got, said) = self.run(args);
        assert_eq!(got, code, "{args:?}: {said}");
        parts.iter().for_each(|p| assert!(said.contains(p), "{args:?} should say {p:?}: {said}"));
    }

    fn solve(&self) {
        self.done(&[&["solve", "scene.toml", "-o", "s.npz", "--seed=3", "--quiet"], &QUICK]);
    }

    fn pixels(&self, name: &str) -> Vec<u32> {
        read_exr(&self.path(name)).unwrap().data.iter().map(|v| v.to_bits()).collect()
    }
}

/// A picture from a kept solution is that of a run which solves, to the bit: diffuse, mirror with gloss and glass, translucent.
#[test]
fn a_kept_solution_gives_the_same_picture() {
    let specular = "[materials.wall]\ndiffuse = 0.4\nspecular = [0.3, 0.2, 0.1]\nroughness = 0.4\n";
    let scenes = [
        Files::diffuse(),
        Files::new(&format!("{specular}[materials.screen]\nspecular = 0.9\n")),
        Files::new(&format!("{specular}[materials.screen]\nspecular_transmission = 1\nior = 1.5\n")),
        Files::new(
            "[materials.wall]\ndiffuse = 0.5\n[materials.screen]\ndiffuse = 0.3\ndiffuse_transmission = [0.5, 0.4, 0.3]\n",
        ),
    ];
    for (k, files) in scenes.iter().enumerate() {
        files.solve();
        for quality in ["mesh", "direct", "gather"] {
            let render = ["render", "scene.toml", "--quality", quality];
            files.done(&[&render, &PASS2, &QUICK, &["-o", "a.exr"]]);
            files.done(&[&render, &PASS2, &["-o", "b.exr", "--solution", "s.npz", "--threads", "1"]]);
            let (a, b) = (files.pixels("a.exr"), files.pixels("b.exr"));
            assert!(a == b && a.iter().any(|v| f32::from_bits(*v) > 0.0), "scene {k}, {quality}");
        }
    }
}

/// Arrays that went through `numpy.savez_compressed` are the same solution.
#[test]
fn a_compressed_solution_is_read() {
    let files = Files::diffuse();
    files.solve();
    let mut stored = zip::ZipArchive::new(fs::File::open(files.path("s.npz")).unwrap()).unwrap();
    let mut deflated = zip::ZipWriter::new(fs::File::create(files.path("c.npz")).unwrap());
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    for k in 0..stored.len() {
        let mut entry = stored.by_index(k).unwrap();
        deflated.start_file(entry.name().to_string(), options).unwrap();
        std::io::copy(&mut entry, &mut deflated).unwrap();
    }
    deflated.finish().unwrap();
    let size = |name: &str| fs::metadata(files.path(name)).unwrap().len();
    assert!(size("c.npz") < size("s.npz"));
    for (solution, picture) in [("s.npz", "s.exr"), ("c.npz", "c.exr")] {
        let render = ["render", "scene.toml", "--quality", "mesh", "--solution", solution, "-o", picture];
        files.done(&[&render, &PASS2]);
    }
    assert_eq!(files.pixels("s.exr"), files.pixels("c.exr"));

    // 64 MiB of zeros take some 64 KiB.
    let mut long = zip::ZipWriter::new(fs::File::create(files.path("l.npz")).unwrap());
    for k in 0..stored.len() {
        let mut entry = stored.by_index(k).unwrap();
        long.start_file(entry.name().to_string(), options).unwrap();
        std::io::copy(&mut entry, &mut long).unwrap();
        if entry.name() == "radiosity.npy" {
            std::io::copy(&mut std::io::repeat(0).take(1 << 26), &mut long).unwrap();
        }
    }
    long.finish().unwrap();
    let render = ["render", "scene.toml", "--quality", "mesh", "--solution", "l.npz", "-o", "l.exr"];
    files.fails(&[&render], 1, &["l.npz", "damaged", "radiosity", "longer"]);

    // One number is none.
    let mut odd = zip::ZipWriter::new(fs::File::create(files.path("n.npz")).unwrap());
    for k in 0..stored.len() {
        let mut entry = stored.by_index(k).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        if entry.name() == "node_reflected.npy" {
            let last = bytes.len() - size_of::<f32>();
            bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
        }
        odd.start_file(entry.name().to_string(), options).unwrap();
        odd.write_all(&bytes).unwrap();
    }
    odd.finish().unwrap();
    let render = ["render", "scene.toml", "--quality", "mesh", "--solution", "n.npz", "-o", "n.exr"];
    files.fails(&[&render], 1, &["n.npz", "damaged", "node_reflected holds NaN"]);
}

/// The solution file `from` with all its tables in Fortran order, as NumPy writes those that are contiguous by columns.
fn write_by_columns(files: &Files, from: &str, to: &str) -> usize {
    let mut stored = zip::ZipArchive::new(fs::File::open(files.path(from)).unwrap()).unwrap();
    let mut turned = zip::ZipWriter::new(fs::File::create(files.path(to)).unwrap());
    let mut tables = 0;
    for k in 0..stored.len() {
        let mut entry = stored.by_index(k).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        let shape = npyz::NpyFile::new(&bytes[..]).unwrap().shape().to_vec();
        if let [rows, columns] = shape.iter().map(|n| *n as usize).collect::<Vec<_>>()[..] {
            tables += 1;
            let end = 1 + bytes.iter().position(|b| *b == b'\n').unwrap();
            let at = bytes[..end].windows(5).position(|w| w == b"False").unwrap();
            bytes[at..at + 5].copy_from_slice(b"True ");
            let values = bytes[end..].to_vec();
            let size = values.len() / (rows * columns);
            for (k, value) in bytes[end..].chunks_exact_mut(size).enumerate() {
                let i = k % rows * columns + k / rows;
                value.copy_from_slice(&values[i * size..][..size]);
            }
        }
        turned.start_file(entry.name().to_string(), zip::write::SimpleFileOptions::default()).unwrap();
        turned.write_all(&bytes).unwrap();
    }
    turned.finish().unwrap();
    tables
}

/// Tables that NumPy wrote by columns are the same solution, those of an adaptive mesh too.
#[test]
fn a_solution_in_fortran_order_is_read() {
    let files = Files::diffuse();
    files.solve();
    files.done(&[&["solve", "scene.toml", "-o", "a.npz", "--adaptive", "--quiet"], &QUICK]);
    for (solution, tables) in [("s.npz", 12), ("a.npz", 13)] {
        assert_eq!(write_by_columns(&files, solution, "f.npz"), tables);
        for quality in ["mesh", "direct"] {
            let render = ["render", "scene.toml", "--quality", quality];
            files.done(&[&render, &PASS2, &["-o", "a.exr", "--solution", solution]]);
            files.done(&[&render, &PASS2, &["-o", "b.exr", "--solution", "f.npz"]]);
            let (a, b) = (files.pixels("a.exr"), files.pixels("b.exr"));
            assert!(a == b && a.iter().any(|v| f32::from_bits(*v) > 0.0), "{solution}, {quality}");
        }
    }
}

/// A frame does not depend on which others are rendered, nor on where pass 1 came from.
#[test]
fn frames_do_not_depend_on_the_range() {
    let files = Files::diffuse();
    files.solve();
    let render = ["render", "scene.toml", "--quality", "direct"];
    files.done(&[&render, &PASS2, &QUICK, &["--frames", "1..8", "-o", "a.%03d.exr", "--report", "r.json"]]);
    files.done(&[&render, &PASS2, &["--frames", "5..6", "-o", "b_##.exr", "--solution", "s.npz"]]);
    files.done(&[&render, &PASS2, &QUICK, &["--frames", "6", "-o", "c.%d.exr", "--threads", "1"]]);
    assert_eq!(files.pixels("a.006.exr"), files.pixels("b_06.exr"));
    assert_eq!(files.pixels("a.006.exr"), files.pixels("c.6.exr"));
    assert_eq!(files.pixels("a.005.exr"), files.pixels("b_05.exr"));
    assert_ne!(files.pixels("a.005.exr"), files.pixels("a.006.exr"));
    let report: serde_json::Value = serde_json::from_slice(&fs::read(files.path("r.json")).unwrap()).unwrap();
    let frames: Vec<_> =
        report["frames"].as_array().unwrap().iter().map(|f| f["frame"].as_u64().unwrap()).collect();
    assert_eq!(frames, (1..=8).collect::<Vec<_>>());
    assert!(report["frames"][0]["trace_seconds"].as_f64().unwrap() > 0.0);
    let stages = report["stages"].as_array().unwrap();
    let names: Vec<_> = stages.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["load", "build", "form-factors", "solve", "trace", "write"]);
    let written: f64 =
        report["frames"].as_array().unwrap().iter().map(|f| f["write_seconds"].as_f64().unwrap()).sum();
    assert!(written > 0.0 && (stages[5]["seconds"].as_f64().unwrap() / written - 1.0).abs() < 1e-9);

    // A still shows the first keyframe where the camera itself says nothing.
    files.done(&[&render, &PASS2, &QUICK, &["-o", "still.exr"]]);
    assert_eq!(files.pixels("still.exr"), files.pixels("a.001.exr"));

    // One frame cannot be written: those before it stay, and nothing else is left behind.
    std::os::unix::fs::symlink("/dev/full", files.path("d.3.exr")).unwrap();
    files.fails(
        &[&render, &PASS2, &["--solution", "s.npz", "--frames", "1..8", "-o", "d.%d.exr"]],
        1,
        &["d.3.exr"],
    );
    let names = |start: &str| {
        let names =
            fs::read_dir(files.0.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = names.filter(|n| n.starts_with(start)).collect();
        names.sort();
        names
    };
    assert_eq!(names("d."), ["d.1.exr", "d.2.exr", "d.3.exr"]);
    assert!(names(".twopass").is_empty());
}

#[test]
fn solutions_that_are_of_no_use() {
    let files = Files::diffuse();
    files.solve();
    let toml = fs::read_to_string(files.path("scene.toml")).unwrap();
    let render = ["render", "scene.toml", "-o", "a.exr", "--quality", "mesh", "--spp", "1"];
    let fails = |name: &str, parts: &[&str]| files.fails(&[&render, &["--solution", name]], 1, parts);
    fails("gone.npz", &["gone.npz", "No such file"]);
    fails("room.obj", &["room.obj", "no solution file", "twopass solve scene.toml -o NAME.npz"]);
    files.done(&[&["form-factors", "room.obj", "--by-object", "-o", "f.npz", "--quiet"], &QUICK]);
    fails("f.npz", &["f.npz", "no solution", "twopass solve"]);

    let whole = fs::read(files.path("s.npz")).unwrap();
    for cut in [0, 1, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(files.path("t.npz"), &whole[..cut]).unwrap();
        fails("t.npz", &["t.npz", "twopass solve"]);
    }
    // A flipped bit anywhere in the data of an array that is read is found by its checksum.
    let at =
        |name: &str| whole.windows(name.len()).position(|w| w == name.as_bytes()).unwrap() + name.len() + 150;
    for name in ["radiosity.npy", "node_reflected.npy", "node_indirect.npy", "sides.npy", "meta.npy"] {
        let mut damaged = whole.clone();
        damaged[at(name)] ^= 1;
        fs::write(files.path("t.npz"), damaged).unwrap();
        fails("t.npz", &["t.npz", "damaged", name.trim_end_matches(".npy")]);
    }

    // What pass 1 depends on makes it stale; cameras and settings of pass 2 do not.
    let stale =
        ["s.npz", "stale", "twopass solve scene.toml -o s.npz --rays 64 --element-size 0.25 --seed 3"];
    let adaptive = ["solve", "scene.toml", "-o", "a.npz", "--adaptive", "--quality", "mesh", "--quiet"];
    files.done(&[&adaptive, &QUICK]);
    for (from, to) in [("diffuse = 0.5", "diffuse = 0.6"), ("[3, 2, 1]", "[3, 2, 2]")] {
        files.scene(&toml.replace(from, to).replace("geometry = [\"room.obj\"]\n", ""));
        fails("s.npz", &stale);
        fails("a.npz", &["a.npz", "stale", "--element-size 0.25 --adaptive --quality mesh"]);
    }
    let rest = toml.replace("geometry = [\"room.obj\"]\n", "");
    files.scene(&format!("{rest}[environment]\nradiance = 0.1\n"));
    fails("s.npz", &stale);
    fs::write(files.path("room.obj"), ROOM.replace("0.3 0.9 0.7", "0.3 0.9 0.6")).unwrap();
    files.scene(&rest);
    fails("s.npz", &stale);
    fs::write(files.path("room.obj"), ROOM).unwrap();
    files.scene(&format!("{}[render]\nspp = 1\n", rest.replace("fov = 60", "fov = 70")));
    files.done(&[&render, &["--solution", "s.npz"]]);

    // A camera outside sees sides that nothing reached.
    files.scene(&format!(
        "{LAMP}[materials.wall]\ndiffuse = 0.5\n[materials.screen]\ndiffuse = [0.7, 0.3, 0.2]\n\
        [camera]\norigin = [0.5, 0.5, 5]\ntarget = [0.5, 0.5, 0]\nsize = [8, 8]\n"
    ));
    let said = files.done(&[&render, &["--solution", "s.npz"]]);
    assert!(said.contains("warning: the camera sees") && said.contains("(cube)"), "{said}");

    files.fails(&[&render, &["--solution", "s.npz", "--rays", "8"]], 2, &["--solution", "--rays"]);
    files.fails(&[&render, &["--solution", "s.npz", "--method", "path"]], 2, &["no pass 1"]);
}

#[test]
fn frames_that_cannot_be_rendered() {
    let files = Files::diffuse();
    let frames = |frames: &str, output: &str, code, parts: &[&str]| {
        files.fails(&[&["render", "scene.toml", "--frames", frames, "-o", output], &QUICK], code, parts);
    };
    frames("1..3", "a.exr", 2, &["a.exr", "%04d"]);
    frames("1..3", "a%d#.exr", 2, &["several places"]);
    frames("1..3", "gone/a#.exr", 1, &["folder gone does not exist"]);
    frames("1..3", "a#.bmp", 2, &["image format is unknown"]);
    frames("3..1", "a#.exr", 2, &["A <= B"]);
    frames("-1..1", "a#.exr", 2, &["A..B"]);
    frames("0..3", "a#.exr", 2, &["--frames 0..3", "from frame 1 to frame 8"]);
    frames("1..9", "a#.exr", 2, &["from frame 1 to frame 8"]);
    files.fails(&[&["render", "scene.toml", "-o", "a.%04d.exr"]], 2, &["--frames"]);
    let camera = |text: &str, parts: &[&str]| {
        files.scene(&format!("[camera]\norigin = [0.5, 0.4, 0.95]\ntarget = [0.5, 0.4, 0]\n{text}\n{LAMP}"));
        frames("1..3", "a#.exr", 1, parts);
    };
    camera("", &["has no keyframes", "[[camera.keyframe]]"]);
    camera("keyframe = []", &["scene.toml", "empty list"]);
    camera("[[camera.keyframe]]\norigin = [0, 0, 0]", &["scene.toml:5", "has no frame"]);
    camera("[[camera.keyframe]]\nframe = 3\n[[camera.keyframe]]\nframe = 3", &["scene.toml:8", "greater"]);
    camera("[[camera.keyframe]]\nframe = -3", &["scene.toml:6", "whole number from 0"]);
    camera("[[camera.keyframe]]\nframe = 1\nfov = 180", &["scene.toml:7", "between 0 and 180"]);
    // Half-way the eye meets its target.
    camera(
        "[[camera.keyframe]]\nframe = 1\n[[camera.keyframe]]\nframe = 3\norigin = [0.5, 0.4, -0.95]",
        &["in frame 2", "same point"],
    );
}

/// What the names of later frames meet is found before anything is rendered.
#[test]
fn names_of_all_frames_are_checked() {
    let files = Files::diffuse();
    files.scene(&format!("{}{LAMP}", CAMERA.replace("frame = 8", "frame = 100000")));
    fs::create_dir_all(files.path("L/x_12.exr")).unwrap();
    let fails = |frames: &str, outputs: &[&str], code: i32, parts: &[&str]| {
        files.fails(&[&["render", "scene.toml", "--frames", frames], outputs, &QUICK], code, parts);
        let names: Vec<_> = fs::read_dir(files.0.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(names.len(), 3, "{names:?}");
    };
    let twice = "is an output given twice";
    fails("9..11", &["-o", "o_%d.exr", "--report", "o_10.exr"], 2, &["o_10.exr", twice]);
    fails("1..12", &["-o", "c_%d.exr", "-o", "c_1%d.exr"], 2, &["c_11.exr", twice]);
    fails("1..12", &["-o", "L/x_%d.exr"], 1, &["L/x_12.exr", "is a folder"]);
    fails("1..100000", &["-o", "o_%d.exr", "--report", "o_99999.exr"], 2, &["o_99999.exr", twice]);
    files.scene(&format!("{CAMERA}{LAMP}"));
    // Another spelling of the same folder.
    fails(
        "1..3",
        &["-o", "o_%d.exr", "-o", "L/../o_##.exr", "--report", "o_02.exr"],
        2,
        &["o_02.exr", twice],
    );
}
