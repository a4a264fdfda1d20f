//! Faces divided into elements, and (face, u, v) to element by arithmetic.
//!
//! Embree holds faces only; an element is a cell of a regular grid on one side of a face. A
//! quad has `nu x nv` cells; a triangle has `n * n` congruent triangles, row by row, an
//! upright and an inverted one in turn.

mod division;
mod grid;
mod joint;
mod lattice;
mod patch;
mod place;

pub use division::{Along, Division, Siblings};
pub use grid::{Grid, Levels};
use lattice::MOST_ALONG;
pub use lattice::{CellFrame, Lattice, whole_part};
pub use patch::Nodes;
pub use place::Place;

use crate::scene::{Face, Scene};
use crate::{Error, Result};
use glam::{DVec2, DVec3};

/// No element.
pub const NONE: u32 = u32::MAX;

/// Most elements of a scene: their factors alone would take tens of gigabytes.
pub(crate) const MOST_ELEMENTS: u32 = 1 << 27;

/// Index of a side of a face: `2 * face` is the front, `2 * face + 1` the back.
pub fn side_index(face: u32, front: bool) -> usize {
    2 * face as usize + usize::from(!front)
}

/// Which sides of the faces take part, by [`side_index`].
#[derive(Debug, Clone, PartialEq)]
pub struct Sides(pub Vec<bool>);

impl Sides {
    /// Every side of every face.
    pub fn all(scene: &Scene) -> Sides {
        Sides(vec![true; 2 * scene.faces.len()])
    }

    /// Only the fronts, by the right-hand rule.
    pub fn fronts(scene: &Scene) -> Sides {
        Sides((0..2 * scene.faces.len()).map(|s| s % 2 == 0).collect())
    }

    /// The same but for surfaces that only reflect or refract specularly: they gather and send no diffuse light.
    pub fn without_purely_specular(mut self, scene: &Scene) -> Sides {
        for (k, face) in scene.faces.iter().enumerate() {
            let m = scene.material(face);
            if m.is_specular() && !m.is_diffuse() && !m.is_emitter() {
                self.0[2 * k..2 * k + 2].fill(false);
            }
        }
        self
    }

    /// Whether a side takes part.
    #[inline]
    pub fn contains(&self, face: u32, front: bool) -> bool {
        self.0[side_index(face, front)]
    }

    /// How many take part.
    pub fn count(&self) -> usize {
        self.0.iter().filter(|s| **s).count()
    }
}

/// All elements of a scene.
///
/// Elements of one side of a face are numbered in a row, in the order of the grid's cells.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// Largest cell edge asked for \[m\]; of an adaptive mesh, that of the finest cells.
    pub element_size: f64,
    grids: Vec<Grid>,
    /// First element of each side, or [`NONE`].
    first: Vec<u32>,
    /// Side index of each element.
    side_of: Vec<u32>,
    area: Vec<f64>,
    adaptive: bool,
}

/// An element size \[m\] fit for the scene's extent: a fixed share of the square root of the area on which light is exchanged
/// diffusely. A sun that is far away, or water all around, takes part in it only `with_black` ([`Mesh::new`]).
///
/// The share makes about 5,000 elements of a simple room.
pub fn default_element_size(scene: &Scene, with_black: bool) -> f64 {
    let [exchanging, whole] = areas(scene, |f| with_black || scene.material(f).is_diffuse());
    let area = if exchanging > 0.0 { exchanging } else { whole };
    (area / 3000.0).sqrt()
}

/// The area of some faces, and that of all \[m^2\].
fn areas(scene: &Scene, some: impl Fn(&Face) -> bool) -> [f64; 2] {
    let area = |f: &Face| DVec2::new(if some(f) { f.area } else { 0.0 }, f.area);
    scene.faces.iter().map(area).sum::<DVec2>().to_array()
}

/// The lattice of each face whose cell edges are at most `size` \[m\] long. Cells are larger on faces that only emit where these have
/// more of the area than the diffuse ones: emission has no detail, and what gathers on them is but absorbed.
fn separate(scene: &Scene, size: f64, with_black: bool) -> impl Iterator<Item = Lattice> {
    let only_emits = move |f: &Face| {
        let m = scene.material(f);
        !with_black && m.is_emitter() && !m.is_diffuse() && !m.is_specular()
    };
    let [emitting, _] = areas(scene, only_emits);
    let [diffuse, _] = areas(scene, |f| scene.material(f).is_diffuse());
    let larger = if diffuse > 0.0 { (emitting / diffuse).sqrt().max(1.0) } else { 1.0 };
    let lattice = move |f: &Face| Lattice::of(scene, f, if only_emits(f) { larger * size } else { size });
    scene.faces.iter().map(lattice)
}

