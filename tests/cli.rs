//! The program as its users run it: what it writes, and what it says about what they did wrong.

mod common;

use common::program::*;
use exr::meta::attribute::AttributeValue;
use std::fs;
use twopass::image::read_exr;

#[test]
fn files_that_are_missing_or_damaged() {
    let room = Files::room();
    room.fails(&["render", "gone.toml", "-o", "a.exr"], 1, &["gone.toml", "No such file"]);
    room.fails(&["info", "gone.obj"], 1, &["gone.obj"]);
    room.fails(&["solve", "scene.txt", "-o", "a.npz"], 1, &["scene.txt", ".toml", ".obj"]);
    Files::new("[camera\n", ROOM).render_fails(&["scene.toml:2"]);
    Files::new("unit = \"metre\"\n", ROOM).render_fails(&["scene.toml:2", "unit must be a number"]);
    let lit = format!("{CAMERA}{MATERIALS}");
    let with = |line: &str| Files::new(&lit, &format!("{ROOM}{line}\n"));
    with("f 1 2 99").render_fails(&["room.obj:24", "vertex index 99", "12 vertices"]);
    with("v 0 nan 0").render_fails(&["room.obj:24", "not a finite number"]);
    with("v 0 0 inf").render_fails(&["room.obj:24", "not a finite number"]);
    Files::new(&lit, "").render_fails(&["room.obj", "no faces"]);
    Files::new(&lit, "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n").render_fails(&["room.obj", "no faces", "area"]);
    let missing = Files::room();
    fs::remove_file(missing.path("room.obj")).unwrap();
    missing.render_fails(&["scene.toml:1", "room.obj"]);
}

#[test]
fn scenes_that_cannot_be_rendered() {
    for method in ["two-pass", "radiosity", "whitted", "path"] {
        let dark = Files::new(CAMERA, ROOM);
        let args = ["render", "scene.toml", "-o", "a.exr", "--method", method];
        dark.fails(&args, 1, &["scene.toml", "no light", "emission"]);
    }
    Files::new("", ROOM).fails(&["solve", "room.obj", "-o", "a.npz"], 1, &["room.obj", "no light"]);
    Files::new(MATERIALS, ROOM).render_fails(&["scene.toml", "no camera", "[camera]"]);
    let camera = |text: &str| Files::new(&format!("[camera]\n{text}\n{MATERIALS}"), ROOM);
    camera("origin = [0, 1, 0]\ntarget = [0, 0, 0]").render_fails(&["scene.toml:2", "up"]);
    camera("origin = [0, 1, 0]\ntarget = [0, 1, 0]").render_fails(&["scene.toml:2", "same point"]);
    camera("origin = [0, 1, 0]\ntarget = [0, 0, 1]\nsize = [60000, 60000]").render_fails(&[
        "scene.toml:5",
        "size",
        "at most",
        "pixels",
    ]);
    camera("orign = [0, 1, 0]\ntarget = [0, 0, 1]")
        .render_fails(&["scene.toml:3", "did you mean \"origin\""]);
    let room = Files::room();
    let args = ["render", "scene.toml", "-o", "a.exr", "--size", "640"];
    room.fails(&args, 2, &["WIDTHxHEIGHT"]);
    let args = ["render", "scene.toml", "-o", "a.exr", "--camera", "camra"];
    room.fails(&args, 1, &["no camera \"camra\"", "did you mean \"camera\""]);

    // Every surface white and no way out: light would grow for ever.
    let white =
        "[materials.white]\ndiffuse = 1\n[materials.lamp]\ndiffuse = 1\nemission = 1\ntwo_sided = true\n";
    Files::new(&format!("{CAMERA}{white}"), ROOM).render_fails(&["no steady state", "albedo", "below 1"]);
}

#[test]
fn numbers_out_of_range_are_bad_usage() {
    let room = Files::room();
    let render = |option: &str, value: &str, says: &str| {
        let args = ["render", "scene.toml", "-o", "a.exr", option, value];
        room.fails(&args, 2, &[option, value, says]);
    };
    for (option, value) in [("--spp", "0"), ("--spp", "-1"), ("--rays", "0"), ("--rays", "99999999999")] {
        render(option, value, "whole number from 1");
    }
    for value in ["0", "-1", "nan", "inf"] {
        render("--element-size", value, "above zero");
    }
    for value in ["0", "1000000"] {
        render("--threads", value, "whole number from 1");
    }
    render("--quality", "best", "gather");
    render("--method", "magic", "two-pass");
    room.fails(&["render", "scene.toml", "-o", "a.exr", "--exposure", "nan"], 2, &["--exposure", "finite"]);
    room.fails(&["render", "scene.toml"], 2, &["--output"]);
    room.fails(&["rendr"], 2, &["render"]);
    let tiny = ["solve", "scene.toml", "-o", "a.npz", "--element-size", "1e-12"];
    room.fails(&tiny, 2, &["element size", "--element-size"]);
}

