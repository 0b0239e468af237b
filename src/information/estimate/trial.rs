//! One trial of an estimator: a number with its interval and the settings it belongs to.

use serde::{Deserialize, Serialize};

use crate::information::density::gaussian::analytic::GaussianBound;
use crate::information::engine_choice::EngineChoice;
use crate::information::entropy::noise_entropy::Protocol;
use crate::information::error::InformationError;
use crate::information::estimator::Estimator;
use crate::information::statistics::bootstrap::{bootstrap_interval, paired_interval};
use crate::information::statistics::shared_images::SharedImages;
use crate::plural::{counted, one_or_many};
use crate::sensor::Noise;

/// Settings of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrialSettings {
    /// The density model.
    pub estimator: Estimator,
    /// Protocol of the entropies.
    pub protocol: Protocol,
    /// Noise of the measurements.
    pub noise: Noise,
    /// Patch shape (rows, cols), pixels.
    pub patch: (usize, usize),
    /// Patches the model was fitted to; 0 for none.
    pub patches_train: usize,
    /// Seed of this trial.
    pub seed: u64,
}

/// The result of one trial; made by an estimator, combined with others into an [`super::Estimate`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    settings: TrialSettings,
    patches_test: usize,
    entropy_y: f64,
    entropy_y_given_x: f64,
    /// Information of each held-out patch, bits per pixel.
    information: Vec<f64>,
    interval_95: [f64; 2],
    seconds: f64,
    engine: Option<EngineChoice>,
    notes: Vec<String>,
    /// Note on requested weights that could not be written.
    #[serde(skip)]
    unwritten_weights: Option<String>,
}

/// Number of images below which a clustered interval is uncertain.
const FEW_IMAGES: usize = 20;

impl Trial {
    /// A trial from the held-out patches: `cross_entropy` and `entropy_y_given_x` hold bits per pixel for each. The
    /// interval is that of their differences ([`paired_interval`]), or under the paper's protocol that of each term
    /// by itself ([`bootstrap_interval`]).
    ///
    /// `seconds` is the computing time; `notes` are for the reader.
    ///
    /// # Errors
    /// When a list is empty, their lengths differ, or a value is not finite.
    pub fn from_patches(
        settings: TrialSettings,
        cross_entropy: &[f64],
        entropy_y_given_x: &[f64],
        seconds: f64,
        notes: Vec<String>,
    ) -> Result<Self, InformationError> {
        if cross_entropy.len() != entropy_y_given_x.len() {
            let (noisy, clean) = (cross_entropy.len(), entropy_y_given_x.len());
            return Err(InformationError::PatchCount { noisy, clean });
        }
        Self::new(settings, cross_entropy, entropy_y_given_x, seconds, notes)
    }

    /// The trial of a bound that needs no samples; `entropy_y_given_x` holds bits per pixel for each clean image and
    /// gives the interval.
    ///
    /// # Errors
    /// When there is no image, or a value is not finite.
    pub fn from_bound(
        settings: TrialSettings,
        bound: &GaussianBound,
        entropy_y_given_x: &[f64],
        seconds: f64,
        notes: Vec<String>,
    ) -> Result<Self, InformationError> {
        Self::new(settings, &[bound.entropy_y], entropy_y_given_x, seconds, notes)
    }

    fn new(
        settings: TrialSettings,
        entropy_y: &[f64],
        entropy_y_given_x: &[f64],
        seconds: f64,
        notes: Vec<String>,
    ) -> Result<Self, InformationError> {
        for (what, values) in [("log-densities", entropy_y), ("noise entropies", entropy_y_given_x)] {
            if let Some(patch) = values.iter().position(|value| !value.is_finite()) {
                return Err(InformationError::NotFinite { what, patch });
            }
        }
        // A bound without samples has one entropy for all patches.
        let information: Vec<f64> =
            entropy_y.iter().cycle().zip(entropy_y_given_x).map(|(y, noise)| y - noise).collect();
        let interval_95 = match settings.protocol {
            Protocol::Default => paired_interval(&information, settings.seed)?,
            Protocol::Paper => bootstrap_interval(entropy_y, entropy_y_given_x, settings.seed)?,
        };
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (patches_test, entropy_y, entropy_y_given_x) =
            (entropy_y_given_x.len(), mean(entropy_y), mean(entropy_y_given_x));
        let engine = None;
        Ok(Self {
            settings,
            patches_test,
            entropy_y,
            entropy_y_given_x,
            information,
            interval_95,
            seconds,
            engine,
            notes,
            unwritten_weights: None,
        })
    }

    /// The trial with a clustered interval, for images that several held-out patches show. The paper protocol keeps the
    /// interval of independent patches and gets a note.
    #[must_use]
    pub fn with_clustered_interval(mut self, images: &SharedImages) -> Self {
        let (found, patches) = (images.images(), self.patches_test);
        let published = self.settings.protocol == Protocol::Paper;
        if !published {
            self.interval_95 = images.inflate_interval(&self.information, self.bits_per_pixel(), self.interval_95);
        }
        if found < patches && (published || found < FEW_IMAGES) {
            let note = format!(
                "{} {} {} in all, so the interval may be too narrow",
                counted(patches, "test patch"),
                one_or_many(patches, "shows", "show"),
                counted(found, "image")
            );
            self.notes.push(note);
        }
        self
    }

    /// The trial with one more note for the reader.
    #[must_use]
    pub fn with_note(mut self, note: String) -> Self {
        self.notes.push(note);
        self
    }

    /// The trial with a note that its requested weights could not be written.
    #[must_use]
    pub fn with_unwritten_weights(self, error: impl std::fmt::Display) -> Self {
        let note = format!("the weights were not written: {error}");
        Self { unwritten_weights: Some(note.clone()), ..self }.with_note(note)
    }

    /// The note on requested weights that could not be written; none in a trial that was read from a file.
    pub fn unwritten_weights(&self) -> Option<&str> {
        self.unwritten_weights.as_deref()
    }

    /// The trial with its compute backend.
    #[must_use]
    pub fn on_engine(self, engine: EngineChoice) -> Self {
        Self { engine: Some(engine), ..self }
    }

    /// The estimate of this trial, bits per pixel.
    pub fn bits_per_pixel(&self) -> f64 {
        self.entropy_y - self.entropy_y_given_x
    }

    /// Its 95 % interval (low, high), bits per pixel. For its coverage see [`paired_interval`],
    /// [`bootstrap_interval`] and [`Trial::with_clustered_interval`].
    pub fn interval_95(&self) -> [f64; 2] {
        self.interval_95
    }

    /// Entropy of the measurement, or an upper bound on it, bits per pixel.
    pub fn entropy_y(&self) -> f64 {
        self.entropy_y
    }

    /// Entropy of the noise, bits per pixel.
    pub fn entropy_y_given_x(&self) -> f64 {
        self.entropy_y_given_x
    }

    /// Information of each held-out patch, bits per pixel, in the order of drawing.
    pub fn information(&self) -> &[f64] {
        &self.information
    }

    /// Settings of the trial.
    pub fn settings(&self) -> &TrialSettings {
        &self.settings
    }

    /// Held-out patches, or clean images of a bound without samples.
    pub fn patches_test(&self) -> usize {
        self.patches_test
    }

    /// Computing time, seconds.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Compute backend of the network; `None` without a network.
    pub fn engine(&self) -> Option<EngineChoice> {
        self.engine
    }

    /// Notes for the reader.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}
