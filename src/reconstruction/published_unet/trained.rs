//! A trained U-net and its file.

use super::layers::Layers;
use crate::nn::{NetworkError, WeightsHeader, read_weights};
use crate::reconstruction::training_record::{TrainingRecord, details_of, to_bytes};

const HEADER: WeightsHeader<'static> = WeightsHeader { format: "lenslet-studio/published-unet", version: 1 };

/// The published U-net, trained for one scene and one mask.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedUnet {
    /// What it was trained for, how long, and how good it became.
    pub training: TrainingRecord,
    /// Weights, and behind them the running statistics.
    pub(super) weights: Vec<f32>,
}

impl TrainedUnet {
    /// The bytes of a safetensors file. Its header holds the record of the training.
    ///
    /// # Errors
    /// [`NetworkError`] where the weights do not fit a file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, NetworkError> {
        to_bytes(&HEADER, &Layers::new().layout, &self.weights, &self.training)
    }

    /// The network of the bytes of a safetensors file.
    ///
    /// # Errors
    /// [`NetworkError`] for other files, for newer ones, and for incomplete ones.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NetworkError> {
        Ok(Self { training: details_of(bytes, &HEADER)?, weights: read_weights(&Layers::new().layout, bytes)? })
    }
}
