//! The sensor: valid convolution with the point spread function, bias, noise, and random patches.

mod convolution;
mod error;
mod field;
pub mod noise;
mod patch_size;
mod patches;
mod poisson;

pub use convolution::{BlurWorkspace, Convolution, Convolver, ObjectSpectra};
pub use error::SensorError;
pub use field::field_offset;
pub use noise::Noise;
pub use patch_size::PatchSize;
pub use patches::Patches;
pub use poisson::{ln_factorial, sample_poisson};

/// Background in photons per pixel of every published measurement (Kabuli et al. 2026).
pub const DEFAULT_BIAS: f64 = 10.0;
