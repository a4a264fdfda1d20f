//! Geometry that breaks meshes, trees and single precision.

use super::build::{Point, SceneText, box_sides, plate, sphere, turned, wedge_room};
use super::exact::{factor, point_factor};
use super::{Case, Outcome, Pace, compare, mean, picture, said, solve, solved};
use crate::Result;
use crate::embree::Device;
use crate::error::Error;
use crate::render::{Method, Quality};
use crate::scene::Scene;
use crate::visibility::Visibility;
use glam::DVec3;
use std::f64::consts::PI;

const fn case(
    name: &'static str,
    breaks: &'static str,
    answer: &'static str,
    run: fn() -> Result<Outcome>,
) -> Case {
    Case { group: "geometry", name, breaks, answer, limit: 0.01, pace: Pace::Fast, run }
}

/// The geometry of the suite.
pub(super) const CASES: &[Case] = &[
    case(
        "edge shared at 0.1 degrees",
        "origins beyond the neighbour, singular kernels",
        "quadrature",
        || wedge(0.1),
    ),
    case("edge shared at 1 degree", "origins beyond the neighbour", "quadrature", || wedge(1.0)),
    case("edge shared at 10 degrees", "origins beyond the neighbour", "quadrature", || wedge(10.0)),
    case("edge shared at 90 degrees", "quadrature on shared edges", "quadrature", || wedge(90.0)),
    case("edge shared at 170 degrees", "rays miss what is nearly coplanar", "quadrature", || wedge(170.0)),
    case("edge shared at 179.9 degrees", "as above", "quadrature", || wedge(179.9)),
    case("closed wedge of 0.1 degrees", "leaks at the sharp edge", "furnace", || {
        furnace_of(&wedge_room(0.1, 1.0), 256, 0.25)
    }),
    case("gap of 1e-2 of the size", "offsets larger than the gap", "quadrature", || gap(1e-2)),
    case("gap of 1e-4 of the size", "as above", "quadrature", || gap(1e-4)),
    case("gap of 1e-6 of the size", "as above", "quadrature", || gap(1e-6)),
    case("light in the plane of the ceiling", "light or ceiling at random", "quadrature", || {
        coplanar_light([0.3, 0.7])
    }),
    case("lights that overlap in part", "the common part counts twice", "quadrature", overlapping_lights),
    case("doubled walls", "energy from nothing", "furnace", doubled_walls),
    case("box on the floor, bottom coplanar", "light under the box", "furnace", standing_box),
    case("slivers of aspect 1e4", "no normal, no hit", "quadrature", || slivers(1e4)),
    case("slivers of aspect 1e6", "as above", "quadrature", || slivers(1e6)),
    case("zero-area and duplicate faces", "NaN normals, doubled light", "furnace", degenerate),
    case("quads that are not planar", "cracks between renderers' splits", "furnace", bent_quads),
    case("concave polygons", "fans outside the polygon", "furnace", concave),
    case("walls turned inside out", "black or missing walls", "quadrature", flipped),
    case("box of 1e-4 of the hall", "offsets as large as the object", "furnace", || small_box(1e-4)),
    case("box of 1e-6 of the hall", "as above", "furnace", || small_box(1e-6)),
    case("small box off the centre", "as above", "furnace", small_box_aside),
    case("slanted plate of 3e-5 of the hall", "offsets through the floor", "furnace", slanted),
    case("room in nanometres", "absolute epsilons", "furnace", || sized_room(1e-9)),
    case("room in kilometres", "absolute epsilons", "furnace", || sized_room(1e3)),
    case("room 1e3 away", "coordinates cancel", "image at the origin", || far_room(1e3)),
    case("room 1e6 away", "coordinates cancel", "image at the origin", || far_room(1e6)),
    case("room 1e7 away", "coordinates cancel", "image at the origin", || far_room(1e7)),
    case("T-junctions", "leaks where vertices meet edges", "furnace", t_junctions),
    case("walls that do not quite meet", "light leaks out unnoticed", "named warning", open_corners),
    case("rays through vertices and edges", "missed or doubled hits", "every ray hits", through_vertices),
    case("needle-thin light", "never hit, elements explode", "quadrature", needle),
    case("light of 1e-6 of the room", "never hit", "point source", tiny_light),
    case("light that all but lies on the floor", "1/r^2 without bound", "quadrature", low_light),
    case("default elements on slivers", "elements explode", "furnace", default_elements),
    Case { pace: Pace::Minutes, ..case("sphere of a million triangles", "memory", "furnace", million) },
];

