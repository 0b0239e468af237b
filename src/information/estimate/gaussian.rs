//! Information from noisy patches by a fitted Gaussian model.

use std::time::Instant;

use ndarray::ArrayView3;
use serde::{Deserialize, Serialize};

use super::trial::{Trial, TrialSettings};
use crate::information::density::gaussian::dense::{check_patches, check_varied};
use crate::information::density::gaussian::full::{FullGaussian, check_scored};
use crate::information::density::gaussian::stationary::StationaryGaussian;
use crate::information::density::patch_checks::check_clean;
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::information::estimator::Estimator;
use crate::information::statistics::dequantisation::{TEST_STREAM, dequantised, whole};
use crate::sensor::Noise;

/// Covariance model of a fitted Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariance {
    /// One value per lag between pixels.
    #[default]
    Stationary,
    /// One value per pair of pixels.
    Full,
}

/// Patches and settings of one Gaussian trial.
#[derive(Clone, Copy, Debug)]
pub struct GaussianRequest<'a> {
    /// Noisy patches to fit, photons per pixel, shape (n, rows, cols).
    pub train: ArrayView3<'a, f32>,
    /// Noisy patches to score, photons per pixel, of scenes that the training patches do not show, shape (m, rows, cols).
    pub test: ArrayView3<'a, f32>,
    /// The test patches without noise, in the same order. Without them (an experiment) the noisy ones replace the
    /// means, negative values as 0; accurate above about 10 photons.
    pub test_clean: Option<ArrayView3<'a, f32>>,
    /// The model.
    pub covariance: Covariance,
    /// Noise of the measurements.
    pub noise: Noise,
    /// How entropies are taken.
    pub protocol: Protocol,
    /// Seed of dequantisation and bootstraps.
    pub seed: u64,
}

