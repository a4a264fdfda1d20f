//! Pass 1 against exact cases, and the solver's time against its residual.

use super::{Context, Files, Measurements, rounds};
use crate::color::Rgb;
use crate::emitters::Emitters;
use crate::form_factor::{AtSpecular, Casting, cast};
use crate::mesh::{Mesh, Sides};
use crate::pipeline::{self, Pass1};
use crate::radiosity::{Solution, Transport, solve_irradiance};
use crate::report::record::{Chart, Figure, PARAMETER, Subject, Unit};
use crate::scene::Scene;
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::f64::consts::PI;
use std::time::Instant;

const ERROR: &str = "relative RMS error";
const TIME: &str = "pass 1";
const RAYS: &str = "rays an element";
const EDGE: &str = "elements along an edge";

pub fn run(context: &Context) -> Result<Measurements> {
    let (furnace, figure) = furnace(context)?;
    let subjects = vec![furnace, room(context)?, sphere(context)?, order(context)?, solver(context)?];
    Ok(Measurements { figures: vec![figure], subjects })
}

/// Pass 1 and its wall time \[s\].
fn solve(
    context: &Context,
    scene: &Scene,
    rays: u32,
    element_size: f64,
    seed: u32,
) -> Result<(Solution, f64)> {
    let start = Instant::now();
    let visibility = Visibility::new(context.device, scene)?;
    let settings = Pass1 { rays, element_size: Some(element_size), seed };
    let emitters = Emitters::new(&visibility);
    let solved = pipeline::solve(&visibility, &emitters, &[], &settings, &|_| (), &mut Vec::new())?;
    Ok((solved.solution, start.elapsed().as_secs_f64()))
}

/// Relative RMS over the elements, weighted by area, of radiosity against `exact` of an element's object.
fn rms(scene: &Scene, s: &Solution, exact: impl Fn(&str) -> f64) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for (e, b) in s.radiosity.iter().enumerate() {
        let face = s.mesh.place(e as u32).0;
        let wanted = exact(&scene.objects[scene.faces[face as usize].object as usize]);
        let a = s.mesh.area(e as u32);
        sum += a * (b.x / wanted - 1.0).powi(2);
        area += a;
    }
    (sum / area).sqrt()
}

fn cube(rho: [f64; 6], e: [f64; 6]) -> Result<Scene> {
    let mut files = Files::default();
    for (k, name) in ["x0", "x1", "y0", "y1", "z0", "z1"].iter().enumerate() {
        files.diffuse(name, rho[k], e[k]);
    }
    files.room().load()
}

fn furnace(context: &Context) -> Result<(Subject, Figure)> {
    let mut subject = Subject::new(
        "furnace",
        "Closed furnace: a cube that glows and reflects evenly",
        "Every wall emits 1 W m^-2 and reflects a share rho. Light then fills the cube evenly, and the radiosity is exactly \
         1 / (1 - rho) everywhere, whatever the mesh. Every ray ends on a wall, so rows of form factors sum to one exactly however \
         few rays they are made from: what is left is the solver's residual and rounding.",
    );
    let counts: &[u32] = context.choose(&[64, 256, 1024], &[64, 256, 1024, 4096, 16384]);
    let mut best = Vec::new();
    for rho in [0.5, 0.9, 0.99] {
        let scene = cube([rho; 6], [1.0; 6])?;
        for &rays in counts {
            rounds(context.settings.seed, context.choose(2, 5), |seed, counts_this| {
                (context.observer)(&format!("radiosity: furnace {rho}, {rays} rays, seed {seed}"));
                let (s, seconds) = solve(context, &scene, rays, 0.25, seed)?;
                if counts_this {
                    let error = rms(&scene, &s, |_| 1.0 / (1.0 - rho));
                    let point = subject.series(&format!("rho = {rho}"), RAYS).at(f64::from(rays));
                    point.push(ERROR, Unit::Share, error);
                    point.push("energy residual", Unit::Share, s.ledger.residual.abs().max_element());
                    point.push("multiplications", Unit::Count, s.convergence.iterations as f64);
                    point.push(TIME, Unit::Seconds, seconds);
                    if rho == 0.9 && rays == 1024 {
                        best.push(error);
                    }
                }
                Ok(())
            })?;
        }
    }
    let chart = Chart::new(
        "Error over rays",
        PARAMETER,
        ERROR,
        "Error of single elements: no number of rays matters here, as long as none gets lost. The next cases are those that rays \
         are noise in.",
    );
    subject.charts.push(chart);
    let label = "RMS error of an element in a furnace (rho = 0.9) with the default 1024 rays".into();
    Ok((subject, Figure { label, unit: Unit::Share, samples: best }))
}

