//! Which estimator answers a request for form factors, and how much work it takes.

use super::found::{Estimates, Found};
use super::pairs::{self, FewPairs, PairFactors, PairWork, Surfaces};
use super::{AtSpecular, Casting, ExchangeMatrix, ObjectTable, analytic, cast_rows};
use crate::mesh::{Mesh, Sides, default_element_size};
use crate::scene::Scene;
use crate::visibility::Visibility;
use crate::{Error, Result};

/// Independent randomisations of the hemisphere rays: four standard errors hold almost always (15 degrees of freedom).
const BATCHES: u32 = 16;
/// Rays an element beyond which an asked error is given up.
pub const MOST_RAYS: u32 = 1 << 20;
/// A pair costs, all pairs considered, as much as this many hemisphere rays: measured, 0.3 to 2.
const RAYS_A_PAIR: u32 = 8;
/// Rays an element that share the rest of a row between what escaped and what was absorbed.
const FEW_RAYS: u32 = 128;
/// Elements up to which unoccluded factors are computed to [`analytic::EXACT`] rather than to [`QUICK`].
const FEW_ELEMENTS: usize = 64;
/// The same where these are summed by objects.
const FEW_OF_OBJECTS: usize = 512;
/// Relative error of integrals over cells among so few elements, where none is asked for: at least this, and
const FEW_CELL_ERROR: f64 = 1e-3;
/// this over the rays of an element for each of its pairs.
const CELL_ERROR_OF_RAYS: f64 = 0.25;
/// Relative error of unoccluded factors among many elements.
const QUICK: f64 = 1e-5;
/// Rays an element for each element of an emitter: with fewer, the pairs of emitters would take much longer than the rays. Without
/// them a small lamp is met by a few rays of a row, and all light has their noise.
const RAYS_A_LAMP: u32 = 16;
/// Relative error of the unoccluded factors of emitters beside hemisphere rays.
const LAMP: f64 = 1e-4;
/// Factor of emitters below which errors count as shares of this one.
const LAMP_FLOOR: f64 = 1e-6;

/// What is asked for.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// Rays an element, at least; the budget of the pairs of an element too.
    pub rays: u32,
    /// Largest relative standard error of the factors above `floor`; none: as good as `rays` give.
    pub error: Option<f64>,
    /// Smallest factor that `error` is for.
    pub floor: f64,
    /// Factors between objects are what counts.
    pub by_object: bool,
    /// Seed.
    pub seed: u32,
    /// Called with the number of elements finished.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

/// Whether every pair of elements is looked at: where they are no more than an eighth of the rays of an
/// element, or an error is asked for; and where their number and that of the surfaces' sides stays within
/// [`pairs::MOST_ELEMENTS`] and [`pairs::MOST_SURFACES`].
pub fn by_pairs(mesh: &Mesh, scene: &Scene, request: &Request) -> bool {
    let most = if request.error.is_some() { pairs::MOST_ELEMENTS } else { most_by_pairs(request.rays) };
    mesh.len() <= most && has_few_surfaces(mesh, scene)
}

/// Elements up to which every pair is looked at with so many rays an element, where no error is asked for.
fn most_by_pairs(rays: u32) -> usize {
    ((rays / RAYS_A_PAIR) as usize).min(pairs::MOST_ELEMENTS)
}

/// An element size \[m\] for factors between objects, which do not depend on elements: the default one, or the next larger one that makes
/// so few elements that every pair of them is looked at with `rays` rays an element. Where no size does, none; but if an error is
/// `asked` for and the default size makes so few that pairs are looked at for its sake, the largest, since pairs take their time.
///
/// # Errors
/// The default size makes more elements than a mesh may have.
pub fn size_for_pairs(scene: &Scene, sides: &Sides, rays: u32, asked: bool) -> Result<Option<f64>> {
    let most = most_by_pairs(rays);
    let mut size = default_element_size(scene, true);
    let mut mesh = Mesh::new(scene, sides, size, true)?;
    if !has_few_surfaces(&mesh, scene) {
        return Ok(None);
    }
    let otherwise = (asked && mesh.len() <= pairs::MOST_ELEMENTS).then_some(f64::MAX);
    if scene.faces.len() > most {
        return Ok(otherwise);
    }
    while mesh.len() > most {
        size *= 1.1;
        if size > 4.0 * scene.radius {
            return Ok(otherwise);
        }
        mesh = Mesh::new(scene, sides, size, true)?;
    }
    Ok(Some(size))
}

