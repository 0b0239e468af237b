//! The Gaussian bound without samples, from the autocovariance of the objects and the point spread function alone.

use ndarray::{Array2, ArrayView3};
use rustfft::num_complex::Complex64;

use super::block_toeplitz::{check_lags, log2_determinant};
use crate::information::entropy::noise_entropy::{check_noise, gaussian_entropy};
use crate::information::error::InformationError;
use crate::information::statistics::fourier::{Fourier2, Workspace, good_length};
use crate::sensor::Noise;

/// An upper bound on the information of a patch, from the Gaussian of the same covariance.
///
/// A Gaussian has the largest entropy of all fields of one covariance, so the bound holds for every object set; it is
/// loose where objects are sparse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianBound {
    /// Upper bound on the entropy of the measured patch, bits per pixel.
    pub entropy_y: f64,
    /// Entropy of the noise as it was given, bits per pixel.
    pub entropy_y_given_x: f64,
    /// Their difference, bits per pixel.
    pub bits_per_pixel: f64,
    /// Limit of `entropy_y` for large patches, `1/2 log2(2 pi e) + 1/2 mean log2 S`, bits per pixel.
    pub spectral_entropy: f64,
}

/// Data of an object set and a patch for repeated evaluations of the Gaussian bound.
#[derive(Clone)]
pub struct AnalyticGaussian {
    psf_rows: usize,
    psf_cols: usize,
    patch: (usize, usize),
    fourier: Fourier2,
    /// Power spectrum of the objects on the transform grid, not negative.
    object_spectrum: Vec<f64>,
}

impl AnalyticGaussian {
    /// Prepares bounds for objects of the given autocovariance.
    ///
    /// - `object_autocovariance`: photons squared, shape (2L+1, 2L+1), entry `[L + dr, L + dc]`, with
    ///   `L >= patch - 1 + psf - 1` in both directions; more lags make the spectral limit more exact. Objects of all
    ///   planes share it and are independent of one another.
    /// - `psf_shape`, `patch`: (rows, cols), pixels.
    ///
    /// # Errors
    /// For an empty shape, too few lags, or values that are not finite.
    pub fn new(
        object_autocovariance: &Array2<f64>,
        psf_shape: (usize, usize),
        patch: (usize, usize),
    ) -> Result<Self, InformationError> {
        let (psf_rows, psf_cols) = psf_shape;
        if psf_rows == 0 || psf_cols == 0 {
            let (found_rows, found_cols) = psf_shape;
            let what = "point spread function";
            return Err(InformationError::SpotShape {
                what,
                rows: usize::MAX,
                cols: usize::MAX,
                found_rows,
                found_cols,
            });
        }
        check_lags(
            object_autocovariance,
            (patch.0.saturating_add(psf_rows - 1), patch.1.saturating_add(psf_cols - 1)),
        )?;
        if patch.0 == 0 || patch.1 == 0 {
            return Err(InformationError::PatchSize {
                rows: patch.0,
                cols: patch.1,
                limit: super::dense::MAX_PATCH_PIXELS,
            });
        }
        if let Some(&found) = object_autocovariance.iter().find(|value| !value.is_finite()) {
            return Err(InformationError::Photons { found });
        }
        let (lag_rows, lag_cols) = object_autocovariance.dim();
        // Lags up to L wrap onto themselves only beyond 2L + 1 points.
        let fourier = Fourier2::new(good_length(lag_rows), good_length(lag_cols));
        let mut data = vec![Complex64::default(); fourier.rows * fourier.cols];
        for ((i, j), &value) in object_autocovariance.indexed_iter() {
            let row = (fourier.rows + i - lag_rows / 2) % fourier.rows;
            let col = (fourier.cols + j - lag_cols / 2) % fourier.cols;
            data[row * fourier.cols + col].re = value;
        }
        let filled_rows = fourier.rows;
        fourier.forward(&mut data, filled_rows, &mut fourier.workspace());
        let object_spectrum = data.iter().map(|value| value.re).collect();
        Ok(Self { psf_rows, psf_cols, patch, fourier, object_spectrum })
    }

