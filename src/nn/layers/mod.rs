//! Layers: activations, normalisation and dense layers, with their gradients.

pub(in crate::nn) mod activation;
pub(in crate::nn) mod dense;
pub(in crate::nn) mod rms_norm;
