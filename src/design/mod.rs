//! Design by information: how the information of the measurements changes with the mask, and masks that climb it.

mod error;
mod gradient;
mod imaging;

pub use error::IdealError;
pub use gradient::{DesignGradient, GradientDraw, GradientScene, information_gradient};
pub use imaging::{Imaging, KnownMoments, MeasurementStream, derived_seed, mean_measurement};
