//! Stationary Gaussian density model: one mean, and a covariance that depends on the lag between two pixels only.

use ndarray::{Array1, Array2, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::block_toeplitz::log2_determinant;
use super::dense::{DenseGaussian, check_patches, check_varied, dense_covariance};
use super::full::check_scored;
use crate::information::error::InformationError;
use crate::information::statistics::fourier::{Fourier2, good_length};

/// Patches per part of the parallel sum: fixed, so that the result does not depend on the number of threads.
const PART: usize = 256;
/// Halvings in the search for the smallest taper.
const TAPER_STEPS: u32 = 10;

/// A stationary Gaussian, fitted to patches or made from a known autocovariance.
#[derive(Clone, Debug)]
pub struct StationaryGaussian {
    rows: usize,
    cols: usize,
    mean: f64,
    taper: f64,
    autocovariance: Array2<f64>,
    gaussian: DenseGaussian,
}

impl StationaryGaussian {
    /// Fits one mean and an autocovariance, averaged over patches and positions, to patches of shape (n, rows, cols).
    ///
    /// The average at each lag divides by the number of pixel pairs at that lag. It is unbiased but, for few patches,
    /// may belong to no random field. Then the fit mixes in the smallest possible share of the average that divides
    /// by the number of pixels instead. That average is the same times a triangle, always positive definite; see
    /// [`StationaryGaussian::taper`].
    ///
    /// # Errors
    /// With no patch, constant data, values that are not finite, or data without noise whose covariance is singular.
    pub fn fit(patches: ArrayView3<'_, f32>) -> Result<Self, InformationError> {
        let (count, rows, cols) = check_patches(patches, "training patches")?;
        if count == 0 {
            let model = "a stationary model";
            return Err(InformationError::TooFewPatches { model, needed: 1, found: 0, pixels: rows * cols });
        }
        check_varied(patches)?;
        let sums = parts(patches, |part| part.iter().map(|&value| f64::from(value)).sum::<f64>());
        let mean = sums.iter().sum::<f64>() / patches.len() as f64;
        let unbiased = autocovariance(patches, mean);
        let taper = smallest_taper(&unbiased, (rows, cols))?;
        Self::new(mean, tapered(&unbiased, (rows, cols), taper), (rows, cols), taper)
    }

    fn new(
        mean: f64,
        autocovariance: Array2<f64>,
        patch: (usize, usize),
        taper: f64,
    ) -> Result<Self, InformationError> {
        let gaussian = DenseGaussian::new(&dense_covariance(&autocovariance, patch), patch.1)?;
        Ok(Self { rows: patch.0, cols: patch.1, mean, taper, autocovariance, gaussian })
    }

    /// Shape of the patches it models, (rows, cols).
    pub fn patch(&self) -> (usize, usize) {
        (self.rows, self.cols)
    }

    /// Mean of every pixel, photons.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Autocovariance, photons squared, shape (2 rows - 1, 2 cols - 1), lag zero in the centre.
    pub fn autocovariance(&self) -> ArrayView2<'_, f64> {
        self.autocovariance.view()
    }

    /// Share of the triangular taper that makes the fitted covariance positive definite, 0 to 1; 0 with enough
    /// patches.
    pub fn taper(&self) -> f64 {
        self.taper
    }

    /// log2-density of each patch of shape (n, rows, cols), bits per patch.
    ///
    /// # Errors
    /// When the patches are of another shape or hold values that are not finite.
    pub fn log2_densities(&self, patches: ArrayView3<'_, f32>) -> Result<Array1<f64>, InformationError> {
        check_scored(patches, self.patch())?;
        Ok(self.gaussian.log2_densities(patches, |_| self.mean))
    }

    /// Differential entropy of the model itself, `1/2 log2((2 pi e)^n det C)`, bits per patch.
    pub fn differential_entropy_bits(&self) -> f64 {
        self.gaussian.entropy_bits()
    }
}

/// Applies `work` to consecutive parts of the patches in parallel; results in order.
fn parts<T: Send>(patches: ArrayView3<'_, f32>, work: impl Fn(ArrayView3<'_, f32>) -> T + Send + Sync) -> Vec<T> {
    let parts: Vec<_> = patches.axis_chunks_iter(Axis(0), PART).collect();
    parts.into_par_iter().map(work).collect()
}

/// Autocovariance about `mean`, averaged over patches and over the pixel pairs of each lag.
///
/// Two patches share one complex transform, as real and imaginary part. In the power spectrum their product is odd,
/// so it drops out of the real part of the inverse.
fn autocovariance(patches: ArrayView3<'_, f32>, mean: f64) -> Array2<f64> {
    let (count, rows, cols) = patches.dim();
    let fourier = Fourier2::new(good_length(2 * rows - 1), good_length(2 * cols - 1));
    let grid = fourier.rows * fourier.cols;
    let powers = parts(patches, |part| {
        let mut workspace = fourier.workspace();
        let mut data = vec![Complex64::default(); grid];
        let mut power = vec![0.0; grid];
        for pair in part.axis_chunks_iter(Axis(0), 2) {
            data.fill(Complex64::default());
            for (j, patch) in pair.outer_iter().enumerate() {
                for ((r, c), &value) in patch.indexed_iter() {
                    let deviation = f64::from(value) - mean;
                    let entry = &mut data[r * fourier.cols + c];
                    if j == 0 { entry.re = deviation } else { entry.im = deviation }
                }
            }
            fourier.forward(&mut data, rows, &mut workspace);
            for (sum, value) in power.iter_mut().zip(&data) {
                *sum += value.norm_sqr();
            }
        }
        power
    });
    let mut total = vec![Complex64::default(); grid];
    for power in powers {
        for (sum, value) in total.iter_mut().zip(power) {
            sum.re += value;
        }
    }
    fourier.inverse(&mut total, &mut fourier.workspace());
    Array2::from_shape_fn((2 * rows - 1, 2 * cols - 1), |(i, j)| {
        let (dr, dc) = (i.abs_diff(rows - 1), j.abs_diff(cols - 1));
        let row = (fourier.rows + i + 1 - rows) % fourier.rows;
        let col = (fourier.cols + j + 1 - cols) % fourier.cols;
        let pairs = ((rows - dr) * (cols - dc) * count) as f64;
        total[row * fourier.cols + col].re / (grid as f64 * pairs)
    })
}

