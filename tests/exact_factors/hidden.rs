//! Elements that others hide from each other, in part or past many bodies.

use super::*;

/// Hemisphere rays in 16 randomisations: what pairs are compared with.
fn hemisphere(rays: u32) -> Casting<'static> {
    Casting {
        rays,
        batches: 16,
        seed: 3,
        specular: AtSpecular::End,
        reached: None,
        emitters: None,
        progress: &|_| (),
    }
}

/// One of 80 strips of a blind half-way between two unit squares.
fn strip(k: usize) -> Vec<Point> {
    let x = k as f64 / 80.0;
    vec![[x, 0.0, 0.5], [x + 1.0 / 240.0, 0.0, 0.5], [x + 1.0 / 240.0, 1.0, 0.5], [x, 1.0, 0.5]]
}

/// Two unit squares with the blind between.
fn blind() -> Scene {
    scene(&[
        ("a", vec![square(0.0, true)]),
        ("b", vec![square(1.0, false)]),
        ("blind", (0..80).map(strip).collect()),
    ])
}

/// More bodies between two squares than cells are made for: 80 strips hide a third of the way. The squares' hemisphere rays tell, or
/// rays from area to area where an error is asked for; both agree with other hemisphere rays.
#[test]
fn many_blockers_take_rays() {
    let scene = blind();
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
    let rows = cast(&visibility, &mesh, &hemisphere(1 << 18)).0;
    let h = ObjectTable::new(&scene, &mesh, &rows, 0.0);
    let g = h.form_factors[0][1];
    for asked in [None, Some(0.01)] {
        let asked = Request { error: asked, by_object: false, ..request(65_536, 5) };
        let found = estimate(&visibility, &mesh, &asked);
        let counts = found.pairs().expect("few elements").counts;
        let by_points = u64::from(asked.error.is_some());
        assert_eq!(
            (counts.rays, counts.hemisphere, counts.shadows),
            (by_points, 1 - by_points, 0),
            "{counts:?}"
        );
        let t = found.table(&scene, &mesh, 0.0);
        let f = t.form_factors[0][1];
        let error = t.standard_errors[0][1].hypot(h.standard_errors[0][1]);
        eprintln!("{f:.6} by pairs, {g:.6} by hemisphere rays, +- {error:.1e}");
        assert!((f - g).abs() <= T15 * error && error < 0.015 * g);
        assert!((t.form_factors[1][0] / f - 1.0).abs() < 1e-12);
    }
}

/// A patch just above a floor a hundred times as wide, with screens halfway between: what the patch sees of the floor is what
/// it would see less what it sees of the screens, since all that they cover lies on the floor. The factor does not depend on which of both comes first,
/// is right within its standard error, and this within what is asked.
#[test]
fn a_small_patch_sees_a_wide_floor_past_screens() {
    let level = |o: [f64; 2], w: f64, h: f64, z: f64, up: bool| {
        let mut p = vec![[o[0], o[1], z], [o[0] + w, o[1], z], [o[0] + w, o[1] + h, z], [o[0], o[1] + h, z]];
        if !up {
            p.reverse();
        }
        p
    };
    let (floor, patch) = (level([-5.0; 2], 10.0, 10.0, 0.0, true), level([1.3; 2], 0.1, 0.1, 0.1, false));
    let one = vec![level([1.25; 2], 0.1, 0.2, 0.05, true)];
    // No two of them touch.
    let tile = |k: usize| {
        let (i, j) = ((k % 8) as f64, (k / 8) as f64);
        level([1.24 + 0.025 * i, 1.27 + 0.031 * j], 0.012 + 0.001 * j, 0.02 + 0.001 * i, 0.05, true)
    };
    let device = device();
    let mut loose = 0;
    for screens in [one, (0..40).map(tile).collect()] {
        let seen = |p: &[Point]| exchange(&poly(&patch), &poly(p), EXACT) / 0.01;
        let exact = seen(&floor) - screens.iter().map(|s| seen(s)).sum::<f64>();
        for floor_first in [true, false] {
            let mut objects = vec![("patch", vec![patch.clone()]), ("screens", screens.clone())];
            objects.insert(if floor_first { 0 } else { 1 }, ("floor", vec![floor.clone()]));
            let scene = scene(&objects);
            let visibility = Visibility::new(&device, &scene).expect("tree");
            let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
            for error in [None, Some(0.01)] {
                let t = estimate(&visibility, &mesh, &Request { error, ..request(16_384, 2) })
                    .table(&scene, &mesh, 0.0);
                let (patch, floor) = if floor_first { (1, 0) } else { (0, 1) };
                let (f, stated) = (t.form_factors[patch][floor], t.standard_errors[patch][floor]);
                let off = (f - exact).abs();
                eprintln!("{} screens, {error:?}: {f:.6} +- {stated:.1e}, exact {exact:.6}", screens.len());
                assert!(
                    off <= T15 * stated && stated <= error.unwrap_or(0.002) * f,
                    "{f} +- {stated}, exact {exact}"
                );
                loose += usize::from(off > 2.0 * stated);
            }
        }
    }
    assert!(loose <= 1, "{loose} of 8 beyond two standard errors");
}

