//! Files of records, of live estimates and of runs of IDEAL, that reproduce their numbers.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;
use thiserror::Error;

use crate::formats::{DocumentKind, FormatError, read_json};
use crate::workbench::live::record::{LIVE_ESTIMATE, LiveRecord};
use crate::workbench::runs::record::{IdealRecord, RUN};

/// Reasons why a record was not read.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file cannot be read or parsed.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The file is JSON, but not a record that this version knows.
    #[error(
        "{path}: expected a record of a live estimate or of a run, of version 1 or 2, found {found}; choose a file that \
         the Information panel has written, or the run.json of a run"
    )]
    Refused {
        /// The file.
        path: String,
        /// Description of what the file holds.
        found: String,
    },
}

/// A record of either kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// Record of a live estimate.
    Live(Box<LiveRecord>),
    /// Record of a run.
    Run(Box<IdealRecord>),
}

impl Record {
    /// Reads a record.
    ///
    /// # Errors
    /// [`RecordError`] for files that are no record, for a newer version, and for records that this program did not write.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        let value: Value = read_json(path)?;
        let record = if value.get("format").and_then(Value::as_str) == Some(LIVE_ESTIMATE.format) {
            fields(LIVE_ESTIMATE, value).and_then(LiveRecord::checked).map(|record| Self::Live(Box::new(record)))
        } else {
            fields(RUN, value).and_then(IdealRecord::checked).map(|record| Self::Run(Box::new(record)))
        };
        record.map_err(|found| RecordError::Refused { path: path.display().to_string(), found })
    }
}

/// The fields of a record of a known version, or a description of what was found.
fn fields<T: DeserializeOwned>(kind: DocumentKind, value: Value) -> Result<T, String> {
    kind.version_of(&value).map_err(|mismatch| mismatch.to_string())?;
    serde_json::from_value(value).map_err(|error| error.to_string())
}
