//! How the cells of an adaptive mesh are divided, and dividing them further.

use super::grid::{Cell, Levels, MOST_LEVELS, quarters};
use super::lattice::CellAt;
use super::{
    Grid, Lattice, MOST_ELEMENTS, Mesh, NONE, Nodes, Sides, agree, lattices, side_index, takes_part,
};
use crate::scene::Scene;
use crate::{Error, Result};
use rustc_hash::FxHashMap;

/// Divisions between the cells of level 0 and the finest, where the face is large enough.
const LEVELS: u32 = 7;
/// Level of the first mesh, as far as faces have it. What lies before the middle of a face, a lamp under a ceiling, its four quarters see
/// all alike, and nothing would tell that they should be divided: level 1 loses 3 % of the light of a room of albedo 0.8 with
/// its lamp 2 cm under the ceiling, level 2 0.2 %.
const FIRST: u8 = 2;

/// Cells of a face that one was divided into along some edges; the first begins where it began.
#[derive(Debug, Clone, PartialEq)]
pub struct Siblings {
    /// The face.
    pub face: u32,
    /// Their numbers.
    pub cells: Vec<u32>,
    /// The edges.
    pub along: Along,
}

/// Along which of its edges, u and v, a cell is to be divided or joined.
pub type Along = [bool; 2];

/// The cells of every face.
///
/// Cells of level 0 have up to 128 times the edge of the finest. Those of quads are halved along either edge, those of triangles
/// quartered: light that changes along one edge alone, as beside the edge of a room, asks for no more.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    finest: f64,
    faces: Vec<Divided>,
}

#[derive(Debug, Clone, PartialEq)]
struct Divided {
    /// The cells of level 0.
    base: Lattice,
    /// Levels of the finest cells allowed.
    deepest: Levels,
    /// In the order of [`Divided::sort`].
    cells: Vec<Cell>,
    /// Some side has elements.
    used: bool,
}

impl Divided {
    /// Cells of the first mesh; undivided where no side has elements.
    fn new(base: Lattice, deepest: Levels, used: bool) -> Divided {
        let mut cells: Vec<_> =
            (0..base.len() as u32).map(|c| Cell { at: base.at(c), levels: [0, 0] }).collect();
        let level = deepest.map(|l| if used { FIRST.min(l) } else { 0 });
        for k in 0..FIRST {
            cells = cells.iter().flat_map(|c| parts(base.triangle, c, level.map(|l| k < l))).collect();
        }
        let mut face = Divided { base, deepest, cells, used };
        face.sort();
        face
    }

    /// Puts the cells of a quad in the order of the Z-order curve; triangles, whose quarters take their places, are in order.
    fn sort(&mut self) {
        if self.base.triangle {
            return;
        }
        let key = |c: &Cell| {
            let ((iu, iv, _), [lu, lv]) = (c.at, c.levels);
            let corner = |i: u32, level: u8| (i & ((1 << level) - 1)) << (MOST_LEVELS - level);
            (
                self.base.number((iu >> lu, iv >> lv, false)),
                spread(corner(iu, lu)) | spread(corner(iv, lv)) << 1,
            )
        };
        self.cells.sort_by_cached_key(key);
    }

    /// Takes the face's cells from the front of a list of levels, in order; none where these do not fit.
    fn take(&mut self, levels: &[Levels]) -> Option<()> {
        let mut rest = levels.iter().copied().peekable();
        self.cells.clear();
        for cell in 0..self.base.len() as u32 {
            let at = self.base.at(cell);
            if self.base.triangle {
                grow((at, 0), self.deepest[0], &mut rest, &mut self.cells)?;
            } else {
                self.take_square(at, &mut rest)?;
            }
        }
        Some(())
    }

