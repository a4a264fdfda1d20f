//! The item buffer: which face each pixel of a hemi-cube sees, by a z-buffer on its five sides.
//!
//! A pixel's direction is `d = f + a r + b u` with the side's forward, right and up vectors. A convex polygon
//! as seen from the origin is where all of its edge functions `d . (p_k x p_(k+1))` have the sign of `p_0 . N`
//! (Olano and Greer 1997), also where some of its corners lie behind the side's plane: nothing has to be
//! clipped. Edge functions are linear in the pixel, so each scanline's span is where straight lines cross it.
//! Spans reach [`SEAM`] beyond those crossings, so that no pixel falls between two faces that meet along an edge, also
//! where the corners of one lie on the other's edge and rounding parts them; the z-buffer keeps one of the two. The
//! reciprocal depth `d . N / p_0 . N` is linear as well.

use super::delta::side_rows;
use crate::mesh::{Lattice, Mesh, NONE};
use crate::scene::{Scene, from_affine};
use glam::{DMat3, DVec3};

/// Sides of a hemi-cube; 0 is the top.
pub(super) const SIDES: usize = 5;

/// Forward, right and up of each side in the frame of the hemi-cube. Up of the four sides is the normal.
const BASES: [[DVec3; 3]; SIDES] = [
    [DVec3::Z, DVec3::X, DVec3::Y],
    [DVec3::X, DVec3::NEG_Y, DVec3::Z],
    [DVec3::NEG_X, DVec3::Y, DVec3::Z],
    [DVec3::Y, DVec3::X, DVec3::Z],
    [DVec3::NEG_Y, DVec3::NEG_X, DVec3::Z],
];

/// Below this share of its size, a face's plane passes through the eye: it is seen edge-on, as nothing.
const EDGE_ON: f64 = 1e-12;

/// How far beyond its edges a face is drawn, in pixels: more than rounding moves an edge, and too little to count.
const SEAM: f64 = 1e-6;

/// What a run of pixels sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Seen {
    /// An element.
    Element(u32),
    /// A side of a face without elements.
    Blocked,
    /// Nothing.
    Outside,
}

/// Pixels `from..to` of a row that see the same.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub side: usize,
    pub row: usize,
    pub from: usize,
    pub to: usize,
    pub seen: Seen,
}

/// A face in the frame of the hemi-cube.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    /// `d . normal / distance` is the reciprocal depth.
    normal: DVec3,
    distance: f64,
    /// Multiples of the face's edges at a pixel are `d . u / d . normal`, `d . v / d . normal`: (u, v), but for skewed faces.
    u: DVec3,
    v: DVec3,
    /// First element of the side that is seen.
    first: u32,
    face: u32,
    /// The cells of its face, or the finest of them.
    lattice: Lattice,
    /// Of its face.
    skew: [f32; 2],
}

/// A face on one side of the hemi-cube.
#[derive(Debug, Clone, Copy)]
struct Polygon {
    item: u32,
    /// First and last row that it may cover.
    low: u32,
    high: u32,
    lines: [Line; 4],
    count: u32,
    /// Reciprocal depth at (a, b) = (-1, 0), and its steps with b and with each pixel to the right.
    depth: f64,
    depth_up: f64,
    slope: f64,
}

/// Pixels that are drawn and read at a time, about: their depths and items stay in the first-level cache.
const BAND: usize = 2048;

/// The buffers of one thread: a band of rows, and the scene in the frame of the hemi-cube.
pub(super) struct ItemBuffer<'a> {
    scene: &'a Scene,
    mesh: &'a Mesh,
    resolution: usize,
    /// 0, 1, 2, ... for the fill.
    ramp: Vec<f32>,
    depth: Vec<f32>,
    item: Vec<u32>,
    vertices: Vec<DVec3>,
    codes: Vec<u8>,
    drawn: Vec<Drawn>,
    polygons: [Vec<Polygon>; SIDES],
    /// Polygons of the side under way that reach into the band under way.
    active: Vec<u32>,
    cells: Vec<u32>,
}

