//! What the methods are compared on, and with which answer.

use super::Method;
use crate::Result;
use crate::bench::{Context, Files, embedded};
use crate::hard_cases::build::{Point, box_sides, sphere, turned};
use crate::mesh::{Mesh, Sides};
use crate::scene::Scene;

/// Where the right factors come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Answer {
    /// Closed forms: nothing lies between.
    Exact,
    /// Pair by pair, from so many points a pair in each of its randomisations.
    Pairs { points: u32 },
    /// Some of the rows by this many hemisphere rays each.
    Rows { rays: u32 },
}

/// Rows that stand for all of a large matrix.
pub(super) struct Sample {
    /// Whether a row is among them.
    pub asked: Vec<bool>,
    /// Those whose answer is known.
    pub answered: Vec<usize>,
}

impl Sample {
    /// Rows spread evenly over `n`, every `every`-th of which has an answer.
    fn new(n: usize, rows: usize, every: usize) -> Sample {
        let (mut asked, mut answered) = (vec![false; n], Vec::new());
        for k in 0..rows {
            let row = (k * n + n / 2) / rows;
            asked[row] = true;
            if k % every == every / 2 {
                answered.push(row);
            }
        }
        Sample { asked, answered }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.asked.iter().filter(|a| **a).count()
    }
}

/// A scene cut into elements.
pub(super) struct Configuration {
    pub name: &'static str,
    pub title: &'static str,
    pub about: &'static str,
    pub scene: Scene,
    pub mesh: Mesh,
    pub answer: Answer,
    /// Nothing escapes: rows sum to 1.
    pub closed: bool,
    /// A setting beyond this time [s] is not tried.
    pub longest: f64,
    /// The rows that are found where all of them take too long; times are those of all rows, in proportion.
    pub sample: Option<Sample>,
}

impl Configuration {
    /// The methods that are compared here.
    pub fn methods(&self) -> Vec<Method> {
        let mut methods = vec![Method::Random, Method::Sobol, Method::Reciprocity];
        methods.extend_from_slice(match self.answer {
            Answer::Exact => &[Method::Automatic, Method::Pairs, Method::Exact],
            Answer::Pairs { .. } => &[Method::Automatic, Method::Pairs],
            Answer::Rows { .. } => &[],
        });
        methods.extend([Method::Centre, Method::Grid(8), Method::Grid(32), Method::Turned(8)]);
        methods
    }
}

/// All configurations, the simple ones first.
pub(super) fn configurations(context: &Context) -> Result<Vec<Configuration>> {
    let longest = context.choose(0.01, 0.25);
    let make = |name, title, about, scene: Scene, size: f64, answer, closed| -> Result<Configuration> {
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), size, true)?;
        Ok(Configuration { name, title, about, scene, mesh, answer, closed, longest, sample: None })
    };
    let pairs = Answer::Pairs { points: context.choose(8, 64) };
    let mut all = vec![
        make(
            "parallel",
            "Unit squares, parallel",
            "Two unit squares that face each other at distance 1, 4 x 4 elements each.",
            parallel(1.0)?,
            0.25,
            Answer::Exact,
            false,
        )?,
        make(
            "right-angle",
            "Unit squares at right angles",
            "Two unit squares that share an edge, 4 x 4 elements each. Along the edge elements touch, and the kernel has no bound.",
            right_angle(&[0.25, 0.5, 0.75, 1.0])?,
            0.25,
            Answer::Exact,
            false,
        )?,
        make(
            "near-contact",
            "Unit squares, nearly in contact",
            "Two unit squares that face each other at distance 0.01, 4 x 4 elements each: an element sees little but the one it faces.",
            parallel(0.01)?,
            0.25,
            Answer::Exact,
            false,
        )?,
        make(
            "slivers",
            "Slivers",
            "Two unit squares that share an edge, cut into strips parallel to it that get half as wide towards the edge each time, one \
             element each, down to a width of 1/1024.",
            right_angle(&graded())?,
            10.0,
            Answer::Exact,
            false,
        )?,
        make(
            "spheres",
            "Concentric spheres",
            "A sphere of radius 0.5 within one of radius 1, 128 flat facets each: the inner one hides part of the outer one from every \
             facet.",
            spheres()?,
            10.0,
            pairs,
            true,
        )?,
        make(
            "occluded-room",
            "Occluded room",
            "A closed room with a screen across most of it and a table: half of the pairs of elements are hidden from each other, in part \
             or wholly.",
            occluded_room()?,
            0.45,
            pairs,
            true,
        )?,
        make(
            "cornell",
            "Cornell box",
            "The Cornell box of the repository, open at its front.",
            embedded("cornell")?,
            context.choose(0.14, 0.0704),
            pairs,
            false,
        )?,
        make(
            "many",
            "Many elements",
            "The room of scenes/music_lesson as more than 20,000 elements (fewer in a quick run). Rows have far more entries than most methods take samples, so \
             single factors are noise until there are many rays or pixels; sums of them are not.",
            embedded("music_lesson")?,
            context.choose(0.25, 0.1075),
            Answer::Rows { rays: context.choose(1 << 18, 1 << 22) },
            false,
        )?,
    ];
    if let Some(many) = all.last_mut() {
        many.longest = context.choose(0.5, 16.0);
        many.sample = Some(Sample::new(many.mesh.len(), context.choose(64, 512), context.choose(8, 32)));
    }
    Ok(all)
}

