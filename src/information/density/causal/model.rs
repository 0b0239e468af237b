//! A fitted density model of one design's measurements.

use std::sync::Arc;

use ndarray::{Array3, ArrayView3, Axis};
use rayon::prelude::*;

use super::conditioning::{Conditioning, Inputs, Moments};
use super::network::Workspace;
use super::shape::{CausalShape, Layers};
use super::stream::PatchBatch;
use crate::information::density::gaussian::dense::MAX_PATCH_PIXELS;
use crate::information::entropy::noise_entropy::{NoiseEntropy, Protocol};
use crate::information::error::InformationError;
use crate::nn::{ParameterLayout, Pool, euclidean_norm, ordered_sum};
use crate::sensor::Noise;

/// Patches that are converted and scored at a time.
const GROUP: usize = 64;

/// A density of patches in raster order. Each pixel is a mixture of the noise around clean levels; a gated residual
/// network computes the weights from the pixels before it.
///
/// No density is narrower than the noise, and every level's likelihood sums to 1. The cross-entropy is therefore an
/// upper bound on the entropy of the measurements.
#[derive(Clone, Debug)]
pub struct CausalModel {
    pub(super) shape: CausalShape,
    pub(super) conditioning: Arc<Conditioning>,
    pub(super) layers: Layers,
    pub(super) layout: ParameterLayout,
    pub(super) weights: Vec<f32>,
    /// Workspaces for evaluation, shared with clones to avoid allocation for small batches.
    pub(super) workspaces: Arc<Workspaces>,
}

impl CausalModel {
    /// A model with random weights, before its fit.
    ///
    /// # Errors
    /// As [`CausalModel::new`].
    pub(super) fn random(
        shape: CausalShape,
        noise: Noise,
        sample: &PatchBatch,
        moments: &Moments,
        seed: u64,
    ) -> Result<Self, InformationError> {
        NoiseEntropy::new(noise, Protocol::Default)?;
        check(sample.noisy.view())?;
        Ok(Self::unfitted(shape, Conditioning::new(noise, sample, moments)?, sample, seed))
    }

    /// Random weights. The head's biases are the log frequencies of the levels in the sample.
    pub(super) fn unfitted(shape: CausalShape, conditioning: Conditioning, sample: &PatchBatch, seed: u64) -> Self {
        let (layers, layout) = shape.layers(conditioning.levels.count(), &conditioning.far);
        let mut weights = layout.draw(seed);
        let images = sample.clean.as_ref().unwrap_or(&sample.noisy);
        let bias = &mut weights[layers.head.bias.clone()];
        bias[..conditioning.levels.count()].copy_from_slice(&conditioning.levels.log_frequencies(images.view()));
        Self { shape, conditioning: Arc::new(conditioning), layers, layout, weights, workspaces: Arc::default() }
    }

    /// Rows and columns of the patches.
    pub fn patch(&self) -> (usize, usize) {
        self.conditioning.patch
    }

    /// Number of weights.
    pub fn weight_count(&self) -> usize {
        self.layout.count()
    }

    /// Largest excess of the estimate in bits per pixel, where the intensity grid is too coarse for the range of
    /// light; `None` for a fine grid.
    pub(in crate::information) fn looseness_bits(&self) -> Option<f64> {
        self.conditioning.levels.looseness()
    }

