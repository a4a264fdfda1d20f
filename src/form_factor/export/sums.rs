//! Rows whose randomisations become one factor and its standard error.

use crate::form_factor::ExchangeMatrix;

/// Sums of a row's randomisations, by column.
pub(super) struct Sums {
    /// Sum of the shares and of their squares, by column; zero but for the columns of the row at hand.
    sums: Vec<[f64; 2]>,
    /// Columns of the row at hand, a bit each.
    columns: Vec<u64>,
    /// Which of these words are not 0, a bit each.
    words: Vec<u64>,
}

impl Sums {
    /// For rows of `n` columns.
    pub(super) fn new(n: usize) -> Sums {
        let words = n.div_ceil(64);
        Sums { sums: vec![[0.0; 2]; n], columns: vec![0; words], words: vec![0; words.div_ceil(64)] }
    }

    /// Columns, factors and standard errors of a row in the order of the columns; no errors from a single randomisation.
    pub(super) fn row(&mut self, matrix: &ExchangeMatrix, row: usize, entries: &mut Vec<(u32, f64, f64)>) {
        let Sums { sums, columns, words } = self;
        entries.clear();
        matrix.at(row).each_mean(|j, f| {
            let s = &mut sums[j];
            *s = [s[0] + f, s[1] + f * f];
            columns[j / 64] |= 1 << (j % 64);
            words[j / 4096] |= 1 << (j / 64 % 64);
        });
        // Each randomisation's estimate is `b` times its share of the row; its absence is an estimate of 0.
        let b = matrix.batches() as f64;
        for (k, word) in words.iter_mut().enumerate() {
            for k in bits(word).map(|bit| 64 * k + bit) {
                for j in bits(&mut columns[k]).map(|bit| 64 * k + bit) {
                    let [sum, square] = std::mem::take(&mut sums[j]);
                    let error = ((b * square - sum * sum).max(0.0) / (b - 1.0)).sqrt();
                    if sum != 0.0 {
                        entries.push((j as u32, sum, error));
                    }
                }
            }
        }
    }
}

/// The bits that are set, which it takes out.
fn bits(word: &mut u64) -> impl Iterator<Item = usize> + '_ {
    std::iter::from_fn(|| {
        let bit = word.trailing_zeros();
        *word &= word.wrapping_sub(1);
        (bit < 64).then_some(bit as usize)
    })
}