    /// Takes the cells within one of level 0 of a quad: each begins where the ones before it left the curve.
    fn take_square(&mut self, (iu, iv, _): CellAt, rest: &mut impl Iterator<Item = Levels>) -> Option<()> {
        let most = self.deepest[0].max(self.deepest[1]);
        let along = self.deepest.map(|l| 1usize << l);
        let mut covered = vec![false; along[0] * along[1]];
        for code in 0..1u32 << (2 * most) {
            let place = [gather(code), gather(code >> 1)];
            let beyond = self.deepest.map(|l| most - l);
            if (0..2).any(|axis| place[axis] & ((1 << beyond[axis]) - 1) != 0) {
                continue;
            }
            let [u, v] = [0, 1].map(|axis| (place[axis] >> beyond[axis]) as usize);
            if covered[v * along[0] + u] {
                continue;
            }
            let levels = rest.next().filter(|l| (0..2).all(|axis| l[axis] <= self.deepest[axis]))?;
            let [width, height] = [0, 1].map(|axis| 1usize << (self.deepest[axis] - levels[axis]));
            if u % width != 0 || v % height != 0 {
                return None;
            }
            for row in v..v + height {
                let row = &mut covered[row * along[0]..][u..u + width];
                if row.contains(&true) {
                    return None;
                }
                row.fill(true);
            }
            let place = |i: u32, level: u8, within: usize, size: usize| (i << level) + (within / size) as u32;
            let at = (place(iu, levels[0], u, width), place(iv, levels[1], v, height), false);
            self.cells.push(Cell { at, levels });
        }
        Some(())
    }
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
        let wanted = lattices(scene, finest, false);
        let mut bases: Vec<Lattice> = wanted.iter().map(coarsest).collect();
        agree(scene, &mut bases);
        let face = |(k, (base, wanted)): (usize, (&Lattice, &Lattice))| {
            let deepest = |base: u32, wanted: u32| {
                (0..MOST_LEVELS).find(|level| base << level >= wanted).unwrap_or(MOST_LEVELS)
            };
            let deepest = [deepest(base.nu, wanted.nu), deepest(base.nv, wanted.nv)];
            let used = [true, false].into_iter().any(|front| {
                sides.0[side_index(k as u32, front)] && takes_part(scene, &scene.faces[k], front, false)
            });
            (*base, deepest, used)
        };
        let faces: Vec<_> = bases.iter().zip(&wanted).enumerate().map(face).collect();
        let cells: u64 =
            faces.iter().map(|(base, [u, v], _)| base.len() << (FIRST.min(*u) + FIRST.min(*v))).sum();
        if cells > u64::from(MOST_ELEMENTS) {
            return Err(Error::Usage(format!(
                "element size {finest} m makes more than {MOST_ELEMENTS} elements: choose a larger --element-size"
            )));
        }
        let faces = faces.into_iter().map(|(base, deepest, used)| Divided::new(base, deepest, used));
        Ok(Division { finest, faces: faces.collect() })
    }

    /// The division whose elements have these levels, in order; none where they fit no division of the scene.
    pub fn of_levels(scene: &Scene, sides: &Sides, finest: f64, mut levels: &[Levels]) -> Option<Division> {
        let mut division = Division::new(scene, sides, finest).ok()?;
        for (k, face) in division.faces.iter_mut().enumerate().filter(|(_, f)| f.used) {
            face.take(levels)?;
            let both = [true, false].into_iter().filter(|front| {
                sides.0[side_index(k as u32, *front)] && takes_part(scene, &scene.faces[k], *front, false)
            });
            levels = levels.get(both.count() * face.cells.len()..)?;
        }
        levels.is_empty().then_some(division)
    }

    /// Largest edge of the finest cells \[m\].
    pub fn finest(&self) -> f64 {
        self.finest
    }

    /// How many times more a cell may be divided along either edge.
    pub fn levels_left(&self, face: u32, cell: u32) -> Levels {
        let face = &self.faces[face as usize];
        let levels = face.cells[cell as usize].levels;
        [0, 1].map(|axis| face.deepest[axis] - levels[axis])
    }

    pub(super) fn grids(&self, scene: &Scene) -> Result<Vec<Grid>> {
        let grid = |(k, f): (usize, &Divided)| {
            Grid::divided(f.base, &f.cells).ok_or_else(|| {
                let object = &scene.objects[scene.faces[k].object as usize];
                let message =
                    format!("object \"{object}\" has too many cells: choose a larger --element-size");
                Error::Usage(message)
            })
        };
        self.faces.iter().enumerate().map(grid).collect()
    }

    /// Divides cells along the edges that `wanted` says, a triangle's along both where along any, as far as they may be; how many these
    /// are.
    pub fn split(&mut self, wanted: impl Fn(u32, u32) -> Along) -> usize {
        self.change(wanted, &[])
    }

    /// The same, and joins cells, each in one of [`Division::siblings`] at most, which are not divided.
    pub fn change(&mut self, wanted: impl Fn(u32, u32) -> Along, joined: &[Siblings]) -> usize {
        let mut joins: FxHashMap<(u32, u32), Option<Along>> = FxHashMap::default();
        for s in joined {
            // The first makes the whole, and the others vanish.
            joins.extend(s.cells.iter().map(|cell| ((s.face, *cell), None)));
            joins.insert((s.face, s.cells[0]), Some(s.along));
        }
        let mut count = 0;
        for (k, face) in self.faces.iter_mut().enumerate() {
            let (mut cells, triangle) = (Vec::with_capacity(face.cells.len()), face.base.triangle);
            for (number, cell) in face.cells.iter().enumerate() {
                let at = (k as u32, number as u32);
                if let Some(join) = joins.get(&at) {
                    cells.extend(join.map(|along| whole(cell, along)));
                    continue;
                }
                let want = wanted(at.0, at.1);
                let any = triangle && want != [false; 2];
                let split = [0, 1].map(|axis| (want[axis] || any) && cell.levels[axis] < face.deepest[axis]);
                count += usize::from(split != [false; 2]);
                cells.extend(parts(triangle, cell, split));
            }
            face.cells = cells;
            face.sort();
        }
        count
    }

    /// What may be joined to cells that are divided at least once along that edge.
    pub fn siblings(&self) -> Vec<Siblings> {
        let mut found = Vec::new();
        for (k, face) in self.faces.iter().enumerate() {
            let numbers: FxHashMap<_, _> =
                face.cells.iter().zip(0..).map(|(cell, number)| ((cell.at, cell.levels), number)).collect();
            let ways: &[Along] =
                if face.base.triangle { &[[true; 2]] } else { &[[true, false], [false, true]] };
            for (cell, along) in face.cells.iter().flat_map(|cell| ways.iter().map(move |way| (cell, *way))) {
                if (0..2).any(|axis| along[axis] && cell.levels[axis] < 2) {
                    continue;
                }
                let of = parts(face.base.triangle, &whole(cell, along), along);
                let numbers = of.iter().map(|part| numbers.get(&(part.at, part.levels)).copied());
                if of[0].at == cell.at {
                    let siblings = |cells| Siblings { face: k as u32, cells, along };
                    found.extend(numbers.collect::<Option<Vec<u32>>>().map(siblings));
                }
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
            let mut chosen: Vec<_> = steep.into_iter().filter(|s| s.1 != NONE).collect();
            chosen.sort_unstable();
            let steep = |face, cell, axis| chosen.binary_search(&(face, cell, axis)).is_ok();
            if self.split(|face, cell| [steep(face, cell, 0), steep(face, cell, 1)]) == 0 {
                return Ok(());
            }
        }
    }
}

