//! The solution as a file that `numpy.load` opens (DESIGN section 6), and back.
//!
//! The file holds what cannot be had again from the scene: the elements follow from the sides that have some and their
//! size (with `levels`, of an adaptive mesh), the nodes from the elements. So a solution that was read is the one that was written, to the bit.

use super::reconstruct::Field;
use super::solve::Convergence;
use super::{CausticMap, Ledger, ObjectRadiosity, Solution};
use crate::color::Rgb;
use crate::mesh::{Division, Levels, MOST_ELEMENTS, Mesh, Nodes, Sides};
use crate::npz::{Reader, Writer};
use crate::scene::Scene;
use crate::{Error, Result};
use glam::DVec3;
use npyz::{Deserialize, NpyFile};
use serde_json::{Map, Value, json};
use std::io::{Cursor, Seek, Write};
use std::path::Path;

/// Number of the layout, and of the rules by which elements and nodes are numbered: changes with either.
const FORMAT: u32 = 3;
/// Bytes of what the file says about itself, at most.
const MOST_META: u64 = 1 << 24;

/// A solution that was read from a file.
pub struct Kept {
    /// The solution.
    pub solution: Solution,
    /// What was said about it when it was written.
    pub about: Map<String, Value>,
}

impl Solution {
    /// The arrays of DESIGN section 6, one row an element, and what [`Solution::read_npz`] needs beside them; `about` joins
    /// the JSON of `meta`.
    pub fn to_npz(&self, scene: &Scene, about: Map<String, Value>) -> Result<Vec<u8>> {
        let mut npz = Writer::new(Cursor::new(Vec::new()));
        let n = self.mesh.len() as u32;
        let faces = || (0..n).map(|e| &scene.faces[self.mesh.place(e).0 as usize]);
        let centroid: Vec<DVec3> =
            (0..n).map(|e| (self.mesh.centroid(scene, e) + scene.center) / scene.unit).collect();
        let normal: Vec<DVec3> = (0..n).map(|e| self.mesh.normal(scene, e)).collect();
        let mean: Vec<Rgb> = self.objects.iter().map(|o| o.radiosity).collect();
        let mean_error: Vec<Rgb> = self.objects.iter().map(|o| o.standard_error).collect();
        let mut meta = about;
        let own = json!({
            "format": FORMAT,
            "objects": scene.objects,
            "scene_hash": hash_text(scene),
            "element_size": self.mesh.element_size,
            "map_element_size": self.caustic_map.as_ref().map(CausticMap::element_size),
        });
        meta.extend(own.as_object().cloned().unwrap_or_default());
        let meta = Value::from(meta).to_string();
        let write = || -> std::io::Result<Vec<u8>> {
            for (name, values) in [
                ("radiosity", &self.radiosity[..]),
                ("irradiance", &self.irradiance),
                ("direct", &self.direct),
                ("standard_error", &self.standard_error),
                ("centroid", &centroid),
                ("normal", &normal),
                ("emitted", &self.emitted),
                ("side_radiosity", &mean),
                ("side_standard_error", &mean_error),
                ("power", &self.ledger.rows()),
            ] {
                triples(&mut npz, name, values)?;
            }
            npz.array("area", &[u64::from(n)], (0..n).map(|e| self.mesh.area(e)))?;
            if self.mesh.is_adaptive() {
                npz.array("levels", &[u64::from(n), 2], (0..n).flat_map(|e| self.mesh.levels(e)))?;
            }
            npz.array("object", &[u64::from(n)], faces().map(|f| f.object as i32))?;
            let sides = self.objects.len() as u64;
            npz.array("side_area", &[sides], self.objects.iter().map(|o| o.area))?;
            npz.array("side_object", &[sides], self.objects.iter().map(|o| o.object as i32))?;
            npz.array("side_front", &[sides], self.objects.iter().map(|o| o.front))?;
            npz.array("convergence", &[4], self.convergence.numbers().into_iter())?;
            let has_elements = self.mesh.sides().0;
            npz.array("sides", &[has_elements.len() as u64], has_elements.into_iter())?;
            for (name, field) in [
                ("node_reflected", Some(&self.reflected)),
                ("node_indirect", Some(&self.indirect)),
                ("node_caustic", self.caustic.as_ref()),
                ("node_map", self.caustic_map.as_ref().map(CausticMap::field)),
            ] {
                let Some(field) = field else { continue };
                let shape = [field.nodes().len() as u64, 3];
                npz.array(name, &shape, field.nodes().iter().flatten().copied())?;
            }
            npz.array("meta", &[meta.len() as u64], meta.bytes())?;
            Ok(npz.finish()?.into_inner())
        };
        write().map_err(|e| Error::io("solution", e))
    }

