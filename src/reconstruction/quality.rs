//! Image quality: PSNR, SSIM, MSE and R2 of a reconstruction against the truth.
//!
//! Truth and estimate are in units of the peak: 1 is the brightest truth there can be. Estimates are clipped to [0, 1] first; nothing is
//! rescaled. SSIM follows Wang et al. (2004) with a Gaussian window of 1.5 px cut off at 5 px, population covariances, a range of 1
//! and mirrored borders; the outer 5 px do not count.

use ndarray::{Array2, ArrayView2, ArrayView3, Axis, s};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::ReconstructionError;

/// Standard deviation of the window of SSIM, px.
const SSIM_SIGMA_PX: f64 = 1.5;
/// Reach of that window from its middle, px.
const SSIM_RADIUS_PX: usize = 5;
/// Constants of SSIM for a range of 1: (0.01)^2 and (0.03)^2.
const SSIM_CONSTANTS: [f64; 2] = [1e-4, 9e-4];
/// Added to the mean squared error of a PSNR, so that a perfect estimate has 80 dB.
const LEAST_MSE: f64 = 1e-8;

/// Quality of one reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageQuality {
    /// Mean squared error of the clipped estimate.
    pub mse: f64,
    /// Mean squared error of the estimate as it is, not clipped.
    pub mse_unclipped: f64,
    /// Mean structural similarity of the clipped estimate, at most 1.
    pub ssim: f64,
    /// 1 - MSE / variance of the pixels of the truth; `None` for a truth of one value.
    pub r2: Option<f64>,
}

impl ImageQuality {
    /// Compares an estimate with the truth, both of shape (rows, cols) in units of the peak.
    ///
    /// # Errors
    /// [`ReconstructionError::Shape`] where the shapes differ, [`ReconstructionError::SmallImage`] below 11 px a side, and
    /// [`ReconstructionError::NotFinite`].
    pub fn of(truth: ArrayView2<'_, f32>, estimate: ArrayView2<'_, f32>) -> Result<Self, ReconstructionError> {
        if truth.dim() != estimate.dim() {
            return Err(ReconstructionError::shape("estimate", truth.shape(), estimate.shape()));
        }
        let (rows, cols) = truth.dim();
        let least = 2 * SSIM_RADIUS_PX + 1;
        if rows < least || cols < least {
            return Err(ReconstructionError::SmallImage { rows, cols, least });
        }
        for (what, image) in [("truth", &truth), ("estimate", &estimate)] {
            ReconstructionError::check_finite(what, image)?;
        }
        let truth = truth.mapv(f64::from);
        let unclipped = estimate.mapv(f64::from);
        let estimate = unclipped.mapv(|value| value.clamp(0.0, 1.0));
        let mse = mean_squared_difference(&truth, &estimate);
        let variance = truth.var(0.0);
        Ok(Self {
            mse,
            mse_unclipped: mean_squared_difference(&truth, &unclipped),
            ssim: ssim(&truth, &estimate),
            r2: (variance > 0.0).then(|| 1.0 - mse / variance),
        })
    }

    /// Compares stacks of shape (n, rows, cols), image by image.
    ///
    /// # Errors
    /// As [`ImageQuality::of`].
    pub fn of_stack(
        truth: ArrayView3<'_, f32>,
        estimate: ArrayView3<'_, f32>,
    ) -> Result<Vec<Self>, ReconstructionError> {
        if truth.dim() != estimate.dim() {
            return Err(ReconstructionError::shape("estimates", truth.shape(), estimate.shape()));
        }
        let pairs = truth.axis_iter(Axis(0)).into_par_iter().zip(estimate.axis_iter(Axis(0)));
        pairs.map(|(truth, estimate)| Self::of(truth, estimate)).collect()
    }

    /// Peak signal-to-noise ratio of the clipped estimate, dB.
    pub fn psnr_db(&self) -> f64 {
        psnr_db(self.mse)
    }
}

/// Peak signal-to-noise ratio of a mean squared error for a peak of 1, dB; at most 80.
pub fn psnr_db(mse: f64) -> f64 {
    -10.0 * (mse + LEAST_MSE).log10()
}

/// Mean squared error of an estimate clipped to [0, 1], without the other numbers of [`ImageQuality`]; both of one shape.
pub(super) fn clipped_mse(truth: ArrayView2<'_, f32>, estimate: ArrayView2<'_, f32>) -> f64 {
    let clipped = estimate.mapv(|value| f64::from(value).clamp(0.0, 1.0));
    mean_squared_difference(&truth.mapv(f64::from), &clipped)
}

fn mean_squared_difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64
}

/// Mean structural similarity of two images of at least 11 px a side.
fn ssim(truth: &Array2<f64>, estimate: &Array2<f64>) -> f64 {
    let window = window();
    let mean_of = |image: Array2<f64>| filtered(&image, &window);
    let (mean_x, mean_y) = (mean_of(truth.clone()), mean_of(estimate.clone()));
    let (xx, yy, xy) = (mean_of(truth * truth), mean_of(estimate * estimate), mean_of(truth * estimate));
    let [c1, c2] = SSIM_CONSTANTS;
    let mut sum = 0.0;
    for (index, &mx) in mean_x.indexed_iter() {
        let my = mean_y[index];
        let (variance_x, variance_y, covariance) = (xx[index] - mx * mx, yy[index] - my * my, xy[index] - mx * my);
        sum += (2.0 * mx * my + c1) * (2.0 * covariance + c2)
            / ((mx * mx + my * my + c1) * (variance_x + variance_y + c2));
    }
    sum / mean_x.len() as f64
}