/// Whether what may lie between any two of the surfaces' sides is soon found.
fn has_few_surfaces(mesh: &Mesh, scene: &Scene) -> bool {
    let sides = if mesh.has_backs() { 2 } else { 1 };
    sides * Surfaces::new(scene).polygons.len() <= pairs::MOST_SURFACES
}

/// Finds the factors between the elements of a mesh.
pub fn estimate(visibility: &Visibility, mesh: &Mesh, request: &Request) -> Found {
    estimate_rows(visibility, mesh, request, None)
}

/// As [`estimate`], for those elements alone that `only` names: their rows are what they are among all. An error may be asked of
/// all rows alone.
pub fn estimate_rows(
    visibility: &Visibility,
    mesh: &Mesh,
    request: &Request,
    only: Option<&[bool]>,
) -> Found {
    let scene = visibility.scene();
    let rows = |rays: u32| {
        let casting = Casting {
            rays,
            batches: BATCHES,
            seed: request.seed,
            specular: AtSpecular::End,
            reached: None,
            emitters: None,
            progress: request.progress,
        };
        cast_rows(visibility, mesh, &casting, only).0
    };
    if !by_pairs(mesh, scene, request) {
        let (matrix, achieved, rays) = by_rows(visibility, mesh, request, rows);
        let alone = request.error.is_some() || request.by_object;
        let lamps = if alone { None } else { lamps(visibility, mesh, request, only) };
        let rays = rays + lamps.as_ref().map_or(0, |l| l.rays);
        return Found { estimates: Estimates::Rows(matrix, lamps), achieved, rays, blocked: Vec::new() };
    }
    let few = mesh.len() <= FEW_ELEMENTS;
    // Hemisphere rays spend one budget; the pairs have another one. Where an error is asked for, the rays only tell what share
    // of a row's rest is absorbed.
    let rows = rows(if few || request.error.is_none() { request.rays } else { request.rays.min(FEW_RAYS) });
    let batches = if few { pairs::BATCHES } else { pairs::FEW_BATCHES };
    let points = request.rays / (mesh.len().max(1) * batches) as u32;
    let asked = if request.by_object { None } else { request.error };
    let mut work = PairWork {
        points: 1 << points.max(1).ilog2().min(pairs::MOST_POINTS.ilog2()),
        batches,
        error: asked,
        floor: request.floor,
        tolerance: if few || request.by_object && mesh.len() <= FEW_OF_OBJECTS {
            analytic::EXACT
        } else {
            QUICK.max(0.01 * request.error.unwrap_or(0.0))
        },
        cells: Some(asked.unwrap_or(if few {
            few_cell_error(mesh.len(), request.rays)
        } else {
            pairs::CELL_ERROR
        })),
        // Where an error is asked for, hemisphere rays are few.
        rows: request.error.is_none().then_some(&rows),
        unoccluded: false,
        seed: request.seed,
        progress: &|_| (),
    };
    if work.error.is_some() {
        // Few points to begin with: most pairs need no more.
        work.points = 4;
    }
    let mut rays = rows.rays;
    loop {
        let found = PairFactors::of_rows(visibility, mesh, &work, only);
        rays += found.rays;
        let achieved = request.error.map(|_| match request.by_object {
            true => {
                largest_error(&ObjectTable::of_pairs(scene, mesh, &found, Some(&rows), 0.0), request.floor)
            }
            false => found.largest_error(request.floor),
        });
        let short = request.error.zip(achieved).map(|(asked, reached)| reached / asked).filter(|s| *s > 1.0);
        let (Some(short), true, true) = (short, request.by_object, work.points < pairs::MOST_POINTS) else {
            let estimates = Estimates::Pairs(found, Some(rows));
            return Found { estimates, achieved, rays, blocked: Vec::new() };
        };
        work.points = more(work.points, short, pairs::MOST_POINTS);
        work.cells = work.cells.map(|error| error / (2.0 * short));
    }
}

/// Relative error of integrals over cells among few elements: smaller where the rays are many for their pairs.
fn few_cell_error(elements: usize, rays: u32) -> f64 {
    (CELL_ERROR_OF_RAYS * elements as f64 / f64::from(rays.max(1))).clamp(FEW_CELL_ERROR, pairs::CELL_ERROR)
}

