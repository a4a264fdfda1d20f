//! Extremes of work: the least and the most of each.

use super::build::{SceneText, plate};
use super::exact::factor;
use super::{Case, Outcome, Pace, compare, departure, picture, said, solve, solved};
use crate::Result;
use crate::render::{Method, Quality};
use std::f64::consts::PI;

const fn case(
    name: &'static str,
    breaks: &'static str,
    answer: &'static str,
    run: fn() -> Result<Outcome>,
) -> Case {
    Case { group: "work", name, breaks, answer, limit: 0.01, pace: Pace::Fast, run }
}

/// The work of the suite.
pub(super) const CASES: &[Case] = &[
    case("one element", "statistics of one", "quadrature", one_element),
    case("one ray", "no standard error", "named warning", one_ray),
    case("a million rays on one element", "a sequence's end", "quadrature", million_rays),
    case("one pixel", "tiles", "furnace", || image([1, 1])),
    case("1 x 16384 pixels", "tiles", "furnace", || image([1, 16_384])),
    case("16384 x 1 pixels", "tiles", "furnace", || image([16_384, 1])),
    case("more elements than rays", "empty rows", "furnace", few_rays),
];

fn plates() -> (SceneText, f64) {
    let floor = plate([0.0, 1.0], [0.0, 1.0], 0.0, true);
    let lamp = plate([0.0, 1.0], [0.0, 1.0], 0.7, false);
    let exact = 0.5 * factor(&floor, &lamp);
    let text = SceneText::new()
        .polygon("floor", "grey", &floor)
        .polygon("lamp", "lamp", &lamp)
        .diffuse("grey", 0.5, 0.0)
        .diffuse("lamp", 0.0, 1.0);
    (text, exact)
}

fn one_element() -> Result<Outcome> {
    // A plate under an open sky: nothing but itself.
    let text = SceneText::new()
        .head("[environment]\nradiance = [1.0, 1.0, 1.0]")
        .polygon("floor", "grey", &plate([0.0, 1.0], [0.0, 1.0], 0.0, true))
        .diffuse("grey", 0.5, 0.0);
    solved(&text, 1024, Some(10.0), &[("floor", 0.5 * PI)])
}

fn one_ray() -> Result<Outcome> {
    let result = solve(&plates().0.load()?, 1, Some(0.5), 1)?;
    said(Ok(()), &result.warnings, &["1 ray", "no standard errors"])
}

fn million_rays() -> Result<Outcome> {
    let (text, exact) = plates();
    solved(&text, 1 << 20, Some(10.0), &[("floor", exact)])
}

fn room(head: &str) -> SceneText {
    SceneText::new().head(head).cuboid("", |_| "m".into(), [0.0; 3], [1.0; 3], true).diffuse("m", 0.5, 1.0)
}

fn image([width, height]: [u32; 2]) -> Result<Outcome> {
    let head = format!(
        "[camera]\norigin = [0.5, 0.1, 0.5]\ntarget = [0.5, 1, 0.5]\nup = [0, 0, 1]\nfov = 60\nsize = [{width}, {height}]"
    );
    let scene = room(&head).load()?;
    Ok(departure(&picture(&scene, Method::TwoPass(Quality::Mesh), 1, (4096, Some(0.5)), 1)?, 2.0 / PI))
}

/// Six hundred elements with eight rays each: most factors of a row are missing, and the sums still close.
fn few_rays() -> Result<Outcome> {
    let scene = room("").load()?;
    compare(&solve(&scene, 8, Some(0.1), 1)?, &[("", 2.0)])
}