/// The window of SSIM along one axis; sums to 1.
fn window() -> [f64; 2 * SSIM_RADIUS_PX + 1] {
    let weights: [f64; 2 * SSIM_RADIUS_PX + 1] = std::array::from_fn(|index| {
        let distance = index as f64 - SSIM_RADIUS_PX as f64;
        (-0.5 * (distance / SSIM_SIGMA_PX).powi(2)).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// The image filtered by `window` along both axes, where the window lies within the image.
fn filtered(image: &Array2<f64>, window: &[f64]) -> Array2<f64> {
    let (rows, cols) = image.dim();
    let reach = window.len() - 1;
    let mut along_cols = Array2::<f64>::zeros((rows, cols - reach));
    for (offset, &weight) in window.iter().enumerate() {
        along_cols.scaled_add(weight, &image.slice(s![.., offset..offset + cols - reach]));
    }
    let mut both = Array2::<f64>::zeros((rows - reach, cols - reach));
    for (offset, &weight) in window.iter().enumerate() {
        both.scaled_add(weight, &along_cols.slice(s![offset..offset + rows - reach, ..]));
    }
    both
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::formats::read_npz_f64;

    fn image(f: impl Fn(usize, usize) -> f32) -> Array2<f32> {
        Array2::from_shape_fn((24, 31), |(row, col)| f(row, col))
    }

    fn pattern() -> Array2<f32> {
        image(|row, col| ((row * 7 + col * 13) % 17) as f32 / 16.0)
    }

    #[test]
    fn perfect_estimate_has_the_largest_values() {
        let quality = ImageQuality::of(pattern().view(), pattern().view()).unwrap();
        assert_eq!((quality.mse, quality.mse_unclipped, quality.r2), (0.0, 0.0, Some(1.0)));
        assert!((quality.ssim - 1.0).abs() < 1e-12 && (quality.psnr_db() - 80.0).abs() < 1e-9);
    }

    #[test]
    fn known_errors_have_known_values() {
        let truth = pattern();
        let shifted = truth.mapv(|value| value + 0.1);
        let quality =
            ImageQuality::of(truth.mapv(|value| 0.5 * value).view(), shifted.mapv(|v| 0.5 * v).view()).unwrap();
        // 0.05 off everywhere: 26.02 dB.
        assert!((quality.psnr_db() - 26.0206).abs() < 1e-3, "{}", quality.psnr_db());
        let quality = ImageQuality::of(truth.view(), shifted.view()).unwrap();
        assert!(quality.mse < quality.mse_unclipped, "values above 1 are clipped");
        // The mean as estimate explains nothing.
        let mean = truth.mean().unwrap();
        let quality = ImageQuality::of(truth.view(), image(|_, _| mean).view()).unwrap();
        assert!(quality.r2.unwrap().abs() < 1e-6, "{:?}", quality.r2);
        let flat = ImageQuality::of(image(|_, _| 0.5).view(), truth.view()).unwrap();
        assert_eq!(flat.r2, None);
    }

    #[test]
    fn ssim_of_two_constant_images_is_the_formula() {
        let quality = ImageQuality::of(image(|_, _| 0.25).view(), image(|_, _| 0.75).view()).unwrap();
        let expected = (2.0 * 0.25 * 0.75 + 1e-4) / (0.25 * 0.25 + 0.75 * 0.75 + 1e-4);
        assert!((quality.ssim - expected).abs() < 1e-9, "{}", quality.ssim);
    }

    #[test]
    fn images_that_cannot_be_compared_are_refused() {
        let truth = pattern();
        let error = |a: ArrayView2<'_, f32>, b: ArrayView2<'_, f32>| ImageQuality::of(a, b).unwrap_err().to_string();
        let small = truth.slice(s![..10, ..]);
        assert!(error(truth.view(), small).contains("expected shape 24 x 31, found 10 x 31"));
        assert!(error(small, small).contains("at least 11 px a side"));
        let mut broken = truth.clone();
        broken[(3, 4)] = f32::NAN;
        assert!(error(truth.view(), broken.view()).contains("row 3, column 4"));
    }

    /// Truth, estimate and values of a pair, computed by scikit-image.
    #[test]
    fn a_pair_agrees_with_scikit_image() {
        agree(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/image_quality.npz"));
    }

    #[test]
    fn all_pairs_agree_with_scikit_image() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/image_quality.npz");
        if path.exists() {
            agree(&path);
        } else {
            println!("skipped: ../shared is absent");
        }
    }

    fn agree(path: &Path) {
        let read = |name: &str| read_npz_f64(path, Some(name)).unwrap();
        let stack = |name: &str| read(name).mapv(|value| value as f32).into_dimensionality::<ndarray::Ix3>().unwrap();
        let expected = read("psnr_ssim_mse");
        let found = ImageQuality::of_stack(stack("truth").view(), stack("estimate").view()).unwrap();
        assert!(!found.is_empty());
        for (found, expected) in found.iter().zip(expected.axis_iter(Axis(0))) {
            // The fixture's PSNR has no least error.
            let psnr = -10.0 * found.mse.log10();
            for (found, expected) in [psnr, found.ssim, found.mse].iter().zip(expected.iter()) {
                assert!((found / expected - 1.0).abs() < 1e-6, "{found} against {expected}");
            }
        }
    }
}