    /// The bound for one point spread function.
    ///
    /// - `psf`: shape (planes, rows, cols), the one announced; sums to the throughput, less the light of planes without objects.
    /// - `mean_measurement`: mean of the encoded image, bias included, photons per pixel: the variance of shot noise.
    /// - `entropy_y_given_x`: entropy of the noise, bits per pixel, from [`super::NoiseEntropy`].
    ///
    /// # Errors
    /// For another shape, no noise, a mean that is negative or not finite, or a covariance that is not positive
    /// definite.
    pub fn evaluate(
        &self,
        psf: ArrayView3<'_, f64>,
        mean_measurement: f64,
        noise: Noise,
        entropy_y_given_x: f64,
    ) -> Result<GaussianBound, InformationError> {
        let variance = noise_variance(noise, mean_measurement)? + variance_of_rounding(noise, mean_measurement);
        let mut workspace = self.fourier.workspace();
        let spectrum = self.signal_spectrum(psf, &mut workspace)?;
        // Truncated lags can make a spectrum slightly negative; negative powers count as 0.
        let mean_log2 =
            spectrum.iter().map(|power| (power.max(0.0) + variance).log2()).sum::<f64>() / spectrum.len() as f64;
        let mut autocovariance = self.lags(&spectrum, &mut workspace);
        let (rows, cols) = self.patch;
        autocovariance[[rows - 1, cols - 1]] += variance;
        let log2_det = log2_determinant(&autocovariance, self.patch)?;
        let entropy_y = gaussian_entropy(1.0) + 0.5 * log2_det / (rows * cols) as f64;
        Ok(GaussianBound {
            entropy_y,
            entropy_y_given_x,
            bits_per_pixel: entropy_y - entropy_y_given_x,
            spectral_entropy: gaussian_entropy(1.0) + 0.5 * mean_log2,
        })
    }

    /// Autocovariance of the measurement, noise included, photons squared, shape (2 rows - 1, 2 cols - 1) for the patch;
    /// arguments as in [`AnalyticGaussian::evaluate`].
    ///
    /// # Errors
    /// For another shape, no noise, or a mean that is negative or not finite.
    pub fn measured_autocovariance(
        &self,
        psf: ArrayView3<'_, f64>,
        mean_measurement: f64,
        noise: Noise,
    ) -> Result<Array2<f64>, InformationError> {
        let variance = noise_variance(noise, mean_measurement)?;
        let mut autocovariance = self.signal_autocovariance(psf)?;
        let (rows, cols) = self.patch;
        autocovariance[[rows - 1, cols - 1]] += variance;
        Ok(autocovariance)
    }

    /// Autocovariance of the encoded image before noise, photons squared, shape (2 rows - 1, 2 cols - 1) for the
    /// patch: that of the objects correlated with the autocorrelation of the point spread function, summed over planes.
    ///
    /// # Errors
    /// For a point spread function of another shape than announced.
    pub fn signal_autocovariance(&self, psf: ArrayView3<'_, f64>) -> Result<Array2<f64>, InformationError> {
        let mut workspace = self.fourier.workspace();
        let spectrum = self.signal_spectrum(psf, &mut workspace)?;
        Ok(self.lags(&spectrum, &mut workspace))
    }

    fn signal_spectrum(
        &self,
        psf: ArrayView3<'_, f64>,
        workspace: &mut Workspace,
    ) -> Result<Vec<f64>, InformationError> {
        let (_, found_rows, found_cols) = psf.dim();
        let (rows, cols) = (self.psf_rows, self.psf_cols);
        if (found_rows, found_cols) != (rows, cols) {
            let what = "point spread function";
            return Err(InformationError::SpotShape { what, rows, cols, found_rows, found_cols });
        }
        let mut data = vec![Complex64::default(); self.object_spectrum.len()];
        let mut power = vec![0.0; data.len()];
        for plane in psf.outer_iter() {
            data.fill(Complex64::default());
            for ((r, c), &value) in plane.indexed_iter() {
                data[r * self.fourier.cols + c].re = value;
            }
            self.fourier.forward(&mut data, rows, workspace);
            for (sum, value) in power.iter_mut().zip(&data) {
                *sum += value.norm_sqr();
            }
        }
        for (sum, objects) in power.iter_mut().zip(&self.object_spectrum) {
            *sum *= objects;
        }
        Ok(power)
    }

