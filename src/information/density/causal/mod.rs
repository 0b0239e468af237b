//! Causal density model: each pixel is a mixture of the noise around a grid of intensities, with weights from the
//! pixels before it. It gives a tighter upper bound than PixelCNN in less time.

pub(in crate::information) mod checkpoint;
pub(in crate::information) mod conditioning;
pub(in crate::information) mod early_stopping;
pub(in crate::information) mod fit;
pub(in crate::information) mod gradient;
pub(in crate::information) mod head;
pub(in crate::information) mod init;
pub(in crate::information) mod level_interpolation;
pub(in crate::information) mod levels;
pub(in crate::information) mod masked_conv;
pub(in crate::information) mod measurement_stream;
pub(in crate::information) mod model;
pub(in crate::information) mod network;
pub(in crate::information) mod predictor;
pub(in crate::information) mod pretrained;
pub(in crate::information) mod refit;
pub(in crate::information) mod score;
pub(in crate::information) mod shape;
pub(in crate::information) mod sliding_map;
pub(in crate::information) mod stream;
pub(in crate::information) mod warm_start;
