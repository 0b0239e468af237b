//! Design by information: how the information of the measurements changes with the mask, and masks that climb it.

mod error;
mod gradient;
mod guide;
mod ideal;
mod merge;
mod movement;
mod schedule;
mod settings;
mod state;
mod unused;
mod watched;

pub use error::IdealError;
pub use gradient::{DesignGradient, GradientDraw, GradientScene, information_gradient};
pub use ideal::{Ideal, OnIdeal};
pub use merge::{least_separation_px, merged, merged_result};
pub use settings::{Free, IdealSettings, Objective, Preset, Rates};
pub use state::{Doing, Frame, IdealEvent, IdealProgress, IdealState, gain_in_words, time_left};