const ALBEDO: f64 = 0.7;

/// A closed scene of material `m`: B = E / (1 - rho) everywhere.
fn furnace_of(text: &SceneText, rays: u32, size: f64) -> Result<Outcome> {
    solved(&text.clone().diffuse("m", ALBEDO, 1.0), rays, Some(size), &[("", 1.0 / (1.0 - ALBEDO))])
}

fn wedge(degrees: f64) -> Result<Outcome> {
    let (s, c) = degrees.to_radians().sin_cos();
    let floor = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let lamp = vec![[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [c, 1.0, s], [c, 0.0, s]];
    let exact = 0.5 * factor(&floor, &lamp);
    let text = SceneText::new()
        .polygon("floor", "grey", &floor)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 4096, Some(0.1), &[("floor", exact)])
}

fn gap(width: f64) -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let lamp = plate([0.0, 1.0], [0.0, 1.0], width, false);
    let exact = 0.5 * factor(&floor, &lamp);
    let text = SceneText::new()
        .polygon("floor", "grey", &floor)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 4096, Some(0.25), &[("floor", exact)])
}

/// A black room but for its floor, with the given lamps in the ceiling's plane.
fn lit_floor(lamps: &[Vec<Point>]) -> SceneText {
    let mut text = SceneText::new()
        .cuboid("", |s| if s == "z0" { "grey".into() } else { "black".into() }, [0.0; 3], [1.0; 3], true)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("black", 0.0, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    for (k, lamp) in lamps.iter().enumerate() {
        text = text.polygon(&format!("lamp{k}"), "lamp", lamp);
    }
    text
}

fn coplanar_light(extent: [f64; 2]) -> Result<Outcome> {
    let lamp = plate(extent, extent, 1.0, false);
    let exact = 0.5 * factor(&plate([0.0, 1.0], [0.0, 1.0], 0.0, true), &lamp);
    solved(&lit_floor(&[lamp]), 4096, Some(0.25), &[("z0", exact)])
}

fn overlapping_lights() -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let to = |x, y| factor(&floor, &plate(x, y, 0.9, false));
    let (a, b) = (plate([0.2, 0.6], [0.2, 0.6], 0.9, false), plate([0.4, 0.8], [0.3, 0.7], 0.9, false));
    let union = to([0.2, 0.6], [0.2, 0.6]) + to([0.4, 0.8], [0.3, 0.7]) - to([0.4, 0.6], [0.3, 0.6]);
    solved(&lit_floor(&[a, b]), 4096, Some(0.25), &[("z0", 0.5 * union)])
}

fn doubled_walls() -> Result<Outcome> {
    // The second of each wall is cut into two triangles along the other diagonal: no face is the same as another.
    let mut text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true);
    for (side, p) in box_sides([0.0; 3], [1.0; 3], true) {
        text = text.polygon(&format!("again-{side}"), "m", &[p[1], p[2], p[3]]).polygon(
            &format!("again-{side}"),
            "m",
            &[p[1], p[3], p[0]],
        );
    }
    let scene = text.diffuse("m", ALBEDO, 1.0).load()?;
    let result = solve(&scene, 1024, Some(0.25), 1)?;
    let emitted = result.solution.ledger.emitted.x;
    if (emitted / 6.0 - 1.0).abs() > 1e-9 {
        return Err(Error::scene("doubled walls", format!("6 W of light became {emitted} W")));
    }
    compare(&result, &[("", 1.0 / (1.0 - ALBEDO))])
}

