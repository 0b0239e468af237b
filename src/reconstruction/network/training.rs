//! Training of the network: fresh objects and noise in every step, validation on images that take no part in it.

use std::sync::Arc;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::batches::{BATCH, Batches, Draw, Sample, samples};
use super::features::{CHANNELS, Features, deviation_of, padded};
use super::layers::Layers;
use super::masks::{TrainingMasks, random_psf};
use super::trained::TrainedNetwork;
use super::unet::{Activations, Ready, check_memory};
use crate::information::FitCheckpoint;
use crate::nn::{Averaging, Optimizer, cosine_factor, ordered_sum};
use crate::objects::{ObjectSet, Split};
use crate::progress::{CancelToken, Progress};
use crate::reconstruction::decoder::DecoderKind;
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::linear::Prior;
use crate::reconstruction::protocol::DecoderScene;
use crate::reconstruction::quality::psnr_db;
use crate::reconstruction::training_checkpoint::{Restored, TrainingArrays, TrainingCheckpoint};
use crate::reconstruction::training_record::{NetworkMask, TrainingPoint, TrainingRecord};
use crate::seeds::SeedStream;

/// Rate of the kernels that Muon updates.
const RATE: f32 = 6e-3;
/// Factor of the mean squared error whose gradient is clipped.
const LOSS_FACTOR: f32 = 30.0;
/// Largest norm of the gradient.
const CLIP: f32 = 1.0;
/// Share of a loss in the recent loss.
const RECENT: f64 = 0.02;
/// Steps before the recent loss can show divergence.
const STEPS_BEFORE_CHECK: usize = 50;
/// Recent loss relative to that of the linear estimate that counts as divergence.
const DIVERGED: f64 = 1.05;
/// Steps between validations.
const STEPS_PER_VALIDATION: usize = 100;
/// Validation objects of one mask, and of each of several.
const VALIDATION_OBJECTS: usize = 64;
const VALIDATION_OBJECTS_PER_MASK: usize = 16;
/// Masks that a network for any mask is validated on.
const VALIDATION_MASKS: usize = 4;

/// When training ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrainingBudget {
    /// After this time of work, seconds. Results depend on the speed of the machine.
    Seconds(f64),
    /// After this number of steps. Equal seeds give equal weights.
    Steps(usize),
}

impl TrainingBudget {
    /// Share of the budget after a number of steps and this time of work, seconds.
    pub(in crate::reconstruction) fn done(self, steps: usize, seconds: f64) -> f64 {
        match self {
            Self::Seconds(budget) => seconds / budget.max(1e-3),
            Self::Steps(budget) => steps as f64 / budget.max(1) as f64,
        }
    }
}

/// Progress of training, reported after each step.
#[derive(Clone, Debug)]
pub struct TrainingStep {
    /// Steps so far.
    pub steps: usize,
    /// Share of the budget, 0 to 1.
    pub done: f64,
    /// Seconds of work so far.
    pub seconds: f64,
    /// Steps in a second of work.
    pub steps_per_second: f64,
    /// Mean squared error of recent training objects, in units of the squared peak.
    pub loss: f64,
    /// That of the linear estimate of the same objects.
    pub linear_loss: Option<f64>,
    /// PSNR of the linear estimate on the validation objects, dB.
    pub linear_psnr_db: Option<f64>,
    /// The latest validation.
    pub validation: Option<TrainingPoint>,
    /// Number of times that training diverged and resumed from averaged weights at half the rate.
    pub restarts: usize,
    /// The network of the best weights so far, on top of the linear estimate; none before the first validation.
    pub best: Option<Arc<TrainedNetwork>>,
}

/// Training of a network on top of the linear estimate.
///
/// The network is a residual U-net of 664 k weights. It sees the linear estimate, its standard deviation, the mean object, the
/// back-projected residual and the coverage, and adds to the linear estimate. A tenth of the training images takes no part and decides
/// which weights are kept; where none are better than the linear estimate, that is kept. Where images are few, the prior is learned from
/// one half of them and the network from the other, and the reverse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkTraining {
    /// When training ends.
    pub budget: TrainingBudget,
    /// Seed of weights, objects and noise.
    pub seed: u64,
}

