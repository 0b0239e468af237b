//! Records of numbers that can be computed again, in files: of live estimates and of runs of IDEAL.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;
use thiserror::Error;

use super::ideal::IdealRecord;
use super::live_record::LiveRecord;
use crate::formats::{FormatError, read_json};

/// What the files say of themselves.
pub(super) const LIVE_FORMAT: &str = "lenslet-studio/live-estimate";
pub(super) const RUN_FORMAT: &str = "lenslet-studio/ideal";
/// Version of the fields of both.
pub(super) const FORMAT_VERSION: u64 = 1;

/// Why a record was not read.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file cannot be read or parsed.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The file is JSON, but not a record that this version knows.
    #[error(
        "{path}: expected a record of a live estimate or of a run, of version {FORMAT_VERSION}, found {found}; choose a file that \
         the Information room has written, or the run.json of a run"
    )]
    Refused {
        /// The file.
        path: String,
        /// What it holds.
        found: String,
    },
}

/// A record of either kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// Of a live estimate.
    Live(Box<LiveRecord>),
    /// Of a run.
    Run(Box<IdealRecord>),
}

impl Record {
    /// Reads one.
    ///
    /// # Errors
    /// [`RecordError`] for files that are no such record, one of a newer version, or one that this program has not written.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        let value: Value = read_json(path)?;
        let format = value.get("format").and_then(Value::as_str);
        let record = match format {
            Some(LIVE_FORMAT) => fields(value).and_then(LiveRecord::checked).map(|record| Self::Live(Box::new(record))),
            Some(RUN_FORMAT) => fields(value).and_then(IdealRecord::checked).map(|record| Self::Run(Box::new(record))),
            _ => Err(format!("{} as its format", entry(&value, "format"))),
        };
        record.map_err(|found| RecordError::Refused { path: path.display().to_string(), found })
    }
}

/// The fields of a record of the version that is known here, or what was found in their place.
fn fields<T: DeserializeOwned>(value: Value) -> Result<T, String> {
    if value.get("format_version").and_then(Value::as_u64) != Some(FORMAT_VERSION) {
        return Err(format!("format version {}", entry(&value, "format_version")));
    }
    serde_json::from_value(value).map_err(|error| error.to_string())
}

fn entry(value: &Value, name: &str) -> String {
    value.get(name).map_or_else(|| "nothing".to_owned(), ToString::to_string)
}
