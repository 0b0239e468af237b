//! A trained network and its file.

use serde::{Deserialize, Serialize};

use super::features::CHANNELS;
use super::layers::Layers;
use crate::nn::{NetworkError, WeightsHeader, read_weights};
use crate::reconstruction::training_record::{TrainingRecord, details_of, to_bytes};

const HEADER: WeightsHeader<'static> = WeightsHeader { format: "lenslet-studio/reconstruction-network", version: 1 };

/// A network on top of the linear estimate, trained for one scene and for one mask or any.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedNetwork {
    /// What it was trained for, how long, and how good it became.
    pub training: TrainingRecord,
    /// PSNR of the linear estimate on the validation objects, dB.
    pub linear_psnr_db: f64,
    /// Standard deviation of the objects, photons.
    pub(super) deviation: f64,
    pub(super) weights: Vec<f32>,
}

/// Header of the file of a network.
#[derive(Serialize, Deserialize)]
struct Details {
    #[serde(flatten)]
    training: TrainingRecord,
    validation_linear_psnr_db: f64,
    deviation_photons: f64,
}

impl TrainedNetwork {
    /// Whether no weights were better than the linear estimate on validation objects. Then the network gives the linear estimate.
    pub fn is_linear(&self) -> bool {
        self.training.psnr_db <= self.linear_psnr_db
    }

    /// One line on its training.
    pub fn summary(&self) -> String {
        let kept = if self.is_linear() { "; the linear estimate is kept, as no weights were better" } else { "" };
        format!("{}, linear estimate {:.2} dB{kept}", self.training.summary(), self.linear_psnr_db)
    }

    /// The bytes of a safetensors file. Its header holds the record of the training.
    ///
    /// # Errors
    /// [`NetworkError`] where the weights do not fit a file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, NetworkError> {
        let details = Details {
            training: self.training.clone(),
            validation_linear_psnr_db: self.linear_psnr_db,
            deviation_photons: self.deviation,
        };
        to_bytes(&HEADER, &Layers::new(CHANNELS).layout, &self.weights, &details)
    }

    /// The network of the bytes of a safetensors file.
    ///
    /// # Errors
    /// [`NetworkError`] for other files, for newer ones, and for incomplete ones.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NetworkError> {
        let Details { training, validation_linear_psnr_db, deviation_photons } = details_of(bytes, &HEADER)?;
        if !deviation_photons.is_normal() || deviation_photons < 0.0 {
            let (expected, found) = ("a deviation above 0".to_owned(), deviation_photons.to_string());
            return Err(NetworkError::Weights { expected, found });
        }
        let weights = read_weights(&Layers::new(CHANNELS).layout, bytes)?;
        Ok(Self { training, linear_psnr_db: validation_linear_psnr_db, deviation: deviation_photons, weights })
    }
}