/// Errors that no number of rays meets are counted, and the largest is given with its elements; the same pairs meet one within reach.
#[test]
fn errors_that_are_not_met_are_counted() {
    let scene = blind();
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
    for (error, missed) in [(0.1, 0), (1e-5, 2)] {
        let asked = Request { error: Some(error), floor: 1e-6, by_object: false, ..request(16, 5) };
        let found = estimate(&visibility, &mesh, &asked);
        let pairs = found.pairs().expect("an error was asked for");
        let warnings = found.warnings(&scene, Some(error));
        let Some(misses) = pairs.misses() else {
            assert!(missed == 0 && warnings.is_empty(), "{warnings:?}");
            continue;
        };
        assert_eq!((misses.count, misses.worst.1, misses.worst.2), (missed, 0, 1));
        let (f, e) = pairs.factor(0, 1);
        assert!((misses.worst.0 - e / f).abs() < 1e-12 && e / f > error);
        let text = format!("not met by 2 of {} factors", misses.of);
        assert!(warnings.len() == 1 && warnings[0].contains(&text), "{warnings:?}");
    }
}

/// No factor of the Cornell box is farther than what was asked for from what a hundredth of that finds: views of the back wall
/// past both blocks bend where no point of a cell is.
#[test]
fn views_that_bend_between_points() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell/cornell.toml");
    let scene = twopass::scene::load(&path).expect("scene");
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.085, true).expect("mesh");
    let find = |error: f64| {
        let asked = Request { error: Some(error), floor: 1e-6, by_object: false, ..request(16, 0) };
        estimate(&visibility, &mesh, &asked)
    };
    let (quick, fine) = (find(0.01), find(1e-4));
    let [quick, fine] = [&quick, &fine].map(|found| found.pairs().expect("an error was asked for"));
    assert_eq!(quick.misses(), None);
    let (mut count, mut worst) = (0, 0.0f64);
    for i in 0..mesh.len() {
        for (j, f) in fine.row(i).filter(|(_, f)| *f > 1e-6) {
            let off = (quick.factor(i, j).0 / f - 1.0).abs();
            assert!(off <= 0.01, "from {i} to {j}: {}, {f}", quick.factor(i, j).0);
            (count, worst) = (count + 1, worst.max(off));
        }
    }
    eprintln!("{count} factors off by {worst:.1e} at most");
    assert!(count > 100_000);
}

/// A closed room with a block on its floor, element by element: rows close without hemisphere rays having any part in it,
/// nothing passes through the block, and the sums by object agree with rays.
#[test]
fn rows_of_a_closed_room_close() {
    let quads = |f: Vec<(&str, Vec<Point>)>| f.into_iter().map(|(_, p)| p).collect::<Vec<_>>();
    let mut block = quads(box_faces([0.3, 0.4, 0.0], [0.3, 0.25, 0.5], false));
    // It stands on the floor: no bottom.
    block.remove(4);
    let scene = scene(&[("room", quads(box_faces([0.0; 3], [1.0; 3], true))), ("block", block)]);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.25, true).expect("mesh");
    let request = Request { error: Some(0.005), by_object: false, ..request(64, 1) };
    let found = estimate(&visibility, &mesh, &request);
    let pairs = found.pairs().expect("an error was asked for");
    eprintln!("{:?}", pairs.counts);
    assert!(pairs.counts.hidden > 0 && pairs.counts.cells > 0 && pairs.counts.free > 0);
    let rows = found.rows().expect("hemisphere rays too");
    let mut worst: f64 = 0.0;
    for i in 0..mesh.len() {
        let sum: f64 = pairs.row(i).map(|(_, f)| f).sum();
        // What starts under the block ends at the insides of its faces: rays count that share, coarsely.
        let inside = rows.summary[i].absorbed.x;
        if inside == 0.0 {
            worst = worst.max((sum - 1.0).abs());
        }
    }
    eprintln!("rows close within {worst:.1e}");
    assert!(worst < 1e-4);
}

