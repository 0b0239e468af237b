//! Training of a network for the open design, on a thread of its own.

pub mod computation;
pub mod queue;
pub mod trainer;
