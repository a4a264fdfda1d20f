//! Mirrors, glass and gloss that break solvers and samplers.

use super::build::{Point, SceneText, ball, box_sides, plate};
use super::transport::{balanced, case, seconds};
use super::{Case, Outcome, departure, mean, picture, solved};
use crate::Result;
use crate::error::Error;
use crate::render::{Method, Quality};
use std::f64::consts::PI;

/// The mirrors and glass of the suite.
pub(super) const CASES: &[Case] = &[
    case("closed box with perfect mirrors", "chains without end", "furnace", mirrors),
    case("camera between perfect mirrors", "recursion's limit", "furnace", || {
        glass_room("diffuse = 0.0\nspecular = 1.0\nroughness = 0.0", true, ([0.5, 0.02, 0.5], 1.0))
    }),
    case("roughness 1e-4", "a lobe narrower than a float", "furnace", || {
        glass_room("diffuse = 0.0\nspecular = 1.0\nroughness = 1e-4", false, ([0.5, 0.02, 0.5], 1.0))
    }),
    seconds("roughness 1", "lobe and path disagree", "path tracer", rough),
    case("glass of ior 1.5", "total internal reflection", "furnace", || glass(1.5)),
    case("glass of ior 1", "division by zero", "furnace", || glass(1.0)),
    case("glass of ior 0.8", "reflection outside", "furnace", || glass(0.8)),
    case("glass of ior 3", "trapped light", "furnace", || glass(3.0)),
    case("at the critical angle", "square root of a negative number", "furnace", critical),
    case("camera inside glass", "trapped light", "furnace", || {
        glass_room(GLASS, false, ([0.5, 0.5, 0.5], 1.5))
    }),
    seconds("light only through glass", "no straight connection", "path tracer", || only_by(Way::Glass)),
    seconds("light only by a mirror", "no straight connection", "path tracer", || only_by(Way::Mirror)),
    seconds("light only by a caustic", "no straight connection", "path tracer", || only_by(Way::Bowl)),
    case("glass in a corner of the room", "walls that see each other in glass", "balance of power", cornered),
    seconds("balls of mirror and of glass", "caustics twice or never", "path tracer", balls),
    Case {
        limit: 0.005,
        ..case(
            "half-mirrors of three colours, albedo 0.9999",
            "noise of chains hides what is lost",
            "furnace",
            half_mirrors,
        )
    },
    case(
        "white floor among mirrors that shine, albedo 0.999",
        "what chains lose and what they bring",
        "furnace",
        white_floor,
    ),
];

const MIRROR: &str = "diffuse = 0.0\nspecular = 0.9\nroughness = 0.0";
const GLASS: &str = "diffuse = 0.0\nspecular = 0.0\nspecular_transmission = 1.0\nior = 1.5";

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
    solved(&text, 512, Some(0.25), &[("x0", b), ("x1", b), ("y0", b), ("y1", b)])
}

/// A furnace that holds a body of the given material, or whose ends are made of it: every camera sees E / (1 - rho) / pi, and n^2 times
/// that where it lies in glass of index n.
fn glass_room(body: &str, ends: bool, (eye, ior): (Point, f64)) -> Result<Outcome> {
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
    seen(&text, ior)
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
    seen(&text, 1.5)
}

fn view(eye: Point, target: Point, fov: f64) -> String {
    format!("[camera]\norigin = {eye:?}\ntarget = {target:?}\nup = [0, 0, 1]\nfov = {fov:?}\nsize = [16, 16]")
}

/// An image of a furnace with E = 1 and rho = 0.5 against its radiance, from within glass of index `ior`.
fn seen(text: &SceneText, ior: f64) -> Result<Outcome> {
    let radiance = 2.0 / PI * ior * ior;
    let image = picture(&text.load()?, Method::TwoPass(Quality::Mesh), 16, (1024, Some(0.25)), 1)?;
    Ok(match departure(&image, radiance) {
        // Single pixels carry the noise of Russian roulette and of pass 1: the mean must hold to 1 %, pixels to 10 %.
        Outcome::Number { error, .. } => Outcome::Number {
            error: (mean(&image) / radiance - 1.0).abs().max(0.1 * error),
            standard_error: 0.0,
        },
        said => said,
    })
}

fn glass(ior: f64) -> Result<Outcome> {
    let body = format!("diffuse = 0.0\nspecular = 0.0\nspecular_transmission = 1.0\nior = {ior:?}");
    glass_room(&body, false, ([0.5, 0.02, 0.5], 1.0))
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

/// A block of glass that lies on the floor and on two walls: parts of these see each other inside of it.
fn cornered() -> Result<Outcome> {
    let text = SceneText::new().cuboid("block-", |_| "glass".into(), [0.0; 3], [0.3, 0.35, 0.4], false);
    balanced(text.material("glass", GLASS))
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

/// A furnace whose walls reflect a share of each colour specularly: chains are long, and what one loses is less than what chance
/// takes from it.
fn half_mirrors() -> Result<Outcome> {
    let albedo = 0.9999;
    let specular = [0.5, 0.7, 0.2].map(|share| albedo * share);
    let diffuse = specular.map(|s| albedo - s);
    let entries =
        format!("diffuse = {diffuse:?}\nspecular = {specular:?}\nroughness = 0.0\nemission = {:?}", 1.0 / PI);
    let text = SceneText::new().cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true).material("m", &entries);
    solved(&text, 256, Some(0.1), &[("", (1.0 - specular[0]) / (1.0 - albedo))])
}

/// A furnace of a diffuse floor, the rest mirrors.
fn white_floor() -> Result<Outcome> {
    let albedo = 0.999;
    let mirror = format!("diffuse = 0.0\nspecular = {albedo:?}\nroughness = 0.0\nemission = {:?}", 1.0 / PI);
    let text = SceneText::new()
        .cuboid("", |s| if s == "z0" { "floor".into() } else { "mirror".into() }, [0.0; 3], [1.0; 3], true)
        .diffuse("floor", albedo, 1.0)
        .material("mirror", &mirror);
    solved(&text, 512, Some(0.1), &[("z0", 1.0 / (1.0 - albedo))])
}
