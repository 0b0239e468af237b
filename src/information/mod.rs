//! Mutual information in bits per pixel: noise entropies, density models, decoders, bounds and the estimate.
//!
//! Sub-folders, lowest first; imports only go down: `statistics`, `entropy`, `density` (`gaussian`, `causal`, `pixelcnn`),
//! `decoder`, `ais`, `bounds`, `estimate`.

#![allow(clippy::needless_pass_by_value, reason = "array views are passed by value, as ndarray itself does")]

mod ais;
mod bounds;
mod decoder;
mod density;
mod engine_choice;
mod entropy;
mod error;
mod estimate;
mod estimator;
mod fit_checkpoint;
mod progress;
mod statistics;
mod stopwatch;
#[cfg(test)]
mod test_beads;

/// Version of the numbers: the program's version, and a counter of changes that give other numbers for the same
/// settings. All records hold it. Numbers of different versions do not belong in one table, and no fit resumes from
/// another version.
pub const NUMBERS_VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "+21");

pub use ais::bound::{AisBound, AisProgress, AisSettings, ais_lower_bound, ais_upper_bound};
pub use ais::posterior::{BeadPosterior, BeadScene, ObjectPosterior, OnSweeps, PosteriorChains};
pub use bounds::bracket::{BeadBounds, Bracket, NamedBound};
pub use bounds::method::BoundMethod;
pub use bounds::object_entropy::bead_upper_bound::{BeadEntropyBound, EntropyBound, binary_entropy};
pub use decoder::channel::BeadChannel;
pub use decoder::fit::{DecoderFit, DecoderProgress, DecoderRefit};
pub use decoder::immse_gradient::bead_response_gradient;
pub use decoder::information_gain::{SceneDraw, decoder_information, paired_gain};
pub use decoder::kind::DecoderKind;
pub use decoder::layers::Decoder;
pub use decoder::lower_bound::{LowerBound, decoder_lower_bound};
pub use decoder::pretrained::{DecoderPretrainProgress, DecoderPretrainStep, DecoderPretraining};
pub use decoder::pretrained_bound::{DecoderTest, PretrainedLowerBound};
pub use decoder::samples::SampleRange;
pub use density::causal::conditioning::Moments;
pub use density::causal::fit::{CausalFit, FitContext, FitLength, FitStep, Fitted};
pub use density::causal::init::{CausalStart, Init};
pub use density::causal::measurement_stream::{MeasurementStream, ObjectDraw};
pub use density::causal::model::{CausalModel, check_causal_patch};
pub use density::causal::pretrained::{PretrainProgress, PretrainStep, PretrainedWeights, TrainingScene};
pub use density::causal::refit::CausalRefit;
pub use density::causal::score::{
    PatchScores, cancellable_information_map, information_map, score, score_with_progress,
};
pub use density::causal::shape::CausalShape;
pub use density::causal::sliding_map::sliding_information_map;
pub use density::causal::stream::{PatchBatch, PatchStream};
pub use density::frozen::FrozenDensity;
pub use density::gaussian::analytic::{AnalyticGaussian, GaussianBound};
pub use density::gaussian::block_toeplitz::{log2_determinant, log2_determinants_by_row};
pub use density::gaussian::dense::MAX_PATCH_PIXELS;
pub use density::gaussian::full::FullGaussian;
pub use density::gaussian::stationary::StationaryGaussian;
pub(crate) use density::pixelcnn::burn_engine::{guarded, open_device};
pub use density::pixelcnn::engine::Engine;
pub use density::pixelcnn::gradient::FrozenPixelCnn;
pub use density::pixelcnn::model::{Mixtures, PixelCnn};
pub use density::pixelcnn::protocols::{FitReport, PixelCnnContext, PixelCnnFit, TrainingPatches};
pub use density::pixelcnn::scale::DataScale;
pub use density::pixelcnn::shape::PixelCnnShape;
pub use engine_choice::{BurnDevice, EngineChoice, UnknownEngine};
pub use entropy::likelihood::log_likelihood;
pub use entropy::noise_entropy::{NoiseEntropy, Protocol, gaussian_entropy};
pub use entropy::poisson::poisson_entropy;
pub use error::InformationError;
pub use estimate::analytic_moments::AnalyticMoments;
pub use estimate::causal::{CausalRequest, causal_estimate, causal_model};
pub use estimate::combined::{Estimate, Provenance};
pub use estimate::format::{between, interval_behind, rounded, with_decimals, with_interval};
pub use estimate::gaussian::{Covariance, GaussianRequest, gaussian_estimate};
pub use estimate::pixelcnn::{PixelCnnRequest, pixelcnn_estimate, pixelcnn_score};
pub use estimate::trial::{Trial, TrialSettings};
pub use estimator::Estimator;
pub use fit_checkpoint::FitCheckpoint;
#[cfg(test)]
pub(crate) use fit_checkpoint::InMemory;
pub(crate) use fit_checkpoint::{FitArrays, FitFile, fit_to_bytes, restore_fit, unread};
pub use progress::FitProgress;
pub use statistics::bootstrap::{bootstrap_interval, paired_interval};
pub(crate) use statistics::dequantisation::dequantised;
pub use statistics::paired_difference::{PairedDifference, TestPatches};
pub use statistics::power_spectrum::{PowerSpectrum, power_spectrum};
pub use statistics::shared_images::SharedImages;