/// Adds a grey polygon, turned out of the axes: where elements lie along the axes of hemi-cubes, pixels fit them or miss
/// them all alike, which tells nothing of other scenes.
fn add(files: &mut Files, object: &str, points: &[Point]) {
    let axis = [1.0, 2.0, 3.0].map(|x: f64| x / 14f64.sqrt());
    let turn = turned(axis, 0.7);
    let points: Vec<Point> = points.iter().map(|p| turn(*p)).collect();
    files.polygon(object, "grey", &points);
}

fn grey() -> Files {
    let mut files = Files::default();
    files.diffuse("grey", 0.5, 0.0);
    files
}

/// Unit squares at z = 0 and above it that face each other.
fn parallel(distance: f64) -> Result<Scene> {
    let mut files = grey();
    let floor = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let mut roof = floor.map(|[x, y, _]| [x, y, distance]);
    roof.reverse();
    add(&mut files, "floor", &floor);
    add(&mut files, "roof", &roof);
    files.load()
}

/// Unit squares z = 0 and x = 0 that share the y axis, each cut at these distances from it.
fn right_angle(cuts: &[f64]) -> Result<Scene> {
    let mut files = grey();
    let mut near = 0.0;
    for &far in cuts {
        let floor = [[near, 0.0, 0.0], [far, 0.0, 0.0], [far, 1.0, 0.0], [near, 1.0, 0.0]];
        let wall = [[0.0, 0.0, near], [0.0, 1.0, near], [0.0, 1.0, far], [0.0, 0.0, far]];
        add(&mut files, "floor", &floor);
        add(&mut files, "wall", &wall);
        near = far;
    }
    files.load()
}

/// 1/1024, 1/512, ... 1.
fn graded() -> Vec<f64> {
    (0..=10).rev().map(|k| 0.5f64.powi(k)).collect()
}

fn spheres() -> Result<Scene> {
    let mut files = grey();
    for (name, radius, inside) in [("inner", 0.5, false), ("outer", 1.0, true)] {
        for facet in sphere(radius, 4, inside) {
            add(&mut files, name, &facet);
        }
    }
    files.load()
}

fn occluded_room() -> Result<Scene> {
    let mut files = grey();
    for (name, origin, size, inside) in [
        ("room", [0.0, 0.0, 0.0], [4.0, 3.0, 2.5], true),
        // Clear of the walls: no element is covered in part.
        ("screen", [1.9, 0.05, 0.05], [0.1, 2.2, 2.2], false),
        ("table", [2.6, 0.7, 0.7], [0.9, 1.4, 0.05], false),
    ] {
        for (side, points) in box_sides(origin, size, inside) {
            add(&mut files, &format!("{name}-{side}"), &points);
        }
    }
    files.load()
}

/// The configuration of that name, for tests.
#[cfg(test)]
pub(super) fn named(context: &Context, name: &str) -> Result<Configuration> {
    let all = configurations(context)?;
    all.into_iter().find(|c| c.name == name).ok_or_else(|| crate::Error::scene(name, "no such configuration"))
}