/// The unit cube of which the ceiling emits 1 W m^-2, with six reflectances.
const RHO: [f64; 6] = [0.3, 0.6, 0.5, 0.5, 0.2, 0.8];
/// Mean radiosity of its faces [W m^-2] in the continuum, by extrapolation from exact element factors on uniform and graded
/// grids of up to 32 x 32 elements a face; known to 2e-6.
const CONTINUUM: [f64; 6] = [
    0.10250225523687,
    0.19750640114711,
    0.16627680343003,
    0.16627680343003,
    0.06559888866752,
    1.13683190194333,
];
/// The same with n x n constant elements a face and exact element factors.
const ELEMENTS: [(u32, [f64; 6]); 4] = [
    (
        2,
        [
            0.10271616494901,
            0.19659795349821,
            0.16588744772363,
            0.16588744772363,
            0.06643090662888,
            1.12706049662956,
        ],
    ),
    (
        4,
        [
            0.10261156261413,
            0.19728994838802,
            0.16620103137554,
            0.16620103137554,
            0.06580517509725,
            1.13369450067308,
        ],
    ),
    (
        8,
        [
            0.10254240681506,
            0.19745447011650,
            0.16626268600797,
            0.16626268600797,
            0.06565083108623,
            1.13587749730533,
        ],
    ),
    (
        16,
        [
            0.10251556287240,
            0.19749428355042,
            0.16627470519110,
            0.16627470519110,
            0.06561176523489,
            1.13655077176953,
        ],
    ),
];

fn room(context: &Context) -> Result<Subject> {
    let mut subject = Subject::new(
        "room",
        "Room of six walls: error over the size of the elements",
        "A unit cube whose ceiling glows and whose walls reflect 20 to 80 %. Mean radiosities of its walls are known to seven \
         digits, both for the true continuum and for constant elements with exact form factors. The distance from the first is what \
         the elements cannot show (discretisation) and what the rays add; the distance from the second is what the rays add alone, which \
         falls because finer elements cast more rays in all.",
    );
    let rays = context.choose(1024, 16384);
    let scene = cube(RHO, [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])?;
    let names = ["x0", "x1", "y0", "y1", "z0", "z1"];
    for (n, same) in ELEMENTS.iter().take(context.choose(3, 4)) {
        rounds(context.settings.seed, context.choose(2, 5), |seed, counts| {
            (context.observer)(&format!("radiosity: room, {n} x {n} elements a wall, seed {seed}"));
            let (s, seconds) = solve(context, &scene, rays, 1.0 / f64::from(*n), seed)?;
            if !counts {
                return Ok(());
            }
            let mean = names.map(|name| object_mean(&scene, &s, name));
            let off = |exact: &[f64; 6]| {
                let squares: f64 = (0..6).map(|k| (mean[k] / exact[k] - 1.0).powi(2)).sum();
                (squares / 6.0).sqrt()
            };
            for (series, exact) in
                [("against the continuum", &CONTINUUM), ("against exact factors of these elements", same)]
            {
                let point = subject.series(series, EDGE).at(f64::from(*n));
                point.push(ERROR, Unit::Share, off(exact));
                point.push(TIME, Unit::Seconds, seconds);
            }
            Ok(())
        })?;
    }
    let chart = Chart::new(
        "Error of the walls' mean radiosity",
        PARAMETER,
        ERROR,
        "Means over constant elements converge with the square of their width (slope -2) where light is smooth, and slower where \
         walls meet at edges, as in any room: with exact factors this room gives -1.85.",
    );
    subject.charts.push(chart.fitted(&subject.series).guide("squared width: -2", -2.0));
    subject.notes.push(format!("{rays} rays an element."));
    Ok(subject)
}

fn object_mean(scene: &Scene, s: &Solution, object: &str) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for (e, b) in s.radiosity.iter().enumerate() {
        let face = s.mesh.place(e as u32).0;
        if scene.objects[scene.faces[face as usize].object as usize] == object {
            let a = s.mesh.area(e as u32);
            sum += a * b.x;
            area += a;
        }
    }
    sum / area
}

