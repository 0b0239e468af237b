//! Linear MMSE estimate: the affine function of the measurement with the least expected squared error.
//!
//! With mean `m` and covariance `C` of the objects, the encoder `A` and the noise variance `D` of the mean measurement, the estimate is
//! `m + C A^T (A C A^T + D)^-1 (y - A m - b)`. It needs the first two moments of the objects and nothing else, so its error is known in
//! closed form. `D` is that of the mean measurement: exact for shot noise, whose variance is the mean.
//!
//! A [`Prior`] holds the moments. [`LinearMmse`] prepares it for a mask: by one Cholesky factor where mosaics have few tiles, by
//! conjugate gradients with Fourier transforms otherwise.

mod beads;
mod cholesky;
mod conjugate_gradients;
mod estimate;
mod light;
mod mean_measurement;
mod principal_components;
mod prior;
mod stationary;
#[cfg(test)]
mod tests;
mod tiles;

pub use estimate::LinearMmse;
pub use light::{Light, mean_object};
pub use prior::Prior;
