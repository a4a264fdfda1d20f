//! Where an element lies in space, for points all over it.

use super::lattice::CellFrame;
use super::{Grid, Mesh};
use crate::scene::{FaceFrame, Scene};
use glam::{DVec2, DVec3};

/// An element in space.
pub struct Place<'m> {
    /// The face that it is a part of.
    pub face: u32,
    /// Unit normal, towards the side that the element is on.
    pub normal: DVec3,
    grid: &'m Grid,
    cell: CellFrame,
    frame: FaceFrame,
}

impl Mesh {
    /// Where an element lies.
    pub fn place_of(&self, scene: &Scene, element: u32) -> Place<'_> {
        let (face, _, cell) = self.place(element);
        let grid = self.grid(face);
        Place {
            face,
            normal: self.normal(scene, element),
            grid,
            cell: grid.cell_frame(cell),
            frame: scene.face_frame(&scene.faces[face as usize]),
        }
    }
}

impl Place<'_> {
    /// (u, v) of the face for (s, t) uniform in the unit square; uniform in area.
    #[inline]
    pub fn uv(&self, s: f64, t: f64) -> DVec2 {
        let p = self.frame.even(self.cell, s, t);
        self.grid.cell_point(&self.cell, p.x, p.y)
    }

    /// The point at (u, v) of the face \[m, relative to the scene's centre\].
    #[inline]
    pub fn at(&self, uv: DVec2) -> DVec3 {
        self.frame.at(uv)
    }
}