/// A room with a hole in its ceiling: what escapes is what the factors leave of 1, in the rows too whose few hemisphere rays all met a
/// surface (of 128, three rows in four have none that meets a gap of 0.2 %).
#[test]
fn rows_of_an_open_room_say_what_escapes() {
    let mut room: Vec<Vec<Point>> = box_faces([0.0; 3], [1.0; 3], true).into_iter().map(|f| f.1).collect();
    // Instead of the ceiling four strips around a hole of 0.1 x 0.1.
    let lid = room.iter().position(|f| f.iter().all(|p| p[2] == 1.0)).expect("ceiling");
    room.remove(lid);
    let strip = |x: f64, y: f64, w: f64, h: f64| -> [Point; 4] {
        [[x, y, 1.0], [x, y + h, 1.0], [x + w, y + h, 1.0], [x + w, y, 1.0]]
    };
    room.extend([
        strip(0.0, 0.0, 0.45, 1.0).to_vec(),
        strip(0.55, 0.0, 0.45, 1.0).to_vec(),
        strip(0.45, 0.0, 0.1, 0.45).to_vec(),
        strip(0.45, 0.55, 0.1, 0.45).to_vec(),
    ]);
    // Scenes lie about the origin.
    let hole = poly(&strip(0.45, 0.45, 0.1, 0.1).map(|p| p.map(|x| x - 0.5)));
    let scene = scene(&[("room", room)]);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.25, true).expect("mesh");
    let asked = Request { error: Some(0.01), floor: 1e-6, by_object: false, ..request(16, 1) };
    let found = estimate(&visibility, &mesh, &asked);
    let (pairs, rows) = (found.pairs().expect("an error was asked for"), found.rows().expect("rays too"));
    let mut unmet = 0;
    for i in 0..mesh.len() {
        let element = Polygon::of_element(&scene, &mesh, i as u32);
        let exact = exchange(&element, &hole, EXACT) / mesh.area(i as u32);
        let rest = pairs.rest(i, Some(rows));
        unmet += u32::from(rows.summary[i].escaped.x == 0.0 && exact > 1e-3);
        assert!((rest.escaped.x - exact).abs() < 2e-4, "element {i}: {} {exact}", rest.escaped.x);
    }
    eprintln!("{unmet} of {} rows have no ray that escapes", mesh.len());
    assert!(unmet > 0);
}

