//! Exact form factors against closed forms and high-precision values, and pairs that are partly hidden.
//!
//! Standard errors come from 16 independent randomisations; seeds are fixed, so a test that passes goes on passing.

#[path = "../common/mod.rs"]
mod common;
mod hidden;

use common::*;
use glam::DVec3;
use std::f64::consts::PI;
use twopass::form_factor::analytic::{EXACT, Polygon, differential, exchange};
use twopass::form_factor::pairs::{BATCHES, PairFactors, PairWork};
use twopass::form_factor::{
    AtSpecular, Casting, Estimates, Factors, ObjectTable, Request, cast, cast_rows, estimate, size_for_pairs,
    unoccluded,
};
use twopass::mesh::{Mesh, Sides};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

fn poly(points: &[Point]) -> Polygon {
    let p: Vec<DVec3> = points.iter().map(|p| DVec3::from_array(*p)).collect();
    Polygon::new(&p, (p[1] - p[0]).cross(p[2] - p[0]).normalize())
}

/// Rectangle from a corner along two edges.
fn rectangle(o: Point, a: Point, b: Point) -> Polygon {
    let add = |p: Point, q: Point| [p[0] + q[0], p[1] + q[1], p[2] + q[2]];
    poly(&[o, add(o, a), add(add(o, a), b), add(o, b)])
}

fn scene(objects: &[(&str, Vec<Vec<Point>>)]) -> Scene {
    let mut files = Files::default();
    files.material("m", "diffuse = 0.5");
    for (name, polygons) in objects {
        polygons.iter().for_each(|p| {
            files.polygon(name, "m", p);
        });
    }
    files.load()
}

fn request(rays: u32, seed: u32) -> Request<'static> {
    Request { rays, error: None, floor: 1e-3, by_object: true, seed, progress: &|_| {} }
}

fn table_at(scene: &Scene, size: f64, request: &Request) -> ObjectTable {
    let device = device();
    let visibility = Visibility::new(&device, scene).expect("tree");
    let mesh = Mesh::new(scene, &Sides::fronts(scene), size, true).expect("mesh");
    estimate(&visibility, &mesh, request).table(scene, &mesh, 0.0)
}

fn table(scene: &Scene, request: &Request) -> ObjectTable {
    table_at(scene, 1e9, request)
}

/// Every unoccluded pair: 1e-9 relative, 1e-6 where the entry is tagged hard; through the scene, so with whatever
/// splitting of polygons and moving of coordinates that brings.
#[test]
fn oracle_pairs_are_exact() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    let (mut problems, mut worst, mut count): (Vec<String>, [f64; 2], _) = (Vec::new(), [0.0; 2], 0);
    for e in entries.iter().filter(|e| e["kind"] == "polygon_polygon") {
        let scene = scene(&[("a", vec![polygon(&e["poly1"])]), ("b", vec![polygon(&e["poly2"])])]);
        let device = device();
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
        let exact =
            unoccluded(&visibility, &mesh, 0, &|_| {}).expect("few elements").table(&scene, &mesh, 0.0);
        let ray = table(&scene, &request(256, 1));
        let hard = e["tags"].as_array().expect("tags").iter().any(|t| t == "hard");
        for (a, b, key) in [(0, 1, "F12"), (1, 0, "F21")] {
            let want = e[key].as_f64().expect("factor");
            // Nothing lies between, which the shaft proves: rays have no part in it.
            for (t, name) in [(&exact, "analytic"), (&ray, "ray")] {
                let got = t.form_factors[a][b];
                let off = if want > 0.0 { (got / want - 1.0).abs() } else { got };
                worst[usize::from(hard)] = worst[usize::from(hard)].max(off);
                count += 1;
                if off > if hard { 1e-6 } else { 1e-9 } || t.standard_errors[a][b] != 0.0 {
                    problems.push(format!("{} {key} {name}: {got}, exact {want}, off {off:.1e}", e["id"]));
                }
            }
        }
    }
    eprintln!("{count} factors: within {:.1e}, hard ones {:.1e}", worst[0], worst[1]);
    assert!(problems.is_empty() && count > 100, "{count} {problems:#?}");
}

