//! Settings of the reconstruction that the cells of a plan have beside their estimates.

use serde::{Deserialize, Serialize};

use super::estimates::check_ranges;
use crate::information::Protocol;
use crate::objects::ObjectSource;
use crate::reconstruction::{DecoderKind, TrainingBudget};
use crate::studies::error::StudyError;
use crate::studies::image_quality::QualityRequest;

/// Time of training, seconds, where none is given.
const TRAINING_SECONDS: f64 = 60.0;

/// A decoder whose image quality every cell reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ReconstructionSettings {
    /// The decoder of plans without an axis of decoders.
    #[serde(default)]
    pub decoder: DecoderKind,
    /// Held-out objects.
    #[serde(default = "usual_objects")]
    pub test_objects: usize,
    /// Time for the training of a network, seconds [default: 60].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training_seconds: Option<f64>,
    /// Steps of the training in place of a time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training_steps: Option<usize>,
    /// Sweeps of the Markov chains that refine the posterior mean; without them, the trained decoder alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweeps: Option<usize>,
}

fn usual_objects() -> usize {
    500
}

impl ReconstructionSettings {
    /// A decoder with the usual test and training.
    pub fn of(decoder: DecoderKind) -> Self {
        let test_objects = usual_objects();
        Self { decoder, test_objects, training_seconds: None, training_steps: None, sweeps: None }.complete()
    }

    /// The settings of a cell: with the usual time of training, and without those that its decoder does not have.
    pub(super) fn complete(self) -> Self {
        let is_trained = self.decoder.needs().training;
        let usual = if self.training_steps.is_some() { None } else { Some(TRAINING_SECONDS) };
        Self {
            training_seconds: self.training_seconds.or(usual).filter(|_| is_trained),
            training_steps: self.training_steps.filter(|_| is_trained),
            sweeps: self.sweeps.filter(|_| self.decoder == DecoderKind::Posterior),
            ..self
        }
    }

    /// The settings with at most `seconds` of training.
    pub(super) fn within(self, seconds: f64) -> Self {
        let is_timed = self.decoder.needs().training && self.training_steps.is_none();
        let own = is_timed.then(|| self.training_seconds.unwrap_or(TRAINING_SECONDS).min(seconds));
        Self { training_seconds: own.or(self.training_seconds), ..self }
    }

    pub(super) fn request(&self, protocol: Protocol, seed: u64) -> QualityRequest {
        let seconds = TrainingBudget::Seconds(self.training_seconds.unwrap_or(TRAINING_SECONDS));
        QualityRequest {
            kind: self.decoder,
            protocol,
            training: self.training_steps.map_or(seconds, TrainingBudget::Steps),
            sweeps: self.sweeps,
            test_objects: self.test_objects,
            seed,
        }
    }

    /// Whether the decoder can reconstruct these objects.
    pub(super) fn fits(&self, objects: &ObjectSource) -> bool {
        self.decoder != DecoderKind::Posterior || objects.is_beads()
    }

    /// Refuses settings that cannot be computed for these objects.
    pub(super) fn check(&self, objects: &ObjectSource) -> Result<(), StudyError> {
        let refused = |what: &str, expected: &str, found: String| {
            Err(StudyError::Plan { what: what.into(), expected: expected.into(), found })
        };
        if let (Some(seconds), Some(steps)) = (self.training_seconds, self.training_steps) {
            return refused("reconstruction", "seconds or steps", format!("{seconds} s and {steps} steps"));
        }
        if let Some(seconds) = self.training_seconds.filter(|seconds| !(0.001..=604_800.0).contains(seconds)) {
            return refused("training_seconds", "0.001 s to one week", format!("{seconds} s"));
        }
        check_ranges([
            ("training_steps", self.training_steps.unwrap_or(1), 1..=10_000_000),
            ("test_objects", self.test_objects, 2..=1_000_000),
            ("sweeps", self.sweeps.unwrap_or(1), 1..=1_000_000),
        ])?;
        if !self.fits(objects) {
            return refused("decoder posterior", "beads", objects.to_string());
        }
        Ok(())
    }
}
