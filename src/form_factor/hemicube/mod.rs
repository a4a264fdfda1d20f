//! Form factors by the hemi-cube (Cohen and Greenberg, SIGGRAPH 1985).
//!
//! A hemi-cube about a point of an element has a square top and four half sides, divided into pixels. The faces of
//! the scene are drawn on it with a z-buffer ([`raster`]); the delta form factors ([`DeltaFactors`]) of the pixels
//! that see element j sum to the form factor from the point to j. Only input faces are drawn: the element within a
//! face follows from the pixel's (u, v), so refinement costs no drawing.
//!
//! It errs in three ways, which [`HemicubeErrors`] measures: pixels are whole or not at all (aliasing), what is
//! near does not look the same from all of the element (proximity), and a point sees what the rest of the element may
//! not (visibility). A grid of hemi-cubes over the element lessens the last two, and random rotations about the normal turn
//! aliasing into noise.

mod delta;
mod errors;
mod raster;

pub use delta::DeltaFactors;
pub use errors::HemicubeErrors;

use super::matrix::{ExchangeMatrix, RowSummary};
use super::rows::{Block, Builder};
use crate::color::Rgb;
use crate::geometry::Frame;
use crate::mesh::Mesh;
use crate::sampling::seed_of;
use crate::scene::Scene;
use glam::{DVec2, DVec3};
use raster::{ItemBuffer, Seen};
use rayon::prelude::*;
use serde::Serialize;

/// Most pixels along the top's edge: a thread's buffers take 24 bytes for each of their squares.
pub const MOST_PIXELS: u32 = 4096;

/// How to draw hemi-cubes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct HemicubeSettings {
    /// Pixels along each edge of the top, 1 to [`MOST_PIXELS`].
    pub resolution: u32,
    /// `grid * grid` hemi-cubes over each element, at the middles of equal parts; 1: one at its centroid.
    pub grid: u32,
    /// Random rotations about the normal: each is one independent randomisation of the row, with points of its own
    /// within the parts of the grid. 0: hemi-cubes stand along the axes.
    pub rotations: u32,
    /// Seed of rotations and points.
    pub seed: u32,
}

impl HemicubeSettings {
    /// Independent randomisations of each row.
    pub fn batches(&self) -> u32 {
        self.rotations.max(1)
    }

    /// Hemi-cubes drawn for each element.
    pub fn cubes_per_element(&self) -> u64 {
        u64::from(self.batches()) * u64::from(self.grid).pow(2)
    }
}

/// Form factors of every element, or of those that `rows` names; other rows stay empty.
///
/// Sides of faces without elements block and absorb. Standard errors of several rotations know of aliasing and,
/// with a grid, of what its points miss; of one point they tell nothing of proximity and visibility.
/// `progress` is called with the number of elements finished.
pub fn hemicube(
    scene: &Scene,
    mesh: &Mesh,
    settings: &HemicubeSettings,
    rows: Option<&[bool]>,
    progress: &(dyn Fn(u64) + Sync),
) -> ExchangeMatrix {
    let deltas = DeltaFactors::new(settings.resolution as usize);
    let drawn: Vec<Row> = (0..mesh.len())
        .into_par_iter()
        .map_init(
            || Drawer::new(scene, mesh, &deltas),
            |drawer, element| {
                if rows.is_some_and(|r| !r[element]) {
                    return Row::empty(settings.batches() as usize);
                }
                let row = drawer.row(element as u32, settings);
                progress(1);
                row
            },
        )
        .collect();
    let (blocks, summary) = drawn.into_iter().map(|row| (row.entries, row.summary)).unzip();
    ExchangeMatrix {
        batches: settings.batches() as usize,
        channels: 1,
        rows_per_block: 1,
        blocks,
        summary,
        rays_per_row: 0,
        rays: 0,
    }
}

/// One row of the matrix.
struct Row {
    entries: Block,
    summary: RowSummary,
}

impl Row {
    fn empty(batches: usize) -> Row {
        let mut entries = Builder::new(false);
        (0..batches).for_each(|_| entries.end_batch());
        entries.end_row(batches, 1, 1.0);
        Row { entries: entries.finish(), summary: RowSummary::default() }
    }
}

/// What one hemi-cube, or the mean of several, sees beside elements.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Beside {
    escaped: f64,
    absorbed: f64,
}

/// Buffers of one thread.
struct Drawer<'a> {
    scene: &'a Scene,
    mesh: &'a Mesh,
    deltas: &'a DeltaFactors,
    buffer: ItemBuffer<'a>,
    /// Dense sums; only touched columns are visited and cleared.
    weight: Vec<f64>,
    touched: Vec<u32>,
    entries: Builder,
}

