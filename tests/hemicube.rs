//! The hemi-cube against exact factors, itself and ray casting.

mod common;

use common::*;
use twopass::form_factor::{
    AtSpecular, Casting, ExchangeMatrix, HemicubeErrors, HemicubeSettings, ObjectTable, cast, hemicube,
};
use twopass::mesh::{Mesh, Sides};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

const OPPOSED: f64 = 0.19982489569838738;
const PERPENDICULAR: f64 = 0.20004377607540316;

fn settings(resolution: u32, grid: u32, rotations: u32) -> HemicubeSettings {
    HemicubeSettings { resolution, grid, rotations, seed: 1 }
}

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

fn rows(scene: &Scene, size: f64, settings: &HemicubeSettings) -> (Mesh, ExchangeMatrix) {
    let mesh = Mesh::new(scene, &Sides::fronts(scene), size, true).expect("mesh");
    let matrix = hemicube(scene, &mesh, settings, None, &|_| {});
    assert_closed(&matrix);
    (mesh, matrix)
}

fn table(scene: &Scene, size: f64, settings: &HemicubeSettings) -> ObjectTable {
    let (mesh, matrix) = rows(scene, size, settings);
    ObjectTable::new(scene, &mesh, &matrix, 0.0)
}

/// Every pixel is somewhere, with its whole weight. Entries are f32.
fn assert_closed(matrix: &ExchangeMatrix) {
    for row in 0..matrix.len() {
        let s = &matrix.summary[row];
        let landed: f64 = matrix.row(row).map(|(_, f)| f.x).sum();
        let sum = landed + s.escaped.x + s.absorbed.x + s.dropped.x;
        assert!((sum - 1.0).abs() < 1e-6, "row {row}: {landed} {s:?}");
    }
}

fn unit_cube() -> Scene {
    let faces = box_faces([0.0; 3], [1.0; 3], true);
    scene(&faces.iter().map(|(n, p)| (*n, vec![p.clone()])).collect::<Vec<_>>())
}

/// RMS of the 30 factors between the faces of the unit cube.
fn cube_error(scene: &Scene, size: f64, settings: &HemicubeSettings) -> f64 {
    let t = table(scene, size, settings);
    let mut squares = 0.0;
    for i in 0..6 {
        let row: f64 = t.form_factors[i].iter().sum();
        assert!((row - 1.0).abs() < 1e-6 && t.escaped[i] == 0.0, "face {i}: {row}, escaped {}", t.escaped[i]);
        assert_eq!(t.form_factors[i][i], 0.0);
        for j in (0..6).filter(|j| *j != i) {
            let exact = if i / 2 == j / 2 { OPPOSED } else { PERPENDICULAR };
            squares += (t.form_factors[i][j] - exact).powi(2) / 30.0;
        }
    }
    squares.sqrt()
}

/// Every row sums to one at any resolution, odd ones included; more points an element come nearer to the exact factors.
#[test]
fn cube_inside() {
    let scene = unit_cube();
    let error = |size, n, grid| cube_error(&scene, size, &settings(n, grid, 0));
    for n in [1, 2, 7, 33] {
        error(10.0, n, 1);
    }
    let (coarse, points) = (error(0.25, 64, 1), error(0.25, 64, 2));
    eprintln!("unit cube: rms error {coarse:.1e}, with 2 x 2 points {points:.1e}");
    assert!(coarse < 2e-3 && points < 0.5 * coarse);
}

/// A convex body in a closed room sees nothing but the room, whatever polygons pass behind the eye or through the planes
/// of the hemi-cube's sides; the room sees it with the ratio of the areas.
#[test]
fn convex_bodies_in_closed_rooms() {
    let quads = |f: Vec<(&str, Vec<Point>)>| f.into_iter().map(|(_, p)| p).collect::<Vec<_>>();
    let cases = [
        (
            quads(box_faces([1.0, 0.75, 1.25], [1.0; 3], false)),
            quads(box_faces([0.0; 3], [3.0; 3], true)),
            settings(48, 8, 0),
        ),
        (sphere(0.5, 6, false), sphere(1.0, 12, true), settings(47, 2, 1)),
    ];
    for (inner, outer, settings) in cases {
        let scene = scene(&[("inner", inner), ("outer", outer)]);
        let t = table(&scene, 100.0, &settings);
        let ratio = t.areas[0] / t.areas[1];
        // Every single pixel: no cracks between faces, no body seen through.
        assert_eq!(t.escaped, [0.0, 0.0]);
        assert!((t.form_factors[0][1] - 1.0).abs() < 1e-6, "{}", t.form_factors[0][1]);
        assert_eq!(t.form_factors[0][0], 0.0);
        eprintln!("room to body: {:.6}, exact {ratio:.6}", t.form_factors[1][0]);
        assert!((t.form_factors[1][0] / ratio - 1.0).abs() < 0.02);
    }
}