    /// Cross-entropy of every pixel, -log2 q(y | pixels before it), in bits; shape of the patches.
    ///
    /// # Errors
    /// For patches of another shape, or values that are not finite.
    pub fn cross_entropy_map(&self, patches: ArrayView3<'_, f32>) -> Result<Array3<f64>, InformationError> {
        self.check_shape(patches)?;
        let mut out = Array3::zeros(patches.dim());
        let pixels = self.conditioning.patch.0 * self.conditioning.patch.1;
        for (group, mut bits) in patches.axis_chunks_iter(Axis(0), GROUP).zip(out.axis_chunks_iter_mut(Axis(0), GROUP))
        {
            let inputs = self.conditioning.inputs(group);
            bits.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(index, mut bits)| {
                self.workspaces.with(self, |workspace| {
                    let inputs = inputs.patch(index, pixels);
                    workspace.forward(&self.layers, &self.weights, inputs);
                    workspace.score(&self.conditioning, inputs, 0.0);
                    for (bits, &nats) in bits.iter_mut().zip(&workspace.losses) {
                        *bits = f64::from(nats) / std::f64::consts::LN_2;
                    }
                });
            });
        }
        Ok(out)
    }

    /// Mean negative log-likelihood of patches, nats per pixel, and its gradient by the weights.
    ///
    /// # Errors
    /// As [`CausalModel::cross_entropy_map`].
    pub fn loss_and_gradient(&self, patches: ArrayView3<'_, f32>) -> Result<(f64, Vec<f32>), InformationError> {
        self.check_shape(patches)?;
        let inputs = self.conditioning.inputs(patches);
        let mut gradients = Gradients::new(self.layout.count());
        let indices: Vec<usize> = (0..patches.len_of(Axis(0))).collect();
        let loss = gradients.evaluate(self, &inputs, &indices);
        Ok((loss, gradients.total))
    }

    pub(super) fn check_shape(&self, patches: ArrayView3<'_, f32>) -> Result<(), InformationError> {
        let ((rows, cols), (_, found_rows, found_cols)) = (self.conditioning.patch, patches.dim());
        if (found_rows, found_cols) != (rows, cols) {
            return Err(InformationError::PatchShape { what: "patches", rows, cols, found_rows, found_cols });
        }
        check(patches)
    }
}

/// Checks that a patch, rows and columns in pixels, is not too large for the model, before thousands of them are
/// drawn.
///
/// # Errors
/// [`InformationError::PatchSize`].
pub fn check_causal_patch((rows, cols): (usize, usize)) -> Result<(), InformationError> {
    if !(1..=MAX_PATCH_PIXELS).contains(&rows.saturating_mul(cols)) {
        return Err(InformationError::PatchSize { rows, cols, limit: MAX_PATCH_PIXELS });
    }
    Ok(())
}

/// Checks that patches can be modelled.
pub(super) fn check(patches: ArrayView3<'_, f32>) -> Result<(), InformationError> {
    let (count, rows, cols) = patches.dim();
    check_causal_patch((rows, cols))?;
    if count == 0 {
        let (model, pixels) = ("a density model", rows * cols);
        return Err(InformationError::TooFewPatches { model, needed: 1, found: 0, pixels });
    }
    crate::information::density::patch_checks::check_values(patches, "patches")
}

/// Gradients of the loss of a batch, one part per patch, summed in order.
#[derive(Debug)]
pub(super) struct Gradients {
    workspaces: Workspaces,
    parts: Vec<(Vec<f32>, f64)>,
    /// Gradient of the mean loss by all weights.
    pub total: Vec<f32>,
}

impl Gradients {
    /// For a model of `count` weights.
    pub fn new(count: usize) -> Self {
        Self { workspaces: Workspaces::default(), parts: Vec::new(), total: vec![0.0; count] }
    }

    /// Returns the mean negative log-likelihood of the patches of these indices, nats per pixel; writes its gradient
    /// to [`Gradients::total`].
    pub fn evaluate(&mut self, model: &CausalModel, inputs: &Inputs, indices: &[usize]) -> f64 {
        let pixels = model.conditioning.patch.0 * model.conditioning.patch.1;
        let weight = 1.0 / (pixels * indices.len()) as f32;
        self.parts.resize_with(indices.len(), Default::default);
        let workspaces = &self.workspaces;
        self.parts.par_iter_mut().zip(indices).with_max_len(1).for_each(|((gradient, nats), &index)| {
            gradient.resize(model.layout.count(), 0.0);
            let inputs = inputs.patch(index, pixels);
            workspaces.with(model, |workspace| {
                workspace.forward(&model.layers, &model.weights, inputs);
                workspace.score(&model.conditioning, inputs, weight);
                *nats = workspace.losses.iter().map(|&loss| f64::from(loss.min(100.0))).sum();
                workspace.backward(&model.layers, &model.weights, inputs, Some(gradient));
            });
        });
        let parts: Vec<&[f32]> = self.parts.iter().map(|(gradient, _)| gradient.as_slice()).collect();
        ordered_sum(&parts, &mut self.total);
        self.parts.iter().map(|(_, nats)| nats).sum::<f64>() * f64::from(weight)
    }

    /// Euclidean norm of the gradient by all weights.
    pub fn norm(&self) -> f64 {
        euclidean_norm(&self.total)
    }
}

/// Memory of the threads, reused from patch to patch.
#[derive(Debug, Default)]
pub(super) struct Workspaces(Pool<Workspace>);

