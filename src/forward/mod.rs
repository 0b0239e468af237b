//! The forward model: a design, and the measurements of its objects by its mask and sensor.

mod design;
mod design_objects;
mod error;
mod mask_source;
mod model;

pub use design::{Design, DesignError, DesignFileError};
pub(crate) use design::{is_published_field, is_usual_placement, published_field};
pub use design_objects::{notices_of, open_set, open_set_with};
pub use error::ForwardError;
pub use mask_source::{MaskError, MaskSource, OpenedMask, on_grid};
pub use model::{ForwardModel, Simulated, bead_response, mean_measurement};
