//! Information in bits: entropies of the noise, Gaussian models, ceiling, intervals, the estimate.

#![allow(clippy::needless_pass_by_value, reason = "array views are passed by value, as ndarray itself does")]

mod analytic;
mod analytic_moments;
mod bits;
mod block_toeplitz;
mod bootstrap;
mod bracket;
mod causal;
mod ceiling;
mod conditional;
mod decoder;
mod dense;
mod error;
mod estimate;
mod fit_keeper;
mod fourier;
mod gaussian;
mod gaussian_estimate;
mod held_density;
mod interpolation;
mod likelihood;
mod measurement_stream;
mod paired_difference;
mod pixelcnn;
mod poisson;
mod poisson_gaussian;
mod power_spectrum;
mod progress;
mod reparameterised;
mod shared_pictures;
mod stationary;
mod stopwatch;
mod student;
#[cfg(test)]
mod test_beads;
mod trial;

/// Version of the numbers: that of the program, and how often the same settings have come to give other numbers. It stands in all
/// records; numbers of different versions do not belong into one table, nor does a fit go on from that of another.
pub const NUMBERS_VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "+21");

pub use analytic::{AnalyticGaussian, GaussianBound};
pub use analytic_moments::AnalyticMoments;
pub use bits::{between, interval_behind, rounded, with_decimals, with_interval};
pub use block_toeplitz::{log2_determinant, log2_determinants_by_row};
pub use bootstrap::{bootstrap_interval, paired_interval};
pub use bracket::{BeadBounds, Bracket, NamedBound};
pub use causal::{
    Beginning, CausalFit, CausalModel, CausalRefit, CausalRequest, CausalShape, CausalStart, FirstFitProgress,
    FirstScene, FirstWeights, FitLength, Moments, OnFirstFit, PatchBatch, PatchStream, causal_estimate, causal_model,
    check_causal_patch, information_map, information_map_unless, information_over, score, score_while,
};
pub use ceiling::{BeadCeiling, Ceiling, binary_entropy};
pub use conditional::{NoiseEntropy, Protocol, gaussian_entropy};
pub use decoder::{
    BeadChannel, Decoder, DecoderFit, DecoderKind, DecoderProgress, DecoderRefit, FirstProgress, LowerBound,
    OnFirstStep, OnPosterior, PosteriorBound, PosteriorFit, PosteriorProgress, QuickLowerBound, decoder_lower_bound,
    decoder_savings, posterior_lower_bound, posterior_upper_bound, savings_gain, spot_slope,
};
pub use dense::MAX_PATCH_PIXELS;
pub use error::InformationError;
pub use estimate::{Estimate, Provenance};
pub use fit_keeper::FitKeeper;
pub use gaussian::FullGaussian;
pub(crate) use gaussian_estimate::dequantised;
pub use gaussian_estimate::{Covariance, GaussianRequest, gaussian_estimate};
pub use held_density::HeldDensity;
pub use likelihood::log_likelihood;
pub use measurement_stream::MeasurementStream;
pub use paired_difference::{PairedDifference, TestPatches};
pub use pixelcnn::{
    BurnDevice, DataScale, Engine, EngineChoice, FitReport, HeldPixelCnn, Mixtures, PixelCnn, PixelCnnFit,
    PixelCnnRequest, PixelCnnShape, TrainingPatches, pixelcnn_estimate, pixelcnn_score,
};
pub use poisson::poisson_entropy;
pub use power_spectrum::{PowerSpectrum, power_spectrum};
pub use progress::{FitProgress, OnProgress};
pub use shared_pictures::SharedPictures;
pub use stationary::StationaryGaussian;
use stopwatch::Stopwatch;
pub use trial::{Estimator, Trial, TrialSettings};
