//! What `twopass form-factors` writes, read back as its users would.

mod common;

use common::factor_files::*;
use std::fs;
use std::process::Command;
use twopass::image::read;

/// One run, every format, one matrix.
#[test]
fn every_format_holds_the_same_matrix() {
    let room = Folder::room();
    let outputs =
        ["-o", "f.npz", "-o", "f.csv", "-o", "f.json", "-o", "f.vf", "-o", "f.png", "--report", "r.json"];
    room.done(&[&["--element-size", "0.5", "--rays", "256", "--quiet"], &outputs[..]].concat());
    let file = room.json("f.json");
    let n = file["elements"].as_u64().expect("elements") as usize;
    assert_eq!(n, 2 * (4 + 2 + 8));
    let (rows, areas) = (dense(&file), floats(&file["areas"]));
    for row in &rows {
        assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-6);
    }
    assert!((areas.iter().sum::<f64>() - 7.0).abs() < 1e-12);
    assert_eq!(file["written"], "raw");
    assert_eq!(file["standard_errors"].as_array().map(Vec::len), file["indices"].as_array().map(Vec::len));

    // CSV: header, then one line a pair above zero.
    let mut csv = csv::Reader::from_path(room.path("f.csv")).expect("CSV");
    let header = csv.headers().expect("header").iter().collect::<Vec<_>>().join(",");
    assert_eq!(header, "from,to,from_object,to_object,area_from,form_factor,standard_error");
    let mut count = 0;
    for record in csv.records() {
        let r = record.expect("record");
        let at = |k: usize| r[k].parse::<f64>().expect("number");
        let (i, j) = (at(0) as usize, at(1) as usize);
        assert_eq!(at(5), rows[i][j]);
        assert_eq!(at(4), areas[i]);
        assert!(at(6) >= 0.0);
        count += 1;
    }
    assert_eq!(count, file["indices"].as_array().map_or(0, Vec::len));

    // View3D's own reader: a header of at most 34 characters, then numbers.
    let text = fs::read_to_string(room.path("f.vf")).expect("f.vf");
    let (header, body) = text.split_once('\n').expect("header");
    assert!(header.len() < 35, "{header}");
    let fields: Vec<&str> = header.split_whitespace().collect();
    assert_eq!((fields.len(), fields[0]), (6, "twopass"));
    assert_eq!(&fields[2..], ["0", "0", "0", &n.to_string()]);
    let numbers: Vec<f64> = body.split_whitespace().map(|x| x.parse().expect("number")).collect();
    assert_eq!(numbers.len(), n + n * n + n);
    for i in 0..n {
        assert!((numbers[i] - areas[i]).abs() < 1e-9);
        for j in 0..n {
            assert!((numbers[n + i * n + j] - rows[i][j]).abs() < 1e-9);
        }
    }
    assert!(numbers[n + n * n..].iter().all(|e| (0.0..=1.0).contains(e)));

    let picture = read(&room.path("f.png")).expect("picture");
    assert!(picture.width > 1000 && picture.height > 1000 && picture.width < 2000);
    let report = room.json("r.json");
    assert_eq!(report["form_factors"]["written"], "raw");
    assert_eq!(report["form_factors"]["method"], "ray");
}

