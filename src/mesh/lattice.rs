//! Regular lattices of cells on faces, by arithmetic.

use super::MOST_ELEMENTS;
use crate::sampling;
use crate::scene::{Face, FaceFrame, Scene};
use glam::{DVec2, DVec3};

/// Column, row, and whether a triangle's cell is an inverted one.
pub(super) type CellAt = (u32, u32, bool);

/// Origin and edge vectors of a cell in (u, v).
pub type CellFrame = (DVec2, DVec2, DVec2);

/// A regular lattice of cells on one face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Cells along u.
    pub nu: u32,
    /// Cells along v; equal to `nu` on a triangle.
    pub nv: u32,
    /// The face is a triangle.
    pub triangle: bool,
}

/// Most cells along an edge: what [`whole_part`] takes, and single precision still tells apart in (u, v).
pub(super) const MOST_ALONG: u32 = 1 << 22;

/// The whole part of a number in [0, 2^22]; others are clamped to that.
///
/// Rust's own conversion is done lane by lane: half of the time that it takes to find where 16 rays landed.
#[inline(always)]
pub fn whole_part(x: f32) -> i32 {
    // Numbers from here to twice as much are whole, and their lower bits count from zero.
    const WHOLE: f32 = (1 << 23) as f32;
    let x = x.max(0.0).min(MOST_ALONG as f32);
    let rounded = x + WHOLE;
    (rounded.to_bits() & ((1 << 23) - 1)) as i32 - i32::from(rounded - WHOLE > x)
}

impl Lattice {
    /// The lattice whose cell edges are at most `size` long.
    pub(super) fn of(scene: &Scene, face: &Face, size: f64) -> Lattice {
        let FaceFrame { e1, e2, twist, .. } = scene.face_frame(face);
        let cells = |l: f64| (l / size - 1e-9).ceil().clamp(1.0, f64::from(MOST_ELEMENTS)) as u32;
        let longer = |edge: DVec3| edge.length().max((edge + twist).length());
        if face.is_triangle() {
            let n = cells(e1.length().max(e2.length()).max((e2 - e1).length()));
            Lattice { nu: n, nv: n, triangle: true }
        } else {
            Lattice { nu: cells(longer(e1)), nv: cells(longer(e2)), triangle: false }
        }
    }

    /// Number of cells.
    pub fn len(&self) -> u64 {
        u64::from(self.nu) * u64::from(self.nv)
    }

    /// Never true: a lattice holds at least one cell.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The cell at (u, v), both in [0, 1], u + v <= 1 on a triangle; rounding outside is clamped.
    #[inline(always)]
    pub fn cell(&self, u: f32, v: f32) -> u32 {
        let (fu, fv) = self.squares(u, v);
        self.cell_of((fu, fv), (whole_part(fu), whole_part(fv)))
    }

    /// (u, v) in squares of the lattice.
    #[inline(always)]
    pub fn squares(&self, u: f32, v: f32) -> (f32, f32) {
        (u * self.nu as i32 as f32, v * self.nv as i32 as f32)
    }

    /// The cell at a place in squares, of which the whole parts are known.
    #[inline(always)]
    pub fn cell_of(&self, place: (f32, f32), whole: (i32, i32)) -> u32 {
        let (nu, triangle) = (self.nu as i32, i32::from(self.triangle));
        let (iu, iv, inner) = self.square(whole);
        let inverted = i32::from(inner & (place.0 + place.1 > (iu + iv + 1) as f32)) & triangle;
        (iv * (nu + (nu - iv) * triangle) + iu * (1 + triangle) + inverted) as u32
    }

    /// Column and row of a square from the whole parts of a place in squares, and whether it lies within a row: beyond its
    /// diagonal there is a triangle's inverted cell.
    ///
    /// No branches and nothing but 32-bit numbers: of many rays at a time, all lanes do the same. Numbers of cells fit 27 bits.
    #[inline(always)]
    fn square(&self, (iu, iv): (i32, i32)) -> (i32, i32, bool) {
        let (nu, nv) = (self.nu as i32, self.nv as i32);
        let iv = iv.min(nv - 1);
        let last = nu - 1 - iv * i32::from(self.triangle);
        let iu = iu.min(last);
        (iu, iv, iu < last)
    }

    /// First cell of row `iv` of a triangle: each row has two cells less than the one before.
    #[inline]
    fn row(&self, iv: u32) -> u32 {
        iv * (2 * self.nu - iv)
    }

    /// The number of a cell by column, row and, on a triangle, orientation.
    #[inline]
    pub(super) fn number(&self, (iu, iv, inverted): CellAt) -> u32 {
        if self.triangle { self.row(iv) + 2 * iu + u32::from(inverted) } else { iv * self.nu + iu }
    }

    /// Column and row of the block of two by two cells that a cell is in.
    pub fn block(&self, cell: u32) -> (u32, u32) {
        let (iu, iv, _) = self.at(cell);
        (iu / 2, iv / 2)
    }

    /// Column, row and orientation of a cell.
    pub(super) fn at(&self, cell: u32) -> CellAt {
        if self.triangle { self.triangle_cell(cell) } else { (cell % self.nu, cell / self.nu, false) }
    }