fn standing_box() -> Result<Outcome> {
    let text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true).cuboid(
        "box-",
        |_| "m".into(),
        [0.31, 0.27, 0.0],
        [0.4, 0.35, 0.5],
        false,
    );
    let scene = text.diffuse("m", ALBEDO, 1.0).load()?;
    let result = solve(&scene, 2048, Some(0.1), 1)?;
    // The bottom and what it covers are not seen.
    let answers: Vec<(&str, f64)> =
        ["x0", "z0", "z1", "box-x0", "box-y1", "box-z1"].iter().map(|n| (*n, 1.0 / (1.0 - ALBEDO))).collect();
    compare(&result, &answers)
}

/// A floor cut into slivers that all meet in one corner, under a lamp.
fn slivers(aspect: f64) -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let lamp = plate([0.2, 0.8], [0.2, 0.8], 0.5, false);
    let exact = 0.5 * factor(&floor, &lamp);
    // Half of the floor as a strip of slivers with one long side, the rest whole.
    let w = 1.0 / aspect;
    let mut text = SceneText::new().polygon("floor", "grey", &plate([0.0, 0.5], [0.0, 1.0], 0.0, true));
    for k in 0..10 {
        let (a, b) = (0.5 + w * f64::from(k), 0.5 + w * f64::from(k + 1));
        text = text.polygon("floor", "grey", &[[a, 0.0, 0.0], [b, 0.0, 0.0], [b, 1.0, 0.0]]).polygon(
            "floor",
            "grey",
            &[[a, 0.0, 0.0], [b, 1.0, 0.0], [a, 1.0, 0.0]],
        );
    }
    let text = text
        .polygon("floor", "grey", &plate([0.5 + 10.0 * w, 1.0], [0.0, 1.0], 0.0, true))
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 1024, Some(0.1), &[("floor", exact)])
}

fn degenerate() -> Result<Outcome> {
    let text = SceneText::new()
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .cuboid("again-", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .polygon("line", "m", &[[0.1, 0.1, 0.1], [0.5, 0.5, 0.5], [0.9, 0.9, 0.9]])
        .polygon("point", "m", &[[0.5, 0.1, 0.1], [0.5, 0.1, 0.1], [0.5, 0.1, 0.1]]);
    furnace_of(&text, 1024, 0.25)
}

/// A room whose walls bulge: every wall is a 3 x 3 net of quads of which none is planar.
fn bent_quads() -> Result<Outcome> {
    let mut text = SceneText::new();
    for (side, p) in box_sides([0.0; 3], [1.0; 3], true) {
        let [a, b, d] = [p[0], p[1], p[3]].map(DVec3::from);
        let (e1, e2) = (b - a, d - a);
        let n = e1.cross(e2);
        let at = |i: usize, j: usize| {
            let (s, t) = (i as f64 / 3.0, j as f64 / 3.0);
            let inner = i % 3 != 0 && j % 3 != 0;
            let bulge = if inner { 0.05 * (1.0 + (i * 7 + j * 3) as f64 / 10.0) } else { 0.0 };
            (a + s * e1 + t * e2 + bulge * n).to_array()
        };
        for i in 0..3 {
            for j in 0..3 {
                let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                text = text.polygon(side, "m", &quad);
            }
        }
    }
    furnace_of(&text, 1024, 0.2)
}

/// An L-shaped room.
fn concave() -> Result<Outcome> {
    let l = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
    let floor: Vec<Point> = l.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let ceiling: Vec<Point> = l.iter().rev().map(|p| [p[0], p[1], 1.0]).collect();
    let mut text = SceneText::new().polygon("floor", "m", &floor).polygon("ceiling", "m", &ceiling);
    for k in 0..l.len() {
        let (a, b) = (l[k], l[(k + 1) % l.len()]);
        let wall = [[b[0], b[1], 0.0], [a[0], a[1], 0.0], [a[0], a[1], 1.0], [b[0], b[1], 1.0]];
        text = text.polygon(&format!("wall{k}"), "m", &wall);
    }
    furnace_of(&text, 1024, 0.25)
}

/// A lamp over a floor that is turned away from it: surfaces reflect on both sides.
fn flipped() -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, false);
    let lamp = plate([0.2, 0.8], [0.2, 0.8], 0.5, false);
    let exact = 0.5 * factor(&floor, &lamp);
    let scene = SceneText::new()
        .polygon("floor", "grey", &floor)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0)
        .load()?;
    let result = solve(&scene, 4096, Some(0.1), 1)?;
    let lit = result.solution.objects.iter().find(|o| o.name == "floor" && !o.front);
    let Some(o) = lit else { return Err(Error::scene("floor", "its back has no elements")) };
    Ok(Outcome::Number {
        error: (o.radiosity.x / exact - 1.0).abs(),
        standard_error: o.standard_error.x / exact,
    })
}

