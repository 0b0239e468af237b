//! Pretrained weights for many encoders and scenes.

use std::sync::LazyLock;
use std::time::{Duration, Instant};

use ndarray::Axis;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::conditioning::{FAR_PLACES, Inputs, Moments, NOWHERE};
use super::fit::{BATCH, MAX_NORM, RATE};
use super::level_interpolation::{among, carry, carry_back};
use super::model::{CausalModel, Gradients};
use super::shape::{CausalShape, rule};
use super::stream::PatchBatch;
use crate::information::error::InformationError;
use crate::nn::{
    Averaging, Optimizer, ParameterLayout, WeightsHeader, learning_rate_factor, read_details, read_weights,
    write_weights,
};
use crate::progress::Progress;
use crate::sensor::Noise;

/// Weights of the program.
const SHIPPED: &[u8] = include_bytes!("../../../../assets/first_density_model.safetensors");
/// Header of the file.
const HEADER: WeightsHeader<'_> = WeightsHeader { format: "lenslet-studio/first-density-model", version: 1 };
/// Number and range of the knots between which the weights of levels are interpolated: distances from the mean of the
/// roots of photons, in their standard deviations. They are evenly spaced in the inverse hyperbolic sine.
const KNOTS: usize = 96;
const REACH: (f32, f32) = (-4.0, 60.0);
/// Scenes in use at a time; each is replaced once all its patches have been used.
const SCENES: usize = 16;
/// Steps over which the reported cross-entropy is averaged.
const REMEMBERED: f64 = 2000.0;

/// Measurements of one scene through one encoder.
#[derive(Clone, Debug)]
pub struct TrainingScene {
    /// Noise of the sensor.
    pub noise: Noise,
    /// Patches to fit.
    pub patches: PatchBatch,
    /// Second moments of the measurements.
    pub moments: Moments,
}

/// Progress of a fit of [`PretrainedWeights`].
#[derive(Clone, Copy, Debug, Default)]
pub struct PretrainProgress {
    /// Steps so far.
    pub steps: usize,
    /// Scenes so far.
    pub scenes: u64,
    /// Running mean of the cross-entropy, bits per pixel.
    pub bits: f64,
    /// Time so far.
    pub elapsed: Duration,
}

/// A step of a fit of [`PretrainedWeights`], reported after it.
pub struct PretrainStep<'a> {
    /// Progress of the fit.
    pub progress: PretrainProgress,
    weights: &'a dyn Fn() -> PretrainedWeights,
}

impl PretrainStep<'_> {
    /// The weights as if the fit ended here.
    pub fn weights(&self) -> PretrainedWeights {
        (self.weights)()
    }
}

/// Pretrained weights for models of any design. The weights of the head are interpolated between knots over the standardised
/// roots of photons, since the intensity grid differs between designs.
#[derive(Clone, Debug)]
pub struct PretrainedWeights {
    shape: CausalShape,
    layout: ParameterLayout,
    weights: Vec<f32>,
}

