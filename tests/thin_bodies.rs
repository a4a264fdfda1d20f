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

/// Two cubes with a wall in common, each drawn with its own: whichever way the walls look, each room has its own on its side.
#[test]
fn rooms_with_a_common_wall_see_their_own() {
    for inside in [true, false] {
        let mut files = Files::default();
        for (room, x) in [("left", 0.0), ("right", 1.0)] {
            files.diffuse(room, &[0.5], &[0.0]);
            for (_, points) in box_faces([x, 0.0, 0.0], [1.0; 3], inside) {
                files.polygon(room, room, &points);
            }
        }
        let scene = files.load();
        assert_eq!(scene.faces.len(), 12);
        let wall = |room: &str| {
            let of_room = |f: &&twopass::scene::Face| scene.objects[f.object as usize] == room;
            let middle = |f: &&twopass::scene::Face| {
                (0..4).all(|k| (scene.corner(f, k).x + scene.center.x - 1.0).abs() < 1e-4)
            };
            let face = scene.faces.iter().filter(of_room).find(middle).expect("a wall");
            scene.corner(face, 0).x
        };
        assert!(wall("left") < wall("right"), "inside {inside}: {} {}", wall("left"), wall("right"));
    }
}

/// A pane that was drawn from both sides is one pane.
#[test]
fn panes_are_not_doubled() {
    for entries in [
        "thin = true\nspecular_transmission = 0.9",
        "diffuse = 0.3\ndiffuse_transmission = 0.4",
        "specular_transmission = 0.9\nior = 1",
    ] {
        let mut files = Files::default();
        files.material("pane", entries);
        let mut back = at(0.0);
        back.reverse();
        files.polygon("outer", "pane", &LOWER).polygon("inner", "pane", &back);
        assert_eq!(files.load().faces.len(), 1, "{entries}");
    }
}

/// A floor and the ceiling of the room below, in one plane, and a lamp in that ceiling: in either order all three stay.
#[test]
fn a_lamp_in_one_of_two_faces_back_to_back() {
    let lamp = [[0.4, 0.6, 0.0], [0.6, 0.6, 0.0], [0.6, 0.4, 0.0], [0.4, 0.4, 0.0]];
    let mut ceiling = at(0.0);
    ceiling.reverse();
    // Of two alike the first stays in the plane, where the lamp shows its back; the other is moved off both.
    for (order, floor) in [(["floor", "ceiling"], 0.96), (["ceiling", "floor"], 1.0)] {
        let mut files = Files::default();
        files.material("floor", "diffuse = 0.5").material("ceiling", "diffuse = 0.6");
        files.material("lamp", "diffuse = 0\nemission = 1");
        for name in order {
            files.polygon(name, name, if name == "floor" { &LOWER } else { &ceiling });
        }
        files.polygon("lamp", "lamp", &lamp);
        let scene = files.load();
        let area = |object: &str| {
            let own = scene.faces.iter().filter(|f| scene.objects[f.object as usize] == object);
            own.map(|f| f.area).sum::<f64>()
        };
        assert!((area("lamp") - 0.04).abs() < 1e-9 && (area("ceiling") - 0.96).abs() < 1e-9, "{order:?}");
        assert!((area("floor") - floor).abs() < 1e-9, "{order:?}: {}", area("floor"));
        let z = |object: &str| {
            let face = scene.faces.iter().find(|f| scene.objects[f.object as usize] == object);
            scene.corner(face.expect(object), 0).z
        };
        assert!(z("floor") > z("ceiling"), "{order:?}");
    }
}