/// Fits a Gaussian to noisy patches and returns an upper bound on the information by its cross-entropy on held-out
/// patches.
///
/// The bound is `I <= -E log2 p(y) - H(Y|X)`, bits per pixel. Whole counts have probabilities, the model has a
/// density. So a uniform number between 0 and 1 is added to every pixel. Its entropy of 0 bit leaves `H(Y)`
/// unchanged, and the cross-entropy of the sum is an upper bound on `H(Y)`. The default protocol does so only for
/// shot noise, whose measurements are whole counts. The paper protocol always does, also for the continuous values of
/// read noise.
///
/// # Errors
/// For patches of different shapes, too few or unsuitable ones (see [`FullGaussian::fit`] and
/// [`StationaryGaussian::fit`]), or noise without a finite entropy (see [`NoiseEntropy`]).
pub fn gaussian_estimate(request: &GaussianRequest<'_>) -> Result<Trial, InformationError> {
    let started = Instant::now();
    let GaussianRequest { train, test, test_clean, covariance, noise, protocol, seed } = *request;
    let entropy = NoiseEntropy::new(noise, protocol)?;
    let (patches_train, rows, cols) = check_patches(train, "training patches")?;
    check_scored(test, (rows, cols))?;
    let pixels = rows * cols;
    if test.is_empty() {
        return Err(InformationError::TooFewPatches { model: "a held-out test", needed: 1, found: 0, pixels });
    }
    // Checked before a uniform number makes the values differ.
    check_varied(train)?;
    let mut notes = Vec::new();
    let entropy_y_given_x = if let Some(clean) = test_clean {
        check_clean(clean, test)?;
        entropy.patch_bits(clean)?
    } else {
        notes.push("the noise entropy uses the noisy measurements in place of clean images".to_owned());
        entropy.measured_patch_bits(test)?
    };

    let dequantise = protocol == Protocol::Paper || noise == Noise::Shot;
    if dequantise && !(whole(train) && whole(test)) {
        notes.push("measurements that are not whole counts were dequantised".to_owned());
    }
    let (train, test) = if dequantise {
        (dequantised(train, seed, 0), dequantised(test, seed, TEST_STREAM))
    } else {
        (train.to_owned(), test.to_owned())
    };
    let (estimator, log2_densities) = match covariance {
        Covariance::Stationary => {
            let model = StationaryGaussian::fit(train.view())?;
            if model.taper() > 0.0 {
                let share = 100.0 * model.taper();
                notes.push(format!("a taper of {share:.1} % made the fitted covariance positive definite"));
            }
            (Estimator::GaussianStationary, model.log2_densities(test.view())?)
        }
        Covariance::Full => (Estimator::GaussianFull, FullGaussian::fit(train.view())?.log2_densities(test.view())?),
    };
    let cross_entropy: Vec<f64> = log2_densities.iter().map(|bits| -bits / pixels as f64).collect();
    let settings = TrialSettings { estimator, protocol, noise, patch: (rows, cols), patches_train, seed };
    Trial::from_patches(settings, &cross_entropy, &entropy_y_given_x, started.elapsed().as_secs_f64(), notes)
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn counts(count: usize, seed: u64) -> Array3<f32> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Array3::from_shape_simple_fn((count, 4, 4), || rng.random_range(20..60_u8).into())
    }

    fn request<'a>(train: &'a Array3<f32>, test: &'a Array3<f32>) -> GaussianRequest<'a> {
        GaussianRequest {
            train: train.view(),
            test: test.view(),
            test_clean: Some(test.view()),
            covariance: Covariance::Stationary,
            noise: Noise::Shot,
            protocol: Protocol::Default,
            seed: 1,
        }
    }

    #[test]
    fn the_seed_alone_decides() {
        let (train, test) = (counts(200, 1), counts(60, 2));
        let run = |seed, threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let request = GaussianRequest { seed, ..request(&train, &test) };
            let trial = pool.install(|| gaussian_estimate(&request).unwrap());
            (trial.bits_per_pixel(), trial.interval_95())
        };
        assert_eq!(run(1, 1), run(1, 3));
        assert_ne!(run(1, 1), run(2, 1));
    }

    #[test]
    fn dequantisation_stays_below_the_next_count_and_differs_between_sets() {
        let patches = counts(10, 3);
        let (train, test) = (dequantised(patches.view(), 5, 0), dequantised(patches.view(), 5, TEST_STREAM));
        assert_eq!(train.mapv(f32::floor), patches);
        assert_ne!(train, test);
    }

    #[test]
    fn stand_ins_and_fractions_are_noted() {
        let (train, test) = (counts(200, 1), counts(60, 2));
        assert!(gaussian_estimate(&request(&train, &test)).unwrap().notes().is_empty());
        let stand_in = GaussianRequest { test_clean: None, ..request(&train, &test) };
        let trial = gaussian_estimate(&stand_in).unwrap();
        assert!(trial.notes()[0].contains("in place of clean images"));
        // Here the clean images given above are the measurements, so nothing else changes.
        let given = gaussian_estimate(&request(&train, &test)).unwrap();
        assert!((trial.bits_per_pixel() - given.bits_per_pixel()).abs() < 1e-12);
        let scaled = train.mapv(|y| y * 0.7);
        assert!(gaussian_estimate(&request(&scaled, &test)).unwrap().notes()[0].contains("not whole counts"));
        let read = GaussianRequest { noise: Noise::Read { sigma: 2.0 }, ..request(&scaled, &test) };
        assert!(gaussian_estimate(&read).unwrap().notes().is_empty(), "continuous data stay as they are");
    }

    #[test]
    fn bad_requests_get_reasons() {
        let (train, test) = (counts(200, 1), counts(60, 2));
        let fails = |request: GaussianRequest<'_>| gaussian_estimate(&request).unwrap_err();
        assert_eq!(fails(GaussianRequest { noise: Noise::None, ..request(&train, &test) }), InformationError::NoNoise);
        let wide = Array3::zeros((60, 4, 5));
        assert!(matches!(fails(request(&train, &wide)), InformationError::PatchShape { .. }));
        let clean = Some(train.view());
        let found = fails(GaussianRequest { test_clean: clean, ..request(&train, &test) });
        assert_eq!(found, InformationError::PatchCount { noisy: 60, clean: 200 });
        let none = Array3::zeros((0, 4, 4));
        assert!(matches!(fails(request(&train, &none)), InformationError::TooFewPatches { .. }));
        assert!(matches!(fails(request(&none, &test)), InformationError::TooFewPatches { .. }));
        for (covariance, noise) in
            [(Covariance::Full, Noise::Shot), (Covariance::Stationary, Noise::Read { sigma: 1.0 })]
        {
            let constant = Array3::from_elem((200, 4, 4), 9.0);
            let found = fails(GaussianRequest { covariance, noise, ..request(&constant, &test) });
            assert_eq!(found, InformationError::Constant { value: 9.0 });
            let few = train.slice(ndarray::s![..16, .., ..]);
            if covariance == Covariance::Full {
                let found = fails(GaussianRequest { train: few, covariance, noise, ..request(&train, &test) });
                assert!(matches!(found, InformationError::TooFewPatches { needed: 17, found: 16, .. }), "{found}");
            }
            let mut broken = test.clone();
            broken[[5, 0, 0]] = f32::NAN;
            let clean = Some(broken.view());
            let found = fails(GaussianRequest { test_clean: clean, covariance, noise, ..request(&train, &test) });
            assert!(matches!(found, InformationError::Photons { found } if found.is_nan()), "{found}");
            let found = fails(GaussianRequest { test_clean: None, covariance, noise, ..request(&train, &broken) });
            assert_eq!(found, InformationError::NotFinite { what: "test patches", patch: 5 });
            let found = fails(GaussianRequest { covariance, noise, ..request(&broken, &test) });
            assert_eq!(found, InformationError::NotFinite { what: "training patches", patch: 5 });
        }
        let dark = Array3::zeros((60, 4, 4));
        let paper = GaussianRequest { protocol: Protocol::Paper, test_clean: None, ..request(&train, &dark) };
        // The published procedure counts measured zeros.
        assert!(gaussian_estimate(&paper).is_ok());
    }

    #[test]
    fn counts_beyond_single_steps_of_f32_keep_their_information() {
        // Above 16.8 million an f32 holds every second count only; shot noise is thousands of counts wide there.
        let patches = |seed| {
            let clean = Array3::from_elem((800, 4, 4), 3e7_f32);
            (Noise::Shot.draw(clean.view(), seed), clean)
        };
        let ((train, _), (test, clean)) = (patches(1), patches(2));
        let trial = gaussian_estimate(&GaussianRequest { test_clean: Some(clean.view()), ..request(&train, &test) });
        let bits = trial.unwrap().bits_per_pixel();
        assert!(bits.abs() < 0.02, "nothing but noise: {bits}");
    }

    #[test]
    fn negative_measurements_stand_in_as_darkness() {
        let (train, test) = (counts(200, 1), counts(60, 2));
        let mut negative = test.clone();
        negative.mapv_inplace(|y| if y < 30.0 { -y } else { y });
        let zeroed = negative.mapv(|y| y.max(0.0));
        let of = |clean| {
            let request = GaussianRequest { test_clean: clean, ..request(&train, &negative) };
            gaussian_estimate(&request).unwrap().bits_per_pixel()
        };
        assert_eq!(of(None), of(Some(zeroed.view())));
    }
}