    fn lags(&self, spectrum: &[f64], workspace: &mut Workspace) -> Array2<f64> {
        let mut data: Vec<Complex64> = spectrum.iter().map(|&power| Complex64::from(power)).collect();
        self.fourier.inverse(&mut data, workspace);
        let (rows, cols) = self.patch;
        let scale = 1.0 / data.len() as f64;
        Array2::from_shape_fn((2 * rows - 1, 2 * cols - 1), |(i, j)| {
            let row = (self.fourier.rows + i + 1 - rows) % self.fourier.rows;
            let col = (self.fourier.cols + j + 1 - cols) % self.fourier.cols;
            data[row * self.fourier.cols + col].re * scale
        })
    }
}

/// Mean variance of the noise of a pixel, photons squared.
fn noise_variance(noise: Noise, mean_measurement: f64) -> Result<f64, InformationError> {
    check_noise(noise)?;
    if !(mean_measurement.is_finite() && mean_measurement >= 0.0) {
        return Err(InformationError::Photons { found: mean_measurement });
    }
    match noise {
        Noise::None => Err(InformationError::NoNoise),
        Noise::Shot => Ok(mean_measurement),
        Noise::Read { sigma } => Ok(sigma * sigma),
        Noise::ShotRead { sigma } => Ok(mean_measurement + sigma * sigma),
    }
}

