//! A stationary Gaussian field with read noise.

use ndarray::{Array2, s};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{StudyError, check};
use lenslet_studio::information::log2_determinant;

/// A stationary Gaussian field with read noise: white noise under a Gaussian filter.
///
/// The covariance of the clean patch is the filter's autocorrelation C. With n pixels, the information per pixel is `log2
/// det(I + C / sigma^2) / (2 n)`.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussianField {
    /// Side of a patch, px.
    pub side_px: usize,
    /// Mean of all pixels, photons.
    pub mean: f64,
    /// Standard deviation of a clean pixel, photons.
    pub deviation: f64,
    /// Pixels over which the correlation falls to `exp(-1/2)`; 0 for independent pixels.
    pub correlation_px: f64,
    /// Standard deviation of the read noise, photons.
    pub read_sigma: f64,
}

impl Default for GaussianField {
    fn default() -> Self {
        Self { side_px: 16, mean: 50.0, deviation: 6.0, correlation_px: 2.0, read_sigma: 3.0 }
    }
}

impl GaussianField {
    pub fn check(&self) -> Result<(), StudyError> {
        check("the mean in photons", "finite and at most 1000000", self.mean, -1e6..=1e6)?;
        check("the field's deviation in photons", "0 to 1000000", self.deviation, 0.0..=1e6)?;
        check("the correlation length in pixels", "0 to 32", self.correlation_px, 0.0..=32.0)?;
        check("the read noise in photons", "above 0 and at most 1000000", self.read_sigma, 1e-6..=1e6)
    }

    /// Samples of the filter along one axis; their squares sum to 1.
    fn filter(&self) -> Vec<f64> {
        // The autocorrelation of a Gaussian is wider by the square root of 2.
        let width = self.correlation_px / std::f64::consts::SQRT_2;
        let radius = (4.0 * width).ceil() as i32;
        let sample = |i: i32| if i == 0 { 1.0 } else { (-0.5 * (f64::from(i) / width).powi(2)).exp() };
        let samples: Vec<f64> = (-radius..=radius).map(sample).collect();
        let norm = samples.iter().map(|x| x * x).sum::<f64>().sqrt();
        samples.into_iter().map(|x| x / norm).collect()
    }

    pub(super) fn clean_patch(&self, random: &mut ChaCha8Rng) -> Array2<f32> {
        let (side, filter) = (self.side_px, self.filter());
        let wide = side + filter.len() - 1;
        let white = Array2::from_shape_simple_fn((wide, wide), || random.sample::<f64, _>(StandardNormal));
        let mut along_rows = Array2::zeros((wide, side));
        for (i, &weight) in filter.iter().enumerate() {
            along_rows.scaled_add(weight, &white.slice(s![.., i..i + side]));
        }
        let mut field = Array2::zeros((side, side));
        for (i, &weight) in filter.iter().enumerate() {
            field.scaled_add(weight, &along_rows.slice(s![i..i + side, ..]));
        }
        field.mapv(|x: f64| (self.mean + self.deviation * x) as f32)
    }

    pub(super) fn bits_per_pixel(&self) -> Result<f64, StudyError> {
        let (side, filter) = (self.side_px, self.filter());
        let along = |lag: usize| filter.iter().zip(filter.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>();
        let noise = self.read_sigma * self.read_sigma;
        let signal_to_noise = self.deviation * self.deviation / noise;
        let covariance = Array2::from_shape_fn((2 * side - 1, 2 * side - 1), |(r, c)| {
            let (row_lag, col_lag) = (r.abs_diff(side - 1), c.abs_diff(side - 1));
            let noise = f64::from(u8::from(row_lag == 0 && col_lag == 0));
            signal_to_noise * along(row_lag) * along(col_lag) + noise
        });
        Ok(0.5 * log2_determinant(&covariance, (side, side))? / (side * side) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::super::KnownTruth;
    use super::*;

    #[test]
    fn independent_pixels_have_the_capacity_formula() {
        for (deviation, sigma) in [(6.0, 3.0), (1.0, 10.0), (0.0, 1.0)] {
            let field = GaussianField { deviation, read_sigma: sigma, correlation_px: 0.0, ..GaussianField::default() };
            let expected = 0.5 * (1.0 + (deviation / sigma).powi(2)).log2();
            assert!((field.bits_per_pixel().unwrap() - expected).abs() < 1e-12, "{deviation} {sigma}");
        }
        let correlated = GaussianField::default().bits_per_pixel().unwrap();
        assert!(correlated > 0.2 && correlated < 0.5 * 5.0_f64.log2(), "correlation repeats itself: {correlated}");
    }

    #[test]
    fn samples_have_the_covariance() {
        let settings = GaussianField::default();
        let (clean, noisy) = KnownTruth::GaussianField(settings.clone()).draw(4000, 1).unwrap();
        let covariance = |a: [usize; 2], b: [usize; 2]| {
            let each = clean.outer_iter().map(|patch| (f64::from(patch[a]) - 50.0) * (f64::from(patch[b]) - 50.0));
            each.sum::<f64>() / 4000.0
        };
        for (lag, at) in [([0, 0], [7, 3]), ([2, 0], [1, 12]), ([0, 2], [8, 8]), ([3, 3], [10, 0])] {
            let found = covariance(at, [at[0] + lag[0], at[1] + lag[1]]);
            let square = (lag[0] * lag[0] + lag[1] * lag[1]) as f64;
            let expected = 36.0 * (-0.5 * square / 4.0).exp();
            // Standard error of a covariance of standard normal numbers: at most sqrt(2 / n).
            assert!((found - expected).abs() < 4.0 * 36.0 * (2.0_f64 / 4000.0).sqrt(), "{lag:?}: {found} {expected}");
        }
        let noise = (&noisy - &clean).mapv(f64::from);
        assert!((noise.mapv(|x| x * x).mean().unwrap() - 9.0).abs() < 0.1);
    }
}
