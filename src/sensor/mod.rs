//! The sensor: valid convolution with the point spread function, bias, noise, and random patches.

pub mod noise;

pub use noise::Noise;
