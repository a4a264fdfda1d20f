//! What rays need to know of the side of a face that they land on, side by side in memory, for 16 at a time without branches.

use crate::embree::{Hits, LANES};
use crate::mesh::{Grid, Lattice, NONE, whole_part};
use crate::scene::{Face, from_halves};
use glam::Vec3;
use pulp::Simd;

/// Both sides of a face; the front comes first.
#[derive(Debug, Clone)]
pub struct FaceSides {
    /// Of the front.
    normal: Vec3,
    /// Of the face ([`Face`]).
    skew: [f32; 2],
    /// The cells of either side.
    pub grid: Grid,
    /// What the cells of a side are numbered from, or [`NONE`].
    pub first: [u32; 2],
    /// Bits with a meaning of the caller's.
    pub kind: [u8; 2],
}

/// What 16 lanes read of a face.
type Record = [u32; 8];

/// The faces of a scene, and one more that stands for none.
#[derive(Debug)]
pub struct SideTable {
    faces: Vec<FaceSides>,
    records: Vec<Record>,
    adaptive: bool,
    skewed: bool,
}

/// The sides that the rays of a packet landed on.
pub struct SideLanes<'t> {
    /// First number of the side, or [`NONE`].
    pub first: [u32; LANES],
    /// Kind of the side; 32 bits a lane, like all else, so that lanes go together.
    pub kind: [u32; LANES],
    face: [u32; LANES],
    /// (u, v) where they landed.
    u: [f32; LANES],
    v: [f32; LANES],
    nu: [u32; LANES],
    nv: [u32; LANES],
    triangle: [u32; LANES],
    table: &'t SideTable,
}

impl FaceSides {
    /// The sides of a face, with the cells of `grid`, numbered from `first`.
    pub fn new(face: &Face, grid: Grid, first: [u32; 2], kind: [u8; 2]) -> FaceSides {
        FaceSides { normal: face.normal.as_vec3(), skew: face.skew.as_vec2().to_array(), grid, first, kind }
    }

    /// A face without cells.
    pub fn bare(normal: Vec3, kind: [u8; 2]) -> FaceSides {
        let grid = Lattice { nu: 1, nv: 1, triangle: false }.into();
        FaceSides { normal, skew: [0.0; 2], grid, first: [NONE; 2], kind }
    }

    fn record(&self) -> Record {
        let [cx, cy] = self.skew.map(f32::to_bits);
        let lattice = &self.grid.lattice;
        let bits = u32::from(self.kind[0]) | u32::from(self.kind[1]) << 8 | u32::from(lattice.triangle) << 16;
        [self.first[0], self.first[1], bits, lattice.nu, lattice.nv, cx, cy, 0]
    }

    /// 0 for a ray that comes to the front, 1 for one that comes to the back.
    #[inline(always)]
    pub fn met(&self, direction: Vec3) -> usize {
        usize::from(self.normal.dot(direction) >= 0.0)
    }
}

impl SideTable {
    /// The table of faces, in their order; no face is of the kind `nothing`.
    pub fn new(faces: impl Iterator<Item = FaceSides>, nothing: u8) -> SideTable {
        let faces: Vec<FaceSides> = faces.chain([FaceSides::bare(Vec3::ZERO, [nothing; 2])]).collect();
        let records = faces.iter().map(FaceSides::record).collect();
        let adaptive = faces.iter().any(|t| t.grid.is_adaptive());
        let skewed = faces.iter().any(|t| t.skew != [0.0; 2]);
        SideTable { adaptive, skewed, records, faces }
    }

    /// The face that stands for none.
    #[inline(always)]
    pub fn none(&self) -> u32 {
        self.records.len() as u32 - 1
    }

    /// A face; one that there is not stands for none.
    #[inline(always)]
    pub fn face(&self, face: u32) -> &FaceSides {
        &self.faces[(face as usize).min(self.faces.len() - 1)]
    }

