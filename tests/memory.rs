//! Pass 1 within a limit of memory.

mod common;

use common::*;
use twopass::color::Rgb;
use twopass::emitters::Emitters;
use twopass::form_factor::{AtSpecular, Casting, Recast, Rows, cast};
use twopass::memory::Factors;
use twopass::mesh::{Mesh, Sides};
use twopass::pipeline::{self, Pass1, Pass1Result};
use twopass::radiosity::Solution;
use twopass::scene::Scene;
use twopass::visibility::Visibility;

fn within(limit: u64, scene: &Scene) -> twopass::Result<Pass1Result> {
    solve(limit, scene, (256, 0.1))
}

fn solve(limit: u64, scene: &Scene, (rays, element_size): (u32, f64)) -> twopass::Result<Pass1Result> {
    let device = device();
    let visibility = Visibility::new(&device, scene)?;
    let emitters = Emitters::new(&visibility);
    let settings = Pass1 { rays, element_size: Some(element_size), seed: 3 };
    pipeline::solve_within(Some(limit), &visibility, &emitters, &[], &settings, &|_| (), &mut Vec::new())
}

/// Bytes that pass 1 needs without a matrix, to a tenth of the unit that messages give them in.
fn needed(scene: &Scene, settings: (u32, f64)) -> u64 {
    let error = solve(1, scene, settings).err().expect("nothing fits into a byte").to_string();
    let words: Vec<&str> = error.split_whitespace().collect();
    let at = words.iter().position(|w| *w == "needs").expect("a need");
    let unit = ["KiB", "MiB"].iter().position(|u| *u == words[at + 2]).expect("a unit");
    (words[at + 1].parse::<f64>().expect("a number") * 1024f64.powi(unit as i32 + 1)) as u64
}

/// A room with a box in it, whose sides are made of `material`.
fn room(material: &str) -> Scene {
    paved_room(material, 0)
}

/// The same with `tiles` x `tiles` dark and bright tiles just above the floor.
fn paved_room(material: &str, tiles: u32) -> Scene {
    let mut files = Files::default();
    files.diffuse("m", &[0.7, 0.5, 0.3], &[0.0]).diffuse("lamp", &[0.0], &[5.0]);
    files.material("box", material);
    for (name, points) in box_faces([0.0; 3], [1.0; 3], true) {
        files.polygon(name, "m", &points);
    }
    for (name, points) in box_faces([0.3, 0.4, 0.2], [0.2, 0.3, 0.3], false) {
        files.polygon(&format!("box-{name}"), "box", &points);
    }
    files.polygon("lamp", "lamp", &[[0.4, 0.6, 0.9], [0.6, 0.6, 0.9], [0.6, 0.4, 0.9], [0.4, 0.4, 0.9]]);
    files.diffuse("dark", &[0.1], &[0.0]);
    for k in 0..tiles * tiles {
        let [x, y] = [k % tiles, k / tiles].map(|i| f64::from(i) / f64::from(tiles));
        let corner = |u: f64, v: f64| [x + u / f64::from(tiles), y + v / f64::from(tiles), 0.01];
        let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
        files.polygon(&format!("tile-{k}"), if (k / tiles + k) % 2 == 0 { "m" } else { "dark" }, &corners);
    }
    files.load()
}

/// Rays that are cast again give what the matrix gives: with counts, and with grey and coloured chains.
#[test]
fn rays_cast_again_give_the_same_solution() {
    for material in [
        "diffuse = 0.5",
        "diffuse = 0.3\nspecular = 0.5\nroughness = 0.4",
        "diffuse = 0.3\nspecular = [0.5, 0.4, 0.2]\nroughness = 0.4",
        "diffuse = 0.2\nspecular_transmission = 0.7\nior = 1.5",
    ] {
        let scene = room(material);
        let kept = within(1 << 40, &scene).expect("solution");
        let elements = kept.solution.mesh.len() as u64;
        assert!(kept.factors == Factors::Kept && kept.matrix_bytes > 0);
        // Enough for the elements, not for the matrix.
        let cast = within(needed(&scene, (256, 0.1)) + 200 * elements, &scene).expect("solution");
        assert!(cast.factors == Factors::CastAgain && cast.matrix_bytes == 0, "{material}");
        assert_eq!(kept.residuals.reciprocity, cast.residuals.reciprocity, "{material}");
        let (kept, cast) = (&kept.solution, &cast.solution);
        alike(kept, cast, material);
        let (a, b) = (kept.ledger, cast.ledger);
        assert!((a.residual - b.residual).abs().max_element() < 1e-8, "{material}: {a:?} {b:?}");
        assert!(
            (a.residual_error / b.residual_error - 1.0).abs().max_element() < 0.05,
            "{material}: {a:?} {b:?}"
        );
    }
}

