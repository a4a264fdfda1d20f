//! What rays need to know of the side of a face that they land on, side by side in memory, for 16 at a time without branches.

use crate::embree::{Hits, LANES, RayLanes};
use crate::mesh::{Grid, Lattice, NONE};
use glam::Vec3;

/// Both sides of a face; the front comes first.
#[derive(Debug, Clone)]
pub struct FaceSides {
    /// Of the front.
    pub normal: Vec3,
    /// The cells of either side.
    pub grid: Grid,
    /// What the cells of a side are numbered from, or [`NONE`].
    pub first: [u32; 2],
    /// Bits with a meaning of the caller's.
    pub kind: [u8; 2],
}

/// The faces of a scene, and one more that stands for none.
#[derive(Debug)]
pub struct SideTable {
    faces: Vec<FaceSides>,
    adaptive: bool,
}

/// The sides that the rays of a packet landed on.
pub struct SideLanes<'t> {
    /// First number of the side, or [`NONE`].
    pub first: [u32; LANES],
    /// Kind of the side; 32 bits a lane, like all else, so that lanes go together.
    pub kind: [u32; LANES],
    nu: [u32; LANES],
    nv: [u32; LANES],
    triangle: [bool; LANES],
    /// Where some faces have cells that differ in size.
    grids: Option<[&'t Grid; LANES]>,
}

impl FaceSides {
    /// A face without cells.
    pub fn bare(normal: Vec3, kind: [u8; 2]) -> FaceSides {
        FaceSides { normal, grid: Lattice { nu: 1, nv: 1, triangle: false }.into(), first: [NONE; 2], kind }
    }

    /// Both kinds, that of the front in the lower byte.
    #[inline(always)]
    fn kinds(&self) -> u32 {
        u32::from(u16::from_le_bytes(self.kind))
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
        SideTable { adaptive: faces.iter().any(|t| t.grid.is_adaptive()), faces }
    }

    /// A face; one that there is not stands for none.
    #[inline(always)]
    pub fn face(&self, face: u32) -> &FaceSides {
        &self.faces[(face as usize).min(self.faces.len() - 1)]
    }

    /// Takes bits away from the kinds of all sides.
    pub fn without(&mut self, kind: u8) {
        self.faces.iter_mut().flat_map(|f| &mut f.kind).for_each(|k| *k &= !kind);
    }

    /// The sides that the rays of a packet landed on.
    #[inline(always)]
    pub fn lanes(&self, hits: &Hits, rays: &RayLanes) -> SideLanes<'_> {
        let mut face = [&self.faces[0]; LANES];
        let (mut normal, mut first, mut kinds) = ([[0.0; LANES]; 3], [[NONE; LANES]; 2], [0; LANES]);
        let (mut nu, mut nv, mut triangle) = ([0; LANES], [0; LANES], [false; LANES]);
        if hits.face == [hits.face[0]; LANES] {
            // Neighbours mostly land on one face: nothing to gather.
            let f = self.face(hits.face[0]);
            face = [f; LANES];
            normal = f.normal.to_array().map(|x| [x; LANES]);
            (first, kinds) = (f.first.map(|x| [x; LANES]), [f.kinds(); LANES]);
            (nu, nv) = ([f.grid.lattice.nu; LANES], [f.grid.lattice.nv; LANES]);
            triangle = [f.grid.lattice.triangle; LANES];
        } else {
            for l in 0..LANES {
                let f = self.face(hits.face[l]);
                face[l] = f;
                (normal[0][l], normal[1][l], normal[2][l]) = f.normal.into();
                (first[0][l], first[1][l]) = f.first.into();
                kinds[l] = f.kinds();
                (nu[l], nv[l], triangle[l]) = (f.grid.lattice.nu, f.grid.lattice.nv, f.grid.lattice.triangle);
            }
        }
        let mut front = [false; LANES];
        for l in 0..LANES {
            let [x, y, z] = [0, 1, 2].map(|c| normal[c][l] * rays.direction[c][l]);
            front[l] = x + y + z < 0.0;
        }
        SideLanes {
            first: std::array::from_fn(|l| if front[l] { first[0][l] } else { first[1][l] }),
            kind: std::array::from_fn(|l| (if front[l] { kinds[l] } else { kinds[l] >> 8 }) & 0xff),
            nu,
            nv,
            triangle,
            grids: if self.adaptive { Some(face.map(|f| &f.grid)) } else { None },
        }
    }
}

impl SideLanes<'_> {
    #[inline(always)]
    fn lattice(&self, l: usize) -> Lattice {
        Lattice { nu: self.nu[l], nv: self.nv[l], triangle: self.triangle[l] }
    }

    /// Numbers of the cells that the rays landed on, counted from [`SideLanes::first`]; [`NONE`] where the side has none.
    #[inline(always)]
    pub fn cells(&self, hits: &Hits) -> [u32; LANES] {
        let mut cell: [u32; LANES] = std::array::from_fn(|l| self.lattice(l).cell(hits.u[l], hits.v[l]));
        if let Some(grids) = self.grids {
            cell.iter_mut().zip(grids).for_each(|(c, grid)| *c = grid.holding(*c));
        }
        for (cell, first) in cell.iter_mut().zip(self.first) {
            let number = first.wrapping_add(*cell);
            *cell = if first == NONE { NONE } else { number };
        }
        cell
    }

    /// Local nodes of the cells that the rays landed on, and their weights there, as in [`Lattice::interpolation`].
    #[inline(always)]
    pub fn interpolation(&self, hits: &Hits) -> ([[u32; LANES]; 4], [[f32; LANES]; 4]) {
        let (mut nodes, mut weights) = ([[0; LANES]; 4], [[0.0; LANES]; 4]);
        for l in 0..LANES {
            let place = self.lattice(l).interpolation(hits.u[l], hits.v[l]);
            for k in 0..4 {
                (nodes[k][l], weights[k][l]) = (place.0[k], place.1[k]);
            }
        }
        let differing = self.grids.into_iter().flatten().enumerate().filter(|(_, g)| g.is_adaptive());
        for (l, grid) in differing {
            let place = grid.interpolation(hits.u[l], hits.v[l]);
            for k in 0..4 {
                (nodes[k][l], weights[k][l]) = (place.0[k], place.1[k]);
            }
        }
        (nodes, weights)
    }
}
