//! Held-out measurements of density models.

use ndarray::{Array3, Array4};

use super::ModelValue;
use crate::design::error::IdealError;
use crate::forward::ForwardModel;
use crate::information::{ObjectDraw, SharedImages, paired_interval};
use crate::objects::Split;
use crate::optics::{LensletArray, render_psf};
use crate::seeds::SeedStream;
use crate::sensor::Patches;

/// Held-out objects of a density model, one patch of each.
const HELD_OUT: usize = 128;

/// Objects that neither a density model nor its mask was fitted to.
pub(super) struct HeldOut {
    /// Shape (n, planes, rows, cols), photons per pixel.
    objects: Array4<f32>,
    /// Base images that the patches show.
    shared: SharedImages,
    patch: (usize, usize),
    seed: u64,
}

/// Patches of held-out measurements, shape (n, rows, cols), photons per pixel.
pub(super) struct HeldOutPatches {
    pub clean: Array3<f32>,
    pub noisy: Array3<f32>,
}

impl HeldOut {
    /// Draws the objects.
    ///
    /// # Errors
    /// Where objects or patch allow none.
    pub fn new(forward: &ForwardModel, patch: (usize, usize), seed: u64) -> Result<Self, IdealError> {
        // An image that repeats adds no information; an interval takes two.
        let count = forward.set.whole_images(Split::Test).map_or(HELD_OUT, |images| images.clamp(2, HELD_OUT));
        let object_seed = SeedStream::HeldOutObjects.derive(seed);
        let objects = forward.set.objects(Split::Test, count, object_seed)?;
        // The mask will change: a uniform PSF stands for all of them.
        let ((field_rows, field_cols), (rows, cols)) = (forward.set.field(), forward.plan().measurement_shape());
        let flat = Array3::ones((1, field_rows + 1 - rows, field_cols + 1 - cols));
        let places = Patches::one_each((count, rows, cols), patch, SeedStream::HeldOutPlaces.derive(seed))?;
        let shared = forward.shared_images(
            flat.view(),
            patch,
            ObjectDraw { split: Split::Test, first: 0, seed: object_seed },
            &places,
        );
        Ok(Self { objects, shared: shared.unwrap_or_default(), patch, seed })
    }

    /// Patches of the measurements through a mask, with the same places and seeds every time.
    ///
    /// # Errors
    /// Where mask and objects do not belong together.
    pub fn measured(&self, forward: &ForwardModel, array: &LensletArray) -> Result<HeldOutPatches, IdealError> {
        let psf = render_psf(array, forward.set.planes())?;
        let encoded = forward.convolver(psf.view())?.measure(self.objects.view(), forward.bias)?;
        let clean = Patches::one_each(encoded.dim(), self.patch, SeedStream::HeldOutPlaces.derive(self.seed))?
            .cut(encoded.view());
        let noisy = forward.noise.draw(clean.view(), SeedStream::HeldOutNoise.derive(self.seed));
        Ok(HeldOutPatches { clean, noisy })
    }

    /// Mean and 95 % interval of the information of each patch, bits per pixel.
    ///
    /// # Errors
    /// For fewer than two patches.
    pub fn value(&self, information: &[f64]) -> Result<ModelValue, IdealError> {
        let mean = information.iter().sum::<f64>() / information.len() as f64;
        let interval_95 = self.shared.inflate_interval(information, mean, paired_interval(information, self.seed)?);
        Ok(ModelValue { bits_per_pixel: mean, interval_95 })
    }
}
