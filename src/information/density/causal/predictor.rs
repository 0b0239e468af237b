//! Best linear prediction of every pixel from those before it.

use faer::Mat;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use ndarray::Array2;
use rayon::prelude::*;

use crate::information::density::gaussian::dense::{DenseGaussian, dense_covariance};
use crate::information::error::InformationError;
use crate::nn::{matmul_transposed_rhs, product};

/// Patches that one thread predicts at a time.
const GROUP: usize = 16;

/// Linear prediction in raster order, with the whole past of the patch as context (the Cholesky factor of the
/// covariance, Pourahmadi 1999). It uses information from any distance, such as the copies of an object point by
/// other lenslets.
#[derive(Clone, Debug)]
pub(super) struct Predictor {
    pixels: usize,
    mean: f32,
    /// Strictly lower triangular, (pixels, pixels): zeros on and right of the diagonal.
    coefficients: Vec<f32>,
    /// Variance of the prediction error of each pixel, noise included, photons squared.
    pub variances: Vec<f32>,
}

impl Predictor {
    /// A predictor of measurements (noise included) of one mean (photons) and this autocovariance. The latter is in
    /// photons squared, of shape (2 rows - 1, 2 cols - 1) with lag 0 in the centre.
    pub fn new(mean: f64, autocovariance: &Array2<f64>, patch: (usize, usize)) -> Result<Self, InformationError> {
        let pixels = patch.0 * patch.1;
        let gaussian = DenseGaussian::new(&dense_covariance(autocovariance, patch), patch.1)?;
        let mut inverse = Mat::<f64>::identity(pixels, pixels);
        solve_lower_triangular_in_place(gaussian.factor(), inverse.as_mut(), faer::get_global_parallelism());
        let mut coefficients = vec![0.0_f32; pixels * pixels];
        coefficients.par_chunks_mut(pixels).enumerate().for_each(|(i, row)| {
            for (j, out) in row.iter_mut().enumerate().take(i) {
                *out = (-inverse[(i, j)] / inverse[(i, i)]) as f32;
            }
        });
        let variances = (0..pixels).map(|i| (1.0 / inverse[(i, i)].powi(2)) as f32).collect();
        Ok(Self { pixels, mean: mean as f32, coefficients, variances })
    }

    /// Gradient by the pixels of patches from that by their predictions, (samples, pixels).
    pub fn transposed(&self, by_predictions: &[f32]) -> Vec<f32> {
        let mut by_values = vec![0.0; by_predictions.len()];
        let groups = by_predictions.par_chunks(GROUP * self.pixels).zip(by_values.par_chunks_mut(GROUP * self.pixels));
        groups.for_each(|(by_predictions, out)| {
            let shape = (out.len() / self.pixels, self.pixels, self.pixels);
            product(by_predictions, &self.coefficients, shape, out, crate::nn::Write::Replace);
        });
        by_values
    }

    /// Predicted mean of each pixel of `values` (samples, pixels), photons.
    pub fn predict(&self, values: &[f32]) -> Vec<f32> {
        let mut predictions = vec![0.0; values.len()];
        let groups = values.par_chunks(GROUP * self.pixels).zip(predictions.par_chunks_mut(GROUP * self.pixels));
        groups.for_each(|(values, out)| {
            let centred: Vec<f32> = values.iter().map(|y| y - self.mean).collect();
            let shape = (values.len() / self.pixels, self.pixels, self.pixels);
            matmul_transposed_rhs(&centred, &self.coefficients, shape, out, crate::nn::Write::Replace);
            for prediction in out {
                *prediction += self.mean;
            }
        });
        predictions
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_order_process_is_predicted_by_its_last_value() {
        // Rows are independent, columns correlate by 0.8 per px.
        let covariance =
            Array2::from_shape_fn((5, 9), |(r, c)| if r == 2 { 4.0 * 0.8_f64.powi((c as i32 - 4).abs()) } else { 0.0 });
        let predictor = Predictor::new(10.0, &covariance, (3, 5)).unwrap();
        let values: Vec<f32> = (0..15).map(|i| 10.0 + ((i * 7) % 5) as f32).collect();
        let found = predictor.predict(&values);
        for i in 0..15 {
            let expected = if i % 5 == 0 { 10.0 } else { 10.0 + 0.8 * (values[i - 1] - 10.0) };
            assert!((found[i] - expected).abs() < 1e-5, "{i}: {} {expected}", found[i]);
            let variance = if i % 5 == 0 { 4.0 } else { 4.0 * (1.0 - 0.64) };
            assert!((predictor.variances[i] - variance).abs() < 1e-5);
        }
    }

    #[test]
    fn predictions_do_not_depend_on_present_and_future() {
        let covariance = Array2::from_shape_fn((7, 7), |(r, c)| {
            let distance = (r as f64 - 3.0).hypot(c as f64 - 3.0);
            50.0 * (-distance).exp() + if distance == 0.0 { 10.0 } else { 0.0 }
        });
        let predictor = Predictor::new(10.0, &covariance, (4, 4)).unwrap();
        let values: Vec<f32> = (0..16).map(|i| ((i * 5) % 11) as f32).collect();
        let before = predictor.predict(&values);
        for moved in 0..16 {
            let mut values = values.clone();
            values[moved] += 100.0;
            let after = predictor.predict(&values);
            assert_eq!(before[..=moved], after[..=moved], "{moved}");
            assert!(moved == 15 || after[moved + 1..] != before[moved + 1..]);
        }
    }
}
