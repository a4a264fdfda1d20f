//! Ray-cast form factors against exact ones.
//!
//! Standard errors come from 16 independent randomisations (15 degrees of freedom), so a right
//! program leaves the interval of four standard errors in 0.12 % of comparisons; seeds are fixed,
//! so a test that passes goes on passing.

mod common;

use common::*;
use glam::DVec3;
use rayon::ThreadPoolBuilder;
use std::f64::consts::{PI, TAU};
use twopass::form_factor::analytic::{EXACT, Polygon, exchange};
use twopass::form_factor::{AtSpecular, Casting, ExchangeMatrix, ObjectTable, cast, unoccluded};
use twopass::mesh::{Mesh, Sides, default_element_size};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

const BATCHES: u32 = 16;
const OPPOSED: f64 = 0.19982489569838738;
const PERPENDICULAR: f64 = 0.20004377607540316;

fn scene(objects: &[(&str, Vec<Vec<Point>>)]) -> Scene {
    let mut files = Files::default();
    files.material("m", "diffuse = 0.5");
    for (name, polygons) in objects {
        for p in polygons {
            files.polygon(name, "m", p);
        }
    }
    files.load()
}

fn rows(scene: &Scene, size: f64, rays: u32, seed: u32) -> (Mesh, ExchangeMatrix) {
    let device = device();
    let visibility = Visibility::new(&device, scene).expect("tree");
    let mesh = Mesh::new(scene, &Sides::fronts(scene), size, true).expect("mesh");
    let casting = Casting {
        rays,
        batches: BATCHES,
        seed,
        specular: AtSpecular::End,
        reached: None,
        emitters: None,
        progress: &|_| {},
    };
    let (matrix, _) = cast(&visibility, &mesh, &casting);
    (mesh, matrix)
}

fn table(scene: &Scene, size: f64, rays: u32, seed: u32) -> ObjectTable {
    let (mesh, matrix) = rows(scene, size, rays, seed);
    assert_closed(&matrix);
    ObjectTable::new(scene, &mesh, &matrix, 0.0)
}

/// Every ray is somewhere: landed, escaped, or stopped where no element is. Entries are f32.
fn assert_closed(matrix: &ExchangeMatrix) {
    for row in 0..matrix.len() {
        let s = &matrix.summary[row];
        let landed: f64 = matrix.row(row).map(|(_, f)| f.x).sum();
        let sum = landed + s.escaped.x + s.absorbed.x + s.dropped.x;
        assert!((sum - 1.0).abs() < 1e-6, "row {row}: {landed} {s:?}");
        assert_eq!((s.exposed, s.dropped.x), (1.0, 0.0));
    }
}

fn index(t: &ObjectTable, name: &str) -> usize {
    t.objects.iter().position(|o| o == name).expect("object")
}

/// Within four standard errors; asserted by name.
#[track_caller]
fn assert_factor(t: &ObjectTable, from: &str, to: &str, exact: f64) {
    let (a, b) = (index(t, from), index(t, to));
    let (f, e) = (t.form_factors[a][b], t.standard_errors[a][b]);
    assert!((f - exact).abs() <= T15 * e + 1e-6 * exact, "{from} to {to}: {f} +- {e:.1e}, exact {exact}");
}

fn square(z: f64, up: bool) -> Vec<Point> {
    let mut p = vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]];
    if !up {
        p.reverse();
    }
    p
}

/// Elements of a unit square.
fn elements_of_square(size: f64) -> f64 {
    (1.0 / size).ceil().powi(2)
}

