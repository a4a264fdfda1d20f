//! Materials and light that break solvers and samplers.

use super::build::{Point, SceneText, box_sides, plate, sphere};
use super::exact::factor;
use super::{Case, Outcome, Pace, compare, departure, mean, picture, said, solve, solved};
use crate::Result;
use crate::error::Error;
use crate::render::{Method, Quality};
use std::f64::consts::PI;

const fn case(
    name: &'static str,
    breaks: &'static str,
    answer: &'static str,
    run: fn() -> Result<Outcome>,
) -> Case {
    Case { group: "transport", name, breaks, answer, limit: 0.01, pace: Pace::Fast, run }
}

/// A case that takes seconds.
const fn seconds(
    name: &'static str,
    breaks: &'static str,
    answer: &'static str,
    run: fn() -> Result<Outcome>,
) -> Case {
    Case { pace: Pace::Seconds, ..case(name, breaks, answer, run) }
}

/// The transport of the suite.
pub(super) const CASES: &[Case] = &[
    case("furnace, albedo 0.9", "slow convergence", "furnace", || furnace(0.9)),
    case("furnace, albedo 0.99", "slow convergence", "furnace", || furnace(0.99)),
    case("furnace, albedo 0.999", "slow convergence", "furnace", || furnace(0.999)),
    Case { limit: 0.005, ..case("furnace, albedo 0.9999", "stops early", "furnace", || furnace(0.9999)) },
    case("furnace, albedo 1 - 1e-6", "row sums in single precision", "furnace", || furnace(1.0 - 1e-6)),
    case("one lit wall, albedo 0.99", "factors that are not reciprocal", "closed form", || lit_wall(0.99)),
    case("one lit wall, albedo 1 - 1e-6", "factors that are not reciprocal", "closed form", || {
        lit_wall(1.0 - 1e-6)
    }),
    case("two halls, one door, albedo 0.999", "balance between the halls", "power emitted", halls),
    case(
        "two halls, one door, albedo 1 - 1e-5",
        "balance between the halls, a thousand steps",
        "balance of power",
        white_halls,
    ),
    case("perfect white, closed", "a large number where none exists", "an error", white),
    case("black surfaces", "division by zero", "quadrature", black),
    case("no light at all", "a black picture", "an error", dark),
    case("emission from 1e-12 to 1e12", "the weak light is never sampled", "furnaces", emissions),
    case("closed box with perfect mirrors", "chains without end", "furnace", mirrors),
    case("camera between perfect mirrors", "recursion's limit", "furnace", || {
        glass_room("diffuse = 0.0\nspecular = 1.0\nroughness = 0.0", true, [0.5, 0.02, 0.5])
    }),
    case("roughness 1e-4", "a lobe narrower than a float", "furnace", || {
        glass_room("diffuse = 0.0\nspecular = 1.0\nroughness = 1e-4", false, [0.5, 0.02, 0.5])
    }),
    seconds("roughness 1", "lobe and path disagree", "path tracer", rough),
    case("glass of ior 1.5", "total internal reflection", "furnace", || glass(1.5)),
    case("glass of ior 1", "division by zero", "furnace", || glass(1.0)),
    case("glass of ior 0.8", "reflection outside", "furnace", || glass(0.8)),
    case("glass of ior 3", "trapped light", "furnace", || glass(3.0)),
    case("at the critical angle", "square root of a negative number", "furnace", critical),
    case("camera inside glass", "trapped light", "furnace", || glass_room(GLASS, false, [0.5, 0.5, 0.5])),
    case("lamp at grazing incidence", "cosines near zero", "quadrature", grazing),
    seconds("light through a keyhole", "rays miss the hole", "quadrature", keyhole),
    seconds("light only through glass", "no straight connection", "path tracer", || only_by(Way::Glass)),
    seconds("light only by a mirror", "no straight connection", "path tracer", || only_by(Way::Mirror)),
    seconds("light only by a caustic", "no straight connection", "path tracer", || only_by(Way::Bowl)),
    case(
        "box without a bottom, albedo 0.98",
        "covered elements that keep light for ever",
        "balance of power",
        open_box,
    ),
    case("lamp close under a white ceiling", "elements wider than the gap", "a warning", gap),
    case("translucent ball through a wall", "light from nothing", "balance of power", translucent),
    case("glass in a corner of the room", "walls that see each other in glass", "balance of power", cornered),
    case("translucent box on the floor", "light lost in the contact", "furnace", lantern),
    seconds("balls of mirror and of glass", "caustics twice or never", "path tracer", balls),
];

