//! Reconstruction of a capture of a camera, with the object so far while it is computed.

pub mod capturer;
pub mod computation;
pub mod queue;
