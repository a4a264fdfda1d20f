//! Pass 1 within a limit of memory.

mod common;

use common::*;
use twopass::emitters::Emitters;
use twopass::memory::Factors;
use twopass::pipeline::{self, Pass1, Pass1Result};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

fn within(limit: u64, scene: &Scene) -> twopass::Result<Pass1Result> {
    let device = device();
    let visibility = Visibility::new(&device, scene)?;
    let emitters = Emitters::new(&visibility);
    let settings = Pass1 { rays: 256, element_size: Some(0.1), seed: 3 };
    pipeline::solve_within(Some(limit), &visibility, &emitters, &[], &settings, &|_| (), &mut Vec::new())
}

/// A room with a box in it, whose sides are made of `material`.
fn room(material: &str) -> Scene {
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
    files.load()
}

/// Rays that are cast again give what the matrix gives, to the bit: with counts, and with grey and coloured chains.
#[test]
fn rays_cast_again_give_the_same_solution() {
    for material in [
        "diffuse = 0.5",
        "diffuse = 0.3\nspecular = 0.5\nroughness = 0.4",
        "diffuse = 0.3\nspecular = [0.5, 0.4, 0.2]\nroughness = 0.4",
    ] {
        let scene = room(material);
        let kept = within(1 << 40, &scene).expect("solution");
        let elements = kept.solution.mesh.len() as u64;
        assert!(kept.factors == Factors::Kept && kept.matrix_bytes > 0);
        // Enough for the elements, not for the matrix.
        let cast = within(1800 * elements, &scene).expect("solution");
        assert!(cast.factors == Factors::CastAgain && cast.matrix_bytes == 0, "{material}");
        assert_eq!(kept.solution.radiosity, cast.solution.radiosity, "{material}");
        assert_eq!(kept.solution.standard_error, cast.solution.standard_error, "{material}");
        assert_eq!(kept.residuals.reciprocity, cast.residuals.reciprocity, "{material}");
        assert_eq!(kept.solution.ledger.residual_error, cast.solution.ledger.residual_error, "{material}");
    }
}

#[test]
fn too_little_is_refused() {
    let refused = within(1 << 10, &room("diffuse = 0.5")).err().expect("an error").to_string();
    assert!(refused.contains("--max-memory") && refused.contains("1.0 KiB"), "{refused}");
}
