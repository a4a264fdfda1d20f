//! The policy of ray starts: no leak, no self-hit, no lost contact.

use super::*;
use crate::color::Rgb;
use crate::form_factor::{AtSpecular, Casting, ExchangeMatrix, cast};
use crate::hard_cases::build::{SceneText, plate, sphere, turned, wedge_room};
use crate::mesh::{Mesh, Sides};

fn factors(scene: &Scene, rays: u32, size: f64) -> (Mesh, ExchangeMatrix) {
    let device = Device::new(2).expect("Embree");
    let visibility = Visibility::new(&device, scene).expect("a tree");
    let mesh = Mesh::new(scene, &Sides::fronts(scene), size, true).expect("a mesh");
    let casting = Casting {
        rays,
        batches: 1,
        seed: 3,
        specular: AtSpecular::End,
        reached: None,
        emitters: None,
        progress: &|_| (),
    };
    let (matrix, _) = cast(&visibility, &mesh, &casting);
    (mesh, matrix)
}

/// Shares of all rays of a closed scene that left it, and that landed on the back of a face.
fn leaked(scene: &Scene, rays: u32, size: f64) -> (f64, f64) {
    let (_, matrix) = factors(scene, rays, size);
    let n = matrix.len() as f64;
    let mean = |f: &dyn Fn(&crate::form_factor::RowSummary) -> Rgb| {
        matrix.summary.iter().map(|s| f(s).x).sum::<f64>() / n
    };
    (mean(&|s| s.escaped), mean(&|s| s.absorbed))
}

const SKEW: [f64; 3] = [0.267_261_241_912_424_4, 0.534_522_483_824_848_8, 0.801_783_725_737_273_2];

/// Closed scenes let no more than a millionth of their rays out: edges at all angles, in a plane of the axes and
/// turned, near the centre and far from it.
#[test]
fn watertight_scenes_do_not_leak() {
    let mut worst: f64 = 0.0;
    let mut check = |name: &str, text: &SceneText, rays: u32, size: f64| {
        for (turn, angle) in [("straight", 0.0), ("turned", 0.7)] {
            let scene = text.transformed(turned(SKEW, angle)).load().expect("scene");
            let (escaped, behind) = leaked(&scene, rays, size);
            eprintln!("{name}, {turn}: escaped {escaped:.1e}, behind {behind:.1e}");
            worst = worst.max(escaped).max(behind);
            assert!(escaped <= 1e-6 && behind <= 1e-6, "{name}, {turn}: {escaped:.1e} {behind:.1e}");
        }
    };
    for degrees in [0.1, 1.0, 10.0, 45.0, 90.0, 135.0, 179.0, 179.9] {
        check(&format!("wedge {degrees}"), &wedge_room(degrees, 1.0), 65_536, 0.5);
    }
    let room = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0, 2.0, 0.5], true);
    check("room", &room, 65_536, 1.0);
    check("sphere", &SceneText::new().polygons("s", "m", &sphere(1.0, 12, true)), 1024, 10.0);
    eprintln!("worst {worst:.1e}");
}

/// Two plates that nearly touch see only each other, however narrow the gap.
#[test]
fn narrow_gaps_stay_open() {
    for gap in [1e-2, 1e-4, 1e-5, 1e-6] {
        for angle in [0.0, 0.7] {
            let text = SceneText::new()
                .polygon("a", "m", &plate([0.0, 1.0], [0.0, 1.0], 0.0, true))
                .polygon("b", "m", &plate([0.0, 1.0], [0.0, 1.0], gap, false))
                .transformed(turned(SKEW, angle));
            let scene = text.load().expect("scene");
            let (_, matrix) = factors(&scene, 16_384, 10.0);
            let seen = matrix.row(0).filter(|(j, _)| *j == 1).map(|(_, f)| f.x).sum::<f64>();
            // Two squares: 1 - F is near twice the gap for a small one.
            eprintln!("gap {gap:e}, turned by {angle}: 1 - F = {:.2e}", 1.0 - seen);
            assert!((1.0 - seen) < 3.0 * gap + 1e-4, "gap {gap:e}: {seen}");
        }
    }
}
