//! The live estimate: a causal model that is refitted after every edit, with its bounds and position gradients.

pub mod bounds;
pub mod estimate;
pub mod estimator;
pub mod inspection;
pub mod position_gradients;
pub mod problem;
pub mod published;
pub mod record;
pub mod schedule;