/// The cells that one is divided into along some of its edges; itself along none.
fn parts(triangle: bool, cell: &Cell, split: Along) -> Vec<Cell> {
    let ((iu, iv, _), [lu, lv]) = (cell.at, cell.levels);
    let [twice_u, twice_v] = split.map(u32::from);
    let levels = [lu + split[0] as u8, lv + split[1] as u8];
    if triangle && split == [true; 2] {
        return quarters(cell.at).map(|at| Cell { at, levels }).to_vec();
    }
    let rows = (0..=twice_v).flat_map(|v| (0..=twice_u).map(move |u| (u, v)));
    let part = |(u, v)| Cell { at: ((iu << twice_u) + u, (iv << twice_v) + v, cell.at.2), levels };
    rows.map(part).collect()
}

/// The cell that the first of some siblings is a part of.
fn whole(first: &Cell, along: Along) -> Cell {
    let ((iu, iv, inverted), [u, v]) = (first.at, along.map(u8::from));
    Cell { at: (iu >> u, iv >> v, inverted), levels: [first.levels[0] - u, first.levels[1] - v] }
}

/// Takes the cells within one of a triangle from the levels that are left.
fn grow(
    (at, level): (CellAt, u8),
    deepest: u8,
    rest: &mut std::iter::Peekable<impl Iterator<Item = Levels>>,
    cells: &mut Vec<Cell>,
) -> Option<()> {
    let levels = *rest.peek()?;
    if levels[0] != levels[1] || levels[0] < level || levels[0] > deepest {
        return None;
    }
    if levels[0] == level {
        rest.next();
        cells.push(Cell { at, levels });
        return Some(());
    }
    quarters(at).iter().try_for_each(|q| grow((*q, level + 1), deepest, rest, cells))
}

/// Puts the lower 16 bits of a number on its even places.
fn spread(mut x: u32) -> u32 {
    for (shift, mask) in [(8, 0x00ff_00ff), (4, 0x0f0f_0f0f), (2, 0x3333_3333), (1, 0x5555_5555)] {
        x = (x | x << shift) & mask;
    }
    x
}

/// The number that a number's even places hold: undoes [`spread`].
fn gather(mut x: u32) -> u32 {
    x &= 0x5555_5555;
    for (shift, mask) in [(1, 0x3333_3333), (2, 0x0f0f_0f0f), (4, 0x00ff_00ff), (8, 0x0000_ffff)] {
        x = (x | x >> shift) & mask;
    }
    x
}

/// The lattice of level 0 for one of the finest cells.
fn coarsest(finest: &Lattice) -> Lattice {
    let along = |finest: u32| {
        let most = LEVELS.min(finest.ilog2() + 1);
        let base = |level: u32| finest.div_ceil(1 << level);
        // Rounding up makes the finest cells smaller than asked for: a level less may come closer.
        let fewer = most.saturating_sub(1);
        base(if base(fewer) << fewer < base(most) << most { fewer } else { most })
    };
    Lattice { nu: along(finest.nu), nv: along(finest.nv), ..*finest }
}
