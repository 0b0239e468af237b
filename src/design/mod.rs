//! Mask optimization by information (IDEAL, Kabuli et al. 2026): gradient of the information by the mask, and the optimizer.

mod adam;
mod config;
mod error;
mod gradient;
mod merge;
mod objective_model;
mod observer;
mod optimizer;
mod projection;
mod settings;
mod settings_identity;
mod state;

pub use config::SettingsFile;
pub use error::IdealError;
pub use gradient::{DesignGradient, GradientDraw, GradientScene, information_gradient};
pub use merge::{least_separation_px, merged, merged_result};
pub use optimizer::IdealOptimizer;
pub use settings::{Free, IdealSettings, Objective, Preset, Rates};
pub use state::{Checkpoint, IdealEvent, IdealProgress, IdealState, Phase, gain_summary, time_left};