#[test]
fn warnings_name_what_they_are_about_and_do_not_stop() {
    let toml = format!("untis = 1\n{CAMERA}{MATERIALS}");
    let flat = "v 0.1 0.1 0.1\nv 0.2 0.2 0.2\nv 0.3 0.3 0.3\nf -1 -2 -3\nf -1 -1 -2\n";
    let files = Files::new(&toml, &format!("{ROOM}{flat}"));
    let args = ["render", "scene.toml", "-o", "a.png", "--spp", "1", "--exposure", "-3", "--quiet"];
    let run = files.done(&[&args, &QUICK[..]].concat());
    let lines: Vec<_> = run.stderr.lines().collect();
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines[0].starts_with("warning: ") && lines[0].contains("scene.toml:2"), "{lines:?}");
    assert!(lines[0].contains("\"untis\"") && lines[0].contains("did you mean \"unit\""), "{lines:?}");
    assert!(lines[1].contains("2 faces of zero area") && lines[1].contains("\"panel\": 2"), "{lines:?}");
    assert_eq!(files.names(), ["a.png", "room.obj", "scene.toml"]);
}

#[test]
fn quiet_is_quiet_and_progress_goes_to_standard_error() {
    let room = Files::room();
    let args = [&["render", "scene.toml", "-o", "a.exr", "-o", "b.png", "--spp", "1"], &QUICK[..]].concat();
    let run = room.done(&args);
    assert!(run.stdout.is_empty());
    for stage in ["load", "build", "form-factors", "solve", "trace", "write"] {
        assert!(run.stderr.lines().any(|l| l.starts_with(stage)), "{stage}: {}", run.stderr);
    }
    assert_eq!(room.names(), ["a.exr", "b.png", "room.obj", "scene.toml"]);
    let quiet = room.done(&[&args[..], &["--quiet"]].concat());
    assert_eq!((quiet.stderr.as_str(), quiet.stdout.len()), ("", 0));
}

#[test]
fn reports_hold_the_fixed_names() {
    let room = Files::room();
    let stages_of = |args: &[&str]| -> (Vec<String>, serde_json::Value) {
        room.done(&[args, &["--report", "r.json", "--threads", "1"]].concat());
        let report: serde_json::Value =
            serde_json::from_slice(&fs::read(room.path("r.json")).unwrap()).unwrap();
        let stages = report["stages"].as_array().unwrap();
        for stage in stages {
            assert!(stage["seconds"].as_f64().unwrap() >= 0.0 && stage["rays"].is_u64(), "{stage}");
        }
        let names = stages.iter().map(|s| s["name"].as_str().unwrap().to_string()).collect();
        (names, report)
    };
    let quick = |args: &[&str]| stages_of(&[args, &QUICK].concat());
    let (stages, report) = quick(&["render", "scene.toml", "-o", "a.exr", "--spp", "2", "--seed", "7"]);
    assert_eq!(stages, ["load", "build", "form-factors", "solve", "trace", "write"]);
    assert!(report["stages"][2]["rays"].as_u64() > Some(0) && report["stages"][4]["rays"].as_u64() > Some(0));
    assert_eq!(report["elements"], 6 * 4 + 1, "the black lamp has one, for its power");
    assert_eq!((report["faces"].as_u64(), report["threads"].as_u64()), (Some(7), Some(1)));
    assert!(report["peak_memory_bytes"].as_u64() > Some(1 << 20));
    assert_eq!(report["features"]["emitters"], true);
    assert_eq!(report["features"]["specular"], false);
    assert_eq!(report["warnings"].as_array().map(Vec::len), Some(0));
    assert_eq!(report["seed"], 7);
    assert_eq!(report["command"][1], "render");
    for version in ["twopass", "embree", "openimageio"] {
        assert!(report["versions"][version].as_str().is_some_and(|v| v.contains('.')), "{version}");
    }
    for residual in ["closure", "reciprocity"] {
        assert!(report["pass1"]["residuals"][residual].is_f64(), "{residual}");
    }
    assert!(report["pass1"]["energy"]["residual"].is_array());
    assert!(report["pass1"]["standard_errors"]["relative_rms"].as_f64() > Some(0.0));

    let (stages, report) =
        stages_of(&["render", "scene.toml", "-o", "a.exr", "--spp", "2", "--method", "path"]);
    assert_eq!(stages, ["load", "build", "trace", "write"]);
    assert!(report.get("pass1").is_none());
    let (stages, _) = quick(&["solve", "scene.toml", "-o", "a.npz"]);
    assert_eq!(stages, ["load", "build", "form-factors", "solve", "write"]);
    let (stages, report) = quick(&["form-factors", "room.obj", "-o", "f.npz"]);
    assert_eq!(stages, ["load", "build", "form-factors", "write"]);
    assert_eq!(report["elements"], 6 * 4 + 1);
    assert!(report["form_factors"]["closure"].as_f64() < Some(1e-6), "{}", report["form_factors"]);
    assert!(report["form_factors"]["reciprocity"].as_f64() < Some(0.5), "{}", report["form_factors"]);
}

