//! Pass 1 on elements that are fine only where the light asks for it.
//!
//! A coarse mesh is solved, the elements whose interpolated light is most wrong are divided, and the new mesh is solved in turn,
//! until what is left to divide matters little beside the rest or nothing may be divided further.

use crate::Result;
use crate::emitters::Emitters;
use crate::mesh::{Division, Mesh, default_element_size};
use crate::pipeline::{self, Observer, Pass1, Pass1Result, Stage};
use crate::radiosity::{Reads, element_errors, worst_cells};
use crate::scene::Camera;
use crate::visibility::Visibility;
use serde::Serialize;

/// Most solves.
const MOST_PASSES: usize = 8;
/// Share of the squared error that is left to cells which might be divided.
const REST: f64 = 0.1;

/// What adapting came to.
#[derive(Debug, Clone, Serialize)]
pub struct Adapted {
    /// Elements of each mesh that was solved.
    pub elements: Vec<usize>,
    /// Elements of the uniform mesh of the same size.
    pub uniform_elements: usize,
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
    let size = settings.element_size.unwrap_or_else(|| default_element_size(scene));
    let (reached, uniform, mut division) = pipeline::building(stages, || {
        let reached = pipeline::reached(visibility, cameras, settings.seed);
        let uniform = Mesh::new(scene, &reached, size, false)?.len();
        let mut division = Division::new(scene, &reached, size)?;
        division.balance(scene, &reached)?;
        Ok::<_, crate::Error>((reached, uniform, division))
    })?;
    let mut adapted = Adapted { elements: Vec::new(), uniform_elements: uniform };
    let mut own: Vec<Stage> = Vec::new();
    loop {
        let mesh = pipeline::building(stages, || Mesh::divided(scene, &reached, &division, false))?;
        adapted.elements.push(mesh.len());
        let solved = (&reached, mesh);
        let result = pipeline::solve_mesh(limit, visibility, emitters, solved, settings, observer, &mut own)?;
        let chosen = if adapted.elements.len() == MOST_PASSES {
            Vec::new()
        } else {
            pipeline::building(stages, || {
                let errors = element_errors(scene, &division, &result.solution, &result.open, reads)?;
                Ok::<_, crate::Error>(worst_cells(&result.solution.mesh, &division, &errors, REST))
            })?
        };
        if chosen.is_empty() {
            stages.extend(together(own));
            return Ok((result, adapted));
        }
        pipeline::building(stages, || {
            division.split(|face, cell| chosen.binary_search(&(face, cell)).is_ok());
            division.balance(scene, &reached)
        })?;
    }
}

/// Each stage once, with the time and the rays of all its passes.
fn together(stages: Vec<Stage>) -> Vec<Stage> {
    let mut sums: Vec<Stage> = Vec::new();
    for stage in stages {
        match sums.iter_mut().find(|s| s.name == stage.name) {
            Some(sum) => {
                sum.seconds += stage.seconds;
                sum.rays += stage.rays;
            }
            None => sums.push(stage),
        }
    }
    sums
}
