//! Matrices as files that other programs read.

use super::ExchangeMatrix;
use crate::color;
use crate::{Error, Result};
use npyz::npz::NpzWriter;
use npyz::sparse::Csr;
use std::collections::BTreeMap;
use std::io::Cursor;

impl ExchangeMatrix {
    /// The matrix as `scipy.sparse.load_npz` reads it: CSR, f64, sorted columns, [n, n].
    pub fn to_npz(&self) -> Result<Vec<u8>> {
        let n = self.len();
        let mut csr: Csr<f64> =
            Csr { data: Vec::new(), indices: Vec::new(), indptr: vec![0], shape: [n as u64, n as u64] };
        for row in 0..n {
            let mut sums = BTreeMap::<usize, f64>::new();
            for (j, f) in self.row(row) {
                *sums.entry(j).or_default() += color::mean(f);
            }
            csr.indices.extend(sums.keys().map(|&j| j as u64));
            csr.data.extend(sums.values());
            csr.indptr.push(csr.data.len());
        }
        let mut bytes = Cursor::new(Vec::new());
        csr.write_npz(&mut NpzWriter::new(&mut bytes)).map_err(|e| Error::io("matrix", e))?;
        Ok(bytes.into_inner())
    }
}
