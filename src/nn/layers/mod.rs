//! Layers: activations, normalisation, convolutions and dense layers, with their gradients.

pub(in crate::nn) mod activation;
pub(in crate::nn) mod batch_norm;
pub(in crate::nn) mod convolution;
pub(in crate::nn) mod dense;
pub(in crate::nn) mod pixel_shuffle;
pub(in crate::nn) mod pooling;
pub(in crate::nn) mod rms_norm;
pub(in crate::nn) mod upsampling;