    /// Takes bits away from the kinds of all sides.
    pub fn without(&mut self, kind: u8) {
        self.faces.iter_mut().flat_map(|f| &mut f.kind).for_each(|k| *k &= !kind);
        self.records = self.faces.iter().map(FaceSides::record).collect();
    }

    /// The sides that the rays of a packet landed on, whose hits count nothing as [`SideTable::none`].
    ///
    /// No closures for lanes here: these would not be compiled for the wider registers.
    #[inline(always)]
    pub fn lanes<S: Simd>(&self, simd: S, hits: &Hits) -> SideLanes<'_> {
        let mut met = [&self.records[0]; LANES];
        for (met, face) in met.iter_mut().zip(hits.face) {
            *met = &self.records[face as usize];
        }
        let [front_first, back_first, bits, nu, nv, cx, cy, _] = fields(simd, met);
        let (mut first, mut kind, mut triangle) = ([0; LANES], [0; LANES], [0; LANES]);
        for l in 0..LANES {
            // All ones where the ray comes to the front: as a mask, LLVM leaves it in its lane. Adding zero takes the sign from -0.
            let front = ((hits.cosine[l] + 0.0).to_bits() as i32 >> 31) as u32;
            first[l] = back_first[l] ^ ((front_first[l] ^ back_first[l]) & front);
            kind[l] = bits[l] >> (8 & !front) & 0xff;
            triangle[l] = bits[l] >> 16;
        }
        let (mut u, mut v) = (hits.u, hits.v);
        if self.skewed {
            for l in 0..LANES {
                let skew = [f32::from_bits(cx[l]), f32::from_bits(cy[l])];
                (u[l], v[l]) = from_halves(skew, hits.u[l], hits.v[l]);
            }
        }
        SideLanes { first, kind, face: hits.face, u, v, nu, nv, triangle, table: self }
    }

    /// The cells that hold those of the finest lattice on these faces. Apart: its numbers would go from lane to lane one by one where
    /// no face is adaptive, too.
    #[inline(never)]
    fn holding(&self, face: [u32; LANES], cell: [u32; LANES]) -> [u32; LANES] {
        std::array::from_fn(|l| self.face(face[l]).grid.holding(cell[l]))
    }
}

/// The numbers of 16 records, each with those of the others.
///
/// Read lane by lane, they would go to memory one by one and come back in whole registers, which waits until the last of them is
/// there. That took a third of all time that rays took beside Embree's.
#[inline(always)]
fn fields<S: Simd>(simd: S, records: [&Record; LANES]) -> [[u32; LANES]; 8] {
    #[cfg(target_arch = "x86_64")]
    if let Some(v3) = (&simd as &dyn std::any::Any).downcast_ref::<pulp::x86::V3>() {
        let low = transposed(*v3, std::array::from_fn(|l| records[l]));
        let high = transposed(*v3, std::array::from_fn(|l| records[l + 8]));
        return std::array::from_fn(|c| {
            std::array::from_fn(|l| if l < 8 { low[c][l] } else { high[c][l - 8] })
        });
    }
    let _ = simd;
    std::array::from_fn(|c| std::array::from_fn(|l| records[l][c]))
}

/// Eight rows as columns.
///
/// No closures: these would not be compiled for the wider registers.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn transposed(v3: pulp::x86::V3, rows: [&Record; 8]) -> [Record; 8] {
    let (first, second) =
        (four(v3, [rows[0], rows[1], rows[2], rows[3]]), four(v3, [rows[4], rows[5], rows[6], rows[7]]));
    let mut columns = [[0; 8]; 8];
    for k in 0..4 {
        columns[k] = pulp::cast(v3.avx2._mm256_permute2x128_si256::<0x20>(first[k], second[k]));
        columns[k + 4] = pulp::cast(v3.avx2._mm256_permute2x128_si256::<0x31>(first[k], second[k]));
    }
    columns
}

