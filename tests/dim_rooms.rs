//! Rooms of their own, one of them lit far less than the other: no light, error or sample of one is another's.

mod common;

use common::*;
use twopass::emitters::Emitters;
use twopass::radiosity::Solution;
use twopass::scene::Scene;
use twopass::visibility::Visibility;

/// What walls are made of.
#[derive(Debug, Clone, Copy)]
enum Walls {
    Quads,
    Triangles,
    /// So many squares along either edge.
    Tiles(u32),
}

impl Walls {
    fn cut(self, [a, b, c, d]: [Point; 4]) -> Vec<Vec<Point>> {
        match self {
            Walls::Quads => vec![vec![a, b, c, d]],
            Walls::Triangles => vec![vec![a, b, c], vec![a, c, d]],
            Walls::Tiles(n) => {
                let at = |u: u32, v: u32| {
                    let [u, v] = [u, v].map(|x| f64::from(x) / f64::from(n));
                    std::array::from_fn(|k| a[k] + u * (b[k] - a[k]) + v * (d[k] - a[k]))
                };
                let cell = |k: u32| {
                    let (u, v) = (k % n, k / n);
                    vec![at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)]
                };
                (0..n * n).map(cell).collect()
            }
        }
    }
}

/// Two closed cubes of albedo 1/2 side by side, each with a lamp at height `z`; that of the second is `ratio` times as bright.
fn rooms(ratio: f64, walls: Walls, z: f64) -> Scene {
    let mut files = Files::default();
    files.diffuse("wall", &[0.5], &[0.0]);
    for (room, x, light) in [("dim", 0.0, 1.0), ("bright", 3.0, ratio)] {
        files.diffuse(room, &[0.0], &[light]);
        for (name, points) in box_faces([x, 0.0, 0.0], [1.0; 3], true) {
            for part in walls.cut(points.try_into().expect("four corners")) {
                files.polygon(&format!("{room}_{name}"), "wall", &part);
            }
        }
        let lamp = [[x + 0.4, 0.4, z], [x + 0.4, 0.6, z], [x + 0.6, 0.6, z], [x + 0.6, 0.4, z]];
        files.polygon(&format!("lamp_{room}"), room, &lamp);
    }
    files.load()
}

fn dim_walls(scene: &Scene, s: &Solution) -> Vec<usize> {
    let dim = |e: &usize| {
        let face = &scene.faces[s.mesh.place(*e as u32).0 as usize];
        scene.objects[face.object as usize].starts_with("dim_")
    };
    (0..s.mesh.len()).filter(dim).collect()
}

/// Nothing hides the own lamp and walls hide the other: direct light is exact, whatever the other is. Irradiance and its standard
/// errors are those of equally bright rooms, up to what rays that are cast alike bring.
#[test]
fn a_bright_room_leaves_a_dim_one_alone() {
    for (walls, z) in [
        (Walls::Quads, 0.99),
        (Walls::Quads, 0.7),
        (Walls::Triangles, 0.7),
        (Walls::Tiles(2), 0.99),
        (Walls::Tiles(4), 0.5),
        (Walls::Tiles(5), 0.7),
    ] {
        stays_alone(walls, z);
    }
}

fn stays_alone(walls: Walls, z: f64) {
    let even = rooms(1.0, walls, z);
    let reference = solve(&even, 256, 0.125, 1).expect("solution").solution;
    let dim = dim_walls(&even, &reference);
    let rms = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, n) = values.fold((0.0, 0.0), |(sum, n), x| (sum + x * x, n + 1.0));
        f64::sqrt(sum / n)
    };
    for ratio in [1e3, 1e6, 1e9] {
        let scene = rooms(ratio, walls, z);
        let s = solve(&scene, 256, 0.125, 1).expect("solution").solution;
        assert_eq!(dim, dim_walls(&scene, &s));
        for &e in &dim {
            let (direct, wanted) = (s.direct[e].x, reference.direct[e].x);
            assert!((direct - wanted).abs() <= 1e-7 * wanted, "{ratio:e}, element {e}: {direct} {wanted}");
        }
        let off = rms(&mut dim.iter().map(|&e| s.irradiance[e].x / reference.irradiance[e].x - 1.0));
        let error = |s: &Solution| rms(&mut dim.iter().map(|&e| s.standard_error[e].x));
        let (stated, wanted) = (error(&s), error(&reference));
        eprintln!(
            "{walls:?}, {ratio:e}: irradiance {off:.1e}, standard error {stated:.2e}, of equal rooms {wanted:.2e}"
        );
        // The rays are the same ones; solves end at 1e-8 of the brightest, and replicas after the same steps.
        assert!(off < 1e-8, "{walls:?}, {ratio:e}: {off:e}");
        assert!((stated / wanted - 1.0).abs() < 1e-6, "{walls:?}, {ratio:e}: {stated:e} {wanted:e}");
    }
}

/// Each of two lamps gets its part of the samples, however much stronger the other is; one lamp gets all.
#[test]
fn weak_lamps_get_samples() {
    let device = device();
    let scene = rooms(1e8, Walls::Quads, 0.99);
    let visibility = Visibility::new(&device, &scene).expect("a tree");
    let emitters = Emitters::new(&visibility);
    let chances: Vec<f64> = (0..emitters.len()).map(|k| emitters.chance(k)).collect();
    assert_eq!(chances.len(), 2);
    assert!((chances.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{chances:?}");
    assert!((chances[0] - 0.125).abs() < 1e-6, "{chances:?}");
    for (k, chance) in chances.iter().enumerate() {
        let sample = emitters.on_side(k, [0.5, 0.5]);
        assert!((sample.density * 0.04 / chance - 1.0).abs() < 1e-12);
    }
    let scene = rooms(0.0, Walls::Quads, 0.99);
    let visibility = Visibility::new(&device, &scene).expect("a tree");
    assert!((Emitters::new(&visibility).chance(0) - 1.0).abs() < 1e-12);
}
