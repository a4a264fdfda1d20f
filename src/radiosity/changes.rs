//! Which cells of an adaptive mesh to divide and which to join.

use super::trust::MUCH;
use super::{ElementError, Judge};
use crate::mesh::{Along, Division, Mesh, NONE, Siblings};
use rustc_hash::{FxHashMap, FxHashSet};

/// What division leaves of an edge's squared error.
const HALF: f64 = 0.5;

/// Share of the error that may be left that joined cells may have. With a sixth as much, the Cornell box and the corridor need a tenth to
/// a fifth more elements at equal error.
const NEEDLESS: f64 = 0.3;

/// Part of what all elements make wrong of the light elsewhere that is left where some make it brighter and others darker. In the corridor
/// 1/2 takes a tenth more elements at equal error.
const TOGETHER: f64 = 1.0 / 3.0;

/// What may be wrong of all light, net, while cells may be divided: behind a lamp close under a ceiling, all elements make it darker. A
/// third of what a warning is for.
const ASTRAY: f64 = MUCH / 3.0;

/// Cells that dividing a triangle's cell adds; a quad's, along one edge, adds one.
const OF_TRIANGLE: usize = 3;

/// Squared relative error of a sum of errors.
fn square(e: ElementError) -> f64 {
    e.shown + (TOGETHER * e.sent).powi(2)
}

/// What to do with the cells of a division.
pub struct Changes {
    /// Cells to divide, by face and number, and along which edges: the fewest that leave to others that may be divided no more than a
    /// number of times the error that the finest mesh would have, were it all along edges.
    pub divide: FxHashMap<(u32, u32), Along>,
    /// Cells that need not have been divided.
    pub join: Vec<Siblings>,
    /// How many cells that adds, as far as dividing does not ask for others.
    pub added: usize,
    /// How many times what may be left there is now, of squared errors.
    pub excess: f64,
}

impl Changes {
    /// Changes by the errors of elements, [`Judge::elements`]; `rest` is the number of times. The sides of a face share its cells.
    pub fn new(
        mesh: &Mesh,
        division: &Division,
        judge: &Judge,
        errors: &[[ElementError; 2]],
        rest: f64,
    ) -> Changes {
        let mut cells: Vec<(ElementError, (u32, u32), usize)> = Vec::new();
        let (mut left, mut finest) = (ElementError::default(), ElementError::default());
        for e in 0..mesh.len() as u32 {
            let (face, front, cell) = mesh.place(e);
            if !front && mesh.first(face, true) != NONE {
                continue;
            }
            let behind = if front { mesh.opposite(e) } else { NONE };
            for (axis, levels) in division.levels_left(face, cell).into_iter().enumerate() {
                let mut error = errors[e as usize][axis];
                if behind != NONE {
                    error = error.plus(errors[behind as usize][axis], 1.0);
                }
                finest = finest.plus(error, HALF.powi(levels.into()));
                if levels > 0 {
                    cells.push((error, (face, cell), axis));
                    left = left.plus(error, 1.0);
                }
            }
        }
        let allowed = rest * square(finest);
        let astray = ASTRAY.max(rest.sqrt() * finest.net.abs());
        let over = |left: ElementError| {
            let times = |of: f64, allowed: f64| if of > 0.0 { of / allowed } else { 0.0 };
            times(square(left), allowed).max(times(left.net.abs(), astray).powi(2))
        };
        let excess = over(left);
        // What a cell has of the squared error, to first order.
        let slope = 2.0 * TOGETHER * TOGETHER * left.sent;
        let part = |e: &ElementError| e.shown + slope * e.sent;
        let cost = |face: u32| if mesh.grid(face).is_triangle() { OF_TRIANGLE } else { 1 };
        cells.retain(|(e, ..)| part(e) > 0.0);
        let gain = |(e, (face, _), _): &(ElementError, (u32, u32), usize)| part(e) / cost(*face) as f64;
        cells.sort_by(|a, b| gain(b).total_cmp(&gain(a)).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut divide: FxHashMap<(u32, u32), Along> = FxHashMap::default();
        let mut added = 0;
        for (error, at, axis) in cells {
            if over(left) <= 1.0 {
                break;
            }
            left = left.plus(error, -1.0);
            divide.entry(at).or_default()[axis] = true;
            added += cost(at.0);
        }
        let error = |s: &Siblings| judge.joined(s);
        let little =
            |lost: ElementError| part(&lost) <= NEEDLESS * allowed && lost.net.abs() <= NEEDLESS * astray;
        let join = needless(division, &divide, (error, part), little);
        Changes { divide, join, added, excess }
    }
}

/// The cells to join whose errors, joined, are least and together `little`; each once, and none that is divided. Errors are compared by
/// what `part` says of them.
fn needless(
    division: &Division,
    divide: &FxHashMap<(u32, u32), Along>,
    (error, part): (impl Fn(&Siblings) -> ElementError, impl Fn(&ElementError) -> f64),
    little: impl Fn(ElementError) -> bool,
) -> Vec<Siblings> {
    let mut siblings: Vec<_> = division.siblings().into_iter().map(|s| (error(&s), s)).collect();
    siblings.sort_by(|a, b| {
        let order = |s: &Siblings| (s.face, s.cells[0], s.along);
        part(&a.0).total_cmp(&part(&b.0)).then_with(|| order(&a.1).cmp(&order(&b.1)))
    });
    let (mut join, mut lost, mut taken) = (Vec::new(), ElementError::default(), FxHashSet::default());
    for (error, s) in siblings {
        let free = |cell: &u32| !taken.contains(&(s.face, *cell)) && !divide.contains_key(&(s.face, *cell));
        if !s.cells.iter().all(free) {
            continue;
        }
        lost = lost.plus(error, 1.0);
        if !little(lost) {
            break;
        }
        taken.extend(s.cells.iter().map(|cell| (s.face, *cell)));
        join.push(s);
    }
    join
}
