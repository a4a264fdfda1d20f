//! Images of lamps in flat mirrors.

mod common;

use common::*;
use glam::DVec3;
use twopass::emitters::Emitters;
use twopass::sampling::sobol;
use twopass::scene::Scene;
use twopass::visibility::Visibility;

/// A room's wall of `nu x nv` mirrors but for a hole in its middle, and a lamp under the ceiling.
fn room(nu: usize, nv: usize) -> Scene {
    let mut files = Files::default();
    files.material("mirror", "specular = 0.9\nroughness = 0").diffuse("lamp", &[0.0], &[1.0]);
    files.polygon("lamp", "lamp", &[[1.0, 2.9, 1.0], [2.0, 2.9, 1.0], [2.0, 2.9, 2.0], [1.0, 2.9, 2.0]]);
    for (j, i) in (0..nv).flat_map(|j| (0..nu).map(move |i| (j, i))) {
        let at = |i: usize, n: usize, size: f64| size * i as f64 / n as f64;
        let (x, y) = ([at(i, nu, 4.0), at(i + 1, nu, 4.0)], [at(j, nv, 3.0), at(j + 1, nv, 3.0)]);
        // Whole mirrors of any number of parts leave the same hole.
        if x[0] >= 1.0 && x[1] <= 2.0 && y[0] >= 1.0 && y[1] <= 2.0 {
            continue;
        }
        let points = [[x[0], y[0], 0.0], [x[1], y[0], 0.0], [x[1], y[1], 0.0], [x[0], y[1], 0.0]];
        files.polygon("mirror", "mirror", &points);
    }
    files.load()
}

/// Of many small mirrors in one plane receivers see the same images as of a few large ones, through the same windows.
#[test]
fn images_do_not_depend_on_how_a_mirror_is_divided() {
    let device = device();
    let windows = |scene: &Scene| {
        let visibility = Visibility::new(&device, scene).expect("tree");
        let emitters = Emitters::new(&visibility);
        let mut found = Vec::new();
        for k in 0..4096 {
            let [p, q] = [sobol(k, 0, 1), sobol(k, 1, 2)];
            let point = DVec3::new(4.0 * p[0], 3.0 * p[1], 0.1 + 3.9 * p[2]) - scene.center;
            let sample = emitters.sample([q[0], q[1], q[2]]).expect("a lamp");
            emitters.images(scene, point, DVec3::NEG_Z, &sample, |face, window, c| {
                let inside = scene.face_frame(&scene.faces[face as usize]).contains(window);
                assert!(inside, "{window} is not on face {face}");
                found.push((k, window + scene.center, c.irradiance.x));
            });
        }
        found
    };
    let (few, many) = (windows(&room(4, 3)), windows(&room(92, 87)));
    assert!((1000..4000).contains(&few.len()) && few.len() == many.len(), "{} {}", few.len(), many.len());
    for (a, b) in few.iter().zip(&many) {
        assert_eq!(a.0, b.0);
        assert!(a.1.distance(b.1) < 1e-12 && (a.2 - b.2).abs() <= 1e-12 * a.2.abs(), "{a:?} {b:?}");
    }
}
