//! Wavefront OBJ files: polygons, their objects and the names of their materials.

use super::obj_text::{self, ObjText};
use crate::error::{Error, Result};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Largest coordinate [m] that single precision can still square.
const MAX_COORDINATE: f64 = 1e18;

/// One polygon of an OBJ file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Polygon {
    /// Indices into [`ObjFile::positions`].
    pub corners: Vec<u32>,
    /// Indices into [`ObjFile::normals`], where every corner has one.
    pub normals: Option<Vec<u32>>,
    /// Index into [`ObjFile::objects`].
    pub object: u32,
    /// Index into [`ObjFile::materials`]; `None` before any `usemtl`.
    pub material: Option<u32>,
    /// Line in the file.
    pub line: usize,
}

/// What one OBJ file holds.
#[derive(Debug, Default)]
pub(super) struct ObjFile {
    /// The file.
    pub path: PathBuf,
    /// Names after `o` and `g`, in the order of their first statement; some may have no polygon.
    pub objects: Vec<String>,
    /// Names after `usemtl`.
    pub materials: Vec<String>,
    /// What follows each `mtllib`, with its line.
    pub libraries: Vec<(usize, String)>,
    /// Vertices that polygons use, in file units; the same point may occur more than once.
    pub positions: Vec<DVec3>,
    /// Normals that polygons use, of any length.
    pub normals: Vec<DVec3>,
    /// The polygons, in the order of the file.
    pub polygons: Vec<Polygon>,
    /// What to do where there is no polygon.
    pub advice: &'static str,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Reads an OBJ file whose unit is `unit` metres.
///
/// # Errors
/// The file cannot be read, or a statement is malformed; the error names the line.
pub(super) fn read(path: &Path, unit: f64) -> Result<ObjFile> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    parse(path, &String::from_utf8_lossy(&bytes), unit)
}

/// Reads OBJ text; see [`read`].
pub(super) fn parse(path: &Path, text: &str, unit: f64) -> Result<ObjFile> {
    let text = obj_text::read(path, text, MAX_COORDINATE / unit)?;
    let names: String = (0..text.materials.len()).map(|i| format!("newmtl {i}\n")).collect();
    let options = tobj::LoadOptions::default();
    // The canonical text names materials by index; any `mtllib` stands for the list of them.
    let canonical = format!("mtllib all\n{}", text.canonical);
    let loaded = tobj::load_obj_buf(&mut canonical.as_bytes(), &options, |_| {
        tobj::load_mtl_buf(&mut names.as_bytes())
    });
    let (models, _) = loaded.map_err(|e| Error::parse(path, None, e.to_string()))?;
    collect(path, text, models)
}

fn collect(path: &Path, text: ObjText, models: Vec<tobj::Model>) -> Result<ObjFile> {
    let mut file = ObjFile {
        path: path.into(),
        objects: text.objects,
        materials: text.materials,
        libraries: text.libraries,
        advice: text.advice,
        warnings: text.warnings,
        ..ObjFile::default()
    };
    let mut lines = text.face_lines.into_iter();
    for model in models {
        let mesh = model.mesh;
        if mesh.indices.is_empty() {
            continue;
        }
        let too_many = || Error::parse(path, None, "more than 4294967295 vertices");
        let first_position = u32::try_from(file.positions.len()).map_err(|_| too_many())?;
        let first_normal = u32::try_from(file.normals.len()).map_err(|_| too_many())?;
        file.positions.extend(triples(&mesh.positions));
        file.normals.extend(triples(&mesh.normals));
        u32::try_from(file.positions.len().max(file.normals.len())).map_err(|_| too_many())?;

        // The canonical text names objects by index.
        let object = model.name.parse().unwrap_or(0);
        let material = mesh.material_id.map(|id| id as u32);
        // tobj leaves out the arities of a mesh of triangles.
        let triangles = mesh.indices.len() / 3 * usize::from(mesh.face_arities.is_empty());
        let arities = mesh.face_arities.iter().map(|&n| n as usize);
        let mut at = 0;
        for arity in arities.chain(std::iter::repeat_n(3, triangles)) {
            let corners = &mesh.indices[at..at + arity];
            let normals = &mesh.normal_indices[at..at + arity];
            at += arity;
            let has_normal = |&n: &u32| !file.normals[(n + first_normal) as usize].is_nan();
            file.polygons.push(Polygon {
                corners: corners.iter().map(|c| c + first_position).collect(),
                normals: normals
                    .iter()
                    .all(has_normal)
                    .then(|| normals.iter().map(|n| n + first_normal).collect()),
                object,
                material,
                line: lines.next().unwrap_or_default(),
            });
        }
    }
    Ok(file)
}

fn triples(values: &[f64]) -> impl Iterator<Item = DVec3> + '_ {
    values.chunks_exact(3).map(DVec3::from_slice)
}