const MIRROR: &str = "diffuse = 0.0\nspecular = 0.9\nroughness = 0.0";
const GLASS: &str = "diffuse = 0.0\nspecular = 0.0\nspecular_transmission = 1.0\nior = 1.5";

fn furnace(albedo: f64) -> Result<Outcome> {
    let text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true);
    // Rays that number no power of two, on purpose.
    solved(&text.diffuse("m", albedo, 1.0), 1000, Some(0.25), &[("", 1.0 / (1.0 - albedo))])
}

/// A unit cube with one emitting wall, one element a wall: three unknowns by symmetry.
fn lit_wall(albedo: f64) -> Result<Outcome> {
    let sides = box_sides([0.0; 3], [1.0; 3], true);
    let opposite = factor(&sides[0].1, &sides[1].1);
    let adjacent = (1.0 - opposite) / 4.0;
    // B = (ceiling, four walls, floor): eliminate the walls by hand.
    let r = albedo;
    // c = 1 + r (4 a w + o f), w = r (a c + a f + (2 a + o) w), f = r (4 a w + o c); f = c - 1 + (o r)(c - f) gives
    // c - f = 1 / (1 + r o).
    let d = 1.0 / (1.0 + r * opposite);
    let s = {
        // s = c + f: s = 1 + r (8 a w + o s), w = r (a s + (2 a + o) w).
        let k = r * adjacent / (1.0 - r * (2.0 * adjacent + opposite));
        1.0 / (1.0 - r * opposite - 8.0 * r * adjacent * k)
    };
    let w = r * adjacent * s / (1.0 - r * (2.0 * adjacent + opposite));
    let text = SceneText::new()
        .cuboid("", |s| if s == "z1" { "lit".into() } else { "m".into() }, [0.0; 3], [1.0; 3], true)
        .diffuse("m", albedo, 0.0)
        .diffuse("lit", albedo, 1.0);
    solved(&text, 65_536, Some(10.0), &[("z1", 0.5 * (s + d)), ("z0", 0.5 * (s - d)), ("x0", w), ("y1", w)])
}

/// Half the width of the door between two halls.
const DOOR: f64 = 0.05;

/// Two halls joined by a door of a hundredth of a wall; light in one.
fn two_halls(albedo: f64) -> SceneText {
    let h = DOOR;
    let mut text = SceneText::new();
    for (name, x) in [("a-", 0.0), ("b-", 1.0)] {
        for (side, p) in box_sides([x, 0.0, 0.0], [1.0; 3], true) {
            let door = (name == "a-" && side == "x1") || (name == "b-" && side == "x0");
            if !door {
                let m = if name == "a-" && side == "z1" { "lit" } else { "m" };
                text = text.polygon(&format!("{name}{side}"), m, &p);
            }
        }
    }
    let frame = |y: [f64; 2], z: [f64; 2]| -> Vec<Point> {
        vec![[1.0, y[0], z[0]], [1.0, y[1], z[0]], [1.0, y[1], z[1]], [1.0, y[0], z[1]]]
    };
    let (a, b) = (0.5 - h, 0.5 + h);
    for (y, z) in [([0.0, 1.0], [0.0, a]), ([0.0, 1.0], [b, 1.0]), ([0.0, a], [a, b]), ([b, 1.0], [a, b])] {
        text = text.polygon("wall", "m", &frame(y, z));
    }
    text.diffuse("m", albedo, 0.0).diffuse("lit", albedo, 1.0)
}

/// What the walls absorb is what the lamp emits.
fn halls() -> Result<Outcome> {
    let albedo = 0.999;
    let s = solve(&two_halls(albedo).load()?, 2048, Some(0.25), 1)?.solution;
    let absorbed: f64 =
        (0..s.mesh.len()).map(|e| s.mesh.area(e as u32) * s.irradiance[e].x * (1.0 - albedo)).sum();
    Ok(Outcome::Number {
        error: (absorbed / s.ledger.emitted.x - 1.0).abs(),
        standard_error: s.ledger.residual_error.x,
    })
}