/// A closed room with a block, its pairs so roughly that rows miss more than a thousandth: what few rays did not find is no gap, for it is within a
/// few standard errors of the row.
#[test]
fn rough_rows_of_a_closed_room_are_not_open() {
    let quads = |f: Vec<(&str, Vec<Point>)>| f.into_iter().map(|(_, p)| p).collect::<Vec<_>>();
    let scene = scene(&[
        ("room", quads(box_faces([0.0; 3], [1.0; 3], true))),
        ("block", quads(box_faces([0.3, 0.4, 0.2], [0.3, 0.25, 0.5], false))),
    ]);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
    let rows = cast(&visibility, &mesh, &hemisphere(64)).0;
    let mut short = 0;
    for seed in 0..8 {
        let work = PairWork {
            points: 1,
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
        for i in 0..mesh.len() {
            let sum: f64 = pairs.row(i).map(|(_, f)| f).sum();
            short += u32::from(sum < 1.0 - 1e-3);
            let rest = pairs.rest(i, Some(&rows));
            assert!(rest.escaped.x == 0.0, "element {i}: {} escapes, the row sums to {sum}", rest.escaped.x);
        }
    }
    eprintln!("{short} of {} rows sum to less than 0.999", 8 * mesh.len());
    assert!(short > 0);
}

/// Occluded pairs of the oracle, cut into so many elements that their pairs are integrated cell by cell: summed over elements, the
/// exact factors, within a fiftieth of the error that was asked of each pair.
#[test]
fn oracle_occluded_pairs_by_cells() {
    let Some(entries) = oracle("public_form_factors.json") else { return };
    let mut cells = 0;
    for e in of_kind(&entries, "polygon_polygon_occluded") {
        let blockers = e["blockers"].as_array().expect("blockers").iter().map(polygon).collect();
        let objects = [("a", vec![polygon(&e["poly1"])]), ("b", vec![polygon(&e["poly2"])]), ("c", blockers)];
        let scene = scene(&objects);
        let area: f64 = scene.faces.iter().map(|f| f.area).sum();
        let device = device();
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), (area / 300.0).sqrt(), true).expect("mesh");
        let asked = Request { error: Some(0.01), floor: 1e-6, by_object: false, ..request(16, 1) };
        let found = estimate(&visibility, &mesh, &asked);
        let counts = found.pairs().expect("an error was asked for").counts;
        assert_eq!((counts.shadows, counts.rays), (0, 0), "{counts:?}");
        cells += counts.cells;
        let t = found.table(&scene, &mesh, 0.0);
        for (a, b, key) in [(0, 1, "F12"), (1, 0, "F21")] {
            let (want, f) = (e[key].as_f64().expect("factor"), t.form_factors[a][b]);
            eprintln!("{} {key}, {} elements: off by {:.1e}", e["id"], mesh.len(), f / want - 1.0);
            assert!((f - want).abs() <= 2e-4 * want + 1e-15, "{} {key}: {f}, exact {want}", e["id"]);
        }
    }
    assert!(cells > 10_000, "{cells}");
}

/// A strip looks at a ceiling over the edge of a shelf, two centimetres below it and level with the strip's upper edge: what it
/// sees begins and ends within five millimetres of a metre's length. Exact: Lambert's formula for what is left of the
/// ceiling, in 100,000 points of the strip.
#[test]
fn a_view_that_opens_along_an_edge() {
    let shelf = vec![[0.1, -1.0, 0.0], [2.0, -1.0, 0.0], [2.0, 2.0, 0.0], [0.1, 2.0, 0.0]];
    let ceiling = |end: f64| vec![[0.5, 0.0, 0.02], [0.5, 1.0, 0.02], [end, 1.0, 0.02], [end, 0.0, 0.02]];
    let strip = vec![[0.0, 0.0, -0.01], [0.0, 1.0, -0.01], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]];
    let far = vec![[0.0, 0.0, -9.0], [0.0, 9.0, -9.0], [9.0, 9.0, -9.0], [9.0, 0.0, -9.0]];
    let scene = scene(&[
        ("strip", vec![strip.clone()]),
        ("ceiling", vec![ceiling(1.5)]),
        ("shelf", vec![shelf]),
        ("far", vec![far]),
    ]);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1.0, true).expect("mesh");
    let asked = Request { error: Some(0.001), floor: 1e-9, by_object: false, ..request(16, 1) };
    let found = estimate(&visibility, &mesh, &asked);
    let table = found.table(&scene, &mesh, 0.0);
    let (n, m) = (1000, 100);
    let points = (0..n * m).map(|k| {
        let z = -0.005 * ((k / m) as f64 + 0.5) / n as f64;
        let end = (0.1 * (0.02 - z) / -z).min(1.5);
        let point = DVec3::new(0.0, ((k % m) as f64 + 0.5) / m as f64, z);
        if end > 0.5 { differential(point, DVec3::X, &poly(&ceiling(end))) } else { 0.0 }
    });
    let exact = 0.5 * points.sum::<f64>() / (n * m) as f64;
    let f = table.form_factors[0][1];
    let free = exchange(&poly(&ceiling(1.5)), &poly(&strip), EXACT) / 0.01;
    eprintln!("{f:.6e} by cells, {exact:.6e} exact, {free:.6e} without the shelf; {} elements", mesh.len());
    assert!((f / exact - 1.0).abs() < 0.001 && exact < 0.5 * free, "{f} {exact}");
}