#[test]
fn oracle_points() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    for e in of_kind(&entries, "point_polygon") {
        let v = |k: &str| DVec3::from_slice(&numbers(&e["params"][k]));
        let seen = poly(&polygon(&e["params"]["poly"]));
        let got = differential(v("point"), v("normal").normalize(), &seen);
        let want = e["F12"].as_f64().expect("factor");
        assert!((got / want - 1.0).abs() < 1e-12, "{}: {got} {want}", e["id"]);
    }
}

/// Howell C-14, perpendicular rectangles with a common edge l; h upright, w flat; from w to h.
fn c14(l: f64, h: f64, w: f64) -> f64 {
    let (h, w) = (h / l, w / l);
    let (h2, w2) = (h * h, w * w);
    let s = h2 + w2;
    let logs = ((1.0 + w2) * (1.0 + h2) / (1.0 + s)).ln()
        + w2 * (w2 * (1.0 + s) / ((1.0 + w2) * s)).ln()
        + h2 * (h2 * (1.0 + s) / ((1.0 + h2) * s)).ln();
    (w * (1.0 / w).atan() + h * (1.0 / h).atan() - s.sqrt() * (1.0 / s.sqrt()).atan() + 0.25 * logs)
        / (PI * w)
}

/// Howell's rectangles over six orders of size and distance: C-11 opposed, C-14 with a common edge.
#[test]
fn howell_rectangles() {
    let mut worst: f64 = 0.0;
    for (a, b, c) in [(1.0, 1.0, 1.0), (3.0, 0.2, 0.5), (1.0, 1.0, 1e-3), (1.0, 1e-3, 0.1), (2.0, 1.0, 20.0)]
    {
        let p = rectangle([0.0; 3], [a, 0.0, 0.0], [0.0, b, 0.0]);
        let q = rectangle([0.0, 0.0, c], [0.0, b, 0.0], [a, 0.0, 0.0]);
        let want = opposed(a, b, c);
        // The closed form itself cancels where the rectangles are far apart.
        let lost = 1e-15 * (c * c / (a * b)).powi(2).max(1.0);
        let off = (exchange(&p, &q, EXACT) / (a * b) / want - 1.0).abs();
        worst = worst.max(off);
        assert!(off < 1e-11 + 10.0 * lost, "C-11 {a} {b} {c}: {off:.1e}");
    }
    for (l, h, w) in [(1.0, 1.0, 1.0), (1.0, 0.5, 2.0), (0.1, 3.0, 1.0), (5.0, 0.01, 1.0)] {
        let p = rectangle([0.0; 3], [l, 0.0, 0.0], [0.0, w, 0.0]);
        let q = rectangle([0.0; 3], [0.0, 0.0, h], [l, 0.0, 0.0]);
        let off = (exchange(&p, &q, EXACT) / (l * w) / c14(l, h, w) - 1.0).abs();
        worst = worst.max(off);
        assert!(off < 1e-11, "C-14 {l} {h} {w}: {off:.1e}");
    }
    eprintln!("within {worst:.1e}");
}

/// Howell C-16: two rectangles with a common edge at any angle. Long ones tend to Hottel's crossed strings,
/// `F = (w + h - third side) / 2 w`; the sum over a triangular prism's sides and ends closes at every length.
#[test]
fn howell_angles() {
    for degrees in [10.0f64, 30.0, 60.0, 90.0, 135.0, 170.0] {
        let (s, c) = degrees.to_radians().sin_cos();
        let (w, h) = (1.0, 1.5);
        let third = (w * w + h * h - 2.0 * w * h * c).sqrt();
        let crossed = (w + h - third) / (2.0 * w);
        for (l, largest) in [(1.0, 0.9), (1e5, 5e-5)] {
            let [o, p, q] = [[0.0; 3], [w, 0.0, 0.0], [h * c, h * s, 0.0]];
            let up = |x: Point| [x[0], x[1], l];
            let floor = poly(&[o, up(o), up(p), p]);
            let tilted = poly(&[o, q, up(q), up(o)]);
            let front = poly(&[p, up(p), up(q), q]);
            let ends = [poly(&[o, p, q]), poly(&[up(o), up(q), up(p)])];
            assert!(floor.normal.y > 0.9);
            let f = exchange(&floor, &tilted, EXACT) / (w * l);
            assert!(
                f < crossed && f > crossed * (1.0 - largest),
                "{degrees} {l}: {f}, crossed strings {crossed}"
            );
            let sum =
                [tilted, front, ends[0], ends[1]].iter().map(|b| exchange(&floor, b, EXACT)).sum::<f64>();
            assert!((sum / (w * l) - 1.0).abs() < 1e-9, "{degrees} {l}: closure {}", sum / (w * l) - 1.0);
        }
    }
}

