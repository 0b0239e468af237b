//! The forward model: a design, and the measurements of its objects by its mask and sensor.

mod design;
mod error;
mod model;
mod simulation;

pub use design::{Design, DesignError, DesignFileError};
pub use error::ForwardError;
pub use model::{ForwardModel, bead_response, mean_measurement};
pub use simulation::{Simulated, Simulator, forward_model, notices_of, open_set, open_set_with};
