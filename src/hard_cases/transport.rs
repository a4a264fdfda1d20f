//! Albedos, light and openings that break solvers and samplers.

use super::build::{Point, SceneText, ball, box_sides, plate};
use super::exact::factor;
use super::{Case, Outcome, Pace, compare, said, solve, solved};
use crate::Result;

pub(super) const fn case(
    name: &'static str,
    breaks: &'static str,
    answer: &'static str,
    run: fn() -> Result<Outcome>,
) -> Case {
    Case { group: "transport", name, breaks, answer, limit: 0.01, pace: Pace::Fast, run }
}

/// A case that takes seconds.
pub(super) const fn seconds(
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
    case("lamp at grazing incidence", "cosines near zero", "quadrature", grazing),
    seconds("light through a keyhole", "rays miss the hole", "quadrature", keyhole),
    case(
        "box without a bottom, albedo 0.98",
        "covered elements that keep light for ever",
        "balance of power",
        open_box,
    ),
    case("lamp close under a white ceiling", "elements wider than the gap", "a warning", gap),
    case("translucent ball through a wall", "light from nothing", "balance of power", translucent),
    case("translucent box on the floor", "light lost in the contact", "furnace", lantern),
];

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

/// A bright room around something, with a lamp: what is emitted must be absorbed.
pub(super) fn balanced(text: SceneText) -> Result<Outcome> {
    let text = text
        .cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true)
        .polygon("lamp", "lamp", &plate([0.35, 0.65], [0.35, 0.65], 0.97, false))
        .diffuse("m", 0.98, 0.0)
        .diffuse("lamp", 0.0, 20.0);
    let ledger = solve(&text.load()?, 1024, Some(0.1), 1)?.solution.ledger;
    Ok(Outcome::Number { error: ledger.residual.x.abs(), standard_error: ledger.residual_error.x })
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
