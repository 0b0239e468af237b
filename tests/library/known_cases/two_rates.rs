//! Independent pixels of two brightnesses, with shot noise.

use ndarray::Array2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{StudyError, check};
use lenslet_studio::information::poisson_entropy;

/// Independent pixels, each of one of two brightnesses, with shot noise.
///
/// The information per pixel is the entropy of the mixture of two Poisson distributions, summed over all counts, less the
/// mean of their entropies.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoRates {
    /// Side of a patch, px.
    pub side_px: usize,
    /// The two brightnesses, photons.
    pub rates: [f64; 2],
    /// Probability of the second.
    pub probability: f64,
}

impl Default for TwoRates {
    fn default() -> Self {
        Self { side_px: 16, rates: [20.0, 60.0], probability: 0.3 }
    }
}

impl TwoRates {
    pub fn check(&self) -> Result<(), StudyError> {
        for rate in self.rates {
            check("both rates in photons", "0 to 1000000", rate, 0.0..=1e6)?;
        }
        check("the probability of the second rate", "0 to 1", self.probability, 0.0..=1.0)
    }

    pub(super) fn clean_patch(&self, random: &mut ChaCha8Rng) -> Array2<f32> {
        let side = self.side_px;
        Array2::from_shape_simple_fn((side, side), || {
            self.rates[usize::from(random.random::<f64>() < self.probability)] as f32
        })
    }

    pub(super) fn bits_per_pixel(&self) -> f64 {
        let weights = [1.0 - self.probability, self.probability];
        let largest = self.rates[0].max(self.rates[1]);
        // In logarithms: from 745 photons on, the probability of 0 counts underflows an f64.
        let mut logarithms = self.rates.map(|rate| -rate);
        let mut entropy = 0.0;
        for count in 0..(largest + 12.0 * largest.sqrt() + 40.0) as u32 {
            let mixture: f64 = weights.iter().zip(logarithms).map(|(weight, ln)| weight * ln.exp()).sum();
            if mixture > 0.0 {
                entropy -= mixture * mixture.log2();
            }
            for (logarithm, rate) in logarithms.iter_mut().zip(self.rates) {
                *logarithm += (rate / f64::from(count + 1)).ln();
            }
        }
        entropy - weights.iter().zip(self.rates).map(|(weight, rate)| weight * poisson_entropy(rate)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::super::KnownTruth;
    use super::*;
    use lenslet_studio::information::binary_entropy;

    #[test]
    fn limits_are_the_entropy_of_the_question_and_nothing() {
        let bits = |rates, probability| TwoRates { rates, probability, ..TwoRates::default() }.bits_per_pixel();
        assert!((bits([1.0, 1000.0], 0.3) - binary_entropy(0.3)).abs() < 1e-9);
        assert!((bits([5000.0, 50_000.0], 0.5) - 1.0).abs() < 1e-9);
        assert!(bits([30.0, 30.0], 0.3).abs() < 1e-9);
        assert!(bits([20.0, 60.0], 1.0).abs() < 1e-9);
        let dark = bits([0.0, 2.0], 0.5);
        // A Z channel: a count above 0 identifies the second rate.
        let none = 0.5 * (1.0 + (-2.0_f64).exp());
        let expected = 1.0 - none * binary_entropy(0.5 / none);
        assert!((dark - expected).abs() < 1e-12, "{dark} {expected}");
    }

    #[test]
    fn rates_come_as_often_as_they_should() {
        let (clean, noisy) = KnownTruth::TwoRates(TwoRates::default()).draw(200, 7).unwrap();
        let share = clean.iter().filter(|x| **x == 60.0).count() as f64 / clean.len() as f64;
        assert!((share - 0.3).abs() < 4.0 * (0.21 / clean.len() as f64).sqrt(), "{share}");
        assert!(clean.iter().all(|x| *x == 20.0 || *x == 60.0) && noisy.iter().all(|y| y.fract() == 0.0));
    }
}
