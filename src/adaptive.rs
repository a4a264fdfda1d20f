//! Pass 1 on elements that are fine only where the light asks for it.
//!
//! A coarse mesh is solved, the elements whose interpolated light is most wrong, or makes that of others wrong, are divided, and
//! the new mesh is solved in turn, until what is left to divide matters little beside the rest or nothing may be divided further.
//! Where the mesh is finer than the light asks for, cells are joined. All this takes fewer rays than the light itself:
//! the last mesh is solved once more with all of them.

use crate::Result;
use crate::emitters::Emitters;
use crate::mesh::{Division, Mesh, default_element_size};
use crate::pipeline::{self, MOST_VIEWS, Observer, Pass1, Pass1Result, Stage};
use crate::radiosity::{self, Changes, Judge, Reads};
use crate::scene::Camera;
use crate::visibility::Visibility;
use serde::Serialize;

/// Most solves that look where elements must be divided.
const MOST_PASSES: usize = 12;
/// They cast the rays of the solution over this. As many elements then show the Cornell box as well with 4,096 rays, up to 5 % worse
/// with 1,024.
const LOOK: u32 = 4;
/// So does one more, which mends what their noise had divided and joined: the corridor needs a tenth fewer elements at equal error with
/// 8,192 rays, for a tenth of the time.
const LOOK_AGAIN: u32 = 2;
/// No fewer rays than these: the noise would be what is divided.
const LEAST_RAYS: u32 = 256;
/// What may be left to cells that might be divided, over the squared error of the finest mesh.
const REST: f64 = 2.0;
/// A pass that would add less than this part of the elements, where the error is nearly what it may be, is not worth its solve.
const LITTLE: usize = 10;
/// How many times what may be left is nearly that.
const NEARLY: f64 = 1.1;
/// Two passes in turn that leave as many elements as there were, but for less than this part, join what they divide.
const STALLED: usize = 200;

/// Rays of all cameras that tell how much of the pictures each element fills. With a 256th of them, small elements have one or none, and
/// the pictures of `scenes/cornell` need 1.1 to 1.3 times as many elements.
const VIEW_RAYS: f64 = 262_144.0;

/// What adapting came to.
#[derive(Debug, Clone, Serialize)]
pub struct Adapted {
    /// Elements of each mesh that was solved.
    pub elements: Vec<usize>,
    /// Elements of the uniform mesh of the same size.
    pub uniform_elements: u64,
}

/// [`pipeline::solve_within`] with adaptive elements; the settings' element size is that of the finest.
pub fn solve(
    limit: Option<u64>,
    visibility: &Visibility,
    emitters: &Emitters,
    cameras: &[Camera],
    (settings, reads): (&Pass1, Reads),
    observer: Observer,
    stages: &mut Vec<Stage>,
) -> Result<(Pass1Result, Adapted)> {
    let scene = visibility.scene();
    pipeline::require_light(scene, emitters)?;
    let size = settings.element_size.unwrap_or_else(|| default_element_size(scene, false));
    let (reached, uniform, mut division) = pipeline::building(stages, || {
        let reached = pipeline::reached(visibility, cameras, settings.seed, observer);
        let mut division = Division::new(scene, &reached, size)?;
        let uniform = Mesh::uniform_len(scene, &reached, size);
        division.balance(scene, &reached)?;
        Ok::<_, crate::Error>((reached, uniform, division))
    })?;
    let across = (VIEW_RAYS / cameras.len().clamp(1, MOST_VIEWS) as f64).sqrt();
    let views = pipeline::views(visibility, cameras.iter(), across as u32);
    let mut adapted = Adapted { elements: Vec::new(), uniform_elements: uniform };
    let mut own: Vec<Stage> = Vec::new();
    let mut rays: Vec<u32> =
        [LOOK, LOOK_AGAIN, 1].map(|over| (settings.rays / over).max(LEAST_RAYS).min(settings.rays)).into();
    // Of few rays, the passes that look cast them all, and one of them is the last.
    rays.dedup();
    let (mut passes, mut stalled, mut before) = (0, 0, 0);
    let mut turn = 0;
    loop {
        let (pass, last) = (Pass1 { rays: rays[turn], ..*settings }, turn + 1 == rays.len());
        let mesh = pipeline::building(stages, || Mesh::divided(scene, &reached, &division, false))?;
        let elements = mesh.len();
        passes += 1;
        stalled = if elements.abs_diff(before) <= elements / STALLED { stalled + 1 } else { 0 };
        before = elements;
        if adapted.elements.last() != Some(&elements) {
            adapted.elements.push(elements);
        }
        let what = (&reached, mesh, Some(&views[..]));
        let mut result = pipeline::solve_mesh(limit, visibility, emitters, what, &pass, observer, &mut own)?;
        let mut too_large = None;
        let enough = pipeline::building(stages, || -> Result<bool> {
            let s = &result.solution;
            let Some(importance) = &result.importance else { return Ok(true) };
            let judge = Judge::new(s, importance, emitters, reads);
            let errors = judge.elements(&division);
            let sent: Vec<f64> = errors.iter().map(|[u, v]| u.sent + v.sent).collect();
            too_large = radiosity::too_large(scene, s, &sent, !views.is_empty());
            if last && turn > 0 {
                return Ok(true);
            }
            let Changes { divide, join, added, excess } =
                Changes::new(&s.mesh, &division, &judge, &errors, REST);
            let little = |cells: usize| cells <= elements / LITTLE;
            let enough = turn > 0
                || passes >= MOST_PASSES
                || stalled >= 2
                || (added == 0 || little(added) && excess < NEARLY) && little(join.len());
            // What is little is done where another solve follows anyway.
            if !(enough && last) {
                let wanted = |face, cell| divide.get(&(face, cell)).copied().unwrap_or_default();
                division.change(wanted, &join);
                division.balance(scene, &reached)?;
            }
            Ok(enough)
        })?;
        if !enough {
            continue;
        }
        if last {
            result.warnings.extend(too_large);
            pipeline::merge(stages, own);
            return Ok((result, adapted));
        }
        turn += 1;
    }
}
