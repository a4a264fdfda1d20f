//! Which sides have elements at all, and what becomes of rays that start where something lies.

use glam::DVec3;
use twopass::color::mean;
use twopass::embree::Device;
use twopass::emitters::Emitters;
use twopass::mesh::{Mesh, NONE, Sides};
use twopass::pipeline::{self, Pass1, Pass1Result};
use twopass::scene::{Scene, load};
use twopass::visibility::{Visibility, reachable_sides};

/// An OBJ text that grows by quads.
#[derive(Default)]
struct Obj {
    text: String,
}

impl Obj {
    /// A lit, closed room of one metre; its faces look inwards.
    fn room() -> Obj {
        let mut obj = Obj::default();
        obj.named("room", "white").cuboid([0.0; 3], [1.0; 3], true, &[0, 1, 2, 3, 4, 5]);
        obj.lamp();
        obj
    }

    fn lamp(&mut self) -> &mut Obj {
        self.named("lamp", "lamp").quad([[0.4, 0.9, 0.4], [0.6, 0.9, 0.4], [0.6, 0.9, 0.6], [0.4, 0.9, 0.6]])
    }

    fn named(&mut self, object: &str, material: &str) -> &mut Obj {
        self.text += &format!("o {object}\nusemtl {material}\n");
        self
    }

    fn quad(&mut self, corners: [[f64; 3]; 4]) -> &mut Obj {
        for [x, y, z] in corners {
            self.text += &format!("v {x} {y} {z}\n");
        }
        self.text += "f -4 -3 -2 -1\n";
        self
    }

    /// Sides of a box, outwards unless `inwards`: 0 bottom, 1 top (y), 2 and 3 along z, 4 and 5 along x.
    fn cuboid(&mut self, low: [f64; 3], high: [f64; 3], inwards: bool, sides: &[usize]) -> &mut Obj {
        let ([a, b, c], [x, y, z]) = (low, high);
        let quads = [
            [[a, b, c], [x, b, c], [x, b, z], [a, b, z]],
            [[a, y, c], [a, y, z], [x, y, z], [x, y, c]],
            [[a, b, c], [a, y, c], [x, y, c], [x, b, c]],
            [[a, b, z], [x, b, z], [x, y, z], [a, y, z]],
            [[a, b, c], [a, b, z], [a, y, z], [a, y, c]],
            [[x, b, c], [x, y, c], [x, y, z], [x, b, z]],
        ];
        for &side in sides {
            let mut quad = quads[side];
            if inwards {
                quad.reverse();
            }
            self.quad(quad);
        }
        self
    }

    /// The scene, with a camera in a corner of the room.
    fn scene(&self) -> Scene {
        let folder = tempfile::tempdir().unwrap();
        let toml = "geometry = [\"s.obj\"]\n[camera]\norigin = [0.05, 0.9, 0.05]\ntarget = [0.5, 0.2, 0.5]\n\
                    [materials.white]\ndiffuse = 0.5\n[materials.lamp]\nemission = 10\n";
        let mirror = "[materials.mirror]\ndiffuse = 0.01\nspecular = 0.9\nroughness = 0.1\n";
        let toml = toml.to_owned() + if self.text.contains("mirror") { mirror } else { "" };
        std::fs::write(folder.path().join("s.toml"), toml).unwrap();
        std::fs::write(folder.path().join("s.obj"), &self.text).unwrap();
        let scene = load(&folder.path().join("s.toml")).unwrap();
        assert_eq!(scene.warnings, [""; 0]);
        scene
    }
}

fn reached(scene: &Scene, seed: u32) -> Sides {
    let device = Device::new(1).unwrap();
    let visibility = Visibility::new(&device, scene).unwrap();
    let cameras: Vec<_> = scene.cameras.iter().map(|c| (c.frame(scene), c.size)).collect();
    reachable_sides(&visibility, &cameras, seed)
}

/// Which (front, back) sides of an object's faces are reached.
fn sides_of(scene: &Scene, sides: &Sides, object: &str) -> Vec<(bool, bool)> {
    let of = |k: usize| (sides.contains(k as u32, true), sides.contains(k as u32, false));
    let faces = scene.faces.iter().enumerate();
    faces.filter(|(_, f)| scene.objects[f.object as usize] == object).map(|(k, _)| of(k)).collect()
}

fn solve(scene: &Scene, rays: u32, size: f64) -> Pass1Result {
    let device = Device::new(2).unwrap();
    let visibility = Visibility::new(&device, scene).unwrap();
    let settings = Pass1 { rays, element_size: Some(size), seed: 1 };
    let emitters = Emitters::new(&visibility);
    pipeline::solve(&visibility, &emitters, &scene.cameras, &settings, &|_| (), &mut Vec::new()).unwrap()
}

const FRONT_ONLY: (bool, bool) = (true, false);

