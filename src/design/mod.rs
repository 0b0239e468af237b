//! Design by information: how the information of the measurements changes with the mask.

mod error;
mod gradient;

pub use error::DesignGradientError;
pub use gradient::{DesignGradient, GradientScene, information_gradient};
