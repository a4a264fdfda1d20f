//! How the cells of an adaptive mesh are divided, and dividing them further.

use super::grid::MOST_LEVELS;
use super::{
    Grid, Lattice, MOST_ELEMENTS, Mesh, NONE, Nodes, Sides, agree, lattices, side_index, takes_part,
};
use crate::scene::Scene;
use crate::{Error, Result};

/// Divisions between the cells of level 0 and the finest, where the face is large enough.
const LEVELS: u32 = 7;
/// Level of the first mesh, as far as faces have it. What lies before the middle of a face, a lamp under a ceiling, its four quarters see
/// all alike, and nothing would tell that they should be divided: level 1 loses 3 % of the light of a room of albedo 0.8 with
/// its lamp 2 cm under the ceiling, level 2 0.2 %.
const FIRST: u8 = 2;

/// The levels of the cells of every face.
///
/// Cells of level 0 have up to 128 times the edge of the finest; level `k + 1` quarters the cells of level `k`.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    finest: f64,
    faces: Vec<Divided>,
}

#[derive(Debug, Clone, PartialEq)]
struct Divided {
    /// The cells of level 0.
    base: Lattice,
    /// Level of the finest cells allowed.
    deepest: u8,
    /// Level of each cell, depth first.
    levels: Vec<u8>,
    /// Some side has elements.
    used: bool,
}

impl Division {
    /// The coarsest mesh whose errors can be told: level 2 wherever cells may be divided so often. The edges of the finest cells will be
    /// at most `finest` \[m\].
    ///
    /// # Errors
    /// The size is not above zero.
    pub fn new(scene: &Scene, sides: &Sides, finest: f64) -> Result<Division> {
        if finest.is_nan() || finest <= 0.0 {
            return Err(Error::Usage(format!("element size {finest} m: must be above zero")));
        }
        let wanted = lattices(scene, finest);
        let mut bases: Vec<Lattice> = wanted.iter().map(coarsest).collect();
        agree(scene, &mut bases);
        let face = |(k, (base, wanted)): (usize, (&Lattice, &Lattice))| {
            let fits = |level: &u8| base.nu << level >= wanted.nu && base.nv << level >= wanted.nv;
            let deepest = (0..MOST_LEVELS).find(fits).unwrap_or(MOST_LEVELS);
            let used = [true, false].into_iter().any(|front| {
                sides.0[side_index(k as u32, front)] && takes_part(scene, &scene.faces[k], front, false)
            });
            (*base, deepest, used)
        };
        let faces: Vec<_> = bases.iter().zip(&wanted).enumerate().map(face).collect();
        let cells: u64 = faces.iter().map(|(base, deepest, _)| base.len() << (2 * FIRST.min(*deepest))).sum();
        if cells > u64::from(MOST_ELEMENTS) {
            return Err(Error::Usage(format!(
                "element size {finest} m makes more than {MOST_ELEMENTS} elements: choose a larger --element-size"
            )));
        }
        let faces = faces.into_iter().map(|(base, deepest, used)| {
            let level = if used { FIRST.min(deepest) } else { 0 };
            Divided { base, deepest, used, levels: vec![level; (base.len() << (2 * level)) as usize] }
        });
        Ok(Division { finest, faces: faces.collect() })
    }

    /// The division whose elements have these levels, in order; none where they fit no division of the scene.
    pub fn of_levels(scene: &Scene, sides: &Sides, finest: f64, mut levels: &[u8]) -> Option<Division> {
        let mut division = Division::new(scene, sides, finest).ok()?;
        for (k, face) in division.faces.iter_mut().enumerate().filter(|(_, f)| f.used) {
            let whole = u128::from(face.base.len()) << (2 * MOST_LEVELS);
            let (mut covered, mut count) = (0, 0);
            while covered < whole {
                let level = *levels.get(count).filter(|l| **l <= MOST_LEVELS)?;
                covered += 1 << (2 * (MOST_LEVELS - level));
                count += 1;
            }
            face.levels = levels[..count].to_vec();
            let both = [true, false].into_iter().filter(|front| {
                sides.0[side_index(k as u32, *front)] && takes_part(scene, &scene.faces[k], *front, false)
            });
            levels = levels.get(both.count() * count..)?;
        }
        levels.is_empty().then_some(division)
    }

    /// Largest edge of the finest cells \[m\].
    pub fn finest(&self) -> f64 {
        self.finest
    }

    /// Level of the deepest cell.
    pub fn deepest(&self) -> u8 {
        self.faces.iter().flat_map(|f| &f.levels).copied().max().unwrap_or(0)
    }

