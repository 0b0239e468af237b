//! Optimizers: Adam, Muon, weight averaging and the learning-rate schedule.

pub(in crate::nn) mod adam;
pub(in crate::nn) mod learning_rate;
pub(in crate::nn) mod muon;
pub(in crate::nn) mod optimizer;