#[test]
fn the_inside_of_closed_boxes_and_the_outside_of_the_room_have_no_elements() {
    let mut obj = Obj::room();
    obj.named("on floor", "white").cuboid([0.2, 0.0, 0.2], [0.5, 0.3, 0.5], false, &[1, 2, 3, 4, 5]);
    obj.named("hanging", "white").cuboid([0.6, 0.4, 0.6], [0.8, 0.6, 0.8], false, &[0, 1, 2, 3, 4, 5]);
    let scene = obj.scene();
    for seed in 0..5 {
        let sides = reached(&scene, seed);
        assert_eq!(sides_of(&scene, &sides, "room"), [FRONT_ONLY; 6], "seed {seed}");
        assert_eq!(sides_of(&scene, &sides, "on floor"), [FRONT_ONLY; 5], "seed {seed}");
        assert_eq!(sides_of(&scene, &sides, "hanging"), [FRONT_ONLY; 6], "seed {seed}");
    }
    let mesh = Mesh::new(&scene, &reached(&scene, 0), 0.1, false).unwrap();
    let with_backs = |f: u32| mesh.first(f, false) != NONE;
    let lamp = scene.faces.iter().position(|f| scene.material(f).is_emitter()).unwrap() as u32;
    assert!((0..scene.faces.len() as u32).all(|f| !with_backs(f)), "no light gets behind anything");
    assert_ne!(mesh.first(lamp, true), NONE, "its power must be accounted for");
}

/// Interpolated normals turn reflected rays below the faces of a ball; no light follows them inside. Seeds are fixed.
#[test]
fn a_smooth_mirror_has_no_inside() {
    let mut obj = Obj::room();
    let (low, high) = ([0.3, 0.1, 0.3], [0.7, 0.5, 0.7]);
    obj.named("ball", "mirror");
    for corner in 0..8 {
        let at = |k: usize| if corner >> k & 1 == 1 { high[k] } else { low[k] };
        obj.text += &format!("v {} {} {}\n", at(0), at(1), at(2));
        let towards = |k: usize| if corner >> k & 1 == 1 { 1 } else { -1 };
        obj.text += &format!("vn {} {} {}\n", towards(0), towards(1), towards(2));
    }
    for face in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        let corner = |k: i32| format!("{}//{}", k - 8, k - 8);
        obj.text += &format!("f {}\n", face.map(corner).join(" "));
    }
    let scene = obj.scene();
    for seed in 0..3 {
        assert_eq!(sides_of(&scene, &reached(&scene, seed), "ball"), [FRONT_ONLY; 6], "seed {seed}");
    }
}

#[test]
fn open_boxes_are_reached_inside() {
    let mut obj = Obj::room();
    obj.named("open", "white").cuboid([0.2, 0.1, 0.2], [0.5, 0.4, 0.5], false, &[0, 2, 3, 4, 5]);
    // Open by a slit of a hundredth of its width.
    obj.named("slit", "white").cuboid([0.6, 0.1, 0.6], [0.9, 0.4, 0.9], false, &[0, 2, 3, 4, 5]);
    obj.quad([[0.6, 0.4, 0.6], [0.6, 0.4, 0.9], [0.897, 0.4, 0.9], [0.897, 0.4, 0.6]]);
    let scene = obj.scene();
    for seed in 0..5 {
        let sides = reached(&scene, seed);
        assert_eq!(sides_of(&scene, &sides, "open"), [(true, true); 5], "seed {seed}");
        assert_eq!(sides_of(&scene, &sides, "slit"), [(true, true); 6], "seed {seed}");
    }
}

#[test]
fn tiny_faces_are_reached() {
    let mut obj = Obj::room();
    obj.named("specks", "white");
    for k in 0..40 {
        let at = |s: f64| 0.1 + 0.8 * (f64::from(k) * s).fract();
        let (x, y, z) = (at(0.618_034), at(0.754_878), at(0.569_840));
        obj.quad([[x, y, z], [x + 1e-3, y, z], [x + 1e-3, y, z + 1e-3], [x, y, z + 1e-3]]);
    }
    let scene = obj.scene();
    for seed in 0..5 {
        let sides = reached(&scene, seed);
        let specks = sides_of(&scene, &sides, "specks");
        assert_eq!(specks, [(true, true); 40], "seed {seed}");
    }
}

#[test]
fn without_any_source_every_side_counts() {
    let mut scene = Obj::room().scene();
    scene.cameras.clear();
    scene.materials.iter_mut().for_each(|m| m.emission = DVec3::ZERO);
    assert_eq!(reached(&scene, 0), Sides::all(&scene));
}

/// Radiosity of what lies in `low..high`, by area, and its standard error.
fn radiosity_in(scene: &Scene, result: &Pass1Result, low: [f64; 3], high: [f64; 3]) -> (f64, f64) {
    let s = &result.solution;
    let (low, high) = (DVec3::from(low), DVec3::from(high));
    let (mut area, mut sum, mut variance) = (0.0, 0.0, 0.0);
    for e in 0..s.mesh.len() {
        let c = s.mesh.centroid(scene, e as u32) + scene.center;
        if c.cmpge(low).all() && c.cmple(high).all() {
            let a = s.mesh.area(e as u32);
            area += a;
            sum += a * mean(s.radiosity[e]);
            variance += (a * mean(s.standard_error[e])).powi(2);
        }
    }
    assert!(area > 0.0, "no element between {low} and {high}");
    (sum / area, variance.sqrt() / area)
}