impl<'a> ItemBuffer<'a> {
    pub fn new(scene: &'a Scene, mesh: &'a Mesh, resolution: usize) -> ItemBuffer<'a> {
        let pixels = resolution * (BAND / resolution).clamp(1, resolution);
        ItemBuffer {
            scene,
            mesh,
            resolution,
            ramp: (0..resolution).map(|k| k as f32).collect(),
            depth: vec![0.0; pixels],
            item: vec![NONE; pixels],
            vertices: vec![DVec3::ZERO; scene.vertices.len()],
            codes: vec![0; scene.vertices.len()],
            drawn: Vec::new(),
            polygons: Default::default(),
            active: Vec::new(),
            cells: vec![0; resolution],
        }
    }

    /// Rows of a side.
    pub fn rows(&self, side: usize) -> usize {
        if side == 0 { self.resolution } else { side_rows(self.resolution) }
    }

    /// b of the middle of a side's first row, and its step from row to row.
    fn row_scale(&self, side: usize) -> (f64, f64) {
        let n = self.resolution as f64;
        let rows = self.rows(side) as f64;
        if side == 0 { (1.0 / n - 1.0, 2.0 / n) } else { (0.5 / rows, 1.0 / rows) }
    }

    /// Draws all faces but `own` as seen from `eye`, in the frame of `axes` (the last is the normal), and calls `visit` with
    /// every pixel of every side, in spans that see one element, blocked or outside.
    #[inline]
    pub fn draw(&mut self, eye: DVec3, axes: [DVec3; 3], own: u32, mut visit: impl FnMut(Span)) {
        self.prepare(eye, axes, own);
        let n = self.resolution;
        let band = self.item.len() / n;
        for side in 0..SIDES {
            let rows = self.rows(side);
            self.polygons[side].sort_unstable_by_key(|p| (p.low, p.item));
            self.active.clear();
            let mut next = 0;
            for start in (0..rows).step_by(band) {
                let end = (start + band).min(rows);
                let polygons = &self.polygons[side];
                while polygons.get(next).is_some_and(|p| (p.low as usize) < end) {
                    self.active.push(next as u32);
                    next += 1;
                }
                self.band(side, start, end);
                let polygons = &self.polygons[side];
                self.active.retain(|p| polygons[*p as usize].high as usize >= end);
                for row in start..end {
                    self.read(side, row, (row - start) * n, &mut visit);
                }
            }
        }
    }

    fn prepare(&mut self, eye: DVec3, axes: [DVec3; 3], own: u32) {
        self.drawn.clear();
        self.polygons.iter_mut().for_each(Vec::clear);
        let to_local = DMat3::from_cols(axes[0], axes[1], axes[2]).transpose();
        for ((local, code), v) in self.vertices.iter_mut().zip(&mut self.codes).zip(&self.scene.vertices) {
            *local = to_local * (*v - eye);
            *code = outside_planes(*local);
        }
        for (k, face) in self.scene.faces.iter().enumerate() {
            let [a, b, c, d] = face.vertices.map(|v| self.codes[v as usize]);
            let (all, any) = (a & b & c & d, a | b | c | d);
            // Behind the plane of the element, or its own face.
            if all & BELOW != 0 || k as u32 == own {
                continue;
            }
            let sides = sides_met(all, any);
            if sides != 0 {
                self.face(k, sides);
            }
        }
    }

    fn face(&mut self, k: usize, sides: u8) {
        let face = &self.scene.faces[k];
        let corners = face.vertices.map(|v| self.vertices[v as usize]);
        let (p0, e1, e2) = (corners[0], corners[1] - corners[0], corners[3] - corners[0]);
        let normal = e1.cross(e2);
        let distance = p0.dot(normal);
        let reach = corners.iter().map(|p| p.length_squared()).fold(0.0, f64::max);
        if distance * distance <= EDGE_ON * EDGE_ON * normal.length_squared() * reach {
            return;
        }
        let front = distance < 0.0;
        let item = self.drawn.len() as u32;
        self.drawn.push(Drawn {
            normal,
            distance,
            u: e2.cross(p0),
            v: p0.cross(e1),
            first: self.mesh.first(k as u32, front),
            face: k as u32,
            lattice: self.mesh.grid(k as u32).lattice,
            skew: face.skew.as_vec2().to_array(),
        });
        let count = if face.is_triangle() { 3 } else { 4 };
        let mut edges = [DVec3::ZERO; 4];
        for i in 0..count {
            edges[i] = corners[i].cross(corners[(i + 1) % count]);
        }
        for side in (0..SIDES).filter(|s| sides >> s & 1 == 1) {
            self.polygon(side, item, &corners[..count], &edges[..count]);
        }
    }

    /// Sets up a convex polygon on one side.
    fn polygon(&mut self, side: usize, item: u32, corners: &[DVec3], edges: &[DVec3]) {
        let n = self.resolution;
        let [forward, right, up] = BASES[side];
        let rows = self.rows(side) as f64;
        let face = self.drawn[item as usize];
        let (first, step) = self.row_scale(side);
        let (low, high) = extent(corners, forward, up);
        let row = |b: f64| ((b - first) / step).clamp(-1.0, rows);
        // A hundredth of a row covers rounding.
        let (low, high) = ((row(low) - 0.01).max(0.0).ceil(), (row(high) + 0.01).min(rows - 1.0).floor());
        if low > high {
            return;
        }
        let sign = face.distance.signum();
        let mut lines = [Line::default(); 4];
        for (line, e) in lines.iter_mut().zip(edges) {
            *line = Line::new(sign * e.dot(forward), sign * e.dot(right), sign * e.dot(up), n);
        }
        let depth = [forward, right, up].map(|axis| face.normal.dot(axis) / face.distance);
        self.polygons[side].push(Polygon {
            item,
            low: low as u32,
            high: high as u32,
            lines,
            count: edges.len() as u32,
            depth: depth[0] - depth[1],
            depth_up: depth[2],
            slope: depth[1] * 2.0 / n as f64,
        });
    }

    /// Fills rows `start..end` of a side from the active polygons.
    fn band(&mut self, side: usize, start: usize, end: usize) {
        let n = self.resolution;
        let (first, step) = self.row_scale(side);
        self.depth.fill(0.0);
        self.item.fill(NONE);
        for &p in &self.active {
            let polygon = &self.polygons[side][p as usize];
            let lines = &polygon.lines[..polygon.count as usize];
            for row in start.max(polygon.low as usize)..end.min(polygon.high as usize + 1) {
                let b = first + step * row as f64;
                let (mut from, mut to) = (0, n);
                for line in lines {
                    line.cut(b, n, &mut from, &mut to);
                }
                if from >= to {
                    continue;
                }
                let depth = polygon.depth + polygon.depth_up * b + polygon.slope * (from as f64 + 0.5);
                let (a, z) = ((row - start) * n + from, (row - start) * n + to);
                fill(
                    &mut self.depth[a..z],
                    &mut self.item[a..z],
                    &self.ramp[..z - a],
                    (depth as f32, polygon.slope as f32, polygon.item),
                );
            }
        }
    }

    /// Visits a row, which starts at `start` in the band.
    #[inline]
    fn read(&mut self, side: usize, row: usize, start: usize, visit: &mut impl FnMut(Span)) {
        let n = self.resolution;
        let pixel = 2.0 / n as f64;
        let [forward, right, up] = BASES[side];
        let (first, step) = self.row_scale(side);
        let b = first + step * row as f64;
        let items = &self.item[start..start + n];
        let mut from = 0;
        while from < n {
            let item = items[from];
            let to = from + run(&items[from..]);
            let mut tell = |from, to, seen| visit(Span { side, row, from, to, seen });
            match self.drawn.get(item as usize) {
                None => tell(from, to, Seen::Outside),
                Some(face) if face.first == NONE => tell(from, to, Seen::Blocked),
                Some(face) if face.lattice.len() == 1 => tell(from, to, Seen::Element(face.first)),
                Some(face) => {
                    let direction = forward + (pixel * (from as f64 + 0.5) - 1.0) * right + b * up;
                    let cells = &mut self.cells[..to - from];
                    locate(face, direction, pixel * right, &self.ramp, cells);
                    let grid = self.mesh.grid(face.face);
                    if grid.is_adaptive() {
                        cells.iter_mut().for_each(|c| *c = grid.holding(*c));
                    }
                    let mut k = 0;
                    while k < cells.len() {
                        let cell = cells[k];
                        let end = k + cells[k..].iter().take_while(|c| **c == cell).count();
                        tell(from + k, from + end, Seen::Element(face.first + cell));
                        k = end;
                    }
                }
            }
            from = to;
        }
    }
}

