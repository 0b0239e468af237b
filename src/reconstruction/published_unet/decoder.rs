//! The published U-net as a decoder.

use std::sync::Arc;

use ndarray::{Array3, ArrayView3, Axis};
use rayon::prelude::*;

use super::layers::Layers;
use super::objects::{image_of, padded};
use super::passes::Evaluation;
use super::trained::TrainedUnet;
use crate::progress::{CancelToken, Progress};
use crate::reconstruction::decoder::{Decoder, DecoderKind, PreparedDecoder, ReconstructionStep};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::protocol::DecoderScene;

/// Measurements between reports of progress.
const TOGETHER: usize = 16;

/// The published U-net as a decoder of the mask that it was trained for.
#[derive(Clone)]
pub struct UnetDecoder {
    pub(super) network: Arc<TrainedUnet>,
    peak: f64,
}

impl UnetDecoder {
    /// The network in the scene that it was trained for.
    ///
    /// # Errors
    /// [`ReconstructionError::OtherScene`] where it was trained for another one.
    pub fn new(network: Arc<TrainedUnet>, scene: &DecoderScene) -> Result<Self, ReconstructionError> {
        network.training.check_scene(scene)?;
        Ok(Self { network, peak: scene.set.peak() })
    }
}

impl Decoder for UnetDecoder {
    fn kind(&self) -> DecoderKind {
        DecoderKind::Unet
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        _cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        self.network.training.check_mask(model)?;
        Ok(Box::new(PreparedUnet { decoder: self.clone(), model: model.clone() }))
    }
}

struct PreparedUnet {
    decoder: UnetDecoder,
    model: ImagingModel,
}

impl PreparedDecoder for PreparedUnet {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        self.model.check_measurements(&measurements)?;
        ReconstructionError::check_finite("measurements", &measurements)?;
        let UnetDecoder { network, peak } = &self.decoder;
        let (layers, field) = (Layers::new(), self.model.field());
        let (_, padded_cols) = padded(field);
        let evaluation = Evaluation::new(&layers, &network.weights, padded(field));
        let total = measurements.len_of(Axis(0));
        let mut objects = Array3::zeros((total, field.0, field.1));
        for first in (0..total).step_by(TOGETHER) {
            let done = (first + TOGETHER).min(total);
            let mut part = objects.slice_mut(ndarray::s![first..done, .., ..]);
            part.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(index, mut object)| {
                let measurement = measurements.index_axis(Axis(0), first + index);
                let result = evaluation.result(&image_of(measurement, &self.model));
                for ((row, col), value) in object.indexed_iter_mut() {
                    *value = (f64::from(result[row * padded_cols + col]) * peak) as f32;
                }
            });
            if progress.report(&ReconstructionStep::Images { done, total }).is_break() {
                return Err(ReconstructionError::Cancelled);
            }
        }
        Ok(objects)
    }
}
