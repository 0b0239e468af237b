//! The fit: small batches of new patches, Muon, a warm-up and decay of the rate, averaged weights.

use std::cell::Cell;
use std::ops::Range;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::checkpoint::{FitState, restore, state_to_bytes};
use super::conditioning::Inputs;
use super::early_stopping::EarlyStopping;
use super::model::{CausalModel, Gradients};
use super::shape::rule;
use super::stream::{PatchBatch, PatchStream};
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::FitCheckpoint;
use crate::information::progress::FitProgress;
use crate::information::stopwatch::Stopwatch;
use crate::nn::{Averaging, Optimizer, learning_rate_factor};
use crate::progress::Progress;

/// Patches of one step.
pub(super) const BATCH: usize = 2;
/// Largest learning rate.
pub(super) const RATE: f64 = 1.2e-2;
/// Largest norm of a gradient.
pub(super) const MAX_NORM: f64 = 1.0;
/// Patches drawn at a time.
const DRAWN: usize = 64;
/// Separates the seed of the predicted noise from that of the seen noise.
const REDRAWN: u64 = 0x7a67 << 32;
/// Steps over which the reported training loss is averaged.
const REMEMBERED: f64 = 100.0;
/// Steps with a loss that is not finite after which a fit fails.
const MAX_REFUSED: usize = 30;

/// Length of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FitLength {
    /// Number of steps; equal seeds then give equal bits on one machine.
    Steps(usize),
    /// Time.
    Time(Duration),
}

/// A step of a fit, reported after it.
pub struct FitStep<'a> {
    /// Progress of the fit.
    pub progress: FitProgress,
    model: &'a dyn Fn() -> CausalModel,
    planned: Cell<Option<usize>>,
}

impl FitStep<'_> {
    /// The model as if the fit ended here.
    pub fn model(&self) -> CausalModel {
        (self.model)()
    }

    /// Plans `steps` steps in all and spreads the rest of the schedule over them; without effect on a fit of a given time.
    pub fn plan(&self, steps: usize) {
        self.planned.set(Some(steps));
    }
}

/// What a fit uses besides the model and its settings.
#[derive(Clone, Copy)]
pub struct FitContext<'a> {
    /// Source of training patches.
    pub stream: &'a dyn PatchStream,
    /// Validation patches; the weights that score best on them win.
    pub validation: Option<&'a PatchBatch>,
    /// Checkpoint from which the fit resumes. With a fixed number of steps a resumed fit gives the same bits.
    pub keeper: Option<&'a dyn FitCheckpoint>,
}

impl<'a> FitContext<'a> {
    /// Patches alone.
    pub fn new(stream: &'a dyn PatchStream) -> Self {
        Self { stream, validation: None, keeper: None }
    }
}

/// Result of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fitted {
    /// Steps, those of earlier sessions included.
    pub steps: usize,
    /// Step of the best validation score, where it beats the final weights.
    pub best: Option<usize>,
    /// Computing time of earlier sessions.
    pub before: Duration,
}

/// Settings of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct CausalFit {
    /// Patches of one step.
    pub batch: usize,
    /// Largest learning rate.
    pub rate: f64,
    /// Averaging of the weights.
    pub averaging: Averaging,
    /// Largest norm of a gradient; longer ones are shortened to it.
    pub max_norm: f64,
    /// Length of the fit.
    pub length: FitLength,
    /// Seed of patches and noise.
    pub seed: u64,
}

impl CausalFit {
    /// Default settings.
    pub fn new(length: FitLength, seed: u64) -> Self {
        Self { batch: BATCH, rate: RATE, averaging: Averaging::LAST_TENTH, max_norm: MAX_NORM, length, seed }
    }

