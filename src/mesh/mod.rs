//! Faces divided into elements, and (face, u, v) to element by arithmetic.
//!
//! Embree holds faces only; an element is a cell of a regular grid on one side of a face. A
//! parallelogram has `nu x nv` cells; a triangle has `n * n` congruent triangles, row by row, an
//! upright and an inverted one in turn.

mod patch;

pub use patch::Nodes;

use crate::sampling;
use crate::scene::{Face, Scene};
use crate::{Error, Result};
use glam::{DVec2, DVec3};

/// No element.
pub const NONE: u32 = u32::MAX;

/// Most elements of a scene: their factors alone would take tens of gigabytes.
const MOST_ELEMENTS: u32 = 1 << 27;

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

/// The regular grid of one face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Cells along u.
    pub nu: u32,
    /// Cells along v; equal to `nu` on a triangle.
    pub nv: u32,
    /// The face is a triangle.
    pub triangle: bool,
}

impl Grid {
    /// The grid whose cell edges are at most `size` long.
    fn of(scene: &Scene, face: &Face, size: f64) -> Grid {
        let (_, e1, e2) = scene.face_frame(face);
        let cells = |l: f64| (l / size - 1e-9).ceil().clamp(1.0, f64::from(MOST_ELEMENTS)) as u32;
        if face.is_triangle() {
            let n = cells(e1.length().max(e2.length()).max((e2 - e1).length()));
            Grid { nu: n, nv: n, triangle: true }
        } else {
            Grid { nu: cells(e1.length()), nv: cells(e2.length()), triangle: false }
        }
    }

    /// Number of cells.
    pub fn len(&self) -> u64 {
        u64::from(self.nu) * u64::from(self.nv)
    }

    /// Never true: a grid holds at least one cell.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The cell at (u, v), both in [0, 1], u + v <= 1 on a triangle; rounding outside is clamped.
    #[inline]
    pub fn cell(&self, u: f32, v: f32) -> u32 {
        let (fu, fv) = (u * self.nu as f32, v * self.nv as f32);
        let iv = (fv.max(0.0) as u32).min(self.nv - 1);
        let iu = fu.max(0.0) as u32;
        if !self.triangle {
            return iv * self.nu + iu.min(self.nu - 1);
        }
        let last = self.nu - 1 - iv;
        if iu >= last {
            return self.row(iv) + 2 * last;
        }
        let inverted = (fu - iu as f32) + (fv - iv as f32) > 1.0;
        self.row(iv) + 2 * iu + u32::from(inverted)
    }

    /// First cell of row `iv` of a triangle: each row has two cells less than the one before.
    #[inline]
    fn row(&self, iv: u32) -> u32 {
        iv * (2 * self.nu - iv)
    }

    /// Row, column and orientation of a triangle's cell.
    fn triangle_cell(&self, cell: u32) -> (u32, u32, bool) {
        let n = f64::from(self.nu);
        // iv solves iv (2 n - iv) <= cell; the square root may be off by one at exact squares.
        let mut iv = (n - (n * n - f64::from(cell)).max(0.0).sqrt()) as u32;
        iv = iv.min(self.nu - 1);
        while iv > 0 && self.row(iv) > cell {
            iv -= 1;
        }
        while iv + 1 < self.nu && self.row(iv + 1) <= cell {
            iv += 1;
        }
        let k = cell - self.row(iv);
        (k / 2, iv, k % 2 == 1)
    }

    /// A cell's origin and its two edge vectors in (u, v).
    pub fn cell_frame(&self, cell: u32) -> (DVec2, DVec2, DVec2) {
        let step = DVec2::new(1.0 / f64::from(self.nu), 1.0 / f64::from(self.nv));
        if !self.triangle {
            let (iu, iv) = (cell % self.nu, cell / self.nu);
            let origin = DVec2::new(f64::from(iu), f64::from(iv)) * step;
            return (origin, DVec2::new(step.x, 0.0), DVec2::new(0.0, step.y));
        }
        let (iu, iv, inverted) = self.triangle_cell(cell);
        let origin = DVec2::new(f64::from(iu), f64::from(iv)) * step;
        if inverted {
            (origin + step, DVec2::new(-step.x, 0.0), DVec2::new(0.0, -step.y))
        } else {
            (origin, DVec2::new(step.x, 0.0), DVec2::new(0.0, step.y))
        }
    }

