//! The hemi-cube against exact factors, itself and ray casting.

mod common;

use common::*;
use std::time::Instant;
use twopass::form_factor::{
    Casting, ExchangeMatrix, HemicubeErrors, HemicubeSettings, ObjectTable, cast, hemicube,
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

#[test]
fn cube_inside() {
    let scene = unit_cube();
    for (size, n, grid, rotations) in [
        (10.0, 64, 1, 0),
        (0.25, 63, 1, 0),
        (0.25, 64, 2, 0),
        (0.25, 256, 1, 0),
        (0.25, 64, 2, 4),
        (0.1, 256, 1, 0),
    ] {
        let start = Instant::now();
        let rms = cube_error(&scene, size, &settings(n, grid, rotations));
        eprintln!("{size} {n} {grid} {rotations}: rms {rms:.2e}, {:.3} s", start.elapsed().as_secs_f64());
    }
}
