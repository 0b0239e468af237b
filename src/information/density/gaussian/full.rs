//! Gaussian density model with a mean and a full covariance over all pixels of a patch.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, Par};
use ndarray::{Array1, ArrayView3, Axis};

use super::dense::{DenseGaussian, check_patches, check_varied};
use crate::information::error::InformationError;

/// Patches per step of the covariance sum.
const BATCH: usize = 1024;

/// A Gaussian with one mean per pixel and a covariance for every pair of pixels of a patch.
#[derive(Clone, Debug)]
pub struct FullGaussian {
    rows: usize,
    cols: usize,
    mean: Vec<f64>,
    gaussian: DenseGaussian,
}

impl FullGaussian {
    /// Fits mean and covariance (maximum likelihood) to training patches of shape (n, rows, cols).
    ///
    /// # Errors
    /// When there are not more patches than pixels, a value is not finite, or the covariance is singular because
    /// pixels are constant or repeat one another.
    pub fn fit(patches: ArrayView3<'_, f32>) -> Result<Self, InformationError> {
        let (count, rows, cols) = check_patches(patches, "training patches")?;
        let pixels = rows * cols;
        if count <= pixels {
            let (model, needed) = ("a full covariance", pixels + 1);
            return Err(InformationError::TooFewPatches { model, needed, found: count, pixels });
        }
        check_varied(patches)?;
        let mut mean = vec![0.0; pixels];
        for patch in patches.outer_iter() {
            for (sum, &value) in mean.iter_mut().zip(patch.iter()) {
                *sum += f64::from(value);
            }
        }
        for sum in &mut mean {
            *sum /= count as f64;
        }

        let mut covariance = Mat::<f64>::zeros(pixels, pixels);
        let mut centred = Mat::<f64>::zeros(pixels, BATCH.min(count));
        for batch in patches.axis_chunks_iter(Axis(0), BATCH) {
            for (j, patch) in batch.outer_iter().enumerate() {
                for (i, &value) in patch.iter().enumerate() {
                    centred[(i, j)] = f64::from(value) - mean[i];
                }
            }
            let used = centred.subcols(0, batch.len_of(Axis(0)));
            // Half the products suffice: the covariance is symmetric.
            triangular::matmul(
                covariance.as_mut(),
                BlockStructure::TriangularLower,
                Accum::Add,
                used,
                BlockStructure::Rectangular,
                used.transpose(),
                BlockStructure::Rectangular,
                1.0 / count as f64,
                Par::rayon(0),
            );
        }
        let gaussian = DenseGaussian::new(&covariance, cols)?;
        Ok(Self { rows, cols, mean, gaussian })
    }

    /// Shape of the patches it models, (rows, cols).
    pub fn patch(&self) -> (usize, usize) {
        (self.rows, self.cols)
    }

    /// log2-density of each patch of shape (n, rows, cols), bits per patch.
    ///
    /// # Errors
    /// When the patches are of another shape or hold values that are not finite.
    pub fn log2_densities(&self, patches: ArrayView3<'_, f32>) -> Result<Array1<f64>, InformationError> {
        check_scored(patches, self.patch())?;
        Ok(self.gaussian.log2_densities(patches, |i| self.mean[i]))
    }

    /// Differential entropy of the model itself, `1/2 log2((2 pi e)^n det C)`, bits per patch.
    pub fn differential_entropy_bits(&self) -> f64 {
        self.gaussian.entropy_bits()
    }
}

/// Checks that patches to score have the model's shape and finite values.
pub(in crate::information) fn check_scored(
    patches: ArrayView3<'_, f32>,
    patch: (usize, usize),
) -> Result<(), InformationError> {
    let (_, found_rows, found_cols) = check_patches(patches, "test patches")?;
    let (rows, cols) = patch;
    if (found_rows, found_cols) != patch {
        return Err(InformationError::PatchShape { what: "test patches", rows, cols, found_rows, found_cols });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    #[test]
    fn moments_are_those_of_the_data() {
        let patches = Array3::from_shape_vec((4, 1, 2), vec![1.0, 5.0, 3.0, 1.0, -1.0, 2.0, 5.0, 4.0]).unwrap();
        let model = FullGaussian::fit(patches.view()).unwrap();
        assert_eq!(model.mean, vec![2.0, 3.0]);
        // Covariance [[5, 0.5], [0.5, 2.5]].
        assert!((model.gaussian.log2_determinant() - 12.25_f64.log2()).abs() < 1e-12);
    }

    #[test]
    fn on_its_training_data_the_mean_log_density_is_minus_the_entropy() {
        // The mean squared Mahalanobis distance of the training data of a maximum-likelihood fit is the number of
        // pixels.
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let patches = Array3::from_shape_simple_fn((3000, 4, 5), || 7.0 + rng.sample::<f32, _>(StandardNormal));
        let model = FullGaussian::fit(patches.view()).unwrap();
        let mean = model.log2_densities(patches.view()).unwrap().mean().unwrap();
        assert!((mean + model.differential_entropy_bits()).abs() < 1e-7, "{mean}");
    }

    #[test]
    fn the_fit_does_not_depend_on_the_number_of_threads() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let patches = Array3::from_shape_simple_fn((700, 20, 20), || rng.sample::<f32, _>(StandardNormal));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| FullGaussian::fit(patches.view()).unwrap().log2_densities(patches.view()).unwrap())
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn bad_patches_get_reasons() {
        let few = Array3::from_shape_fn((20, 4, 5), |(n, r, c)| (n * r + c) as f32);
        let expected =
            InformationError::TooFewPatches { model: "a full covariance", needed: 21, found: 20, pixels: 20 };
        assert_eq!(FullGaussian::fit(few.view()).unwrap_err(), expected);
        let constant = Array3::from_elem((30, 4, 5), 2.0_f32);
        assert_eq!(FullGaussian::fit(constant.view()).unwrap_err(), InformationError::Constant { value: 2.0 });
        let mut broken = constant.clone();
        broken[[7, 1, 1]] = f32::NAN;
        let expected = InformationError::NotFinite { what: "training patches", patch: 7 };
        assert_eq!(FullGaussian::fit(broken.view()).unwrap_err(), expected);
        let repeated = Array3::from_shape_fn((30, 2, 2), |(n, r, _)| (n * n % 13 + r * n) as f32);
        let found = FullGaussian::fit(repeated.view());
        assert!(matches!(found, Err(InformationError::NotPositiveDefinite { row: 0 })), "{found:?}");
        let empty = Array3::<f32>::zeros((3, 0, 5));
        assert!(matches!(FullGaussian::fit(empty.view()), Err(InformationError::PatchSize { .. })));
    }
}
