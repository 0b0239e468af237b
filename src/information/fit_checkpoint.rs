//! The state of a fit as bytes, so that it can go on after it was stopped.

use std::collections::HashMap;
use std::time::Duration;

use super::error::InformationError;
use crate::nn::{
    Initial, NetworkError, Optimizer, ParameterLayout, WeightsHeader, read_details, read_weights, write_weights,
};

/// Whose state it is.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/fit", version: 1 };

/// Keeps the state of one fit.
pub trait FitCheckpoint: Sync {
    /// Says which fit it is; a state of another one is refused.
    fn key(&self) -> &str;

    /// Where it is kept, for people.
    fn place(&self) -> String;

    /// Time between two states.
    fn every(&self) -> Duration {
        Duration::from_secs(20)
    }

    /// The state that was kept last, if any.
    ///
    /// # Errors
    /// Where it cannot be read.
    fn load(&self) -> Result<Option<Vec<u8>>, InformationError>;

    /// Puts a newer state in place of the last one.
    ///
    /// # Errors
    /// Where it cannot be written; the last one is then still there.
    fn store(&self, state: &[u8]) -> Result<(), InformationError>;
}

/// The numbers of a state: weights, what moves them, and the best weights so far where such are kept.
pub(in crate::information) struct FitNumbers<'a> {
    pub weights: &'a [f32],
    pub optimizer: &'a Optimizer,
    pub best: Option<&'a [f32]>,
}

/// What the header of a state says.
pub(in crate::information) struct FitDetails(HashMap<String, String>);

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

/// Which steps were taken, and which of them were refused: an optimizer has made the others.
const STEPS: &str = "steps";
const REFUSED: &str = "refused";

/// The bytes of a state after so many `steps`, some of them `refused`.
pub(in crate::information) fn fit_to_bytes(
    key: &str,
    numbers: &FitNumbers<'_>,
    (steps, refused): (usize, usize),
    mut details: Vec<(&str, String)>,
) -> Result<Vec<u8>, InformationError> {
    let state = numbers.optimizer.state();
    let layout = layout(numbers.weights.len(), state.len(), numbers.best.is_some());
    let values = [numbers.weights, &state, numbers.best.unwrap_or_default()].concat();
    details.extend([("key", key.to_owned()), (STEPS, steps.to_string()), (REFUSED, refused.to_string())]);
    details.push(("has_best", numbers.best.is_some().to_string()));
    Ok(write_weights(&layout, &values, &HEADER, details)?)
}

/// What a state holds besides weights and optimizer.
pub(in crate::information) struct KeptFit {
    pub details: FitDetails,
    pub steps: usize,
    pub refused: usize,
    /// The best weights so far, where such are kept.
    pub best: Option<Vec<f32>>,
}

/// The kept state of a fit, put into weights and optimizer that were made ready for the same one; none where nothing is kept.
pub(in crate::information) fn restore_fit(
    keeper: &dyn FitCheckpoint,
    weights: &mut [f32],
    optimizer: &mut Optimizer,
) -> Result<Option<KeptFit>, InformationError> {
    let Some(bytes) = keeper.load()? else { return Ok(None) };
    restore(&bytes, keeper.key(), weights, optimizer).map(Some).map_err(|error| unread(keeper, &error))
}

/// Why what was kept cannot be read, and where it lies.
pub(in crate::information) fn unread(keeper: &dyn FitCheckpoint, error: &dyn std::fmt::Display) -> InformationError {
    InformationError::WeightsFile { path: keeper.place(), reason: error.to_string() }
}

fn restore(
    bytes: &[u8],
    key: &str,
    weights: &mut [f32],
    optimizer: &mut Optimizer,
) -> Result<KeptFit, InformationError> {
    let details = FitDetails(read_details(bytes, &HEADER)?);
    if details.text("key") != key {
        return Err(InformationError::OtherFit);
    }
    let (count, state, has_best) = (weights.len(), optimizer.state().len(), details.number("has_best")?);
    let values = read_weights(&layout(count, state, has_best), bytes)?;
    weights.copy_from_slice(&values[..count]);
    let (steps, refused): (usize, usize) = (details.number(STEPS)?, details.number(REFUSED)?);
    optimizer.restore(&values[count..count + state], steps.saturating_sub(refused));
    Ok(KeptFit { details, steps, refused, best: has_best.then(|| values[count + state..].to_vec()) })
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

/// Keeps a state in memory, whenever it may.
#[cfg(test)]
#[derive(Default)]
pub(in crate::information) struct InMemory(pub std::sync::Mutex<Option<Vec<u8>>>);

#[cfg(test)]
impl FitCheckpoint for InMemory {
    fn key(&self) -> &'static str {
        "this fit"
    }

    fn place(&self) -> String {
        "memory".into()
    }

    fn every(&self) -> Duration {
        Duration::ZERO
    }

    fn load(&self) -> Result<Option<Vec<u8>>, InformationError> {
        Ok(self.0.lock().unwrap().clone())
    }

    fn store(&self, state: &[u8]) -> Result<(), InformationError> {
        *self.0.lock().unwrap() = Some(state.to_vec());
        Ok(())
    }
}
