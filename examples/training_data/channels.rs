//! Training data of the decoder: channels of beads of many densities.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::masks::{USUAL_SHARE, between, light, mask, noise};
use lenslet_studio::design::IdealError;
use lenslet_studio::forward::ForwardModel;
use lenslet_studio::information::{BeadChannel, InformationError};
use lenslet_studio::objects::{ObjectOptions, ObjectSet, ObjectSource};
use lenslet_studio::optics::render_psf;
use lenslet_studio::seeds::SeedStream;

/// Densities of beads, and mean light of objects (photons per pixel).
const DENSITIES: (f64, f64) = (0.006, 0.15);
const LIGHT: (f64, f64) = (40.0, 250.0);
/// Shares of channels with shot noise and with read noise; the rest have both.
const NOISES: (f64, f64) = (0.7, 0.15);
/// Rows and columns of a patch, px.
const PATCH_SIDE: usize = 32;
/// Rows and columns of a whole sensor, px, and the share of channels that take it.
const SENSOR_SIDE: usize = 65;
const SENSOR_SHARE: f64 = 0.1;

/// Channel `number` of `seed`, from beads to measurements.
///
/// # Errors
/// If the channel cannot be computed.
pub fn training_channel(seed: u64, number: u64) -> Result<BeadChannel, InformationError> {
    channel(SeedStream::TrainingProblem { number }.derive(seed))
        .map_err(|error| InformationError::Stream { reason: error.to_string() })
}

fn channel(seed: u64) -> Result<BeadChannel, IdealError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let usual = random.random_bool(USUAL_SHARE);
    let density = between(&mut random, DENSITIES);
    let (mean_photons, bias) = light(&mut random, usual, LIGHT);
    let options = ObjectOptions { mean_photons, ..ObjectOptions::default() };
    let set = ObjectSet::open(&ObjectSource::Beads { density }, &options)?;
    let array = mask(&mut random);
    let psf = render_psf(&array, 1)?;
    let noise = noise(&mut random, NOISES);
    let side = if random.random_bool(SENSOR_SHARE) { SENSOR_SIDE } else { PATCH_SIDE };
    let forward = ForwardModel::new(set.clone(), (array.rows, array.cols), bias, noise)?;
    Ok(forward.bead_channel(psf.view(), (side, side)).ok_or(InformationError::NoLight)?)
}