/// A furnace with a box of the given share of its size standing in the middle of its floor.
fn small_box(share: f64) -> Result<Outcome> {
    box_in_hall(share, [0.5 - 0.5 * share, 0.5 - 0.5 * share, 0.0])
}

fn small_box_aside() -> Result<Outcome> {
    box_in_hall(1e-3, [0.93, 0.871, 0.0])
}

fn box_in_hall(share: f64, at: Point) -> Result<Outcome> {
    let text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true).cuboid(
        "box-",
        |_| "m".into(),
        at,
        [share; 3],
        false,
    );
    let scene = text.diffuse("m", ALBEDO, 1.0).load()?;
    let result = solve(&scene, 4096, Some(0.25), 1)?;
    let answers: Vec<(&str, f64)> = ["z0", "x1", "box-x0", "box-x1", "box-y0", "box-y1", "box-z1"]
        .map(|n| (n, 1.0 / (1.0 - ALBEDO)))
        .into();
    compare(&result, &answers)
}

/// A plate that shines on both sides, one edge of it on the floor, its front towards that at six degrees.
fn slanted() -> Result<Outcome> {
    let (at, size, height) = (0.6, 3e-5, 3e-6);
    let ends = [[at, at + size, height], [at + size, at + size, height], [at + size, at, 0.0], [at, at, 0.0]];
    let text = SceneText::new()
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .polygon("plate", "plate", &ends)
        .diffuse("m", ALBEDO, 1.0)
        .material("plate", &format!("diffuse = {ALBEDO}\nemission = {}\nemit_both_sides = true", 1.0 / PI));
    solved(&text, 4096, Some(0.25), &["", "plate"].map(|n| (n, 1.0 / (1.0 - ALBEDO))))
}

fn sized_room(metres: f64) -> Result<Outcome> {
    let text = SceneText::new()
        .head(&format!("unit = {metres:e}"))
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0, 2.0, 1.5], true)
        .cuboid("box-", |_| "m".into(), [0.3, 0.4, 0.2], [0.2, 0.3, 0.4], false);
    solved(&text.diffuse("m", ALBEDO, 1.0), 1024, Some(0.25 * metres), &[("", 1.0 / (1.0 - ALBEDO))])
}

