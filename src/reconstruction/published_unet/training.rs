//! Training of the published U-net by the published schedule, squeezed into a budget.

use std::time::Instant;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::burn_module::BurnPasses;
use super::layers::Layers;
use super::objects::{Objects, padded};
use super::passes::{Evaluation, Passes};
use super::trained::TrainedUnet;
use crate::information::{EngineChoice, FitCheckpoint};
use crate::nn::{Averaging, Optimizer, Rule};
use crate::objects::Split;
use crate::progress::{CancelToken, Progress};
use crate::reconstruction::decoder::DecoderKind;
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::reconstruction::network::{TrainingBudget, TrainingStep};
use crate::reconstruction::protocol::DecoderScene;
use crate::reconstruction::quality::psnr_db;
use crate::reconstruction::training_checkpoint::{TrainingArrays, TrainingCheckpoint};
use crate::reconstruction::training_record::{NetworkMask, TrainingPoint, TrainingRecord};
use crate::seeds::SeedStream;

/// Objects of a step.
const BATCH: usize = 64;
/// Training objects, each with one draw of its noise.
const OBJECTS: usize = 20_000;
/// Most validation objects, and those for each step between validations, so that these take a small share of the time.
const MOST_VALIDATION_OBJECTS: usize = 2_000;
const VALIDATION_OBJECTS_PER_STEP: usize = 16;
/// Epochs of the schedule.
const EPOCHS: usize = 200;
/// Largest share of a budget between validations: a tenth, and less than that by rounding.
const SHARE_BETWEEN_VALIDATIONS: f64 = 0.1 - 1e-9;
/// Rate at the start, and weight decay of `AdamW` (Loshchilov and Hutter 2019).
const RATE: f64 = 2e-3;
const WEIGHT_DECAY: f64 = 1e-4;
/// Training ends after this number of validations without an improvement of this size.
const PATIENCE: usize = 10;
const IMPROVEMENT: f64 = 1e-5;
/// Share of a loss in the recent loss.
const RECENT: f64 = 0.05;
/// Most memory of a batch, GiB.
const MOST_GIBIBYTES: f64 = 8.0;

/// Training of the published U-net (Kabuli et al. 2026) for one mask.
///
/// It has 152,497 weights and sees the measurement alone: divided by its maximum, with zeros around it up to the field. 20,000 objects of
/// one noise draw each, batches of 64, mean squared error, `AdamW` with a rate of 2e-3 and a half cosine over 200 epochs or the budget,
/// whichever is shorter. It ends early after ten validations without an improvement of 1e-5. The weights of the best validation are kept.
/// A tenth of the training images takes no part and validates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnetTraining {
    /// When training ends.
    pub budget: TrainingBudget,
    /// Seed of weights, objects and noise.
    pub seed: u64,
    /// What computes the steps; validations are always on the processor.
    pub engine: EngineChoice,
}

