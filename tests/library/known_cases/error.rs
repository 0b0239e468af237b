//! Errors of a study.

use thiserror::Error;

use lenslet_studio::information::InformationError;

/// Reason why a study could not be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum StudyError {
    /// A setting is outside the range of the study.
    #[error("{what} must be {expected}, found {found}; change it")]
    Setting {
        /// The setting, with its unit.
        what: &'static str,
        /// Its range.
        expected: &'static str,
        /// The value given.
        found: f64,
    },
    /// The estimate failed.
    #[error(transparent)]
    Information(#[from] InformationError),
}

/// Refuses a setting outside its limits. NaN is outside all limits.
pub fn check(
    what: &'static str,
    expected: &'static str,
    found: f64,
    limits: std::ops::RangeInclusive<f64>,
) -> Result<(), StudyError> {
    if limits.contains(&found) { Ok(()) } else { Err(StudyError::Setting { what, expected, found }) }
}
