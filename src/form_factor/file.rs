//! Matrices as files that other programs read.

use super::ExchangeMatrix;
use super::pairs::PairFactors;
use crate::color;
use crate::{Error, Result};
use npyz::npz::NpzWriter;
use npyz::sparse::Csr;
use std::collections::BTreeMap;
use std::io::Cursor;

impl ExchangeMatrix {
    /// The matrix as `scipy.sparse.load_npz` reads it: CSR, f64, sorted columns, [n, n].
    pub fn to_npz(&self) -> Result<Vec<u8>> {
        let sums = |row: usize| {
            let mut sums = BTreeMap::<usize, f64>::new();
            for (j, f) in self.row(row) {
                *sums.entry(j).or_default() += color::mean(f);
            }
            sums
        };
        npz(self.len(), sums)
    }
}

impl PairFactors {
    /// The factors as `scipy.sparse.load_npz` reads them: CSR, f64, sorted columns, [n, n].
    pub fn to_npz(&self) -> Result<Vec<u8>> {
        npz(self.len(), |row| self.row(row).collect::<Vec<_>>())
    }
}

/// A square matrix from its rows' (column, value) in the columns' order.
fn npz<R: IntoIterator<Item = (usize, f64)>>(n: usize, rows: impl Fn(usize) -> R) -> Result<Vec<u8>> {
    let mut csr: Csr<f64> =
        Csr { data: Vec::new(), indices: Vec::new(), indptr: vec![0], shape: [n as u64, n as u64] };
    for row in 0..n {
        for (column, value) in rows(row) {
            csr.indices.push(column as u64);
            csr.data.push(value);
        }
        csr.indptr.push(csr.data.len());
    }
    let mut bytes = Cursor::new(Vec::new());
    csr.write_npz(&mut NpzWriter::new(&mut bytes)).map_err(|e| Error::io("matrix", e))?;
    Ok(bytes.into_inner())
}
