//! Form factors as data that every format is made of: small functions from [`Factors`] to bytes or pixels.

mod heatmap;
mod npz;
mod sums;
mod text;
mod view;

pub use heatmap::heat_map;
pub use npz::write_npz;
pub use text::{to_csv, to_json, to_view3d};
pub use view::{View, view};

use super::pairs::{FewPairs, PairFactors};
use super::{Estimates, ExchangeMatrix, Found, ObjectTable};
use crate::color::{self, Rgb};
use crate::mesh::Mesh;
use crate::scene::Scene;
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashSet;
use std::ops::Range;
use sums::Sums;

/// What the name of an object's back ends in.
const BACK: &str = ":back";
/// Rows that a thread turns into factors at a time.
const PART: usize = 256;

/// Form factors between nodes, which are the elements of a scene or its objects (one for each side that takes part).
///
/// Rows are sparse, in the order of their columns, f64. What left the scene or landed on sides that
/// take no part is kept beside them, so that each row's factors, escaped and absorbed shares sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Factors {
    /// Nodes are objects; elements otherwise.
    pub by_object: bool,
    /// Names of the objects' sides that take part: the object's own for fronts, `NAME:back` for backs (after all fronts).
    pub names: Vec<String>,
    /// Index into `names` of each node.
    pub object: Vec<u32>,
    /// Area of each node [m^2].
    pub areas: Vec<f64>,
    /// Share of diffuse light that each node's material absorbs: 1 less its albedo and transmittance, mean of the channels.
    pub emissivity: Vec<f64>,
    /// Nodes whose rows are held; all of them unless only some were asked for.
    pub rows: Range<usize>,
    /// Start of each held row, and the end.
    pub start: Vec<usize>,
    /// Column (node) of each factor.
    pub columns: Vec<u32>,
    /// Factors from the row's node to the column's.
    pub values: Vec<f64>,
    /// Standard error of each factor; empty where a single randomisation gives none.
    pub errors: Vec<f64>,
    /// Share of each held row that left the scene.
    pub escaped: Vec<f64>,
    /// Share of each held row that landed on a side of a face without nodes, or was dropped.
    pub absorbed: Vec<f64>,
    /// Rays an element; 0 where none were cast.
    pub rays: u32,
    /// Seconds that the computation took.
    pub seconds: f64,
    /// `raw`, or which conditions a correction has enforced.
    pub written: &'static str,
}

/// Some of the rows of [`Factors`].
#[derive(Default)]
struct Part {
    /// Entries by row.
    lengths: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
    errors: Vec<f64>,
    /// What escaped and what was absorbed, by row.
    lost: Vec<(Rgb, Rgb)>,
}

impl Factors {
    /// One node an element, and no factors yet in the rows that are kept.
    fn without_entries(scene: &Scene, mesh: &Mesh, rows: Range<usize>, rays: u32, seconds: f64) -> Factors {
        let n = mesh.len() as u32;
        let sides = sides(scene, mesh);
        Factors {
            by_object: false,
            names: sides.names,
            object: sides.of_element,
            areas: (0..n).map(|e| mesh.area(e)).collect(),
            emissivity: (0..n).map(|e| emissivity(scene, mesh.place(e).0)).collect(),
            rows,
            start: vec![0],
            columns: Vec::new(),
            values: Vec::new(),
            errors: Vec::new(),
            escaped: Vec::new(),
            absorbed: Vec::new(),
            rays,
            seconds,
            written: "raw",
        }
    }

    /// One node an element, `rows` of them are kept; `few` of the pairs are known better.
    pub fn of_elements(
        scene: &Scene,
        mesh: &Mesh,
        (matrix, few): (&ExchangeMatrix, Option<&FewPairs>),
        rows: Range<usize>,
        seconds: f64,
    ) -> Factors {
        let mut factors = Factors::without_entries(scene, mesh, rows.clone(), matrix.rays_per_row, seconds);
        if matrix.batches() == 1 {
            // Each entry is a factor; of several randomisations, some entries are the same factor's. Grown by
            // doubling, a large matrix would take twice its memory.
            factors.columns.reserve_exact(matrix.stored());
            factors.values.reserve_exact(matrix.stored());
        }
        let of_part = |sums: &mut Sums, part: Range<usize>| {
            let mut found = Part::default();
            let mut entries = Vec::new();
            for row in part {
                sums.row(matrix, row, &mut entries);
                let mut summary = matrix.summary[row];
                if let Some(few) = few {
                    few.mend(row, mesh.area(row as u32), &mut entries, &mut summary);
                }
                found.lost.push((summary.escaped, summary.absorbed + summary.dropped));
                found.lengths.push(entries.len());
                found.columns.extend(entries.iter().map(|e| e.0));
                found.values.extend(entries.iter().map(|e| e.1));
                if matrix.batches() > 1 {
                    found.errors.extend(entries.iter().map(|e| e.2));
                }
            }
            found
        };
        // A part for each thread at a time: all parts at once would take the memory of the factors again.
        let mut sums: Vec<Sums> = (0..rayon::current_num_threads()).map(|_| Sums::new(mesh.len())).collect();
        for first in rows.clone().step_by(PART * sums.len()) {
            let part = |k: usize| rows.end.min(first + k * PART)..rows.end.min(first + (k + 1) * PART);
            let of_part = |(k, sums): (usize, &mut Sums)| of_part(sums, part(k));
            let parts: Vec<Part> = sums.par_iter_mut().enumerate().map(of_part).collect();
            parts.iter().for_each(|part| factors.append(part));
        }
        factors
    }