/// Random pairs of triangles and parallelograms, near and far: each asked tolerance holds against the tightest one, and
/// reciprocity holds to rounding.
#[test]
fn tolerances_hold() {
    let mut worst = [0.0f64; 3];
    let mut compared = 0;
    for k in 0..600u32 {
        let x = |set| twopass::sampling::sobol(k, set, 3).map(|v| 2.0 * v - 1.0);
        let (a, b, c, d) = (x(0), x(1), x(2), x(3));
        let size = 10f64.powf(0.75 * (a[3] - 1.0));
        let make = |o: [f64; 3], u: [f64; 4], v: [f64; 4], s: f64, triangle: bool| {
            let at = |p: f64, q: f64| [0, 1, 2].map(|i| o[i] + s * (p * u[i] + q * v[i]));
            let corners = [
                at(0.0, 0.0),
                at(1.0, 0.0),
                if triangle { at(0.0, 1.0) } else { at(1.0, 1.0) },
                at(0.0, 1.0),
            ];
            poly(&corners[..if triangle { 3 } else { 4 }])
        };
        let p = make([0.0; 3], a, b, size, k % 2 == 0);
        let q = make([3.0 * c[3], 3.0 * b[3], 3.0 * d[3]], c, d, size, k % 3 == 0);
        let exact = exchange(&p, &q, EXACT);
        let other = exchange(&q, &p, EXACT);
        assert!((exact - other).abs() <= 1e-10 * exact, "{k}: {exact} {other}");
        if exact <= 1e-9 * p.area() {
            continue;
        }
        compared += 1;
        for (worst, tolerance) in worst.iter_mut().zip([1e-3, 1e-5, 1e-8]) {
            let off = (exchange(&p, &q, tolerance) / exact - 1.0).abs();
            *worst = worst.max(off / tolerance);
        }
    }
    eprintln!("{compared} pairs; worst errors over tolerances 1e-3, 1e-5, 1e-8: {worst:.3?}");
    assert!(compared > 100 && worst.iter().all(|w| *w <= 1.0));
}

fn square(z: f64, up: bool) -> Vec<Point> {
    let mut p = vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]];
    if !up {
        p.reverse();
    }
    p
}

/// The 95 % interval (Student's t, 15 degrees of freedom: 2.131) of partly hidden pairs by points over 40 seeds: as many
/// as 40 intervals hold 36 times or more but in 5 % of cases and 34 times or more but in 0.7 %; the three
/// configurations together, 108 of 120 but in 1 %.
#[test]
fn standard_errors_of_hidden_pairs_are_calibrated() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    let (mut held, mut total) = (0, 0);
    for id in ["PO01", "PO03", "PO04"] {
        let e = entries.iter().find(|e| e["id"] == id).expect("entry");
        let blockers: Vec<_> = e["blockers"].as_array().expect("blockers").iter().map(polygon).collect();
        let scene = scene(&[
            ("a", vec![polygon(&e["poly1"])]),
            ("b", vec![polygon(&e["poly2"])]),
            ("blocker", blockers),
        ]);
        let want = e["F12"].as_f64().expect("factor");
        let device = device();
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
        let (mut squares, mut variance) = (0.0, 0.0);
        for seed in 0..40 {
            let work = PairWork {
                points: 16,
                batches: BATCHES,
                error: None,
                floor: 0.0,
                tolerance: EXACT,
                cells: None,
                rows: None,
                unoccluded: false,
                seed,
                progress: &|_| (),
            };
            let pairs = PairFactors::new(&visibility, &mesh, &work);
            assert_eq!((pairs.counts.shadows, pairs.counts.cells), (1, 0));
            let t = ObjectTable::of_pairs(&scene, &mesh, &pairs, None, 0.0);
            let (f, error) = (t.form_factors[0][1], t.standard_errors[0][1]);
            held += u32::from((f - want).abs() <= 2.131 * error);
            total += 1;
            squares += (f - want).powi(2) / 40.0;
            variance += error * error / 40.0;
        }
        eprintln!(
            "{id}: true error {:.1e} of the factor, over stated {:.2}",
            squares.sqrt() / want,
            (squares / variance).sqrt()
        );
        // 40 squared errors have a mean of standard error 22 %: a root within 35 % but for one in 1000.
        assert!(((squares / variance).sqrt() - 1.0).abs() < 0.35);
    }
    eprintln!("95 % intervals hold in {held} of {total}");
    assert!((108..=119).contains(&held), "{held} of {total}");
}