impl UnetTraining {
    /// Trains the network for a scene and a model of it, from the weights of `start` where there are any.
    ///
    /// `progress` receives each step. Training pauses until it returns; the pause does not count as work. With a `keeper` a stopped training
    /// resumes where it was.
    ///
    /// # Errors
    /// [`ReconstructionError`] where there are too few images, where the field does not fit into memory, and where `start` is of other
    /// objects; [`ReconstructionError::Cancelled`] within a layer of a step.
    pub fn train(
        &self,
        scene: &DecoderScene,
        model: &ImagingModel,
        start: Option<&TrainedUnet>,
        keeper: Option<&dyn FitCheckpoint>,
        cancel: &CancelToken,
        progress: &mut dyn Progress<TrainingStep>,
    ) -> Result<TrainedUnet, ReconstructionError> {
        let layers = Layers::new();
        let field = padded(model.field());
        check_memory(&layers, field)?;
        TrainingRecord::check_images(scene, DecoderKind::Unet)?;
        let seed = SeedStream::ReconstructionNetwork.derive(self.seed);
        let of_training = (*scene.set).clone().of_training();
        let training = Objects::new((scene, model), (&of_training, Split::Train), seed)?;
        let validation_seed = SeedStream::Block { index: 0 }.derive(seed);
        let validation = Objects::new((scene, model), (&of_training, Split::Test), validation_seed)?;
        let mut weights = match start {
            Some(start) => {
                start.training.check_scene(scene)?;
                start.weights.clone()
            }
            None => layers.layout.draw(seed),
        };
        let mut best = Best { weights: weights.clone(), loss: f64::INFINITY, psnr_db: f64::NEG_INFINITY, waited: 0 };
        let trained = layers.trained.count();
        let mut optimizer = Optimizer::new(&layers.trained, &weights[..trained], Averaging::Off, |_| Rule::Adam);
        let mut gradient = vec![0.0; trained];
        let mut passes = match self.engine {
            EngineChoice::Cpu => Engine::Kernels(Passes::new(&layers, field)),
            EngineChoice::Burn(device) => Engine::Burn(BurnPasses::new(&layers, field, device)?),
        };
        let mut order = Order { seed, epoch: 0, waiting: Vec::new() };
        let mut checkpoint = TrainingCheckpoint::new(keeper);
        let (mut steps, mut counters) = (0, Counters::default());
        if let Some(restored) = checkpoint.restore(&mut weights, &mut optimizer)? {
            (steps, counters, best.weights) = (restored.steps, restored.counters, restored.best);
            (best.loss, best.psnr_db) = counters.best.unwrap_or((best.loss, best.psnr_db));
            best.waited = counters.waited;
            (0..steps).for_each(|_| drop(order.next()));
        }
        let mut done = self.done(steps, counters.seconds);
        while done < 1.0 && best.waited < PATIENCE {
            let started = Instant::now();
            let batch = training.examples(&order.next())?;
            let loss = match &mut passes {
                Engine::Kernels(passes) => {
                    passes.step(&mut weights, &batch, &mut gradient, cancel).ok_or(ReconstructionError::Cancelled)?
                }
                Engine::Burn(passes) => passes.step(&mut weights, &batch, &mut gradient)?,
            };
            let rate = RATE * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
            let kept = (1.0 - rate * WEIGHT_DECAY) as f32;
            weights[..trained].iter_mut().for_each(|weight| *weight *= kept);
            optimizer.step(&mut weights[..trained], &gradient, 1.0, rate as f32);
            steps += 1;
            let last = counters.recent.unwrap_or(loss);
            counters.recent = Some(last + RECENT * (loss - last));
            done = self.done(steps, counters.seconds + started.elapsed().as_secs_f64());
            let (last_steps, last_done) = counters.validated;
            let is_epoch = steps - last_steps >= OBJECTS.div_ceil(BATCH);
            if is_epoch || done - last_done >= SHARE_BETWEEN_VALIDATIONS || done >= 1.0 {
                counters.validated = (steps, done);
                let count = *counters
                    .validation_objects
                    .get_or_insert_with(|| (VALIDATION_OBJECTS_PER_STEP * steps).clamp(BATCH, MOST_VALIDATION_OBJECTS));
                let evaluation = Evaluation::new(&layers, &weights, field);
                let point = Losses::of(&evaluation, &validation, (count, model.field()), cancel)?;
                best.take(&point, &weights);
                (counters.best, counters.waited) = (Some((best.loss, best.psnr_db)), best.waited);
                let seconds = counters.seconds + started.elapsed().as_secs_f64();
                counters.curve.push(TrainingPoint { steps, seconds, psnr_db: point.psnr_db });
            }
            counters.seconds += started.elapsed().as_secs_f64();
            let seconds = counters.seconds;
            let step = TrainingStep {
                steps,
                done: if best.waited < PATIENCE { done } else { 1.0 },
                seconds,
                steps_per_second: steps as f64 / seconds.max(1e-9),
                loss: counters.recent.unwrap_or(loss),
                linear_loss: None,
                linear_psnr_db: None,
                validation: counters.curve.last().copied(),
                restarts: 0,
                best: None,
            };
            let is_stopped = progress.report(&step).is_break() || cancel.is_cancelled();
            if step.done < 1.0 && (is_stopped || checkpoint.is_due()) {
                let arrays = TrainingArrays { weights: &weights, optimizer: &optimizer, best: &best.weights };
                checkpoint.keep(arrays, steps, &counters)?;
            }
            if is_stopped {
                return Err(ReconstructionError::Cancelled);
            }
        }
        let Counters { seconds, curve, .. } = counters;
        let record = TrainingRecord::new(scene, NetworkMask::of(model), self.seed);
        Ok(TrainedUnet {
            training: TrainingRecord { steps, seconds, psnr_db: best.psnr_db, curve, ..record },
            weights: best.weights,
        })
    }
}