/// How many leading items are equal, eight at a time.
#[inline]
fn run(items: &[u32]) -> usize {
    let first = items[0];
    let whole = |chunk: &&[u32]| chunk.iter().fold(true, |same, i| same & (*i == first));
    let start = 8 * items.chunks_exact(8).take_while(whole).count();
    start + items[start..].iter().take_while(|i| **i == first).count()
}

/// Keeps the nearer of two reciprocal depths. The vectoriser makes selections of it, four lanes at a time.
#[inline]
fn fill(depth: &mut [f32], item: &mut [u32], ramp: &[f32], (start, slope, face): (f32, f32, u32)) {
    for ((z, i), k) in depth.iter_mut().zip(item).zip(ramp) {
        let w = start + slope * k;
        let nearer = w > *z;
        *z = if nearer { w } else { *z };
        *i = if nearer { face } else { *i };
    }
}

/// Adding it to a number from 0 to half of it rounds that to the nearest whole one, which then stands in the lowest bits:
/// conversions of numbers that may be out of range do not vectorise.
const ROUND: f32 = 8_388_608.0;
/// Cells of a lattice from which on their numbers leave that range.
const MOST_WHOLE: u64 = 1 << 22;

/// The cell of a face in each of a run of pixels, from the direction to the first and its step.
///
/// As [`Lattice::cell`], but for what lies on the line between two cells to rounding.
#[inline]
fn locate(face: &Drawn, direction: DVec3, step: DVec3, ramp: &[f32], cells: &mut [u32]) {
    let linear = |v: DVec3| (direction.dot(v) as f32, step.dot(v) as f32);
    let (grid, (d0, d1)) = (face.lattice, linear(face.normal));
    let (u0, u1) = linear(face.u * f64::from(grid.nu));
    let (v0, v1) = linear(face.v * f64::from(grid.nv));
    let (nu, nv) = (grid.nu as f32, grid.nv as f32);
    if grid.len() >= MOST_WHOLE || face.skew != [0.0; 2] {
        for (cell, k) in cells.iter_mut().zip(ramp) {
            let scale = 1.0 / (d0 + d1 * k);
            // Without a skew these are (u, v) themselves.
            let (u, v) = from_affine(face.skew, (u0 + u1 * k) * scale / nu, (v0 + v1 * k) * scale / nv);
            *cell = grid.cell(u, v);
        }
        return;
    }
    // The whole part, of 0.5 to one half less than the number of cells.
    let whole = |x: f32| (x - 0.5) + ROUND - ROUND;
    let number = |x: f32| (x + ROUND).to_bits() - ROUND.to_bits();
    if grid.triangle {
        for (cell, k) in cells.iter_mut().zip(ramp) {
            let scale = 1.0 / (d0 + d1 * k);
            let (fu, fv) = ((u0 + u1 * k) * scale, (v0 + v1 * k) * scale);
            let iv = whole(fv.max(0.5).min(nv - 0.5));
            let last = nu - 1.0 - iv;
            let iu = whole(fu.max(0.5).min(last + 0.5));
            let inverted = if (fu - iu) + (fv - iv) > 1.0 { 1.0 } else { 0.0 };
            // The last cell of a row stands alone.
            let along = (2.0 * iu + inverted).min(2.0 * last);
            *cell = number(iv * (2.0 * nu - iv) + along);
        }
    } else {
        for (cell, k) in cells.iter_mut().zip(ramp) {
            let scale = 1.0 / (d0 + d1 * k);
            let iu = whole(((u0 + u1 * k) * scale).max(0.5).min(nu - 0.5));
            let iv = whole(((v0 + v1 * k) * scale).max(0.5).min(nv - 0.5));
            *cell = number(iv * nu + iu);
        }
    }
}