/// All 36 factors inside a unit cube, as one element a face and as 16: 72 comparisons, 0.09 false
/// alarms expected. The perpendicular factor follows from the opposed one by closure.
#[test]
fn cube_inside() {
    assert!((opposed(1.0, 1.0, 1.0) - OPPOSED).abs() < 1e-15);
    assert!(((1.0 - OPPOSED) / 4.0 - PERPENDICULAR).abs() < 1e-16);
    let faces = box_faces([0.0; 3], [1.0; 3], true);
    let scene = scene(&faces.iter().map(|(n, p)| (*n, vec![p.clone()])).collect::<Vec<_>>());
    for (size, rays) in [(10.0, 65_536), (0.25, 4096)] {
        let t = table(&scene, size, rays, 2);
        let mut squares = 0.0;
        for (i, (a, _)) in faces.iter().enumerate() {
            let row: f64 = t.form_factors[i].iter().sum();
            assert!((row - 1.0).abs() < 1e-6 && t.escaped[i] == 0.0, "{a}: {row} {}", t.escaped[i]);
            for (j, (b, _)) in faces.iter().enumerate() {
                let exact = match (i == j, i / 2 == j / 2) {
                    (true, _) => 0.0,
                    (_, true) => OPPOSED,
                    _ => PERPENDICULAR,
                };
                assert_factor(&t, a, b, exact);
                if i != j {
                    squares += (t.form_factors[i][j] / exact - 1.0).powi(2) / 30.0;
                }
            }
        }
        // Unstratified rays would have this relative error; stratified ones at most half of it.
        let random = ((1.0 - OPPOSED) / OPPOSED / f64::from(t.rays) / elements_of_square(size)).sqrt();
        let rms = f64::sqrt(squares);
        eprintln!("cube, elements {size}: rms error {:.3} %, random {:.3} %", 100.0 * rms, 100.0 * random);
        assert!(rms < 0.5 * random);
    }
}

/// A convex body in a closed room: every ray from it lands on the room, so the room sees it with
/// the ratio of the areas, whatever the shapes. 6 comparisons.
#[test]
fn convex_bodies_in_closed_rooms() {
    let quads = |f: Vec<(&str, Vec<Point>)>| f.into_iter().map(|(_, p)| p).collect::<Vec<_>>();
    let cases = [
        (
            quads(box_faces([1.0, 0.75, 1.25], [1.0; 3], false)),
            quads(box_faces([0.0; 3], [3.0; 3], true)),
            4096,
        ),
        (sphere(0.5, 6, false), sphere(1.0, 12, true), 256),
    ];
    for (inner, outer, rays) in cases {
        let scene = scene(&[("inner", inner), ("outer", outer)]);
        let t = table(&scene, 100.0, rays, 2);
        let ratio = t.areas[0] / t.areas[1];
        // Every single ray: no cracks between faces, no body seen through.
        assert_eq!(t.escaped, [0.0, 0.0]);
        assert!((t.form_factors[0][1] - 1.0).abs() < 1e-6, "{}", t.form_factors[0][1]);
        assert_eq!(t.form_factors[0][0], 0.0);
        assert_factor(&t, "outer", "inner", ratio);
        assert_factor(&t, "outer", "outer", 1.0 - ratio);
        eprintln!("room to body: {:.6}, exact {ratio:.6}", t.form_factors[1][0]);
    }
}

/// Blockers: half-way between unit squares one of half the edge leaves 0.0995..., one of the full
/// edge leaves nothing; from both sides, whichever way the blocker faces.
#[test]
fn blockers() {
    for up in [true, false] {
        let mut half: Vec<Point> = square(0.5, up);
        half.iter_mut().for_each(|p| (p[0], p[1]) = (0.25 + 0.5 * p[0], 0.25 + 0.5 * p[1]));
        for (blocker, exact) in [(half, 0.09950629459898479), (square(0.5, up), 0.0)] {
            let scene = scene(&[
                ("a", vec![square(0.0, true)]),
                ("b", vec![square(1.0, false)]),
                ("blocker", vec![blocker]),
            ]);
            let t = table(&scene, 10.0, 65_536, 3);
            assert_factor(&t, "a", "b", exact);
            assert_factor(&t, "b", "a", exact);
        }
    }
}

