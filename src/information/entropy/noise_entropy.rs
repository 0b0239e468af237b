//! Entropy of the noise, H(Y|X): the entropy of a measurement when the encoded image is known.

use std::fmt;
use std::str::FromStr;

use ndarray::{ArrayView, ArrayView3, Axis, Dimension};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::poisson::poisson_entropy;
use super::poisson_gaussian::PoissonGaussianEntropy;
use crate::information::error::InformationError;
use crate::sensor::Noise;

/// Protocol of an estimate: exact entropies, or the published procedure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// Exact entropies of the noise; only whole counts are dequantised.
    #[default]
    Default,
    /// The procedure behind the published figures (Pinkard et al. 2024; Kabuli et al. 2026): shot noise as a Gaussian
    /// of variance x, which overstates its entropy by 0.0127 bit at 10 photons; all data are dequantised.
    Paper,
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Default => "default",
            Self::Paper => "paper",
        })
    }
}

impl FromStr for Protocol {
    type Err = InformationError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "default" => Ok(Self::Default),
            "paper" => Ok(Self::Paper),
            _ => Err(InformationError::UnknownProtocol { found: text.to_owned() }),
        }
    }
}

/// Differential entropy of a Gaussian of the given variance, `1/2 log2(2 pi e variance)` bits.
pub fn gaussian_entropy(variance: f64) -> f64 {
    0.5 * (2.0 * std::f64::consts::PI * std::f64::consts::E * variance).log2()
}

/// Entropy of one noisy pixel as a function of its mean, for one noise model and protocol.
///
/// | noise | default protocol | paper protocol |
/// |---|---|---|
/// | shot | exact Poisson entropy | `1/2 log2(2 pi e x)` |
/// | read | `1/2 log2(2 pi e sigma^2)` | the same |
/// | both | differential entropy of the Poisson-Gaussian mixture | `1/2 log2(2 pi e (x + sigma^2))` |
///
/// With both noises the default protocol tabulates the mixture once in [`NoiseEntropy::new`] (some milliseconds), so
/// keep the value as long as the noise stays the same.
#[derive(Clone, Debug)]
pub struct NoiseEntropy {
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Poisson,
    Constant(f64),
    Mixture(PoissonGaussianEntropy),
    /// Gaussian of the mean plus this variance.
    Gaussian(f64),
}

impl NoiseEntropy {
    /// The entropy of `noise` under `protocol`.
    ///
    /// # Errors
    /// Without noise, or with a read noise that is not a positive finite number.
    pub fn new(noise: Noise, protocol: Protocol) -> Result<Self, InformationError> {
        check_noise(noise)?;
        let kind = match (noise, protocol) {
            (Noise::None, _) => return Err(InformationError::NoNoise),
            (Noise::Shot, Protocol::Default) => Kind::Poisson,
            (Noise::Shot, Protocol::Paper) => Kind::Gaussian(0.0),
            (Noise::Read { sigma }, _) => Kind::Constant(gaussian_entropy(sigma * sigma)),
            (Noise::ShotRead { sigma }, Protocol::Default) => Kind::Mixture(PoissonGaussianEntropy::new(sigma)),
            (Noise::ShotRead { sigma }, Protocol::Paper) => Kind::Gaussian(sigma * sigma),
        };
        Ok(Self { kind })
    }

    /// Entropy in bits of a pixel of mean `mean_photons`; NaN for a negative mean and minus infinity for a dark pixel
    /// where shot noise is approximated by a Gaussian.
    pub fn bits(&self, mean_photons: f64) -> f64 {
        match &self.kind {
            Kind::Constant(bits) => *bits,
            Kind::Poisson => poisson_entropy(mean_photons),
            // Written so that NaN passes the test and shows.
            _ if mean_photons < 0.0 => f64::NAN,
            Kind::Mixture(entropy) => entropy.bits(mean_photons),
            Kind::Gaussian(variance) => gaussian_entropy(mean_photons + variance),
        }
    }

    /// Entropy in bits of a pixel whose mean is unknown, with its measured photons in place of the mean. Negative ones count as 0. A
    /// pixel of 0 has no entropy where shot noise is approximated by a Gaussian (as in the published procedure).
    pub fn measured_bits(&self, measured_photons: f64) -> f64 {
        match self.kind {
            Kind::Gaussian(variance) if measured_photons.max(0.0) + variance == 0.0 => 0.0,
            _ => self.bits(measured_photons.max(0.0)),
        }
    }