/// The four lines of Python that the README shows, with the real SciPy.
#[test]
fn scipy_loads_the_matrix() {
    let available = Command::new("python3").args(["-c", "import scipy.sparse"]).output();
    if !available.is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: python3 with SciPy is not there");
        return;
    }
    let room = Folder::room();
    room.done(&["--element-size", "0.5", "--rays", "256", "--quiet", "-o", "f.npz", "-o", "f.json"]);
    let script = "import json, numpy as np, scipy.sparse as sp\n\
        F = sp.load_npz('f.npz'); extra = np.load('f.npz'); want = json.load(open('f.json'))\n\
        assert F.shape == (28, 28) and F.format == 'csr' and F.dtype == np.float64 and F.has_sorted_indices\n\
        assert (F.data == want['form_factors']).all() and (F.indices == want['indices']).all() and (F.indptr == want['indptr']).all()\n\
        assert abs(np.asarray(F.sum(axis=1)).ravel() + extra['escaped'] - 1).max() < 1e-6\n\
        assert (extra['area'] == want['areas']).all() and (extra['standard_error'] == want['standard_errors']).all()\n\
        assert list(extra['objects']) == want['objects'] and (extra['object'] == want['object']).all()\n\
        assert extra['objects'].dtype.kind == 'U' and len(extra['object']) == 28\n\
        S = sp.csr_matrix((extra['area'], (extra['object'], range(28)))); T = S @ F @ sp.csr_matrix((np.ones(28), (range(28), extra['object'])))\n\
        T = T.toarray() / np.asarray(S.sum(axis=1)); assert abs(T.sum(axis=1) - 1).max() < 1e-6 and T.shape == (6, 6)\n\
        G = sp.diags(extra['area']) @ F\n\
        print(abs(G - G.T).max())\n";
    let output =
        Command::new("python3").current_dir(room.0.path()).args(["-c", script]).output().expect("python3");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn tables_of_objects() {
    let plates = Folder::plates();
    let stderr = plates.done(&[
        "--by-object",
        "-o",
        "t.json",
        "-o",
        "t.csv",
        "-o",
        "t.vf",
        "-o",
        "t.npz",
        "-o",
        "t.png",
    ]);
    assert!(stderr.matches("the enclosure is open").count() == 1, "{stderr}");
    assert!(stderr.contains("80.0") && stderr.contains("\"low\""), "{stderr}");
    let t = plates.json("t.json");
    assert_eq!(t["objects"], serde_json::json!(["low", "high"]));
    let f = floats(&t["form_factors"][0])[1];
    // Whatever the elements are: every pair is exact.
    assert!((f - 0.199_824_895_698_387_39).abs() < 1e-9, "{f}");
    let csv = fs::read_to_string(plates.path("t.csv")).expect("t.csv");
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[0], "from,to,area_from,form_factor,standard_error");
    assert_eq!(lines.len(), 1 + 2 * (2 + 2));
    assert!(lines[2].starts_with("low,high,") && lines[2].contains(&format!(",{f},")), "{}", lines[2]);
    let shares: f64 = lines[1..5]
        .iter()
        .map(|l| l.split(',').nth(3).expect("factor").parse::<f64>().expect("number"))
        .sum();
    assert!((shares - 1.0).abs() < 1e-6 && lines[3].starts_with("low,(escaped),"), "{csv}");
    assert!(fs::read_to_string(plates.path("t.vf")).expect("t.vf").starts_with("twopass "));

    // A closed room says nothing of it.
    assert!(!Folder::room().done(&["--by-object", "--element-size", "0.5", "-o", "t.json"]).contains("open"));

    // Both sides: the backs look at nothing.
    let stderr =
        plates.done(&["--by-object", "--two-sided", "--element-size", "0.5", "--rays", "64", "-o", "t.json"]);
    assert!(!stderr.contains("backs"), "{stderr}");
    let t = plates.json("t.json");
    assert_eq!(t["objects"], serde_json::json!(["low", "high", "low:back", "high:back"]));
    assert_eq!(floats(&t["escaped"])[2..], [1.0, 1.0]);
    assert!(floats(&t["areas"]).iter().all(|a| (a - 1.0).abs() < 1e-9));
}

/// Small areas and small factors keep their digits in View3D's format.
#[test]
fn view3d_files_hold_small_numbers() {
    let square = |z: f64| vec![[0.0, 0.0, z], [1e-5, 0.0, z], [1e-5, 1e-5, z], [0.0, 1e-5, z]];
    let down = square(0.1).into_iter().rev().collect();
    let tiny = Folder::new(&[("low", vec![square(0.0)]), ("high", vec![down])]);
    tiny.done(&["--element-size", "1", "--quiet", "-o", "t.vf", "-o", "t.json"]);
    let text = fs::read_to_string(tiny.path("t.vf")).expect("t.vf");
    let numbers: Vec<f64> =
        text.lines().skip(1).flat_map(str::split_whitespace).map(|x| x.parse().expect("number")).collect();
    let t = tiny.json("t.json");
    let (areas, rows) = (floats(&t["areas"]), dense(&t));
    let expected: Vec<f64> = areas.iter().chain(rows.iter().flatten()).copied().collect();
    assert!(areas[0] > 0.9e-10 && rows[0][1] > 3e-9, "{areas:?} {rows:?}");
    for (a, b) in numbers.iter().zip(&expected) {
        assert!((a - b).abs() <= 1e-8 * b, "{a} {b}: {text}");
    }
}

#[test]
fn options_without_effect_are_named() {
    let room = Folder::room();
    let (code, stderr) =
        room.run(&["--method", "analytic", "--rays", "9", "--floor", "0.1", "-o", "a.npz", "--quiet"]);
    assert_eq!(code, 0, "{stderr}");
    for option in ["--rays has no effect with --method analytic", "--floor has no effect without --error"] {
        assert_eq!(stderr.matches(option).count(), 1, "{stderr}");
    }
}

