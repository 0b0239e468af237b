//! Initial weights of a fit: pretrained, random, or from the model of a similar design.

use serde::{Deserialize, Serialize};

use std::sync::Arc;

use super::conditioning::{Conditioning, FAR_PLACES, Moments, Units};
use super::level_interpolation::{among, carry};
use super::levels::{LevelSpan, Levels};
use super::model::{CausalModel, check};
use super::pretrained::PretrainedWeights;
use super::shape::CausalShape;
use super::stream::PatchBatch;
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::nn::ParameterLayout;
use crate::sensor::Noise;

/// Largest distance of a far place in rows or columns, px; the distance of an unused place.
const FARTHEST: usize = 1_000_000;

/// Initial weights of a model.
#[derive(Clone, Copy, Debug)]
pub enum Init<'a> {
    /// The pretrained weights of the program ([`PretrainedWeights`]).
    Pretrained,
    /// Random weights: a cold start.
    Random,
    /// Weights of the model of a similar design: a warm start. The pretrained weights where its noise differs.
    Warm(&'a CausalStart),
}

/// Data that a fit takes from the model of a similar design. The numbers pass through a file unchanged, so a fit that
/// starts from them is reproducible.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CausalStart {
    /// Size of the network.
    pub(super) shape: CausalShape,
    /// Noise of its measurements.
    pub(super) noise: Noise,
    /// Range of its measurements.
    pub(super) span: LevelSpan,
    /// Units of one input: mean and inverse deviation of the roots of photons.
    pub(super) roots: (f32, f32),
    /// Units of the other input: mean and inverse deviation of photons.
    pub(super) photons: (f32, f32),
    /// Far places (rows down, columns right), px.
    pub(super) far: Vec<(isize, isize)>,
    /// All weights of the network.
    pub(super) weights: Vec<f32>,
}

impl CausalStart {
    /// The weights.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Whether it belongs to measurements with this noise.
    pub fn is_of(&self, noise: Noise) -> bool {
        self.noise == noise
    }

    /// Whether the values are those of a model and not of a damaged file.
    pub fn is_sound(&self) -> bool {
        let near = |place: &(isize, isize)| place.0.unsigned_abs() <= FARTHEST && place.1.unsigned_abs() <= FARTHEST;
        let units = [self.roots.0, self.roots.1, self.photons.0, self.photons.1];
        self.far.len() == FAR_PLACES
            && self.far.iter().all(near)
            && units.iter().all(|unit| unit.is_finite())
            && self.span.is_sound()
            && self.layout(Levels::spanning(self.noise, self.span).count()).is_some()
    }

    /// Places of the weights; `None` where their number is wrong, as in a damaged file.
    pub(super) fn layout(&self, levels: usize) -> Option<ParameterLayout> {
        let (_, layout) = self.shape.layers(levels, &self.far);
        (layout.count() == self.weights.len() && self.weights.iter().all(|weight| weight.is_finite())).then_some(layout)
    }
}

impl From<&CausalModel> for CausalStart {
    fn from(model: &CausalModel) -> Self {
        let conditioning = &model.conditioning;
        let Units { roots, photons } = conditioning.units();
        Self {
            shape: model.shape.clone(),
            noise: conditioning.noise,
            span: conditioning.levels.span,
            roots,
            photons,
            far: conditioning.far.clone(),
            weights: model.weights.clone(),
        }
    }
}

impl CausalModel {
    /// A model for patches like those of `sample` before its fit. From the model of a similar design it takes the
    /// weights as far as they fit, so that it needs few steps.
    ///
    /// # Errors
    /// For no noise; for patches that are empty, too large, constant or not finite; for moments that are no
    /// covariance.
    pub fn new(
        shape: CausalShape,
        noise: Noise,
        sample: &PatchBatch,
        moments: &Moments,
        beginning: Init<'_>,
        seed: u64,
    ) -> Result<Self, InformationError> {
        NoiseEntropy::new(noise, Protocol::Default)?;
        check(sample.noisy.view())?;
        let start = match beginning {
            Init::Warm(start) if start.shape == shape && start.is_of(noise) => {
                let levels = Levels::spanning(start.noise, start.span);
                start.layout(levels.count()).map(|layout| (start, layout, levels))
            }
            _ => None,
        };
        let mut conditioning = Conditioning::new(noise, sample, moments)?;
        if let Some((start, _, levels)) = &start {
            let units = Units { roots: start.roots, photons: start.photons };
            conditioning = conditioning.in_units_of(units, &start.far, levels);
        }
        let mut model = Self::unfitted(shape, conditioning, sample, seed);
        if !matches!(beginning, Init::Random) {
            model.begin_as_shipped();
        }
        if let Some((start, layout, levels)) = &start {
            let conditioning = Arc::clone(&model.conditioning);
            let nodes: Vec<f32> = conditioning.roots_of(levels).collect();
            let places = among(&nodes, conditioning.roots_of(&conditioning.levels));
            let same_levels = levels.photons == conditioning.levels.photons;
            for (tensor, from) in model.layout.tensors().iter().zip(layout.tensors()) {
                let (own, start) = (&mut model.weights[tensor.range.clone()], &start.weights[from.range.clone()]);
                match tensor.name.as_str() {
                    "head.kernel" if !same_levels => carry(start, nodes.len(), &places, own),
                    // The frequencies of the levels are known for each design.
                    "head.bias" if !same_levels => own[places.len()] = start[nodes.len()],
                    _ => own.copy_from_slice(start),
                }
            }
        }
        Ok(model)
    }

    /// Takes the pretrained weights, where they have its shape.
    pub(super) fn begin_as_shipped(&mut self) {
        if let Some(first) = PretrainedWeights::shipped() {
            first.put_into(self);
        }
    }
}