/// The factors of emitters, pair by pair: a small lamp takes few of a hemisphere's rays, and all light depends on it.
/// None where there are no emitters, or so many that they would take much longer than the rays.
fn lamps(visibility: &Visibility, mesh: &Mesh, request: &Request, only: Option<&[bool]>) -> Option<FewPairs> {
    let scene = visibility.scene();
    let emits = |e: &u32| {
        let (face, front, _) = mesh.place(*e);
        scene.material(&scene.faces[face as usize]).emitted(front).max_element() > 0.0
    };
    let most = (request.rays / RAYS_A_LAMP) as usize;
    let elements: Vec<u32> = (0..mesh.len() as u32).filter(emits).take(most + 1).collect();
    let few = !elements.is_empty() && elements.len() <= most;
    if !few || !has_few_surfaces(mesh, scene) {
        return None;
    }
    let work = PairWork {
        points: 8,
        batches: pairs::FEW_BATCHES,
        error: None,
        floor: LAMP_FLOOR,
        tolerance: LAMP,
        cells: Some(pairs::CELL_ERROR),
        rows: None,
        unoccluded: false,
        seed: request.seed,
        progress: &|_| (),
    };
    Some(FewPairs::new(visibility, mesh, (elements, only), &work))
}

/// Exact factors between the elements of a mesh, as if nothing were between any two.
///
/// # Errors
/// There are more than [`pairs::MOST_ELEMENTS`] elements.
pub fn unoccluded(
    visibility: &Visibility,
    mesh: &Mesh,
    seed: u32,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Found> {
    if mesh.len() > pairs::MOST_ELEMENTS {
        return Err(Error::Usage(format!(
            "{} elements: exact factors of at most {} are held; choose a larger --element-size",
            mesh.len(),
            pairs::MOST_ELEMENTS
        )));
    }
    let work = PairWork {
        points: 1,
        batches: pairs::FEW_BATCHES,
        error: None,
        floor: 0.0,
        tolerance: analytic::EXACT,
        cells: None,
        rows: None,
        unoccluded: true,
        seed,
        progress,
    };
    let found = PairFactors::new(visibility, mesh, &work);
    let (blocked, rays) = found.blocked_objects(visibility, mesh, seed);
    Ok(Found { estimates: Estimates::Pairs(found, None), achieved: None, rays, blocked })
}

/// Hemisphere rays alone, more of them until they meet an asked error: the rows, their error, and the rays cast in all.
fn by_rows(
    visibility: &Visibility,
    mesh: &Mesh,
    request: &Request,
    rows: impl Fn(u32) -> ExchangeMatrix,
) -> (ExchangeMatrix, Option<f64>, u64) {
    let (mut per_element, mut rays) = (request.rays, 0);
    loop {
        let matrix = rows(per_element);
        rays += matrix.rays;
        let achieved = request.error.map(|_| match request.by_object {
            true => largest_error(&ObjectTable::new(visibility.scene(), mesh, &matrix, 0.0), request.floor),
            false => largest_row_error(&matrix, request.floor),
        });
        let short = request.error.zip(achieved).map(|(asked, reached)| reached / asked).filter(|s| *s > 1.0);
        match short {
            Some(short) if per_element < MOST_RAYS => {
                per_element = more(per_element.next_power_of_two(), short, MOST_RAYS);
            }
            _ => return (matrix, achieved, rays),
        }
    }
}

/// The next number of points, if the error must fall by `factor` and falls with the square root.
fn more(points: u32, factor: f64, most: u32) -> u32 {
    let times = (factor * factor).clamp(2.0, 16.0) as u32;
    (points * times.next_power_of_two()).min(most)
}

fn largest_error(table: &ObjectTable, floor: f64) -> f64 {
    let both = table.form_factors.iter().flatten().zip(table.standard_errors.iter().flatten());
    both.filter(|(f, _)| **f > floor).map(|(f, e)| e / f).fold(0.0, f64::max)
}

fn largest_row_error(matrix: &ExchangeMatrix, floor: f64) -> f64 {
    let batches = matrix.batches();
    let mut estimates = std::collections::BTreeMap::new();
    let mut worst = 0.0f64;
    for row in 0..matrix.len() {
        estimates.clear();
        for b in 0..batches {
            for (j, f) in matrix.batch(row, b) {
                estimates.entry(j).or_insert_with(|| vec![0.0; batches])[b] += f.x * batches as f64;
            }
        }
        for e in estimates.values() {
            let (mean, error) = super::table::mean_error(e);
            if mean > floor {
                worst = worst.max(error / mean);
            }
        }
    }
    worst
}