/// `(1 - taper)` of the autocovariance plus `taper` of it times a triangle that falls to zero beyond the patch.
fn tapered(autocovariance: &Array2<f64>, patch: (usize, usize), taper: f64) -> Array2<f64> {
    let (rows, cols) = patch;
    let mut out = autocovariance.clone();
    for ((i, j), value) in out.indexed_iter_mut() {
        let triangle =
            (1.0 - i.abs_diff(rows - 1) as f64 / rows as f64) * (1.0 - j.abs_diff(cols - 1) as f64 / cols as f64);
        *value *= 1.0 - taper * (1.0 - triangle);
    }
    out
}

/// The smallest taper (to about a thousandth) that leaves a positive definite covariance.
fn smallest_taper(autocovariance: &Array2<f64>, patch: (usize, usize)) -> Result<f64, InformationError> {
    let works = |taper: f64| log2_determinant(&tapered(autocovariance, patch, taper), patch);
    if works(0.0).is_ok() {
        return Ok(0.0);
    }
    works(1.0)?;
    let (mut fails, mut enough) = (0.0, 1.0);
    for _ in 0..TAPER_STEPS {
        let middle = 0.5 * (fails + enough);
        if works(middle).is_ok() { enough = middle } else { fails = middle }
    }
    Ok(enough)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    fn noise(count: usize, rows: usize, cols: usize, seed: u64) -> Array3<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Array3::from_shape_simple_fn((count, rows, cols), || rng.sample::<f32, _>(StandardNormal))
    }

    #[test]
    fn autocovariance_equals_the_plain_double_sum() {
        let patches = noise(5, 4, 6, 3);
        let found = autocovariance(patches.view(), 0.3);
        for ((i, j), &value) in found.indexed_iter() {
            let (dr, dc) = (i as i64 - 3, j as i64 - 5);
            let (mut sum, mut pairs) = (0.0, 0.0);
            for ((n, r, c), &a) in patches.indexed_iter() {
                let (row, col) = (r as i64 + dr, c as i64 + dc);
                if (0..4).contains(&row) && (0..6).contains(&col) {
                    sum += (f64::from(a) - 0.3) * (f64::from(patches[[n, row as usize, col as usize]]) - 0.3);
                    pairs += 1.0;
                }
            }
            assert!((value - sum / pairs).abs() < 1e-12, "lag {dr} {dc}");
        }
    }

    #[test]
    fn entropy_is_that_of_the_recursion() {
        let model = StationaryGaussian::fit(noise(300, 6, 5, 4).view()).unwrap();
        assert!(model.taper() == 0.0);
        let log2_det = log2_determinant(&model.autocovariance().to_owned(), (6, 5)).unwrap();
        let expected = 30.0 * crate::information::gaussian_entropy(1.0) + 0.5 * log2_det;
        assert!((model.differential_entropy_bits() - expected).abs() < 1e-9);
    }

    #[test]
    fn few_patches_are_tapered_no_more_than_needed() {
        let single = noise(1, 12, 12, 5);
        let model = StationaryGaussian::fit(single.view()).unwrap();
        let taper = model.taper();
        assert!(taper > 0.0 && taper < 1.0, "{taper}");
        let unbiased = autocovariance(single.view(), model.mean());
        let less = tapered(&unbiased, (12, 12), taper - 0.002);
        assert!(log2_determinant(&less, (12, 12)).is_err());
        assert!(model.log2_densities(single.view()).unwrap()[0].is_finite());
    }

    #[test]
    fn the_sum_does_not_depend_on_the_number_of_threads() {
        let patches = noise(1000, 8, 8, 6);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| StationaryGaussian::fit(patches.view()).unwrap())
        };
        let (one, three) = (run(1), run(3));
        assert_eq!(one.autocovariance(), three.autocovariance());
        assert_eq!(one.log2_densities(patches.view()).unwrap(), three.log2_densities(patches.view()).unwrap());
    }

    #[test]
    fn bad_patches_get_reasons() {
        let none = Array3::<f32>::zeros((0, 4, 4));
        assert!(matches!(StationaryGaussian::fit(none.view()), Err(InformationError::TooFewPatches { .. })));
        let constant = Array3::from_elem((30, 4, 5), 2.0_f32);
        assert_eq!(StationaryGaussian::fit(constant.view()).unwrap_err(), InformationError::Constant { value: 2.0 });
        let model = StationaryGaussian::fit(noise(50, 4, 4, 7).view()).unwrap();
        let found = model.log2_densities(noise(5, 4, 5, 7).view());
        assert!(matches!(found, Err(InformationError::PatchShape { cols: 4, found_cols: 5, .. })));
    }
}
