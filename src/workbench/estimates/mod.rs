//! Estimates that take minutes: the queue, the thread that computes them, and their files.

pub mod computation;
pub mod estimator;
pub mod files;
pub mod queue;
