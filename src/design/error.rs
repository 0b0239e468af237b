//! Errors of the optimizer.

use thiserror::Error;

use crate::information::InformationError;
use crate::objects::ObjectError;
use crate::optics::LensletError;
use crate::plural::counted;
use crate::sensor::SensorError;

/// Error of a gradient or of an optimizer run.
#[derive(Debug, Error)]
pub enum IdealError {
    /// Error of the mask.
    #[error(transparent)]
    Lenslets(#[from] LensletError),
    /// Error of the objects.
    #[error(transparent)]
    Objects(#[from] ObjectError),
    /// Objects, PSF and patches together.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// Error of the density model or the decoder.
    #[error(transparent)]
    Information(#[from] InformationError),
    /// A setting is out of range.
    #[error("{name} is {found}; expected {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Its value.
        found: String,
        /// Allowed values.
        expected: &'static str,
    },
    /// Too many steps were refused.
    #[error(
        "the gradient of the mask was not finite {}; start from another mask or with lower rates",
        counted(*refused, "time")
    )]
    Diverged {
        /// Number of refused steps.
        refused: usize,
    },
    /// A saved state belongs to another run.
    #[error("this is not the state of this run: {reason}")]
    OtherRun {
        /// Difference.
        reason: String,
    },
}
