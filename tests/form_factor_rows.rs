//! `twopass form-factors` of some rows, of both sides of faces, and of what no ray met.

mod common;

use common::factor_files::*;
use common::*;
use serde_json::Value;
use std::fs;

#[test]
fn some_rows_are_those_of_all() {
    let room = Folder::room();
    for method in [&["--rays", "64"][..], &["--method", "hemicube", "--resolution", "24"]] {
        let common = [&["--element-size", "0.5", "--quiet"], method].concat();
        room.done(&[&common[..], &["-o", "all.json"]].concat());
        room.done(&[&common[..], &["-o", "some.json", "--rows", "5..9", "--report", "r.json"]].concat());
        let (all, some) = (room.json("all.json"), room.json("some.json"));
        assert_eq!(some["rows"], serde_json::json!([5, 9]));
        assert_eq!(dense(&some), dense(&all)[5..9]);
        assert_eq!(floats(&some["escaped"]).len(), 4);
        assert!(room.json("r.json")["form_factors"]["closure"].as_f64() < Some(1e-6));
        room.done(&[&common[..], &["-o", "t.json", "--by-object"]].concat());
        room.done(&[&common[..], &["-o", "u.json", "--by-object", "--rows", "2..4"]].concat());
        let (t, u) = (room.json("t.json"), room.json("u.json"));
        assert_eq!((&u["form_factors"][0], &u["rows"]), (&t["form_factors"][2], &serde_json::json!([2, 4])));
        assert_eq!(u["form_factors"].as_array().map(Vec::len), Some(2));
    }
    let rays: u64 = {
        room.done(&[
            "--rays",
            "64",
            "--element-size",
            "0.5",
            "--rows",
            "0..1",
            "-o",
            "a.npz",
            "--report",
            "r.json",
        ]);
        let stages = room.json("r.json")["stages"].clone();
        stages.as_array().expect("stages").iter().map(|s| s["rays"].as_u64().expect("rays")).sum()
    };
    assert_eq!(rays, 64, "only the rows asked for are cast");
}

/// Few elements are treated pair by pair whether all rows are asked for or some, and with backs or without.
#[test]
fn rows_and_backs_do_not_change_the_estimator() {
    let plates = Folder::plates();
    let whole = ["--element-size", "1", "--quiet"];
    plates.done(&[&whole[..], &["--by-object", "-o", "t.json"]].concat());
    let t = plates.json("t.json");
    assert!((floats(&t["form_factors"][0])[1] - 0.199_824_895_698).abs() < 1e-9);
    for extra in [&["--rows", "0..1"][..], &["--two-sided"], &["--two-sided", "--rows", "0..2"]] {
        plates.done(&[&whole[..], &["--by-object", "-o", "u.json"], extra].concat());
        let u = plates.json("u.json");
        assert_eq!(floats(&u["form_factors"][0])[..2], floats(&t["form_factors"][0]), "{extra:?}");
        assert_eq!(floats(&u["standard_errors"][0])[..2], [0.0, 0.0], "{extra:?}");
    }
    // Backs, of which low's looks at nothing, are objects of their own.
    plates.done(&[&whole[..], &["--by-object", "--two-sided", "-o", "u.json"]].concat());
    let u = plates.json("u.json");
    assert_eq!(u["objects"], serde_json::json!(["low", "high", "low:back", "high:back"]));
    assert_eq!(floats(&u["escaped"])[2..], [1.0, 1.0]);

    // Partly hidden pairs, among few elements and among many.
    let faces = box_faces([0.0; 3], [1.0, 0.5, 2.0], true).into_iter().map(|(n, p)| (n, vec![p]));
    let screen = vec![[0.3, 0.1, 0.9], [0.7, 0.1, 0.9], [0.7, 0.4, 1.1], [0.3, 0.4, 1.1]];
    let room = Folder::new(&faces.chain([("screen", vec![screen])]).collect::<Vec<_>>());
    for (size, rows) in [("0.5", "5..9"), ("0.25", "40..50")] {
        let common = ["--element-size", size, "--quiet"];
        room.done(&[&common[..], &["-o", "all.json", "--report", "a.json"]].concat());
        room.done(&[&common[..], &["-o", "some.json", "--rows", rows, "--report", "r.json"]].concat());
        let (all, some) = (room.json("all.json"), room.json("some.json"));
        let (first, end) = (some["rows"][0].as_u64(), some["rows"][1].as_u64());
        let range = first.expect("row") as usize..end.expect("row") as usize;
        assert_eq!(dense(&some), dense(&all)[range.clone()]);
        assert_eq!(floats(&some["escaped"]), floats(&all["escaped"])[range]);
        assert!(room.json("r.json")["form_factors"]["pairs"].is_object(), "by pairs");
        let closure = |report: &str| room.json(report)["form_factors"]["closure"].as_f64();
        assert!(closure("r.json") <= closure("a.json"));
        room.done(&[&common[..], &["-o", "t.json", "--by-object"]].concat());
        room.done(&[&common[..], &["-o", "u.json", "--by-object", "--rows", "2..4"]].concat());
        let (t, u) = (room.json("t.json"), room.json("u.json"));
        for what in ["form_factors", "standard_errors", "escaped"] {
            assert_eq!((&u[what][0], &u[what][1]), (&t[what][2], &t[what][3]), "{what}");
        }
        // Fronts as without backs, and all of a closed room's rows sum to one; the screen's back sees the other half.
        room.done(&[&common[..], &["-o", "both.json", "--by-object", "--two-sided"]].concat());
        let both = room.json("both.json");
        let screen = |row: usize| floats(&both["form_factors"][row]);
        assert!(screen(6).iter().sum::<f64>() > 0.998 && screen(13).iter().sum::<f64>() > 0.998, "{both}");
        for (row, seen) in t["form_factors"].as_array().expect("rows").iter().enumerate() {
            let errors = |file: &Value| floats(&file["standard_errors"][row]);
            let with_backs = floats(&both["form_factors"][row]).into_iter().zip(errors(&both));
            for ((a, ea), (b, eb)) in floats(seen).into_iter().zip(errors(&t)).zip(with_backs) {
                assert!((a - b).abs() <= 5.0 * ea.hypot(eb) + 1e-9, "{row}: {a} +- {ea}, {b} +- {eb}");
            }
            // What lands on the screen's back was lost without it.
            assert!((floats(&both["form_factors"][row]).iter().sum::<f64>() - 1.0).abs() < 5e-3, "{row}");
        }
    }
}

