//! For NumPy and SciPy.

use super::Factors;
use npyz::{AutoSerialize, DType, WriterBuilder};
use std::io::{BufWriter, Result as IoResult, Seek, Write};
use zip::write::FileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Bytes that go into the file at a time: npyz writes each number by itself.
const BUFFER: usize = 1 << 16;

/// What `scipy.sparse.load_npz` reads: CSR, f64, sorted columns, \[rows, nodes\]. Beside it, for `numpy.load`:
/// `standard_error` of the stored entries in their order (where there are), `area` \[nodes\], `escaped` and
/// `absorbed` \[rows\].
///
/// Not compressed: factors are noise in their last digits, and compressing a matrix takes longer than finding it.
///
/// # Errors
/// Those of the file.
pub fn write_npz(factors: &Factors, file: &mut (impl Write + Seek)) -> IoResult<()> {
    let mut npz = ZipWriter::new(file);
    let text = DType::Plain("|S3".parse().map_err(std::io::Error::other)?);
    npz.start_file("format.npy", stored())?;
    let mut format = npyz::WriteOptions::new().dtype(text).shape(&[]).writer(&mut npz).begin_nd()?;
    format.push(b"csr".as_slice())?;
    format.finish()?;
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
    if !factors.errors.is_empty() {
        array(&mut npz, "standard_error", factors.errors.iter().copied())?;
    }
    npz.finish()?;
    Ok(())
}

fn stored() -> FileOptions {
    FileOptions::default().compression_method(CompressionMethod::Stored).large_file(true)
}

fn array<T: AutoSerialize>(
    npz: &mut ZipWriter<impl Write + Seek>,
    name: &str,
    values: impl ExactSizeIterator<Item = T>,
) -> IoResult<()> {
    npz.start_file(format!("{name}.npy"), stored())?;
    let shape = [values.len() as u64];
    let mut buffer = BufWriter::with_capacity(BUFFER, npz);
    let options = npyz::WriteOptions::new().default_dtype().shape(&shape);
    let mut writer = options.writer(&mut buffer).begin_nd()?;
    writer.extend(values)?;
    writer.finish()?;
    buffer.flush()
}
