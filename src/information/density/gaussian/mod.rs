//! Gaussian density models: stationary, full-covariance and analytic.

pub(in crate::information) mod analytic;
pub(in crate::information) mod block_toeplitz;
pub(in crate::information) mod dense;
pub(in crate::information) mod full;
pub(in crate::information) mod stationary;
