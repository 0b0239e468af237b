//! Design by information: how the information of the measurements changes with the mask, and masks that climb it.

mod error;
mod gradient;
mod ideal;
mod imaging;
mod merge;
mod movement;
mod settings;

pub use error::IdealError;
pub use gradient::{DesignGradient, GradientDraw, GradientScene, information_gradient};
pub use ideal::{Frame, Ideal, IdealEvent, IdealProgress, IdealState, OnIdeal, time_left};
pub use imaging::{Imaging, KnownMoments, MeasurementStream, derived_seed, mean_measurement};
pub use merge::merged;
pub use settings::{Free, IdealSettings, Preset, Rates};
