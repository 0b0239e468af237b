//! What can be wrong with a study.

use thiserror::Error;

use lenslet_studio::information::InformationError;

/// Why a study could not be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum StudyError {
    /// A setting is outside what the study can do.
    #[error("{what} must be {expected}, found {found}; change it")]
    Setting {
        /// The setting, with its unit.
        what: &'static str,
        /// What it must be.
        expected: &'static str,
        /// The value given.
        found: f64,
    },
    /// The estimate.
    #[error(transparent)]
    Information(#[from] InformationError),
}

/// Refuses a setting that is not within its limits; what is not a number is within none.
pub fn check(
    what: &'static str,
    expected: &'static str,
    found: f64,
    limits: std::ops::RangeInclusive<f64>,
) -> Result<(), StudyError> {
    if limits.contains(&found) { Ok(()) } else { Err(StudyError::Setting { what, expected, found }) }
}
