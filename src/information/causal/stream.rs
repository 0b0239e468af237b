//! Where fresh patches come from.

use ndarray::{Array3, Axis};

use crate::information::InformationError;

/// Noisy patches, and what they were before the noise where that is known; photons per pixel, shape (n, rows, cols).
#[derive(Clone, Debug)]
pub struct PatchBatch {
    /// With noise.
    pub noisy: Array3<f32>,
    /// Without, in the same order.
    pub clean: Option<Array3<f32>>,
}

impl PatchBatch {
    /// The first `count` of them, or all where there are fewer.
    #[must_use]
    pub fn first(&self, count: usize) -> Self {
        let first = |patches: &Array3<f32>| {
            let count = count.min(patches.len_of(Axis(0)));
            patches.slice_axis(Axis(0), (..count).into()).to_owned()
        };
        Self { noisy: first(&self.noisy), clean: self.clean.as_ref().map(first) }
    }
}

/// An endless source of patches of one shape.
pub trait PatchStream: Sync {
    /// Draws `count` patches; equal seeds give equal patches.
    ///
    /// # Errors
    /// Where the objects behind them cannot be drawn or measured.
    fn draw(&self, count: usize, seed: u64) -> Result<PatchBatch, InformationError>;
}