/// A box that stands across cells of the floor: their open parts are as bright as in a scene whose
/// floor ends at the box.
#[test]
fn covered_floor_does_not_darken_the_cells_beside_the_box() {
    let (low, high) = ([0.35, 0.0, 0.35], [0.65, 0.3, 0.65]);
    let walls = |obj: &mut Obj| {
        obj.named("walls", "white").cuboid([0.0; 3], [1.0; 3], true, &[1, 2, 3, 4, 5]);
        obj.named("lamp", "lamp").quad([[0.1, 0.9, 0.1], [0.9, 0.9, 0.1], [0.9, 0.9, 0.9], [0.1, 0.9, 0.9]]);
        obj.named("box", "white").cuboid(low, high, false, &[1, 2, 3, 4, 5]);
        obj.named("floor", "white");
    };
    let mut whole = Obj::default();
    walls(&mut whole);
    whole.cuboid([0.0; 3], [1.0, 0.0, 1.0], true, &[0]);
    let mut holed = Obj::default();
    walls(&mut holed);
    let lines = [0.0, 0.3, 0.35, 0.4, 0.6, 0.65, 0.7, 1.0];
    for (x, z) in (0..7).flat_map(|i| (0..7).map(move |k| (i, k))) {
        let under = (2..5).contains(&x) && (2..5).contains(&z);
        if !under {
            holed.cuboid([lines[x], 0.0, lines[z]], [lines[x + 1], 0.0, lines[z + 1]], true, &[0]);
        }
    }
    let (whole, holed) = (whole.scene(), holed.scene());
    let results = [solve(&whole, 4096, 0.1), solve(&holed, 4096, 0.1)];
    // The box's sides halve the cells that they cross.
    let under = 0.3 * 0.3;
    let area: f64 =
        (0..results[0].solution.mesh.len() as u32).map(|e| results[0].solution.mesh.area(e)).sum();
    let covered = results[0].residuals.covered * area;
    assert!((covered - under).abs() < 2e-3, "{covered} of {under} m^2");
    assert!(results[1].residuals.covered < 1e-4);
    for (open, cells) in [
        (([0.3, 0.0, 0.4], [0.35, 0.0, 0.6]), ([0.3, 0.0, 0.4], [0.4, 0.0, 0.6])),
        (([0.65, 0.0, 0.4], [0.7, 0.0, 0.6]), ([0.6, 0.0, 0.4], [0.7, 0.0, 0.6])),
        (([0.4, 0.0, 0.3], [0.6, 0.0, 0.35]), ([0.4, 0.0, 0.3], [0.6, 0.0, 0.4])),
        // Not beside the box: how well the two scenes agree at all.
        (([0.0, 0.0, 0.0], [0.3, 0.0, 0.3]), ([0.0, 0.0, 0.0], [0.3, 0.0, 0.3])),
    ] {
        let grow = |(a, b): ([f64; 3], [f64; 3])| (a.map(|x| x - 1e-9), b.map(|x| x + 1e-9));
        let ((a, b), (c, d)) = (grow(open), grow(cells));
        let (expected, error1) = radiosity_in(&holed, &results[1], a, b);
        let (found, error2) = radiosity_in(&whole, &results[0], c, d);
        let error = error1.hypot(error2);
        println!("{expected:.4} {found:.4} +- {error:.4}");
        // Half a percent for elements of other shapes in the rest of the scene.
        assert!((found - expected).abs() < 4.0 * error + 0.005 * expected, "{expected} {found} +- {error}");
    }
    // Fully covered elements send and receive nothing.
    let (inside, _) = radiosity_in(&whole, &results[0], [0.4, -1e-9, 0.4], [0.6, 1e-9, 0.6]);
    assert_eq!(inside, 0.0);
}

/// Seen from outside, a closed room is dark for certain: that is no doubt that more rays would mend.
#[test]
fn the_dark_outside_of_a_room_is_not_uncertain() {
    let mut scene = Obj::room().scene();
    scene.cameras[0].origin = DVec3::new(3.0, 3.0, 3.0);
    let result = solve(&scene, 256, 0.2);
    let outside = |front: bool| result.solution.objects.iter().find(|o| o.name == "room" && o.front == front);
    assert!(outside(true).is_some_and(|o| o.radiosity.x > 0.1));
    assert!(outside(false).is_some_and(|o| o.radiosity.x == 0.0 && o.standard_error.x == 0.0));
    assert!(!result.warnings.iter().any(|w| w.contains("uncertain")), "{:?}", result.warnings);
}