/// Columns k and k + 4 of four rows, in the lower and the upper half of register k.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn four(v3: pulp::x86::V3, rows: [&Record; 4]) -> [std::arch::x86_64::__m256i; 4] {
    let [a, b, c, d] =
        [pulp::cast(*rows[0]), pulp::cast(*rows[1]), pulp::cast(*rows[2]), pulp::cast(*rows[3])];
    let (ab, cd) = (v3.avx2._mm256_unpacklo_epi32(a, b), v3.avx2._mm256_unpacklo_epi32(c, d));
    let (ab_high, cd_high) = (v3.avx2._mm256_unpackhi_epi32(a, b), v3.avx2._mm256_unpackhi_epi32(c, d));
    [
        v3.avx2._mm256_unpacklo_epi64(ab, cd),
        v3.avx2._mm256_unpackhi_epi64(ab, cd),
        v3.avx2._mm256_unpacklo_epi64(ab_high, cd_high),
        v3.avx2._mm256_unpackhi_epi64(ab_high, cd_high),
    ]
}

/// [`whole_part`] of the places of rays in squares.
#[inline(always)]
fn whole<S: Simd>(simd: S, x: [f32; LANES]) -> [i32; LANES] {
    let mut whole = [0; LANES];
    #[cfg(target_arch = "x86_64")]
    if let Some(v3) = (&simd as &dyn std::any::Any).downcast_ref::<pulp::x86::V3>() {
        for first in [0, 8] {
            let mut part = [0.0f32; 8];
            part.copy_from_slice(&x[first..first + 8]);
            let part: [i32; 8] = pulp::cast(v3.avx._mm256_cvttps_epi32(pulp::cast(part)));
            whole[first..first + 8].copy_from_slice(&part);
        }
        for whole in &mut whole {
            *whole = (*whole).max(0);
        }
        return whole;
    }
    let _ = simd;
    for (whole, x) in whole.iter_mut().zip(x) {
        *whole = whole_part(x);
    }
    whole
}

impl SideLanes<'_> {
    #[inline(always)]
    fn lattice(&self, l: usize) -> Lattice {
        Lattice { nu: self.nu[l], nv: self.nv[l], triangle: self.triangle[l] != 0 }
    }

    /// Numbers of the cells that the rays landed on, counted from [`SideLanes::first`]; [`NONE`] where the side has none.
    #[inline(always)]
    pub fn cells<S: Simd>(&self, simd: S) -> [u32; LANES] {
        let (mut fu, mut fv) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            (fu[l], fv[l]) = self.lattice(l).squares(self.u[l], self.v[l]);
        }
        let (iu, iv) = (whole(simd, fu), whole(simd, fv));
        let mut cell = [0; LANES];
        for (l, cell) in cell.iter_mut().enumerate() {
            *cell = self.lattice(l).cell_of((fu[l], fv[l]), (iu[l], iv[l]));
        }
        if self.table.adaptive {
            cell = self.table.holding(self.face, cell);
        }
        for (cell, first) in cell.iter_mut().zip(self.first) {
            let number = first.wrapping_add(*cell);
            *cell = if first == NONE { NONE } else { number };
        }
        cell
    }

    /// Local nodes of the cells that the rays landed on, and their weights there, as in [`Lattice::interpolation`].
    #[inline(always)]
    pub fn interpolation(&self) -> ([[u32; LANES]; 4], [[f32; LANES]; 4]) {
        let (mut nodes, mut weights) = ([[0; LANES]; 4], [[0.0; LANES]; 4]);
        for l in 0..LANES {
            let place = self.lattice(l).interpolation(self.u[l], self.v[l]);
            for k in 0..4 {
                (nodes[k][l], weights[k][l]) = (place.0[k], place.1[k]);
            }
        }
        if self.table.adaptive {
            for l in 0..LANES {
                let grid = &self.table.face(self.face[l]).grid;
                if grid.is_adaptive() {
                    let place = grid.interpolation(self.u[l], self.v[l]);
                    for k in 0..4 {
                        (nodes[k][l], weights[k][l]) = (place.0[k], place.1[k]);
                    }
                }
            }
        }
        (nodes, weights)
    }
}