/// Two plates with 48 small ones between: up to so many bodies hide elements from each other. What each element sees of the
/// other plate agrees with hemisphere rays: 72 such sums, each within [`T15`] errors of the rays (15 degrees of freedom) and a
/// thousandth.
#[test]
fn many_bodies_by_cells() {
    let plate = |k: usize| {
        let (i, j, l) = ((k % 4) as f64, (k / 4 % 4) as f64, (k / 16) as f64);
        let (x, y, z) = (0.05 + 0.25 * i + 0.03 * l, 0.04 + 0.23 * j, 0.2 + 0.25 * l + 0.02 * i);
        let (w, h) = (0.1 + 0.02 * j, 0.12);
        vec![[x, y, z], [x + w, y, z + 0.05], [x + w, y + h, z + 0.05], [x, y + h, z]]
    };
    let scene = scene(&[
        ("a", vec![square(0.0, true)]),
        ("b", vec![square(1.0, false)]),
        ("plates", (0..48).map(plate).collect()),
    ]);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.17, true).expect("mesh");
    let asked = Request { error: Some(0.01), floor: 1e-6, by_object: false, ..request(16, 1) };
    let found = estimate(&visibility, &mesh, &asked);
    let pairs = found.pairs().expect("an error was asked for");
    eprintln!("{} elements, {:?}", mesh.len(), pairs.counts);
    assert_eq!((pairs.counts.shadows, pairs.counts.rays, pairs.counts.missed), (0, 0, 0));
    let rows = cast(&visibility, &mesh, &hemisphere(131_072)).0;
    let object = |e: usize| scene.faces[mesh.place(e as u32).0 as usize].object;
    let (mut worst, mut largest): (f64, f64) = (0.0, 0.0);
    for i in (0..mesh.len()).filter(|i| object(*i) < 2) {
        let other = 1 - object(i);
        let sum: f64 = pairs.row(i).filter(|(j, _)| object(*j) == other).map(|(_, f)| f).sum();
        let seen = |b: usize| -> f64 {
            rows.batch(i, b).filter(|(j, _)| object(*j) == other).map(|(_, f)| 16.0 * f.x).sum()
        };
        let batches: Vec<f64> = (0..16).map(seen).collect();
        let mean = batches.iter().sum::<f64>() / 16.0;
        let error = (batches.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / (16.0 * 15.0)).sqrt();
        assert!(
            (sum - mean).abs() <= T15 * error + 1e-3 * mean,
            "element {i}: {sum}, rays {mean} +- {error}"
        );
        (worst, largest) = (worst.max((sum - mean).abs() / mean), largest.max(error / mean));
    }
    eprintln!("sums off by {worst:.1e} at most, the rays' errors {largest:.1e}");
    assert!(largest < 0.015);
}

/// A drum of 100 sides between two squares is one body, as large a number of corners as its outline gives what is seen
/// past it: the factor meets the error that is asked for, and agrees with hemisphere rays within [`T15`] errors of both.
#[test]
fn a_body_of_many_sides_is_one() {
    const SIDES: usize = 100;
    let corner = |k: usize, z: f64| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / SIDES as f64).sin_cos();
        [0.5 + 0.3 * cos, 0.5 + 0.3 * sin, z]
    };
    let (bottom, top) = (0.3, 0.65);
    let side = |k: usize| {
        let next = (k + 1) % SIDES;
        vec![corner(k, bottom), corner(next, bottom), corner(next, top), corner(k, top)]
    };
    let mut drum: Vec<_> = (0..SIDES).map(side).collect();
    for k in 1..SIDES - 1 {
        drum.push(vec![corner(0, bottom), corner(k + 1, bottom), corner(k, bottom)]);
        drum.push(vec![corner(0, top), corner(k, top), corner(k + 1, top)]);
    }
    let scene = scene(&[("a", vec![square(0.0, true)]), ("b", vec![square(1.0, false)]), ("drum", drum)]);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 1e9, true).expect("mesh");
    let found = estimate(&visibility, &mesh, &Request { error: Some(1e-3), ..request(64, 1) });
    let counts = found.pairs().expect("an error was asked for").counts;
    assert_eq!((counts.cells, counts.shadows, counts.rays, counts.missed), (1, 0, 0, 0), "{counts:?}");
    let table = found.table(&scene, &mesh, 0.0);
    let (factor, stated) = (table.form_factors[0][1], table.standard_errors[0][1]);
    let object = |e: usize| scene.faces[mesh.place(e as u32).0 as usize].object;
    let lower: Vec<bool> = (0..mesh.len()).map(|e| object(e) == 0).collect();
    let rows = cast_rows(&visibility, &mesh, &hemisphere(1 << 20), Some(&lower)).0;
    let a = lower.iter().position(|is| *is).expect("one element");
    let seen = |k: usize| rows.batch(a, k).filter(|(j, _)| object(*j) == 1).map(|(_, f)| 16.0 * f.x).sum();
    let (mean, error) = mean_error(&(0..16).map(seen).collect::<Vec<f64>>());
    eprintln!("{factor:.6} +- {stated:.1e}, by rays {mean:.6} +- {error:.1e}");
    assert!(stated <= 1e-3 * factor && error <= 2e-3 * mean);
    assert!((factor - mean).abs() <= T15 * stated.hypot(error));
}