/// Where an edge function is positive on the scanlines of a side.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    /// The crossing at b is `at + by * b`, in pixels.
    at: f64,
    by: f64,
    /// Positive to the right of the crossing (1), to the left (-1), or parallel to the scanlines (0).
    inside: i8,
    /// The function itself, for parallel ones.
    value: f64,
    up: f64,
}

impl Line {
    /// The function `forward + a right + b up`, moved outwards by [`SEAM`].
    fn new(forward: f64, right: f64, up: f64, n: usize) -> Line {
        let half = 0.5 * n as f64;
        // a = x / half - 1 at x pixels from the left: zero where x = half - half (forward + b up) / right.
        if right.abs() <= 1e-18 * (forward.abs() + up.abs()) {
            let seam = SEAM / half * (forward.abs() + up.abs());
            return Line { value: forward - right + seam, up, ..Line::default() };
        }
        Line {
            at: half - half * (forward / right) - SEAM.copysign(right),
            by: -half * (up / right),
            inside: if right > 0.0 { 1 } else { -1 },
            value: 0.0,
            up,
        }
    }

    /// Narrows a row's span of pixels to those whose middles lie inside.
    #[inline]
    fn cut(&self, b: f64, n: usize, from: &mut usize, to: &mut usize) {
        if self.inside == 0 {
            if self.value + self.up * b < 0.0 {
                *to = 0;
            }
            return;
        }
        let x = (self.at + self.by * b - 0.5).max(0.0).min(n as f64);
        // `ceil` is a function call on the oldest 64-bit processors.
        let whole = x as i32;
        let pixel = (whole + i32::from(x > f64::from(whole))) as usize;
        if self.inside > 0 {
            *from = (*from).max(pixel);
        } else {
            *to = (*to).min(pixel);
        }
    }
}