    /// The local index of the node at a column and a row.
    #[inline]
    pub(super) fn node(&self, iu: u32, iv: u32) -> u32 {
        if self.triangle { self.triangle_node(iu, iv) } else { iv * (self.nu + 1) + iu }
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
    pub fn cell_frame(&self, cell: u32) -> CellFrame {
        self.frame(self.at(cell))
    }

    /// [`Lattice::cell_frame`] of a cell by column, row and orientation.
    pub(super) fn frame(&self, (iu, iv, inverted): CellAt) -> CellFrame {
        let step = DVec2::new(1.0 / f64::from(self.nu), 1.0 / f64::from(self.nv));
        let origin = DVec2::new(f64::from(iu), f64::from(iv)) * step;
        if inverted {
            (origin + step, DVec2::new(-step.x, 0.0), DVec2::new(0.0, -step.y))
        } else {
            (origin, DVec2::new(step.x, 0.0), DVec2::new(0.0, step.y))
        }
    }

    /// (u, v) of a cell's point for (s, t) uniform in the unit square; uniform in (u, v).
    #[inline]
    pub fn cell_point(&self, frame: &CellFrame, s: f64, t: f64) -> DVec2 {
        let (s, t) = if self.triangle { sampling::triangle(s, t) } else { (s, t) };
        frame.0 + s * frame.1 + t * frame.2
    }

    /// Local node indices of a cell's corners: 4 for a quad (counter-clockwise), 3 and a
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

    /// Local nodes as in [`Lattice::cell_nodes`] of the cell at (u, v) as in [`Lattice::cell`], and their weights in linear
    /// (triangles; the last one is zero) or bilinear interpolation there.
    #[inline(always)]
    pub fn interpolation(&self, u: f32, v: f32) -> ([u32; 4], [f32; 4]) {
        let nu = self.nu as i32;
        let (fu, fv) = self.squares(u, v);
        let (iu, iv, inner) = self.square((whole_part(fu), whole_part(fv)));
        let (s, t) = (fu - iu as f32, fv - iv as f32);
        let beyond = inner & (s + t > 1.0);
        let (s, t) = (s.clamp(0.0, 1.0), t.clamp(0.0, 1.0));
        let (p, q) = (1.0 - s, 1.0 - t);
        // [`Lattice::triangle_node`]; the next row begins where this one ends.
        let before = iv * i32::from(self.triangle);
        let k = iv * (nu + 1) - before * (before - 1) / 2 + iu;
        let c = k + nu + 1 - before;
        let (nodes, weights) = match (self.triangle, beyond) {
            (false, _) => ([k, k + 1, c + 1, c], [p * q, s * q, s * t, p * t]),
            (true, true) => ([c + 1, c, k + 1, k + 1], [s + t - 1.0, p, q, 0.0]),
            (true, false) => ([k, k + 1, c, c], [p - t, s, t, 0.0]),
        };
        (nodes.map(|k| k as u32), weights)
    }

    fn triangle_node(&self, iu: u32, iv: u32) -> u32 {
        iv * (self.nu + 1) - iv * iv.saturating_sub(1) / 2 + iu
    }

    /// Cells along edge `edge`, which runs from corner `edge` to the next.
    pub fn edge_cells(&self, edge: usize) -> u32 {
        if edge % 2 == 0 { self.nu } else { self.nv }
    }

    /// Local index of the `k`-th node of an edge, 0 <= k <= [`Lattice::edge_cells`].
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

    /// Number of nodes.
    pub fn node_count(&self) -> u32 {
        if self.triangle { (self.nu + 1) * (self.nu + 2) / 2 } else { (self.nu + 1) * (self.nv + 1) }
    }

    /// (u, v) of every node, in the order of [`Lattice::cell_nodes`].
    pub fn node_points(&self) -> impl Iterator<Item = DVec2> + '_ {
        (0..=self.nv).flat_map(move |iv| {
            let last = if self.triangle { self.nu - iv } else { self.nu };
            (0..=last).map(move |iu| {
                DVec2::new(f64::from(iu) / f64::from(self.nu), f64::from(iv) / f64::from(self.nv))
            })
        })
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
                let grid = Lattice { nu, nv, triangle };
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
    fn whole_parts() {
        let most = MOST_ALONG as f32;
        for k in [0i32, 1, 2, 3, 77, 1 << 20, (1 << 22) - 1] {
            let x = k as f32;
            let next = |x: f32| f32::from_bits(x.to_bits() + 1);
            let before = |x: f32| f32::from_bits(x.to_bits() - 1);
            for y in [x, next(x), x + 0.25, x + 0.5, before(x + 1.0)] {
                assert_eq!(whole_part(y), k, "{y}");
            }
        }
        assert_eq!([-1.0, -0.0, f32::NAN, f32::NEG_INFINITY].map(whole_part), [0; 4]);
        assert_eq!([most, most + 1.0, 1e30, f32::INFINITY].map(whole_part), [1 << 22; 4]);
    }

    #[test]
    fn lookup_clamps_rounding() {
        let tri = Lattice { nu: 4, nv: 4, triangle: true };
        assert_eq!(tri.cell(1.0, 0.0), 6);
        assert_eq!(tri.cell(0.0, 1.0), 15);
        assert_eq!(tri.cell(-1e-7, 1.0000001), 15);
        assert_eq!(tri.cell(0.5000001, 0.5), tri.cell(0.49, 0.5));
        let quad = Lattice { nu: 3, nv: 2, triangle: false };
        assert_eq!(quad.cell(1.0, 1.0), 5);
        assert_eq!(quad.cell(-1e-7, -1e-7), 0);
    }
}
