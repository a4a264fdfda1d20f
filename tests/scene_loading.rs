//! Scene files as users write them: what is read, and what is said about what cannot be.

use std::path::{Path, PathBuf};
use twopass::scene::{Scene, load};

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
const CAMERA: &str = "[camera]\norigin = [0, 0, 5]\ntarget = [0, 0, 0]\n";

/// Loads the first of `files` from a directory that holds them all.
fn load_files(files: &[(&str, &str)]) -> Result<Scene, String> {
    let directory = tempfile::tempdir().expect("temporary directory");
    for (name, text) in files {
        std::fs::write(directory.path().join(name), text).expect("temporary file");
    }
    load(&directory.path().join(files[0].0)).map_err(|e| e.to_string())
}

fn load_obj(text: &str) -> Result<Scene, String> {
    load_files(&[("s.obj", text)])
}

fn load_toml(text: &str) -> Result<Scene, String> {
    let text = format!("geometry = [\"s.obj\"]\n{text}");
    load_files(&[("s.toml", &text), ("s.obj", SQUARE), ("s.mtl", "")])
}

fn load_mtl(text: &str) -> Result<Scene, String> {
    let obj = format!("mtllib s.mtl\nusemtl m\n{SQUARE}");
    load_files(&[("s.obj", &obj), ("s.mtl", text)])
}

#[track_caller]
fn assert_error(result: Result<Scene, String>, parts: &[&str]) {
    let message = result.expect_err("an error");
    for part in parts {
        assert!(message.contains(part), "\"{message}\" should contain \"{part}\"");
    }
}

#[track_caller]
fn assert_warning(scene: &Scene, parts: &[&str]) {
    let found = scene.warnings.iter().filter(|w| parts.iter().all(|p| w.contains(p))).count();
    assert_eq!(found, 1, "one warning with {parts:?} among {:#?}", scene.warnings);
}

fn area(scene: &Scene) -> f64 {
    scene.faces.iter().map(|f| f.area).sum()
}