/// The insides of a box see each other, though it is a solid body from outside.
#[test]
fn the_inside_of_a_box_sees_itself() {
    let faces: Vec<_> = box_faces([0.0; 3], [1.0; 3], false).into_iter().map(|(n, p)| (n, vec![p])).collect();
    let cube = Folder::new(&faces);
    cube.done(&[
        "--by-object",
        "--two-sided",
        "--element-size",
        "1",
        "--quiet",
        "-o",
        "t.json",
        "--report",
        "r.json",
    ]);
    assert!(cube.json("r.json")["form_factors"]["pairs"].is_object());
    let t = cube.json("t.json");
    for inside in 6..12 {
        let row = floats(&t["form_factors"][inside]);
        assert!(row[..6].iter().all(|f| *f == 0.0) && (row[6..].iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert_eq!(row.iter().filter(|f| (**f - 0.199_824_895_698).abs() < 1e-9).count(), 1, "{row:?}");
    }
}

/// A zero that rays found is no exact one.
#[test]
fn factors_that_no_ray_met_have_an_error() {
    let far = far_plates(100.0);
    far.done(&["--by-object", "--rays", "16", "--element-size", "0.5", "--quiet", "-o", "t.json"]);
    let t = far.json("t.json");
    for (a, b) in [(0, 1), (1, 0)] {
        assert_eq!(floats(&t["form_factors"][a])[b], 0.0);
        let error = floats(&t["standard_errors"][a])[b];
        assert!((error - 0.25 / 16.0).abs() < 1e-12, "{error}");
        // A plane does not see itself.
        assert_eq!((floats(&t["form_factors"][a])[a], floats(&t["standard_errors"][a])[a]), (0.0, 0.0));
    }
    // Many elements, by hemisphere rays.
    let far = far_plates(1e4);
    far.done(&["--by-object", "--element-size", "0.03", "--quiet", "-o", "t.json", "-o", "t.csv"]);
    let t = far.json("t.json");
    let (f, error) = (floats(&t["form_factors"][0])[1], floats(&t["standard_errors"][0])[1]);
    assert!((f - 3.18e-9).abs() <= 3.0 * error && error < 1e-5, "{f} {error}");
    assert!(error > 0.0);
    let csv = fs::read_to_string(far.path("t.csv")).expect("t.csv");
    assert!(csv.contains(&format!(",0,{error}\n")), "{csv}");
}

/// Two rooms with a wall in common, drawn twice: between its two sides are factors that are exact and tiny, and rows close all the same.
#[test]
fn rooms_with_a_common_wall_close() {
    let rooms = [("left", 0.0), ("right", 1.0)]
        .map(|(name, x)| (name, box_faces([x, 0.0, 0.0], [1.0; 3], true).into_iter().map(|f| f.1).collect()));
    let folder = Folder::new(&rooms);
    let args =
        ["--element-size", "0.5", "--rays", "4096", "--two-sided", "--enforce", "closure", "-o", "f.npz"];
    folder.done(&args);
}