/// A room with a box under a lamp, somewhere.
fn furnished(at: Point) -> Result<Scene> {
    let camera = |x: f64| {
        let p = |p: Point| [0, 1, 2].map(|k| p[k] + at[k]);
        format!(
            "[camera]\norigin = {:?}\ntarget = {:?}\nup = [0, 0, 1]\nfov = 60\nsize = [24, 24]",
            p([x, 0.02, 0.5]),
            p([0.5, 1.0, 0.4])
        )
    };
    SceneText::new()
        .head(&camera(0.5))
        .cuboid("", |_| "grey".into(), [0.0; 3], [1.0; 3], true)
        .cuboid("box-", |_| "grey".into(), [0.375, 0.5, 0.0], [0.25, 0.25, 0.5], false)
        .polygon("lamp", "lamp", &plate([0.25, 0.75], [0.25, 0.75], 0.9375, false))
        .diffuse("grey", 0.6, 0.0)
        .diffuse("lamp", 0.0, 10.0)
        .transformed(|p| [0, 1, 2].map(|k| p[k] + at[k]))
        .load()
}

fn far_room(distance: f64) -> Result<Outcome> {
    let method = Method::TwoPass(Quality::Gather);
    let images = [[0.0; 3], [distance, -distance, 0.5 * distance]]
        .map(|at| picture(&furnished(at)?, method, 4, (256, Some(0.2)), 1));
    let [near, far] = images;
    let (near, far) = (near?, far?);
    let m = mean(&near);
    let squares: f64 = near.data.iter().zip(&far.data).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let error = (squares / near.data.len() as f64).sqrt() / m;
    // A tenth of what the table's other cases are allowed.
    Ok(Outcome::Number { error: 10.0 * error, standard_error: 0.0 })
}

