//! What can be wrong with a design by information.

use thiserror::Error;

use crate::information::InformationError;
use crate::objects::ObjectError;
use crate::optics::LensletError;
use crate::plural::counted;
use crate::sensor::SensorError;

/// Why a mask has no gradient, or a run no next step.
#[derive(Debug, Error)]
pub enum IdealError {
    /// The mask.
    #[error(transparent)]
    Lenslets(#[from] LensletError),
    /// The objects.
    #[error(transparent)]
    Objects(#[from] ObjectError),
    /// Objects, PSF and patches together.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The density model or the decoder.
    #[error(transparent)]
    Information(#[from] InformationError),
    /// A setting of the run.
    #[error("{name} is {found}; expected {expected}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        found: String,
        /// What it may be.
        expected: &'static str,
    },
    /// Steps were refused again and again.
    #[error(
        "the gradient of the mask had no finite numbers {}; start from another mask or at a lower rate",
        counted(*refused, "time")
    )]
    Diverged {
        /// How often.
        refused: usize,
    },
    /// A state that belongs to another run.
    #[error("this is not the state of this run: {reason}")]
    OtherRun {
        /// What differs.
        reason: String,
    },
}