impl<'a> Drawer<'a> {
    fn new(scene: &'a Scene, mesh: &'a Mesh, deltas: &'a DeltaFactors) -> Drawer<'a> {
        Drawer {
            scene,
            mesh,
            deltas,
            buffer: ItemBuffer::new(scene, mesh, deltas.resolution()),
            weight: vec![0.0; mesh.len()],
            touched: Vec::new(),
            entries: Builder::new(false),
        }
    }

    fn row(&mut self, element: u32, settings: &HemicubeSettings) -> Row {
        let mut summary = RowSummary { exposed: 1.0, ..RowSummary::default() };
        let (batches, grid) = (settings.batches(), settings.grid);
        let share = 1.0 / settings.cubes_per_element() as f64;
        for batch in 0..batches {
            let mut beside = Beside::default();
            for cube in 0..grid * grid {
                let random =
                    (settings.rotations > 0).then(|| seed_of(&[settings.seed, element, batch, cube]));
                self.cube(element, place_in_grid(grid, cube, random), random.map(turn), share, &mut beside);
            }
            for &j in &self.touched {
                self.entries.push(j, &[self.weight[j as usize] as f32]);
                self.weight[j as usize] = 0.0;
            }
            self.entries.end_batch();
            self.touched.clear();
            summary.escaped += Rgb::splat(beside.escaped);
            summary.absorbed += Rgb::splat(beside.absorbed);
        }
        self.entries.end_row(batches as usize, 1, 1.0);
        Row { entries: self.entries.finish(), summary }
    }

    /// Adds `share` of what one hemi-cube sees; at the centroid without a place.
    fn cube(
        &mut self,
        element: u32,
        place: Option<DVec2>,
        turn: Option<f64>,
        share: f64,
        beside: &mut Beside,
    ) {
        let (eye, axes, own) = stand(self.scene, self.mesh, element, place, turn);
        let (weight, touched, deltas) = (&mut self.weight, &mut self.touched, self.deltas);
        self.buffer.draw(eye, axes, own, |span| {
            let delta = share * deltas.span(span.side, span.row, span.from, span.to);
            match span.seen {
                Seen::Element(j) => {
                    let w = &mut weight[j as usize];
                    if *w == 0.0 {
                        touched.push(j);
                    }
                    *w += delta;
                }
                Seen::Blocked => beside.absorbed += delta,
                Seen::Outside => beside.escaped += delta,
            }
        });
    }
}

/// Where a hemi-cube stands: its centre, its axes and the face that it stands on.
fn stand(
    scene: &Scene,
    mesh: &Mesh,
    element: u32,
    place: Option<DVec2>,
    turn: Option<f64>,
) -> (DVec3, [DVec3; 3], u32) {
    let at = mesh.place_of(scene, element);
    let eye = place.map_or_else(|| mesh.centroid(scene, element), |p| at.at(at.uv(p.x, p.y)));
    let frame = Frame::new(at.normal);
    let (sin, cos) = turn.unwrap_or(0.0).sin_cos();
    (eye, [cos * frame.x + sin * frame.y, cos * frame.y - sin * frame.x, frame.z], at.face)
}

/// Place in the unit square of one of `grid * grid` hemi-cubes, within its part at random with a seed; none: the centroid.
fn place_in_grid(grid: u32, cube: u32, seed: Option<u32>) -> Option<DVec2> {
    if grid == 1 {
        return None;
    }
    let jitter = |dimension| seed.map_or(0.5, |s| unit(seed_of(&[s, dimension])));
    let (i, j) = (f64::from(cube % grid), f64::from(cube / grid));
    Some(DVec2::new(i + jitter(1), j + jitter(2)) / f64::from(grid))
}

/// A random angle \[rad\].
fn turn(seed: u32) -> f64 {
    std::f64::consts::TAU * unit(seed_of(&[seed, 0]))
}

/// In (0, 1).
fn unit(bits: u32) -> f64 {
    (f64::from(bits) + 0.5) / f64::from(u32::MAX)
}

/// What each pixel of an element's hemi-cube at its centroid sees, for pictures, by side (0 is the top), row (upwards) and
/// column: `None` outside, `Some(None)` a side of a face without elements, else an element. [`DeltaFactors`] has the weights.
pub fn item_image(
    scene: &Scene,
    mesh: &Mesh,
    element: u32,
    resolution: u32,
) -> [Vec<Vec<Option<Option<u32>>>>; 5] {
    let n = resolution as usize;
    let mut buffer = ItemBuffer::new(scene, mesh, n);
    let (eye, axes, own) = stand(scene, mesh, element, None, None);
    let mut image: [Vec<Vec<Option<Option<u32>>>>; 5] =
        std::array::from_fn(|side| vec![vec![None; n]; buffer.rows(side)]);
    buffer.draw(eye, axes, own, |span| {
        let seen = match span.seen {
            Seen::Element(j) => Some(Some(j)),
            Seen::Blocked => Some(None),
            Seen::Outside => None,
        };
        image[span.side][span.row][span.from..span.to].fill(seen);
    });
    image
}
