//! Bodies without thickness: faces in one plane, back to back.

mod common;

use common::*;
use std::f64::consts::PI;
use twopass::scene::Scene;

const LOWER: [Point; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

fn at(z: f64) -> [Point; 4] {
    LOWER.map(|[x, y, _]| [x, y, z])
}

/// A floor, a ceiling, and halfway between them, hiding each from the other, a lamp that shines up and one that shines down: drawn with the
/// same corners, or one of them as two triangles.
fn lamps(triangles: [bool; 2]) -> Scene {
    let mut files = Files::default();
    files.material("grey", "diffuse = 0.5");
    files.material("up", "diffuse = 0\nemission = [1, 2, 3]").material("down", "diffuse = 0\nemission = 2");
    files.polygon("floor", "grey", &LOWER);
    for (name, triangles) in ["up", "down"].into_iter().zip(triangles) {
        let mut p = at(1.0);
        if name == "down" {
            p.reverse();
        }
        match triangles {
            true => files.polygon(name, name, &p[..3]).polygon(name, name, &[p[0], p[2], p[3]]),
            false => files.polygon(name, name, &p),
        };
    }
    let mut ceiling = at(2.0);
    ceiling.reverse();
    files.polygon("ceiling", "grey", &ceiling);
    files.load()
}

/// Each lamp lights what it looks at, and nothing else: `B = rho pi L F` of opposed squares (Howell C-11). Lamps that nothing hides
/// give exactly their light; that one of them was moved by some millionths changes F by less than 1e-5.
#[test]
fn lamps_back_to_back_shine_both_ways() {
    for triangles in [[false, false], [true, false], [false, true], [true, true]] {
        let scene = lamps(triangles);
        assert_eq!(scene.objects.len(), 4);
        assert!(scene.warnings.iter().any(|w| w.contains("back to back")), "{:?}", scene.warnings);
        let s = solve(&scene, 256, 1.0, 1).expect("solution").solution;
        for (object, radiance) in [("floor", [2.0; 3]), ("ceiling", [1.0, 2.0, 3.0])] {
            let found = object_mean(&scene, &s, &s.radiosity, object, true);
            for (c, radiance) in radiance.into_iter().enumerate() {
                let exact = 0.5 * PI * radiance * opposed(1.0, 1.0, 1.0);
                let off = found[c] / exact - 1.0;
                assert!(off.abs() < 1e-5, "{triangles:?} {object}: off by {off:.1e}");
            }
        }
    }
}

/// What a surface of one material shows on both its sides is there once, however often it was drawn; of another material, of another
/// object, and where fronts alone reflect, each drawing is a side of its own.
#[test]
fn sides_that_differ_are_both_kept() {
    for (materials, objects, entries, faces) in [
        (["a", "a"], ["one", "one"], "diffuse = 0.5", 1),
        (["a", "b"], ["one", "one"], "diffuse = 0.5", 2),
        (["a", "a"], ["one", "two"], "diffuse = 0.5", 2),
        (["a", "a"], ["one", "one"], "diffuse = 0.5\ntwo_sided = false", 2),
        (["a", "a"], ["one", "one"], "emission = 1", 2),
        (["a", "a"], ["one", "one"], "emission = 1\nemit_both_sides = true", 1),
        (["a", "a"], ["one", "two"], "specular_transmission = 1\nior = 1.5", 1),
    ] {
        let mut files = Files::default();
        files.material("a", entries).material("b", entries);
        let mut back = at(0.0);
        back.reverse();
        files.polygon(objects[0], materials[0], &LOWER).polygon(objects[1], materials[1], &back);
        // A third one with the first one's front adds nothing.
        files.polygon("three", "b", &LOWER);
        let scene = files.load();
        assert_eq!(scene.faces.len(), faces, "{materials:?} {objects:?} {entries}: {:?}", scene.warnings);
        if faces == 2 {
            let [a, b] = [&scene.faces[0], &scene.faces[1]];
            let gap = (scene.corner(b, 0) - scene.corner(a, 0)).dot(b.normal);
            assert!(a.normal.dot(b.normal) < -0.99 && gap > 5e-7 && gap < 1e-5, "{gap}");
        }
    }
}
