//! Checkpoint of the fit of a causal model.

use std::time::Duration;

use super::early_stopping::BestWeights;
use super::model::CausalModel;
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitArrays, FitCheckpoint, RestoredFit, fit_to_bytes, restore_fit};
use crate::nn::Optimizer;

/// State of a fit besides weights and optimizer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FitState {
    /// Steps taken.
    pub steps: usize,
    /// Steps skipped because the loss was not finite.
    pub refused: usize,
    /// Factor of the learning rate after such steps.
    pub step_scale: f64,
    /// Number of draws of patches.
    pub draws: u64,
    /// Running mean of the training loss, bits per pixel.
    pub recent: Option<f64>,
    /// Computing time of earlier sessions.
    pub before: Duration,
}

impl Default for FitState {
    fn default() -> Self {
        Self { steps: 0, refused: 0, step_scale: 1.0, draws: 0, recent: None, before: Duration::ZERO }
    }
}

/// The bytes of the checkpoint after `elapsed` in all.
pub(super) fn state_to_bytes(
    key: &str,
    course: &FitState,
    elapsed: Duration,
    model: &CausalModel,
    optimizer: &Optimizer,
    best: Option<&BestWeights>,
) -> Result<Vec<u8>, InformationError> {
    let mut details = vec![
        ("caution", course.step_scale.to_string()),
        ("draws", course.draws.to_string()),
        ("recent", course.recent.map_or_else(String::new, |bits| bits.to_string())),
        ("nanoseconds", elapsed.as_nanos().to_string()),
    ];
    if let Some(best) = best {
        details.extend([("best_bits", best.bits.to_string()), ("best_step", best.step.to_string())]);
    }
    let numbers = FitArrays { weights: &model.weights, optimizer, best: best.map(|best| best.weights.as_slice()) };
    fit_to_bytes(key, &numbers, course.steps, course.refused, details)
}

/// Restores a model and its optimizer, prepared for the same fit. Returns the state of the fit and the best weights on
/// validation patches; the initial state where there is no checkpoint.
pub(super) fn restore(
    keeper: &dyn FitCheckpoint,
    model: &mut CausalModel,
    optimizer: &mut Optimizer,
) -> Result<(FitState, Option<BestWeights>), InformationError> {
    let Some(kept) = restore_fit(keeper, &mut model.weights, optimizer)? else {
        return Ok((FitState::default(), None));
    };
    let RestoredFit { details, steps, refused, best } = kept;
    let found = match best {
        Some(weights) => {
            Some(BestWeights { bits: details.number("best_bits")?, step: details.number("best_step")?, weights })
        }
        None => None,
    };
    let course = FitState {
        steps,
        refused,
        step_scale: details.number("caution")?,
        draws: details.number("draws")?,
        recent: details.text("recent").parse().ok(),
        before: Duration::from_nanos(details.number("nanoseconds")?),
    };
    Ok((course, found))
}