impl UnetTraining {
    /// Share of budget or schedule after a number of steps and this time of work, seconds.
    fn done(&self, steps: usize, seconds: f64) -> f64 {
        let of_schedule = steps as f64 / (EPOCHS * OBJECTS.div_ceil(BATCH)) as f64;
        self.budget.done(steps, seconds).max(of_schedule).min(1.0)
    }
}

/// What a checkpoint holds beside weights and optimizer.
#[derive(Default, Serialize, Deserialize)]
struct Counters {
    seconds: f64,
    recent: Option<f64>,
    curve: Vec<TrainingPoint>,
    /// Steps and share of the budget at the last validation.
    validated: (usize, f64),
    validation_objects: Option<usize>,
    /// Loss and PSNR of the best weights, once there are any.
    best: Option<(f64, f64)>,
    waited: usize,
}

/// What computes the steps.
enum Engine<'a> {
    Kernels(Passes<'a>),
    Burn(BurnPasses<'a>),
}

fn check_memory(layers: &Layers, field: (usize, usize)) -> Result<(), ReconstructionError> {
    let gibibytes = Passes::bytes_per_image(layers, field) * BATCH as f64 / f64::from(1 << 30);
    if gibibytes <= MOST_GIBIBYTES {
        return Ok(());
    }
    Err(ReconstructionError::TooLarge { rows: field.0, cols: field.1, gibibytes })
}

/// The training objects, in a new order in each epoch.
struct Order {
    seed: u64,
    epoch: usize,
    waiting: Vec<usize>,
}

impl Order {
    /// Numbers of the objects of the next step.
    fn next(&mut self) -> Vec<usize> {
        if self.waiting.is_empty() {
            self.epoch += 1;
            self.waiting = (0..OBJECTS).collect();
            let seed = SeedStream::Block { index: self.epoch }.derive(self.seed);
            self.waiting.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        }
        self.waiting.split_off(self.waiting.len().saturating_sub(BATCH))
    }
}

/// Result of a validation.
struct Losses {
    /// Mean squared error of results as they are.
    loss: f64,
    /// PSNR of results clipped to [0, 1], dB.
    psnr_db: f64,
}

impl Losses {
    fn of(
        evaluation: &Evaluation<'_>,
        objects: &Objects<'_>,
        (count, (rows, cols)): (usize, (usize, usize)),
        cancel: &CancelToken,
    ) -> Result<Self, ReconstructionError> {
        let padded_cols = padded((rows, cols)).1;
        let (mut unclipped, mut clipped) = (0.0, 0.0);
        for first in (0..count).step_by(BATCH) {
            if cancel.is_cancelled() {
                return Err(ReconstructionError::Cancelled);
            }
            let numbers: Vec<usize> = (first..(first + BATCH).min(count)).collect();
            let examples = objects.examples(&numbers)?;
            let errors: Vec<[f64; 2]> = examples
                .par_iter()
                .map(|example| {
                    let result = evaluation.result(&example.image);
                    let lines =
                        result.chunks_exact(padded_cols).zip(example.truth.chunks_exact(padded_cols)).take(rows);
                    let pixels = lines.flat_map(|(found, truth)| found.iter().zip(truth).take(cols));
                    pixels.fold([0.0, 0.0], |[all, within], (found, truth)| {
                        let square = |found: f32| f64::from(found - truth).powi(2);
                        [all + square(*found), within + square(found.clamp(0.0, 1.0))]
                    })
                })
                .collect();
            for [all, within] in errors {
                unclipped += all;
                clipped += within;
            }
        }
        let pixels = (count * rows * cols) as f64;
        Ok(Self { loss: unclipped / pixels, psnr_db: psnr_db(clipped / pixels) })
    }
}

/// The best weights so far.
struct Best {
    weights: Vec<f32>,
    loss: f64,
    psnr_db: f64,
    /// Validations since the last improvement.
    waited: usize,
}

impl Best {
    fn take(&mut self, point: &Losses, weights: &[f32]) {
        self.waited = if point.loss < self.loss - IMPROVEMENT { 0 } else { self.waited + 1 };
        if point.loss < self.loss {
            self.loss = point.loss;
            self.psnr_db = point.psnr_db;
            self.weights.copy_from_slice(weights);
        }
    }
}