    fn append(&mut self, part: &Part) {
        let mut at = self.columns.len();
        self.start.extend(part.lengths.iter().map(|length| {
            at += length;
            at
        }));
        self.columns.extend_from_slice(&part.columns);
        self.values.extend_from_slice(&part.values);
        self.errors.extend_from_slice(&part.errors);
        self.escaped.extend(part.lost.iter().map(|l| color::mean(l.0)));
        self.absorbed.extend(part.lost.iter().map(|l| color::mean(l.1)));
    }

    /// Factors however they were found; `rows` of them are kept.
    pub fn of_found(
        scene: &Scene,
        mesh: &Mesh,
        found: &Found,
        (by_object, rows): (bool, Range<usize>),
        seconds: f64,
    ) -> Factors {
        match (&found.estimates, by_object) {
            (Estimates::Pairs(pairs, matrix), true) => {
                let table = found.table(scene, mesh, seconds);
                let rest = |e: usize| pairs.rest(e, matrix.as_ref()).absorbed;
                Factors::of_table(scene, mesh, table, rest, rows)
            }
            (Estimates::Pairs(pairs, matrix), false) => {
                Factors::of_pairs(scene, mesh, pairs, matrix.as_ref(), rows, seconds)
            }
            // An error that was asked for is that of both directions together.
            (Estimates::Rows(matrix, _), true) if found.achieved.is_some() => {
                let lost = |e: usize| matrix.summary[e].absorbed + matrix.summary[e].dropped;
                Factors::of_table(scene, mesh, found.table(scene, mesh, seconds), lost, rows)
            }
            (Estimates::Rows(matrix, _), true) => Factors::of_objects(scene, mesh, matrix, rows, seconds),
            (Estimates::Rows(matrix, lamps), false) => {
                Factors::of_elements(scene, mesh, (matrix, lamps.as_ref()), rows, seconds)
            }
        }
    }

    /// One node an element, factors found pair by pair; `matrix` tells where the rest of the rays went.
    fn of_pairs(
        scene: &Scene,
        mesh: &Mesh,
        pairs: &PairFactors,
        matrix: Option<&ExchangeMatrix>,
        rows: Range<usize>,
        seconds: f64,
    ) -> Factors {
        let rays = matrix.map_or(0, |m| m.rays_per_row);
        let mut factors = Factors::without_entries(scene, mesh, rows.clone(), rays, seconds);
        for row in rows {
            let rest = pairs.rest(row, matrix);
            factors.escaped.push(color::mean(rest.escaped));
            factors.absorbed.push(color::mean(rest.absorbed + rest.dropped));
            for (j, f) in pairs.row(row) {
                factors.columns.push(j as u32);
                factors.values.push(f);
                factors.errors.push(pairs.factor(row, j).1);
            }
            factors.start.push(factors.columns.len());
        }
        factors
    }

    /// One node for each side of an object; `rows` of them are kept. Zeros are kept too.
    pub fn of_objects(
        scene: &Scene,
        mesh: &Mesh,
        matrix: &ExchangeMatrix,
        rows: Range<usize>,
        seconds: f64,
    ) -> Factors {
        let table = ObjectTable::new(scene, mesh, matrix, seconds);
        let lost = |e: usize| matrix.summary[e].absorbed + matrix.summary[e].dropped;
        Factors::of_table(scene, mesh, table, lost, rows)
    }