    /// Fits `model` to new patches; its weights become the average over the last steps.
    ///
    /// # Errors
    /// Where the stream fails, numbers stay infinite, or `progress` cancels; the model then keeps the weights
    /// reached. Where the checkpoint cannot be read or written, or belongs to another fit; where the validation patches
    /// do not fit the model.
    pub fn fit(
        &self,
        model: &mut CausalModel,
        &FitContext { stream, validation, keeper }: &FitContext<'_>,
        progress: &mut dyn for<'a> Progress<FitStep<'a>>,
    ) -> Result<Fitted, InformationError> {
        let (mut trainer, mut found) = (Trainer::new(model, self.averaging), None);
        if let Some(keeper) = keeper {
            (trainer.course, found) = restore(keeper, model, &mut trainer.optimizer)?;
        }
        let time = Stopwatch::after(trainer.course.before);
        let mut plan = Plan::new(self.length);
        let mut best = EarlyStopping::new(validation, plan.done(trainer.course.steps, trainer.course.before), found);
        let (mut kept, mut state) = (Instant::now(), Vec::new());
        loop {
            if let Some(keeper) = keeper {
                // A fit resumes where patches are drawn.
                let Trainer { course, optimizer, .. } = &trainer;
                state = state_to_bytes(keeper.key(), course, time.elapsed(), model, optimizer, best.found.as_ref())?;
                if kept.elapsed() >= keeper.every() {
                    keeper.store(&state)?;
                    kept = Instant::now();
                }
            }
            let inputs = trainer.draw(self, model, stream)?;
            for indices in self.batches() {
                let done = plan.done(trainer.course.steps, time.elapsed());
                if done >= 1.0 {
                    model.weights = trainer.averaged(model);
                    let FitState { steps, before, .. } = trainer.course;
                    return Ok(Fitted { steps, best: best.install_best(model)?, before });
                }
                trainer.step(self, model, &inputs, indices, learning_rate_factor(done))?;
                let averaged = || CausalModel { weights: trainer.averaged(model), ..model.clone() };
                let elapsed = time.elapsed();
                best.validate(plan.done(trainer.course.steps, elapsed), trainer.course.steps, &averaged)?;
                let snapshot = || CausalModel { weights: best.or(|| trainer.averaged(model)), ..model.clone() };
                let step = plan.progress(&trainer.course, elapsed);
                let step = FitStep { progress: step, model: &snapshot, planned: Cell::new(None) };
                if progress.report(&step).is_break() {
                    model.weights = best.or(|| trainer.averaged(model));
                    keeper.map_or(Ok(()), |keeper| keeper.store(&state))?;
                    return Err(InformationError::Cancelled);
                }
                if let Some(all) = step.planned.get() {
                    plan.revise(trainer.course.steps, all);
                }
            }
        }
    }

    /// Index ranges of the patches of each step, until the drawn ones are used up.
    pub(super) fn batches(&self) -> impl DoubleEndedIterator<Item = Range<usize>> + use<> {
        let batch = self.batch.clamp(1, DRAWN);
        (0..DRAWN / batch).map(move |index| index * batch..(index + 1) * batch)
    }
}

/// Length of a fit, which can be revised.
struct Plan {
    length: FitLength,
    /// Steps at the last revision, and the share of the fit that was done then.
    revised: (usize, f64),
}

impl Plan {
    fn new(length: FitLength) -> Self {
        Self { length, revised: (0, 0.0) }
    }

    /// Plans `all` steps in total, if the fit counts steps.
    fn revise(&mut self, steps: usize, all: usize) {
        if let FitLength::Steps(_) = self.length {
            self.revised = (steps, self.done(steps, Duration::ZERO));
            self.length = FitLength::Steps(all.max(steps));
        }
    }

    /// Share of the fit that is done.
    fn done(&self, steps: usize, elapsed: Duration) -> f64 {
        match self.length {
            // Rounding must not ask for one more.
            FitLength::Steps(all) if steps >= all => 1.0,
            FitLength::Steps(all) => {
                let (from, before) = self.revised;
                before + (1.0 - before) * (steps - from) as f64 / (all - from) as f64
            }
            FitLength::Time(all) => elapsed.as_secs_f64() / all.as_secs_f64().max(1e-9),
        }
    }

