//! The fit of a decoder to fresh samples of a channel.

use std::ops::ControlFlow;
use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::channel::BeadChannel;
use super::gradient::Passes;
use super::kind::DecoderKind;
use super::layers::Decoder;
use super::problem::Problem;
use super::samples::Reveal;
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitArrays, FitCheckpoint, RestoredFit, fit_to_bytes, restore_fit};
use crate::information::stopwatch::Stopwatch;
use crate::nn::{Averaging, Optimizer, Rule, learning_rate_factor};

/// Share of a budget that is kept for the test.
const TEST_SHARE: f64 = 0.06;
/// Steps without finite numbers after which a fit is given up.
const MAX_REFUSED: usize = 30;
/// Gradients longer than this many times their running mean are shortened to it.
const LONGEST: f64 = 2.0;
/// Weight of a step in running means.
const RUNNING: f64 = 0.02;
/// Largest share of sites that is revealed in training, and how the share is spread: `u^EARLY`, u uniform.
const MOST_REVEALED: f64 = 0.97;
const EARLY: f64 = 1.5;
/// Largest factor by which few remaining sites count more in training, before its root is taken.
const HEAVIEST: f64 = 4.0;

/// Names of what is kept of a fit besides its weights.
const MEAN_NORM: &str = "mean_norm";
const SAVED: &str = "saved_per_site";
const NANOSECONDS: &str = "nanoseconds";

/// How a decoder is fitted and tested.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoderFit {
    /// What the decoder is given besides the measurement.
    pub kind: DecoderKind,
    /// Unrolled steps.
    pub unrolled: usize,
    /// Samples of one training step.
    pub batch: usize,
    /// Largest learning rate.
    pub rate: f64,
    /// Training steps, unless there is a budget.
    pub steps: usize,
    /// Time for fit and test together; the schedule is stretched over it.
    pub budget: Option<Duration>,
    /// Half width of the 95 % interval at which the test ends, bits per pixel.
    pub half_width: f64,
    /// Largest number of test samples.
    pub max_test: usize,
    /// Seed of first weights, samples and test.
    pub seed: u64,
}

impl DecoderFit {
    /// Largest learning rate of a fit from first weights.
    pub const RATE: f64 = 1e-2;
    /// That of one which goes on from a fitted decoder: larger steps undo what it knows. By six unrolled steps the lower bound came out
    /// 0.0004 to 0.0012 bits per pixel higher than by the other rate after 20 s, before four kinds of beads.
    pub const RATE_ON: f64 = 3e-3;

    /// The default fit within a budget of time.
    pub fn within(budget: Duration, kind: DecoderKind, seed: u64) -> Self {
        Self { budget: Some(budget), ..Self::of_steps(usize::MAX, kind, seed) }
    }

    /// The default fit of a number of steps: equal seeds give equal bits, whatever the number of threads.
    pub fn of_steps(steps: usize, kind: DecoderKind, seed: u64) -> Self {
        Self {
            kind,
            unrolled: Decoder::UNROLLED,
            batch: 2,
            rate: Self::RATE,
            steps,
            budget: None,
            half_width: 0.0015,
            max_test: 4096,
            seed,
        }
    }

    /// Refuses a fit that does nothing.
    pub(super) fn check(&self) -> Result<(), InformationError> {
        let refuse = |expected, found: String| Err(InformationError::DecoderFit { expected, found });
        if !(1..=1024).contains(&self.batch) {
            return refuse("1 to 1024 samples per step", self.batch.to_string());
        }
        if !(self.rate > 0.0 && self.rate.is_finite()) {
            return refuse("a positive learning rate", self.rate.to_string());
        }
        if self.max_test == 0 {
            return refuse("at least one test sample", "none".to_owned());
        }
        if self.half_width.is_nan() {
            return refuse("a number for the width of the interval", "NaN".to_owned());
        }
        Ok(())
    }
}

/// Where a fit is; sent after every step and every few test samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoderProgress {
    /// Training steps taken.
    pub step: usize,
    /// Time since the start.
    pub elapsed: Duration,
    /// Time left for the fit, where it can be told; the test follows.
    pub remaining: Option<Duration>,
    /// Bits per pixel that the decoder saves on the training samples of late, on sites with as many others revealed as
    /// in training; it settles near the bound.
    pub training_bits: f64,
    /// Test samples scored, once the fit is over.
    pub tested: Option<usize>,
}

/// The state of one fit.
pub(super) struct Run<'a> {
    fit: &'a DecoderFit,
    scene: &'a Problem,
    keeper: Option<&'a dyn FitCheckpoint>,
    watch: Stopwatch,
    course: Course,
}

/// How far a fit has come.
struct Course {
    mover: Mover,
    steps: usize,
    saved_per_site: f64,
}

