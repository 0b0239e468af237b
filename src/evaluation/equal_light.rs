//! Equal light for the images of different cameras.

use ndarray::{Array3, ArrayView3};

/// Equal light for all systems: images are scaled to a mean, and fresh noise is drawn (the published procedure).
///
/// The measured images then are the clean ones. Their own noise counts as part of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EqualLight {
    /// Mean of the scaled images, photons per pixel.
    pub mean_photons: f64,
    /// Background that is added, photons per pixel.
    pub background_photons: f64,
}

impl Default for EqualLight {
    fn default() -> Self {
        Self { mean_photons: 500.0, background_photons: 10.0 }
    }
}

impl EqualLight {
    /// Note on the procedure.
    pub(crate) fn describe(self) -> String {
        let Self { mean_photons, background_photons } = self;
        format!(
            "equal light: images are scaled to a mean of {mean_photons} photons per pixel, {background_photons} are added, and \
             fresh noise is drawn; their own noise counts as scene"
        )
    }

    /// Clean images, shape (n, rows, cols): `photons` at the mean and background of this light.
    pub(crate) fn clean(self, photons: ArrayView3<'_, f32>) -> Array3<f32> {
        let Self { mean_photons, background_photons } = self;
        let mean = photons.iter().map(|&value| f64::from(value)).sum::<f64>() / photons.len() as f64;
        photons.map(|&value| (f64::from(value) * mean_photons / mean + background_photons).max(0.0) as f32)
    }
}