    /// [`NoiseEntropy::measured_bits`] of each noisy patch of shape (rows, cols), mean bits per pixel, from patches (n, rows, cols).
    ///
    /// # Errors
    /// For an empty array, or a pixel that is not finite.
    pub fn measured_patch_bits(&self, noisy: ArrayView3<'_, f32>) -> Result<Vec<f64>, InformationError> {
        let dark = matches!(self.kind, Kind::Gaussian(0.0));
        let has_dark = dark && noisy.iter().any(|y| *y <= 0.0);
        if !has_dark {
            return self.patch_bits(noisy.mapv(|y| y.max(0.0)).view());
        }
        noisy
            .axis_iter(Axis(0))
            .map(|patch| {
                let bits: f64 = patch.iter().map(|&y| self.measured_bits(f64::from(y))).sum();
                let mean = bits / patch.len().max(1) as f64;
                if mean.is_finite() { Ok(mean) } else { Err(InformationError::DarkPixel) }
            })
            .collect()
    }

    /// Mean entropy in bits per pixel over clean images (photons per pixel), of any shape.
    ///
    /// # Errors
    /// For an empty array, a mean that is negative or not finite, or a dark pixel in the Gaussian approximation.
    pub fn mean_bits<D: Dimension>(&self, clean: ArrayView<'_, f32, D>) -> Result<f64, InformationError> {
        if clean.is_empty() {
            return Err(InformationError::Empty);
        }
        let standard = clean.as_standard_layout();
        // A standard layout is contiguous, so the slice is there.
        let pixels = standard.as_slice().unwrap_or_default();
        // Parts of fixed length, summed in order: the result does not depend on the number of threads.
        let sums: Vec<f64> = pixels.par_chunks(16_384).map(|part| self.sum_bits(part)).collect();
        let mean = sums.iter().sum::<f64>() / pixels.len() as f64;
        if mean.is_finite() { Ok(mean) } else { Err(Self::explain(pixels)) }
    }

    /// Mean entropy of each patch of shape (rows, cols), bits per pixel, from clean patches (n, rows, cols).
    ///
    /// # Errors
    /// As [`NoiseEntropy::mean_bits`].
    pub fn patch_bits(&self, clean: ArrayView3<'_, f32>) -> Result<Vec<f64>, InformationError> {
        let patches: Vec<_> = clean.axis_iter(Axis(0)).collect();
        patches.into_par_iter().map(|patch| self.mean_bits(patch)).collect()
    }

    fn sum_bits(&self, pixels: &[f32]) -> f64 {
        pixels.iter().map(|&x| if x.is_finite() { self.bits(f64::from(x)) } else { f64::NAN }).sum()
    }

    /// Error that explains why a sum over these pixels is not finite.
    fn explain(pixels: &[f32]) -> InformationError {
        match pixels.iter().find(|x| !x.is_finite() || **x < 0.0) {
            Some(&found) => InformationError::Photons { found: f64::from(found) },
            None => InformationError::DarkPixel,
        }
    }
}