fn sphere(context: &Context) -> Result<Subject> {
    let mut subject = Subject::new(
        "sphere",
        "Inside of a sphere, one half glowing",
        "In a sphere every point sees every other with the same form factor, so the radiosity is known exactly: 1.5 on the half that \
         emits 1 W m^-2, 0.5 on the other, both reflecting one half. The sphere is built of flat facets, one element each; their \
         distance from the true sphere, and with it the error, falls in proportion to their number. Single facets also hold the noise of \
         their own rays, which does not fall; in the means of the two halves it averages out.",
    );
    let rays = context.choose(1024, 16384);
    for n in context.choose(vec![2, 4, 8], vec![2, 4, 8, 16]) {
        let scene = facets(n)?;
        rounds(context.settings.seed, context.choose(2, 5), |seed, counts| {
            (context.observer)(&format!("radiosity: sphere of {} facets, seed {seed}", 8 * n * n));
            let (s, seconds) = solve(context, &scene, rays, 10.0, seed)?;
            if !counts {
                return Ok(());
            }
            let exact = |half: &str| if half == "glowing" { 1.5 } else { 0.5 };
            let off = |half| object_mean(&scene, &s, half) / exact(half) - 1.0;
            let halves = (0.5 * (off("glowing").powi(2) + off("dark").powi(2))).sqrt();
            for (name, error) in [("single facets", rms(&scene, &s, exact)), ("means of the halves", halves)]
            {
                let point = subject.series(name, "facets").at(s.mesh.len() as f64);
                point.push(ERROR, Unit::Share, error);
                point.push(TIME, Unit::Seconds, seconds);
            }
            Ok(())
        })?;
    }
    let chart = Chart::new(
        "Error over facets",
        PARAMETER,
        ERROR,
        "The theory of inscribed flat facets is a slope of -1.",
    );
    subject.charts.push(chart.fitted(&subject.series).guide("in proportion: -1", -1.0));
    subject.notes.push(format!("{rays} rays an element."));
    Ok(subject)
}

