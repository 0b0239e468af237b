//! Checkpoint of an AIS bound.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitCheckpoint, unread};

/// Samples of a bound that are done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct AisCheckpoint {
    /// Identity of the bound.
    key: String,
    /// Temperatures of every chain.
    pub levels: usize,
    /// Log ratio of each sample, nats.
    pub nats: Vec<f64>,
    /// Computing time of all sessions.
    pub elapsed: Duration,
}

impl AisCheckpoint {
    /// Loads the checkpoint of a bound with at most `most` samples; `None` where there is none.
    pub fn restore(keeper: &dyn FitCheckpoint, most: usize) -> Result<Option<Self>, InformationError> {
        let Some(bytes) = keeper.load()? else { return Ok(None) };
        let followed: Self = serde_json::from_slice(&bytes).map_err(|error| unread(keeper, &error))?;
        if followed.key != keeper.key() {
            return Err(unread(keeper, &InformationError::OtherFit));
        }
        if followed.levels == 0 || followed.nats.len() > most {
            return Err(unread(keeper, &"levels or samples are not those of a bound"));
        }
        Ok(Some(followed))
    }

    /// Writes the checkpoint.
    pub fn keep(
        keeper: &dyn FitCheckpoint,
        levels: usize,
        nats: &[f64],
        elapsed: Duration,
    ) -> Result<(), InformationError> {
        let followed = Self { key: keeper.key().to_owned(), levels, nats: nats.to_vec(), elapsed };
        let bytes = serde_json::to_vec(&followed);
        keeper.store(&bytes.map_err(|error| InformationError::Format { reason: error.to_string() })?)
    }
}