/// Two halls so white that each is uniform: the balance of power of two unknowns. Light reaches the dark one through
/// some hundred rays a wall, and both are within a percent of each other all the same.
fn white_halls() -> Result<Outcome> {
    let albedo = 1.0 - 1e-5;
    let door = 4.0 * DOOR * DOOR;
    let loss = (1.0 - albedo) * (6.0 - door);
    // loss a + door rho (a - b) = 1 W, loss b = door rho (a - b).
    let share = door * albedo / (loss + door * albedo);
    let a = 1.0 / (loss + door * albedo * (1.0 - share));
    solved(
        &two_halls(albedo),
        1024,
        Some(0.25),
        &[("a-z0", a), ("a-y1", a), ("b-z1", share * a), ("b-x1", share * a), ("b-y0", share * a)],
    )
}

fn white() -> Result<Outcome> {
    let text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true).diffuse("m", 1.0, 1.0);
    said(solve(&text.load()?, 100, Some(0.25), 1).map(|_| ()), &[], &["no steady state exists"])
}

fn black() -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let lamp = plate([0.0, 1.0], [0.0, 1.0], 1.0, false);
    let exact = 0.3 * factor(&floor, &lamp);
    let text = SceneText::new()
        .cuboid(
            "",
            |s| match s {
                "z0" => "grey".into(),
                "z1" => "lamp".into(),
                _ => "black".into(),
            },
            [0.0; 3],
            [1.0; 3],
            true,
        )
        .diffuse("grey", 0.3, 0.0)
        .diffuse("lamp", 0.0, 1.0)
        .diffuse("black", 0.0, 0.0);
    solved(&text, 1024, Some(0.25), &[("z0", exact)])
}

fn dark() -> Result<Outcome> {
    let text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true).diffuse("m", 0.5, 0.0);
    said(solve(&text.load()?, 100, Some(0.25), 1).map(|_| ()), &[], &["no light"])
}

/// Closed furnaces side by side, their emission 24 orders of magnitude apart.
fn emissions() -> Result<Outcome> {
    let mut text = SceneText::new();
    let powers = [1e-12, 1.0, 1e12];
    for (k, e) in powers.iter().enumerate() {
        let m = format!("m{k}");
        text = text
            .cuboid(&format!("{k}-"), |_| m.clone(), [2.0 * k as f64, 0.0, 0.0], [1.0; 3], true)
            .diffuse(&m, 0.5, *e);
    }
    let scene = text.load()?;
    let result = solve(&scene, 1024, Some(0.25), 1)?;
    let names: Vec<(String, f64)> = powers
        .iter()
        .enumerate()
        .flat_map(|(k, e)| ["x0", "z1"].map(|s| (format!("{k}-{s}"), 2.0 * e)))
        .collect();
    let answers: Vec<(&str, f64)> = names.iter().map(|(n, e)| (n.as_str(), *e)).collect();
    compare(&result, &answers)
}

/// Four furnace walls between two facing perfect mirrors.
fn mirrors() -> Result<Outcome> {
    let text = SceneText::new()
        .cuboid(
            "",
            |s| if s.starts_with('z') { "mirror".into() } else { "m".into() },
            [0.0; 3],
            [1.0; 3],
            true,
        )
        .diffuse("m", 0.7, 1.0)
        .material("mirror", "diffuse = 0.0\nspecular = 1.0\nroughness = 0.0");
    let b = 1.0 / (1.0 - 0.7);
    solved(&text, 1024, Some(0.25), &[("x0", b), ("x1", b), ("y0", b), ("y1", b)])
}

/// A furnace that holds a body of the given material, or whose ends are made of it: every camera sees E / (1 - rho) / pi.
fn glass_room(body: &str, ends: bool, eye: Point) -> Result<Outcome> {
    let target = if ends { [0.5, 1.0, 0.5] } else { [0.51, 0.9, 0.47] };
    let mut text = SceneText::new()
        .head(&view(eye, target, 40.0))
        .cuboid(
            "",
            |s| if ends && s.starts_with('y') { "body".into() } else { "m".into() },
            [0.0; 3],
            [1.0; 3],
            true,
        )
        .diffuse("m", 0.5, 1.0)
        .material("body", body);
    if !ends {
        text = text.cuboid("body-", |_| "body".into(), [0.31, 0.33, 0.32], [0.4, 0.3, 0.37], false);
    }
    seen(&text)
}

