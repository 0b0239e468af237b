//! Density models with frozen weights, differentiated by the images.

use ndarray::{Array3, ArrayView3};

use crate::information::error::InformationError;
use crate::progress::Progress;

/// Density model of noisy patches with frozen weights. It links the information to the mask that makes the patches.
pub trait FrozenDensity {
    /// Information of noisy patches under the model, bits per pixel, and its gradient by the encoded patches, bits
    /// per pixel and photon; all of shape (n, rows, cols).
    ///
    /// The noise is reparameterised, `y = x + s(x) e`, where s is the standard deviation of the noise at x and
    /// `normals` holds e (Kabuli et al. 2026). The measurements therefore change smoothly with the images.
    ///
    /// Densities that compute it in parts report the number of patches before each.
    ///
    /// # Errors
    /// For invalid patches and values that are not finite; where `progress` cancels.
    fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<usize>,
    ) -> Result<(f64, Array3<f64>), InformationError>;
}
