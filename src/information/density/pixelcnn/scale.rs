//! Statistics of the training patches that scale the network: mean, spread and range.

use ndarray::ArrayView3;

use crate::information::density::patch_checks::check_values;
use crate::information::error::InformationError;

/// Statistics of the training patches, photons per pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DataScale {
    /// Mean; inputs are standardised by it.
    pub mean: f32,
    /// Standard deviation (of the population); inputs are standardised by it, and no Gaussian is wider.
    pub deviation: f32,
    /// Smallest value; no mean lies below.
    pub min: f32,
    /// Largest value; no mean lies above.
    pub max: f32,
    /// No Gaussian is narrower, unless the deviation is; 1 photon as published.
    pub min_width: f32,
}

impl DataScale {
    /// Statistics of training patches, shape (n, rows, cols), photons per pixel.
    ///
    /// # Errors
    /// For no data, values that are not finite or beyond 10 million photons, or all equal.
    pub fn of(patches: ArrayView3<'_, f32>, min_width: f32) -> Result<Self, InformationError> {
        check_values(patches, "training patches")?;
        let count = patches.len() as f64;
        let mean = patches.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
        let variance = patches.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / count;
        let min = patches.iter().copied().fold(f32::INFINITY, f32::min);
        let max = patches.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let deviation = variance.sqrt() as f32;
        // The second test catches spreads that vanish when they are squared.
        if min >= max || deviation <= 1e-6 {
            return Err(InformationError::Constant { value: f64::from(min) });
        }
        Ok(Self { mean: mean as f32, deviation, min, max, min_width })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn statistics_are_those_of_all_pixels() {
        let patches = Array3::from_shape_vec((2, 1, 2), vec![1.0, 3.0, 5.0, 7.0]).unwrap();
        let scale = DataScale::of(patches.view(), 1.0).unwrap();
        let expected = DataScale { mean: 4.0, deviation: 5.0_f32.sqrt(), min: 1.0, max: 7.0, min_width: 1.0 };
        assert_eq!(scale, expected);
    }

    #[test]
    fn bad_values_get_reasons() {
        let patches = |value: f32| Array3::from_shape_fn((4, 3, 3), |(n, ..)| if n == 2 { value } else { 5.0 });
        let of = |value: f32| DataScale::of(patches(value).view(), 1.0).unwrap_err();
        assert_eq!(of(5.0), InformationError::Constant { value: 5.0 });
        assert_eq!(of(f32::NAN), InformationError::NotFinite { what: "training patches", patch: 2 });
        assert!(of(2e7).to_string().contains("20000000"), "{}", of(2e7));
        assert_eq!(DataScale::of(Array3::zeros((0, 3, 3)).view(), 1.0), Err(InformationError::Empty));
    }
}