/// The surface of glass from inside, all pixels within 1e-7 of the critical angle, over walls that emit n^2 times as much as
/// those outside: what is seen is the same everywhere. Not a block: there, light that a face throws back may be caught for good.
fn critical() -> Result<Outcome> {
    let sin: f64 = 1.0 / 1.5;
    let target = [0.1 + sin, 0.5, 0.1 + (1.0 - sin * sin).sqrt()];
    let mut text = SceneText::new()
        .head(&view([0.1, 0.5, 0.1], target, 1e-5))
        .diffuse("outside", 0.5, 1.0)
        .diffuse("inside", 0.5, 2.25)
        .material("glass", GLASS)
        .polygon("surface", "glass", &plate([0.0, 1.0], [0.0, 1.0], 0.6, true));
    for (material, z, height, open) in [("inside", 0.0, 0.6, "z1"), ("outside", 0.6, 0.4, "z0")] {
        for (side, p) in box_sides([0.0, 0.0, z], [1.0, 1.0, height], true) {
            if side != open {
                text = text.polygon(side, material, &p);
            }
        }
    }
    seen(&text)
}

fn view(eye: Point, target: Point, fov: f64) -> String {
    format!("[camera]\norigin = {eye:?}\ntarget = {target:?}\nup = [0, 0, 1]\nfov = {fov:?}\nsize = [16, 16]")
}

/// An image of a furnace with E = 1 and rho = 0.5 against its radiance.
fn seen(text: &SceneText) -> Result<Outcome> {
    let image = picture(&text.load()?, Method::TwoPass(Quality::Mesh), 16, (1024, Some(0.25)), 1)?;
    Ok(match departure(&image, 2.0 / PI) {
        // Single pixels carry the noise of Russian roulette and of pass 1: the mean must hold to 1 %, pixels to 10 %.
        Outcome::Number { error, .. } => Outcome::Number {
            error: (mean(&image) / (2.0 / PI) - 1.0).abs().max(0.1 * error),
            standard_error: 0.0,
        },
        said => said,
    })
}

fn glass(ior: f64) -> Result<Outcome> {
    let body = format!("diffuse = 0.0\nspecular = 0.0\nspecular_transmission = 1.0\nior = {ior:?}");
    glass_room(&body, false, [0.5, 0.02, 0.5])
}

