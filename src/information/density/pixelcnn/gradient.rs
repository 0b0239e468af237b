//! Gradient of the information by the encoded images, with the weights of the network held fixed.

use ndarray::{Array3, ArrayView3};

use super::model::PixelCnn;
use crate::information::density::frozen::FrozenDensity;
use crate::information::entropy::reparameterisation::{DARKEST, Reparameterised};
use crate::information::error::InformationError;
use crate::progress::Progress;
use crate::sensor::Noise;

/// Mean of the uniform number added to whole counts before a fit.
const DEQUANTISED: f64 = 0.5;

/// A network fitted to measurements with this noise.
#[derive(Clone, Copy)]
pub struct FrozenPixelCnn<'a> {
    /// Fitted to dequantised measurements.
    pub network: &'a PixelCnn,
    /// Their noise.
    pub noise: Noise,
}

impl FrozenDensity for FrozenPixelCnn<'_> {
    /// Both terms as published: `-E log2 q(y)` at measurements with reparameterised noise, and
    /// `1/2 log2(2 pi e s(x)^2)` for the noise (Kabuli et al. 2026).
    fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<usize>,
    ) -> Result<(f64, Array3<f64>), InformationError> {
        let noise = Reparameterised::new(self.noise);
        let mut noisy = clean.to_owned();
        noisy.zip_mut_with(&normals, |x, e| *x = (noise.measured(f64::from(*x), f64::from(*e)) + DEQUANTISED) as f32);
        let losses = self.network.losses_and_gradients(noisy.view(), progress)?;
        let mut gradient = Array3::zeros(clean.dim());
        let mut total = 0.0;
        for ((out, (&x, &e)), (nats, by_y)) in gradient.iter_mut().zip(clean.iter().zip(&normals)).zip(losses) {
            let (seen, e) = (f64::from(x).max(DARKEST), f64::from(e));
            let (entropy, by_x) = noise.entropy(seen);
            total += f64::from(nats) - entropy;
            // Darker pixels all count as this dark.
            *out = if f64::from(x) < seen { 0.0 } else { f64::from(by_y) * noise.slope(seen, e) - by_x };
        }
        let share = 1.0 / (noisy.len().max(1) as f64 * std::f64::consts::LN_2);
        gradient *= share;
        Ok((total * share, gradient))
    }
}

#[cfg(test)]
mod tests {
    use super::super::scale::DataScale;
    use super::super::shape::PixelCnnShape;
    use super::*;
    use crate::progress::CancelToken;

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        let clean = Array3::from_shape_fn((2, 6, 7), |(n, r, c)| {
            let distance = (r as f32 - (n * 5 % 6) as f32).hypot(c as f32 - (n * 3 % 7) as f32);
            15.0 + 60.0 * (-0.3 * distance * distance).exp()
        });
        let normals = clean.mapv(|x| (x * 7.3).sin() * 1.2);
        let scale = DataScale { mean: 25.0, deviation: 16.0, min: 2.0, max: 95.0, min_width: 1.0 };
        let mut network = PixelCnn::new(PixelCnnShape::new(6, 5, vec![1, 2]).unwrap(), scale, 3);
        for (i, weight) in network.weights.iter_mut().enumerate() {
            *weight += 0.1 * ((i * 37 % 101) as f32 / 50.0 - 1.0);
        }
        for noise in [Noise::Shot, Noise::Read { sigma: 3.0 }, Noise::ShotRead { sigma: 2.0 }] {
            let held = FrozenPixelCnn { network: &network, noise };
            let value = |clean: &Array3<f32>| {
                held.information_gradient(clean.view(), normals.view(), &mut CancelToken::new()).unwrap()
            };
            let (bits, gradient) = value(&clean);
            assert!(bits.is_finite(), "{noise}: {bits}");
            for index in [(0, 0, 0), (0, 2, 3), (1, 3, 1), (1, 5, 6), (0, 4, 5), (1, 0, 3)] {
                let moved = |by: f32| {
                    let mut clean = clean.clone();
                    clean[index] += by;
                    value(&clean).0
                };
                let step = 0.05;
                let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
                let found = gradient[index];
                assert!((slope - found).abs() < 0.02 * slope.abs() + 2e-5, "{noise} {index:?}: {slope} {found}");
            }
        }
    }
}