impl Workspaces {
    pub fn with<R>(&self, model: &CausalModel, work: impl FnOnce(&mut Workspace) -> R) -> R {
        let patch = model.conditioning.patch;
        let make = || Workspace::new(&model.shape, &model.layers, patch);
        self.0.with(|workspace| workspace.serves(&model.layers, patch), make, work)
    }
}

#[cfg(test)]
mod tests {
    use super::super::conditioning::TARGETS;
    use super::super::init::{CausalStart, Init};
    use super::*;

    /// Blobs of light on a dark ground.
    fn sample(noise: Noise, patch: (usize, usize)) -> PatchBatch {
        let clean = Array3::from_shape_fn((12, patch.0, patch.1), |(n, r, c)| {
            let distance = (r as f32 - (n * 5 % patch.0) as f32).hypot(c as f32 - (n * 3 % patch.1) as f32);
            10.0 + 80.0 * (-0.3 * distance * distance).exp()
        });
        PatchBatch { noisy: noise.draw(clean.view(), 5), clean: Some(clean) }
    }

    fn model(noise: Noise, patch: (usize, usize)) -> (CausalModel, Array3<f32>) {
        dilated(&[1, 2], noise, patch)
    }

    fn dilated(dilations: &[usize], noise: Noise, patch: (usize, usize)) -> (CausalModel, Array3<f32>) {
        let sample = sample(noise, patch);
        let moments = Moments::of_patches(sample.noisy.view()).unwrap();
        let shape = CausalShape { channels: 6, dilations: dilations.to_vec() };
        let mut model = CausalModel::new(shape, noise, &sample, &moments, Init::Random, 3).unwrap();
        // Away from the initial weights, where some gradients are 0.
        for (i, weight) in model.weights.iter_mut().enumerate() {
            *weight += 0.1 * ((i * 37 % 101) as f32 / 50.0 - 1.0);
        }
        (model, sample.noisy.slice_move(ndarray::s![..3, .., ..]))
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        let (model, patches) = model(Noise::Shot, (6, 7));
        let (_, gradient) = model.loss_and_gradient(patches.view()).unwrap();
        for tensor in model.layout.tensors() {
            // A direction for every tensor: one number tests all its entries.
            let direction: Vec<f32> = tensor.range.clone().map(|i| ((i * 29 % 83) as f32 / 41.0) - 1.0).collect();
            let expected: f64 =
                gradient[tensor.range.clone()].iter().zip(&direction).map(|(g, d)| f64::from(g * d)).sum();
            let moved = |by: f32| {
                let mut model = model.clone();
                for (weight, d) in model.weights[tensor.range.clone()].iter_mut().zip(&direction) {
                    *weight += by * d;
                }
                model.loss_and_gradient(patches.view()).unwrap().0
            };
            let step = 2e-3;
            let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
            assert!((slope - expected).abs() < 2e-3 * expected.abs() + 2e-4, "{}: {slope} {expected}", tensor.name);
        }
    }

    #[test]
    fn targets_replace_the_measured_values_in_the_loss() {
        let (mut model, patches) = model(Noise::Shot, (6, 7));
        let clean = patches.mapv(|y| y + 3.0);
        // With this weight of the linear prediction, unexpected values are almost impossible.
        model.weights[model.layers.head.bias.end - 1] = 2.0;
        let of = |targets: &[f32]| {
            let mut inputs = model.conditioning.inputs(patches.view());
            inputs.targets = targets.to_vec();
            let mut gradients = Gradients::new(model.layout.count());
            let loss = gradients.evaluate(&model, &inputs, &[0, 1, 2]);
            (loss, gradients.total)
        };
        // One of them is so unlikely that it is summed in double precision.
        let mut first = Noise::Shot.draw(clean.view(), 1).into_raw_vec_and_offset().0;
        first[8] = 120.0;
        let second = Noise::Shot.draw(clean.view(), 2).into_raw_vec_and_offset().0;
        let both: Vec<f32> = first.iter().zip(&second).flat_map(|(one, other)| [*one, *other]).collect();
        let (one, other, both) = (of(&first), of(&second), of(&both));
        assert!((both.0 - f64::midpoint(one.0, other.0)).abs() < 1e-5 * one.0, "{} {} {}", both.0, one.0, other.0);
        assert!(one.0 != other.0 && of(&[]).0 != one.0);
        for ((both, one), other) in both.1.iter().zip(one.1).zip(other.1) {
            assert!((both - f32::midpoint(one, other)).abs() < 1e-5, "{both} {one} {other}");
        }
        let targets = model.conditioning.targets(clean.view(), 4);
        assert_eq!(targets.len(), TARGETS * clean.len());
        let sum = targets.iter().map(|&y| f64::from(y)).sum::<f64>() / TARGETS as f64;
        let mean = clean.iter().map(|&x| f64::from(x)).sum::<f64>();
        assert!((sum - mean).abs() < 4.0 * (mean / TARGETS as f64).sqrt(), "{sum} {mean}");
    }