/// The unit sphere from within, as an octahedron divided `n` times along each edge; the half above z = 0 glows.
fn facets(n: usize) -> Result<Scene> {
    let mut files = Files::default();
    files.diffuse("glowing", 0.5, 1.0).diffuse("dark", 0.5, 0.0);
    for octant in 0..8 {
        let sign = [0, 1, 2].map(|k| if octant >> k & 1 == 1 { -1.0 } else { 1.0 });
        let name = if sign[2] > 0.0 { "glowing" } else { "dark" };
        let at = |i: usize, j: usize| {
            let p = [sign[0] * i as f64, sign[1] * j as f64, sign[2] * (n - i - j) as f64];
            let l = p.iter().map(|x| x * x).sum::<f64>().sqrt();
            p.map(|x| x / l)
        };
        let mut add = |mut t: [[f64; 3]; 3]| {
            if sign[0] * sign[1] * sign[2] > 0.0 {
                t.reverse();
            }
            files.polygon(name, name, &t);
        };
        for i in 0..n {
            for j in 0..n - i {
                add([at(i + 1, j), at(i, j + 1), at(i, j)]);
                if i + j + 1 < n {
                    add([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
    }
    files.load()
}

/// Form factor from a point of the plane z = 0 to the unit square [0, 1] x [0, 1] at z = 1, parallel to it (sum of four
/// rectangles with a corner above the point; Howell, catalogue B-4).
fn point_to_square(x: f64, y: f64) -> f64 {
    let corner = |a: f64, b: f64| {
        let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        (a / p * (b / p).atan() + b / q * (a / q).atan()) / (2.0 * PI)
    };
    corner(x, y) + corner(1.0 - x, y) + corner(x, 1.0 - y) + corner(1.0 - x, 1.0 - y)
}

fn order(context: &Context) -> Result<Subject> {
    let mut subject = Subject::new(
        "order",
        "Order of convergence of the mesh",
        "A square lamp hangs over a square floor; the floor's irradiance is known in closed form at every point. Read \
         directly, an element has one value for all its points (error in proportion to its width: slope -1). Interpolated between nodes, as \
         pictures are made, the error falls with the square of the width (slope -2) in the middle. At the border of a surface nodes \
         have neighbours on one side only; the error there is of first order on a strip one element wide, which makes the slope of the \
         whole -3/2. With few elements the border reaches into the middle too, whose line therefore falls faster at first.",
    );
    let mut files = Files::default();
    files.diffuse("floor", 0.5, 0.0).diffuse("lamp", 0.0, 1.0);
    files.polygon("floor", "floor", &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    files.polygon("lamp", "lamp", &[[0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]);
    let scene = files.load()?;
    let Some(floor) = scene.faces.iter().position(|f| scene.objects[f.object as usize] == "floor") else {
        return Err(Error::scene("floor", "is missing"));
    };
    let frame = scene.face_frame(&scene.faces[floor]);
    let floor = floor as u32;
    let rays = context.choose(4096, 65536);
    for n in context.choose(vec![2u32, 4, 8, 16], vec![2, 4, 8, 16, 32]) {
        rounds(context.settings.seed, 2, |seed, counts| {
            (context.observer)(&format!("radiosity: order, {n} x {n} elements, seed {seed}"));
            // A hair more than the edge: exactly n cells.
            let (s, seconds) = solve(context, &scene, rays, 1.0000001 / f64::from(n), seed)?;
            if !counts {
                return Ok(());
            }
            let (mut constant, mut between, mut inner, mut mean) = (0.0, 0.0, 0.0, 0.0);
            const POINTS: u32 = 96;
            for k in 0..POINTS * POINTS {
                let at = |k: u32| (f64::from(k) + 0.5) / f64::from(POINTS);
                let (u, v) = (at(k % POINTS), at(k / POINTS));
                let p = frame.at((u, v).into()) + scene.center;
                let exact = 0.5 * point_to_square(p.x, p.y);
                let (u, v) = (u as f32, v as f32);
                let e = s.mesh.element(floor, true, u, v);
                let node = s.reflected.at(&s.mesh, &s.nodes, (floor, true), u, v).unwrap_or(Rgb::ZERO);
                constant += (s.radiosity[e as usize].x - exact).powi(2);
                between += (node.x - exact).powi(2);
                if [u, v].iter().all(|x| (0.25..0.75).contains(x)) {
                    // A quarter of the points: four times the weight.
                    inner += 4.0 * (node.x - exact).powi(2);
                }
                mean += exact;
            }
            let points = f64::from(POINTS * POINTS);
            let relative = |squares: f64| (squares / points).sqrt() / (mean / points);
            for (name, error) in [
                ("one value an element", constant),
                ("interpolated", between),
                ("interpolated, inner quarter", inner),
            ] {
                let point = subject.series(name, EDGE).at(f64::from(n));
                point.push(ERROR, Unit::Share, relative(error));
                point.push(TIME, Unit::Seconds, seconds);
            }
            Ok(())
        })?;
    }
    let about = "Further down is better. The lines flatten where the noise of the rays is all that is left.";
    let chart = Chart::new("Error over elements along an edge", PARAMETER, ERROR, about);
    let chart = chart.fitted(&subject.series).guide("one value: -1", -1.0).guide("linear: -2", -2.0);
    let chart = chart.guide("linear with its border: -3/2", -1.5);
    subject.charts.push(chart);
    subject.notes.push(format!("{rays} rays an element."));
    Ok(subject)
}

fn solver(context: &Context) -> Result<Subject> {
    let size: f64 = context.choose(0.1, 0.04);
    let scene = cube([0.5; 6], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])?;
    let visibility = Visibility::new(context.device, &scene)?;
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), size, true)?;
    let casting = Casting {
        rays: 1024,
        batches: 4,
        seed: context.settings.seed,
        specular: AtSpecular::End,
        reached: None,
        emitters: None,
        progress: &|_| (),
    };
    let (matrix, _) = cast(&visibility, &mesh, &casting);
    let lit: Vec<Rgb> = (0..mesh.len() as u32)
        .map(|e| {
            let object = scene.faces[mesh.place(e).0 as usize].object as usize;
            if scene.objects[object] == "z1" { Rgb::ONE } else { Rgb::ZERO }
        })
        .collect();
    let incident = matrix.multiply(&lit);
    let mut transport = Transport::of(&scene, &mesh);
    let mut subject = Subject::new(
        "solver",
        format!("Solver: residual over time, {} elements, {} entries", mesh.len(), matrix.stored()),
        "The linear system of pass 1 for a closed cube, solved to more and more digits. The brighter the walls, the more often light \
         bounces and the more steps it takes. The residual is what the found solution leaves of the right-hand side, worst channel.",
    );
    for rho in [0.5, 0.9, 0.99, 0.999] {
        transport.reflectance.fill(Rgb::splat(rho));
        for digits in [2, 4, 6, 8, 10] {
            rounds(context.settings.seed, context.choose(3, 7), |_, counts| {
                let start = Instant::now();
                let (_, c) = solve_irradiance(&matrix, &transport, &incident, 10f64.powi(-digits))?;
                let seconds = start.elapsed().as_secs_f64();
                if counts {
                    let point =
                        subject.series(&format!("rho = {rho}"), "digits asked for").at(f64::from(digits));
                    point.push("solution", Unit::Seconds, seconds);
                    point.push("residual", Unit::Plain, c.residual);
                    point.push("multiplications", Unit::Count, c.iterations as f64);
                }
                Ok(())
            })?;
        }
    }
    subject.charts.push(Chart::new(
        "Residual over time",
        "solution",
        "residual",
        "Every step is one pass over the matrix, so time is proportional to steps. The program asks for 8 digits.",
    ));
    Ok(subject)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean over the square is the form factor of two unit squares a unit apart, 0.199825.
    #[test]
    fn the_closed_form_has_the_known_mean() {
        let n = 200;
        let at = |k: usize| (k as f64 + 0.5) / n as f64;
        let sum: f64 = (0..n * n).map(|k| point_to_square(at(k % n), at(k / n))).sum();
        assert!((sum / (n * n) as f64 - 0.199_824_895_698).abs() < 1e-6);
    }
}
