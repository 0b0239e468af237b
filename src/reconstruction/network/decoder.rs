//! The trained network as a decoder.

use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;

use super::features::{CHANNELS, Features, padded};
use super::layers::Layers;
use super::trained::TrainedNetwork;
use super::unet::{Activations, Ready, check_memory};
use crate::progress::{CancelToken, Progress};
use crate::reconstruction::decoder::{Decoder, DecoderKind, PreparedDecoder, ReconstructionStep};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::linear::Prior;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::protocol::DecoderScene;

/// Measurements that are decoded together.
const TOGETHER: usize = 16;

/// A trained network on top of the linear estimate, as a decoder.
#[derive(Clone)]
pub struct NetworkDecoder {
    network: Arc<TrainedNetwork>,
    prior: Arc<Prior>,
    set_mean: f64,
}

impl NetworkDecoder {
    /// The network with the prior of the scene that it was trained for.
    ///
    /// # Errors
    /// [`ReconstructionError::OtherScene`] where it was trained for another one.
    pub fn new(
        network: Arc<TrainedNetwork>,
        scene: &DecoderScene,
        prior: Arc<Prior>,
    ) -> Result<Self, ReconstructionError> {
        network.training.check_scene(scene)?;
        Ok(Self { network, prior, set_mean: scene.set.mean() })
    }
}

impl Decoder for NetworkDecoder {
    fn kind(&self) -> DecoderKind {
        DecoderKind::Network
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        self.network.training.check_mask(model)?;
        check_memory(model.field(), 1)?;
        let moments = (self.network.deviation, self.set_mean);
        let features = Features::new(model, &self.prior, moments, cancel)?;
        Ok(Box::new(PreparedNetwork { features, layers: Layers::new(CHANNELS), network: self.network.clone() }))
    }
}

struct PreparedNetwork {
    features: Features,
    layers: Layers,
    network: Arc<TrainedNetwork>,
}

impl PreparedDecoder for PreparedNetwork {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        let field = self.features.model().field();
        let total = measurements.len_of(Axis(0));
        let mut objects = Array3::zeros((total, field.0, field.1));
        let ready = Ready::new(&self.layers, &self.network.weights);
        let padded = padded(field);
        for first in (0..total).step_by(TOGETHER) {
            let done = (first + TOGETHER).min(total);
            let part = ndarray::s![first..done, .., ..];
            let examples = self.features.examples(measurements.slice(part), &CancelToken::new())?;
            let mut part = objects.slice_mut(part);
            let pairs = part.axis_iter_mut(Axis(0)).into_par_iter().zip(examples.par_iter());
            pairs.for_each_init(
                || Activations::new(&self.layers, padded),
                |memory, (mut object, example)| {
                    ready.forward(&example.image, memory);
                    for ((row, col), value) in object.indexed_iter_mut() {
                        let correction = self.features.unit() * memory.result[row * padded.1 + col];
                        *value = example.linear[row * field.1 + col] + correction;
                    }
                },
            );
            if progress.report(&ReconstructionStep::Images { done, total }).is_break() {
                return Err(ReconstructionError::Cancelled);
            }
        }
        Ok(objects)
    }

    /// That of the linear estimate, which the network mostly undercuts.
    fn standard_deviation(
        &self,
        measurement: ArrayView2<'_, f32>,
        cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>, ReconstructionError> {
        self.features.linear().standard_deviation(measurement, cancel)
    }
}
