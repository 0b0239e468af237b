//! The state of a fit as bytes, so that it can go on after it was stopped.

use std::collections::HashMap;
use std::time::Duration;

use super::best::Found;
use super::model::CausalModel;
use crate::information::InformationError;
use crate::network::{
    Initial, NetworkError, Optimizer, ParameterLayout, WeightsHeader, read_details, read_weights, write_weights,
};

/// Whose state it is.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/fit", version: 1 };

/// Keeps the state of one fit.
pub trait FitKeeper: Sync {
    /// Says which fit it is; a state of another one is refused.
    fn key(&self) -> &str;

    /// Where it is kept, for people.
    fn place(&self) -> String;

    /// Time between two states; one is kept when patches are drawn next.
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

/// The bytes of a state after `elapsed` in all.
pub(super) fn to_bytes(
    key: &str,
    (course, elapsed): (&Course, Duration),
    model: &CausalModel,
    optimizer: &Optimizer,
    best: Option<&Found>,
) -> Result<Vec<u8>, InformationError> {
    let state = optimizer.state();
    let layout = layout(model.weights.len(), state.len(), best.is_some());
    let best_weights = best.map_or(&[] as &[f32], |best| &best.weights);
    let values = [model.weights.as_slice(), &state, best_weights].concat();
    let mut details = vec![
        ("key", key.to_owned()),
        ("steps", course.steps.to_string()),
        ("refused", course.refused.to_string()),
        ("caution", course.caution.to_string()),
        ("draws", course.draws.to_string()),
        ("recent", course.recent.map_or_else(String::new, |bits| bits.to_string())),
        ("nanoseconds", elapsed.as_nanos().to_string()),
    ];
    if let Some(best) = best {
        details.extend([("best_bits", best.bits.to_string()), ("best_step", best.step.to_string())]);
    }
    Ok(write_weights(&layout, &values, &HEADER, details)?)
}

/// Puts a state into a model that was made ready for the same fit, and its optimizer; returns where it stands, and its best
/// weights on validation patches.
pub(super) fn restore(
    bytes: &[u8],
    key: &str,
    model: &mut CausalModel,
    optimizer: &mut Optimizer,
) -> Result<(Course, Option<Found>), InformationError> {
    let details = read_details(bytes, &HEADER)?;
    if details.get("key").map(String::as_str) != Some(key) {
        return Err(InformationError::OtherFit);
    }
    let count = model.weights.len();
    let state = optimizer.state().len();
    let with_best = details.contains_key("best_step");
    let values = read_weights(&layout(count, state, with_best), bytes)?;
    model.weights.copy_from_slice(&values[..count]);
    let (steps, refused): (usize, usize) = (number(&details, "steps")?, number(&details, "refused")?);
    optimizer.restore(&values[count..count + state], steps.saturating_sub(refused));
    let recent = details.get("recent").and_then(|text| text.parse().ok());
    let found = if with_best {
        let (bits, step) = (number(&details, "best_bits")?, number(&details, "best_step")?);
        Some(Found { bits, step, weights: values[count + state..].to_vec() })
    } else {
        None
    };
    let course = Course {
        steps,
        refused,
        caution: number(&details, "caution")?,
        draws: number(&details, "draws")?,
        recent,
        before: Duration::from_nanos(number(&details, "nanoseconds")?),
    };
    Ok((course, found))
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

fn number<T: std::str::FromStr>(details: &HashMap<String, String>, name: &str) -> Result<T, InformationError> {
    let found = details.get(name).cloned().unwrap_or_default();
    found.parse().map_err(|_| NetworkError::Weights { expected: format!("a number of {name}"), found }.into())
}