    /// One node for each side of an object; `lost` is the share of an element's light that landed on no node.
    fn of_table(
        scene: &Scene,
        mesh: &Mesh,
        table: ObjectTable,
        lost: impl Fn(usize) -> Rgb,
        rows: Range<usize>,
    ) -> Factors {
        // A single randomisation has no errors to tell.
        let several = table.standard_errors.iter().flatten().all(|e| !e.is_nan());
        let sides = sides(scene, mesh);
        let n = table.objects.len();
        let (mut absorbed, mut reflected) = (vec![0.0; n], vec![0.0; n]);
        for e in 0..mesh.len() {
            let a = sides.of_element[e] as usize;
            let share = mesh.area(e as u32) / table.areas[a];
            absorbed[a] += share * color::mean(lost(e));
            reflected[a] += share * (1.0 - emissivity(scene, mesh.place(e as u32).0));
        }
        let some = |table: Vec<Vec<f64>>| -> Vec<f64> {
            table[rows.clone()].iter().flat_map(|row| row.iter().copied()).collect()
        };
        Factors {
            by_object: true,
            names: table.objects,
            object: (0..n as u32).collect(),
            areas: table.areas,
            emissivity: reflected.iter().map(|r| 1.0 - r).collect(),
            start: (0..=rows.len()).map(|r| r * n).collect(),
            columns: rows.clone().flat_map(|_| 0..n as u32).collect(),
            values: some(table.form_factors),
            errors: if several { some(table.standard_errors) } else { Vec::new() },
            escaped: table.escaped[rows.clone()].to_vec(),
            absorbed: absorbed[rows.clone()].to_vec(),
            rays: table.rays,
            seconds: table.seconds,
            written: "raw",
            rows,
        }
    }

    /// Number of nodes, which is that of columns.
    pub fn nodes(&self) -> usize {
        self.areas.len()
    }

    /// Name of a node: the object's, and the element's number where nodes are elements.
    pub fn name(&self, node: usize) -> String {
        let name = &self.names[self.object[node] as usize];
        if self.by_object { name.clone() } else { format!("element {node} of \"{name}\"") }
    }

    /// Columns, factors and (where there are) standard errors of a held row, counted from the first held.
    pub fn row(&self, row: usize) -> (&[u32], &[f64], Option<&[f64]>) {
        let range = self.start[row]..self.start[row + 1];
        let errors = (!self.errors.is_empty()).then(|| &self.errors[range.clone()]);
        (&self.columns[range.clone()], &self.values[range], errors)
    }

    /// The share of what leaves all held nodes that `of` them (escaped or absorbed) take, and the objects that
    /// lose most: name and share of what leaves the object, largest loss first.
    pub fn loss(&self, of: &[f64]) -> (f64, Vec<(String, f64)>) {
        let (mut lost, mut area) = (vec![0.0; self.names.len()], vec![0.0; self.names.len()]);
        for (share, node) in of.iter().zip(self.rows.clone()) {
            lost[self.object[node] as usize] += share * self.areas[node];
            area[self.object[node] as usize] += self.areas[node];
        }
        let mut order: Vec<usize> = (0..lost.len()).filter(|k| lost[*k] > 0.0).collect();
        order.sort_by(|a, b| lost[*b].total_cmp(&lost[*a]));
        let (all, whole): (f64, f64) = (lost.iter().sum(), area.iter().sum());
        let share = if whole > 0.0 { all / whole } else { 0.0 };
        (share, order.iter().map(|k| (self.names[*k].clone(), lost[*k] / area[*k])).collect())
    }
}

/// Names of the sides of objects, and the one that each element is on.
pub(super) struct ObjectSides {
    pub names: Vec<String>,
    pub of_element: Vec<u32>,
}

/// Fronts of all objects, then, where any back has elements, backs of all objects.
pub(super) fn sides(scene: &Scene, mesh: &Mesh) -> ObjectSides {
    let n = scene.objects.len() as u32;
    let (mut names, mut backs) = (scene.objects.clone(), false);
    let of_element = (0..mesh.len() as u32)
        .map(|e| {
            let (face, front, _) = mesh.place(e);
            backs |= !front;
            scene.faces[face as usize].object + if front { 0 } else { n }
        })
        .collect();
    if backs {
        names.extend(scene.objects.iter().map(|name| format!("{name}{BACK}")));
    }
    ObjectSides { names, of_element }
}

/// Makes sure that names tell the sides of all objects apart.
///
/// # Errors
/// An object is called as the back of another one is.
pub fn check_names_of_backs(scene: &Scene) -> Result<()> {
    let objects: HashSet<&str> = scene.objects.iter().map(String::as_str).collect();
    let mut backs = scene.objects.iter().filter_map(|name| Some((name, name.strip_suffix(BACK)?)));
    match backs.find(|(_, other)| objects.contains(other)) {
        None => Ok(()),
        Some((name, other)) => Err(Error::scene(
            format!("object \"{name}\""),
            format!(
                "the back of object \"{other}\" has that name in factors of both sides: rename one of the two, or leave out --two-sided"
            ),
        )),
    }
}

fn emissivity(scene: &Scene, face: u32) -> f64 {
    let material = scene.material(&scene.faces[face as usize]);
    (1.0 - color::mean(material.diffuse + material.diffuse_transmission)).clamp(0.0, 1.0)
}
