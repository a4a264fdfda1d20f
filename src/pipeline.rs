//! The stages in order, as a newcomer would tell them: build the tree, find what light can
//! reach, divide it into elements, cast form factors, sample the emitters, solve.

use crate::color::Rgb;
use crate::emitters::Emitters;
use crate::form_factor::{
    self, AtSpecular, Casting, EmitterRows, EmitterWork, ProjectionMap, Recast, RowSummary, Rows, pass_on,
};
use crate::memory::{Factors, Need, Plan};
use crate::mesh::{Mesh, NONE, Sides, default_element_size};
use crate::radiosity::{self, Directional, EmitterLight, Importance, Solution, System, View};
use crate::sampling::MAX_POINTS;
use crate::scene::{Camera, Features, Scene};
use crate::visibility::{Visibility, reachable_sides};
use crate::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;
use std::time::Instant;

/// Rays an element where nobody says otherwise.
pub const DEFAULT_RAYS: u32 = 1024;
/// Independent randomisations of each row, for standard errors.
pub const BATCHES: u32 = 4;
/// Share of an object's light lost in chains that were cut, from which on it is said.
const MOST_DROPPED: f64 = 1e-3;
/// Relative residual of the radiosity solve.
pub const TOLERANCE: f64 = 1e-8;

/// News from a running stage.
#[derive(Debug, Clone, Copy)]
pub enum Event {
    /// A stage begins with this much to do, in its own units.
    Begin(&'static str, u64),
    /// So much more is done.
    Advance(u64),
    /// The stage is at this item of so many.
    Item(u64, u64),
    /// The stage is over.
    End,
}

/// Who listens to the stages.
pub type Observer<'a> = &'a (dyn Fn(Event) + Sync);

/// Time and work of one stage.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Stage {
    /// `load`, `build`, `form-factors`, `solve`, `trace` or `write`.
    pub name: &'static str,
    /// Wall time \[s\]. Of many frames, `write` is what encoding and writing took beside `trace`, which it does not add to.
    pub seconds: f64,
    /// Rays cast.
    pub rays: u64,
}

/// Runs a stage, tells the observer, and records its time.
pub fn stage<T>(
    name: &'static str,
    total: u64,
    observer: Observer,
    stages: &mut Vec<Stage>,
    work: impl FnOnce() -> (T, u64),
) -> T {
    observer(Event::Begin(name, total));
    let start = Instant::now();
    let (result, rays) = work();
    stages.push(Stage { name, seconds: start.elapsed().as_secs_f64(), rays });
    observer(Event::End);
    result
}

/// Adds the times and rays of stages to those of the same name.
pub fn merge(stages: &mut Vec<Stage>, more: Vec<Stage>) {
    for s in more {
        match stages.iter_mut().find(|t| t.name == s.name) {
            Some(t) => (t.seconds, t.rays) = (t.seconds + s.seconds, t.rays + s.rays),
            None => stages.push(s),
        }
    }
}

/// Settings of pass 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pass1 {
    /// Rays an element.
    pub rays: u32,
    /// Largest element edge \[m\]; none: from the scene's extent.
    pub element_size: Option<f64>,
    /// Seed.
    pub seed: u32,
}

impl Pass1 {
    /// The scene file's defaults.
    pub fn of(scene: &Scene) -> Pass1 {
        Pass1 {
            rays: scene.radiosity.rays.unwrap_or(DEFAULT_RAYS),
            element_size: scene.radiosity.element_size,
            seed: 0,
        }
    }
}

/// Residuals that pass 1 reports.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Residuals {
    /// Largest departure of a row from closure.
    pub closure: f64,
    /// Departure from reciprocity between objects.
    pub reciprocity: f64,
    /// Share of elements' area that other surfaces cover.
    pub covered: f64,
    /// Largest share of a row's weight dropped in chains that were cut.
    pub dropped: f64,
}