impl NetworkTraining {
    /// Trains a network for the objects of a scene, from the weights of `start` where there are any.
    ///
    /// `progress` receives each step. Training pauses until it returns; the pause does not count as work. With a `keeper` a stopped training
    /// resumes where it was.
    ///
    /// # Errors
    /// [`ReconstructionError`] where there are too few images, where mask and field do not fit, and where `start` is of other objects;
    /// [`ReconstructionError::Cancelled`] after the object of a step, or the part of the preparation, that is at work.
    pub fn train(
        &self,
        scene: &DecoderScene,
        masks: &TrainingMasks,
        start: Option<&TrainedNetwork>,
        keeper: Option<&dyn FitCheckpoint>,
        cancel: &CancelToken,
        progress: &mut dyn Progress<TrainingStep>,
    ) -> Result<TrainedNetwork, ReconstructionError> {
        let mask = match masks {
            TrainingMasks::One(model) => NetworkMask::of(model),
            TrainingMasks::Any { psf } => NetworkMask::Any { psf: *psf },
        };
        check_memory(scene.set.field(), BATCH)?;
        TrainingRecord::check_images(scene, DecoderKind::Network)?;
        let seed = SeedStream::ReconstructionNetwork.derive(self.seed);
        let deviation = match start {
            Some(start) => {
                start.training.check_scene(scene)?;
                start.deviation
            }
            None => deviation_of(&scene.set)?,
        };
        let training = (*scene.set).clone().of_training();
        let mut batches = Batches::new((scene, &training), masks, (deviation, seed), cancel)?;
        let validation = Validation::new((scene, &training), masks, (deviation, seed), cancel)?;
        let layers = Layers::new(CHANNELS);
        let weights = match start {
            Some(start) => start.weights.clone(),
            None => layers.layout.draw(seed),
        };
        let mut run = Run::new(&layers, scene, weights);
        let mut checkpoint = TrainingCheckpoint::new(keeper);
        let restored = checkpoint.restore(&mut run.weights, &mut run.optimizer)?;
        let (mut best, mut curve) = match restored {
            Some(Restored { steps, best, counters }) => {
                let Counters { curve, best_psnr_db, .. } = run.resume(steps, counters);
                batches.skip(steps, cancel)?;
                (Best { weights: best, psnr_db: best_psnr_db }, curve)
            }
            None => (Best::new(&validation, &run, cancel)?, Vec::new()),
        };
        let mut trained = None;
        let mut done = self.budget.done(run.steps, run.seconds);
        while done < 1.0 {
            let started = Instant::now();
            let batch = batches.next(cancel)?;
            run.step(&batch, done, cancel)?;
            done = self.budget.done(run.steps, run.seconds + started.elapsed().as_secs_f64());
            if run.steps.is_multiple_of(STEPS_PER_VALIDATION) || done >= 1.0 {
                let psnr_db = best.validate(&validation, &run, cancel)?;
                let seconds = run.seconds + started.elapsed().as_secs_f64();
                curve.push(TrainingPoint { steps: run.steps, seconds, psnr_db });
                let record = TrainingRecord::new(scene, mask.clone(), self.seed);
                let curve = curve.clone();
                trained = Some(Arc::new(TrainedNetwork {
                    training: TrainingRecord { steps: run.steps, seconds, psnr_db: best.psnr_db, curve, ..record },
                    linear_psnr_db: validation.linear_psnr_db,
                    deviation,
                    weights: best.weights.clone(),
                }));
            }
            run.seconds += started.elapsed().as_secs_f64();
            let step = TrainingStep {
                steps: run.steps,
                done: done.min(1.0),
                seconds: run.seconds,
                steps_per_second: run.steps as f64 / run.seconds.max(1e-9),
                loss: run.recent.map_or(0.0, |recent| recent.loss),
                linear_loss: run.recent.map(|recent| recent.linear),
                linear_psnr_db: Some(validation.linear_psnr_db),
                validation: curve.last().copied(),
                restarts: run.restarts,
                best: trained.clone(),
            };
            let is_stopped = progress.report(&step).is_break() || cancel.is_cancelled();
            if done < 1.0 && (is_stopped || checkpoint.is_due()) {
                let Run { weights, optimizer, steps, .. } = &run;
                let arrays = TrainingArrays { weights, optimizer, best: &best.weights };
                checkpoint.keep(arrays, *steps, &run.counters(&curve, best.psnr_db))?;
            }
            if is_stopped {
                return Err(ReconstructionError::Cancelled);
            }
        }
        // The last step is validated.
        trained.map(Arc::unwrap_or_clone).ok_or(ReconstructionError::Cancelled)
    }
}

