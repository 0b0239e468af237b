//! Log-determinant of the covariance of a patch of a stationary field.
//!
//! The covariance of `rows` x `cols` pixels of a stationary field is block-Toeplitz (blocks depend on the difference
//! of rows) with Toeplitz blocks (on the difference of columns). The recursion of Whittle (1963) and of Wiggins and
//! Robinson (1965) predicts each row from those above it. The determinant is the product of the determinants of the
//! prediction-error covariances. The covariance is unchanged by a rotation of 180 degrees, so the backward predictor
//! is the rotated forward one. This saves half of the recursion. The cost is about 2 rows^2 cols^3 floating-point
//! operations instead of rows^3 cols^3 / 3.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use ndarray::Array2;

use crate::information::error::InformationError;

/// Log-determinant, `log2 det C`, bits, of the covariance of a patch of `patch` = (rows, cols) pixels of a stationary
/// field with the given autocovariance.
///
/// `autocovariance` has shape (2L+1, 2L+1), entry `[L + dr, L + dc]` at a lag of `dr` rows and `dc` columns, in
/// photons squared. Lags up to one less than the patch are used. Only the half with `dr >= 0` is read, and for
/// `dr = 0` only `dc >= 0`.
///
/// # Errors
/// When the patch is empty, the lags do not suffice, or the covariance is not positive definite.
pub fn log2_determinant(autocovariance: &Array2<f64>, patch: (usize, usize)) -> Result<f64, InformationError> {
    // The list is never empty, since a patch of no rows is refused.
    Ok(log2_determinants_by_row(autocovariance, patch)?.last().copied().unwrap_or(0.0))
}

/// [`log2_determinant`] of the first 1, 2, ..., rows of the patch: entry `r - 1` belongs to `r` x cols pixels.
pub fn log2_determinants_by_row(
    autocovariance: &Array2<f64>,
    patch: (usize, usize),
) -> Result<Vec<f64>, InformationError> {
    let (rows, cols) = patch;
    check_lags(autocovariance, patch)?;
    let centre_row = autocovariance.nrows() / 2;
    let centre_col = autocovariance.ncols() / 2;
    // Entry [a, b] of the block of row lag k: the covariance of column a with column b of the row k above.
    let covariance = |k: usize, a: usize, b: usize| {
        let column = if k == 0 { centre_col + a.abs_diff(b) } else { centre_col + a - b };
        autocovariance[[centre_row + k, column]]
    };
    let variance = covariance(0, 0, 0);
    let smallest_pivot = variance * f64::EPSILON * cols as f64;

    let block = cols * cols;
    // The blocks of row lag rows-1, ..., 1 above each other; the m-th predictor uses the last m of them.
    let height = rows.saturating_sub(1) * cols;
    let mut stacked = vec![0.0; height * cols];
    for b in 0..cols {
        for k in 1..rows {
            let start = b * height + (rows - 1 - k) * cols;
            for a in 0..cols {
                stacked[start + a] = covariance(k, a, b);
            }
        }
    }
    let mut error: Vec<f64> = (0..block).map(|i| covariance(0, i % cols, i / cols)).collect();
    let mut predictor = vec![0.0; height * cols];
    let mut product = vec![0.0; height * cols];
    let (mut factor, mut reflected, mut gain) = (vec![0.0; block], vec![0.0; block], vec![0.0; block]);

    let mut total = factorise(&error, &mut factor, cols, smallest_pivot, 0)?;
    let mut totals = vec![total];
    for order in 0..rows - 1 {
        let width = order * cols;
        // The covariance at lag order + 1 that the predictor of `order` rows does not explain, columns reversed.
        {
            let known = MatRef::from_column_major_slice(&predictor[..cols * width], cols, width);
            let below = MatRef::from_column_major_slice_with_stride(&stacked, height, cols, height);
            for (b, column) in gain.chunks_exact_mut(cols).enumerate() {
                for (a, entry) in column.iter_mut().enumerate() {
                    *entry = covariance(order + 1, a, b);
                }
            }
            let unexplained = MatMut::from_column_major_slice_mut(&mut gain, cols, cols);
            matmul(unexplained, Accum::Add, known, below.subrows(height - width, width), -1.0, Par::Seq);
        }
        for (target, source) in reflected.chunks_exact_mut(cols).zip(gain.chunks_exact(cols).rev()) {
            target.copy_from_slice(source);
        }
        divide_by_transposed(&mut reflected, &factor, cols);
        subtract_outer(&mut error, &reflected, cols);
        if order + 2 < rows {
            gain.copy_from_slice(&reflected);
            divide_by(&mut gain, &factor, cols);
            let known = MatRef::from_column_major_slice(&predictor[..cols * width], cols, width);
            let gain_view = MatRef::from_column_major_slice(&gain, cols, cols);
            let change = MatMut::from_column_major_slice_mut(&mut product[..cols * width], cols, width);
            matmul(change, Accum::Replace, gain_view, known, 1.0, Par::Seq);
            let changes = product[..cols * width].chunks_exact(cols).rev();
            for (column, change) in predictor[..cols * width].chunks_exact_mut(cols).zip(changes) {
                for (entry, difference) in column.iter_mut().zip(change) {
                    *entry -= difference;
                }
            }
            let newest = predictor[cols * width..cols * (width + cols)].chunks_exact_mut(cols);
            for (column, source) in newest.zip(gain.chunks_exact(cols).rev()) {
                column.copy_from_slice(source);
            }
        }
        total += factorise(&error, &mut factor, cols, smallest_pivot, order + 1)?;
        totals.push(total);
    }
    Ok(totals)
}