/// A room with a box, as a file of few faces that are cut into elements and as a file of as many faces as elements: the same factors.
#[test]
fn faces_that_continue_each_other_block_as_one() {
    let grid = |p: &[Point], n: usize| -> Vec<Vec<Point>> {
        let at = |s: usize, t: usize| {
            let (s, t) = (s as f64 / n as f64, t as f64 / n as f64);
            [0, 1, 2].map(|k| p[0][k] + s * (p[1][k] - p[0][k]) + t * (p[3][k] - p[0][k]))
        };
        let cell = |k: usize| {
            let (s, t) = (k % n, k / n);
            vec![at(s, t), at(s + 1, t), at(s + 1, t + 1), at(s, t + 1)]
        };
        (0..n * n).map(cell).collect()
    };
    let mut quads: Vec<Vec<Point>> = box_faces([0.0; 3], [1.0; 3], true).into_iter().map(|f| f.1).collect();
    let mut block: Vec<Vec<Point>> =
        box_faces([0.25, 0.25, 0.25], [0.5; 3], false).into_iter().map(|f| f.1).collect();
    quads.append(&mut block);
    let fine: Vec<_> =
        quads.iter().enumerate().flat_map(|(k, q)| grid(q, if k < 6 { 4 } else { 2 })).collect();
    let device = device();
    let [few, many] = [quads, fine].map(|polygons| {
        let scene = scene(&[("all", polygons)]);
        let visibility = Visibility::new(&device, &scene).expect("tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.25, true).expect("mesh");
        let asked = Request { error: Some(0.01), floor: 1e-6, by_object: false, ..request(16, 1) };
        let found = estimate(&visibility, &mesh, &asked);
        let pairs = found.pairs().expect("an error was asked for");
        eprintln!("{} faces: {:?}", scene.faces.len(), pairs.counts);
        let mut factors: Vec<f64> = (0..mesh.len()).flat_map(|i| pairs.row(i).map(|(_, f)| f)).collect();
        factors.sort_by(f64::total_cmp);
        (mesh.len(), pairs.counts, factors)
    });
    assert_eq!((few.0, few.1), (many.0, many.1));
    assert!(few.1.hidden > 100 && few.1.cells > 100);
    let sums = [&few, &many].map(|f| f.2.iter().sum::<f64>());
    assert!((sums[0] / sums[1] - 1.0).abs() < 1e-5, "{sums:?}");
    let off = few.2.iter().zip(&many.2).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
    assert!(few.2.len() == many.2.len() && off < 0.01, "{off}");
}

/// A lamp of a hundredth of the ceiling above a block, among elements that hemisphere rays look at: its factors are as good as
/// those found pair by pair, both ways, the rest is no noisier than the rays alone had it, and rows stay closed.
#[test]
fn factors_of_a_small_lamp_are_exact_beside_rays() {
    let mut files = Files::default();
    files.diffuse("m", &[0.5], &[0.0]).diffuse("glow", &[0.5], &[1.0]);
    box_faces([0.0; 3], [1.0; 3], true).iter().for_each(|(_, p)| {
        files.polygon("room", "m", p);
    });
    // It stands on the floor: no bottom.
    box_faces([0.3, 0.4, 0.0], [0.3, 0.25, 0.5], false).iter().filter(|f| f.0 != "z0").for_each(|(_, p)| {
        files.polygon("block", "m", p);
    });
    files.polygon("lamp", "glow", &[[0.6, 0.6, 0.95], [0.6, 0.7, 0.95], [0.7, 0.7, 0.95], [0.7, 0.6, 0.95]]);
    let scene = files.load();
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.1, true).expect("mesh");
    let n = mesh.len();
    let lamp: Vec<bool> = (0..n as u32)
        .map(|e| scene.objects[scene.faces[mesh.place(e).0 as usize].object as usize] == "lamp")
        .collect();
    assert!(n > 600 && lamp.iter().filter(|l| **l).count() == 1);
    let asked = |rays, error| Request { error, floor: 1e-6, by_object: false, ..request(rays, 3) };
    let converged = estimate(&visibility, &mesh, &asked(16, Some(0.002)));
    let converged = converged.pairs().expect("an error was asked for");
    let found = estimate(&visibility, &mesh, &asked(256, None));
    let rays = found.rows().expect("hemisphere rays");
    let dense = |few| {
        let f = Factors::of_elements(&scene, &mesh, (rays, few), 0..n, 0.0);
        let mut all = vec![0.0; n * n];
        for i in 0..n {
            let (columns, values, _) = f.row(i);
            let sum: f64 = values.iter().sum();
            // A lamp's own row is made of pairs alone, and closes as well as these were integrated.
            let allowed = if lamp[i] { 1e-3 } else { 1e-6 };
            let open = sum + f.escaped[i] + f.absorbed[i] - 1.0;
            assert!(open.abs() < allowed, "row {i}: {open:.1e}");
            columns.iter().zip(values).for_each(|(j, v)| all[i * n + *j as usize] = *v);
        }
        all
    };
    let Estimates::Rows(_, Some(lamps)) = &found.estimates else { panic!("a lamp") };
    let (mended, alone) = (dense(Some(lamps)), dense(None));
    let (mut rest, mut worst, mut by_rays) = ([0.0, 0.0], 0.0f64, 0.0f64);
    for (i, j) in (0..n * n).map(|k| (k / n, k % n)) {
        let (exact, k) = (converged.factor(i, j).0, i * n + j);
        if lamp[i] || lamp[j] {
            worst = worst.max((mended[k] - exact).abs() / exact.max(1e-5));
            by_rays = by_rays.max((alone[k] - exact).abs() / exact.max(1e-5));
        } else {
            rest[0] += (mended[k] - exact).powi(2);
            rest[1] += (alone[k] - exact).powi(2);
        }
    }
    let ratio = (rest[0] / rest[1]).sqrt();
    eprintln!("lamp off by {worst:.1e} at most, by rays {by_rays:.1e}; the rest {ratio:.4} as noisy");
    assert!(worst < 0.02 && by_rays > 0.5 && ratio < 1.001, "{worst} {by_rays} {ratio}");
}