/// Each wall of a room is divided differently from its neighbours.
fn t_junctions() -> Result<Outcome> {
    let mut text = SceneText::new();
    for (k, (side, p)) in box_sides([0.0; 3], [1.0; 3], true).into_iter().enumerate() {
        let [a, b, d] = [p[0], p[1], p[3]].map(DVec3::from);
        let (n, m) = (1 + k, 7 - k);
        for i in 0..n {
            for j in 0..m {
                let at = |i: usize, j: usize| {
                    (a + (b - a) * (i as f64 / n as f64) + (d - a) * (j as f64 / m as f64)).to_array()
                };
                text = text.polygon(side, "m", &[at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    let scene = text.transformed(turned([0.6, 0.0, 0.8], 0.3)).diffuse("m", ALBEDO, 1.0).load()?;
    let result = solve(&scene, 4096, Some(0.5), 1)?;
    let l = &result.solution.ledger;
    if l.escaped.x / l.emitted.x > 1e-6 / (1.0 - ALBEDO) {
        return Err(Error::scene(
            "T-junctions",
            format!("{:.1e} of the light escaped", l.escaped.x / l.emitted.x),
        ));
    }
    compare(&result, &[("", 1.0 / (1.0 - ALBEDO))])
}

/// Walls a ten-thousandth short of each other: light leaks, and the program says where.
fn open_corners() -> Result<Outcome> {
    let mut text = SceneText::new();
    for (side, p) in box_sides([0.0; 3], [1.0; 3], true) {
        let c = p.iter().map(|p| DVec3::from(*p)).sum::<DVec3>() / 4.0;
        let smaller: Vec<Point> =
            p.iter().map(|p| (c + (DVec3::from(*p) - c) * (1.0 - 1e-4)).to_array()).collect();
        text = text.polygon(side, "m", &smaller);
    }
    let scene = text.diffuse("m", ALBEDO, 1.0).load()?;
    let result = solve(&scene, 4096, Some(0.25), 1)?;
    if let Outcome::Number { error, .. } = compare(&result, &[("", 1.0 / (1.0 - ALBEDO))])? {
        if error > 0.01 {
            return Err(Error::scene("open corners", format!("wrong by {:.2} %", 100.0 * error)));
        }
    }
    said(Ok(()), &result.warnings, &["may not quite meet", "object"])
}

/// Rays from the middle of a closed net of triangles to its vertices and edges: none may pass.
fn through_vertices() -> Result<Outcome> {
    let n = 24;
    let faces = sphere(1.0, n, true);
    let scene = SceneText::new().polygons("sphere", "m", &faces).diffuse("m", 0.5, 1.0).load()?;
    let device = Device::new(0)?;
    let visibility = Visibility::new(&device, &scene)?;
    let (mut cast, mut missed) = (0u32, 0u32);
    for face in &scene.faces {
        let corners = [0, 1, 2].map(|k| scene.corner(face, k));
        for k in 0..3 {
            for target in [corners[k], 0.5 * (corners[k] + corners[(k + 1) % 3])] {
                for origin in [DVec3::ZERO, DVec3::new(0.1, 0.2, -0.3)] {
                    let direction = (target - origin).as_vec3();
                    cast += 1;
                    missed += u32::from(visibility.closest(origin.as_vec3(), direction, u32::MAX).is_none());
                }
            }
        }
    }
    // Every ray counts: one in a million misses is too many for these few thousand.
    Ok(Outcome::Number { error: 1e4 * f64::from(missed) / f64::from(cast), standard_error: 0.0 })
}

fn needle() -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let lamp = plate([0.5, 0.5 + 1e-6], [0.0, 1.0], 0.5, false);
    let exact = 0.5 * factor(&floor, &lamp);
    let text = SceneText::new()
        .polygon("floor", "grey", &floor)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    // With the default element size: the needle must not make millions of elements.
    let scene = text.load()?;
    let result = solve(&scene, 256, None, 1)?;
    if result.solution.mesh.len() > 20_000 {
        return Err(Error::scene("needle", format!("{} elements", result.solution.mesh.len())));
    }
    compare(&result, &[("floor", exact)])
}

fn tiny_light() -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let lamp = plate([0.5 - 5e-7, 0.5 + 5e-7], [0.5 - 5e-7, 0.5 + 5e-7], 0.8, false);
    // By reciprocity: the factor from a point of the lamp to the floor, times the ratio of areas.
    let exact = 0.5 * 1e-12 * point_factor(DVec3::new(0.5, 0.5, 0.8), DVec3::NEG_Z, &floor);
    let text = SceneText::new()
        .cuboid("", |s| if s == "z0" { "grey".into() } else { "black".into() }, [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("black", 0.0, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 1024, Some(0.1), &[("z0", exact)])
}

/// A lamp of 1e-5 of the room, ten times as high above the floor.
fn low_light() -> Result<Outcome> {
    let (x, w, z) = (0.3, 1e-5, 1e-4);
    let lamp = plate([x, x + w], [x, x + w], z, false);
    let exact = 0.5 * w * w * factor(&lamp, &plate([0.0, 1.0], [0.0, 1.0], 0.0, true));
    let text = SceneText::new()
        .cuboid("", |s| if s == "z0" { "grey".into() } else { "black".into() }, [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("black", 0.0, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 1024, Some(0.1), &[("z0", exact)])
}

/// A furnace with slivers of aspect 1e6 among its walls, divided by default.
fn default_elements() -> Result<Outcome> {
    let mut text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true);
    for k in 0..8 {
        let x = 0.1 + 0.1 * f64::from(k);
        text = text.polygon("hair", "m", &[[x, 0.1, 0.5], [x + 1e-6, 0.1, 0.5], [x, 0.9, 0.5]]);
    }
    let scene = text.diffuse("m", ALBEDO, 1.0).load()?;
    let result = solve(&scene, 256, None, 1)?;
    if result.solution.mesh.len() > 20_000 {
        return Err(Error::scene("slivers", format!("{} elements", result.solution.mesh.len())));
    }
    compare(&result, &[("z0", 1.0 / (1.0 - ALBEDO)), ("x1", 1.0 / (1.0 - ALBEDO))])
}

fn million() -> Result<Outcome> {
    let text = SceneText::new().polygons("sphere", "m", &sphere(1.0, 354, true));
    let scene = text.diffuse("m", ALBEDO, 1.0).load()?;
    compare(&solve(&scene, 32, None, 1)?, &[("", 1.0 / (1.0 - ALBEDO))])
}
