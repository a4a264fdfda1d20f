//! For NumPy and SciPy.

use super::Factors;
use crate::npz::Writer;
use std::io::{Result as IoResult, Seek, Write};

/// What `scipy.sparse.load_npz` reads: CSR, f64, sorted columns, \[rows, nodes\]. Beside it, for `numpy.load`:
/// `standard_error` of the stored entries in their order (none of hemi-cubes in one position each), `area` \[nodes\], `escaped` and
/// `absorbed` \[rows\], `objects` (names of the objects' sides) and `object` \[nodes\], an index into these.
///
/// # Errors
/// Those of the file.
pub fn write_npz(factors: &Factors, file: &mut (impl Write + Seek)) -> IoResult<()> {
    let mut npz = Writer::new(file);
    npz.text("format", "csr")?;
    let shape = [factors.rows.len(), factors.nodes()];
    array(&mut npz, "shape", shape.iter().map(|n| *n as i64))?;
    // SciPy wants both kinds of indices to be of one type.
    if i32::try_from(factors.columns.len()).is_ok() {
        array(&mut npz, "indices", factors.columns.iter().map(|j| *j as i32))?;
        array(&mut npz, "indptr", factors.start.iter().map(|k| *k as i32))?;
    } else {
        array(&mut npz, "indices", factors.columns.iter().map(|j| i64::from(*j)))?;
        array(&mut npz, "indptr", factors.start.iter().map(|k| *k as i64))?;
    }
    array(&mut npz, "data", factors.values.iter().copied())?;
    array(&mut npz, "area", factors.areas.iter().copied())?;
    array(&mut npz, "escaped", factors.escaped.iter().copied())?;
    array(&mut npz, "absorbed", factors.absorbed.iter().copied())?;
    npz.texts("objects", &factors.names)?;
    array(&mut npz, "object", factors.object.iter().map(|k| *k as i32))?;
    if !factors.errors.is_empty() {
        array(&mut npz, "standard_error", factors.errors.iter().copied())?;
    }
    npz.finish()?;
    Ok(())
}

fn array<T: npyz::AutoSerialize>(
    npz: &mut Writer<impl Write + Seek>,
    name: &str,
    values: impl ExactSizeIterator<Item = T>,
) -> IoResult<()> {
    npz.array(name, &[values.len() as u64], values)
}
