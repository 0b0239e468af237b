//! The live estimate: a causal model that is refitted after every edit, with its bounds and position gradients.

pub mod bounds;
pub mod estimator;
pub mod inspection;
pub mod position_gradients;
pub mod problem;
pub mod record;