/// By objects, factors found pair by pair and by hemisphere rays, and the standard error of both together, for elements of at most this
/// size.
fn both_ways(
    scene: &Scene,
    size: f64,
    rays: u32,
    error: Option<f64>,
) -> impl Fn(&str, &str) -> (f64, f64, f64) {
    let device = device();
    let visibility = Visibility::new(&device, scene).expect("tree");
    let mesh = Mesh::new(scene, &Sides::fronts(scene), size, true).expect("mesh");
    let found = estimate(&visibility, &mesh, &Request { error, ..request(rays, 1) });
    assert!(found.pairs().is_some_and(|p| p.len() > 64), "pair by pair");
    let pairs = found.table(scene, &mesh, 0.0);
    let rows = ObjectTable::new(scene, &mesh, &cast(&visibility, &mesh, &hemisphere(rays)).0, 0.0);
    move |from, to| {
        let [i, j] = [from, to].map(|name| pairs.objects.iter().position(|o| o == name).expect("an object"));
        let (f, g) = (pairs.form_factors[i][j], rows.form_factors[i][j]);
        (f, g, pairs.standard_errors[i][j].hypot(rows.standard_errors[i][j]))
    }
}

/// A plate that looks out of a box without a lid, and a shelf and a board that reach into a closed one: what lies within a body is not
/// hidden by it. The pairs agree with hemisphere rays within [`T15`] errors of both.
#[test]
fn what_lies_within_a_body_sees() {
    let body = |at: Point, lid: bool| -> Vec<Vec<Point>> {
        let faces = box_faces(at, [1.0; 3], false).into_iter().map(|f| f.1);
        faces.filter(|f| lid || f.iter().any(|p| p[2] < at[2] + 0.5)).collect()
    };
    let scene = scene(&[
        ("open", body([0.0; 3], false)),
        ("deep", vec![vec![[0.1, 0.1, 0.5], [0.9, 0.1, 0.5], [0.9, 0.9, 0.5], [0.1, 0.9, 0.5]]]),
        ("ceiling", vec![vec![[-1.0, -1.0, 2.5], [-1.0, 2.0, 2.5], [2.0, 2.0, 2.5], [2.0, -1.0, 2.5]]]),
        ("closed", body([9.0, 0.0, 0.0], true)),
        ("shelf", vec![vec![[8.5, 0.2, 0.5], [9.8, 0.2, 0.5], [9.8, 0.8, 0.5], [8.5, 0.8, 0.5]]]),
        ("board", vec![vec![[9.8, 0.2, 0.5], [9.8, 0.2, 1.5], [9.8, 0.8, 1.5], [9.8, 0.8, 0.5]]]),
    ]);
    let factor = both_ways(&scene, 0.25, 8192, None);
    for (from, to) in [("deep", "ceiling"), ("ceiling", "deep"), ("shelf", "board"), ("board", "shelf")] {
        let (f, g, error) = factor(from, to);
        eprintln!("{from} to {to}: {f:.5} by pairs, {g:.5} by hemisphere rays, +- {error:.1e}");
        assert!((f - g).abs() <= T15 * error && error < 0.03 * g);
    }
}