    /// The solution of `scene` in the file at `path`, as [`Solution::to_npz`] wrote it.
    ///
    /// # Errors
    /// The file cannot be read, is damaged or no solution, or was solved for other geometry, materials or light from outside
    /// than the scene has now.
    pub fn read_npz(scene: &Scene, path: &Path) -> Result<Kept> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        Arrays::open(scene, path, &bytes)?.solution(scene)
    }
}

fn hash_text(scene: &Scene) -> String {
    format!("{:016x}", scene.hash())
}

/// A solution file while it is read.
struct Arrays<'a> {
    npz: Reader<Cursor<&'a [u8]>>,
    path: &'a Path,
    /// What to do about a file that is of no use.
    remedy: String,
    meta: Map<String, Value>,
}

impl<'a> Arrays<'a> {
    /// Reads what the file says about itself and refuses one of another scene.
    fn open(scene: &Scene, path: &'a Path, bytes: &'a [u8]) -> Result<Arrays<'a>> {
        let solve = |to: &Path| format!("twopass solve {} -o {}", scene.path.display(), to.display());
        // Not over a file that may be something else.
        let other = solve(Path::new("NAME.npz"));
        let npz = Reader::new(Cursor::new(bytes)).map_err(|e| {
            let message = format!("is no solution file, or a damaged one ({e}); write one with: {other}");
            Error::parse(path, None, message)
        })?;
        let mut arrays = Arrays { npz, path, remedy: other, meta: Map::new() };
        let Some(meta) = arrays.bytes("meta", MOST_META)? else {
            return Err(arrays.refuse("is an .npz file, but no solution"));
        };
        arrays.remedy = solve(path);
        let text: Vec<u8> = arrays.values("meta", &meta, None)?;
        let parsed: Option<Value> = serde_json::from_slice(&text).ok();
        let Some(Value::Object(meta)) = parsed else { return Err(arrays.damaged("meta is no JSON")) };
        if meta.get("format") != Some(&json!(FORMAT)) {
            let by = meta.get("versions").and_then(|v| v.get("twopass")).and_then(Value::as_str);
            let by = by.map(|v| format!(" {v}")).unwrap_or_default();
            return Err(arrays.refuse(format!("was written by a twopass{by} with other contents")));
        }
        if meta.get("scene_hash") != Some(&json!(hash_text(scene))) {
            return Err(arrays.stale(scene, &meta));
        }
        arrays.meta = meta;
        Ok(arrays)
    }

    fn refuse(&self, what: impl std::fmt::Display) -> Error {
        Error::parse(self.path, None, format!("{what}; write one with: {}", self.remedy))
    }

    fn damaged(&self, what: impl std::fmt::Display) -> Error {
        self.refuse(format!("is damaged ({what})"))
    }

    /// The refusal of another scene's solution, with the command that makes the right one.
    fn stale(&self, scene: &Scene, meta: &Map<String, Value>) -> Error {
        let setting = |key: &str| meta.get("settings").and_then(|s| s.get(key));
        let mut again = self.remedy.clone();
        if let Some(rays) = setting("rays").and_then(Value::as_u64) {
            again += &format!(" --rays {rays}");
        }
        if let Some(size) = setting("element_size").and_then(Value::as_f64) {
            again += &format!(" --element-size {}", size / scene.unit);
        }
        if let Some(seed) = setting("seed").and_then(Value::as_u64).filter(|s| *s != 0) {
            again += &format!(" --seed {seed}");
        }
        if meta.get("adaptive") == Some(&json!(true)) {
            again += " --adaptive";
            if let Some(quality) = meta.get("quality").and_then(Value::as_str) {
                again += &format!(" --quality {quality}");
            }
        }
        let message = format!(
            "is stale: geometry, materials, emitters or environment of {} are not those that it was solved for; solve again: {again}",
            scene.path.display()
        );
        Error::parse(self.path, None, message)
    }

    /// The bytes of an array's entry of at most `most` bytes of values; none where there is no such array.
    fn bytes(&mut self, name: &str, most: u64) -> Result<Option<Vec<u8>>> {
        self.npz.bytes(name, most).map_err(|e| self.damaged(format!("{name}: {e}")))
    }

    /// The values of an array, rows first, which has `shape` where one is given.
    fn values<T: Deserialize + Copy>(
        &self,
        name: &str,
        bytes: &[u8],
        shape: Option<&[u64]>,
    ) -> Result<Vec<T>> {
        let read = || -> std::io::Result<Vec<T>> {
            let file = NpyFile::new(bytes)?;
            let (is, items) = (file.shape().to_vec(), (bytes.len() / size_of::<T>().max(1)) as u128);
            if shape.is_some_and(|s| s != is) || is.iter().map(|n| u128::from(*n)).product::<u128>() > items {
                return Err(std::io::Error::other(format!("its shape is {is:?}")));
            }
            // Of arrays that are not contiguous by rows, as slices and transposes, NumPy writes columns first.
            let columns_first = is.len() > 1 && file.order() == npyz::Order::Fortran;
            let values = file.into_vec()?;
            match is[..] {
                _ if !columns_first => Ok(values),
                [rows, columns] => Ok(rows_first(&values, rows as usize, columns as usize)),
                _ => Err(std::io::Error::other("it is in Fortran order")),
            }
        };
        read().map_err(|e| self.damaged(format!("{name}: {e}")))
    }

    fn get<T: Deserialize + Copy>(&mut self, name: &str, shape: &[u64]) -> Result<Vec<T>> {
        let most = shape.iter().product::<u64>() * size_of::<T>() as u64;
        match self.bytes(name, most)? {
            Some(bytes) => self.values(name, &bytes, Some(shape)),
            None => Err(self.damaged(format!("it has no {name}"))),
        }
    }

    fn triples(&mut self, name: &str, n: usize) -> Result<Vec<Rgb>> {
        let flat: Vec<f64> = self.get(name, &[n as u64, 3])?;
        Ok(flat.chunks_exact(3).map(Rgb::from_slice).collect())
    }

    fn field(&mut self, name: &str, nodes: &Nodes) -> Result<Field> {
        let flat: Vec<f32> = self.get(name, &[nodes.count() as u64, 3])?;
        if let Some(number) = flat.iter().find(|x| !x.is_finite()) {
            return Err(self.damaged(format!("{name} holds {number}")));
        }
        Ok(Field::of_nodes(flat.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect()))
    }

    /// A length that `meta` states.
    fn size(&self, name: &str) -> Result<f64> {
        let size = self.meta.get(name).and_then(Value::as_f64).filter(|s| *s > 0.0);
        size.ok_or_else(|| self.damaged(format!("meta has no {name}")))
    }

    fn solution(mut self, scene: &Scene) -> Result<Kept> {
        let sides = Sides(self.get("sides", &[2 * scene.faces.len() as u64])?);
        let mesh = self.mesh(scene, &sides)?;
        let n = mesh.len();
        // Areas tell whether the elements are those that were solved.
        let area: Vec<f64> = self.get("area", &[n as u64])?;
        if (0..n).any(|e| mesh.area(e as u32) != area[e]) {
            return Err(self.damaged("its elements are not the scene's"));
        }
        let nodes = Nodes::new(scene, &mesh);
        let caustic =
            if self.npz.has("node_caustic") { Some(self.field("node_caustic", &nodes)?) } else { None };
        let caustic_map = match self.meta.get("map_element_size") {
            None | Some(Value::Null) => None,
            Some(_) => {
                let cells = Mesh::new(scene, &mesh.sides(), self.size("map_element_size")?, false)?;
                let nodes = Nodes::new(scene, &cells);
                let field = self.field("node_map", &nodes)?;
                Some(CausticMap::of(cells, nodes, field))
            }
        };
        let convergence: Vec<f64> = self.get("convergence", &[4])?;
        let convergence = [0, 1, 2, 3].map(|k| convergence[k]);
        let power = self.triples("power", Ledger::ROWS)?;
        let solution = Solution {
            radiosity: self.triples("radiosity", n)?,
            emitted: self.triples("emitted", n)?,
            irradiance: self.triples("irradiance", n)?,
            direct: self.triples("direct", n)?,
            standard_error: self.triples("standard_error", n)?,
            objects: self.objects(scene)?,
            ledger: Ledger::of_rows(&power),
            convergence: Convergence::of_numbers(convergence),
            reflected: self.field("node_reflected", &nodes)?,
            indirect: self.field("node_indirect", &nodes)?,
            caustic,
            caustic_map,
            nodes,
            mesh,
        };
        Ok(Kept { solution, about: self.meta })
    }

    /// The elements: their levels tell those of an adaptive mesh.
    fn mesh(&mut self, scene: &Scene, sides: &Sides) -> Result<Mesh> {
        let size = self.size("element_size")?;
        let Some(bytes) = self.bytes("levels", 2 * u64::from(MOST_ELEMENTS))? else {
            return Mesh::new(scene, sides, size, false);
        };
        let levels: Vec<u8> = self.values("levels", &bytes, None)?;
        let levels: Vec<Levels> = levels.chunks_exact(2).map(|l| [l[0], l[1]]).collect();
        let division = Division::of_levels(scene, sides, size, &levels);
        let division = division.ok_or_else(|| self.damaged("levels: no such mesh"))?;
        Mesh::divided(scene, sides, &division, false)
    }

    fn objects(&mut self, scene: &Scene) -> Result<Vec<ObjectRadiosity>> {
        let most = 2 * size_of::<i32>() * scene.objects.len();
        let sides = self.bytes("side_object", most as u64)?.unwrap_or_default();
        let object: Vec<i32> = self.values("side_object", &sides, None)?;
        let n = object.len();
        let front: Vec<bool> = self.get("side_front", &[n as u64])?;
        let area: Vec<f64> = self.get("side_area", &[n as u64])?;
        let (mean, error) = (self.triples("side_radiosity", n)?, self.triples("side_standard_error", n)?);
        (0..n)
            .map(|k| {
                let name = usize::try_from(object[k]).ok().and_then(|o| scene.objects.get(o));
                let name = name.ok_or_else(|| self.damaged("side_object: no such object"))?.clone();
                let (object, front, area) = (object[k] as u32, front[k], area[k]);
                Ok(ObjectRadiosity {
                    object,
                    name,
                    front,
                    area,
                    radiosity: mean[k],
                    standard_error: error[k],
                })
            })
            .collect()
    }
}

fn triples(npz: &mut Writer<impl Write + Seek>, name: &str, values: &[Rgb]) -> std::io::Result<()> {
    npz.array(name, &[values.len() as u64, 3], values.iter().flat_map(|v| v.to_array()))
}

/// The values of a table that are stored by columns, by rows.
fn rows_first<T: Copy>(values: &[T], rows: usize, columns: usize) -> Vec<T> {
    (0..rows * columns).map(|i| values[i % columns * rows + i / columns]).collect()
}