/// The lattices of all faces, made to agree where faces meet.
fn lattices(scene: &Scene, size: f64, with_black: bool) -> Vec<Lattice> {
    let mut lattices: Vec<Lattice> = separate(scene, size, with_black).collect();
    agree(scene, &mut lattices);
    lattices
}

/// Makes lattices finer until those that meet agree.
fn agree(scene: &Scene, lattices: &mut [Lattice]) {
    // Triangles of one polygon meet along its diagonals: equal grids make their nodes coincide.
    let mut finest = vec![1u32; scene.polygon_count.max(1)];
    for (face, lattice) in scene.faces.iter().zip(&*lattices).filter(|(_, l)| l.triangle) {
        let n = &mut finest[face.polygon as usize];
        *n = (*n).max(lattice.nu);
    }
    for (face, lattice) in scene.faces.iter().zip(&mut *lattices).filter(|(_, l)| l.triangle) {
        (lattice.nu, lattice.nv) = (finest[face.polygon as usize], finest[face.polygon as usize]);
    }
    patch::nest(scene, lattices);
}

/// Whether a side of a face has elements where light or a camera reaches it.
fn takes_part(scene: &Scene, face: &Face, front: bool, with_black: bool) -> bool {
    let material = scene.material(face);
    // A black emitter gathers nothing, but its power must be accounted for.
    let diffuse = material.is_diffuse() && (front || material.two_sided);
    with_black || diffuse || material.emitted(front).max_element() > 0.0
}

impl Mesh {
    /// Divides the given sides of a scene's faces into cells with edges of at most `element_size` \[m\].
    ///
    /// Sides whose material neither reflects nor transmits diffusely get no elements unless
    /// `with_black` asks for them (form factors do not care for materials), and those that only emit have no more elements in all
    /// than the others, but one a face.
    pub fn new(scene: &Scene, sides: &Sides, element_size: f64, with_black: bool) -> Result<Mesh> {
        if element_size.is_nan() || element_size <= 0.0 {
            return Err(Error::Usage(format!("element size {element_size} m: must be above zero")));
        }
        let grids = lattices(scene, element_size, with_black).into_iter().map(Grid::from).collect();
        Mesh::of_grids(scene, sides, (element_size, false), grids, with_black)
    }

    /// Fewer and more even cells than those of [`Mesh::new`] on the sides of another mesh; their nodes need not coincide where
    /// faces meet: no field is interpolated between them.
    pub(crate) fn patches(scene: &Scene, sides: &Sides, size: f64) -> Result<Mesh> {
        let grids = separate(scene, size, false).map(Grid::from).collect();
        Mesh::of_grids(scene, sides, (size, false), grids, true)
    }

    /// How many elements [`Mesh::new`] would make of the sides that reflect, transmit or emit, without making them.
    pub fn uniform_len(scene: &Scene, sides: &Sides, element_size: f64) -> u64 {
        let lattices = lattices(scene, element_size, false);
        let elements = |(k, (face, lattice)): (usize, (&Face, &Lattice))| {
            let used =
                |front: &bool| sides.contains(k as u32, *front) && takes_part(scene, face, *front, false);
            lattice.len() * [true, false].iter().filter(|front| used(front)).count() as u64
        };
        scene.faces.iter().zip(&lattices).enumerate().map(elements).sum()
    }

    /// [`Mesh::new`] with cells of different sizes.
    pub fn divided(scene: &Scene, sides: &Sides, division: &Division, with_black: bool) -> Result<Mesh> {
        let grids = division.grids(scene)?;
        Mesh::of_grids(scene, sides, (division.finest(), true), grids, with_black)
    }

