//! How far a posterior was followed, as it is kept.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::information::error::InformationError;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::information::fit_checkpoint::unread;

/// What was followed so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Followed {
    /// Says which bound it is of.
    key: String,
    /// Levels of every walk.
    pub levels: usize,
    /// Log ratio of each sample, nats.
    pub nats: Vec<f64>,
    /// Time taken, in all parts.
    pub elapsed: Duration,
}

impl Followed {
    /// What is kept of a bound of at most so many samples, if anything.
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

    /// Keeps what was followed over so many levels in the time.
    pub fn keep(
        keeper: &dyn FitCheckpoint,
        (levels, nats): (usize, &[f64]),
        elapsed: Duration,
    ) -> Result<(), InformationError> {
        let followed = Self { key: keeper.key().to_owned(), levels, nats: nats.to_vec(), elapsed };
        let bytes = serde_json::to_vec(&followed);
        keeper.store(&bytes.map_err(|error| InformationError::Format { reason: error.to_string() })?)
    }
}