/// A ground with 81 boxes on it that cover a third of it, under a sky: of so many bodies rays must do, and what the boxes stand on sees
/// nothing. The pairs agree with hemisphere rays within [`T15`] errors of both.
#[test]
fn many_bodies_stand_on_one_element() {
    let bodies = (0..81).flat_map(|k| {
        box_faces([f64::from(k % 9) + 0.2, f64::from(k / 9) + 0.2, 0.0], [0.6, 0.6, 0.25], false)
    });
    let boxes = bodies.map(|f| f.1).filter(|f| f.iter().any(|p| p[2] > 0.0)).collect();
    let ground =
        |z: f64, up: bool| vec![square(z, up).into_iter().map(|[x, y, z]| [9.0 * x, 9.0 * y, z]).collect()];
    let scene = scene(&[("ground", ground(0.0, true)), ("sky", ground(5.0, false)), ("boxes", boxes)]);
    for asked in [None, Some(0.02)] {
        let factor = both_ways(&scene, 1e9, 1 << 17, asked);
        for (from, to) in [("ground", "sky"), ("sky", "ground")] {
            let (f, g, error) = factor(from, to);
            eprintln!("{from} to {to}: {f:.5} by pairs, {g:.5} by hemisphere rays, +- {error:.1e}");
            assert!((f - g).abs() <= T15 * error && error < 0.03 * g);
        }
    }
}

/// A drum without a bottom stands on one element with sixty sides, and leaves of it what has as many corners. The pairs agree with
/// hemisphere rays within [`T15`] errors of both and a thousandth.
#[test]
fn a_body_of_many_sides_stands_on_one_element() {
    const SIDES: usize = 60;
    let corner = |k: usize, z: f64| {
        let (sin, cos) = (std::f64::consts::TAU * (k % SIDES) as f64 / SIDES as f64).sin_cos();
        [0.5 + 0.3 * cos, 0.5 + 0.3 * sin, z]
    };
    let side = |k: usize| vec![corner(k, 0.0), corner(k + 1, 0.0), corner(k + 1, 0.25), corner(k, 0.25)];
    let top = |k: usize| vec![corner(0, 0.25), corner(k, 0.25), corner(k + 1, 0.25)];
    let drum = (0..SIDES).map(side).chain((1..SIDES - 1).map(top)).collect();
    let scene =
        scene(&[("floor", vec![square(0.0, true)]), ("ceiling", vec![square(0.5, false)]), ("drum", drum)]);
    let factor = both_ways(&scene, 1e9, 1 << 16, None);
    for (from, to) in [("floor", "ceiling"), ("floor", "drum"), ("drum", "floor")] {
        let (f, g, error) = factor(from, to);
        eprintln!("{from} to {to}: {f:.5} by pairs, {g:.5} by hemisphere rays, +- {error:.1e}");
        assert!((f - g).abs() <= T15 * error + 1e-3 * g && error < 0.01 * g);
    }
}