/// What a checkpoint holds beside weights and optimizer.
#[derive(Serialize, Deserialize)]
struct Counters {
    rate: f32,
    seconds: f64,
    restarts: usize,
    recent: Option<Recent>,
    best_psnr_db: f64,
    curve: Vec<TrainingPoint>,
}

/// Recent mean squared errors, in units of the squared peak.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Recent {
    loss: f64,
    linear: f64,
    steps: usize,
}

/// Weights on their way.
struct Run<'a> {
    layers: &'a Layers,
    weights: Vec<f32>,
    optimizer: Optimizer,
    field: (usize, usize),
    peak: f64,
    /// Images and gradient of each object of a batch.
    memory: Vec<(Activations, Vec<f32>)>,
    gradient: Vec<f32>,
    rate: f32,
    steps: usize,
    seconds: f64,
    restarts: usize,
    recent: Option<Recent>,
}

/// Squared errors of an object, sums over its pixels, photons squared.
struct Errors {
    network: f64,
    linear: f64,
}

impl<'a> Run<'a> {
    fn new(layers: &'a Layers, scene: &DecoderScene, weights: Vec<f32>) -> Self {
        let field = scene.set.field();
        let memory = || (Activations::new(layers, padded(field)), vec![0.0; weights.len()]);
        Self {
            optimizer: optimizer(layers, &weights),
            field,
            peak: scene.set.peak(),
            memory: (0..BATCH).map(|_| memory()).collect(),
            gradient: vec![0.0; weights.len()],
            rate: RATE,
            steps: 0,
            seconds: 0.0,
            restarts: 0,
            recent: None,
            layers,
            weights,
        }
    }

    /// Restores the counters after a number of steps. Weights and optimizer are restored before.
    fn resume(&mut self, steps: usize, counters: Counters) -> Counters {
        let Counters { rate, seconds, restarts, recent, .. } = counters;
        (self.steps, self.rate, self.seconds) = (steps, rate, seconds);
        (self.restarts, self.recent) = (restarts, recent);
        counters
    }

    fn counters(&self, curve: &[TrainingPoint], best_psnr_db: f64) -> Counters {
        let &Self { rate, seconds, restarts, recent, .. } = self;
        Counters { rate, seconds, restarts, recent, best_psnr_db, curve: curve.to_vec() }
    }

    /// The averaged weights.
    fn averaged(&self) -> &[f32] {
        self.optimizer.result(&self.weights)
    }

