//! The record of a training: what a network was trained for, how long, and how good it became. It is the header of its weights file.

use ndarray::ArrayView2;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::decoder::DecoderKind;
use super::error::ReconstructionError;
use super::model::ImagingModel;
use super::protocol::DecoderScene;
use crate::formats::{content_key, json_of};
use crate::nn::{NetworkError, ParameterLayout, WeightsHeader, read_details, write_weights};
use crate::plural::counted;

/// Entry of the header that describes the network.
const ENTRY: &str = "network";
/// Fewest images of a set: one to train on, one to validate with, one to test with.
const LEAST_IMAGES: usize = 3;

/// One validation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
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

    /// Refuses a mask that it does not serve.
    fn check(&self, model: &ImagingModel) -> Result<(), ReconstructionError> {
        let expected = match self {
            Self::One { psf_hash } if *psf_hash == hash_of(model.psf()) => return Ok(()),
            Self::One { .. } => return Err(ReconstructionError::OtherMask),
            Self::Any { psf } => *psf,
        };
        let (rows, cols) = model.psf().dim();
        let other_grid = (expected != (rows, cols)).then(|| format!("{rows} x {cols} px"));
        match other_grid.or_else(|| model.beyond_training().map(str::to_owned)) {
            Some(found) => Err(ReconstructionError::BeyondTraining { expected, found }),
            None => Ok(()),
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

/// What a network was trained for, how long, and how good it became.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Description of the objects.
    pub set: String,
    /// Key of objects, light, background and noise.
    pub(super) scene: String,
    /// Rows and columns of the objects.
    pub(super) field: (usize, usize),
    /// Mask that it was trained for.
    pub mask: NetworkMask,
    /// Seed of its training.
    pub seed: u64,
    /// Steps of its training.
    pub steps: usize,
    /// Seconds of work of its training.
    pub seconds: f64,
    /// PSNR on validation objects, dB.
    #[serde(rename = "validation_psnr_db")]
    pub psnr_db: f64,
    /// All validations.
    pub curve: Vec<TrainingPoint>,
}

impl TrainingRecord {
    /// The record of a training in a scene that has not begun.
    pub(super) fn new(scene: &DecoderScene, mask: NetworkMask, seed: u64) -> Self {
        Self {
            set: scene.set.describe(),
            scene: key_of(scene),
            field: scene.set.field(),
            mask,
            seed,
            steps: 0,
            seconds: 0.0,
            psnr_db: f64::NEG_INFINITY,
            curve: Vec::new(),
        }
    }

    /// One line on the training.
    pub fn summary(&self) -> String {
        let Self { steps, seconds, psnr_db, .. } = self;
        format!("{} in {seconds:.1} s; on validation images {psnr_db:.2} dB", counted(*steps, "step"))
    }

    /// Refuses a set with too few images to train a decoder on and to validate it with.
    ///
    /// # Errors
    /// [`ReconstructionError::FewImages`].
    pub(super) fn check_images(scene: &DecoderScene, decoder: DecoderKind) -> Result<(), ReconstructionError> {
        match scene.set.base_images() {
            Some(found) if found < LEAST_IMAGES => {
                Err(ReconstructionError::FewImages { decoder: decoder.name(), least: LEAST_IMAGES, found })
            }
            _ => Ok(()),
        }
    }

    /// Refuses another scene than that of the training.
    ///
    /// # Errors
    /// [`ReconstructionError::OtherScene`].
    pub fn check_scene(&self, scene: &DecoderScene) -> Result<(), ReconstructionError> {
        if self.scene == key_of(scene) {
            return Ok(());
        }
        Err(ReconstructionError::other_scene(&self.set, scene.set.describe()))
    }

    /// Refuses another field or mask than that of the training. A network for any mask serves the masks that
    /// [`TrainingMasks::any`](super::TrainingMasks::any) trains for.
    ///
    /// # Errors
    /// [`ReconstructionError::Shape`] for another field, [`ReconstructionError::OtherMask`], [`ReconstructionError::BeyondTraining`].
    pub fn check_mask(&self, model: &ImagingModel) -> Result<(), ReconstructionError> {
        if model.field() != self.field {
            let (expected, found) = (self.field, model.field());
            return Err(ReconstructionError::shape("field", &[expected.0, expected.1], &[found.0, found.1]));
        }
        self.mask.check(model)
    }
}

/// Key of the objects of a scene, their light, the background and the noise.
fn key_of(scene: &DecoderScene) -> String {
    content_key(&serde_json::json!({
        "objects": scene.set.fingerprint(),
        "light": json_of(&scene.light),
        "background": scene.background,
        "noise": scene.noise.to_string(),
    }))
}

/// The bytes of a safetensors file of weights, with `details` in its header.
pub(super) fn to_bytes<T: Serialize>(
    header: &WeightsHeader<'_>,
    layout: &ParameterLayout,
    weights: &[f32],
    details: &T,
) -> Result<Vec<u8>, NetworkError> {
    write_weights(layout, weights, header, vec![(ENTRY, json_of(details).to_string())])
}

/// The details in the header of the bytes of a safetensors file.
pub(super) fn details_of<T: DeserializeOwned>(bytes: &[u8], header: &WeightsHeader<'_>) -> Result<T, NetworkError> {
    let broken = |found: String| NetworkError::Weights { expected: format!("an entry {ENTRY:?}"), found };
    let entries = read_details(bytes, header)?;
    let text = entries.get(ENTRY).ok_or_else(|| broken("none".to_owned()))?;
    serde_json::from_str(text).map_err(|error| broken(error.to_string()))
}