/// A fit of a number of steps that is done part by part: each part takes samples of the channel as it is by then.
pub struct DecoderRefit {
    fit: DecoderFit,
    decoder: Decoder,
    course: Course,
}

/// Moves the weights of a decoder by gradients that are shortened where they are unusually long.
pub(super) struct Mover {
    optimizer: Optimizer,
    moved: usize,
    refused: usize,
    mean_norm: f64,
}

impl Mover {
    pub fn new(decoder: &Decoder) -> Self {
        let optimizer = Optimizer::new(&decoder.layout, &decoder.weights, Averaging::LAST_TENTH, |tensor| {
            if tensor.name.starts_with("block") { Rule::Muon } else { Rule::Adam }
        });
        Self { optimizer, moved: 0, refused: 0, mean_norm: 0.0 }
    }

    /// One step of `rate` against the gradient in `unit`s; tells whether there was one: a gradient without finite numbers
    /// makes none.
    ///
    /// # Errors
    /// Where that has happened too often.
    pub fn step(
        &mut self,
        decoder: &mut Decoder,
        gradient: &[f32],
        unit: f64,
        rate: f64,
    ) -> Result<bool, InformationError> {
        let norm = gradient.iter().map(|&g| f64::from(g) * f64::from(g)).sum::<f64>().sqrt() / unit;
        if !norm.is_finite() {
            self.refused += 1;
            let refused = self.refused;
            return if refused < MAX_REFUSED { Ok(false) } else { Err(InformationError::Diverged { refused }) };
        }
        self.moved += 1;
        let running = RUNNING.max(1.0 / (self.moved + self.refused) as f64);
        let scale = if self.mean_norm > 0.0 { (LONGEST * self.mean_norm / norm.max(1e-30)).min(1.0) } else { 1.0 };
        self.mean_norm += running * (norm * scale - self.mean_norm);
        self.optimizer.step(&mut decoder.weights, gradient, (scale / unit) as f32, rate as f32);
        Ok(true)
    }

    /// The averaged weights.
    pub fn result(&self, decoder: &Decoder) -> Vec<f32> {
        self.optimizer.result(&decoder.weights).to_vec()
    }
}

impl Course {
    fn new(decoder: &Decoder) -> Self {
        Self { mover: Mover::new(decoder), steps: 0, saved_per_site: 0.0 }
    }

    /// Share of the steps of a fit that is over.
    fn share(&self, fit: &DecoderFit) -> f64 {
        self.steps as f64 / fit.steps.max(1) as f64
    }

    /// One step on fresh samples of a scene.
    fn step(
        &mut self,
        fit: &DecoderFit,
        scene: &Problem,
        (decoder, passes): (&mut Decoder, &mut Passes<'_>),
        done: f64,
    ) -> Result<(), InformationError> {
        let sites = scene.decoded.len();
        let draws = (fit.seed, self.steps * fit.batch, fit.batch);
        let outcomes = match fit.kind {
            DecoderKind::Factorised => passes.train(decoder, draws, |_| Reveal::Nothing),
            DecoderKind::Autoregressive => passes.train(decoder, draws, |random| revealed_in_training(sites, random)),
        };
        self.steps += 1;
        if self.mover.step(decoder, &passes.gradient, 1.0, fit.rate * learning_rate_factor(done))? {
            let saved = outcomes.iter().map(|outcome| outcome.saved_bits_per_site).sum::<f64>() / outcomes.len() as f64;
            self.saved_per_site += RUNNING.max(1.0 / self.steps as f64) * (saved - self.saved_per_site);
        }
        Ok(())
    }

    /// Keeps where the fit of a decoder stands after `elapsed` in all.
    fn keep(&self, keeper: &dyn FitCheckpoint, decoder: &Decoder, elapsed: Duration) -> Result<(), InformationError> {
        let Mover { optimizer, refused, mean_norm, .. } = &self.mover;
        let details = vec![
            (MEAN_NORM, mean_norm.to_string()),
            (SAVED, self.saved_per_site.to_string()),
            (NANOSECONDS, elapsed.as_nanos().to_string()),
        ];
        let numbers = FitArrays { weights: &decoder.weights, optimizer, best: None };
        keeper.store(&fit_to_bytes(keeper.key(), &numbers, (self.steps, *refused), details)?)
    }

    /// Goes on from what is kept of the same fit, if anything; returns the time that was taken for it.
    fn restore(&mut self, keeper: &dyn FitCheckpoint, decoder: &mut Decoder) -> Result<Duration, InformationError> {
        let Some(kept) = restore_fit(keeper, &mut decoder.weights, &mut self.mover.optimizer)? else {
            return Ok(Duration::ZERO);
        };
        let RestoredFit { details, steps, refused, .. } = kept;
        self.steps = steps;
        self.saved_per_site = details.number(SAVED)?;
        (self.mover.moved, self.mover.refused) = (steps.saturating_sub(refused), refused);
        self.mover.mean_norm = details.number(MEAN_NORM)?;
        Ok(Duration::from_nanos(details.number(NANOSECONDS)?))
    }
}

impl DecoderRefit {
    /// Begins a fit of its number of steps from the weights of a decoder.
    ///
    /// # Errors
    /// For what is no fit.
    pub fn new(fit: DecoderFit, start: &Decoder) -> Result<Self, InformationError> {
        fit.check()?;
        Ok(Self { fit, decoder: start.clone(), course: Course::new(start) })
    }