/// Whether `autocovariance` has odd sides and lags enough for the patch.
pub(in crate::information) fn check_lags(
    autocovariance: &Array2<f64>,
    patch: (usize, usize),
) -> Result<(), InformationError> {
    let (rows, cols) = patch;
    if rows == 0 || cols == 0 {
        return Err(InformationError::PatchSize { rows, cols, limit: super::dense::MAX_PATCH_PIXELS });
    }
    let (lag_rows, lag_cols) = autocovariance.dim();
    if lag_rows % 2 == 0 || lag_cols % 2 == 0 || lag_rows / 2 + 1 < rows || lag_cols / 2 + 1 < cols {
        return Err(InformationError::Lags { needed: rows.max(cols) - 1, rows: lag_rows, cols: lag_cols });
    }
    Ok(())
}

/// Cholesky factor of the lower half of `matrix` (column-major, `n` x `n`) into `factor`; its log2-determinant.
fn factorise(
    matrix: &[f64],
    factor: &mut [f64],
    n: usize,
    smallest_pivot: f64,
    row: usize,
) -> Result<f64, InformationError> {
    factor.copy_from_slice(matrix);
    let mut ln_determinant = 0.0;
    for j in 0..n {
        let (before, from) = factor.split_at_mut(j * n);
        let column = &mut from[j..n];
        for earlier in before.chunks_exact(n) {
            let scale = earlier[j];
            for (entry, other) in column.iter_mut().zip(&earlier[j..]) {
                *entry -= scale * other;
            }
        }
        let pivot = column[0];
        // Written so that a NaN is refused too.
        if !(pivot > smallest_pivot && pivot.is_finite()) {
            return Err(InformationError::NotPositiveDefinite { row });
        }
        ln_determinant += pivot.ln();
        let scale = 1.0 / pivot.sqrt();
        for entry in column {
            *entry *= scale;
        }
    }
    Ok(ln_determinant / std::f64::consts::LN_2)
}

/// `matrix <- matrix L^-T` for the lower-triangular `factor` L, both column-major `n` x `n`.
fn divide_by_transposed(matrix: &mut [f64], factor: &[f64], n: usize) {
    for j in 0..n {
        let (before, from) = matrix.split_at_mut(j * n);
        let column = &mut from[..n];
        for (i, earlier) in before.chunks_exact(n).enumerate() {
            let scale = factor[i * n + j];
            for (entry, other) in column.iter_mut().zip(earlier) {
                *entry -= scale * other;
            }
        }
        let scale = 1.0 / factor[j * n + j];
        for entry in column {
            *entry *= scale;
        }
    }
}

/// `matrix <- matrix L^-1` for the lower-triangular `factor` L, both column-major `n` x `n`.
fn divide_by(matrix: &mut [f64], factor: &[f64], n: usize) {
    for j in (0..n).rev() {
        let (before, after) = matrix.split_at_mut((j + 1) * n);
        let column = &mut before[j * n..];
        for (offset, later) in after.chunks_exact(n).enumerate() {
            let scale = factor[j * n + j + 1 + offset];
            for (entry, other) in column.iter_mut().zip(later) {
                *entry -= scale * other;
            }
        }
        let scale = 1.0 / factor[j * n + j];
        for entry in column {
            *entry *= scale;
        }
    }
}

