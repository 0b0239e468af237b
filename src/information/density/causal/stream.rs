//! Sources of training patches.

use std::ops::Range;

use ndarray::{Array3, Axis};

use crate::information::error::InformationError;

/// Noisy patches with their clean images where known; photons per pixel, shape (n, rows, cols).
#[derive(Clone, Debug)]
pub struct PatchBatch {
    /// With noise.
    pub noisy: Array3<f32>,
    /// Without, in the same order.
    pub clean: Option<Array3<f32>>,
}

impl PatchBatch {
    /// The first `count` patches, or all where there are fewer.
    #[must_use]
    pub fn first(&self, count: usize) -> Self {
        self.part(0..count.min(self.noisy.len_of(Axis(0))))
    }

    /// All patches, `count` at a time.
    pub(super) fn in_parts(&self, count: usize) -> impl Iterator<Item = Self> {
        let all = self.noisy.len_of(Axis(0));
        (0..all).step_by(count).map(move |first| self.part(first..all.min(first + count)))
    }

    fn part(&self, range: Range<usize>) -> Self {
        let part = |patches: &Array3<f32>| patches.slice_axis(Axis(0), range.clone().into()).to_owned();
        Self { noisy: part(&self.noisy), clean: self.clean.as_ref().map(part) }
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