#[test]
fn malformed_obj_names_file_and_line() {
    let cases: &[(&str, &[&str])] = &[
        ("v 0 0 0\nv 1 0\n", &["s.obj:2", "3 coordinates", "found 2"]),
        ("v 0 0 zero\n", &["s.obj:1", "\"zero\" is not a number"]),
        ("v 0 0 0\n\nv 0 nan 0\n", &["s.obj:3", "nan is not a finite number"]),
        ("v 0 inf 0\n", &["s.obj:1", "not a finite number"]),
        ("v 0 1e999 0\n", &["s.obj:1", "1e999 is not a finite number"]),
        ("v 0 2e18 0\n", &["s.obj:1", "too large"]),
        ("v 0 1 0 0\n", &["s.obj:1", "weight"]),
        ("vn 0 1\n", &["s.obj:1", "vn needs 3"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", &["s.obj:4", "vertex index 0"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", &["s.obj:4", "vertex index 4", "3 vertices"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n", &["s.obj:4", "vertex index -4", "3 vertices"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1\n", &["s.obj:4", "normal index 1", "0 normals"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/-1 2/-1 3/-1\n", &["s.obj:4", "texture coordinate index -1"]),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/0 2/0 3/0\n", &["s.obj:4", "texture coordinate index 0"]),
        ("v 0 0 0\nv 1 0 0\nf 1 2\n", &["s.obj:3", "at least 3 vertices, found 2"]),
        ("f\n", &["s.obj:1", "at least 3 vertices, found 0"]),
        ("v 0 0 0\nf 1 1.5 1\n", &["s.obj:2", "\"1.5\" is not a vertex"]),
        ("v 0 0 0\nf 1/1/1/1 1 1\n", &["s.obj:2", "\"1/1/1/1\""]),
        ("v 0 0 0\nf //1 1 1\n", &["s.obj:2", "\"//1\""]),
        ("v 0 0 0\nf 1 99999999999999999999 1\n", &["s.obj:2", "99999999999999999999"]),
        ("usemtl\n", &["s.obj:1", "usemtl"]),
        ("mtllib\n", &["s.obj:1", "mtllib"]),
        ("", &["s.obj", "no faces"]),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", &["s.obj", "no faces", "area"]),
    ];
    for (text, parts) in cases {
        assert_error(load_obj(text), parts);
    }
}

#[test]
fn malformed_mtl_names_file_line_and_material() {
    let cases: &[(&str, &[&str])] = &[
        ("Kd 1 1 1\n", &["s.mtl:1", "before any newmtl"]),
        ("newmtl\n", &["s.mtl:1", "without a name"]),
        ("newmtl m\nKd 1 1\n", &["s.mtl:2", "\"m\"", "Kd needs 3 numbers, found 2"]),
        ("newmtl m\nKd\n", &["s.mtl:2", "\"m\"", "found 0"]),
        ("newmtl m\nKd spectral a.rfl 1\n", &["s.mtl:2", "spectral"]),
        ("newmtl m\nKd 0.1 -0.2 0.3\n", &["s.mtl:2", "\"m\"", "negative", "-0.2"]),
        ("newmtl m\n\nKe nan 0 0\n", &["s.mtl:3", "\"m\"", "Ke must be finite"]),
        ("newmtl m\n\nKe 1e39 0 0\n", &["s.mtl:3", "\"m\"", "Ke must be at most 1e30"]),
        ("newmtl m\nNs x\n", &["s.mtl:2", "\"m\"", "\"x\" is not a number"]),
        ("newmtl m\nNs\n", &["s.mtl:2", "\"m\"", "Ns has no value"]),
        ("newmtl m\nNi -1\n", &["s.mtl:2", "Ni", "-1"]),
        ("newmtl m\nPr 1.5\n", &["s.mtl:2", "Pr", "[0, 1]", "1.5"]),
        ("newmtl m\nd 2\n", &["s.mtl:2", "[0, 1]"]),
        ("newmtl m\nillum 2.5\n", &["s.mtl:2", "whole number"]),
        ("newmtl m\nillum 11\n", &["s.mtl:2", "[0, 10]"]),
    ];
    for (text, parts) in cases {
        assert_error(load_mtl(text), parts);
    }
}

#[test]
fn malformed_scene_file_names_file_line_and_part() {
    // `load_toml` puts the geometry on line 1.
    let camera = |entry: &str| format!("{CAMERA}{entry}\n");
    let material = |entry: &str| format!("[materials.\"red\"]\n{entry}\n");
    let cases: Vec<(String, &[&str])> = vec![
        ("unit = \n".into(), &["s.toml:2"]),
        ("unit = 0\n".into(), &["s.toml:2", "unit must be above 0"]),
        ("unit = -1.5\n".into(), &["s.toml:2", "unit must be above 0", "-1.5"]),
        ("unit = nan\n".into(), &["s.toml:2", "unit", "finite"]),
        ("unit = \"mm\"\n".into(), &["s.toml:2", "unit must be a number", "\"mm\""]),
        ("camera = 3\n".into(), &["s.toml:2", "camera must be a table"]),
        ("[camera]\ntarget = [0, 0, 0]\n".into(), &["s.toml:2", "camera \"camera\"", "no origin"]),
        (
            "[camera]\nname = \"a\"\norigin = [0, 0]\n".into(),
            &["s.toml:4", "camera \"a\"", "3 numbers, found 2"],
        ),
        (camera("fov = 180"), &["s.toml:5", "camera \"camera\"", "fov", "180"]),
        (camera("fov = 0"), &["s.toml:5", "fov"]),
        (camera("fov = inf"), &["s.toml:5", "fov", "finite"]),
        (camera("size = [0, 5]"), &["s.toml:5", "size", "from 1"]),
        (camera("size = [512, 512.5]"), &["s.toml:5", "size", "whole number"]),
        (camera("size = 512"), &["s.toml:5", "size must be a list of 2 whole numbers"]),
        (camera("up = [0, 0, 1]"), &["s.toml:2", "camera \"camera\"", "up"]),
        (camera("up = [0, 0, 0]"), &["s.toml:2", "camera \"camera\"", "up must not be zero"]),
        ("[camera]\norigin = [1, 2, 3]\ntarget = [1, 2, 3]\n".into(), &["camera \"camera\"", "same point"]),
        (material("diffuse = [nan, 0, 0]"), &["s.toml:3", "material \"red\"", "diffuse", "finite"]),
        (material("diffuse = [0, inf, 0]"), &["s.toml:3", "material \"red\"", "diffuse", "finite"]),
        (material("diffuse = [0, -0.1, 0]"), &["s.toml:3", "material \"red\"", "negative"]),
        (material("diffuse = [0, 0]"), &["s.toml:3", "material \"red\"", "3 numbers, found 2"]),
        (material("diffuse = \"red\""), &["s.toml:3", "material \"red\"", "3 numbers, or one number"]),
        (material("emission = -1"), &["s.toml:3", "material \"red\"", "emission", "negative"]),
        (material("emission = [1, 1e39, 1]"), &["s.toml:3", "material \"red\"", "emission", "at most 1e30"]),
        (material("roughness = 1.01"), &["s.toml:3", "material \"red\"", "roughness", "[0, 1]"]),
        (material("ior = 0"), &["s.toml:3", "material \"red\"", "ior must be above 0"]),
        (material("two_sided = 1"), &["s.toml:3", "material \"red\"", "true or false"]),
        ("[materials]\nred = 1\n".into(), &["s.toml:3", "red must be a table"]),
        ("[environment]\nradiance = [0, 0, -1]\n".into(), &["s.toml:3", "environment", "negative"]),
        ("[radiosity]\nelement_size = 0\n".into(), &["s.toml:3", "element_size must be above 0"]),
        ("[radiosity]\nrays = 0\n".into(), &["s.toml:3", "rays", "from 1"]),
        ("[radiosity]\nrays = 4294967295\n".into(), &["s.toml:3", "rays", "to 1073741824"]),
        ("[render]\nspp = 1.5\n".into(), &["s.toml:3", "spp must be a whole number"]),
        ("[render]\nquality = \"best\"\n".into(), &["s.toml:3", "mesh, direct, gather", "best"]),
    ];
    for (text, parts) in &cases {
        assert_error(load_toml(text), parts);
    }
    let twice = "[[camera]]\nname = \"a\"\norigin = [0, 0, 1]\ntarget = [0, 0, 0]\n".repeat(2);
    assert_error(load_toml(&twice), &["s.toml:6", "second camera \"a\""]);
}

#[test]
fn missing_files_are_named() {
    assert_error(load(Path::new("absent.toml")).map_err(|e| e.to_string()), &["absent.toml"]);
    assert_error(load(Path::new("absent.obj")).map_err(|e| e.to_string()), &["absent.obj"]);
    assert_error(load_files(&[("s.txt", "")]), &["s.txt", ".toml", ".obj"]);
    assert_error(load_files(&[("s.toml", "unit = 1\n")]), &["s.toml", "geometry"]);
    assert_error(load_files(&[("s.toml", "geometry = []\n")]), &["s.toml:1", "no file"]);
    assert_error(load_files(&[("s.toml", "geometry = \"s.obj\"\n")]), &["s.toml:1", "a list of strings"]);
    assert_error(load_files(&[("s.toml", "geometry = [\n\"gone.obj\"]\n")]), &["s.toml:2", "gone.obj"]);
    let scene = load_obj(&format!("mtllib gone.mtl\nusemtl red\n{SQUARE}")).unwrap();
    assert_warning(&scene, &["s.obj:1", "gone.mtl"]);
    assert_warning(&scene, &["\"red\"", "nowhere"]);
    assert_eq!(scene.materials[0].diffuse.to_array(), [0.5; 3]);
}

#[test]
fn damaged_bytes_are_an_error_and_never_a_panic() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("s.toml");
    std::fs::write(&path, b"unit = 1\n# \xff\n").unwrap();
    assert_error(load(&path).map_err(|e| e.to_string()), &["s.toml:2", "UTF-8"]);

    // Every truncation and many single-byte changes of a file that uses all statements.
    let text = "mtllib s.mtl\no a\nv 0 0 0\nv 1 0 0 1\nv 1 1 0 1 1 1\nv 0 1 0\nvn 0 0 1\nvt 0 0\n\
                usemtl m # c\nf 1/1/1 2//1 -2/1 4\ng b c\nl 1 2 3\ns off\nf 3 2 \\\n1\n";
    assert!(load_obj(text).is_ok());
    for end in 0..text.len() {
        let _ = load_obj(&text[..end]);
    }
    for at in 0..text.len() {
        for byte in *b" /-#9x\n\\" {
            let mut bytes = text.as_bytes().to_vec();
            bytes[at] = byte;
            let _ = load_obj(&String::from_utf8(bytes).unwrap());
        }
    }
    let mtl = "newmtl m # x\nKd 1 1 1\nTf 1\nd -halo 0.5\nillum 7\nPr 0.5\nmap_Kd a.png\n";
    let toml =
        format!("unit = 0x10\n{CAMERA}size = [8, 8]\n[materials.\"\\u00e9\"]\ndiffuse = [1, 0.5, 1e-3]\n");
    assert!(load_mtl(mtl).is_ok() && load_toml(&toml).is_ok());
    for (text, load) in [(mtl, load_mtl as fn(&str) -> _), (&toml, load_toml)] {
        for at in 0..text.len() {
            let _ = load(&text[..at]);
            for change in ["", "\u{e9}", "[", "\"", "9"] {
                let _ = load(&format!("{}{change}{}", &text[..at], &text[at + 1..]));
            }
        }
    }
}

/// What led to it would be lost with the scene: it is told in the error.
#[test]
fn files_without_faces_say_what_they_are() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n0 0 0\n1 0 0\n2 0 0\n";
    let cases: &[(&str, &[&str])] = &[
        ("", &["s.obj: no faces: ", "(f 1 2 3)"]),
        (
            "v 0 0 0\nv 1 0 0\nl 1 2\n",
            &["no faces: points and lines", "1 point and line elements were skipped"],
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nF 1 2 3\n",
            &["no faces: keywords are in lower case", "s.obj:4: statement \"F\"", "did you mean \"f\"?"],
        ),
        (ply, &["no faces: this is a PLY file", "statement \"ply\"", "and 3 more warnings"]),
        ("newmtl a\nKd 1 1 1\n", &["no faces: this is a library of materials", "mtllib"]),
        ("solid a\nendsolid a\n", &["no faces: this is an STL file"]),
        ("v 0 0 0\n", &["no faces: there are vertices alone"]),
        (
            "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
            &["no faces: none of them has an area", "1 face of zero area dropped"],
        ),
    ];
    for (text, parts) in cases {
        assert_error(load_obj(text), parts);
    }
    let toml = "geometry = [\"a.obj\", \"s.obj\"]\n";
    let scene = load_files(&[("s.toml", toml), ("a.obj", "v 0 0 0\nl 1 1\n"), ("s.obj", SQUARE)]).unwrap();
    assert_warning(&scene, &["a.obj: no faces: points and lines"]);
}

#[test]
fn obj_reads_what_real_files_hold() {
    let text = "\u{feff}# comment\r\n\to first\r\nv 0 0 0 # origin\r\nv\t1 0\t0\r\nv 1 1 0#corner\r\nv 0 1 0 1 0 0\r\n\
                v 4 4 2 2\r\nusemtl\tred paint\r\nf 1 2 \\\r\n 3 4 # square\r\nl 1 2 3\r\np 1\r\ns 1\r\n\
                f -5 -4 -1\r\ng second # half\r\ng empty\r\no first\r\nf 2 5 3";
    let scene = load_obj(text).unwrap();
    assert_eq!(scene.objects, ["first"]);
    assert_eq!(scene.materials.len(), 1);
    assert_eq!(scene.materials[0].name, "red paint");
    assert_eq!((scene.faces.len(), scene.triangle_count, scene.polygon_count), (3, 2, 3));
    // The weighted vertex is (2, 2, 1).
    assert_eq!((scene.center * 2.0).to_array(), [2.0, 2.0, 1.0]);
    assert!((area(&scene) - (1.0 + 0.5 * 5f64.sqrt() + 0.5 * 2f64.sqrt())).abs() < 1e-12, "{}", area(&scene));
    assert_warning(&scene, &["2 point and line elements"]);
}

#[test]
fn objects_keep_the_order_of_their_names_and_merge() {
    let face = |z: i32| format!("v 0 0 {z}\nv 1 0 {z}\nv 0 1 {z}\nf -3 -2 -1\n");
    let text =
        format!("{}o b\n{}g a\nusemtl x\n{}usemtl y\n{}o b\n{}", face(0), face(1), face(2), face(3), face(4));
    let scene = load_obj(&text).unwrap();
    assert_eq!(scene.objects, ["unnamed", "b", "a"]);
    let objects: Vec<_> = scene.faces.iter().map(|f| f.object).collect();
    assert_eq!(objects, [0, 1, 2, 2, 1]);
    let names: Vec<_> = scene.faces.iter().map(|f| scene.material(f).name.as_str()).collect();
    assert_eq!(names, ["default", "default", "x", "y", "y"]);
    assert_warning(&scene, &["2 faces have no material"]);
}

#[test]
fn objects_of_several_files_stay_apart() {
    let (one, two) =
        (format!("o box\n{SQUARE}o own\n{SQUARE}"), format!("o box\n{SQUARE}").replace(" 0\n", " 7\n"));
    let toml = "geometry = [\"one.obj\", \"two.obj\"]\n";
    let scene = load_files(&[("s.toml", toml), ("one.obj", &one), ("two.obj", &two)]).unwrap();
    // The face of "own" repeats that of "box": it goes, and its object with it.
    assert_eq!(scene.objects, ["box@one", "box@two"]);
    assert_warning(&scene, &["one.obj:12", "1 face dropped that repeats", "\"own\""]);
    assert_eq!(scene.faces.len(), 2);
}

#[test]
fn unit_scales_and_distance_does_not_matter() {
    let far = SQUARE.replace("v 0", "v 100000000").replace("v 1 ", "v 100000001 ");
    let toml = "geometry = [\"s.obj\"]\nunit = 0.001\n[radiosity]\nelement_size = 0.5\n";
    let scene = load_files(&[("s.toml", toml), ("s.obj", &far)]).unwrap();
    assert_eq!(scene.radiosity.element_size, Some(0.0005));
    assert!((scene.center.x - 100_000.000_5).abs() < 1e-9);
    assert!((area(&scene) - 1e-6).abs() < 1e-6 * 1e-6);
    assert!((scene.radius - 0.5e-3 * 2f64.sqrt()).abs() < 1e-10);
    assert!(scene.vertices.iter().all(|v| (v.x.abs() - 0.0005).abs() < 1e-10));
}

#[test]
fn faces_that_cannot_count_are_dropped_with_one_warning() {
    let text = format!("o thing\n{SQUARE}f 4 3 2 1\nf 1 1 2\nf 1 2 1 2\nf 3 4 1 2\n");
    let scene = load_obj(&text).unwrap();
    assert_eq!((scene.faces.len(), scene.polygon_count), (1, 1));
    assert_warning(&scene, &["s.obj:8", "2 faces of zero area", "\"thing\": 2"]);
    assert_warning(&scene, &["s.obj:7", "2 faces dropped that repeat"]);

    // A triangle that repeats half of a split quad.
    let scene = load_obj("v 0 0 0\nv 2 0 0\nv 0.3 1 0\nv 0 1 0\nf 1 2 3 4\nf 3 1 2\n").unwrap();
    assert_eq!((scene.faces.len(), scene.polygon_count), (2, 1));
    assert_warning(&scene, &["s.obj:6", "1 face dropped that repeats"]);
}

#[test]
fn faces_lost_to_single_precision_are_counted() {
    let speck = "v 1e6 0 0\nv 1000000.001 0 0\nv 1e6 0.001 0\nf -3 -2 -1\n";
    let scene = load_obj(&format!("{SQUARE}{speck}")).unwrap();
    assert_eq!(scene.faces.len(), 2);
    assert_warning(&scene, &["1 face is", "single precision"]);
}

#[test]
fn a_library_named_twice_is_read_once() {
    let obj = format!("mtllib s.mtl\nmtllib s.mtl gone.mtl\nusemtl m\n{SQUARE}");
    let scene = load_files(&[("s.obj", &obj), ("s.mtl", "newmtl m\nmap_Kd a.png\n")]).unwrap();
    assert_warning(&scene, &["s.mtl:2", "map_Kd"]);
    assert_warning(&scene, &["s.obj:2", "gone.mtl"]);
}

#[test]
fn a_library_whose_name_has_a_space() {
    let obj = format!("mtllib no such.mtl\nusemtl m\n{SQUARE}");
    let scene = load_obj(&obj).unwrap();
    assert_warning(&scene, &["material library"]);
    assert_warning(&scene, &["s.obj:1", "\"no such.mtl\" not found"]);
    let red = "newmtl m\nKd 0.25 0 0\n";
    for file in ["no such.mtl", "such.mtl"] {
        let scene = load_files(&[("s.obj", &obj), (file, red)]).unwrap();
        assert_eq!(scene.materials[0].diffuse.to_array(), [0.25, 0.0, 0.0], "{file}");
        let missing = usize::from(file == "such.mtl");
        assert_eq!(scene.warnings.iter().filter(|w| w.contains("material library")).count(), missing);
    }
}

#[test]
fn carriage_returns_alone_end_lines() {
    let obj = format!("# a square\nmtllib s.mtl\no a\nusemtl m\n{SQUARE}wrong 1\n");
    let mtl = "newmtl m\n# half\nKd 0.25 0.5 0.75\n";
    for (ends, both) in [("\n", true), ("\r\n", true), ("\r", true), ("\r", false)] {
        let (obj, mtl) = (obj.replace('\n', ends), if both { mtl.replace('\n', ends) } else { mtl.into() });
        let scene = load_files(&[("s.obj", &obj), ("s.mtl", &mtl)]).unwrap();
        assert_eq!(scene.materials[0].diffuse.to_array(), [0.25, 0.5, 0.75], "{ends:?}");
        assert_eq!((area(&scene), scene.objects.as_slice()), (1.0, &["a".to_string()][..]), "{ends:?}");
        assert_warning(&scene, &["s.obj:10", "\"wrong\""]);
    }
    assert_error(load_obj("v 0 0 0\r\rv 1 0\r"), &["s.obj:3", "found 2"]);
}

/// Objects are told apart by the last `o` or `g` alone, and who names groups alike in several `o` is told.
#[test]
fn groups_of_one_name_in_several_objects_are_told() {
    let square = |z: usize| {
        let k = 4 * z;
        let face = format!("f {} {} {} {}\n", k + 1, k + 2, k + 3, k + 4);
        format!("v 0 0 {z}\nv 1 0 {z}\nv 1 1 {z}\nv 0 1 {z}\n{face}")
    };
    let scene = |heads: &[&str]| {
        let text: String =
            heads.iter().enumerate().map(|(k, head)| format!("{head}\n{}", square(k))).collect();
        load_obj(&text).unwrap()
    };
    let chairs = scene(&["o chair1\ng seat", "o chair2\ng seat", "g back", "o chair3\ng seat", "g back"]);
    assert_eq!(chairs.objects, ["seat", "back"]);
    assert_warning(&chairs, &["group \""]);
    assert_warning(
        &chairs,
        &["s.obj:9: ", "\"seat\" is in 3 objects (\"chair1\", \"chair2\", \"chair3\")", "1 other group"],
    );
    // An object goes on under its name, and groups without any `o` do.
    for heads in [&["o a\ng x", "g y", "o a\ng x"][..], &["g x", "g y", "g x"], &["o a", "o b", "o a\ng a"]] {
        let scene = scene(heads);
        assert_eq!(scene.objects.len(), 2, "{heads:?}");
        assert!(!scene.warnings.iter().any(|w| w.contains("group")), "{heads:?}: {:?}", scene.warnings);
    }
    assert_warning(
        &scene(&["o seat", "o chair\ng seat"]),
        &["\"seat\" is in 2 objects (\"seat\", \"chair\")"],
    );
}

#[test]
fn shading_normals_are_kept_where_they_say_something() {
    let corners = "v 0 0 0\nv 2 0 0\nv 0 2 0\nv 0 0 5\nv 2 0 5\nv 0 2 5\n";
    let scene = |normals: &str, face: &str| load_obj(&format!("{corners}{normals}{face}")).unwrap();
    let smooth = scene("vn 0 0 2\nvn 0 1 1\n", "f 1//1 2//2 3//1\nf 4 5 6\n");
    assert_eq!(smooth.normals.len(), 2);
    let normals = smooth.faces[0].normals.unwrap().map(|n| smooth.normals[n as usize]);
    assert_eq!(normals[0].to_array(), [0.0, 0.0, 1.0]);
    assert!((normals[1].y - 0.5f64.sqrt()).abs() < 1e-12 && normals[2] == normals[0]);
    assert_eq!(smooth.faces[1].normals, None);

    assert_eq!(scene("vn 0 0 2\n", "f 1//1 2//1 3//1\n").faces[0].normals, None);
    // A corner without a normal: none of the face's count.
    assert_eq!(scene("vn 0 1 1\n", "f 1//1 2//1 3\n").faces[0].normals, None);
    let zero = scene("vn 0 0 0\nvn 0 1 1\n", "f 1//2 2//1 3//2\n");
    assert_eq!(zero.faces[0].normals, None);
    assert_warning(&zero, &["s.obj:9", "shading normal's direction"]);
    let averted = scene("vn 0 0 -1\n", "f 1//1 2//1 3//1\nf 4//1 5//1 6//1\n");
    assert_eq!(averted.faces[0].normals, None);
    assert_warning(&averted, &["s.obj:8", "2 faces", "points away"]);
}

#[test]
fn scene_file_overrides_and_adds_materials() {
    let toml = "geometry = [\"s.obj\"]\n[materials.\"red\"]\nspecular = 0.25\nroughness = 0.5\n\
                [materials.added]\nemission = [1, 2, 3]\nemit_both_sides = true\ntwo_sided = false\n\
                [materials.unused]\n[materials.reed]\ndifuse = 1\n";
    let obj = format!("mtllib s.mtl\nusemtl red\n{SQUARE}v 0 0 1\nusemtl added\nf 1 2 5\n");
    let mtl = "newmtl red\nKd 0.5 0.25 0\nillum 1\n";
    let scene = load_files(&[("s.toml", toml), ("s.obj", &obj), ("s.mtl", mtl)]).unwrap();
    let [red, added] = &scene.materials[..] else { panic!("{:?}", scene.materials) };
    assert_eq!((red.diffuse.to_array(), red.specular.to_array()), ([0.5, 0.25, 0.0], [0.25; 3]));
    assert_eq!(red.alpha(), 0.25);
    assert_eq!(added.emission.to_array(), [1.0, 2.0, 3.0]);
    assert!(added.emit_both_sides && !added.two_sided && added.diffuse.to_array() == [0.0; 3]);
    assert_warning(&scene, &["s.toml:9", "no face has material \"unused\""]);
    assert_warning(&scene, &["s.toml:10", "no face has material \"reed\"", "did you mean \"red\""]);
    assert_warning(&scene, &["s.toml:11", "\"reed\"", "\"difuse\"", "did you mean \"diffuse\""]);
    assert_eq!(scene.warnings.len(), 3, "{:?}", scene.warnings);
}

/// Light comes out on the other side of what lets it through: one side alone cannot be black. What is opaque may be one-sided.
#[test]
fn what_lets_light_through_has_two_sides() {
    for (entries, ignored) in [
        ("diffuse = 0.2\ndiffuse_transmission = 0.7", true),
        ("specular_transmission = 1\nthin = true", true),
        ("specular_transmission = 0.9\nior = 1", true),
        ("specular_transmission = 1", true),
        ("diffuse = 0.5\nspecular = 0.4", false),
    ] {
        let scene = |more: &str| {
            let toml = format!("geometry = [\"s.obj\"]\n[materials.pane]\n{entries}\n{more}\n");
            load_files(&[("s.toml", &toml), ("s.obj", &format!("usemtl pane\n{SQUARE}"))]).unwrap()
        };
        let (one, two) = (scene("two_sided = false"), scene(""));
        assert_eq!(one.materials == two.materials, ignored, "{entries}");
        assert_eq!(one.materials[0].two_sided, ignored, "{entries}");
        assert_eq!(one.warnings.len(), usize::from(ignored), "{:?}", one.warnings);
        if ignored {
            assert_warning(
                &one,
                &["s.toml:2", "\"pane\"", "lets light through", "two_sided = false is ignored"],
            );
        }
    }
}

#[test]
fn unknown_keys_are_warned_about_everywhere() {
    let toml = "untis = 1\n[camera]\norigin = [0, 0, 5]\ntarget = [0, 0, 0]\nfow = 40\n[environment]\ncolour = 1\n\
                [radiosity]\nray = 3\n[render]\nqualty = 1\n[lights]\n";
    let scene = load_toml(toml).unwrap();
    for (line, key, hint) in [
        (2, "untis", "unit"),
        (6, "fow", "fov"),
        (8, "colour", "radiance"),
        (10, "ray", "rays"),
        (12, "qualty", "quality"),
        (13, "lights", "geometry"),
    ] {
        assert_warning(&scene, &[&format!("s.toml:{line}:"), &format!("\"{key}\""), hint]);
    }
}

#[test]
fn keys_of_materials_without_effect_are_named() {
    let obj = format!(
        "mtllib s.mtl\nusemtl plain\n{SQUARE}v 0 0 1\nusemtl glass\nf 1 2 5\nusemtl sheet\nf 2 3 5\n"
    );
    let mtl = "newmtl plain\nKd 0.5\nillum 1\nnewmtl glass\nillum 7\nnewmtl sheet\nd 0.5\nKd 0.2\n";
    let toml = |materials: &str| format!("geometry = [\"s.obj\"]\n{materials}");
    let load = |materials: &str| {
        let toml = toml(materials);
        load_files(&[("s.toml", &toml), ("s.obj", &obj), ("s.mtl", mtl)]).unwrap()
    };
    let idle = load(
        "[materials.plain]\nthin = true\nroughness = 0.3\nior = 1.5\nemit_both_sides = true\n\
         [materials.sheet]\nthin = true\nroughness = 0.1\n",
    );
    for (line, name, key, why) in [
        (3, "plain", "thin", "no specular_transmission"),
        (4, "plain", "roughness", "nothing to be rough"),
        (5, "plain", "ior", "no specular_transmission"),
        (6, "plain", "emit_both_sides", "no emission"),
        (8, "sheet", "thin", "ior = 1"),
        (9, "sheet", "roughness", "ior = 1"),
    ] {
        let place = format!("s.toml:{line}: material \"{name}\": {key} has no effect");
        assert_warning(&idle, &[&place, why]);
    }
    assert_eq!(idle.warnings.len(), 6, "{:?}", idle.warnings);
    let used = load(
        "[materials.plain]\nspecular = 0.2\nroughness = 0.3\nemission = 1\nemit_both_sides = true\n\
         [materials.glass]\nthin = true\nroughness = 0.1\nior = 1.3\n\
         [materials.sheet]\nthin = false\nroughness = 0\nior = 1.4\n",
    );
    assert_eq!(used.warnings, [""; 0]);
}

#[test]
fn too_much_reflection_is_scaled_after_overrides() {
    let toml = "geometry = [\"s.obj\"]\n[materials.m]\nspecular = [0.5, 0.5, 0.5]\n";
    let obj = format!("mtllib s.mtl\nusemtl m\n{SQUARE}");
    let scene =
        load_files(&[("s.toml", toml), ("s.obj", &obj), ("s.mtl", "newmtl m\nKd 0.75 0.5 0\n")]).unwrap();
    assert_warning(&scene, &["material \"m\"", "1.25"]);
    assert_eq!(scene.materials[0].diffuse.to_array(), [0.6, 0.4, 0.0]);
    assert_eq!(scene.materials[0].specular.to_array(), [0.4; 3]);
}

#[test]
fn cameras_are_found_by_name() {
    let toml = "[[camera]]\nname = \"front\"\norigin = [0, 0, 5]\ntarget = [0, 0, 0]\n\
                [[camera]]\norigin = [5, 0, 0]\ntarget = [0, 0, 0]\n";
    let scene = load_toml(toml).unwrap();
    assert_eq!(scene.camera(None).unwrap().name, "front");
    assert_eq!(scene.camera(Some("2")).unwrap().origin.x, 5.0);
    let message = scene.camera(Some("frnt")).unwrap_err().to_string();
    assert!(message.contains("did you mean \"front\"") && message.contains("front, 2"), "{message}");
    let message = load_obj(SQUARE).unwrap().camera(None).unwrap_err().to_string();
    assert!(message.contains("[camera]") && message.contains("s.obj"), "{message}");
}

/// Directory of the scenes with reference images, where it is at hand.
fn reference_scenes() -> Option<PathBuf> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes");
    if !directory.is_dir() {
        println!("skipped: no {}", directory.display());
    }
    directory.is_dir().then_some(directory)
}