/// Checks that there is noise and that its read noise is positive and finite.
pub(in crate::information) fn check_noise(noise: Noise) -> Result<(), InformationError> {
    match noise {
        Noise::None => Err(InformationError::NoNoise),
        Noise::Shot => Ok(()),
        Noise::Read { sigma } | Noise::ShotRead { sigma } if sigma > 0.0 && (sigma * sigma).is_normal() => Ok(()),
        Noise::Read { sigma } | Noise::ShotRead { sigma } => Err(InformationError::ReadNoise { sigma }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Array3, arr1};

    #[test]
    fn both_protocols_follow_their_formulas() {
        let read = Noise::Read { sigma: 5.0 };
        let both = Noise::ShotRead { sigma: 5.0 };
        let bits = |noise, protocol, x| NoiseEntropy::new(noise, protocol).unwrap().bits(x);
        for protocol in [Protocol::Default, Protocol::Paper] {
            assert!((bits(read, protocol, 40.0) - gaussian_entropy(25.0)).abs() < 1e-12);
        }
        assert!((bits(Noise::Shot, Protocol::Paper, 40.0) - gaussian_entropy(40.0)).abs() < 1e-12);
        assert!((bits(both, Protocol::Paper, 40.0) - gaussian_entropy(65.0)).abs() < 1e-12);
        assert!((bits(Noise::Shot, Protocol::Default, 40.0) - poisson_entropy(40.0)).abs() < 1e-12);
        // Adding read noise to counts adds uncertainty, but less than the summed variances of a Gaussian.
        assert!(bits(both, Protocol::Default, 40.0) < gaussian_entropy(65.0));
        assert!(bits(both, Protocol::Default, 40.0) > gaussian_entropy(25.0));
    }

    #[test]
    fn means_do_not_depend_on_layout() {
        let entropy = NoiseEntropy::new(Noise::Shot, Protocol::Default).unwrap();
        let clean = Array2::from_shape_fn((40, 70), |(r, c)| 10.0 + (r * c) as f32);
        let expected = clean.iter().map(|&x| entropy.bits(f64::from(x))).sum::<f64>() / 2800.0;
        assert!((entropy.mean_bits(clean.view()).unwrap() - expected).abs() < 1e-12);
        assert!((entropy.mean_bits(clean.t()).unwrap() - expected).abs() < 1e-12);
        let mut turned = clean.view();
        turned.invert_axis(Axis(0));
        assert!((entropy.mean_bits(turned).unwrap() - expected).abs() < 1e-12);
        let patches = Array3::from_shape_fn((3, 4, 5), |(n, r, c)| (n * 100 + r * 5 + c) as f32);
        let each = entropy.patch_bits(patches.view()).unwrap();
        assert_eq!(each.len(), 3);
        assert!((each.iter().sum::<f64>() / 3.0 - entropy.mean_bits(patches.view()).unwrap()).abs() < 1e-12);
    }

    #[test]
    fn bad_requests_get_reasons() {
        assert_eq!(NoiseEntropy::new(Noise::None, Protocol::Default).unwrap_err(), InformationError::NoNoise);
        for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-200] {
            let found = NoiseEntropy::new(Noise::ShotRead { sigma }, Protocol::Default);
            assert!(matches!(found, Err(InformationError::ReadNoise { .. })), "{sigma}");
        }
        let exact = NoiseEntropy::new(Noise::Shot, Protocol::Default).unwrap();
        let paper = NoiseEntropy::new(Noise::Shot, Protocol::Paper).unwrap();
        assert_eq!(exact.mean_bits(arr1(&[3.0, -1.0]).view()), Err(InformationError::Photons { found: -1.0 }));
        assert!(matches!(exact.mean_bits(arr1(&[f32::NAN]).view()), Err(InformationError::Photons { .. })));
        assert!(exact.mean_bits(arr1(&[0.0]).view()).is_ok());
        assert_eq!(paper.mean_bits(arr1(&[5.0, 0.0]).view()), Err(InformationError::DarkPixel));
        assert_eq!(exact.mean_bits(arr1(&[]).view()), Err(InformationError::Empty));
    }

    #[test]
    fn measured_pixels_of_zero_count_as_published() {
        let noisy = ndarray::arr3(&[[[0.0_f32, -2.0, 8.0, 8.0]]]);
        let paper = NoiseEntropy::new(Noise::Shot, Protocol::Paper).unwrap();
        let found = paper.measured_patch_bits(noisy.view()).unwrap();
        assert!((found[0] - gaussian_entropy(8.0) / 2.0).abs() < 1e-12, "{found:?}");
        let exact = NoiseEntropy::new(Noise::Shot, Protocol::Default).unwrap();
        let found = exact.measured_patch_bits(noisy.view()).unwrap();
        assert!((found[0] - exact.bits(8.0) / 2.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn protocols_have_names() {
        for protocol in [Protocol::Default, Protocol::Paper] {
            assert_eq!(protocol.to_string().parse::<Protocol>().unwrap(), protocol);
            assert_eq!(serde_json::to_string(&protocol).unwrap(), format!("\"{protocol}\""));
        }
        assert!("Paper".parse::<Protocol>().is_err());
    }
}
