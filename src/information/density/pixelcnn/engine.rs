//! Interface of the compute backends of a `PixelCNN`.

use ndarray::ArrayView3;

use super::model::PixelCnn;
use crate::information::engine_choice::EngineChoice;
use crate::information::error::InformationError;

/// Computes losses and gradients of a [`PixelCnn`]. Weights and gradients are in the order of [`PixelCnn::layout`]
/// for every engine, so all engines share the same optimizers.
pub trait Engine {
    /// The name of this engine.
    fn choice(&self) -> EngineChoice;

    /// Mean negative log density of `patches` (photons per pixel, shape (n, rows, cols)), nats per pixel.
    ///
    /// Its gradient by all weights is written to `gradient`, that by the patches (per photon) to `by_patch` where it is
    /// given. Values that are not finite give a loss that is not finite, without an error.
    ///
    /// # Errors
    /// Where a device fails, such as a graphics card without memory.
    fn loss_and_gradients(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
        gradient: &mut [f32],
        by_patch: Option<&mut [f32]>,
    ) -> Result<f64, InformationError>;

    /// Cross-entropy of each patch, `-log2 p(y)` in bits per pixel, as [`PixelCnn::cross_entropy_bits`].
    ///
    /// # Errors
    /// As [`PixelCnn::cross_entropy_bits`], and where a device fails.
    fn cross_entropy_bits(
        &mut self,
        model: &PixelCnn,
        patches: ArrayView3<'_, f32>,
    ) -> Result<Vec<f64>, InformationError>;
}