impl PretrainedWeights {
    /// Weights of the program, fitted to beads and drawn images through many encoders; `None` in a program built without
    /// weights of this version.
    pub fn shipped() -> Option<&'static Self> {
        static WEIGHTS: LazyLock<Option<PretrainedWeights>> =
            LazyLock::new(|| PretrainedWeights::from_bytes(SHIPPED).ok());
        WEIGHTS.as_ref()
    }

    /// Random weights.
    pub fn new(seed: u64) -> Self {
        let shape = CausalShape::default();
        let (_, layout) = shape.layers(KNOTS, &[NOWHERE; FAR_PLACES]);
        let weights = layout.draw(seed);
        Self { shape, layout, weights }
    }

    /// The bytes of a safetensors file.
    ///
    /// # Errors
    /// Where the weights fit no file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, InformationError> {
        Ok(write_weights(&self.layout, &self.weights, &HEADER, Vec::new())?)
    }

    /// Reads the bytes of [`PretrainedWeights::to_bytes`].
    ///
    /// # Errors
    /// For bytes of another format, another shape or a newer version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, InformationError> {
        read_details(bytes, &HEADER)?;
        let drawn = Self::new(0);
        let weights = read_weights(&drawn.layout, bytes)?;
        Ok(Self { weights, ..drawn })
    }

    /// Copies the weights into a model of the same shape, whose level frequencies stay. A model of another shape
    /// stays unchanged.
    pub(super) fn put_into(&self, model: &mut CausalModel) {
        if model.shape != self.shape {
            return;
        }
        let knots = knots(model);
        for (tensor, from) in model.layout.tensors().iter().zip(self.layout.tensors()) {
            let (own, first) = (&mut model.weights[tensor.range.clone()], &self.weights[from.range.clone()]);
            match tensor.name.as_str() {
                "head.kernel" => carry(first, KNOTS, &knots, own),
                "head.bias" => own[knots.len()] = first[KNOTS],
                _ => own.copy_from_slice(first),
            }
        }
    }

    /// The gradient by these weights from that by those of a model that they were [put into](Self::put_into).
    fn gradient(&self, model: &CausalModel, by_model: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; self.weights.len()];
        let knots = knots(model);
        for (tensor, to) in model.layout.tensors().iter().zip(self.layout.tensors()) {
            let (own, first) = (&by_model[tensor.range.clone()], &mut out[to.range.clone()]);
            match tensor.name.as_str() {
                "head.kernel" => carry_back(own, &knots, KNOTS, first),
                "head.bias" => first[KNOTS] = own[knots.len()],
                _ => first.copy_from_slice(own),
            }
        }
        out
    }

    /// Fits the weights to many scenes at once, for a given time and at least one step; `scene` makes a scene from
    /// its number. The weights become the average over the last steps.
    ///
    /// # Errors
    /// Where a scene is invalid; when `on_step` cancels.
    pub fn fit(
        &mut self,
        scene: &(dyn Fn(u64) -> Result<TrainingScene, InformationError> + Sync),
        length: Duration,
        seed: u64,
        on_step: &mut dyn for<'a> Progress<PretrainStep<'a>>,
    ) -> Result<(), InformationError> {
        let started = Instant::now();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut optimizer = Optimizer::new(&self.layout, &self.weights, Averaging::LAST_TENTH, rule);
        let mut progress = PretrainProgress::default();
        loop {
            let next: Vec<(u64, u64)> =
                (progress.scenes..progress.scenes + SCENES as u64).map(|number| (number, random.random())).collect();
            let fitted = next.into_par_iter().map(|(number, seed)| Fitted::new(&self.shape, &scene(number)?, seed));
            let mut fitted = fitted.collect::<Result<Vec<_>, _>>()?;
            progress.scenes += SCENES as u64;
            let mut order: Vec<(usize, usize)> =
                (0..SCENES).flat_map(|scene| (0..fitted[scene].steps()).map(move |step| (scene, step))).collect();
            order.shuffle(&mut random);
            for (scene, step) in order {
                progress.elapsed = started.elapsed();
                let done = progress.elapsed.as_secs_f64() / length.as_secs_f64().max(1e-9);
                // Steps without finite numbers are skipped.
                if let Some((loss, gradient, scale)) = fitted[scene].gradient(self, step) {
                    optimizer.step(&mut self.weights, &gradient, scale, (RATE * learning_rate_factor(done)) as f32);
                    progress.steps += 1;
                    let bits = loss / std::f64::consts::LN_2;
                    progress.bits += (bits - progress.bits) / REMEMBERED.min(progress.steps as f64);
                }
                if done >= 1.0 {
                    self.weights = optimizer.result(&self.weights).to_vec();
                    return Ok(());
                }
                let snapshot = || Self { weights: optimizer.result(&self.weights).to_vec(), ..self.clone() };
                if on_step.report(&PretrainStep { progress, weights: &snapshot }).is_break() {
                    return Err(InformationError::Cancelled);
                }
            }
        }
    }
}

/// A scene prepared for the fit.
struct Fitted {
    model: CausalModel,
    inputs: Inputs,
    gradients: Gradients,
    patches: usize,
}

impl Fitted {
    fn new(shape: &CausalShape, scene: &TrainingScene, seed: u64) -> Result<Self, InformationError> {
        let TrainingScene { noise, patches, moments } = scene;
        let model = CausalModel::random(shape.clone(), *noise, patches, moments, 0)?;
        let mut inputs = model.conditioning.inputs(patches.noisy.view());
        if let Some(clean) = &patches.clean {
            inputs.targets = model.conditioning.targets(clean.view(), seed);
        }
        let gradients = Gradients::new(model.layout.count());
        Ok(Self { gradients, inputs, patches: patches.noisy.len_of(Axis(0)), model })
    }

    /// Steps of one pass through its patches.
    fn steps(&self) -> usize {
        self.patches / BATCH
    }

    /// Loss of the patches of a step (nats per pixel), its gradient by the weights, and the factor that shortens long
    /// gradients; `None` where they are not finite.
    fn gradient(&mut self, weights: &PretrainedWeights, step: usize) -> Option<(f64, Vec<f32>, f32)> {
        weights.put_into(&mut self.model);
        let indices: Vec<usize> = (step * BATCH..(step + 1) * BATCH).collect();
        let loss = self.gradients.evaluate(&self.model, &self.inputs, &indices);
        let norm = self.gradients.norm();
        let scale = (MAX_NORM / norm.max(1e-30)).min(1.0) as f32;
        let finite = loss.is_finite() && norm.is_finite();
        finite.then(|| (loss, weights.gradient(&self.model, &self.gradients.total), scale))
    }
}

