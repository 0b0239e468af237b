//! What can be wrong with a gradient.

use thiserror::Error;

use crate::information::InformationError;
use crate::optics::LensletError;
use crate::sensor::SensorError;

/// Why a mask has no gradient.
#[derive(Debug, Error)]
pub enum DesignGradientError {
    /// The mask.
    #[error(transparent)]
    Lenslets(#[from] LensletError),
    /// Objects, PSF and patches together.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The density model.
    #[error(transparent)]
    Information(#[from] InformationError),
}
