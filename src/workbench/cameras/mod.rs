//! Cameras: their calibration, previews of their captures, and the comparison of systems.

pub mod calibration;
pub mod comparison;
mod comparison_file;
pub mod desk;
pub mod previews;