    fn of_grids(
        scene: &Scene,
        sides: &Sides,
        (element_size, adaptive): (f64, bool),
        grids: Vec<Grid>,
        with_black: bool,
    ) -> Result<Mesh> {
        let (mut first, mut side_of, mut area) = (vec![NONE; 2 * scene.faces.len()], Vec::new(), Vec::new());
        let mut total = 0u64;
        for (k, (face, grid)) in scene.faces.iter().zip(&grids).enumerate() {
            for front in [true, false] {
                let side = side_index(k as u32, front);
                if !sides.0[side] || !takes_part(scene, face, front, with_black) {
                    continue;
                }
                first[side] = total as u32;
                total += grid.len();
                let along = grid.lattice.nu.max(grid.lattice.nv);
                if along > MOST_ALONG {
                    let object = &scene.objects[face.object as usize];
                    return Err(Error::Usage(format!(
                        "element size {element_size} m divides an edge of \"{object}\" by more than {MOST_ALONG}: choose a larger --element-size"
                    )));
                }
                if total > u64::from(MOST_ELEMENTS) {
                    return Err(Error::Usage(format!(
                        "element size {element_size} m makes more than {MOST_ELEMENTS} elements: choose a larger --element-size"
                    )));
                }
                side_of.resize(total as usize, side as u32);
                let frame = scene.face_frame(face);
                if frame.is_twisted() {
                    // Between lines of equal u and v, the mean is that in the middle.
                    let share = |cell: u32| grid.share(cell) * frame.density(grid.centroid(cell));
                    area.extend((0..grid.len() as u32).map(|cell| face.area * share(cell)));
                } else if grid.is_adaptive() {
                    area.extend((0..grid.len() as u32).map(|cell| face.area * grid.share(cell)));
                } else {
                    area.resize(total as usize, face.area / grid.len() as f64);
                }
            }
        }
        Ok(Mesh { element_size, grids, first, side_of, area, adaptive })
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.side_of.len()
    }

    /// Elements may differ in size: [`Mesh::divided`] made them.
    pub fn is_adaptive(&self) -> bool {
        self.adaptive
    }

    /// How often a cell of the coarsest grid was divided for an element; 0 everywhere on a uniform mesh.
    pub fn levels(&self, element: u32) -> Levels {
        let (face, _, cell) = self.place(element);
        self.grid(face).levels(cell)
    }

    /// The sides that have elements.
    pub fn sides(&self) -> Sides {
        Sides(self.first.iter().map(|f| *f != NONE).collect())
    }

    /// No surface takes part in diffuse exchange.
    pub fn is_empty(&self) -> bool {
        self.side_of.is_empty()
    }

    /// The grid of a face.
    #[inline]
    pub fn grid(&self, face: u32) -> &Grid {
        &self.grids[face as usize]
    }

    /// First element of a side, or [`NONE`] where the side has no elements.
    #[inline]
    pub fn first(&self, face: u32, front: bool) -> u32 {
        self.first[side_index(face, front)]
    }

    /// The element at (u, v) of a side, or [`NONE`].
    #[inline]
    pub fn element(&self, face: u32, front: bool, u: f32, v: f32) -> u32 {
        match self.first(face, front) {
            NONE => NONE,
            first => first + self.grids[face as usize].cell(u, v),
        }
    }

    /// Face, side and cell of an element.
    #[inline]
    pub fn place(&self, element: u32) -> (u32, bool, u32) {
        let side = self.side_of[element as usize];
        (side / 2, side % 2 == 0, element - self.first[side as usize])
    }

    /// The side that an element is on, by [`side_index`].
    #[inline]
    pub fn side(&self, element: u32) -> u32 {
        self.side_of[element as usize]
    }

    /// The element on the other side of the same cell, or [`NONE`].
    pub fn opposite(&self, element: u32) -> u32 {
        let (face, front, cell) = self.place(element);
        match self.first(face, !front) {
            NONE => NONE,
            first => first + cell,
        }
    }

    /// Whether any element lies on the back of a face.
    pub fn has_backs(&self) -> bool {
        self.first.iter().skip(1).step_by(2).any(|first| *first != NONE)
    }

    /// Area of an element [m^2].
    #[inline]
    pub fn area(&self, element: u32) -> f64 {
        self.area[element as usize]
    }

    /// Centroid of an element [m, relative to the scene's centre].
    pub fn centroid(&self, scene: &Scene, element: u32) -> DVec3 {
        let (face, _, cell) = self.place(element);
        let grid = self.grid(face);
        scene.face_frame(&scene.faces[face as usize]).at(grid.centroid(cell))
    }

    /// Unit normal of an element, towards the side that it is on.
    pub fn normal(&self, scene: &Scene, element: u32) -> DVec3 {
        let (face, front, _) = self.place(element);
        let n = scene.faces[face as usize].normal;
        if front { n } else { -n }
    }
}