#[test]
fn reference_scenes_have_their_faces_materials_and_objects() {
    let Some(directory) = reference_scenes() else { return };
    for (name, faces, triangles, polygons, materials, objects) in [
        ("mcguire/original.toml", 17, 2, 16, 8, 7),
        ("mcguire/mirror.toml", 17, 2, 16, 8, 7),
        ("ours/cornell_diffuse.toml", 46, 46, 46, 4, 16),
        ("ours/cornell_mirror.toml", 46, 46, 46, 5, 16),
        ("ours/cornell_glossy.toml", 46, 46, 46, 5, 16),
        ("mcguire/CornellBox-Sphere.obj", 2188, 2188, 2188, 8, 8),
    ] {
        let scene = load(&directory.join(name)).unwrap();
        assert_eq!(
            (scene.faces.len(), scene.triangle_count, scene.polygon_count),
            (faces, triangles, polygons),
            "{name}"
        );
        assert_eq!((scene.materials.len(), scene.objects.len()), (materials, objects), "{name}");
    }
}

#[test]
fn reference_mirrors_are_the_tall_boxes() {
    let Some(directory) = reference_scenes() else { return };
    for (name, material, faces, specular) in
        [("mcguire/mirror.toml", "tallBox", 5, 0.95), ("ours/cornell_mirror.toml", "mirror", 10, 0.9)]
    {
        let scene = load(&directory.join(name)).unwrap();
        let mirrors: Vec<_> = scene.faces.iter().filter(|f| scene.material(f).is_specular()).collect();
        assert_eq!(mirrors.len(), faces, "{name}");
        assert!(mirrors.iter().all(|f| scene.material(f).name == material));
        let mirror = scene.material(mirrors[0]);
        assert_eq!((mirror.specular.to_array(), mirror.roughness), ([specular; 3], 0.0));
    }
    // The published file's bottoms repeat a side of each box.
    let scene = load(&directory.join("mcguire/mirror.toml")).unwrap();
    assert_warning(&scene, &["CornellBox-Mirror.obj:108", "2 faces dropped that repeat"]);
}

