//! Reconstruction: what a decoder makes of a measurement, and how good that is.
//!
//! [`Decoder`] is what all methods are: prepared for one [`ImagingModel`], they turn measurements into objects. [`DecoderKind`] lists them.
//! [`Prior`] holds what a method knows about the objects. [`DecoderTest`] tests a decoder on held-out objects; [`ImageQuality`] compares
//! images. [`CaptureFiles`] opens real captures.

mod capture;
mod data_term;
mod decoder;
mod error;
mod fourier;
mod linear;
mod model;
mod network;
mod notices;
mod one_by_one;
mod posterior_mean;
mod protocol;
mod published_unet;
mod quality;
mod richardson_lucy;
mod saved_estimates;
mod standard;
mod total_variation;
mod trained_decoder;
mod training_checkpoint;
mod training_record;

pub use capture::{Capture, CaptureChannel, CaptureError, CaptureFiles, DarkLevel};
pub use data_term::residual_in_noise;
pub use decoder::{Decoder, DecoderKind, DecoderNeeds, ObjectEstimates, PreparedDecoder, ReconstructionStep};
pub use error::ReconstructionError;
pub use linear::{Light, LinearMmse, Prior};
pub use model::ImagingModel;
pub use network::{NetworkDecoder, NetworkTraining, TrainedNetwork, TrainingBudget, TrainingMasks, TrainingStep};
pub use posterior_mean::PosteriorMean;
pub use protocol::{DecoderQuality, DecoderScene, DecoderTest, Evaluated, TestObjects};
pub(crate) use protocol::{TestScores, in_units_of};
pub use published_unet::{TrainedUnet, UnetDecoder, UnetTraining};
pub use quality::{ImageQuality, psnr_db};
pub use richardson_lucy::RichardsonLucy;
pub use saved_estimates::SavingDecoder;
pub use total_variation::TotalVariation;
pub use trained_decoder::{DecoderTraining, LARGEST_WEIGHTS, TrainedDecoder};
pub use training_record::{NetworkMask, TrainingPoint, TrainingRecord};