    /// One step after a share `done` of the budget. A cancelled one changes no weights.
    fn step(&mut self, batch: &[Sample], done: f64, cancel: &CancelToken) -> Result<(), ReconstructionError> {
        let ready = Ready::new(self.layers, &self.weights);
        let (field, count) = (self.field, (batch.len() * self.field.0 * self.field.1) as f32);
        let pairs = batch.par_iter().zip(self.memory.par_iter_mut()).with_max_len(1);
        let errors: Option<Vec<Errors>> = pairs
            .map(|(sample, (memory, gradient))| {
                if cancel.is_cancelled() {
                    return None;
                }
                ready.forward(&sample.example.image, memory);
                let mut by_result = std::mem::take(&mut memory.result);
                let errors = errors_of(sample, field, padded(field).1, &mut by_result, LOSS_FACTOR / count);
                ready.backward(&by_result, gradient, memory);
                memory.result = by_result;
                Some(errors)
            })
            .collect();
        let errors = errors.ok_or(ReconstructionError::Cancelled)?;
        drop(ready);
        let parts: Vec<&[f32]> = self.memory.iter().map(|(_, gradient)| gradient.as_slice()).collect();
        ordered_sum(&parts, &mut self.gradient);
        let square: f64 = self.gradient.iter().map(|&value| f64::from(value).powi(2)).sum();
        let scale = CLIP / (square.sqrt() as f32).max(CLIP);
        let scaled = f64::from(count) * self.peak * self.peak;
        let sum = |error: fn(&Errors) -> f64| errors.iter().map(error).sum::<f64>() / scaled;
        self.steps += 1;
        let has_diverged = !square.is_finite() || self.note(sum(|error| error.network), sum(|error| error.linear));
        if has_diverged {
            self.restart();
            return Ok(());
        }
        let rate = self.rate * cosine_factor(done) as f32;
        self.optimizer.step(&mut self.weights, &self.gradient, scale, rate);
        Ok(())
    }

    /// Adds the losses of a step to the recent ones; whether training diverges.
    fn note(&mut self, loss: f64, linear: f64) -> bool {
        let recent = match self.recent {
            None => Recent { loss, linear, steps: 1 },
            Some(recent) => Recent {
                loss: recent.loss + RECENT * (loss - recent.loss),
                linear: recent.linear + RECENT * (linear - recent.linear),
                steps: recent.steps + 1,
            },
        };
        self.recent = Some(recent);
        recent.steps > STEPS_BEFORE_CHECK && recent.loss > DIVERGED * recent.linear
    }

    /// Resumes from the averaged weights at half the rate, or from new weights where these are not finite.
    fn restart(&mut self) {
        self.restarts += 1;
        self.rate *= 0.5;
        self.recent = None;
        let averaged = self.averaged().to_vec();
        self.weights = if averaged.iter().all(|weight| weight.is_finite()) {
            averaged
        } else {
            self.layers.layout.draw(self.restarts as u64)
        };
        self.optimizer = optimizer(self.layers, &self.weights);
    }
}

fn optimizer(layers: &Layers, weights: &[f32]) -> Optimizer {
    Optimizer::new(&layers.layout, weights, Averaging::LAST_TENTH, Layers::rule)
}

/// Squared errors of a result of the network; turns the result into the gradient of `factor` times their sum, in squared units of the
/// network.
fn errors_of(
    Sample { example, truth, unit }: &Sample,
    (rows, cols): (usize, usize),
    padded_cols: usize,
    result: &mut [f32],
    factor: f32,
) -> Errors {
    let mut errors = Errors { network: 0.0, linear: 0.0 };
    for (row, line) in result.chunks_exact_mut(padded_cols).enumerate() {
        let within = if row < rows { cols } else { 0 };
        let (inside, outside) = line.split_at_mut(within);
        outside.fill(0.0);
        let (mut network, mut linear_sum) = (0.0, 0.0);
        for (col, value) in inside.iter_mut().enumerate() {
            let at = row * cols + col;
            let missing = truth[at] - example.linear[at];
            let error = *value - missing / unit;
            network += error * error;
            linear_sum += missing * missing;
            *value = 2.0 * factor * error;
        }
        errors.network += f64::from(network) * f64::from(*unit).powi(2);
        errors.linear += f64::from(linear_sum);
    }
    errors
}

/// Objects that take no part in training, measured and estimated once.
struct Validation {
    samples: Vec<Sample>,
    peak: f32,
    field: (usize, usize),
    linear_psnr_db: f64,
}

