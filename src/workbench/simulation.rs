//! Objects and their measurements through a design, as many as are asked for.

use ndarray::{Array3, Array4, s};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::design::Design;
use super::evaluation::EvaluationError;
use crate::objects::{ObjectError, ObjectOptions, ObjectSet, Split};
use crate::sensor::{Convolution, Convolver};

/// Objects and what the sensor makes of them.
pub struct Simulated {
    /// Shape (n, planes, rows, cols), photons per pixel.
    pub objects: Array4<f32>,
    /// Encoded images with background, shape (n, rows, cols).
    pub noiseless: Array3<f32>,
    /// With noise.
    pub noisy: Array3<f32>,
}

/// Opens the objects of a design and measures `count` of them.
///
/// # Errors
/// [`EvaluationError`] where the objects cannot be read or do not fit the PSF.
pub fn simulate(design: &Design, count: usize) -> Result<(ObjectSet, Simulated), EvaluationError> {
    let set = open_set(design)?;
    let convolver = convolver(design, &set)?;
    let objects = set.objects(Split::All, count, design.seed)?;
    let noiseless = convolver.measure(objects.view(), design.bias_photons)?;
    let noisy = design.noise.draw(noiseless.view(), design.seed);
    Ok((set, Simulated { objects, noiseless, noisy }))
}

/// The objects of a design.
pub(super) fn open_set(design: &Design) -> Result<ObjectSet, ObjectError> {
    let options = ObjectOptions { mean_photons: design.mean_photons, ..ObjectOptions::default() };
    ObjectSet::open(&design.objects, &options)
}

/// The optics of a design before a set of objects.
pub(super) fn convolver(design: &Design, set: &ObjectSet) -> Result<Convolver, EvaluationError> {
    let psf = design.psf(set.planes())?;
    let plan = Convolution::new(set.field(), design.encoder.grid())?;
    Ok(plan.with_psf(psf.slice(s![..set.planes(), .., ..]))?)
}

/// A seed of its own for each purpose of a run.
pub(super) fn derived_seed(seed: u64, purpose: u64) -> u64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(purpose);
    random.next_u64()
}
