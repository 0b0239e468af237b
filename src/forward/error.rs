//! Errors of the forward model.

use thiserror::Error;

use crate::forward::DesignError;
use crate::objects::ObjectError;
use crate::sensor::SensorError;

/// Reason why a design has no measurements.
#[derive(Debug, Error)]
pub enum ForwardError {
    /// The design itself.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// The objects.
    #[error(transparent)]
    Objects(#[from] ObjectError),
    /// Objects and PSF together.
    #[error(transparent)]
    Sensor(#[from] SensorError),
}