/// Positions of the levels of a model among the knots.
fn knots(model: &CausalModel) -> Vec<(usize, f32)> {
    let (first, last) = (REACH.0.asinh(), REACH.1.asinh());
    let knots: Vec<f32> = (0..KNOTS).map(|knot| first + (last - first) * knot as f32 / (KNOTS - 1) as f32).collect();
    among(&knots, model.conditioning.roots_of(&model.conditioning.levels).map(f32::asinh))
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::super::init::Init;
    use super::*;
    use ndarray::Array3;

    /// Spots of two kinds on a ground.
    fn scene(number: u64) -> TrainingScene {
        let clean = Array3::from_shape_fn((40, 12, 12), |(n, r, c)| {
            let (row, col) = ((n * 7 + number as usize) % 12, n * 5 % 12);
            let distance = (r as f32 - row as f32).hypot(c as f32 - col as f32);
            10.0 + if n % 2 == 0 { 60.0 } else { 200.0 } * (-0.4 * distance * distance).exp()
        });
        let noisy = Noise::Shot.draw(clean.view(), number);
        let moments = Moments::of_patches(noisy.view()).unwrap();
        TrainingScene { noise: Noise::Shot, patches: PatchBatch { noisy, clean: Some(clean) }, moments }
    }

    fn model(beginning: Init<'_>) -> CausalModel {
        let TrainingScene { noise, patches, moments } = scene(3);
        CausalModel::new(CausalShape::default(), noise, &patches, &moments, beginning, 7).unwrap()
    }

    #[test]
    fn gradient_matches_the_interpolated_weights() {
        let mut own = model(Init::Random);
        let first = PretrainedWeights::new(1);
        first.put_into(&mut own);
        let by_model: Vec<f32> = (0..own.weights.len()).map(|i| ((i * 37 % 101) as f32 - 50.0) * 0.01).collect();
        let gradient = first.gradient(&own, &by_model);
        // Copying into a model is linear: along any change both gradients agree.
        let mut changed = first.clone();
        let change: Vec<f32> = (0..first.weights.len()).map(|i| ((i * 53 % 89) as f32 - 44.0) * 0.01).collect();
        changed.weights.iter_mut().zip(&change).for_each(|(weight, change)| *weight += change);
        let before = own.weights.clone();
        changed.put_into(&mut own);
        let moved = own.weights.iter().zip(&before).zip(&by_model);
        let moved: f64 = moved.map(|((after, before), by)| f64::from(after - before) * f64::from(*by)).sum();
        let expected: f64 = gradient.iter().zip(&change).map(|(by, change)| f64::from(*by) * f64::from(*change)).sum();
        assert!((moved - expected).abs() < 1e-3 * expected.abs().max(1.0), "{moved} {expected}");
        // The frequencies of the levels are known for each design.
        let bias = own.layers.head.bias.clone();
        let levels = own.conditioning.levels.count();
        assert_eq!(own.weights[bias.clone()][..levels], model(Init::Random).weights[bias][..levels]);
    }

    #[test]
    fn pretrained_weights_beat_random_ones_on_a_new_scene() {
        let patches = scene(11).patches.noisy;
        let bits = |beginning| model(beginning).cross_entropy_map(patches.view()).unwrap().mean().unwrap();
        let (shipped, drawn) = (bits(Init::Pretrained), bits(Init::Random));
        assert!(shipped < drawn - 0.02, "{shipped} {drawn}");
    }

    #[test]
    fn pretraining_lowers_cross_entropy_and_saves_its_weights() {
        let mut weights = PretrainedWeights::new(2);
        let (mut early, mut late, mut kept) = (0.0, f64::INFINITY, None);
        let fitted =
            weights.fit(&|number| Ok(scene(number)), Duration::from_hours(1), 3, &mut |step: &PretrainStep<'_>| {
                let progress = &step.progress;
                match progress.steps {
                    10 => early = progress.bits,
                    // 16 scenes of 20 steps each.
                    321 => assert_eq!(progress.scenes, 32),
                    ..400 => {}
                    _ => {
                        (late, kept) = (progress.bits, Some(step.weights()));
                        return ControlFlow::Break(());
                    }
                }
                ControlFlow::Continue(())
            });
        assert!(matches!(fitted, Err(InformationError::Cancelled)));
        assert!(late < early - 0.05, "{late} {early}");
        let kept = kept.unwrap();
        let bytes = kept.to_bytes().unwrap();
        assert_eq!(PretrainedWeights::from_bytes(&bytes).unwrap().weights, kept.weights);
        assert!(PretrainedWeights::from_bytes(&bytes[..bytes.len() / 2]).is_err());
    }
}