    /// (u, v) of a cell's point for (s, t) uniform in the unit square; uniform in area.
    #[inline]
    pub fn cell_point(&self, frame: &(DVec2, DVec2, DVec2), s: f64, t: f64) -> DVec2 {
        let (s, t) = if self.triangle { sampling::triangle(s, t) } else { (s, t) };
        frame.0 + s * frame.1 + t * frame.2
    }

    /// Local node indices of a cell's corners: 4 for a parallelogram (counter-clockwise), 3 and a
    /// repeat for a triangle.
    pub fn cell_nodes(&self, cell: u32) -> [u32; 4] {
        if !self.triangle {
            let (iu, iv) = (cell % self.nu, cell / self.nu);
            let k = iv * (self.nu + 1) + iu;
            return [k, k + 1, k + self.nu + 2, k + self.nu + 1];
        }
        let (iu, iv, inverted) = self.triangle_cell(cell);
        let at = |iu: u32, iv: u32| self.triangle_node(iu, iv);
        if inverted {
            let c = at(iu, iv + 1);
            [at(iu + 1, iv + 1), c, at(iu + 1, iv), at(iu + 1, iv)]
        } else {
            let c = at(iu, iv + 1);
            [at(iu, iv), at(iu + 1, iv), c, c]
        }
    }

    /// Local nodes as in [`Grid::cell_nodes`] of the cell at (u, v) as in [`Grid::cell`], and their weights in linear
    /// (triangles; the last one is zero) or bilinear interpolation there.
    #[inline]
    pub fn interpolation(&self, u: f32, v: f32) -> ([u32; 4], [f32; 4]) {
        let (fu, fv) = (u * self.nu as f32, v * self.nv as f32);
        let iv = (fv.max(0.0) as u32).min(self.nv - 1);
        let last = if self.triangle { self.nu - 1 - iv } else { self.nu - 1 };
        let iu = (fu.max(0.0) as u32).min(last);
        let (s, t) = ((fu - iu as f32).clamp(0.0, 1.0), (fv - iv as f32).clamp(0.0, 1.0));
        if !self.triangle {
            let k = iv * (self.nu + 1) + iu;
            let (p, q) = (1.0 - s, 1.0 - t);
            return ([k, k + 1, k + self.nu + 2, k + self.nu + 1], [p * q, s * q, s * t, p * t]);
        }
        let k = self.triangle_node(iu, iv);
        // The next row begins where this one ends.
        let c = k + self.nu + 1 - iv;
        if iu < last && s + t > 1.0 {
            ([c + 1, c, k + 1, k + 1], [s + t - 1.0, 1.0 - s, 1.0 - t, 0.0])
        } else {
            ([k, k + 1, c, c], [1.0 - s - t, s, t, 0.0])
        }
    }

    fn triangle_node(&self, iu: u32, iv: u32) -> u32 {
        iv * (self.nu + 1) - iv * iv.saturating_sub(1) / 2 + iu
    }

    /// Cells along edge `edge`, which runs from corner `edge` to the next.
    pub fn edge_cells(&self, edge: usize) -> u32 {
        if edge % 2 == 0 { self.nu } else { self.nv }
    }

    /// Local index of the `k`-th node of an edge, 0 <= k <= [`Grid::edge_cells`].
    pub fn edge_node(&self, edge: usize, k: u32) -> u32 {
        let (nu, nv) = (self.nu, self.nv);
        if self.triangle {
            return match edge {
                0 => self.triangle_node(k, 0),
                1 => self.triangle_node(nu - k, k),
                _ => self.triangle_node(0, nu - k),
            };
        }
        let (iu, iv) = match edge {
            0 => (k, 0),
            1 => (nu, k),
            2 => (nu - k, nv),
            _ => (0, nv - k),
        };
        iv * (nu + 1) + iu
    }