/// Coaxial discs of a hundred corners, which are strips of quads: pair by pair as a fan of triangles from the middle of each has it,
/// and by rays at the default element size, of which triangles as long as the discs would need hundreds of thousands.
#[test]
fn discs_of_many_corners() {
    let n = 100;
    let at = |k: usize, z: f64| {
        let angle = TAU * k as f64 / n as f64;
        [angle.cos(), angle.sin(), z]
    };
    let lower: Vec<Point> = (0..n).map(|k| at(k, 0.0)).collect();
    let upper: Vec<Point> = (0..n).rev().map(|k| at(k, 1.0)).collect();
    let scene = scene(&[("lower", vec![lower]), ("upper", vec![upper])]);
    assert!(scene.faces.len() < n && scene.triangle_count <= 4, "{} faces", scene.faces.len());

    let part = |k: usize, z: f64| {
        let [a, b, c] = [[0.0, 0.0, z], at(k, z), at(k + 1, z)].map(DVec3::from_array);
        if z == 0.0 { Polygon::new(&[a, b, c], DVec3::Z) } else { Polygon::new(&[a, c, b], -DVec3::Z) }
    };
    let one = part(0, 0.0);
    let exact = (0..n).map(|k| exchange(&one, &part(k, 1.0), EXACT)).sum::<f64>() / one.area();
    // Discs as large as the polygons: their shape matters less by far.
    let r2 = 0.5 * n as f64 * (TAU / n as f64).sin() / PI;
    let x = 2.0 + 1.0 / r2;
    let disc = 0.5 * (x - (x * x - 4.0).sqrt());
    assert!((exact - disc).abs() < 1e-6 && (exact - 0.381_966).abs() < 2e-4, "{exact}, disc {disc}");

    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
    let pairs = unoccluded(&visibility, &mesh, 0, &|_| {}).expect("few elements").table(&scene, &mesh, 0.0);
    let size = default_element_size(&scene, true);
    let elements = Mesh::new(&scene, &Sides::fronts(&scene), size, true).expect("mesh").len();
    assert!(elements < 8000, "{elements} elements");
    let rays = table(&scene, size, 1024, 5);
    for (from, to) in [("lower", "upper"), ("upper", "lower")] {
        let pair = pairs.form_factors[index(&pairs, from)][index(&pairs, to)];
        assert!((pair / exact - 1.0).abs() < 1e-9, "{pair}, exact {exact}");
        assert_factor(&rays, from, to, exact);
    }
}

/// Bounds of a count with Poisson mean `m`, each left with a probability below 5e-4.
fn poisson_bounds(m: f64) -> (f64, f64) {
    let (mut p, mut below, mut k, mut low) = ((-m).exp(), 0.0, 0.0, 0.0);
    while below + p < 1.0 - 5e-4 {
        below += p;
        k += 1.0;
        if below < 5e-4 {
            low = k;
        }
        p *= m / k;
    }
    (low, k)
}

