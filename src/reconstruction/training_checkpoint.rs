//! Checkpoints of a training: weights, optimizer, the best weights and counters, from which it resumes bit for bit.

use std::time::Instant;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::ReconstructionError;
use crate::formats::json_of;
use crate::information::{FitArrays, FitCheckpoint, InformationError, fit_to_bytes, restore_fit, unread};
use crate::nn::Optimizer;

/// Entry of the header with the counters.
const ENTRY: &str = "training";

/// Writes and restores the checkpoint of one training, where it has a place.
pub(super) struct TrainingCheckpoint<'a> {
    keeper: Option<&'a dyn FitCheckpoint>,
    /// Time of the last checkpoint.
    kept: Instant,
}

/// A restored checkpoint beside weights and optimizer.
pub(super) struct Restored<T> {
    pub(super) steps: usize,
    pub(super) best: Vec<f32>,
    pub(super) counters: T,
}

/// What a checkpoint holds.
pub(super) struct TrainingArrays<'a> {
    pub(super) weights: &'a [f32],
    pub(super) optimizer: &'a Optimizer,
    pub(super) best: &'a [f32],
}

impl<'a> TrainingCheckpoint<'a> {
    pub(super) fn new(keeper: Option<&'a dyn FitCheckpoint>) -> Self {
        Self { keeper, kept: Instant::now() }
    }

    /// Loads the checkpoint into weights and optimizer of the same training; `None` where there is none.
    pub(super) fn restore<T: DeserializeOwned>(
        &self,
        weights: &mut [f32],
        optimizer: &mut Optimizer,
    ) -> Result<Option<Restored<T>>, ReconstructionError> {
        let Some(keeper) = self.keeper else { return Ok(None) };
        let Some(restored) = restore_fit(keeper, weights, optimizer)? else { return Ok(None) };
        let counters = serde_json::from_str(restored.details.text(ENTRY)).map_err(|error| unread(keeper, &error))?;
        let best = restored.best.ok_or_else(|| unread(keeper, &"no best weights"))?;
        Ok(Some(Restored { steps: restored.steps, best, counters }))
    }

    /// Whether the last checkpoint is old.
    pub(super) fn is_due(&self) -> bool {
        self.keeper.is_some_and(|keeper| self.kept.elapsed() >= keeper.every())
    }

    /// Writes the checkpoint after a number of steps.
    pub(super) fn keep<T: Serialize>(
        &mut self,
        TrainingArrays { weights, optimizer, best }: TrainingArrays<'_>,
        steps: usize,
        counters: &T,
    ) -> Result<(), InformationError> {
        let Some(keeper) = self.keeper else { return Ok(()) };
        let arrays = FitArrays { weights, optimizer, best: Some(best) };
        // The optimizer counts from its start, which is later than that of the training where that began again.
        let refused = steps.saturating_sub(optimizer.steps());
        let details = vec![(ENTRY, json_of(counters).to_string())];
        keeper.store(&fit_to_bytes(keeper.key(), &arrays, steps, refused, details)?)?;
        self.kept = Instant::now();
        Ok(())
    }
}
