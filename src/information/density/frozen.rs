//! Density models whose weights are held while the images that they describe move.

use ndarray::{Array3, ArrayView3};

use crate::information::error::InformationError;

/// A density model of noisy patches with its weights held: the link between the information and the mask that makes the
/// patches.
pub trait FrozenDensity {
    /// Information of noisy patches under the model, bits per pixel, and its gradient by the encoded patches, bits per
    /// pixel and photon; all of shape (n, rows, cols).
    ///
    /// The noise is reparameterised, `y = x + s(x) e`, where s is the standard deviation of the noise at x and `normals`
    /// holds e (Kabuli et al. 2026); so the measurements move with the images.
    ///
    /// # Errors
    /// For patches that the model cannot take, and values that are not finite.
    fn information_gradient(
        &self,
        clean: ArrayView3<'_, f32>,
        normals: ArrayView3<'_, f32>,
    ) -> Result<(f64, Array3<f64>), InformationError>;
}