#[test]
fn requests_that_make_no_sense_are_refused_before_the_work() {
    let room = Folder::room();
    let png = ["-o", "a.png"];
    room.refuses(&["--rows", "5..5", "-o", "a.npz"], &["5..5", "A < B"]);
    room.refuses(&["--rows", "-1..5", "-o", "a.npz"], &["--rows"]);
    room.refuses(&["--rows", "0..9999999", "-o", "a.npz"], &["0..9999999", "elements, so rows go from 0 to"]);
    room.refuses(&["--rows", "0..7", "--by-object"], &["6 objects"]);
    room.refuses(&["--rows", "0..2", "-o", "a.vf"], &["all rows", "--rows"]);
    room.refuses(&["--rows", "0..2", "--enforce", "closure", "-o", "a.npz"], &["--enforce", "--rows"]);
    room.refuses(&["--resolution", "64", "-o", "a.npz"], &["--resolution", "--method hemicube"]);
    room.refuses(&["--method", "hemicube", "--rays", "64", "-o", "a.npz"], &["--rays", "--resolution"]);
    room.refuses(&["--method", "hemicube", "--resolution", "0", "-o", "a.npz"], &["--resolution"]);
    room.refuses(&["--method", "hemicube", "--hemicube-errors", "-o", "a.npz"], &["--report"]);
    room.refuses(&[&["--view", "0", "--resolution", "64"], &png[..]].concat(), &["--resolution"]);
    room.refuses(&["-o", "a.xyz"], &["a.xyz", ".npz", ".png"]);
    room.refuses(&["-o", "a.npz", "-o", "./a.npz"], &["given twice"]);
    room.refuses(&["--view", "nowhere", "-o", "a.png"], &["nowhere", "x0, x1"]);
    room.refuses(&["--view", "999999", "-o", "a.png"], &["999999", "elements"]);
    room.refuses(&["--view", "0"], &["-o VIEW.png"]);
    room.refuses(&[&["--view", "0", "--by-object"], &png[..]].concat(), &["--view", "--by-object"]);
    room.refuses(&[&["--view-as", "hemicube"], &png[..]].concat(), &["--view"]);
}

/// Few rays, closed and open: after the correction, symmetry, sums and signs hold to 1e-9, and the report says so.
#[test]
fn corrected_matrices_obey() {
    for (folder, by_object) in [(Folder::room(), false), (Folder::plates(), false), (Folder::room(), true)] {
        for enforce in ["reciprocity", "closure"] {
            let mut args = vec![
                "--element-size",
                "0.25",
                "--rays",
                "48",
                "--quiet",
                "-o",
                "f.json",
                "--report",
                "r.json",
            ];
            args.extend(["--enforce", enforce]);
            if by_object {
                args.push("--by-object");
            }
            folder.done(&args);
            let file = folder.json("f.json");
            assert_eq!(file["written"], enforce);
            let rows: Vec<Vec<f64>> = if by_object {
                file["form_factors"].as_array().expect("rows").iter().map(floats).collect()
            } else {
                dense(&file)
            };
            let (areas, escaped) = (floats(&file["areas"]), floats(&file["escaped"]));
            for i in 0..rows.len() {
                for j in 0..rows.len() {
                    let (there, back) = (areas[i] * rows[i][j], areas[j] * rows[j][i]);
                    assert!(there >= 0.0 && (there - back).abs() <= 1e-12 * there, "{i} {j}: {there} {back}");
                }
                let sum = rows[i].iter().sum::<f64>() + escaped[i];
                assert!(enforce == "reciprocity" || (sum - 1.0).abs() < 1e-9, "row {i}: {sum}");
            }
            let report = folder.json("r.json")["form_factors"].clone();
            let correction = &report["correction"];
            assert_eq!((&report["written"], &correction["enforced"]), (&enforce.into(), &enforce.into()));
            assert!(correction["largest_move"].as_f64() > Some(0.0));
            assert!(correction["rms_move_in_standard_errors"].as_f64() < Some(3.0), "{correction}");
            eprintln!("{enforce}, by object {by_object}: {correction}");
        }
    }
}

