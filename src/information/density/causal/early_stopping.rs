//! The weights that scored best on validation patches while a model was fitted: of few patches a fit learns by heart.

use super::model::CausalModel;
use super::stream::PatchBatch;
use crate::information::error::InformationError;

/// Looks during a fit, evenly spread.
const LOOKS: f64 = 20.0;

/// The weights of the best look.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Found {
    /// Cross-entropy of the validation patches, bits per pixel.
    pub bits: f64,
    /// Steps they had taken.
    pub step: usize,
    /// In the order of the model's layout.
    pub weights: Vec<f32>,
}

/// What is looked at, and what was found.
pub(super) struct Best<'a> {
    patches: Option<&'a PatchBatch>,
    looks: f64,
    pub found: Option<Found>,
    /// Whether the last look found worse ones.
    is_behind: bool,
}

impl<'a> Best<'a> {
    /// For a fit of which the share `done` is over, and what was found until then.
    pub fn new(patches: Option<&'a PatchBatch>, done: f64, found: Option<Found>) -> Self {
        Self { patches, looks: (LOOKS * done).floor(), found, is_behind: false }
    }

    /// Scores the model that `snapshot` makes where it is time for it.
    pub fn look(&mut self, done: f64, step: usize, snapshot: &dyn Fn() -> CausalModel) -> Result<(), InformationError> {
        let Some(patches) = self.patches else { return Ok(()) };
        let looks = (LOOKS * done).floor();
        if looks <= self.looks {
            return Ok(());
        }
        self.looks = looks;
        let model = snapshot();
        let bits = validation_bits(&model, patches)?;
        let is_best = bits.is_finite() && self.found.as_ref().is_none_or(|found| bits < found.bits);
        if is_best {
            self.found = Some(Found { bits, step, weights: model.weights });
        }
        self.is_behind = !is_best;
        Ok(())
    }

    /// The best weights where the last look found worse ones, or those at hand: for a fit that is seen, or ends, between two looks.
    pub fn or(&self, at_hand: impl FnOnce() -> Vec<f32>) -> Vec<f32> {
        match &self.found {
            Some(found) if self.is_behind => found.weights.clone(),
            _ => at_hand(),
        }
    }

    /// Puts the best weights in place of those at the end, where they score better; returns their step.
    pub fn put_into(self, model: &mut CausalModel) -> Result<Option<usize>, InformationError> {
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
