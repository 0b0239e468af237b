//! The one forward model: a design, and how its objects, mask and sensor make measurements.

mod design;
mod error;
mod model;
mod simulation;

pub use design::{Design, DesignError, DesignFileError};
pub use error::ForwardError;
pub use model::{ForwardModel, bead_response, mean_measurement};
pub use simulation::{Simulated, Simulator, forward_model, notices_of, open_set, open_set_with};