    /// Number of grid nodes.
    pub fn node_count(&self) -> u32 {
        if self.triangle { (self.nu + 1) * (self.nu + 2) / 2 } else { (self.nu + 1) * (self.nv + 1) }
    }

    /// (u, v) of every node, in the order of [`Grid::cell_nodes`].
    pub fn node_points(&self) -> impl Iterator<Item = DVec2> + '_ {
        (0..=self.nv).flat_map(move |iv| {
            let last = if self.triangle { self.nu - iv } else { self.nu };
            (0..=last).map(move |iu| {
                DVec2::new(f64::from(iu) / f64::from(self.nu), f64::from(iv) / f64::from(self.nv))
            })
        })
    }
}

/// All elements of a scene.
///
/// Elements of one side of a face are numbered in a row, in the order of the grid's cells.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// Largest cell edge asked for \[m\].
    pub element_size: f64,
    grids: Vec<Grid>,
    /// First element of each side, or [`NONE`].
    first: Vec<u32>,
    /// Side index of each element.
    side_of: Vec<u32>,
    area: Vec<f64>,
}

/// An element size fit for the scene's extent: a fixed share of the square root of its area.
///
/// The share makes about 5,000 elements of a simple room.
pub fn default_element_size(scene: &Scene) -> f64 {
    let area: f64 = scene.faces.iter().map(|f| f.area).sum();
    (area / 3000.0).sqrt()
}