/// Lower half of `matrix <- matrix - V V^T`, all column-major `n` x `n`.
fn subtract_outer(matrix: &mut [f64], v: &[f64], n: usize) {
    for j in 0..n {
        let column = &mut matrix[j * n + j..(j + 1) * n];
        for other in v.chunks_exact(n) {
            let scale = other[j];
            for (entry, value) in column.iter_mut().zip(&other[j..]) {
                *entry -= scale * value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::dense::{dense_covariance, log2_determinant_dense};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The autocovariance of white noise filtered by a random kernel, plus white noise: positive definite by
    /// construction.
    fn random_autocovariance(seed: u64, kernel: usize, lag: usize, floor: f64) -> Array2<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let taps = Array2::from_shape_fn((kernel, kernel), |_| rng.random::<f64>() - 0.4);
        let mut out = Array2::zeros((2 * lag + 1, 2 * lag + 1));
        for ((r, c), a) in taps.indexed_iter() {
            for ((s, d), b) in taps.indexed_iter() {
                let (row, col) = (lag + r - s.min(lag + r), lag + c);
                if s <= lag + r && d <= col && row < out.nrows() && col - d < out.ncols() {
                    out[[row, col - d]] += a * b;
                }
            }
        }
        out[[lag, lag]] += floor;
        out
    }

    #[test]
    fn agrees_with_dense_cholesky() {
        for (seed, rows, cols, floor) in
            [(1, 1, 1, 1.0), (2, 1, 7, 0.5), (3, 9, 1, 0.5), (4, 5, 8, 1e-3), (5, 12, 12, 0.1), (6, 16, 9, 1e-4)]
        {
            let autocovariance = random_autocovariance(seed, 6, 16, floor);
            let quick = log2_determinants_by_row(&autocovariance, (rows, cols)).unwrap();
            assert_eq!(quick.len(), rows);
            for (r, value) in quick.iter().enumerate() {
                let dense = log2_determinant_dense(&dense_covariance(&autocovariance, (r + 1, cols))).unwrap();
                assert!((value - dense).abs() < 1e-10 * dense.abs().max(1.0), "{rows}x{cols} row {r}: {value} {dense}");
            }
        }
    }

    #[test]
    fn agrees_with_dense_cholesky_at_working_size() {
        let autocovariance = random_autocovariance(7, 20, 31, 0.3);
        let quick = log2_determinant(&autocovariance, (32, 32)).unwrap();
        let dense = log2_determinant_dense(&dense_covariance(&autocovariance, (32, 32))).unwrap();
        assert!((quick - dense).abs() < 1e-10 * dense.abs(), "{quick} {dense}");
    }

    #[test]
    fn white_noise_is_a_product_of_variances() {
        let mut autocovariance = Array2::zeros((9, 9));
        autocovariance[[4, 4]] = 8.0;
        assert!((log2_determinant(&autocovariance, (5, 5)).unwrap() - 75.0).abs() < 1e-12);
    }

    #[test]
    fn refuses_what_is_no_covariance() {
        let mut autocovariance = Array2::zeros((5, 5));
        autocovariance[[2, 2]] = 1.0;
        autocovariance[[2, 1]] = 0.9;
        autocovariance[[2, 3]] = 0.9;
        let found = log2_determinant(&autocovariance, (2, 3));
        assert_eq!(found, Err(InformationError::NotPositiveDefinite { row: 0 }));
        let constant = Array2::ones((5, 5));
        assert!(matches!(log2_determinant(&constant, (3, 3)), Err(InformationError::NotPositiveDefinite { .. })));
        let nan = Array2::from_elem((5, 5), f64::NAN);
        assert!(matches!(log2_determinant(&nan, (3, 3)), Err(InformationError::NotPositiveDefinite { .. })));
    }

    #[test]
    fn refuses_too_few_lags_and_empty_patches() {
        let autocovariance = Array2::ones((5, 5));
        assert_eq!(
            log2_determinant(&autocovariance, (4, 2)),
            Err(InformationError::Lags { needed: 3, rows: 5, cols: 5 })
        );
        assert!(matches!(log2_determinant(&autocovariance, (0, 2)), Err(InformationError::PatchSize { .. })));
    }
}