/// What pass 1 leaves.
pub struct Pass1Result {
    /// The solution.
    pub solution: Solution,
    /// Residuals of the form factors.
    pub residuals: Residuals,
    /// What became of the form factors.
    pub factors: Factors,
    /// Entries of the matrix; 0 without one.
    pub stored: usize,
    /// Bytes of the matrix; 0 without one.
    pub matrix_bytes: usize,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// What the light of each element is worth, where asked for.
    pub importance: Option<Importance>,
}

/// Refuses a scene that nothing lights: every image of it would be black.
pub fn require_light(scene: &Scene, emitters: &Emitters) -> Result<()> {
    if !emitters.is_empty() || scene.environment != Rgb::ZERO {
        return Ok(());
    }
    let help = "the scene has no light: give a material `emission` (or `Ke` in the MTL) or set [environment] radiance";
    Err(Error::scene(scene.path.display().to_string(), help))
}

/// Pass 1: from a scene that is ready for rays to its radiosity, whatever memory that takes.
pub fn solve(
    visibility: &Visibility,
    emitters: &Emitters,
    cameras: &[Camera],
    settings: &Pass1,
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Pass1Result> {
    solve_within(None, visibility, emitters, cameras, settings, observer, stages)
}

/// [`solve`] in at most `limit` bytes, as far as can be told before: where the matrix does not fit, its rays are cast again for
/// each multiplication, with the same radiosity as far as it is solved and standard errors within a few per cent; but where surfaces
/// lose less than 3 % of the light, only a matrix is made reciprocal.
///
/// # Errors
/// As [`solve`], and where pass 1 does not fit without a matrix either.
pub fn solve_within(
    limit: Option<u64>,
    visibility: &Visibility,
    emitters: &Emitters,
    cameras: &[Camera],
    settings: &Pass1,
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Pass1Result> {
    require_light(visibility.scene(), emitters)?;
    let reached = building(stages, || reached(visibility, cameras, settings.seed, observer));
    solve_reached(limit, visibility, emitters, &reached, settings, observer, stages)
}

/// [`solve_within`] of sides that light or a camera can reach ([`reached`]), which several solutions may share.
///
/// # Errors
/// As [`solve_within`].
pub fn solve_reached(
    limit: Option<u64>,
    visibility: &Visibility,
    emitters: &Emitters,
    reached: &Sides,
    settings: &Pass1,
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Pass1Result> {
    require_light(visibility.scene(), emitters)?;
    let mesh = building(stages, || uniform_mesh(visibility.scene(), reached, settings, false))?;
    solve_mesh(limit, visibility, emitters, (reached, mesh, None), settings, observer, stages)
}

/// [`solve_within`] of given elements on sides that light or a camera can reach; the settings' element size does not matter. With
/// `views`, what each element's light is worth to them and to the scene.
pub(crate) fn solve_mesh(
    limit: Option<u64>,
    visibility: &Visibility,
    emitters: &Emitters,
    (reached, mesh, views): (&Sides, Mesh, Option<&[View]>),
    settings: &Pass1,
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Pass1Result> {
    let scene = visibility.scene();
    let specular = Features::of(scene).specular;
    // As many as the matrix will have: long rows need several sequences.
    let batches = BATCHES.max(settings.rays.div_ceil(MAX_POINTS)).min(settings.rays.max(1));
    let coloured = scene.materials.iter().any(|m| m.is_specular() && !m.has_grey_specular());
    let channels = if !specular {
        0
    } else if coloured {
        3
    } else {
        1
    };
    let samples = (settings.rays / 4).div_ceil(batches).max(16);
    // Particles cost no more than the rows' rays, where they can bring anything.
    let start = Instant::now();
    let most = if specular && !emitters.is_empty() { most_particles(mesh.len(), settings.rays) } else { 0.0 };
    let projection = (most > 0.0).then(|| {
        ProjectionMap::new(visibility, &mesh, emitters, (most / 16.0).min(524_288.0) as u32, settings.seed)
    });
    let projection = projection.flatten();
    let cells = projection.as_ref().map(|_| radiosity::caustic_cells(scene, &mesh)).transpose()?;
    let count = cells.as_ref().map_or(0, Mesh::len);
    let need = Need::new(&mesh, (settings.rays, batches), channels, count, rayon::current_num_threads());
    let all = Plan { factors: Factors::Kept, tiles: true };
    let Plan { factors, tiles } = limit.map_or(Ok(all), |limit| need.choose(limit))?;
    let particles = projection.as_ref().map_or(0, |projection| aimed_particles(most, projection) / batches);
    let looked = start.elapsed().as_secs_f64();
    let work = EmitterWork {
        samples: batches * samples,
        particles: batches * particles,
        projection: projection.as_ref(),
    };
    let casting = Casting {
        rays: settings.rays,
        batches,
        seed: settings.seed,
        specular: if specular { AtSpecular::GoOnByShare } else { AtSpecular::End },
        reached: Some(reached),
        emitters: (!emitters.is_empty()).then_some((emitters, work)),
        progress: &|n| observer(Event::Advance(n)),
    };
    // The light straight from the emitters beside what the hemisphere rays found of it.
    let straight = |rows: Rows, mut found: EmitterRows| {
        let per_row = rows.rays_per_row();
        let mut light = EmitterLight { rows: None, particles: None };
        if emitters.is_empty() {
            return (light, 0);
        }
        let mut rays = mesh.len() as u64 * u64::from(work.samples);
        let (seed, count) = (settings.seed, (batches, samples));
        radiosity::sample_emitters(visibility, &mesh, emitters, count, per_row, seed, &mut found);
        light.rows = Some(found);
        if let Some(cells) = cells.filter(|_| particles > 0 && !mesh.is_empty()) {
            let work = (batches, work);
            let caustic =
                radiosity::trace_particles(visibility, (&mesh, cells), emitters, work, per_row, seed);
            rays += caustic.rays;
            light.particles = Some(caustic);
        }
        (light, rays)
    };
    let total = mesh.len() as u64;
    let mut result = match factors {
        Factors::Kept => {
            let (matrix, light) = stage("form-factors", total, observer, stages, || {
                let (matrix, found) = form_factor::cast(visibility, &mesh, &casting);
                let (light, rays) = straight((&matrix).into(), found);
                let rays = rays + matrix.rays;
                ((matrix, light), rays)
            });
            let mut result = stage("solve", 0, observer, stages, || {
                (finish(visibility, mesh.clone(), ((&matrix).into(), tiles), emitters, light, views), 0)
            })?;
            (result.stored, result.matrix_bytes) = (matrix.stored(), matrix.bytes());
            result
        }
        Factors::CastAgain => {
            let (recast, light) = stage("form-factors", total, observer, stages, || {
                let (recast, found) = Recast::new(visibility, &mesh, &casting);
                let (light, rays) = straight(Rows::Cast(&recast), found);
                let rays = rays + recast.rays();
                ((recast, light), rays)
            });
            stage("solve", 0, observer, stages, || {
                let before = recast.rays();
                let result =
                    finish(visibility, mesh.clone(), (Rows::Cast(&recast), tiles), emitters, light, views);
                (result, recast.rays() - before)
            })?
        }
    };
    if let Some(cast) = stages.iter_mut().find(|s| s.name == "form-factors") {
        cast.seconds += looked;
        cast.rays += projection.as_ref().map_or(0, |projection| projection.rays);
    }
    result.factors = factors;
    Ok(result)
}

/// Directional radiosity of a scene that is ready for rays, with about `directions` cells a hemisphere: the method
/// that two-pass rendering is compared with ([`Directional`]).
pub fn solve_directional(
    visibility: &Visibility,
    emitters: &Emitters,
    cameras: &[Camera],
    (settings, directions): (&Pass1, u32),
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<Directional> {
    let scene = visibility.scene();
    require_light(scene, emitters)?;
    let reached = building(stages, || reached(visibility, cameras, settings.seed, observer));
    let mesh = building(stages, || uniform_mesh(scene, &reached, settings, true))?;
    stage("solve", 0, observer, stages, || {
        let samples = (settings.rays / 4).max(16);
        let straight = if emitters.is_empty() {
            vec![Rgb::ZERO; mesh.len()]
        } else {
            // The rays of the hemisphere's cells leave the light of emitters to these samples.
            let mut found = EmitterRows::dark(mesh.len(), 1);
            let (count, seed) = ((1, samples), settings.seed);
            radiosity::sample_emitters(visibility, &mesh, emitters, count, 0, seed, &mut found);
            found.mean.iter().map(|s| s.straight).collect()
        };
        let rays = mesh.len() as u64 * u64::from(samples);
        let solution =
            radiosity::solve_directional(visibility, mesh, emitters, &straight, directions, settings.seed);
        let rays = rays + solution.as_ref().map_or(0, |s| s.rays);
        (solution, rays)
    })
}

/// Most cameras that are asked what they see.
pub(crate) const MOST_VIEWS: usize = 64;

/// What cameras see of diffuse surfaces, at most [`MOST_VIEWS`] of them, by `across` x `across` rays each.
pub(crate) fn views<'a>(
    visibility: &Visibility,
    cameras: impl ExactSizeIterator<Item = &'a Camera>,
    across: u32,
) -> Vec<View> {
    let scene = visibility.scene();
    let view = |camera: &Camera| {
        let frame = camera.frame(scene);
        let at = |k: u32, n: u32| (f64::from(k) + 0.5) * f64::from(n) / f64::from(across);
        let ray = |k: u32| {
            let (origin, direction) =
                frame.ray(at(k % across, camera.size[0]), at(k / across, camera.size[1]));
            let hit = visibility.closest(origin, direction.as_vec3(), u32::MAX)?;
            let material = scene.material(&scene.faces[hit.face as usize]);
            let reflects = material.is_diffuse() && (hit.front || material.two_sided);
            reflects.then_some((hit.face, hit.front, [hit.u, hit.v]))
        };
        (0..across * across).into_par_iter().filter_map(ray).collect()
    };
    let every = cameras.len().div_ceil(MOST_VIEWS).max(1);
    cameras.step_by(every).map(view).collect()
}

/// Warns where cameras see diffuse surfaces without elements: a solution that was kept did not know the view. At most 64
/// cameras are asked, by 32 x 32 rays each.
pub fn without_elements(visibility: &Visibility, mesh: &Mesh, cameras: &[&Camera]) -> Vec<String> {
    let scene = visibility.scene();
    let mut objects = BTreeSet::new();
    for view in views(visibility, cameras.iter().copied(), 32) {
        for (face, front, _) in view {
            if mesh.first(face, front) == NONE {
                objects.insert(scene.faces[face as usize].object);
            }
        }
    }
    if objects.is_empty() {
        return Vec::new();
    }
    let names: Vec<&str> = objects.iter().take(5).map(|o| scene.objects[*o as usize].as_str()).collect();
    vec![format!(
        "the camera sees surfaces that neither light nor a camera reached when the solution was made: they get no indirect \
         light ({}{}); solve again with this camera in the scene file",
        names.join(", "),
        if objects.len() > names.len() { ", ..." } else { "" }
    )]
}

/// Sides divided into elements of the settings' size.
fn uniform_mesh(scene: &Scene, sides: &Sides, settings: &Pass1, with_black: bool) -> Result<Mesh> {
    Mesh::new(
        scene,
        sides,
        settings.element_size.unwrap_or_else(|| default_element_size(scene, with_black)),
        with_black,
    )
}

/// The sides that light or a camera can reach.
pub fn reached(visibility: &Visibility, cameras: &[Camera], seed: u32, observer: Observer) -> Sides {
    observer(Event::Begin("reach", 0));
    let frames: Vec<_> = cameras.iter().map(|c| (c.frame(visibility.scene()), c.size)).collect();
    let reached = reachable_sides(visibility, &frames, seed);
    observer(Event::End);
    reached
}

/// Does work whose time counts as `build`.
pub(crate) fn building<T>(stages: &mut [Stage], work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    if let Some(build) = stages.iter_mut().find(|s| s.name == "build") {
        build.seconds += start.elapsed().as_secs_f64();
    }
    result
}

/// Particles for specular chains, were they not aimed: twice as many as the rows have rays.
fn most_particles(elements: usize, rays: u32) -> f64 {
    (elements as f64 * f64::from(rays) * 2.0).clamp(65_536.0, 1e9)
}

/// As many as bring light over chains as often as [`most_particles`] would.
fn aimed_particles(most: f64, projection: &ProjectionMap) -> u32 {
    (most * (projection.useful / projection.aimed).min(1.0)).max(65_536.0) as u32
}

/// Names the object that misses most of its light because specular chains were cut, where that matters. A single element's share
/// is one of chance: few chains are that long.
fn cut_short(scene: &Scene, mesh: &Mesh, rows: &[RowSummary]) -> Option<String> {
    let mut objects = vec![(0.0, 0.0); scene.objects.len()];
    for (e, row) in (0..).zip(rows) {
        let (dropped, area) = &mut objects[scene.faces[mesh.place(e).0 as usize].object as usize];
        *dropped += mesh.area(e) * row.dropped.max_element();
        *area += mesh.area(e);
    }
    let shares = objects.iter().map(|(dropped, area)| if *area > 0.0 { dropped / area } else { 0.0 });
    let (most, share) = shares.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    (share > MOST_DROPPED).then(|| {
        format!(
            "specular chains were cut after their longest: {:.2} % of the light of object \"{}\" is missing",
            100.0 * share,
            scene.objects[most]
        )
    })
}

fn finish(
    visibility: &Visibility,
    mesh: Mesh,
    (rows, tiles): (Rows, bool),
    emitters: &Emitters,
    light: EmitterLight,
    views: Option<&[View]>,
) -> Result<Pass1Result> {
    let scene = visibility.scene();
    let keep = |e: u32| {
        let material = scene.material(&scene.faces[mesh.place(e).0 as usize]);
        if material.is_specular() { pass_on(material) } else { Rgb::ZERO }
    };
    let area: f64 = (0..mesh.len() as u32).map(|e| mesh.area(e)).sum();
    let open: f64 = (0..mesh.len()).map(|e| mesh.area(e as u32) * rows.summary()[e].exposed).sum();
    let check = rows.check(scene, &mesh, keep);
    let residuals = Residuals {
        closure: check.closure,
        reciprocity: check.reciprocity,
        covered: if area > 0.0 { 1.0 - open / area } else { 0.0 },
        dropped: rows.summary().iter().map(|s| s.dropped.max_element()).fold(0.0, f64::max),
    };
    let mut warnings = visibility.warnings();
    if mesh.is_empty() {
        warnings.push("no diffuse surface can be reached by light or a camera: pass 1 is empty".into());
    }
    warnings.extend(cut_short(scene, &mesh, rows.summary()));
    let system = System::new(scene, &mesh, (rows, &check, tiles));
    let solution = radiosity::solve(scene, mesh, &system, emitters, light, TOLERANCE)?;
    warnings.extend(radiosity::warnings(scene, &solution, rows));
    let importance = views.map(|views| Importance::new(scene, &solution, &system, views)).transpose()?;
    // What elements send to wrong places grows with the number of bounces. Rows that are cast again would take too long.
    if views.is_none() && rows.kept().is_some() && solution.loss() < radiosity::LITTLE_LOSS {
        if let Ok(importance) = Importance::new(scene, &solution, &system, &[]) {
            let sent = radiosity::block_errors(&solution, &importance);
            warnings.extend(radiosity::too_large(scene, &solution, &sent, false));
        }
    }
    let factors = Factors::CastAgain;
    Ok(Pass1Result { solution, residuals, factors, stored: 0, matrix_bytes: 0, warnings, importance })
}
