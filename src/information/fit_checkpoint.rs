//! Checkpoints of fits: weights, optimizer state and counters as bytes.

use std::collections::HashMap;
use std::path::PathBuf;
use std::time::Duration;

use super::error::InformationError;
use crate::formats::{read_if_there, write_safely};
use crate::nn::{
    Initial, NetworkError, Optimizer, ParameterLayout, WeightsHeader, read_details, read_weights, write_weights,
};

/// Header of the checkpoint file.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/fit", version: 1 };

/// Storage for the checkpoint of one fit.
pub trait FitCheckpoint: Sync {
    /// Identity of the fit; a checkpoint of another fit is refused.
    fn key(&self) -> &str;

    /// Location of the checkpoint, for error messages.
    fn place(&self) -> String;

    /// Time between two checkpoints. A cancelled fit writes one more.
    fn every(&self) -> Duration {
        Duration::from_secs(20)
    }

    /// The last checkpoint; `None` where there is none.
    ///
    /// # Errors
    /// Where it cannot be read.
    fn load(&self) -> Result<Option<Vec<u8>>, InformationError>;

    /// Replaces the checkpoint.
    ///
    /// # Errors
    /// When it cannot be written; the previous checkpoint then remains.
    fn store(&self, state: &[u8]) -> Result<(), InformationError>;
}

/// A file with the checkpoint of one running fit.
pub(crate) struct FitFile {
    pub(crate) path: PathBuf,
    pub(crate) key: String,
}

impl FitCheckpoint for FitFile {
    fn key(&self) -> &str {
        &self.key
    }

    fn place(&self) -> String {
        self.path.display().to_string()
    }

    fn load(&self) -> Result<Option<Vec<u8>>, InformationError> {
        Ok(read_if_there(&self.path)?)
    }

    fn store(&self, state: &[u8]) -> Result<(), InformationError> {
        // A disk without room stops no fit: the earlier checkpoint stays, and the next one may find room.
        let _ = write_safely(&self.path, |out| out.write_all(state));
        Ok(())
    }
}

/// Arrays of a checkpoint: weights, optimizer state, and the best weights on validation patches.
pub(crate) struct FitArrays<'a> {
    pub weights: &'a [f32],
    pub optimizer: &'a Optimizer,
    pub best: Option<&'a [f32]>,
}

/// Named values in the header of a checkpoint.
pub(crate) struct FitDetails(HashMap<String, String>);

impl FitDetails {
    /// A number of this name.
    pub fn number<T: std::str::FromStr>(&self, name: &str) -> Result<T, InformationError> {
        let found = self.0.get(name).cloned().unwrap_or_default();
        found.parse().map_err(|_| NetworkError::Weights { expected: format!("a number of {name}"), found }.into())
    }

    /// The text of this name.
    pub fn text(&self, name: &str) -> &str {
        self.0.get(name).map_or("", String::as_str)
    }
}

/// Names of the counters: steps taken, and steps skipped because the loss was not finite.
const STEPS: &str = "steps";
const REFUSED: &str = "refused";

/// The bytes of a checkpoint after `steps`, of which `refused` were skipped.
pub(crate) fn fit_to_bytes(
    key: &str,
    numbers: &FitArrays<'_>,
    steps: usize,
    refused: usize,
    mut details: Vec<(&str, String)>,
) -> Result<Vec<u8>, InformationError> {
    let state = numbers.optimizer.state();
    let layout = layout(numbers.weights.len(), state.len(), numbers.best.is_some());
    let values = [numbers.weights, &state, numbers.best.unwrap_or_default()].concat();
    details.extend([("key", key.to_owned()), (STEPS, steps.to_string()), (REFUSED, refused.to_string())]);
    details.push(("has_best", numbers.best.is_some().to_string()));
    Ok(write_weights(&layout, &values, &HEADER, details)?)
}

/// Contents of a checkpoint besides weights and optimizer state.
pub(crate) struct RestoredFit {
    pub details: FitDetails,
    pub steps: usize,
    pub refused: usize,
    /// The best weights on validation patches.
    pub best: Option<Vec<f32>>,
}

/// Loads a checkpoint into weights and optimizer that were prepared for the same fit; `None` where there is none.
pub(crate) fn restore_fit(
    keeper: &dyn FitCheckpoint,
    weights: &mut [f32],
    optimizer: &mut Optimizer,
) -> Result<Option<RestoredFit>, InformationError> {
    let Some(bytes) = keeper.load()? else { return Ok(None) };
    restore(&bytes, keeper.key(), weights, optimizer).map(Some).map_err(|error| unread(keeper, &error))
}

/// Error for a checkpoint that cannot be read, with its location.
pub(crate) fn unread(keeper: &dyn FitCheckpoint, error: &dyn std::fmt::Display) -> InformationError {
    InformationError::WeightsFile { path: keeper.place(), reason: error.to_string() }
}

fn restore(
    bytes: &[u8],
    key: &str,
    weights: &mut [f32],
    optimizer: &mut Optimizer,
) -> Result<RestoredFit, InformationError> {
    let details = FitDetails(read_details(bytes, &HEADER)?);
    if details.text("key") != key {
        return Err(InformationError::OtherFit);
    }
    let (count, state, has_best) = (weights.len(), optimizer.state().len(), details.number("has_best")?);
    let values = read_weights(&layout(count, state, has_best), bytes)?;
    weights.copy_from_slice(&values[..count]);
    let (steps, refused): (usize, usize) = (details.number(STEPS)?, details.number(REFUSED)?);
    optimizer.restore(&values[count..count + state], steps.saturating_sub(refused));
    Ok(RestoredFit { details, steps, refused, best: has_best.then(|| values[count + state..].to_vec()) })
}

fn layout(weights: usize, state: usize, best: bool) -> ParameterLayout {
    let mut layout = ParameterLayout::default();
    layout.add("weights", &[weights], Initial::Zeros);
    layout.add("optimizer", &[state], Initial::Zeros);
    if best {
        layout.add("best", &[weights], Initial::Zeros);
    }
    layout
}

/// Checkpoint in memory, for tests.
#[cfg(test)]
#[derive(Default)]
pub(crate) struct InMemory {
    pub state: std::sync::Mutex<Option<Vec<u8>>>,
    pub every: Duration,
}

#[cfg(test)]
impl InMemory {
    /// One that only a cancelled fit writes.
    pub fn of_cancelled() -> Self {
        Self { every: Duration::from_hours(24), ..Self::default() }
    }
}

#[cfg(test)]
impl FitCheckpoint for InMemory {
    fn key(&self) -> &'static str {
        "this fit"
    }

    fn place(&self) -> String {
        "memory".into()
    }

    fn every(&self) -> Duration {
        self.every
    }

    fn load(&self) -> Result<Option<Vec<u8>>, InformationError> {
        Ok(self.state.lock().unwrap().clone())
    }

    fn store(&self, state: &[u8]) -> Result<(), InformationError> {
        *self.state.lock().unwrap() = Some(state.to_vec());
        Ok(())
    }
}
