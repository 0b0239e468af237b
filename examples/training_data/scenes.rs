//! Training data of the density model: beads, and mosaics of random images.

use ndarray::{Array2, Array4, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::images::{TILE, images};
use super::masks::{USUAL_SHARE, between, light, mask, noise};
use lenslet_studio::design::IdealError;
use lenslet_studio::forward::ForwardModel;
use lenslet_studio::information::{InformationError, Moments, PatchBatch, PatchStream, TrainingScene};
use lenslet_studio::objects::{ObjectOptions, ObjectSet, ObjectSource, Split};
use lenslet_studio::optics::render_psf;
use lenslet_studio::seeds::SeedStream;
use lenslet_studio::sensor::{Convolution, Patches};

/// Rows and columns of objects and of patches, px.
const FIELD: usize = 96;
const PATCH: (usize, usize) = (32, 32);
/// Objects of a scene and patches cut from each, and patches that are fitted.
const OBJECTS: usize = 256;
const PATCHES_PER_OBJECT: usize = 4;
const FITTED: usize = 256;
/// Densities of beads, and mean light of objects (photons per pixel).
const DENSITIES: (f64, f64) = (0.004, 0.2);
const LIGHT: (f64, f64) = (30.0, 400.0);
/// Shares of scenes with shot noise and with read noise; the rest have both.
const NOISES: (f64, f64) = (0.75, 0.15);
/// Share of scenes that are beads.
const BEADS_SHARE: f64 = 0.35;

/// Scene `number` of `seed`.
///
/// # Errors
/// If the scene cannot be computed.
pub fn training_scene(seed: u64, number: u64) -> Result<TrainingScene, InformationError> {
    scene(SeedStream::TrainingProblem { number }.derive(seed))
        .map_err(|error| InformationError::Stream { reason: error.to_string() })
}

fn scene(seed: u64) -> Result<TrainingScene, IdealError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let usual = random.random_bool(USUAL_SHARE);
    let (mean_photons, bias) = light(&mut random, usual, LIGHT);
    let array = mask(&mut random);
    let psf = render_psf(&array, 1)?;
    let noise = noise(&mut random, NOISES);
    let grid = (array.rows, array.cols);
    if random.random_bool(BEADS_SHARE) {
        let density = between(&mut random, DENSITIES);
        let options = ObjectOptions { mean_photons, ..ObjectOptions::default() };
        let set = ObjectSet::open(&ObjectSource::Beads { density }, &options)?;
        let forward = ForwardModel::new(set.clone(), grid, bias, noise)?;
        let stream = forward.stream(forward.convolver(psf.view())?, Split::Train, PATCH);
        let moments = forward.analytic_moments(Split::All, grid, PATCH)?.of(psf.view())?;
        return Ok(TrainingScene { noise, patches: stream.draw(FITTED, seed)?, moments });
    }
    let objects = mosaics(&mut random, mean_photons);
    let encoded = Convolution::new((FIELD, FIELD), grid)?.with_psf(psf.view())?.measure(objects.view(), bias)?;
    let clean = Patches::draw(encoded.dim(), PATCH, PATCHES_PER_OBJECT * OBJECTS, seed)?.cut(encoded.view());
    let noisy = noise.draw(clean.view(), SeedStream::PatchNoise.derive(seed));
    let moments = Moments::of_patches(noisy.view())?;
    Ok(TrainingScene { noise, patches: PatchBatch { noisy, clean: Some(clean) }.first(FITTED), moments })
}

/// Mosaics of images of one kind, photons per pixel, shape (n, 1, rows, cols).
fn mosaics(random: &mut ChaCha8Rng, mean_photons: f64) -> Array4<f32> {
    let tiles: Vec<Array2<f32>> = images(random);
    let light: f64 = tiles.iter().map(|tile| f64::from(tile.sum())).sum();
    let mean = light / (tiles.len() * TILE * TILE) as f64;
    // Avoids a division by zero for a dark set.
    let photons = (mean_photons / mean.max(1e-3)) as f32;
    let mut objects = Array4::zeros((OBJECTS, 1, FIELD, FIELD));
    for mut object in objects.outer_iter_mut() {
        for row in (0..FIELD).step_by(TILE) {
            for col in (0..FIELD).step_by(TILE) {
                let tile = &tiles[random.random_range(0..tiles.len())];
                object.slice_mut(s![0, row..row + TILE, col..col + TILE]).assign(&(tile * photons));
            }
        }
    }
    objects
}

#[cfg(test)]
mod tests {
    use super::*;
    use lenslet_studio::sensor::Noise;

    #[test]
    fn scenes_are_bright_uneven_and_reproducible() {
        let noises: Vec<Noise> = (0..12)
            .map(|number| {
                let scene = training_scene(5, number).unwrap();
                let TrainingScene { noise, patches: PatchBatch { noisy, clean }, moments } = scene;
                let clean = clean.unwrap();
                assert_eq!((noisy.dim(), clean.dim()), ((FITTED, 32, 32), (FITTED, 32, 32)));
                let mean = f64::from(clean.mean().unwrap());
                assert!((2.0..500.0).contains(&mean), "{mean}");
                assert!((moments.mean / mean - 1.0).abs() < 0.2, "{} {mean}", moments.mean);
                assert!(clean.std(0.0) > 0.1 && clean.iter().all(|x| x.is_finite() && *x >= 0.0));
                noise
            })
            .collect();
        assert!(noises.contains(&Noise::Shot) && noises.iter().any(|noise| *noise != Noise::Shot));
        let (one, again) = (training_scene(5, 3).unwrap(), training_scene(5, 3).unwrap());
        assert_eq!(one.patches.noisy, again.patches.noisy);
        assert_ne!(one.patches.noisy, training_scene(6, 3).unwrap().patches.noisy);
    }
}