/// Neighbouring elements share a scrambling of the directions, yet their errors are uncorrelated: the variance of the mean of
/// a face's 16 elements is a sixteenth of the mean of their variances. Over 300 seeds and 30 pairs of faces, of which some 20
/// are independent, the ratio is known to 2 %: false alarms above four standard errors, 0.01 %.
#[test]
fn neighbours_have_uncorrelated_errors() {
    const SEEDS: u32 = 300;
    let faces = box_faces([0.0; 3], [1.0; 3], true);
    let scene = scene(&faces.iter().map(|(n, p)| (*n, vec![p.clone()])).collect::<Vec<_>>());
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.25, true).expect("mesh");
    for (rays, batches) in [(64, 1), (256, 1), (100, 1)] {
        let casting = |seed| Casting {
            rays,
            batches,
            seed,
            specular: AtSpecular::End,
            reached: None,
            emitters: None,
            progress: &|_| {},
        };
        // By seed, element and face: the factor.
        let runs: Vec<Vec<[f64; 6]>> = (0..SEEDS)
            .map(|seed| {
                let (matrix, _) = cast(&visibility, &mesh, &casting(seed));
                let to_faces = |row: usize| {
                    let mut sums = [0.0; 6];
                    matrix.row(row).for_each(|(j, f)| sums[mesh.place(j as u32).0 as usize] += f.x);
                    sums
                };
                (0..mesh.len()).map(to_faces).collect()
            })
            .collect();
        let variance = |value: &dyn Fn(&Vec<[f64; 6]>) -> f64| -> f64 {
            let mean = runs.iter().map(value).sum::<f64>() / f64::from(SEEDS);
            runs.iter().map(|r| (value(r) - mean).powi(2)).sum::<f64>() / f64::from(SEEDS - 1)
        };
        let (mut of_means, mut of_elements) = (0.0, 0.0);
        for (a, b) in (0..6).flat_map(|a| (0..6).map(move |b| (a, b))).filter(|(a, b)| a != b) {
            let elements = 16 * a..16 * a + 16;
            of_means += variance(&|r| elements.clone().map(|e| r[e][b]).sum::<f64>() / 16.0);
            of_elements += elements.clone().map(|e| variance(&|r| r[e][b])).sum::<f64>() / 256.0;
        }
        let ratio = of_means / of_elements;
        eprintln!("{rays} rays: variance of means over that of independent elements {ratio:.3}");
        assert!((ratio - 1.0).abs() < 0.08, "{rays} rays: {ratio}");
    }
}

/// Polygon pairs with and without blockers, both ways, at two numbers of rays: 34 pairs x 2 x 2 =
/// 136 comparisons at 0.12 %, and half as many of reciprocity: 0.24 false alarms expected over all.
///
/// Factors that expect less than 50 hits are counted instead: the hits stay within bounds that a
/// Poisson count (which stratified points undercut) leaves in at most 0.1 %. Factors above 0.1 may
/// also be within 0.5 %.
#[test]
fn oracle_polygon_pairs() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    let mut problems = Vec::new();
    for rays in [16_384u32, 65_536] {
        let (mut compared, mut counted, mut worst, mut largest_error): (_, _, f64, f64) = (0, 0, 0.0, 0.0);
        let mut t_squared = 0.0;
        for e in &entries {
            let kind = e["kind"].as_str().unwrap_or_default();
            if !kind.starts_with("polygon_polygon") {
                continue;
            }
            let mut objects = vec![("a", vec![polygon(&e["poly1"])]), ("b", vec![polygon(&e["poly2"])])];
            if kind == "polygon_polygon_occluded" {
                let blockers = e["blockers"].as_array().expect("blockers").iter().map(polygon).collect();
                objects.push(("blocker", blockers));
            }
            let scene = scene(&objects);
            let t = table(&scene, 1e9, rays, 5);
            let mut well_known = true;
            for (a, b, key) in [(0, 1, "F12"), (1, 0, "F21")] {
                let exact = e[key].as_f64().expect("factor");
                let (f, error) = (t.form_factors[a][b], t.standard_errors[a][b]);
                let name = format!("{} {key} {rays}", e["id"]);
                let expected = exact * f64::from(rays);
                if exact == 0.0 {
                    if f != 0.0 {
                        problems.push(format!("{name}: {f}, exact 0"));
                    }
                } else if expected < 50.0 {
                    counted += 1;
                    well_known = false;
                    let hits = f * f64::from(rays);
                    let (low, high) = poisson_bounds(expected);
                    if hits < low - 1e-3 || hits > high + 1e-3 {
                        problems.push(format!("{name}: {hits} hits, expected {expected}"));
                    }
                } else {
                    compared += 1;
                    let off = (f - exact).abs();
                    // Single precision (origins moved by 1e-6 of the scene) may cost 1e-5 of the factor.
                    let sigma = error + 1e-5 * exact;
                    t_squared += (off / sigma).powi(2);
                    worst = worst.max(off / sigma);
                    if exact > 0.1 {
                        largest_error = largest_error.max(off / exact);
                    }
                    if off > T15 * sigma && !(exact > 0.1 && off <= 0.005 * exact) {
                        problems.push(format!("{name}: {f} +- {error:.1e}, exact {exact}"));
                    }
                    if rays == 65_536 && error > 0.05 * exact {
                        problems.push(format!("{name}: standard error {error:.1e} of {exact}"));
                    }
                }
            }
            let (ab, ba) = (t.areas[0] * t.form_factors[0][1], t.areas[1] * t.form_factors[1][0]);
            let sigma = (t.areas[0] * t.standard_errors[0][1]).hypot(t.areas[1] * t.standard_errors[1][0])
                + 1e-5 * ab;
            if well_known && (ab - ba).abs() > T15 * sigma {
                problems.push(format!("{} reciprocity {rays}: {ab} {ba} +- {sigma:.1e}", e["id"]));
            }
        }
        eprintln!(
            "{rays} rays: {compared} factors, worst {worst:.2} standard errors, rms {:.2}, factors above 0.1 within \
             {:.2} %; {counted} counted by hits",
            (t_squared / f64::from(compared)).sqrt(),
            100.0 * largest_error
        );
        assert!(compared > 50, "only {compared} comparisons");
    }
    assert!(problems.is_empty(), "{problems:#?}");
}

