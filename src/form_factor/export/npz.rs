//! For NumPy and SciPy.

use super::Factors;
use crate::{Error, Result};
use npyz::WriterBuilder;
use npyz::npz::NpzWriter;
use npyz::sparse::Csr;
use std::io::{Cursor, Result as IoResult};

/// What `scipy.sparse.load_npz` reads: CSR, f64, sorted columns, [rows, nodes]. Beside it, for `numpy.load`:
/// `standard_error` of the stored entries in their order (where there are), `area` [nodes], `escaped` and
/// `absorbed` [rows].
pub fn to_npz(factors: &Factors) -> Result<Vec<u8>> {
    let csr: Csr<f64> = Csr {
        data: factors.values.clone(),
        indices: factors.columns.iter().map(|&j| u64::from(j)).collect(),
        indptr: factors.start.clone(),
        shape: [factors.rows.len() as u64, factors.nodes() as u64],
    };
    let mut bytes = Cursor::new(Vec::new());
    let mut npz = NpzWriter::new(&mut bytes);
    let mut write = || -> IoResult<()> {
        csr.write_npz(&mut npz)?;
        let arrays = [
            ("area", &factors.areas),
            ("escaped", &factors.escaped),
            ("absorbed", &factors.absorbed),
            ("standard_error", &factors.errors),
        ];
        for (name, values) in arrays.into_iter().filter(|(name, v)| !v.is_empty() || *name == "area") {
            let array = npz.array(name, Default::default())?;
            let mut writer = array.default_dtype().shape(&[values.len() as u64]).begin_nd()?;
            writer.extend(values.iter().copied())?;
            writer.finish()?;
        }
        Ok(())
    };
    write().map_err(|e| Error::io("matrix", e))?;
    drop(npz);
    Ok(bytes.into_inner())
}