/// Additional variance of counts, taken as numbers with a density. A count stands for all numbers up to the next. At
/// a tenth of a photon the Gaussian of the counts alone would have less entropy than the counts. From one photon on,
/// their skewness leaves more entropy than that.
fn variance_of_rounding(noise: Noise, mean_measurement: f64) -> f64 {
    if noise == Noise::Shot { (1.0 - mean_measurement).max(0.0) / 12.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
    use crate::information::entropy::poisson::poisson_entropy;
    use crate::information::test_beads::{bead_autocovariance, bead_spot, convolve, encoded_image, heuristic_psf};
    use ndarray::{Array3, Axis};

    #[test]
    fn a_gaussian_has_no_less_entropy_than_counts_however_few() {
        for step in 0..400 {
            let mean = 1e-3 * 1.03_f64.powi(step);
            let gaussian = gaussian_entropy(mean + variance_of_rounding(Noise::Shot, mean));
            let counts = poisson_entropy(mean);
            assert!(gaussian > counts, "{mean}: {gaussian} {counts}");
        }
    }

    #[test]
    fn heuristic_layouts_have_the_known_bounds() {
        // Entropies from a separate program with a dense 1024 x 1024 covariance, and its bounds to two digits. It
        // sampled the entropy of the noise from 67 images.
        let entropies =
            [6.541_412, 6.331_623, 6.246_759, 6.183_491, 6.132_315, 6.099_807, 6.067_565, 6.045_001, 6.020_008];
        let bounds = [1.72, 1.25, 1.05, 0.93, 0.85, 0.78, 0.74, 0.70, 0.67];
        let spectral_limits = [6.448_849, 6.201_716, 6.150_308];
        let probability = 0.02;
        let model = AnalyticGaussian::new(&bead_autocovariance(probability, 62), (32, 32), (32, 32)).unwrap();
        let noise = NoiseEntropy::new(Noise::Shot, Protocol::Default).unwrap();
        for i in 0..9 {
            let spot = bead_spot(i + 1, probability);
            let sampled = (0..120).map(|seed| {
                let image = encoded_image(&spot, probability, 96, seed);
                noise.mean_bits(image.view()).unwrap()
            });
            let entropy_y_given_x = sampled.sum::<f64>() / 120.0;
            let psf = heuristic_psf(i + 1).insert_axis(Axis(0));
            let bound = model.evaluate(psf.view(), 110.0, Noise::Shot, entropy_y_given_x).unwrap();
            assert!((bound.entropy_y - entropies[i]).abs() < 1e-4, "{}: {}", i + 1, bound.entropy_y);
            // The sampling errors of either noise entropy are about 0.01 bit.
            assert!((bound.bits_per_pixel - bounds[i]).abs() < 0.03, "{}: {}", i + 1, bound.bits_per_pixel);
            if let Some(limit) = spectral_limits.get(i) {
                assert!((bound.spectral_entropy - limit).abs() < 2e-3, "{}: {}", i + 1, bound.spectral_entropy);
            }
        }
    }

    #[test]
    fn signal_autocovariance_is_the_plain_correlation_summed_over_planes() {
        let objects = bead_autocovariance(0.1, 20);
        let psf = Array3::from_shape_fn((2, 4, 6), |(p, r, c)| ((p * 7 + r * 5 + c * 3) % 11) as f64 / 10.0);
        let model = AnalyticGaussian::new(&objects, (4, 6), (5, 3)).unwrap();
        let found = model.signal_autocovariance(psf.view()).unwrap();
        let mut expected = Array2::<f64>::zeros((9, 5));
        for plane in psf.outer_iter() {
            let mut turned = plane.to_owned();
            turned.invert_axis(Axis(0));
            turned.invert_axis(Axis(1));
            let correlation = convolve(&plane.to_owned(), &turned);
            for ((i, j), value) in expected.indexed_iter_mut() {
                for ((r, c), weight) in correlation.indexed_iter() {
                    *value += weight * objects[[20 + i + 3 - 4 - r, 20 + j + 5 - 2 - c]];
                }
            }
        }
        for (a, b) in found.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-9 * expected[[4, 2]], "{a} {b}");
        }
    }

    #[test]
    fn spectral_limit_is_approached_from_above() {
        let psf = heuristic_psf(3).insert_axis(Axis(0));
        let bound = |patch: usize| {
            let objects = bead_autocovariance(0.05, 126);
            let model = AnalyticGaussian::new(&objects, (32, 32), (patch, patch)).unwrap();
            model.evaluate(psf.view(), 110.0, Noise::ShotRead { sigma: 3.0 }, 5.0).unwrap()
        };
        let (small, middle, large) = (bound(8), bound(16), bound(40));
        assert!(small.entropy_y > middle.entropy_y && middle.entropy_y > large.entropy_y);
        assert!(large.entropy_y > large.spectral_entropy);
        assert!(large.entropy_y - large.spectral_entropy < 0.5 * (middle.entropy_y - middle.spectral_entropy));
    }

    #[test]
    fn a_blind_mask_measures_the_noise_alone() {
        let model = AnalyticGaussian::new(&bead_autocovariance(0.1, 12), (3, 3), (6, 6)).unwrap();
        let dark = Array3::<f64>::zeros((1, 3, 3));
        let read = Noise::Read { sigma: 4.0 };
        let bound = model.evaluate(dark.view(), 10.0, read, gaussian_entropy(16.0)).unwrap();
        assert!(bound.bits_per_pixel.abs() < 1e-12);
        assert!((bound.spectral_entropy - gaussian_entropy(16.0)).abs() < 1e-12);
    }

    #[test]
    fn bad_requests_get_reasons() {
        let objects = bead_autocovariance(0.1, 12);
        let lags = AnalyticGaussian::new(&objects, (8, 8), (7, 7)).err();
        assert_eq!(lags, Some(InformationError::Lags { needed: 13, rows: 25, cols: 25 }));
        assert!(AnalyticGaussian::new(&objects, (0, 8), (7, 7)).is_err());
        assert!(AnalyticGaussian::new(&objects, (8, 8), (0, 5)).is_err());
        let model = AnalyticGaussian::new(&objects, (3, 3), (5, 5)).unwrap();
        let psf = Array3::from_elem((1, 3, 3), 1.0 / 9.0);
        let wrong = Array3::from_elem((1, 3, 4), 1.0 / 12.0);
        assert!(matches!(
            model.evaluate(wrong.view(), 10.0, Noise::Shot, 0.0),
            Err(InformationError::SpotShape { found_cols: 4, .. })
        ));
        assert_eq!(model.evaluate(psf.view(), 10.0, Noise::None, 0.0), Err(InformationError::NoNoise));
        assert!(model.evaluate(psf.view(), f64::NAN, Noise::Shot, 0.0).is_err());
    }
}