    fn progress(&self, course: &FitState, elapsed: Duration) -> FitProgress {
        let remaining = match self.length {
            FitLength::Steps(all) => elapsed.mul_f64((all as f64 / course.steps as f64 - 1.0).max(0.0)),
            FitLength::Time(all) => all.saturating_sub(elapsed),
        };
        let (step, recent) = (course.steps, course.recent);
        FitProgress {
            epoch: 1,
            epochs: 1,
            step,
            validation_bits: recent,
            best_bits: recent,
            elapsed,
            remaining: Some(remaining),
            scored: None,
        }
    }
}

/// Optimizer of a model, and the state of its fit.
pub(super) struct Trainer {
    optimizer: Optimizer,
    pub course: FitState,
    gradients: Gradients,
}

impl Trainer {
    pub fn new(model: &CausalModel, averaging: Averaging) -> Self {
        Self {
            optimizer: Optimizer::new(&model.layout, &model.weights, averaging, rule),
            course: FitState::default(),
            gradients: Gradients::new(model.layout.count()),
        }
    }

    /// Draws patches for the next steps: network inputs and prediction targets.
    pub fn draw(
        &mut self,
        fit: &CausalFit,
        model: &CausalModel,
        stream: &dyn PatchStream,
    ) -> Result<Inputs, InformationError> {
        let seed = fit.seed.wrapping_add(self.course.draws.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let pool = stream.draw(DRAWN, seed)?;
        super::model::check(pool.noisy.view())?;
        let mut inputs = model.conditioning.inputs(pool.noisy.view());
        if let Some(clean) = &pool.clean {
            inputs.targets = model.conditioning.targets(clean.view(), seed ^ REDRAWN);
        }
        self.course.draws += 1;
        Ok(inputs)
    }

    /// One step of `factor` times the largest rate.
    pub fn step(
        &mut self,
        fit: &CausalFit,
        model: &mut CausalModel,
        inputs: &Inputs,
        indices: Range<usize>,
        factor: f64,
    ) -> Result<(), InformationError> {
        let Self { optimizer, course, gradients } = self;
        let indices: Vec<usize> = indices.collect();
        let loss = gradients.evaluate(model, inputs, &indices);
        let norm = gradients.norm();
        course.steps += 1;
        if loss.is_finite() && norm.is_finite() {
            let scale = (fit.max_norm / norm.max(1e-30)).min(1.0);
            let rate = fit.rate * course.step_scale * factor;
            optimizer.step(&mut model.weights, &gradients.total, scale as f32, rate as f32);
            let bits = loss / std::f64::consts::LN_2;
            let share = (1.0 / REMEMBERED).max(1.0 / course.steps as f64);
            course.recent = Some(course.recent.map_or(bits, |mean| mean + share * (bits - mean)));
        } else {
            course.refused += 1;
            course.step_scale *= 0.5;
            if course.refused == MAX_REFUSED {
                return Err(InformationError::Diverged { refused: course.refused });
            }
        }
        Ok(())
    }

    /// The averaged weights.
    pub fn averaged(&self, model: &CausalModel) -> Vec<f32> {
        self.optimizer.result(&model.weights).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn revised_plan_spreads_the_rest_over_its_steps() {
        let share = |plan: &Plan, steps| plan.done(steps, Duration::ZERO);
        let mut plan = Plan::new(FitLength::Steps(100));
        assert_eq!([0, 25, 100].map(|steps| share(&plan, steps)), [0.0, 0.25, 1.0]);
        plan.revise(25, 325);
        assert_eq!([25, 125, 325].map(|steps| share(&plan, steps)), [0.25, 0.5, 1.0]);
        plan.revise(125, 10);
        assert_eq!(share(&plan, 125), 1.0, "never fewer than were taken");
        let mut rounded = Plan::new(FitLength::Steps(5315));
        rounded.revise(136, 1259);
        assert!(share(&rounded, 1258) < 1.0);
        assert_eq!(share(&rounded, 1259), 1.0);
        let mut timed = Plan::new(FitLength::Time(Duration::from_secs(4)));
        timed.revise(5, 7);
        assert_eq!(timed.done(5, Duration::from_secs(1)), 0.25);
    }
}
