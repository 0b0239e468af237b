//! Random patches of known information, against which estimators are tested.

mod error;
mod gaussian_field;
mod one_bead;
mod two_rates;

use std::fmt;

use ndarray::{Array2, Array3, Axis};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

pub use gaussian_field::GaussianField;
pub use one_bead::OneBead;
pub use two_rates::TwoRates;

use error::{StudyError, check};
use lenslet_studio::information::InformationError;
use lenslet_studio::sensor::Noise;

/// First random stream of clean patches. The noise uses the streams from 0 on.
const CLEAN_STREAM: u64 = 1 << 40;
/// Largest side of a patch, px.
const LARGEST_SIDE: usize = 90;
/// Largest number of pixels of one draw: 4 GiB.
const MOST_PIXELS: usize = 1 << 30;

/// Random patches with known mutual information between clean and noisy patches. Patches are independent of one another.
///
/// ```
/// use lenslet_studio::studies::{KnownTruth, TwoRates};
///
/// let study = KnownTruth::TwoRates(TwoRates::default());
/// let truth = study.information(1)?;
/// let (clean, noisy) = study.draw(100, 2)?;
/// assert_eq!(clean.dim(), noisy.dim());
/// // A noiseless pixel of two equally probable values would give at most the entropy of the values.
/// assert!(truth.bits_per_pixel > 0.8 && truth.bits_per_pixel < 0.8813);
/// # Ok::<(), lenslet_studio::studies::StudyError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum KnownTruth {
    /// Correlated Gaussian pixels with read noise.
    GaussianField(GaussianField),
    /// One bead somewhere, with shot noise.
    OneBead(OneBead),
    /// Independent pixels of two brightnesses, with shot noise.
    TwoRates(TwoRates),
}

/// The true information of a study, bits per pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueInformation {
    /// Mutual information between clean and noisy patch, divided by the pixels of a patch.
    pub bits_per_pixel: f64,
    /// Standard error of that number where it was sampled; 0 where it was computed.
    pub standard_error: f64,
}

impl KnownTruth {
    /// The three studies with default settings. The information is a good part of a bit; for the bead, a good part of
    /// that of its place.
    pub fn standard() -> [Self; 3] {
        [
            Self::GaussianField(GaussianField::default()),
            Self::OneBead(OneBead::default()),
            Self::TwoRates(TwoRates::default()),
        ]
    }

    /// Clean and noisy patches, photons per pixel, each of shape (count, side, side).
    ///
    /// Patch i depends only on i and the seed.
    ///
    /// # Errors
    /// [`StudyError`] for settings outside their limits, or more patches than memory holds.
    pub fn draw(&self, count: usize, seed: u64) -> Result<(Array3<f32>, Array3<f32>), StudyError> {
        self.check()?;
        let (rows, cols) = self.patch();
        let most = MOST_PIXELS / (rows * cols);
        if count > most {
            return Err(InformationError::TooManyPatches { count, rows, cols, most }.into());
        }
        let mut clean = Array3::zeros((count, rows, cols));
        clean.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(index, mut patch)| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(CLEAN_STREAM + index as u64);
            patch.assign(&self.clean_patch(&mut random));
        });
        let noisy = self.noise().draw(clean.view(), seed);
        Ok((clean, noisy))
    }

    /// Mutual information between a clean and a noisy patch. `seed` is the seed of the sample, where one is needed.
    ///
    /// # Errors
    /// [`StudyError`] for settings outside their limits.
    pub fn information(&self, seed: u64) -> Result<TrueInformation, StudyError> {
        self.check()?;
        let computed = |bits_per_pixel| TrueInformation { bits_per_pixel, standard_error: 0.0 };
        match self {
            Self::GaussianField(field) => Ok(computed(field.bits_per_pixel()?)),
            Self::OneBead(bead) => Ok(bead.information(seed)),
            Self::TwoRates(rates) => Ok(computed(rates.bits_per_pixel())),
        }
    }

    /// Noise of the measurements.
    pub fn noise(&self) -> Noise {
        match self {
            Self::GaussianField(field) => Noise::Read { sigma: field.read_sigma },
            Self::OneBead(_) | Self::TwoRates(_) => Noise::Shot,
        }
    }

    /// Shape of a patch (rows, cols), px.
    pub fn patch(&self) -> (usize, usize) {
        let side = match self {
            Self::GaussianField(field) => field.side_px,
            Self::OneBead(bead) => bead.side_px,
            Self::TwoRates(rates) => rates.side_px,
        };
        (side, side)
    }

    fn clean_patch(&self, random: &mut ChaCha8Rng) -> Array2<f32> {
        match self {
            Self::GaussianField(field) => field.clean_patch(random),
            Self::OneBead(bead) => bead.clean_patch(random),
            Self::TwoRates(rates) => rates.clean_patch(random),
        }
    }

    fn check(&self) -> Result<(), StudyError> {
        let side = self.patch().0;
        check("the patch's side in pixels", "1 to 90", side as f64, 1.0..=LARGEST_SIDE as f64)?;
        match self {
            Self::GaussianField(field) => field.check(),
            Self::OneBead(bead) => bead.check(),
            Self::TwoRates(rates) => rates.check(),
        }
    }
}