    /// Goes on up to so many steps in all, on samples of a channel; `watch` hears of every step and answers whether to go on.
    ///
    /// # Errors
    /// As [`decoder_lower_bound`](super::decoder_lower_bound).
    pub fn advance_to(
        &mut self,
        channel: &BeadChannel,
        steps: usize,
        watch: &mut dyn FnMut(usize) -> ControlFlow<()>,
    ) -> Result<(), InformationError> {
        let Self { fit, decoder, course } = self;
        let scene = Problem::new(channel)?;
        let mut passes = Passes::new(&scene, decoder);
        while course.steps < steps.min(fit.steps) {
            let done = course.share(fit);
            course.step(fit, &scene, (decoder, &mut passes), done)?;
            if watch(course.steps).is_break() {
                return Err(InformationError::Cancelled);
            }
        }
        Ok(())
    }

    /// Steps so far.
    pub fn steps(&self) -> usize {
        self.course.steps
    }

    /// The decoder with weights averaged over the last steps.
    pub fn decoder(&self) -> Decoder {
        Decoder { weights: self.course.mover.result(&self.decoder), ..self.decoder.clone() }
    }
}

impl<'a> Run<'a> {
    /// A fit from the weights of a decoder, or from what is kept of the same fit, whose weights the decoder gets then.
    pub fn new(
        fit: &'a DecoderFit,
        scene: &'a Problem,
        decoder: &mut Decoder,
        keeper: Option<&'a dyn FitCheckpoint>,
    ) -> Result<Self, InformationError> {
        let mut course = Course::new(decoder);
        let before = keeper.map(|keeper| course.restore(keeper, decoder)).transpose()?;
        Ok(Self { fit, scene, keeper, watch: Stopwatch::after(before.unwrap_or_default()), course })
    }

    /// All steps; the decoder gets the averaged weights. Returns the number of steps.
    pub fn train(
        &mut self,
        decoder: &mut Decoder,
        passes: &mut Passes<'_>,
        on_progress: &mut dyn FnMut(&DecoderProgress) -> ControlFlow<()>,
    ) -> Result<usize, InformationError> {
        let mut kept = self.elapsed();
        loop {
            let done = self.done();
            if done >= 1.0 || self.course.steps >= self.fit.steps {
                break;
            }
            self.course.step(self.fit, self.scene, (decoder, passes), done)?;
            if let Some(keeper) = self.keeper
                && self.elapsed() >= kept + keeper.every()
            {
                kept = self.elapsed();
                self.course.keep(keeper, decoder, kept)?;
            }
            if on_progress(&self.progress(None)).is_break() {
                return Err(InformationError::Cancelled);
            }
        }
        decoder.weights = self.course.mover.result(decoder);
        Ok(self.course.steps)
    }

    /// Time for the fit so far.
    pub fn elapsed(&self) -> Duration {
        self.watch.elapsed()
    }

    /// Share of the schedule that is over.
    fn done(&self) -> f64 {
        match self.fit.budget {
            Some(budget) => self.elapsed().as_secs_f64() / (budget.as_secs_f64() * (1.0 - TEST_SHARE)).max(1e-9),
            None => self.course.share(self.fit),
        }
    }

    /// What there is to tell now.
    pub fn progress(&self, tested: Option<usize>) -> DecoderProgress {
        let (elapsed, done) = (self.elapsed(), self.done());
        let left = (done > 0.0).then(|| elapsed.as_secs_f64() * (1.0 / done - 1.0).max(0.0));
        let Course { steps, saved_per_site, .. } = self.course;
        DecoderProgress {
            step: steps,
            elapsed,
            remaining: left.and_then(|left| Duration::try_from_secs_f64(left).ok()),
            training_bits: saved_per_site * self.scene.decoded.len() as f64 / self.scene.pixels() as f64,
            tested,
        }
    }
}

/// How many sites a training sample reveals, and its weight.
pub(super) fn revealed_in_training(sites: usize, random: &mut ChaCha8Rng) -> Reveal {
    let share = random.random::<f64>().powf(EARLY).min(MOST_REVEALED);
    let count = ((share * sites as f64) as usize).min(sites.saturating_sub(1));
    let weight = (sites as f64 / (sites - count) as f64).min(HEAVIEST).sqrt();
    Reveal::Random { count, weight }
}