/// A black lamp 2 cm under a nearly white ceiling, on elements four times as wide: what the lamp keeps from the room is much of the
/// light after a thousand bounces. True error: some 7 %.
fn gap() -> Result<Outcome> {
    let scene = SceneText::new()
        .diffuse("white", 0.999, 0.0)
        .diffuse("lamp", 0.0, 1.0)
        .cuboid("", |_| "white".into(), [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &plate([0.35, 0.65], [0.35, 0.65], 0.98, false))
        .load()?;
    let result = solve(&scene, 1024, Some(0.08), 1)?;
    said(Ok(()), &result.warnings, &["elements are too large", "\"z1\""])
}

/// A rough floor under a lamp: both passes against the path tracer.
fn rough() -> Result<Outcome> {
    let text = SceneText::new()
        .head("[camera]\norigin = [0.5, 0.05, 0.5]\ntarget = [0.5, 1, 0.2]\nup = [0, 0, 1]\nfov = 60\nsize = [8, 8]")
        .cuboid("", |s| if s == "z0" { "rough".into() } else { "m".into() }, [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &plate([0.2, 0.8], [0.2, 0.8], 0.95, false))
        .diffuse("m", 0.5, 0.0)
        .diffuse("lamp", 0.0, 5.0)
        .material("rough", "diffuse = 0.2\nspecular = 0.5\nroughness = 1.0");
    against_path(&text, 64, 4096)
}

/// A box on the floor whose inside no light reaches: it covers elements of the floor altogether.
fn open_box() -> Result<Outcome> {
    let sides = box_sides([0.3, 0.25, 0.0], [0.4, 0.35, 0.5], false);
    balanced(sides.iter().filter(|s| s.0 != "z0").fold(SceneText::new(), |t, s| t.polygon(s.0, "m", &s.1)))
}

/// A translucent ball that a wall cuts: its elements are covered in part, on either side in another.
fn translucent() -> Result<Outcome> {
    let text = SceneText::new().polygons("ball", "sheet", &ball(0.2, [0.1, 0.5, 0.45]));
    balanced(text.material("sheet", "diffuse = 0.475\ndiffuse_transmission = 0.475"))
}

/// A translucent box that stands on the floor, its bottom in the floor's plane. It absorbs nothing, as does the floor, and the
/// walls glow: light fills the room and the box evenly.
fn lantern() -> Result<Outcome> {
    let material = |side: &str| if side == "z0" { "floor".into() } else { "m".into() };
    let text = SceneText::new()
        .cuboid("", material, [0.0; 3], [1.0; 3], true)
        .cuboid("box-", |_| "sheet".into(), [0.31, 0.27, 0.0], [0.4, 0.35, 0.5], false)
        .diffuse("m", 0.7, 1.0)
        .diffuse("floor", 1.0, 0.0)
        .material("sheet", "diffuse = 0.4\ndiffuse_transmission = 0.6");
    let everywhere = ["x0", "z0", "z1", "box-x0", "box-y1", "box-z1"].map(|n| (n, 1.0 / (1.0 - 0.7)));
    solved(&text, 1024, Some(0.1), &everywhere)
}

/// A block of glass that lies on the floor and on two walls: parts of these see each other inside of it.
fn cornered() -> Result<Outcome> {
    let text = SceneText::new().cuboid("block-", |_| "glass".into(), [0.0; 3], [0.3, 0.35, 0.4], false);
    balanced(text.material("glass", GLASS))
}

/// A bright room around something, with a lamp: what is emitted must be absorbed.
fn balanced(text: SceneText) -> Result<Outcome> {
    let text = text
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &plate([0.35, 0.65], [0.35, 0.65], 0.97, false))
        .diffuse("m", 0.98, 0.0)
        .diffuse("lamp", 0.0, 20.0);
    let ledger = solve(&text.load()?, 1024, Some(0.1), 1)?.solution.ledger;
    Ok(Outcome::Number { error: ledger.residual.x.abs(), standard_error: ledger.residual_error.x })
}

/// A ball about `centre`.
fn ball(radius: f64, centre: Point) -> Vec<Vec<Point>> {
    let moved = |p: &Point| [0, 1, 2].map(|k| p[k] + centre[k]);
    sphere(radius, 8, false).iter().map(|t| t.iter().map(moved).collect()).collect()
}

/// Curved bodies that gather and spread a lamp's light, seen from a wall.
fn balls() -> Result<Outcome> {
    let text = SceneText::new()
        .head("[camera]\norigin = [0.5, 0.03, 0.5]\ntarget = [0.5, 1, 0.42]\nup = [0, 0, 1]\nfov = 70\nsize = [16, 16]")
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &plate([0.2, 0.8], [0.2, 0.8], 0.97, false))
        .polygons("mirror ball", "mirror", &ball(0.2, [0.28, 0.55, 0.3]))
        .polygons("glass ball", "glass", &ball(0.2, [0.72, 0.5, 0.3]))
        .diffuse("m", 0.5, 0.0)
        .diffuse("lamp", 0.0, 20.0);
    against_path(&text.material("mirror", MIRROR).material("glass", GLASS), 16, 512)
}

/// Means of an image by both passes and by the path tracer in eight independent parts, whose spread is the standard error.
fn against_path(text: &SceneText, spp: u32, path_spp: u32) -> Result<Outcome> {
    let scene = text.load()?;
    let means = |method: Method, spp: u32, parts: u32| -> Result<(f64, f64)> {
        let runs: Vec<f64> = (0..parts)
            .map(|seed| Ok(mean(&picture(&scene, method, (spp / parts).max(1), (1024, Some(0.1)), seed)?)))
            .collect::<Result<_>>()?;
        let m = runs.iter().sum::<f64>() / f64::from(parts);
        let spread: f64 = runs.iter().map(|r| (r - m) * (r - m)).sum();
        Ok((m, (spread / f64::from(parts * (parts - 1))).sqrt()))
    };
    let (reference, a) = means(Method::Path, path_spp, 8)?;
    let (two_pass, b) = means(Method::TwoPass(Quality::Gather), spp, 4)?;
    if reference == 0.0 {
        return Err(Error::scene("path tracer", "found no light"));
    }
    Ok(Outcome::Number { error: (two_pass / reference - 1.0).abs(), standard_error: a.hypot(b) / reference })
}

