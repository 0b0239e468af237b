//! Decoders that work on one measurement at a time.

use std::ops::ControlFlow;

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;

use super::decoder::{PreparedDecoder, ReconstructionStep};
use super::error::ReconstructionError;
use super::fourier::fast_length;
use super::model::ImagingModel;
use crate::progress::{CancelToken, Progress};

/// Largest number of pixels of a field: 8192 x 8192.
const MOST_PIXELS: usize = 1 << 26;
/// Pixels of a field from which images are solved one after another, with all threads on each.
const LARGE_PIXELS: usize = 1 << 17;

/// A method for one measurement.
pub(super) trait OneImage: Send + Sync {
    /// The model that it inverts.
    fn model(&self) -> &ImagingModel;

    /// The object of a measurement of the right shape.
    fn object(
        &self,
        measurement: ArrayView2<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array2<f32>, ReconstructionError>;
}

/// Such a method as a decoder of stacks.
pub(super) struct OneByOne<M>(pub(super) M);

impl<M: OneImage> PreparedDecoder for OneByOne<M> {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        let model = self.0.model();
        model.check_measurements(&measurements)?;
        let (rows, cols) = model.field();
        let total = measurements.len_of(Axis(0));
        let mut objects = Array3::zeros((total, rows, cols));
        if total == 1 {
            let object = self.0.object(measurements.index_axis(Axis(0), 0), progress)?;
            objects.index_axis_mut(Axis(0), 0).assign(&object);
            return Ok(objects);
        }
        let together = if rows * cols >= LARGE_PIXELS { 1 } else { 2 * rayon::current_num_threads() };
        for first in (0..total).step_by(together) {
            let done = (first + together).min(total);
            let found: Vec<Result<Array2<f32>, ReconstructionError>> = (first..done)
                .into_par_iter()
                .map(|index| self.0.object(measurements.index_axis(Axis(0), index), &mut CancelToken::new()))
                .collect();
            for (index, object) in (first..done).zip(found) {
                objects.index_axis_mut(Axis(0), index).assign(&object?);
            }
            if progress.report(&ReconstructionStep::Images { done, total }).is_break() {
                return Err(ReconstructionError::Cancelled);
            }
        }
        Ok(objects)
    }
}

/// Refuses fields whose `images` images of the size of the transform do not fit into memory.
pub(super) fn check_memory((rows, cols): (usize, usize), images: usize) -> Result<(), ReconstructionError> {
    let points = fast_length(rows).saturating_mul(fast_length(cols));
    if points <= MOST_PIXELS {
        return Ok(());
    }
    let gibibytes = (points.saturating_mul(images) * size_of::<f32>()) as f64 / (1_u64 << 30) as f64;
    Err(ReconstructionError::TooLarge { rows, cols, gibibytes })
}

/// Reports an iteration; the error of a cancelled reconstruction after `Break`.
pub(super) fn report(
    progress: &mut dyn Progress<ReconstructionStep>,
    step: &ReconstructionStep,
) -> Result<(), ReconstructionError> {
    match progress.report(step) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(ReconstructionError::Cancelled),
    }
}
