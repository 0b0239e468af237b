//! Channels that the decoder of the program was fitted to: beads of many densities.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::design::IdealError;
use crate::forward::ForwardModel;
use crate::information::{BeadChannel, InformationError};
use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};
use crate::optics::render_psf;
use crate::seeds::SeedStream;
use crate::workbench::first::masks::{USUAL_SHARE, between, light, mask, noise};

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

/// Channel number `number` from beads to measurements, of those that `seed` gives.
///
/// # Errors
/// Where it cannot be computed.
pub fn first_channel(seed: u64, number: u64) -> Result<BeadChannel, InformationError> {
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
    let imaging = ForwardModel::new(&set, (array.rows, array.cols), bias, noise)?;
    Ok(imaging.bead_channel(psf.view(), (side, side)).ok_or(InformationError::NoLight)?)
}
