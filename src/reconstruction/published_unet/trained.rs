//! A trained U-net: its weights, what they belong to, and their file.

use serde::{Deserialize, Serialize};

use super::layers::Layers;
use crate::formats::json_of;
use crate::nn::{NetworkError, WeightsHeader, read_details, read_weights, write_weights};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::network::{NetworkMask, TrainedNetwork, TrainingPoint};
use crate::reconstruction::protocol::DecoderScene;

const HEADER: WeightsHeader<'static> = WeightsHeader { format: "lenslet-studio/published-unet", version: 1 };
/// Entry of the header that describes the network.
const ENTRY: &str = "network";

/// The published U-net, trained for one scene and one mask.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedUnet {
    /// Description of the objects.
    pub set: String,
    /// Mask that it was trained for.
    pub mask: NetworkMask,
    /// Seed of its training.
    pub seed: u64,
    /// Steps of its training.
    pub steps: usize,
    /// Seconds of work of its training.
    pub seconds: f64,
    /// PSNR on validation objects, dB.
    pub psnr_db: f64,
    /// All validations.
    pub curve: Vec<TrainingPoint>,
    /// Key of objects, light, background and noise.
    pub(super) scene: String,
    pub(super) field: (usize, usize),
    /// Weights, and behind them the running statistics.
    pub(super) weights: Vec<f32>,
}

/// [`TrainedUnet`] in the header of its file.
#[derive(Serialize, Deserialize)]
struct Details {
    set: String,
    scene: String,
    field: (usize, usize),
    mask: NetworkMask,
    seed: u64,
    steps: usize,
    seconds: f64,
    validation_psnr_db: f64,
    curve: Vec<TrainingPoint>,
}

impl TrainedUnet {
    /// The bytes of a safetensors file. Its header holds the description of the objects, keys of scene and mask, and the validations.
    ///
    /// # Errors
    /// [`NetworkError`] where the weights do not fit a file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, NetworkError> {
        let details = Details {
            set: self.set.clone(),
            scene: self.scene.clone(),
            field: self.field,
            mask: self.mask.clone(),
            seed: self.seed,
            steps: self.steps,
            seconds: self.seconds,
            validation_psnr_db: self.psnr_db,
            curve: self.curve.clone(),
        };
        let details = vec![(ENTRY, json_of(&details).to_string())];
        write_weights(&Layers::new().layout, &self.weights, &HEADER, details)
    }

    /// The network of the bytes of a safetensors file.
    ///
    /// # Errors
    /// [`NetworkError`] for other files, for newer ones, and for incomplete ones.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NetworkError> {
        let details = read_details(bytes, &HEADER)?;
        let broken = |found: String| NetworkError::Weights { expected: format!("an entry {ENTRY:?}"), found };
        let text = details.get(ENTRY).ok_or_else(|| broken("none".to_owned()))?;
        let details: Details = serde_json::from_str(text).map_err(|error| broken(error.to_string()))?;
        Ok(Self {
            set: details.set,
            mask: details.mask,
            seed: details.seed,
            steps: details.steps,
            seconds: details.seconds,
            psnr_db: details.validation_psnr_db,
            curve: details.curve,
            scene: details.scene,
            field: details.field,
            weights: read_weights(&Layers::new().layout, bytes)?,
        })
    }

    pub(super) fn scene_key(scene: &DecoderScene) -> String {
        TrainedNetwork::scene_key(scene)
    }

    /// This network, where it was trained for that scene.
    ///
    /// # Errors
    /// [`ReconstructionError::OtherScene`] otherwise.
    pub fn start_of(&self, scene: &DecoderScene) -> Result<&Self, ReconstructionError> {
        if self.scene == Self::scene_key(scene) {
            return Ok(self);
        }
        Err(ReconstructionError::other_scene(&self.set, scene.set.describe()))
    }

    /// Refuses another mask than that of the training.
    pub(super) fn check_mask(&self, model: &ImagingModel) -> Result<(), ReconstructionError> {
        if model.field() != self.field {
            let (expected, found) = (self.field, model.field());
            return Err(ReconstructionError::shape("field", &[expected.0, expected.1], &[found.0, found.1]));
        }
        if self.mask.serves(model) { Ok(()) } else { Err(ReconstructionError::OtherMask) }
    }
}