    /// How many times more a cell may be divided.
    pub fn levels_left(&self, face: u32, cell: u32) -> u8 {
        let face = &self.faces[face as usize];
        face.deepest - face.levels[cell as usize]
    }

    pub(super) fn grids(&self, scene: &Scene) -> Result<Vec<Grid>> {
        let grid = |(k, f): (usize, &Divided)| {
            Grid::divided(f.base, &f.levels).ok_or_else(|| {
                let object = &scene.objects[scene.faces[k].object as usize];
                let message =
                    format!("object \"{object}\" has too many cells: choose a larger --element-size");
                Error::Usage(message)
            })
        };
        self.faces.iter().enumerate().map(grid).collect()
    }

    /// The same without cells beyond a level, and for each face the cell of it that each of these cells is in.
    pub fn truncated(&self, level: u8) -> (Division, Vec<Vec<u32>>) {
        let mut coarse = self.clone();
        let mut within = Vec::with_capacity(self.faces.len());
        for (face, fine) in coarse.faces.iter_mut().zip(&self.faces) {
            let (mut parents, mut covered) = (Vec::with_capacity(fine.levels.len()), 0u64);
            face.levels.clear();
            for l in &fine.levels {
                if covered == 0 {
                    face.levels.push(level.min(*l));
                }
                parents.push(face.levels.len() as u32 - 1);
                // Quarters of quarters make up the cell of the level.
                let below = l.saturating_sub(level);
                covered += 1 << (2 * (MOST_LEVELS - below));
                covered %= 1 << (2 * MOST_LEVELS);
            }
            within.push(parents);
        }
        (coarse, within)
    }

    /// Divides the cells of which `wanted` says so and that may be divided; how many these are.
    pub fn split(&mut self, wanted: impl Fn(u32, u32) -> bool) -> usize {
        self.change(wanted, |_, _| false)
    }

    /// The same, and joins the quarters of each cell whose first quarter `joined` names: one of [`Division::quarters`].
    pub fn change(&mut self, wanted: impl Fn(u32, u32) -> bool, joined: impl Fn(u32, u32) -> bool) -> usize {
        let mut count = 0;
        for (k, face) in self.faces.iter_mut().enumerate() {
            let mut levels = Vec::with_capacity(face.levels.len());
            let mut cell = 0;
            while cell < face.levels.len() {
                let level = face.levels[cell];
                if joined(k as u32, cell as u32) {
                    levels.push(level - 1);
                    cell += 3;
                } else if level < face.deepest && wanted(k as u32, cell as u32) {
                    levels.extend([level + 1; 4]);
                    count += 1;
                } else {
                    levels.push(level);
                }
                cell += 1;
            }
            face.levels = levels;
        }
        count
    }

    /// First of the four quarters, by (face, cell) in order, of each cell of level 1 that is divided once.
    pub fn quarters(&self) -> Vec<(u32, u32)> {
        let mut found = Vec::new();
        for (k, face) in self.faces.iter().enumerate() {
            let (mut cell, mut covered) = (0, 0u64);
            while cell < face.levels.len() {
                let level = face.levels[cell];
                let whole = 1 << (2 * (MOST_LEVELS - 1));
                let four = face.levels.get(cell..cell + 4).is_some_and(|l| l.iter().all(|l| *l == 2));
                if four && covered % whole == 0 {
                    found.push((k as u32, cell as u32));
                }
                covered += 1 << (2 * (MOST_LEVELS - level));
                cell += 1;
            }
        }
        found
    }

    /// Divides cells until no edge has neighbours of less than half its length on the same surface, as far as cells may be
    /// divided.
    pub fn balance(&mut self, scene: &Scene, sides: &Sides) -> Result<()> {
        loop {
            let mesh = Mesh::divided(scene, sides, self, false)?;
            let steep = Nodes::new(scene, &mesh).steep;
            let mut chosen: Vec<(u32, u32)> = steep.into_iter().filter(|s| s.1 != NONE).collect();
            chosen.sort_unstable();
            if self.split(|face, cell| chosen.binary_search(&(face, cell)).is_ok()) == 0 {
                return Ok(());
            }
        }
    }
}

/// The lattice of level 0 for one of the finest cells.
fn coarsest(finest: &Lattice) -> Lattice {
    let across = finest.nu.min(finest.nv);
    let most = LEVELS.min(across.ilog2() + 1);
    let base = |level: u32| Lattice {
        nu: finest.nu.div_ceil(1 << level),
        nv: finest.nv.div_ceil(1 << level),
        ..*finest
    };
    // Rounding up makes the finest cells smaller than asked for: a level less may come closer.
    let cells = |level: u32| base(level).len() << (2 * level);
    let fewer = most.saturating_sub(1);
    base(if cells(fewer) < cells(most) { fewer } else { most })
}