/// A lamp that stands upright beside a floor and shines along it.
fn grazing() -> Result<Outcome> {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    // A thousandth high, at the floor's edge.
    let lamp = vec![[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1e-3], [0.0, 0.0, 1e-3]];
    let exact = 0.5 * factor(&floor, &lamp);
    let text = SceneText::new()
        .polygon("floor", "grey", &floor)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 4096, Some(0.1), &[("floor", exact)])
}

/// A black chamber with a bright end wall and a small hole; what falls through onto a screen beyond.
fn keyhole() -> Result<Outcome> {
    let h = 0.02;
    let (a, b) = (0.5 - h, 0.5 + h);
    let mut text = SceneText::new();
    for (side, p) in box_sides([0.0; 3], [1.0; 3], true) {
        match side {
            "z1" => {}
            "z0" => text = text.polygon("lamp", "lamp", &p),
            _ => text = text.polygon(side, "black", &p),
        }
    }
    for (x, y) in [([0.0, 1.0], [0.0, a]), ([0.0, 1.0], [b, 1.0]), ([0.0, a], [a, b]), ([b, 1.0], [a, b])] {
        text = text.polygon("lid", "black", &plate(x, y, 1.0, false));
    }
    // The screen faces the hole; each of its points sees a patch of the lamp through it, wholly bright.
    let screen = plate([0.4, 0.6], [0.4, 0.6], 1.5, false);
    let exact = 0.5 * factor(&screen, &plate([a, b], [a, b], 1.0, true));
    let text = text
        .polygon("screen", "grey", &screen)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("black", 0.0, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    solved(&text, 65_536, Some(0.05), &[("screen", exact)])
}

/// What the light of a lamp must pass.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// A slab of glass that closes the lamp's black box.
    Glass,
    /// A flat mirror above the lamp, which shines upwards over a black tray.
    Mirror,
    /// A hollow mirror in that place, of more facets than have mirror images.
    Bowl,
}

/// A room without a straight line between lamp and walls.
fn only_by(way: Way) -> Result<Outcome> {
    let mut text = SceneText::new()
        .head("[camera]\norigin = [0.5, 0.05, 0.5]\ntarget = [0.5, 1, 0.3]\nup = [0, 0, 1]\nfov = 60\nsize = [8, 8]")
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .diffuse("m", 0.5, 0.0)
        .diffuse("black", 0.0, 0.0)
        .diffuse("lamp", 0.0, 50.0)
        .material("special", if way == Way::Glass { GLASS } else { MIRROR });
    if way == Way::Glass {
        text = text.polygon("lamp", "lamp", &plate([0.4, 0.6], [0.4, 0.6], 0.9, false)).cuboid(
            "slab-",
            |_| "special".into(),
            [0.25, 0.25, 0.6],
            [0.5, 0.5, 0.1],
            false,
        );
        for (side, p) in box_sides([0.3, 0.3, 0.7], [0.4, 0.4, 0.25], true) {
            if side != "z0" {
                text = text.polygon("case", "black", &p);
            }
        }
    } else {
        text = text.polygon("lamp", "lamp", &plate([0.4, 0.6], [0.4, 0.6], 0.6, true)).polygon(
            "tray",
            "black",
            &plate([0.3, 0.7], [0.3, 0.7], 0.59, true),
        );
        text = match way {
            Way::Bowl => text.polygons("bowl", "special", &bowl(6)),
            _ => text.polygon("mirror", "special", &plate([0.1, 0.9], [0.1, 0.9], 0.9, false)),
        };
    }
    against_path(&text, 64, if way == Way::Glass { 16_384 } else { 8192 })
}

/// Triangles of a hollow over the room's middle, open downwards: a paraboloid on a grid of `n` x `n`.
fn bowl(n: usize) -> Vec<Vec<Point>> {
    let at = |i: usize, j: usize| -> Point {
        let [x, y] = [i, j].map(|k| 0.1 + 0.8 * k as f64 / n as f64);
        [x, y, 0.95 - 0.6 * ((x - 0.5).powi(2) + (y - 0.5).powi(2))]
    };
    let cell = |k: usize| {
        let (i, j) = (k / n, k % n);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [vec![a, c, b], vec![a, d, c]]
    };
    (0..n * n).flat_map(cell).collect()
}