/// Oracle pairs with and without blockers, both ways, each polygon one element. Grids and pixels are refined together: an edge that
/// crosses a hemi-cube cuts some N pixels of some 1/N^2, and where a polygon crosses the other's plane, its factor jumps by up
/// to a half within one row of points, a half of which may be counted wrongly. So errors stay below a constant over
/// N, the same at both resolutions.
#[test]
fn oracle_polygon_pairs() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    for (n, grid) in [(24, 6), (48, 12)] {
        let (mut worst, mut squares, mut count): (f64, f64, _) = (0.0, 0.0, 0);
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
            let t = table(&scene(&objects), 1e9, &settings(n, grid, 0));
            for (a, b, key) in [(0, 1, "F12"), (1, 0, "F21")] {
                let exact = e[key].as_f64().expect("factor");
                let off = (t.form_factors[a][b] - exact).abs();
                let id = &e["id"];
                if exact == 0.0 {
                    assert_eq!(off, 0.0, "{id} {key}");
                }
                assert!(
                    off <= PER_PIXEL / f64::from(n),
                    "{id} {key} at {n}: {} exact {exact}",
                    t.form_factors[a][b]
                );
                worst = worst.max(off);
                squares += off * off;
                count += 1;
            }
        }
        let rms = (squares / f64::from(count)).sqrt();
        eprintln!(
            "{n} pixels, {grid} x {grid}: {count} factors, rms {rms:.1e}, worst {worst:.1e} = {:.2} / N",
            worst * f64::from(n)
        );
        assert!(count > 60);
    }
}

/// Largest error of a factor times the resolution in [`oracle_polygon_pairs`].
const PER_PIXEL: f64 = 0.75;

/// Rotations make noise of aliasing, with standard errors that hold: points (elements of a millionth of a metre) against
/// Lambert's formula, 16 rotations each at three resolutions, two targets: 6 comparisons at 0.12 %. The
/// errors fall with the resolution.
#[test]
fn rotations_give_standard_errors() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    for e in of_kind(&entries, "point_polygon") {
        let p = &e["params"];
        let (point, normal) =
            (numbers(&p["point"]), glam::DVec3::from_slice(&numbers(&p["normal"])).normalize());
        let (x, y) = normal.any_orthonormal_pair();
        let (x, y) = if x.cross(y).dot(normal) > 0.0 { (x, y) } else { (y, x) };
        let corner = |s: f64, t: f64| -> Point {
            (glam::DVec3::from_slice(&point) + 1e-6 * (s * x + t * y)).to_array()
        };
        let patch = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        let scene = scene(&[("point", vec![patch]), ("target", vec![polygon(&p["poly"])])]);
        let exact = e["F12"].as_f64().expect("factor");
        let mut last = f64::INFINITY;
        for n in [16, 64, 256] {
            let t = table(&scene, 1e9, &settings(n, 1, 16));
            let (f, error) = (t.form_factors[0][1], t.standard_errors[0][1]);
            eprintln!("{} at {n}: {f:.6} +- {error:.1e}, exact {exact:.6}", e["id"]);
            assert!(
                (f - exact).abs() <= T15 * error + 1e-7,
                "{} at {n}: {f} +- {error:.1e}, exact {exact}",
                e["id"]
            );
            // Four times the pixels along an edge: four times less each by count, more by their independence.
            assert!(error < 0.5 * last && error > 0.0);
            last = error;
        }
    }
}

/// A room with a box that stands on its floor (whose pieces round the box have corners on each other's edges) and a
/// screen: factors between objects as rays find them, 9 comparisons at 0.12 %, with what the hemi-cubes' own pixels and
/// points may miss.
#[test]
fn agrees_with_ray_casting() {
    let mut objects: Vec<(&str, Vec<Vec<Point>>)> =
        vec![("room", box_faces([0.0; 3], [2.0, 1.5, 1.0], true).into_iter().map(|(_, p)| p).collect())];
    objects.push((
        "box",
        box_faces([0.4, 0.3, 0.0], [0.5, 0.4, 0.6], false).into_iter().map(|(_, p)| p).collect(),
    ));
    objects.push(("screen", vec![vec![[1.3, 0.2, 0.1], [1.5, 1.0, 0.1], [1.4, 1.0, 0.8], [1.2, 0.2, 0.8]]]));
    let scene = scene(&objects);
    let own = table(&scene, 0.25, &settings(64, 3, 0));
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.25, true).expect("mesh");
    let casting = Casting {
        rays: 4096,
        batches: 16,
        seed: 3,
        specular: AtSpecular::End,
        reached: None,
        emitters: None,
        progress: &|_| {},
    };
    let (matrix, _) = cast(&visibility, &mesh, &casting);
    let rays = ObjectTable::new(&scene, &mesh, &matrix, 0.0);
    for a in 0..3 {
        for b in 0..3 {
            let (f, r, e) = (own.form_factors[a][b], rays.form_factors[a][b], rays.standard_errors[a][b]);
            eprintln!("{} to {}: {f:.5}, by rays {r:.5} +- {e:.1e}", own.objects[a], own.objects[b]);
            assert!((f - r).abs() <= T15 * e + 2e-3, "{a} {b}: {f} {r} +- {e}");
        }
    }
    // Backs block and take no part: the screen's back is somewhere, not outside.
    let escaped = format!("{:?}, by rays {:?}", own.escaped, rays.escaped);
    assert!(own.escaped.iter().zip(&rays.escaped).all(|(a, b)| (a - b).abs() < 1e-12), "{escaped}");
    assert!(matrix.summary.iter().any(|s| s.absorbed.x > 0.0));
}