impl Validation {
    fn new(
        (scene, training): (&DecoderScene, &ObjectSet),
        masks: &TrainingMasks,
        (deviation, seed): (f64, u64),
        cancel: &CancelToken,
    ) -> Result<Self, ReconstructionError> {
        let prior = Arc::new(Prior::learn(training, scene.light, cancel)?);
        let seed = SeedStream::Block { index: 1 }.derive(seed);
        let models = match masks {
            TrainingMasks::One(model) => vec![model.clone()],
            TrainingMasks::Any { psf } => {
                let mut random = ChaCha8Rng::seed_from_u64(seed);
                let model = |_| scene.model(random_psf(*psf, &mut random)?.view());
                (0..VALIDATION_MASKS).map(model).collect::<Result<_, _>>()?
            }
        };
        let count = if models.len() == 1 { VALIDATION_OBJECTS } else { VALIDATION_OBJECTS_PER_MASK };
        let mut all = Vec::new();
        for (index, model) in models.iter().enumerate() {
            let features = Features::new(model, &prior, (deviation, scene.set.mean()), cancel)?;
            let draw = Draw { set: training, split: Split::Test, first: index * count, count, seed };
            all.extend(samples(scene, draw, &features, cancel)?);
        }
        let (field, peak) = (scene.set.field(), scene.set.peak() as f32);
        let mut validation = Self { samples: all, peak, field, linear_psnr_db: 0.0 };
        validation.linear_psnr_db = validation.psnr_db(None, cancel)?;
        Ok(validation)
    }

    /// PSNR of clipped estimates: of a network, or of the linear estimate.
    fn psnr_db(&self, network: Option<&Ready<'_>>, cancel: &CancelToken) -> Result<f64, ReconstructionError> {
        let ((rows, cols), peak) = (self.field, self.peak);
        let padded = padded(self.field);
        let of_sample = |memory: &mut Option<Activations>, Sample { example, truth, unit }: &Sample| {
            if cancel.is_cancelled() {
                return None;
            }
            if let (Some(network), Some(memory)) = (network, memory.as_mut()) {
                network.forward(&example.image, memory);
            }
            let correction = |at: usize| match &memory {
                Some(memory) => unit * memory.result[at / cols * padded.1 + at % cols],
                None => 0.0,
            };
            let error = |at: usize| {
                let estimate = ((example.linear[at] + correction(at)) / peak).clamp(0.0, 1.0);
                f64::from(estimate - truth[at] / peak).powi(2)
            };
            Some((0..rows * cols).map(error).sum::<f64>() / (rows * cols) as f64)
        };
        let memory = || network.map(|network| network.activations(padded));
        let errors: Option<Vec<f64>> = self.samples.par_iter().map_init(memory, of_sample).collect();
        let errors = errors.ok_or(ReconstructionError::Cancelled)?;
        Ok(psnr_db(errors.iter().sum::<f64>() / errors.len().max(1) as f64))
    }
}

/// The best weights so far.
struct Best {
    weights: Vec<f32>,
    psnr_db: f64,
}

impl Best {
    fn new(validation: &Validation, run: &Run<'_>, cancel: &CancelToken) -> Result<Self, ReconstructionError> {
        let psnr_db = validation.psnr_db(Some(&Ready::new(run.layers, &run.weights)), cancel)?;
        if psnr_db >= validation.linear_psnr_db {
            return Ok(Self { weights: run.weights.clone(), psnr_db });
        }
        // The weights that training began with are worse than none.
        Ok(Self { weights: vec![0.0; run.weights.len()], psnr_db: validation.linear_psnr_db })
    }

    /// Keeps the averaged weights where they are better; their PSNR, dB.
    fn validate(
        &mut self,
        validation: &Validation,
        run: &Run<'_>,
        cancel: &CancelToken,
    ) -> Result<f64, ReconstructionError> {
        let psnr_db = validation.psnr_db(Some(&Ready::new(run.layers, run.averaged())), cancel)?;
        if psnr_db > self.psnr_db {
            self.psnr_db = psnr_db;
            self.weights.copy_from_slice(run.averaged());
        }
        Ok(psnr_db)
    }
}
