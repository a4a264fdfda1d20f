//! Edges of small faces that lie on other faces at sharp angles, such as those of a slanted part that stands on the floor of a hall.
//!
//! Where two faces share an edge, its margin knows their angle (`offset.rs`). An edge that touches the middle of another face
//! shares nothing with it: rays find that face, and the margin becomes that of a common edge. Of faces that are large for single
//! precision, margins are too thin to matter, and no ray is cast.

use super::offset::{Offset, WIDEST, edge_ends, height, inward};
use crate::embree::{CommittedScene, Hit, Ray};
use crate::scene::Scene;
use glam::DVec3;
use rayon::prelude::*;

/// Margins of a right angle below this share of a face's height do not matter at any angle that is not itself too small.
const MATTERS: f32 = 1e-4;

/// Widens the margins of edges that lie on other faces.
pub(super) fn widen(scene: &Scene, embree: &CommittedScene, offsets: &mut [Offset]) {
    let known = &*offsets;
    let of_face = |k: u32| {
        let margins = known[k as usize].margin;
        let small = (0..4).filter(move |e| margins[*e] >= MATTERS);
        small.filter_map(move |e| Some((k, e, share(scene, embree, known, k, e)?)))
    };
    let found: Vec<(u32, usize, f32)> =
        (0..scene.faces.len() as u32).into_par_iter().flat_map_iter(of_face).collect();
    for (k, e, share) in found {
        let margin = &mut offsets[k as usize].margin[e];
        *margin = margin.max(share);
    }
}

/// Margin of an edge, as a share of its face's height, that the faces ask for which it lies on; none where it lies on none.
fn share(scene: &Scene, embree: &CommittedScene, offsets: &[Offset], face: u32, edge: usize) -> Option<f32> {
    let normal = scene.faces[face as usize].normal;
    let (a, b) = edge_ends(scene, face, edge);
    let (inward, height) = (inward(scene, face, edge), height(scene, face, edge));
    let reach = WIDEST * height;
    let own = offsets[face as usize].lift;
    let wanted = |side: DVec3| -> Option<f64> {
        // From a little behind the face, which rounding may have put behind the other.
        let origin = 0.5 * (a + b) + reach * inward - 2.0 * own * side;
        let hit = other(embree, face, origin, side, reach + 2.0 * own)?;
        let n = scene.faces[hit.face as usize].normal;
        let lift = own.max(offsets[hit.face as usize].lift);
        let corner = scene.corner(&scene.faces[hit.face as usize], 0);
        let touches = [a, b].iter().all(|end| n.dot(*end - corner).abs() <= 2.0 * lift);
        // cot(angle / 2) = (1 + cos) / sin, of an angle that is not above a right one.
        let sine = n.dot(inward).abs();
        let cot = (1.0 + (1.0 - sine * sine).max(0.0).sqrt()) / sine.max(1e-12);
        touches.then_some(lift * cot / height)
    };
    let widest = [normal, -normal].into_iter().filter_map(wanted).reduce(f64::max)?;
    Some(widest.min(WIDEST) as f32)
}

/// The first face but `face` within `length` \[m\].
fn other(embree: &CommittedScene, face: u32, origin: DVec3, direction: DVec3, length: f64) -> Option<Hit> {
    let mut ray = Ray::segment(origin.as_vec3(), direction.as_vec3(), length as f32);
    loop {
        let hit = embree.intersect(&ray)?;
        if hit.face != face {
            return Some(hit);
        }
        ray.tnear = f32::from_bits(hit.t.to_bits() + 1);
        if ray.tnear > ray.tfar {
            return None;
        }
    }
}
