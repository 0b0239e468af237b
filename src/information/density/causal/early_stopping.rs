//! Early stopping: the weights that score best on validation patches during a fit, against overfitting to few patches.

use super::model::CausalModel;
use super::stream::PatchBatch;
use crate::information::error::InformationError;

/// Validations during a fit, evenly spaced.
const VALIDATIONS: f64 = 20.0;

/// The best weights so far.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BestWeights {
    /// Cross-entropy of the validation patches, bits per pixel.
    pub bits: f64,
    /// Step of these weights.
    pub step: usize,
    /// In the order of the model's layout.
    pub weights: Vec<f32>,
}

/// Validation patches and the best weights on them.
pub(super) struct EarlyStopping<'a> {
    patches: Option<&'a PatchBatch>,
    validations: f64,
    pub found: Option<BestWeights>,
    /// Whether the last validation found worse weights.
    is_behind: bool,
}

impl<'a> EarlyStopping<'a> {
    /// For a fit that is `done` (share, 0 to 1), with the best weights of earlier sessions.
    pub fn new(patches: Option<&'a PatchBatch>, done: f64, found: Option<BestWeights>) -> Self {
        Self { patches, validations: (VALIDATIONS * done).floor(), found, is_behind: false }
    }

    /// Validates the model of `snapshot` where a validation is due.
    pub fn validate(
        &mut self,
        done: f64,
        step: usize,
        snapshot: &dyn Fn() -> CausalModel,
    ) -> Result<(), InformationError> {
        let Some(patches) = self.patches else { return Ok(()) };
        let validations = (VALIDATIONS * done).floor();
        if validations <= self.validations {
            return Ok(());
        }
        self.validations = validations;
        let model = snapshot();
        let bits = validation_bits(&model, patches)?;
        let is_best = bits.is_finite() && self.found.as_ref().is_none_or(|found| bits < found.bits);
        if is_best {
            self.found = Some(BestWeights { bits, step, weights: model.weights });
        }
        self.is_behind = !is_best;
        Ok(())
    }

    /// The best weights where the last validation found worse ones, otherwise the current weights.
    pub fn or(&self, current: impl FnOnce() -> Vec<f32>) -> Vec<f32> {
        match &self.found {
            Some(found) if self.is_behind => found.weights.clone(),
            _ => current(),
        }
    }

    /// Replaces the final weights by the best ones where these score better; returns their step.
    pub fn install_best(self, model: &mut CausalModel) -> Result<Option<usize>, InformationError> {
        let (Some(patches), Some(found)) = (self.patches, self.found) else { return Ok(None) };
        if found.bits < validation_bits(model, patches)? {
            model.weights = found.weights;
            return Ok(Some(found.step));
        }
        Ok(None)
    }
}

fn validation_bits(model: &CausalModel, patches: &PatchBatch) -> Result<f64, InformationError> {
    Ok(model.cross_entropy_map(patches.noisy.view())?.mean().unwrap_or(f64::INFINITY))
}
