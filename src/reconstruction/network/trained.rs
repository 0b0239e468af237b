//! A trained network: its weights, what they belong to, and their file.

use ndarray::ArrayView2;
use serde::{Deserialize, Serialize};

use super::features::CHANNELS;
use super::layers::Layers;
use crate::formats::{content_key, json_of};
use crate::nn::{NetworkError, WeightsHeader, read_details, read_weights, write_weights};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::protocol::DecoderScene;

const HEADER: WeightsHeader<'static> = WeightsHeader { format: "lenslet-studio/reconstruction-network", version: 1 };
/// Entry of the header that describes the network.
const ENTRY: &str = "network";

/// One validation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingPoint {
    /// Steps so far.
    pub steps: usize,
    /// Seconds of work so far.
    pub seconds: f64,
    /// PSNR on the validation objects, dB.
    pub psnr_db: f64,
}

/// Mask that a network was trained for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NetworkMask {
    /// One mask.
    One {
        /// BLAKE3 hash of its point spread function, in hexadecimal.
        psf_hash: String,
    },
    /// Any mask.
    Any {
        /// Rows and columns of the point spread functions, px.
        psf: (usize, usize),
    },
}

impl NetworkMask {
    /// The mask of a model alone.
    pub fn of(model: &ImagingModel) -> Self {
        Self::One { psf_hash: hash_of(model.psf()) }
    }

    /// Whether a network for this mask serves a model.
    pub(in crate::reconstruction) fn serves(&self, model: &ImagingModel) -> bool {
        match self {
            Self::One { psf_hash } => *psf_hash == hash_of(model.psf()),
            Self::Any { psf } => *psf == model.psf().dim(),
        }
    }
}

fn hash_of(psf: ArrayView2<'_, f64>) -> String {
    let mut hasher = blake3::Hasher::new();
    for side in [psf.nrows(), psf.ncols()] {
        hasher.update(&(side as u64).to_le_bytes());
    }
    // Rounded, so that a mask is the same one after a round trip through a file of f32.
    for &value in psf {
        hasher.update(&(value as f32).to_le_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// A network on top of the linear estimate, trained for one scene and for one mask or any.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedNetwork {
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
    /// That of the linear estimate, dB.
    pub linear_psnr_db: f64,
    /// All validations.
    pub curve: Vec<TrainingPoint>,
    /// Key of objects, light, background and noise.
    pub(super) scene: String,
    pub(super) field: (usize, usize),
    /// Standard deviation of the objects, photons.
    pub(super) deviation: f64,
    pub(super) weights: Vec<f32>,
}

/// [`TrainedNetwork`] in the header of its file.
#[derive(Serialize, Deserialize)]
struct Details {
    set: String,
    scene: String,
    field: (usize, usize),
    mask: NetworkMask,
    deviation_photons: f64,
    seed: u64,
    steps: usize,
    seconds: f64,
    validation_psnr_db: f64,
    validation_linear_psnr_db: f64,
    curve: Vec<TrainingPoint>,
}

impl TrainedNetwork {
    /// Whether no weights were better than the linear estimate on validation objects, which therefore is what this network gives.
    pub fn is_linear(&self) -> bool {
        self.psnr_db <= self.linear_psnr_db
    }

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
            deviation_photons: self.deviation,
            seed: self.seed,
            steps: self.steps,
            seconds: self.seconds,
            validation_psnr_db: self.psnr_db,
            validation_linear_psnr_db: self.linear_psnr_db,
            curve: self.curve.clone(),
        };
        let details = vec![(ENTRY, json_of(&details).to_string())];
        write_weights(&Layers::new(CHANNELS).layout, &self.weights, &HEADER, details)
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
        if !details.deviation_photons.is_normal() || details.deviation_photons < 0.0 {
            return Err(broken(format!("a deviation of {}", details.deviation_photons)));
        }
        let weights = read_weights(&Layers::new(CHANNELS).layout, bytes)?;
        Ok(Self {
            set: details.set,
            mask: details.mask,
            seed: details.seed,
            steps: details.steps,
            seconds: details.seconds,
            psnr_db: details.validation_psnr_db,
            linear_psnr_db: details.validation_linear_psnr_db,
            curve: details.curve,
            scene: details.scene,
            field: details.field,
            deviation: details.deviation_photons,
            weights,
        })
    }

    /// Key of the objects of a scene, their light, the background and the noise.
    pub(in crate::reconstruction) fn scene_key(scene: &DecoderScene) -> String {
        content_key(&serde_json::json!({
            "objects": scene.set.fingerprint(),
            "light": json_of(&scene.light),
            "background": scene.background,
            "noise": scene.noise.to_string(),
        }))
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
