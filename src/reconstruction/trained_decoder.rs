//! Training of either network, and its result as a decoder.

use std::sync::Arc;

use super::decoder::{Decoder, DecoderKind};
use super::error::ReconstructionError;
use super::linear::Prior;
use super::network::{NetworkDecoder, NetworkTraining, TrainedNetwork, TrainingBudget, TrainingMasks, TrainingStep};
use super::protocol::DecoderScene;
use super::published_unet::{TrainedUnet, UnetDecoder, UnetTraining};
use super::training_record::TrainingRecord;
use crate::information::{EngineChoice, FitCheckpoint};
use crate::nn::NetworkError;
use crate::progress::{CancelToken, Progress};

/// Largest file of weights, bytes.
pub const LARGEST_WEIGHTS: u64 = 1 << 28;

/// Training of a decoder that needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoderTraining {
    /// The decoder.
    pub kind: DecoderKind,
    /// When training ends.
    pub budget: TrainingBudget,
    /// Seed of weights, objects and noise.
    pub seed: u64,
    /// What computes the steps of the published U-net; the network on top of the linear estimate has the processor.
    pub engine: EngineChoice,
}

/// A trained network of either kind.
#[derive(Clone, Debug)]
pub enum TrainedDecoder {
    /// On top of the linear estimate.
    Network(Arc<TrainedNetwork>),
    /// The published U-net.
    Unet(Arc<TrainedUnet>),
}

impl DecoderTraining {
    /// Trains a network, from the weights of `start` where there are any. `progress` receives each step. Training pauses
    /// until it returns. With a `keeper` a stopped training resumes where it was.
    ///
    /// # Errors
    /// [`ReconstructionError::OneMask`] for a U-net of any mask, [`ReconstructionError::Untrained`] for decoders without training; otherwise
    /// as [`NetworkTraining::train`] and [`UnetTraining::train`].
    pub fn train(
        self,
        scene: &DecoderScene,
        masks: &TrainingMasks,
        start: Option<&TrainedDecoder>,
        keeper: Option<&dyn FitCheckpoint>,
        cancel: &CancelToken,
        progress: &mut dyn Progress<TrainingStep>,
    ) -> Result<TrainedDecoder, ReconstructionError> {
        let Self { kind, budget, seed, engine } = self;
        match (kind, masks) {
            (DecoderKind::Network, _) => {
                let start = start.and_then(|start| match start {
                    TrainedDecoder::Network(network) => Some(&**network),
                    TrainedDecoder::Unet(_) => None,
                });
                let network = NetworkTraining { budget, seed }.train(scene, masks, start, keeper, cancel, progress)?;
                Ok(TrainedDecoder::Network(Arc::new(network)))
            }
            (DecoderKind::Unet, TrainingMasks::One(model)) => {
                let start = start.and_then(|start| match start {
                    TrainedDecoder::Unet(network) => Some(&**network),
                    TrainedDecoder::Network(_) => None,
                });
                let network =
                    UnetTraining { budget, seed, engine }.train(scene, model, start, keeper, cancel, progress)?;
                Ok(TrainedDecoder::Unet(Arc::new(network)))
            }
            (DecoderKind::Unet, TrainingMasks::Any { .. }) => Err(ReconstructionError::OneMask),
            _ => Err(ReconstructionError::Untrained { decoder: kind.name() }),
        }
    }
}

impl TrainedDecoder {
    /// The network of this kind of the bytes of a safetensors file.
    ///
    /// # Errors
    /// [`NetworkError`] for other files, for newer ones, and for incomplete ones.
    pub fn from_bytes(kind: DecoderKind, bytes: &[u8]) -> Result<Self, NetworkError> {
        Ok(match kind {
            DecoderKind::Unet => Self::Unet(Arc::new(TrainedUnet::from_bytes(bytes)?)),
            _ => Self::Network(Arc::new(TrainedNetwork::from_bytes(bytes)?)),
        })
    }

    /// The bytes of a safetensors file.
    ///
    /// # Errors
    /// [`NetworkError`] where the weights do not fit a file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, NetworkError> {
        match self {
            Self::Network(network) => network.to_bytes(),
            Self::Unet(network) => network.to_bytes(),
        }
    }

    /// What it was trained for, how long, and how good it became.
    pub fn training(&self) -> &TrainingRecord {
        match self {
            Self::Network(network) => &network.training,
            Self::Unet(network) => &network.training,
        }
    }

    /// One line on its training.
    pub fn summary(&self) -> String {
        match self {
            Self::Network(network) => network.summary(),
            Self::Unet(network) => network.training.summary(),
        }
    }

    /// PSNR of the linear estimate on the validation objects, dB, for a network on top of it.
    pub fn linear_psnr_db(&self) -> Option<f64> {
        match self {
            Self::Network(network) => Some(network.linear_psnr_db),
            Self::Unet(_) => None,
        }
    }

    /// Whether no weights were better than the linear estimate, which is therefore kept.
    pub fn is_linear(&self) -> bool {
        match self {
            Self::Network(network) => network.is_linear(),
            Self::Unet(_) => false,
        }
    }

    /// The network as a decoder of a scene. A network on top of the linear estimate needs the prior.
    ///
    /// # Errors
    /// [`ReconstructionError::NoPrior`], and [`ReconstructionError::OtherScene`] where it was trained for another one.
    pub fn decoder(
        &self,
        scene: &DecoderScene,
        prior: Option<&Arc<Prior>>,
    ) -> Result<Box<dyn Decoder>, ReconstructionError> {
        Ok(match self {
            Self::Network(network) => {
                let prior = prior.ok_or(ReconstructionError::NoPrior { decoder: DecoderKind::Network.name() })?;
                Box::new(NetworkDecoder::new(network.clone(), scene, prior.clone())?)
            }
            Self::Unet(network) => Box::new(UnetDecoder::new(network.clone(), scene)?),
        })
    }
}