fn bits(matrix: &ExchangeMatrix) -> Vec<(usize, u64)> {
    (0..matrix.len()).flat_map(|r| matrix.row(r)).map(|(j, f)| (j, f.x.to_bits())).collect()
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let faces = box_faces([0.0; 3], [1.0, 0.7, 1.3], true);
    let scene = scene(&faces.iter().map(|(n, p)| (*n, vec![p.clone()])).collect::<Vec<_>>());
    let run = |threads: usize, seed: u32| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        bits(&pool.install(|| rows(&scene, 0.1, 200, seed)).1)
    };
    let one = run(1, 5);
    assert!(one == run(2, 5), "1 and 2 threads differ");
    assert!(one == run(2, 5), "two runs differ");
    assert!(one != run(2, 6), "another seed gives the same rays");
}

/// The 95 % interval (Student's t, 15 degrees of freedom: 2.131) over 40 seeds, both ways of a
/// smooth pair and of a blocked one: 80 intervals each, 76 expected to hold. Less than 85 % come by chance
/// in 3 of 10,000; of a program that states half its errors, 70 % would hold.
#[test]
fn standard_errors_are_calibrated() {
    let blocker = vec![[0.25, 0.25, 0.5], [0.75, 0.25, 0.5], [0.75, 0.75, 0.5], [0.25, 0.75, 0.5]];
    for (blockers, exact) in [(vec![], OPPOSED), (vec![blocker], 0.09950629459898479)] {
        let mut objects = vec![("a", vec![square(0.0, true)]), ("b", vec![square(1.0, false)])];
        if !blockers.is_empty() {
            objects.push(("blocker", blockers));
        }
        let scene = scene(&objects);
        let (mut held, mut squares, mut variance) = (0, 0.0, 0.0);
        for seed in 0..40 {
            let t = table(&scene, 10.0, 1024, 100 + seed);
            for (a, b) in [(0, 1), (1, 0)] {
                let (f, e) = (t.form_factors[a][b], t.standard_errors[a][b]);
                held += u32::from((f - exact).abs() <= 2.131 * e);
                squares += (f - exact).powi(2) / 80.0;
                variance += e * e / 80.0;
            }
        }
        eprintln!(
            "95 % intervals hold in {held} of 80; true error over stated: {:.2}",
            (squares / variance).sqrt()
        );
        assert!((68..=80).contains(&held), "{held} of 80");
        // 80 squared errors have a mean of standard error 16 %: a root within 25 % but for one in 1000.
        assert!(((squares / variance).sqrt() - 1.0).abs() < 0.25);
    }
}