/// What turns with the scene does not change but for aliasing; what is moved along changes by nothing that counts.
#[test]
fn turned_scenes_have_the_same_factors() {
    let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -0.7);
    let build = |move_: &dyn Fn(Point) -> Point| {
        let faces = box_faces([0.0; 3], [1.0, 2.0, 0.5], true);
        let moved = |p: Vec<Point>| vec![p.into_iter().map(move_).collect::<Vec<_>>()];
        scene(&faces.into_iter().map(|(n, p)| (n, moved(p))).collect::<Vec<_>>())
    };
    let at = |scene: &Scene| table(scene, 0.5, &settings(96, 1, 0)).form_factors;
    let still = at(&build(&|p| p));
    let far = at(&build(&|p| [p[0] + 1e5, p[1] - 1e5, p[2]]));
    let turned = at(&build(&|p| (turn * glam::DVec3::from(p)).to_array()));
    for (a, b) in (0..36).map(|k| (k / 6, k % 6)) {
        assert!(
            (still[a][b] - far[a][b]).abs() < 2e-3 * still[a][b].max(0.1),
            "{a} {b}: {} {}",
            still[a][b],
            far[a][b]
        );
        assert!((still[a][b] - turned[a][b]).abs() < 0.4 / 96.0, "{a} {b}: {} {}", still[a][b], turned[a][b]);
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_for_some_rows() {
    let scene = unit_cube();
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.2, true).expect("mesh");
    let run = |threads: usize, seed: u32, rows: Option<&[bool]>| -> Vec<(usize, u64)> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let settings = HemicubeSettings { seed, ..settings(40, 2, 3) };
        let matrix = pool.install(|| hemicube(&scene, &mesh, &settings, rows, &|_| {}));
        assert_eq!((matrix.batches(), matrix.len()), (3, mesh.len()));
        (0..matrix.len()).flat_map(|r| matrix.row(r)).map(|(j, f)| (j, f.x.to_bits())).collect()
    };
    let one = run(1, 5, None);
    assert!(one == run(3, 5, None), "1 and 3 threads differ");
    assert!(one != run(1, 6, None), "another seed gives the same rotations");
    let rows: Vec<bool> = (0..mesh.len()).map(|e| e == 7 || e == 30).collect();
    let some = run(2, 5, Some(&rows));
    assert!(!some.is_empty() && some.len() < one.len() / 20);
    assert!(one.windows(some.len() / 2).any(|w| w == &some[..some.len() / 2]), "row 7 differs");
}

/// The measured estimates name the right culprit: aliasing falls with the resolution and not with the grid's points,
/// proximity falls with the grid and not with the resolution, and visibility is there only with something in the way.
#[test]
fn errors_are_told_apart() {
    let open = scene(&[
        ("a", vec![vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]]),
        ("b", vec![vec![[0.0, 1.0, 0.5], [1.0, 1.0, 0.5], [1.0, 0.0, 0.5], [0.0, 0.0, 0.5]]]),
    ]);
    let blocked = scene(&[
        ("a", vec![vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]]),
        ("b", vec![vec![[0.0, 1.0, 0.5], [1.0, 1.0, 0.5], [1.0, 0.0, 0.5], [0.0, 0.0, 0.5]]]),
        ("blocker", vec![vec![[0.4, 0.4, 0.2], [0.9, 0.4, 0.2], [0.9, 0.9, 0.2], [0.4, 0.9, 0.2]]]),
    ]);
    let measure = |scene: &Scene, n, grid| {
        let mesh = Mesh::new(scene, &Sides::fronts(scene), 0.5, true).expect("mesh");
        let errors = HemicubeErrors::measure(scene, &mesh, &settings(n, grid, 0));
        eprintln!("{n} pixels, grid {grid}: {errors:?}");
        errors
    };
    let (coarse, fine, points) = (measure(&open, 16, 1), measure(&open, 128, 1), measure(&open, 128, 3));
    assert!(fine.aliasing_rms < 0.3 * coarse.aliasing_rms && fine.aliasing_rms > 0.0);
    assert!(
        (fine.proximity_rms / coarse.proximity_rms - 1.0).abs() < 0.2
            && points.proximity_rms < 0.3 * fine.proximity_rms
    );
    assert!(fine.visibility_rms < 0.1 * fine.proximity_rms);
    let screen = measure(&blocked, 128, 1);
    assert!(screen.visibility_rms > 10.0 * fine.visibility_rms, "{screen:?}");
}
