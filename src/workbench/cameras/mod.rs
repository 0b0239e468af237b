//! Cameras: their calibration, previews of their captures, and the comparison of systems.

pub mod calibration;
pub mod comparison;
pub mod desk;
pub mod previews;