impl Mesh {
    /// Divides the given sides of a scene's faces into cells with edges of at most `element_size` \[m\].
    ///
    /// Sides whose material neither reflects nor transmits diffusely get no elements unless
    /// `with_black` asks for them (form factors do not care for materials).
    pub fn new(scene: &Scene, sides: &Sides, element_size: f64, with_black: bool) -> Result<Mesh> {
        if element_size.is_nan() || element_size <= 0.0 {
            return Err(Error::Usage(format!("element size {element_size} m: must be above zero")));
        }
        let mut grids: Vec<Grid> = scene.faces.iter().map(|f| Grid::of(scene, f, element_size)).collect();
        // Triangles of one polygon meet along its diagonals: equal grids make their nodes coincide.
        let mut finest = vec![1u32; scene.polygon_count.max(1)];
        for (face, grid) in scene.faces.iter().zip(&grids).filter(|(_, g)| g.triangle) {
            let n = &mut finest[face.polygon as usize];
            *n = (*n).max(grid.nu);
        }
        for (face, grid) in scene.faces.iter().zip(&mut grids).filter(|(_, g)| g.triangle) {
            (grid.nu, grid.nv) = (finest[face.polygon as usize], finest[face.polygon as usize]);
        }
        patch::nest(scene, &mut grids);
        let (mut first, mut side_of, mut area) = (vec![NONE; 2 * scene.faces.len()], Vec::new(), Vec::new());
        let mut total = 0u64;
        for (k, (face, grid)) in scene.faces.iter().zip(&grids).enumerate() {
            let material = scene.material(face);
            for front in [true, false] {
                let side = side_index(k as u32, front);
                // A black emitter gathers nothing, but its power must be accounted for.
                let diffuse = material.is_diffuse() && (front || material.two_sided);
                let used = with_black || diffuse || material.emitted(front).max_element() > 0.0;
                if !sides.0[side] || !used {
                    continue;
                }
                first[side] = total as u32;
                total += grid.len();
                if total > u64::from(MOST_ELEMENTS) {
                    return Err(Error::Usage(format!(
                        "element size {element_size} m makes more than {MOST_ELEMENTS} elements: choose a larger --element-size"
                    )));
                }
                side_of.resize(total as usize, side as u32);
                area.resize(total as usize, face.area / grid.len() as f64);
            }
        }
        Ok(Mesh { element_size, grids, first, side_of, area })
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.side_of.len()
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

    /// Area of an element [m^2].
    #[inline]
    pub fn area(&self, element: u32) -> f64 {
        self.area[element as usize]
    }

    /// Centroid of an element [m, relative to the scene's centre].
    pub fn centroid(&self, scene: &Scene, element: u32) -> DVec3 {
        let (face, _, cell) = self.place(element);
        let grid = self.grid(face);
        let (o, a, b) = grid.cell_frame(cell);
        let uv = o + (a + b) / if grid.triangle { 3.0 } else { 2.0 };
        let (p0, e1, e2) = scene.face_frame(&scene.faces[face as usize]);
        p0 + uv.x * e1 + uv.y * e2
    }

    /// Unit normal of an element, towards the side that it is on.
    pub fn normal(&self, scene: &Scene, element: u32) -> DVec3 {
        let (face, front, _) = self.place(element);
        let n = scene.faces[face as usize].normal;
        if front { n } else { -n }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every cell of every small grid: inner points name their own cell, corners match the nodes,
    /// areas add up.
    #[test]
    fn lookup_agrees_with_geometry_on_every_cell() {
        for triangle in [false, true] {
            for (nu, nv) in (1..=13).flat_map(|a| (1..=13).map(move |b| (a, b))).chain([(200, 200), (255, 3)])
            {
                if triangle && nu != nv {
                    continue;
                }
                let grid = Grid { nu, nv, triangle };
                let nodes: Vec<DVec2> = grid.node_points().collect();
                assert_eq!(nodes.len(), grid.node_count() as usize);
                let mut area = 0.0;
                for cell in 0..grid.len() as u32 {
                    let frame = grid.cell_frame(cell);
                    area += frame.1.perp_dot(frame.2) * if triangle { 0.5 } else { 1.0 };
                    for (s, t) in [(0.5, 0.5), (0.01, 0.02), (0.98, 0.99), (0.02, 0.97), (0.97, 0.02)] {
                        let p = grid.cell_point(&frame, s, t);
                        assert_eq!(grid.cell(p.x as f32, p.y as f32), cell, "{grid:?} {cell} {p}");
                    }
                    let ids = grid.cell_nodes(cell);
                    let centre = if triangle { 1.0 / 3.0 } else { 0.5 };
                    for (s, t) in [(centre, centre), (0.1, 0.2), (0.7, 0.2), (0.2, 0.7)] {
                        let p = frame.0 + s * frame.1 + t * frame.2;
                        let (found, weights) = grid.interpolation(p.x as f32, p.y as f32);
                        let expected = if triangle {
                            [1.0 - s - t, s, t, 0.0]
                        } else {
                            [(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t]
                        };
                        assert_eq!(found, ids, "{grid:?} {cell} {p}");
                        for (a, b) in weights.iter().zip(expected) {
                            assert!((f64::from(*a) - b).abs() < 1e-4, "{grid:?} {cell}: {weights:?}");
                        }
                    }
                    let corners = ids.map(|k| nodes[k as usize]);
                    let expected = if triangle {
                        [frame.0, frame.0 + frame.1, frame.0 + frame.2, frame.0 + frame.2]
                    } else {
                        [frame.0, frame.0 + frame.1, frame.0 + frame.1 + frame.2, frame.0 + frame.2]
                    };
                    let mut close = corners.map(|c| expected.iter().any(|e| e.distance(c) < 1e-12));
                    if triangle {
                        close[3] = true;
                    }
                    assert_eq!(close, [true; 4], "{grid:?} {cell}: {corners:?} {expected:?}");
                }
                assert!((area - if triangle { 0.5 } else { 1.0 }).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn lookup_clamps_rounding() {
        let tri = Grid { nu: 4, nv: 4, triangle: true };
        assert_eq!(tri.cell(1.0, 0.0), 6);
        assert_eq!(tri.cell(0.0, 1.0), 15);
        assert_eq!(tri.cell(-1e-7, 1.0000001), 15);
        assert_eq!(tri.cell(0.5000001, 0.5), tri.cell(0.49, 0.5));
        let quad = Grid { nu: 3, nv: 2, triangle: false };
        assert_eq!(quad.cell(1.0, 1.0), 5);
        assert_eq!(quad.cell(-1e-7, -1e-7), 0);
    }
}