impl fmt::Display for KnownTruth {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::GaussianField(_) => "Gaussian field",
            Self::OneBead(_) => "one bead",
            Self::TwoRates(_) => "two rates",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_depends_on_its_number_and_the_seed_alone() {
        for study in KnownTruth::standard() {
            let (clean, noisy) = study.draw(6, 3).unwrap();
            let (first_clean, first_noisy) = study.draw(2, 3).unwrap();
            assert_eq!(clean.slice(ndarray::s![..2, .., ..]), first_clean, "{study}");
            assert_eq!(noisy.slice(ndarray::s![..2, .., ..]), first_noisy, "{study}");
            assert_ne!(study.draw(2, 4).unwrap().0, first_clean, "{study}");
            assert_eq!(study.draw(0, 3).unwrap().0.dim(), (0, study.patch().0, study.patch().1));
        }
    }

    #[test]
    fn settings_outside_their_limits_get_one_sentence() {
        let field = |change: &dyn Fn(&mut GaussianField)| {
            let mut field = GaussianField::default();
            change(&mut field);
            KnownTruth::GaussianField(field)
        };
        let bead = |change: &dyn Fn(&mut OneBead)| {
            let mut bead = OneBead::default();
            change(&mut bead);
            KnownTruth::OneBead(bead)
        };
        let rates = |change: &dyn Fn(&mut TwoRates)| {
            let mut rates = TwoRates::default();
            change(&mut rates);
            KnownTruth::TwoRates(rates)
        };
        for (study, told) in [
            (field(&|field| field.side_px = 0), "the patch's side in pixels must be 1 to 90, found 0"),
            (field(&|field| field.side_px = 91), "found 91"),
            (field(&|field| field.read_sigma = 0.0), "the read noise in photons must be above 0"),
            (field(&|field| field.deviation = f64::NAN), "found NaN"),
            (field(&|field| field.correlation_px = -1.0), "the correlation length in pixels"),
            (field(&|field| field.mean = f64::INFINITY), "the mean in photons"),
            (bead(&|bead| bead.bias = 0.0), "the background in photons must be above 0"),
            (bead(&|bead| bead.peak = -3.0), "the bead's peak in photons"),
            (bead(&|bead| bead.sigma_px = 1e3), "the bead's width in pixels"),
            (rates(&|rates| rates.rates = [1.0, 1e9]), "both rates in photons must be 0 to 1000000"),
            (rates(&|rates| rates.probability = 1.5), "the probability of the second rate must be 0 to 1, found 1.5"),
        ] {
            let error = study.draw(1, 1).unwrap_err();
            assert_eq!(study.information(1).unwrap_err().to_string(), error.to_string());
            assert!(error.to_string().contains(told), "{error}");
        }
        let many = KnownTruth::TwoRates(TwoRates::default()).draw(usize::MAX, 1);
        assert!(matches!(many, Err(StudyError::Information(InformationError::TooManyPatches { .. }))));
    }
}
