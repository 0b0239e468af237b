//! How far the fit of a causal model has come, as it is kept.

use std::time::Duration;

use super::early_stopping::Found;
use super::model::CausalModel;
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitCheckpoint, FitNumbers, KeptFit, fit_to_bytes, restore_fit};
use crate::nn::Optimizer;

/// Everything about a fit but weights and optimizer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Course {
    /// Steps taken.
    pub steps: usize,
    /// Steps without finite numbers.
    pub refused: usize,
    /// Factor of the rate after such steps.
    pub caution: f64,
    /// Times that patches were drawn.
    pub draws: u64,
    /// Mean training value of late, bits per pixel.
    pub recent: Option<f64>,
    /// Time taken before this part of the fit.
    pub before: Duration,
}

impl Default for Course {
    fn default() -> Self {
        Self { steps: 0, refused: 0, caution: 1.0, draws: 0, recent: None, before: Duration::ZERO }
    }
}

/// Keeps the state after `elapsed` in all.
pub(super) fn keep(
    keeper: &dyn FitCheckpoint,
    (course, elapsed): (&Course, Duration),
    model: &CausalModel,
    optimizer: &Optimizer,
    best: Option<&Found>,
) -> Result<(), InformationError> {
    let mut details = vec![
        ("caution", course.caution.to_string()),
        ("draws", course.draws.to_string()),
        ("recent", course.recent.map_or_else(String::new, |bits| bits.to_string())),
        ("nanoseconds", elapsed.as_nanos().to_string()),
    ];
    if let Some(best) = best {
        details.extend([("best_bits", best.bits.to_string()), ("best_step", best.step.to_string())]);
    }
    let numbers = FitNumbers { weights: &model.weights, optimizer, best: best.map(|best| best.weights.as_slice()) };
    keeper.store(&fit_to_bytes(keeper.key(), &numbers, (course.steps, course.refused), details)?)
}

/// Puts what was kept into a model that was made ready for the same fit, and its optimizer; returns where it stands, and its
/// best weights on validation patches. Where nothing was kept the fit begins.
pub(super) fn restore(
    keeper: &dyn FitCheckpoint,
    model: &mut CausalModel,
    optimizer: &mut Optimizer,
) -> Result<(Course, Option<Found>), InformationError> {
    let Some(kept) = restore_fit(keeper, &mut model.weights, optimizer)? else {
        return Ok((Course::default(), None));
    };
    let KeptFit { details, steps, refused, best } = kept;
    let found = match best {
        Some(weights) => {
            Some(Found { bits: details.number("best_bits")?, step: details.number("best_step")?, weights })
        }
        None => None,
    };
    let course = Course {
        steps,
        refused,
        caution: details.number("caution")?,
        draws: details.number("draws")?,
        recent: details.text("recent").parse().ok(),
        before: Duration::from_nanos(details.number("nanoseconds")?),
    };
    Ok((course, found))
}