/// Range of b that a polygon covers on a side, conservatively.
fn extent(corners: &[DVec3], forward: DVec3, up: DVec3) -> (f64, f64) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (k, p) in corners.iter().enumerate() {
        let q = corners[(k + 1) % corners.len()];
        let (w, next) = (p.dot(forward), q.dot(forward));
        if w > 0.0 {
            let b = p.dot(up) / w;
            (low, high) = (low.min(b), high.max(b));
        }
        if (w > 0.0) != (next > 0.0) {
            // Towards the side's own plane an edge runs to infinity, up or down.
            let crossing = p.dot(up) * (next - w) - w * (q.dot(up) - p.dot(up));
            let upwards = crossing * (next - w).signum();
            if upwards >= 0.0 {
                high = f64::INFINITY;
            }
            if upwards <= 0.0 {
                low = f64::NEG_INFINITY;
            }
        }
    }
    (low, high)
}

const BELOW: u8 = 1 << 6;

/// On which sides of the planes between the hemi-cube's sides a point lies; bit 6: not above the element.
#[inline]
fn outside_planes(p: DVec3) -> u8 {
    u8::from(p.x > p.z)
        | u8::from(p.x < -p.z) << 1
        | u8::from(p.y > p.z) << 2
        | u8::from(p.y < -p.z) << 3
        | u8::from(p.x > p.y) << 4
        | u8::from(p.x > -p.y) << 5
        | u8::from(p.z <= 0.0) << 6
}

/// The sides that a polygon may be seen on, from the codes that all of its corners share and that any has: it is not where
/// all corners lie outside of one of the side's planes.
#[inline]
fn sides_met(all: u8, any: u8) -> u8 {
    let none = !any;
    let has = |code: u8, bits: u8| code & bits != 0;
    let top = !has(all, 0b1111);
    // x >= z, x >= y, x >= -y.
    let x = !has(none, 1 | 1 << 4 | 1 << 5);
    // x <= -z, x <= y, x <= -y.
    let minus_x = !has(none, 1 << 1) && !has(all, 1 << 4 | 1 << 5);
    let y = !has(none, 1 << 2 | 1 << 5) && !has(all, 1 << 4);
    let minus_y = !has(none, 1 << 3 | 1 << 4) && !has(all, 1 << 5);
    u8::from(top) | u8::from(x) << 1 | u8::from(minus_x) << 2 | u8::from(y) << 3 | u8::from(minus_y) << 4
}