    #[test]
    fn density_depends_on_past_pixels_only() {
        // The last dilation is as wide as the program's, so that the farthest taps lie within the patch.
        let all = CausalShape::default().dilations;
        let cases: [(Noise, &[usize], _); 3] = [
            (Noise::Shot, &[1, 2], (5, 6)),
            (Noise::Read { sigma: 3.0 }, &[1, 2], (5, 6)),
            (Noise::Shot, &all, (12, 20)),
        ];
        for (noise, dilations, (rows, cols)) in cases {
            let (model, patches) = dilated(dilations, noise, (rows, cols));
            let (patch, pixels) = (patches.slice(ndarray::s![..1, .., ..]).to_owned(), rows * cols);
            let outputs = |patch: &Array3<f32>| -> Vec<f32> {
                let inputs = model.conditioning.inputs(patch.view());
                let mut workspace = Workspace::new(&model.shape, &model.layers, model.patch());
                let out = workspace.forward(&model.layers, &model.weights, inputs.patch(0, pixels)).to_vec();
                // The weights of the levels depend on the linear prediction as well.
                let guesses = inputs.guess.iter().flat_map(|&(mean, half)| [mean, half]);
                out.into_iter().chain(guesses).collect()
            };
            let before = outputs(&patch);
            let levels = model.layers.head.outputs;
            let mut seen = 0;
            for moved in 0..pixels {
                let mut patch = patch.clone();
                patch[(0, moved / cols, moved % cols)] += 40.0;
                let after = outputs(&patch);
                let past = (moved + 1) * levels;
                assert_eq!(before[..past], after[..past], "{noise} pixel {moved}");
                let guesses = pixels * levels..pixels * levels + 2 * (moved + 1);
                assert_eq!(before[guesses.clone()], after[guesses], "{noise} pixel {moved}");
                seen += usize::from(before[past..pixels * levels] != after[past..pixels * levels]);
            }
            assert_eq!(seen, pixels - 1, "every pixel but the last is seen by later ones");
        }
    }

    #[test]
    fn mean_of_map_equals_loss() {
        let (model, patches) = model(Noise::ShotRead { sigma: 1.5 }, (5, 6));
        let map = model.cross_entropy_map(patches.view()).unwrap();
        let (loss, _) = model.loss_and_gradient(patches.view()).unwrap();
        assert!((map.mean().unwrap() * std::f64::consts::LN_2 - loss).abs() < 1e-5);
        let wrong = Array3::zeros((2, 5, 5));
        assert!(matches!(model.cross_entropy_map(wrong.view()), Err(InformationError::PatchShape { .. })));
    }

    #[test]
    fn unexpected_values_have_finite_density() {
        let (model, mut patches) = model(Noise::Shot, (5, 6));
        let before = model.cross_entropy_map(patches.view()).unwrap();
        patches[(0, 2, 2)] = 5000.0;
        let after = model.cross_entropy_map(patches.view()).unwrap();
        assert!(after.iter().all(|bits| bits.is_finite()));
        assert!(after[(0, 2, 2)] > before[(0, 2, 2)] + 1000.0);
    }

    #[test]
    fn warm_start_equals_the_first_model() {
        let (first, _) = model(Noise::Shot, (6, 6));
        let sample = sample(Noise::Shot, (6, 6));
        let moments = Moments::of_patches(sample.noisy.view()).unwrap();
        let start = CausalStart::from(&first);
        let again =
            CausalModel::new(first.shape.clone(), Noise::Shot, &sample, &moments, Init::Warm(&start), 9).unwrap();
        assert_eq!(again.weights, first.weights);
        assert_eq!(again.conditioning.levels.photons, first.conditioning.levels.photons);
        let fresh = CausalModel::new(first.shape.clone(), Noise::Shot, &sample, &moments, Init::Random, 9).unwrap();
        assert_ne!(fresh.weights, first.weights);
    }
}