/// Occluded pairs of the oracle, both ways: within four standard errors, which are below 0.5 % at 65,536 rays.
#[test]
fn oracle_occluded_pairs() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    for e in of_kind(&entries, "polygon_polygon_occluded") {
        let blockers = e["blockers"].as_array().expect("blockers").iter().map(polygon).collect();
        let objects = [("a", vec![polygon(&e["poly1"])]), ("b", vec![polygon(&e["poly2"])]), ("c", blockers)];
        let t = table(&scene(&objects), &request(65_536, 3));
        for (a, b, key) in [(0, 1, "F12"), (1, 0, "F21")] {
            let (want, f, error) =
                (e[key].as_f64().expect("factor"), t.form_factors[a][b], t.standard_errors[a][b]);
            assert!(
                (f - want).abs() <= T15 * error + 1e-12 && error <= 5e-3 * want,
                "{} {f} +- {error:.1e} {want}",
                e["id"]
            );
        }
    }
}

/// An asked error is met, by object and by element, or said to be missed.
#[test]
fn asked_errors_are_met() {
    let mut half = square(0.5, true);
    half.iter_mut().for_each(|p| (p[0], p[1]) = (0.25 + 0.5 * p[0], 0.25 + 0.5 * p[1]));
    let scene = scene(&[("a", vec![square(0.0, true)]), ("b", vec![square(1.0, false)]), ("c", vec![half])]);
    for (error, by_object) in [(0.01, true), (1e-3, true), (0.01, false)] {
        let device = device();
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
        let found =
            estimate(&visibility, &mesh, &Request { error: Some(error), by_object, ..request(16, 2) });
        let achieved = found.achieved.expect("an error was asked for");
        assert!(achieved > 0.0 && achieved <= error, "{achieved} {error}");
        assert!(found.warnings(&scene, Some(error)).is_empty());
        let t = found.table(&scene, &mesh, 0.0);
        assert!((t.form_factors[0][1] / 0.09950629459898479 - 1.0).abs() < 4.0 * error);
    }
    let found = {
        let device = device();
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
        estimate(&visibility, &mesh, &Request { error: Some(1e-9), ..request(16, 2) })
    };
    let warnings = found.warnings(&scene, Some(1e-9));
    assert!(warnings.len() == 1 && warnings[0].contains("not met"), "{warnings:?}");
}

/// Where an error is asked of factors between objects and pairs of elements are looked at for its sake, elements are as few as there can be,
/// even if faces are more than are looked at otherwise.
#[test]
fn an_asked_error_takes_few_elements() {
    let quads = |f: Vec<(&str, Vec<Point>)>| f.into_iter().map(|(_, p)| p).collect::<Vec<_>>();
    let scene = scene(&[
        ("room", quads(box_faces([0.0; 3], [1.0; 3], true))),
        ("block", quads(box_faces([0.3; 3], [0.3; 3], false))),
    ]);
    let sides = Sides::fronts(&scene);
    let elements = |rays: u32, asked: bool| {
        let size = size_for_pairs(&scene, &sides, rays, asked).expect("few elements");
        size.map(|size| Mesh::new(&scene, &sides, size, true).expect("mesh").len())
    };
    assert_eq!((elements(64, false), elements(64, true)), (None, Some(12)));
    let many = elements(1024, false).expect("128 elements are allowed");
    assert!((13..=128).contains(&many) && elements(1024, true) == Some(many), "{many}");
}