#[test]
fn cornell_box_is_as_measured() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell/cornell.toml");
    let scene = load(&path).unwrap();
    assert_eq!(scene.warnings, [""; 0]);
    let names =
        ["floor", "ceiling", "light", "back_wall", "right_wall", "left_wall", "short_box", "tall_box"];
    assert_eq!(scene.objects, names);
    let area = |name: &str| -> f64 {
        scene.faces.iter().filter(|f| scene.objects[f.object as usize] == name).map(|f| f.area).sum()
    };
    assert!((area("light") - 0.13 * 0.105).abs() < 1e-12);
    assert!((area("ceiling") + area("light") - 0.556 * 0.5592).abs() < 1e-12);
    assert!((area("right_wall") - 0.5592 * 0.5488).abs() < 1e-12);
    assert!((area("floor") - 0.5 * (0.5528 + 0.5496) * 0.5592).abs() < 1e-12);
    let light = scene.faces.iter().find(|f| scene.material(f).is_emitter()).unwrap();
    assert!(!light.is_triangle() && light.normal.y == -1.0);
    // Every face looks into the room: the walls and the light towards the middle of the box.
    let middle = glam::DVec3::ZERO;
    for face in scene.faces.iter().filter(|f| !scene.objects[f.object as usize].ends_with("_box")) {
        assert!((middle - scene.corner(face, 0)).dot(face.normal) > 0.0, "{face:?}");
    }
}
