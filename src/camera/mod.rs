//! Real sensors: photon transfer after EMVA 1288 from frame pairs, maps of their pixels, and colour planes of captures.
//!
//! [`FrameSeries`] finds the frames, [`calibrate`] reads them, [`CameraFile`] stores the result.

mod calibration;
mod channel;
mod curves;
mod descriptor;
mod error;
mod exposure;
mod file;
mod frames;
mod group_summary;
mod grouping;
mod line;
mod locate;
mod nonuniformity;
mod notes;
mod plot;
mod response;
mod series;
#[cfg(test)]
mod simulated;
mod summary;
#[cfg(test)]
mod tests;
mod transfer;

pub use calibration::{CalibratedCamera, CalibrationProgress, CameraCalibration, CameraMaps, PixelList, calibrate};
pub use channel::{BayerPattern, ChosenFrames, ColourChannel, ColourChoice};
pub use curves::{LinearityCurve, LinearityPoint};
pub use error::CameraError;
pub use file::{CameraFile, MapFiles};
pub(crate) use frames::hash_of;
pub use group_summary::GroupSummary;
pub use series::{FrameGroup, FrameSeries, Grouping};
pub use summary::Quantity;
pub use transfer::LightLevel;
