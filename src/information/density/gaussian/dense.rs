//! Dense covariance matrices: assembly, Cholesky factor, log-determinant, log-densities.

use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Side};
use ndarray::{Array1, Array2, ArrayView3};
use rayon::prelude::*;

use crate::information::error::InformationError;

/// Largest patch of a dense covariance, pixels; the covariance then takes 512 MiB. A 65 x 65 sensor has 4,225 pixels.
pub const MAX_PATCH_PIXELS: usize = 8192;

/// Patches scored together: enough for fast matrix products, few enough for the cache.
const BATCH: usize = 512;

/// The covariance of a patch of (rows, cols) pixels, row by row; the lags must suffice.
pub(in crate::information) fn dense_covariance(autocovariance: &Array2<f64>, patch: (usize, usize)) -> Mat<f64> {
    let (rows, cols) = patch;
    let (centre_row, centre_col) = (autocovariance.nrows() / 2, autocovariance.ncols() / 2);
    Mat::from_fn(rows * cols, rows * cols, |i, j| {
        let (i, j) = if i >= j { (i, j) } else { (j, i) };
        autocovariance[[centre_row + i / cols - j / cols, centre_col + i % cols - j % cols]]
    })
}

/// A multivariate Gaussian with a Cholesky factor ready for scoring.
#[derive(Clone, Debug)]
pub(in crate::information) struct DenseGaussian {
    factor: Mat<f64>,
    log2_determinant: f64,
}

impl DenseGaussian {
    /// Factorises a covariance; `cols` is the patch width, to name the row where it fails.
    pub(in crate::information) fn new(covariance: &Mat<f64>, cols: usize) -> Result<Self, InformationError> {
        let llt = covariance.llt(Side::Lower).map_err(|error| {
            let faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index } = error;
            InformationError::NotPositiveDefinite { row: index / cols.max(1) }
        })?;
        let factor = llt.L().to_owned();
        let mut log2_determinant = 0.0;
        for i in 0..factor.nrows() {
            let pivot = factor[(i, i)];
            let variance = covariance[(i, i)];
            // A pivot at the level of rounding errors is not a variance.
            if !(pivot.is_finite() && pivot * pivot > variance * f64::EPSILON * 16.0) {
                return Err(InformationError::NotPositiveDefinite { row: i / cols.max(1) });
            }
            log2_determinant += 2.0 * pivot.log2();
        }
        Ok(Self { factor, log2_determinant })
    }

    /// Lower Cholesky factor of the covariance.
    pub(in crate::information) fn factor(&self) -> faer::MatRef<'_, f64> {
        self.factor.as_ref()
    }

    /// log2 det C.
    #[cfg(test)]
    pub(in crate::information) fn log2_determinant(&self) -> f64 {
        self.log2_determinant
    }

    /// Differential entropy `1/2 log2((2 pi e)^n det C)`, bits per patch.
    pub(in crate::information) fn entropy_bits(&self) -> f64 {
        0.5 * (self.factor.nrows() as f64 * (2.0 * std::f64::consts::PI * std::f64::consts::E).log2()
            + self.log2_determinant)
    }

    /// log2-density of each patch, bits per patch; `mean` gives the mean of pixel i.
    pub(in crate::information) fn log2_densities(
        &self,
        patches: ArrayView3<f32>,
        mean: impl Fn(usize) -> f64 + Sync,
    ) -> Array1<f64> {
        let pixels = self.factor.nrows();
        let constant = pixels as f64 * (2.0 * std::f64::consts::PI).log2() + self.log2_determinant;
        let half_bit = 0.5 / std::f64::consts::LN_2;
        let batches: Vec<_> = patches.axis_chunks_iter(ndarray::Axis(0), BATCH).collect();
        let scores: Vec<Vec<f64>> = batches
            .into_par_iter()
            .map(|batch| {
                let mut residuals = Mat::<f64>::zeros(pixels, batch.len_of(ndarray::Axis(0)));
                for (j, patch) in batch.outer_iter().enumerate() {
                    for (i, &value) in patch.iter().enumerate() {
                        residuals[(i, j)] = f64::from(value) - mean(i);
                    }
                }
                solve_lower_triangular_in_place(self.factor.as_ref(), residuals.as_mut(), faer::Par::Seq);
                (0..residuals.ncols())
                    .map(|j| {
                        let squares: f64 = residuals.col(j).iter().map(|z| z * z).sum();
                        -0.5 * constant - half_bit * squares
                    })
                    .collect()
            })
            .collect();
        Array1::from(scores.concat())
    }
}

/// log2-determinant by a dense Cholesky factorisation, the reference for tests.
#[cfg(test)]
pub(in crate::information) fn log2_determinant_dense(covariance: &Mat<f64>) -> Result<f64, InformationError> {
    Ok(DenseGaussian::new(covariance, 1)?.log2_determinant())
}

/// Checks patches for a Gaussian fit or score; returns (patches, rows, cols).
pub(in crate::information) fn check_patches(
    patches: ArrayView3<f32>,
    what: &'static str,
) -> Result<(usize, usize, usize), InformationError> {
    let (count, rows, cols) = patches.dim();
    let pixels = rows.saturating_mul(cols);
    if pixels == 0 || pixels > MAX_PATCH_PIXELS {
        return Err(InformationError::PatchSize { rows, cols, limit: MAX_PATCH_PIXELS });
    }
    if let Some(patch) = patches.outer_iter().position(|patch| patch.iter().any(|value| !value.is_finite())) {
        return Err(InformationError::NotFinite { what, patch });
    }
    Ok((count, rows, cols))
}

/// Checks that training patches do not all hold one value.
pub(in crate::information) fn check_varied(patches: ArrayView3<f32>) -> Result<(), InformationError> {
    let first = patches.first().copied().unwrap_or(0.0);
    if !patches.is_empty() && patches.iter().all(|&value| value.to_bits() == first.to_bits()) {
        return Err(InformationError::Constant { value: f64::from(first) });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn density_of_two_correlated_pixels_is_the_textbook_formula() {
        let (variance, covariance) = (4.0, 1.5);
        let matrix = Mat::from_fn(2, 2, |i, j| if i == j { variance } else { covariance });
        let gaussian = DenseGaussian::new(&matrix, 2).unwrap();
        let patches = Array3::from_shape_vec((2, 1, 2), vec![1.0, -2.0, 3.0, 0.5]).unwrap();
        let scores = gaussian.log2_densities(patches.view(), |i| [0.5, 0.25][i]);
        let determinant: f64 = variance * variance - covariance * covariance;
        for (score, (a, b)) in scores.iter().zip([(0.5, -2.25), (2.5, 0.25)]) {
            let form = (variance * a * a - 2.0 * covariance * a * b + variance * b * b) / determinant;
            let density = (-0.5_f64 * form).exp() / (2.0 * std::f64::consts::PI * determinant.sqrt());
            assert!((score - density.log2()).abs() < 1e-12);
        }
        let entropy = 0.5 * ((2.0 * std::f64::consts::PI * std::f64::consts::E).powi(2) * determinant).log2();
        assert!((gaussian.entropy_bits() - entropy).abs() < 1e-12);
    }
}