/// Kept matrices have a coarse grid and rays that are cast again none: solutions are the same as far as they are solved, and so are
/// standard errors.
fn alike(a: &Solution, b: &Solution, name: &str) {
    let largest = a.radiosity.iter().map(|b| b.max_element()).fold(0.0, f64::max);
    let apart = a.radiosity.iter().zip(&b.radiosity).map(|(a, b)| (*a - *b).abs().max_element());
    let apart = apart.fold(0.0, f64::max) / largest;
    let (steps, of_b) = (a.convergence.iterations, b.convergence.iterations);
    println!("{name}: {} elements, {apart:.1e} apart, {steps} and {of_b} steps", a.radiosity.len());
    assert!(apart < 1e-8, "{name}: {apart}");
    let squares = |s: &Solution| s.standard_error.iter().map(|e| e.x * e.x).sum::<f64>();
    let ratio = (squares(a) / squares(b)).sqrt();
    assert!((ratio - 1.0).abs() < 0.02, "{name}: standard errors {ratio}");
    for (a, b) in a.objects.iter().zip(&b.objects).filter(|(a, _)| a.standard_error.x > 0.0) {
        let ratio = a.standard_error.x / b.standard_error.x;
        assert!((0.9..1.1).contains(&ratio), "{name}: {} {ratio}", a.name);
    }
}

#[test]
fn too_little_is_refused() {
    let refused = within(1 << 10, &room("diffuse = 0.5")).err().expect("an error").to_string();
    assert!(refused.contains("--max-memory") && refused.contains("1.0 KiB"), "{refused}");
}

/// What threads hold of the rays that they cast, and the map that particles fill, count too: more rays, and a material that lets light
/// over specular chains, need more even without a matrix.
#[test]
fn rays_and_caustics_need_memory() {
    let needed = |material: &str, rays: u32| needed(&room(material), (rays, 0.1)) as f64;
    let (few, many) = (needed("diffuse = 0.5", 1 << 10), needed("diffuse = 0.5", 1 << 20));
    let threads = std::thread::available_parallelism().expect("threads").get().min(2) as f64;
    assert!(many - few >= 0.9 * threads * 64.0 * f64::from((1 << 20) - (1 << 10)), "{few} {many}");
    let glossy = needed("diffuse = 0.3\nspecular = 0.5\nroughness = 0.4", 1 << 10);
    assert!(glossy > 2.0 * few, "{few} {glossy}");
}

/// Very many elements have tiles where the matrix is kept; without memory for them these are given up first.
#[test]
fn coarse_grids_and_tiles_change_no_solution() {
    for (name, material, tiles, size, least) in [
        ("tiles", "diffuse = 0.5", 0, 0.007, 1 << 17),
        ("many faces", "diffuse = 0.5", 20, 0.018, 1 << 14),
        ("translucent", "diffuse = 0.2\ndiffuse_transmission = 0.6", 0, 0.018, 1 << 14),
        ("gloss", "diffuse = 0.3\nspecular = [0.5, 0.4, 0.2]\nroughness = 0.4", 0, 0.018, 1 << 14),
    ] {
        let scene = paved_room(material, tiles);
        let kept = solve(1 << 40, &scene, (8, size)).expect("solution");
        let elements = kept.solution.mesh.len() as u64;
        assert!(kept.factors == Factors::Kept && elements >= least, "{name}: {elements}");
        // 4 bytes for each ray, once more in tiles.
        let (bytes, left) = if name == "tiles" { (40, Factors::Kept) } else { (10, Factors::CastAgain) };
        let limit = needed(&scene, (8, size)) + bytes * elements;
        let less = solve(limit, &scene, (8, size)).expect("solution");
        assert!(less.factors == left, "{name}");
        alike(&kept.solution, &less.solution, name);
    }
}

/// The rows themselves are the same to the bit whether they are kept or cast again, at each visit: their products with a vector, of
/// which no two elements are alike, and those of single randomisations. Rays that end at gloss, and chains of it.
#[test]
fn rows_cast_again_are_the_same_to_the_bit() {
    let scene = room("diffuse = 0.3\nspecular = [0.5, 0.4, 0.2]\nroughness = 0.4");
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.1, true).expect("mesh");
    let x: Vec<Rgb> = (0..mesh.len()).map(|k| Rgb::new(k as f64, 1.0 / (k + 1) as f64, 0.3)).collect();
    for specular in [AtSpecular::End, AtSpecular::GoOn, AtSpecular::GoOnByShare] {
        let casting = Casting {
            rays: 48,
            batches: 3,
            seed: 7,
            specular,
            reached: None,
            emitters: None,
            progress: &|_| (),
        };
        let matrix = cast(&visibility, &mesh, &casting).0;
        let recast = Recast::new(&visibility, &mesh, &casting).0;
        let products = |rows: Rows| {
            let bits = |y: Rgb| y.to_array().map(f64::to_bits);
            rows.map(|_, row| {
                let batches = (0..3).map(|b| bits(row.dot_batch(b, &x)));
                std::iter::once(bits(row.dot(&x))).chain(batches).collect::<Vec<_>>()
            })
        };
        let kept = products(Rows::Kept(&matrix));
        assert!(kept.len() == mesh.len() && kept.iter().all(|row| row[0] != [0; 3]));
        for visit in 0..2 {
            assert!(kept == products(Rows::Cast(&recast)), "{specular:?}, visit {visit}");
        }
    }
}
