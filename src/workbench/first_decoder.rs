//! Channels that the decoder of the program was fitted to: beads of many densities, bright and dim, through masks of all
//! kinds.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::design::IdealError;
use crate::design::{Imaging, derived_seed};
use crate::information::{BeadChannel, InformationError};
use crate::objects::{ObjectOptions, ObjectSet, ObjectSource};
use crate::optics::{Lenslet, LensletArray, Limits, heuristic_layout, random_layout, render_psf};
use crate::sensor::Noise;

/// Densities of beads, mean light of objects and background (photons per pixel).
const DENSITIES: (f64, f64) = (0.006, 0.15);
const LIGHT: (f64, f64) = (40.0, 250.0);
const BIAS: (f64, f64) = (3.0, 40.0);
/// Light and background of most designs.
const USUAL: (f64, f64) = (100.0, 10.0);
/// Share of channels that have them.
const USUAL_SHARE: f64 = 0.7;
/// Read noise of channels, photons.
const READ_NOISE: (f64, f64) = (1.0, 10.0);
/// Rows and columns of a patch, px.
const PATCH_SIDE: usize = 32;
/// Rows and columns of a whole sensor, px, and the share of channels that take it.
const SENSOR_SIDE: usize = 65;
const SENSOR_SHARE: f64 = 0.1;
/// Most lenslets of a drawn mask, and their widths, px.
const MOST_LENSLETS: f64 = 25.5;
const WIDTHS: (f64, f64) = (0.775, 2.5);

/// Channel number `number` from beads to measurements, of those that `seed` gives.
///
/// # Errors
/// Where it cannot be computed.
pub fn first_channel(seed: u64, number: u64) -> Result<BeadChannel, InformationError> {
    channel(derived_seed(seed, number)).map_err(|error| InformationError::Stream { reason: error.to_string() })
}

fn channel(seed: u64) -> Result<BeadChannel, IdealError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let usual = random.random_bool(USUAL_SHARE);
    let density = between(&mut random, DENSITIES);
    let (mean_photons, bias) = if usual { USUAL } else { (between(&mut random, LIGHT), between(&mut random, BIAS)) };
    let options = ObjectOptions { mean_photons, ..ObjectOptions::default() };
    let set = ObjectSet::open(&ObjectSource::Beads { density }, &options)?;
    let array = mask(&mut random);
    let psf = render_psf(&array, 1)?;
    let noise = match random.random_range(0.0..1.0) {
        share if share < 0.7 => Noise::Shot,
        share if share < 0.85 => Noise::Read { sigma: between(&mut random, READ_NOISE) },
        _ => Noise::ShotRead { sigma: between(&mut random, READ_NOISE) },
    };
    let side = if random.random_bool(SENSOR_SHARE) { SENSOR_SIDE } else { PATCH_SIDE };
    let imaging = Imaging::new(&set, (array.rows, array.cols), bias, noise)?;
    Ok(imaging.bead_channel(psf.view(), (side, side)).ok_or(InformationError::NoLight)?)
}

/// Heuristic masks, random starts of designs, and lenslets anywhere.
fn mask(random: &mut ChaCha8Rng) -> LensletArray {
    let choice: f64 = random.random();
    if choice < 0.4 {
        return heuristic_layout(random.random_range(1..=9));
    }
    if choice < 0.5 {
        return random_layout(25, random.random());
    }
    let limits = Limits::default();
    let count = between(random, (1.0, MOST_LENSLETS)).round() as usize;
    let mut array = heuristic_layout(1);
    let (low, high) = limits.coordinate_range(array.cols);
    let sharp = random.random_bool(0.6);
    let uneven = if random.random_bool(0.5) { 0.6 } else { 0.0 };
    array.lenslets = (0..count)
        .map(|_| {
            let sigma = if sharp { random.random_range(0.775..0.85) } else { between(random, WIDTHS) };
            let spread: f64 = StandardNormal.sample(random);
            let (x, y) = (random.random_range(low..high), random.random_range(low..high));
            Lenslet::round(x, y, sigma, (uneven * spread).exp() / count as f64)
        })
        .collect();
    array
}

/// A number whose logarithm is uniform.
fn between(random: &mut ChaCha8Rng, (low, high): (f64, f64)) -> f64 {
    random.random_range(low.ln()..high.ln()).exp()
}