#[test]
fn solutions_hold_the_fixed_arrays() {
    // A unit and a place of their own: coordinates come back as the file has them.
    let room = Files::new(&format!("unit = 0.01\n{CAMERA}{MATERIALS}"), ROOM);
    room.done(&[&["solve", "scene.toml", "-o", "x.npz"], &QUICK[..]].concat());
    let open = || twopass::npz::Reader::new(fs::File::open(room.path("x.npz")).unwrap()).unwrap();
    let array = |name: &str| -> (Vec<u64>, Vec<f64>) {
        let bytes = open().bytes(name, 1 << 20).unwrap().unwrap_or_else(|| panic!("{name}"));
        let npy = npyz::NpyFile::new(&bytes[..]).unwrap();
        assert_eq!(npy.dtype().descr(), "'<f8'", "{name}");
        (npy.shape().to_vec(), npy.into_vec().unwrap())
    };
    let (shape, area) = array("area");
    let n = shape[0];
    assert_eq!(shape, [n]);
    assert_eq!(n, 6 * 4 + 1, "the black lamp has one, for its power");
    for name in ["radiosity", "irradiance", "direct", "standard_error", "centroid", "normal"] {
        let (shape, values) = array(name);
        assert_eq!(shape, [n, 3], "{name}");
        assert!(values.iter().all(|v| v.is_finite()), "{name}");
    }
    assert!((area.iter().sum::<f64>() - 6.16e-4).abs() < 1e-9);
    let (_, centroids) = array("centroid");
    assert!(centroids.iter().all(|c| (-1e-9..1.0 + 1e-9).contains(c)));
    let (_, normals) = array("normal");
    assert!(normals.chunks(3).all(|v| (v.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-12));
    {
        let bytes = open().bytes("object", 1 << 20).unwrap().unwrap();
        let object = npyz::NpyFile::new(&bytes[..]).unwrap();
        assert_eq!((object.dtype().descr().as_str(), object.shape()), ("'<i4'", &[n][..]));
    }
    let bytes = open().bytes("meta", 1 << 20).unwrap().unwrap();
    let meta = npyz::NpyFile::new(&bytes[..]).unwrap();
    assert_eq!(meta.dtype().descr(), "'|u1'");
    let meta: serde_json::Value = serde_json::from_slice(&meta.into_vec::<u8>().unwrap()).unwrap();
    assert_eq!(meta["objects"], serde_json::json!(["cube", "panel"]));
    assert_eq!(meta["settings"]["rays"], 16);
    assert!(meta["scene_hash"].is_string() && meta["versions"]["embree"].is_string());
}

#[test]
fn form_factors_on_standard_output_are_json_alone() {
    let room = Files::room();
    let run = room.done(&["form-factors", "room.obj", "--by-object", "-o", "-", "--rays", "256"]);
    let table: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(table["objects"], serde_json::json!(["cube", "panel"]));
    let number = |v: &serde_json::Value| v.as_f64().unwrap();
    assert!((number(&table["areas"][0]) - 6.0).abs() < 1e-12);
    let rows = table["form_factors"].as_array().unwrap();
    assert_eq!((rows.len(), rows[0].as_array().unwrap().len()), (2, 2));
    // The panel looks down on the cube alone; of the cube, it takes its share by reciprocity.
    assert!((number(&rows[1][0]) - 1.0).abs() < 1e-12, "{rows:?}");
    let error = number(&table["standard_errors"][0][1]);
    assert!((number(&rows[0][1]) - 0.16 / 6.0).abs() < 5.0 * error + 1e-4, "{rows:?} +- {error}");
    assert_eq!(table["escaped"].as_array().map(Vec::len), Some(2));
    assert!(table["rays"].as_u64() >= Some(256) && table["seconds"].is_f64());
    assert!(run.stderr.contains("form-factors"), "{}", run.stderr);
    assert_eq!(room.names(), ["room.obj", "scene.toml"]);
}

#[test]
fn images_carry_how_they_were_made() {
    let room = Files::room();
    room.done(&[&["render", "scene.toml", "-o", "a.exr", "--spp", "1", "--seed", "9"], &QUICK[..]].concat());
    let meta = exr::meta::MetaData::read_from_file(room.path("a.exr"), false).unwrap();
    let attributes = &meta.headers[0].own_attributes;
    let text = |name: &str| -> String {
        match attributes.other.get(&exr::meta::attribute::Text::from(name)) {
            Some(AttributeValue::Text(text)) => text.to_string(),
            other => panic!("{name}: {other:?}"),
        }
    };
    assert!(text("twopass:command").contains("render scene.toml -o a.exr"));
    assert_eq!(text("twopass:seed"), "9");
    assert!(text("twopass:embree").contains('.') && text("twopass:openimageio").contains('.'));
    assert_eq!(text("Software"), format!("twopass {}", env!("CARGO_PKG_VERSION")));
}

#[test]
fn images_do_not_depend_on_the_run_or_on_threads() {
    // A mirror and a translucent pane, so that chains and both sides take part.
    let obj = format!(
        "{ROOM}o mirror\nusemtl mirror\nv 0.1 0.2 0.2\nv 0.1 0.2 0.8\nv 0.1 0.8 0.8\nv 0.1 0.8 0.2\nf -4 -3 -2 -1\n\
         o pane\nusemtl pane\nv 0.2 0.1 0.1\nv 0.8 0.1 0.1\nv 0.8 0.7 0.1\nv 0.2 0.7 0.1\nf -4 -3 -2 -1\n"
    );
    let toml = format!(
        "{CAMERA}{MATERIALS}[materials.mirror]\nspecular = [0.9, 0.8, 0.7]\nroughness = 0.3\n\
         [materials.pane]\ndiffuse = 0.3\ndiffuse_transmission = 0.4\n"
    );
    let files = Files::new(&toml, &obj);
    for (method, quick) in [("two-pass", &QUICK[..]), ("path", &[])] {
        let render = |name: &str, threads: &str| {
            let args = ["render", "scene.toml", "-o", name, "--spp", "3", "--threads", threads];
            files.done(&[&args[..], &["--method", method], quick].concat());
            let image = read_exr(&files.path(name)).unwrap();
            assert!(image.data.iter().all(|v| v.is_finite()) && image.data.iter().any(|v| *v > 0.0));
            image.data.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        let first = render("a.exr", "1");
        assert!(first == render("b.exr", "1"), "{method}: two runs differ");
        assert!(first == render("c.exr", "2"), "{method}: threads change the image");
    }
}

#[test]
fn ray_tracing_with_emitters_alone_says_that_the_environment_is_left_out() {
    let files = Files::new(&format!("{CAMERA}[environment]\nradiance = 1.0\n{MATERIALS}"), ROOM);
    for (method, told) in [("whitted", true), ("path", false)] {
        let args = ["render", "scene.toml", "-o", "a.exr", "--size", "2x2", "--spp", "1", "--method", method];
        let stderr = files.done(&args).stderr;
        assert_eq!(
            stderr.matches("leaves out the environment's light").count(),
            usize::from(told),
            "{stderr}"
        );
    }
}

#[test]
fn info_says_what_is_modelled_and_what_is_not() {
    let room = Files::room();
    let run = room.done(&["info", "scene.toml"]);
    let text = String::from_utf8(run.stdout).unwrap();
    let (_, features) = text.split_once("  modelled\n").unwrap();
    let (needed, absent) = features.split_once("  not needed, not modelled\n").unwrap();
    assert!(needed.contains("emitters") && !needed.contains("specular"), "{needed}");
    for feature in ["environment", "specular", "glossy", "glass", "translucent"] {
        assert!(absent.contains(feature), "{feature}: {absent}");
    }
    for part in ["polygons      7", "0 triangles, 7 quads", "cube, panel", "camera", "elements", "Embree"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert_eq!(run.stderr, "");
}

#[test]
fn info_tells_what_materials_are() {
    let materials = "[materials.white]\ndiffuse = 0.5\ntwo_sided = false\n\
                     [materials.lamp]\nemission = [3, 2, 1]\nemit_both_sides = true\n\
                     [materials.pane]\nspecular_transmission = 1\nthin = true\nroughness = 0.25\nior = 1.4\n\
                     [materials.clear]\nspecular_transmission = [1, 0.5, 0.25]\n";
    let obj = format!(
        "{ROOM}o pane\nusemtl pane\nv 0.2 0.1 0.1\nv 0.8 0.1 0.1\nv 0.8 0.7 0.1\nv 0.2 0.7 0.1\nf -4 -3 -2 -1\n\
         usemtl clear\nv 0.2 0.1 0.2\nv 0.8 0.1 0.2\nv 0.8 0.7 0.2\nv 0.2 0.7 0.2\nf -4 -3 -2 -1\n"
    );
    let run = Files::new(&format!("{CAMERA}{materials}"), &obj).done(&["info", "scene.toml"]);
    let text = String::from_utf8(run.stdout).unwrap();
    for line in [
        "white        diffuse (0.5000 0.5000 0.5000), one-sided",
        "lamp         emits (3.0000 2.0000 1.0000) W m^-2 sr^-1 from both sides",
        "pane         thin glass (1.0000 1.0000 1.0000) ior 1.4 roughness 0.2500",
        "clear        glass (1.0000 0.5000 0.2500) ior 1.5",
    ] {
        assert!(text.lines().any(|l| l.trim() == line), "{line}: {text}");
    }
}

/// Who set the size in the scene file has given no --element-size.
#[test]
fn too_many_elements_name_the_key_of_the_scene_file() {
    let room = Files::new(&format!("{CAMERA}{MATERIALS}[radiosity]\nelement_size = 1e-9\n"), ROOM);
    let key = ["scene.toml: [radiosity] element_size: ", "choose a larger element_size there"];
    room.fails(&["render", "scene.toml", "-o", "a.exr"], 1, &key);
    room.fails(&["render", "scene.toml", "-o", "a.exr", "--adaptive"], 1, &key);
    room.fails(&["solve", "scene.toml", "-o", "a.npz"], 1, &key);
    room.fails(&["form-factors", "scene.toml", "-o", "a.npz"], 1, &key);
    room.fails(&["info", "scene.toml"], 1, &key);
    let given = ["solve", "scene.toml", "-o", "a.npz", "--element-size", "1e-8"];
    room.fails(&given, 2, &["choose a larger --element-size"]);
    room.done(&[&["solve", "scene.toml", "-o", "a.npz"], &QUICK[..]].concat());
}

#[test]
fn options_of_glossy_lobes_need_one() {
    let render = ["render", "scene.toml", "-o", "a.exr", "--size", "2x2", "--spp", "1", "--lobe", "frustum"];
    let plain = Files::room().done(&[&render[..], &QUICK].concat()).stderr;
    assert!(plain.contains("--lobe has no effect: the scene has no glossy surface"), "{plain}");
    let glossy = format!("{CAMERA}{MATERIALS}specular = 0.2\nroughness = 0.3\n");
    let glossy = Files::new(&glossy, ROOM).done(&[&render[..], &QUICK].concat()).stderr;
    assert!(!glossy.contains("no effect"), "{glossy}");
}

/// What a camera sees on its way counts, here the inside of a second, dark box.
#[test]
fn info_and_solve_have_the_same_elements() {
    // Its vertices follow the twelve of the room and its panel.
    let later = |k: &str| format!(" {}", k.parse::<u32>().unwrap() + 12);
    let moved = |line: &str| match line.split_once(' ') {
        Some(("v", at)) => format!("v 1{at}\n"),
        Some(("f", ids)) => format!("f{}\n", ids.split(' ').map(later).collect::<String>()),
        _ => format!("{}\n", line.replace("cube", "far")),
    };
    let far: String = ROOM.lines().take_while(|l| *l != "o panel").map(moved).collect();
    let keys = "[[camera.keyframe]]\nframe = 1\n[[camera.keyframe]]\nframe = 2\n\
        origin = [10.5, 0.4, 0.95]\ntarget = [10.5, 0.4, 0]\n";
    let files = Files::new(&format!("{CAMERA}{keys}{MATERIALS}"), &format!("{ROOM}{far}"));
    files.done(&[&["solve", "scene.toml", "-o", "s.npz", "--report", "r.json"], &QUICK[..]].concat());
    let report: serde_json::Value = serde_json::from_slice(&fs::read(files.path("r.json")).unwrap()).unwrap();
    let elements = report["elements"].as_u64().unwrap();
    assert_eq!(elements, 2 * 6 * 4 + 1, "both boxes, and the black lamp for its power");
    let run = files.done(&["info", "scene.toml", "--element-size", "0.5", "--seed", "3"]);
    let text = String::from_utf8(run.stdout).unwrap();
    assert!(text.contains(&format!("elements      {elements} of at most 0.5 m\n")), "{text}");
    assert!(text.contains("), keyframes from frame 1 to 2\n"), "{text}");
    files.fails(&["info", "scene.toml", "--rays", "7"], 2, &["--rays"]);
}

/// Unit squares face to face, and a smaller one half-way between them.
const BLOCKED: &str = "o a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n\
    o b\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 5 8 7 6\n\
    o shelf\nv 0.25 0.25 0.5\nv 0.75 0.25 0.5\nv 0.75 0.75 0.5\nv 0.25 0.75 0.5\nf 9 10 11 12\n";

#[test]
fn analytic_factors_ignore_what_lies_between_and_say_so() {
    let files = Files::new("", BLOCKED);
    let base = ["form-factors", "room.obj", "--method", "analytic"];
    let run = files.done(&[&base[..], &["--by-object"]].concat());
    let table: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let factor = |a: usize, b: usize| table["form_factors"][a][b].as_f64().unwrap();
    assert!((factor(0, 1) / 0.19982489569838738 - 1.0).abs() < 1e-12, "{}", factor(0, 1));
    // The shelf's front sees b alone, and a its back.
    assert!(factor(2, 1) > 0.5 && factor(0, 2) == 0.0);
    assert_eq!(table["standard_errors"][0][1], 0.0);
    assert_eq!(run.stderr.matches("occlusion is ignored").count(), 1, "{}", run.stderr);
    let said = run.stderr.lines().find(|l| l.contains("occlusion is ignored")).unwrap();
    assert!(said.contains("\"a\" - \"b\"") && !said.contains("\"shelf\""), "{said}");
    files.done(&[&base[..], &["--element-size", "0.25", "-o", "f.npz"]].concat());
    assert!(files.path("f.npz").exists());
    files.fails(
        &[&base[..], &["--element-size", "0.001", "-o", "g.npz"]].concat(),
        2,
        &["--element-size", "elements"],
    );
}

#[test]
fn asked_errors_are_reported() {
    let files = Files::new("", BLOCKED);
    let base = ["form-factors", "room.obj", "--by-object", "--element-size", "9", "--rays", "16"];
    let run = files.done(&[&base[..], &["--error", "1e-3", "--report", "r.json"]].concat());
    let table: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let factor = table["form_factors"][0][1].as_f64().unwrap();
    let error = table["standard_errors"][0][1].as_f64().unwrap();
    assert!(error > 0.0 && error <= 1e-3 * factor, "{factor} {error}");
    assert!((factor / 0.09950629459898479 - 1.0).abs() < 4e-3, "{factor}");
    let report: serde_json::Value = serde_json::from_slice(&fs::read(files.path("r.json")).unwrap()).unwrap();
    assert!(report["form_factors"]["largest_relative_error"].as_f64().unwrap() <= 1e-3);
    assert_eq!(report["form_factors"]["pairs"]["cells"], 1);
    let run = files.done(&[&base[..], &["--error", "1e-9"]].concat());
    assert_eq!(run.stderr.matches("--error 0.000000001 not met").count(), 1, "{}", run.stderr);
    for bad in ["0", "2", "-1", "x"] {
        files.fails(&[&base[..], &["--error", bad]].concat(), 2, &["--error"]);
    }
}