#[test]
fn views_are_pictures_in_which_area_is_form_factor() {
    let plates = Folder::plates();
    for how in ["fisheye", "hemicube"] {
        plates.done(&["--view", "low", "--view-as", how, "--element-size", "0.334", "-o", "v.png"]);
        let picture = read(&plates.path("v.png")).expect("picture");
        // The middle element sees the upper plate straight above, and nothing (black) at the horizon.
        let at = |x: usize, y: usize| picture.get(x, y);
        let (left, top, across) =
            (10, 25, 720 / if how == "fisheye" { 1 } else { 512 } * if how == "fisheye" { 1 } else { 512 });
        assert_ne!(at(left + across / 2, top + across / 2), [0.0; 3], "{how}");
        assert_eq!(at(left + 8, top + across / 2), [0.0; 3], "{how}");
        if how == "fisheye" {
            // Lambert's factor from the centre of a unit square to its opposite at distance 1: 0.2395.
            let disc = (0..across * across).map(|k| (k % across, k / across)).filter(|(x, y)| {
                let p = |i: &usize| (2 * i + 1) as f64 / across as f64 - 1.0;
                p(x) * p(x) + p(y) * p(y) < 1.0
            });
            let (mut all, mut lit) = (0.0, 0.0);
            for (x, y) in disc {
                all += 1.0;
                lit += f64::from(u8::from(at(left + x, top + y) != [0.0; 3]));
            }
            let b = 0.5 / 1.25f64.sqrt();
            let exact = 4.0 / std::f64::consts::PI * b * b.atan();
            assert!((lit / all - exact).abs() < 2e-3, "{} {exact}", lit / all);
        }
    }
}

/// Rows and columns of the heat map are where their labels say, by colour.
#[test]
fn heat_maps_show_large_factors_bright() {
    let plates = Folder::plates();
    plates.done(&["--by-object", "--element-size", "0.5", "-o", "t.png"]);
    let picture = read(&plates.path("t.png")).expect("picture");
    let grey = twopass::color::srgb_decode(225.0 / 255.0) as f32;
    let count = |test: &dyn Fn([f32; 3]) -> bool| {
        (0..picture.pixel_count()).filter(|k| test(picture.get(k % picture.width, k / picture.width))).count()
    };
    let near = |a: f32, b: f32| (a - b).abs() < 0.01;
    let zero = count(&|p| p.iter().all(|c| near(*c, grey)));
    // Viridis ends in (253, 231, 37).
    let ends = [253.0, 231.0, 37.0].map(|c: f64| twopass::color::srgb_decode(c / 255.0) as f32);
    let bright = count(&|p| (0..3).all(|c| near(p[c], ends[c])));
    // The diagonal is zero, the rest is 0.2: two squares each, and the legend.
    assert!((2 * 64 * 64..3 * 64 * 64).contains(&zero), "{zero}");
    assert!(bright > 64 * 64 && bright < 3 * 64 * 64, "{bright}");
}

/// Where nothing is specular, chains change nothing: the factors are those pair by pair, exact to the last digit.
#[test]
fn chains_where_nothing_is_specular_change_nothing() {
    let plates = Folder::plates();
    let table = |args: &[&str]| {
        plates.done(&[&["--by-object", "--element-size", "1", "--quiet", "-o", "t.json"], args].concat());
        floats(&plates.json("t.json")["form_factors"][0])[1]
    };
    let (plain, chain) = (table(&[]), table(&["--mirror", "chain"]));
    assert!(plain == chain && (chain - 0.199_824_895_698).abs() < 1e-9, "{plain} {chain}");
}

/// Names tell sides apart, or there are none.
#[test]
fn backs_whose_names_are_taken_are_refused() {
    let square = |z: f64| vec![vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]]];
    let folder = Folder::new(&[("b:back", square(0.0)), ("b", square(1.0))]);
    let (code, stderr) = folder.run(&["--by-object", "--two-sided", "-o", "t.json"]);
    assert_eq!(code, 1, "{stderr}");
    for part in ["object \"b:back\"", "object \"b\"", "rename", "--two-sided"] {
        assert!(stderr.contains(part), "{part:?}: {stderr}");
    }
    assert!(!folder.path("t.json").exists());
    folder.done(&["--by-object", "-o", "t.json"]);
    let other = Folder::new(&[("b:back", square(0.0)), ("c", square(1.0))]);
    other.done(&["--by-object", "--two-sided", "--rays", "64", "-o", "t.json"]);
    assert_eq!(other.json("t.json")["objects"], serde_json::json!(["b:back", "c", "b:back:back", "c:back"]));
}
