//! The solution as a file that `numpy.load` opens (DESIGN section 6).

use super::Solution;
use crate::color::Rgb;
use crate::scene::Scene;
use crate::{Error, Result};
use glam::DVec3;
use npyz::WriterBuilder;
use npyz::npz::NpzWriter;
use std::io::{Cursor, Seek, Write};
use zip::CompressionMethod;
use zip::write::FileOptions;

impl Solution {
    /// The arrays of DESIGN section 6, one row an element; `meta` is JSON.
    pub fn to_npz(&self, scene: &Scene, meta: &str) -> Result<Vec<u8>> {
        let mut bytes = Cursor::new(Vec::new());
        let mut npz = NpzWriter::new(&mut bytes);
        let n = self.mesh.len() as u32;
        let faces = || (0..n).map(|e| &scene.faces[self.mesh.place(e).0 as usize]);
        let centroid: Vec<DVec3> =
            (0..n).map(|e| (self.mesh.centroid(scene, e) + scene.center) / scene.unit).collect();
        let normal: Vec<DVec3> = (0..n).map(|e| self.mesh.normal(scene, e)).collect();
        let write = || -> std::io::Result<()> {
            for (name, values) in [
                ("radiosity", &self.radiosity),
                ("irradiance", &self.irradiance),
                ("direct", &self.direct),
                ("standard_error", &self.standard_error),
                ("centroid", &centroid),
                ("normal", &normal),
            ] {
                triples(&mut npz, name, values)?;
            }
            array(&mut npz, "area", &[u64::from(n)], (0..n).map(|e| self.mesh.area(e)))?;
            array(&mut npz, "object", &[u64::from(n)], faces().map(|f| f.object as i32))?;
            array(&mut npz, "meta", &[meta.len() as u64], meta.bytes())
        };
        let mut write = write;
        write().map_err(|e| Error::io("solution", e))?;
        drop(npz);
        Ok(bytes.into_inner())
    }
}

fn triples<W: Write + Seek>(npz: &mut NpzWriter<W>, name: &str, values: &[Rgb]) -> std::io::Result<()> {
    array(npz, name, &[values.len() as u64, 3], values.iter().flat_map(|v| v.to_array()))
}

fn array<W: Write + Seek, T: npyz::AutoSerialize>(
    npz: &mut NpzWriter<W>,
    name: &str,
    shape: &[u64],
    values: impl Iterator<Item = T>,
) -> std::io::Result<()> {
    // Not compressed: the last digits are noise, and a million elements would take as long as their solution.
    let options = FileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
    let mut writer = npz.array(name, options)?.default_dtype().shape(shape).begin_nd()?;
    writer.extend(values)?;
    writer.finish()
}
