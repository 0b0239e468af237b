//! The fit of a decoder to new samples of a channel.

use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::channel::BeadChannel;
use super::gradient::Passes;
use super::kind::DecoderKind;
use super::layers::Decoder;
use super::problem::Problem;
use super::samples::{Reveal, SampleRange};
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitArrays, FitCheckpoint, RestoredFit, fit_to_bytes, restore_fit};
use crate::information::stopwatch::Stopwatch;
use crate::nn::{Averaging, Optimizer, Rule, learning_rate_factor};
use crate::progress::Progress;

/// Share of a budget reserved for the test.
const TEST_SHARE: f64 = 0.06;
/// Number of steps without finite numbers after which a fit fails.
const MAX_REFUSED: usize = 30;
/// Gradients longer than this multiple of their running mean are shortened to it.
const LONGEST: f64 = 2.0;
/// Weight of a step in running means.
const RUNNING: f64 = 0.02;
/// Largest share of sites revealed in training. The share is distributed as `u^EARLY`, u uniform.
const MOST_REVEALED: f64 = 0.97;
const EARLY: f64 = 1.5;
/// Largest training weight of samples with few remaining sites, before its root is taken.
const HEAVIEST: f64 = 4.0;

/// Names of the checkpoint entries besides the weights.
const MEAN_NORM: &str = "mean_norm";
const SAVED: &str = "saved_per_site";
const NANOSECONDS: &str = "nanoseconds";

/// Settings of the fit and the test of a decoder.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoderFit {
    /// Inputs of the decoder besides the measurement.
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
    /// Seed of initial weights, samples and test.
    pub seed: u64,
}

impl DecoderFit {
    /// Largest learning rate of a fit from random weights.
    pub const RATE: f64 = 1e-2;
    /// Largest learning rate of a fit from a fitted decoder; larger steps lose what that one has learned. With six
    /// unrolled steps and 20 s the lower bound was 0.0004 to 0.0012 bits per pixel higher than with the other rate,
    /// before four kinds of beads.
    pub const RATE_ON: f64 = 3e-3;

    /// Default settings within a time budget.
    pub fn within(budget: Duration, kind: DecoderKind, seed: u64) -> Self {
        Self { budget: Some(budget), ..Self::of_steps(usize::MAX, kind, seed) }
    }

    /// Default settings for a number of steps. Equal seeds give equal bits on any number of threads.
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

    /// Checks that a fit takes steps.
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

/// Progress of a fit; sent after every step and every few test samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoderProgress {
    /// Training steps taken.
    pub step: usize,
    /// Time since the start.
    pub elapsed: Duration,
    /// Estimated time left for the fit, where known; the test comes after it.
    pub remaining: Option<Duration>,
    /// Running mean of the information gain over the prior on recent training samples, bits per pixel. Training
    /// reveals as many other sites. It converges near the bound.
    pub training_bits: f64,
    /// Test samples scored, after the fit.
    pub tested: Option<usize>,
}

/// The state of one fit.
pub(super) struct Run<'a> {
    fit: &'a DecoderFit,
    scene: &'a Problem,
    keeper: Option<&'a dyn FitCheckpoint>,
    time: Stopwatch,
    course: Course,
}

/// Progress and optimizer state of a fit.
struct Course {
    mover: Mover,
    steps: usize,
    saved_per_site: f64,
}

/// A fit of a number of steps, done in parts. Each part uses samples of the channel at that time.
pub struct DecoderRefit {
    fit: DecoderFit,
    decoder: Decoder,
    course: Course,
}

/// Optimizer of the weights of a decoder; shortens gradients that are unusually long.
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

    /// Takes one step of `rate` against the gradient in `unit`s; returns whether it did. A gradient without finite
    /// numbers is skipped.
    ///
    /// # Errors
    /// Where too many were skipped.
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

    /// Share of the steps of a fit that are done.
    fn share(&self, fit: &DecoderFit) -> f64 {
        self.steps as f64 / fit.steps.max(1) as f64
    }

    /// Takes one step on new samples of a problem.
    fn step(
        &mut self,
        fit: &DecoderFit,
        scene: &Problem,
        decoder: &mut Decoder,
        passes: &mut Passes<'_>,
        done: f64,
    ) -> Result<(), InformationError> {
        let sites = scene.decoded.len();
        let samples = SampleRange { seed: fit.seed, first: self.steps * fit.batch, count: fit.batch };
        let outcomes = match fit.kind {
            DecoderKind::Factorised => passes.train(decoder, samples, |_| Reveal::Nothing),
            DecoderKind::Autoregressive => passes.train(decoder, samples, |random| revealed_in_training(sites, random)),
        };
        self.steps += 1;
        if self.mover.step(decoder, &passes.gradient, 1.0, fit.rate * learning_rate_factor(done))? {
            let saved = outcomes.iter().map(|outcome| outcome.saved_bits_per_site).sum::<f64>() / outcomes.len() as f64;
            self.saved_per_site += RUNNING.max(1.0 / self.steps as f64) * (saved - self.saved_per_site);
        }
        Ok(())
    }

    /// Writes the checkpoint of the fit of a decoder after `elapsed` in all.
    fn keep(&self, keeper: &dyn FitCheckpoint, decoder: &Decoder, elapsed: Duration) -> Result<(), InformationError> {
        let Mover { optimizer, refused, mean_norm, .. } = &self.mover;
        let details = vec![
            (MEAN_NORM, mean_norm.to_string()),
            (SAVED, self.saved_per_site.to_string()),
            (NANOSECONDS, elapsed.as_nanos().to_string()),
        ];
        let numbers = FitArrays { weights: &decoder.weights, optimizer, best: None };
        keeper.store(&fit_to_bytes(keeper.key(), &numbers, self.steps, *refused, details)?)
    }

    /// Resumes from the checkpoint of the same fit, if there is one; returns its elapsed time.
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
    /// Starts a fit of its number of steps from the weights of a decoder.
    ///
    /// # Errors
    /// For an invalid fit.
    pub fn new(fit: DecoderFit, start: &Decoder) -> Result<Self, InformationError> {
        fit.check()?;
        Ok(Self { fit, decoder: start.clone(), course: Course::new(start) })
    }

    /// Advances to a total number of steps on samples of a channel. The number of steps so far is reported after
    /// every step.
    ///
    /// # Errors
    /// As [`decoder_lower_bound`](super::decoder_lower_bound).
    pub fn advance_to(
        &mut self,
        channel: &BeadChannel,
        steps: usize,
        progress: &mut dyn Progress<usize>,
    ) -> Result<(), InformationError> {
        let Self { fit, decoder, course } = self;
        let scene = Problem::new(channel)?;
        let mut passes = Passes::new(&scene, decoder);
        while course.steps < steps.min(fit.steps) {
            let done = course.share(fit);
            course.step(fit, &scene, decoder, &mut passes, done)?;
            if progress.report(&course.steps).is_break() {
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
    /// A fit from the weights of a decoder, or from the checkpoint of the same fit, whose weights then replace those
    /// of the decoder.
    pub fn new(
        fit: &'a DecoderFit,
        scene: &'a Problem,
        decoder: &mut Decoder,
        keeper: Option<&'a dyn FitCheckpoint>,
    ) -> Result<Self, InformationError> {
        let mut course = Course::new(decoder);
        let before = keeper.map(|keeper| course.restore(keeper, decoder)).transpose()?;
        Ok(Self { fit, scene, keeper, time: Stopwatch::after(before.unwrap_or_default()), course })
    }

    /// Takes all steps and gives the decoder the averaged weights. Returns the number of steps.
    pub fn train(
        &mut self,
        decoder: &mut Decoder,
        passes: &mut Passes<'_>,
        progress: &mut dyn Progress<DecoderProgress>,
    ) -> Result<usize, InformationError> {
        let mut kept = self.elapsed();
        loop {
            let done = self.done();
            if done >= 1.0 || self.course.steps >= self.fit.steps {
                break;
            }
            self.course.step(self.fit, self.scene, decoder, passes, done)?;
            let is_cancelled = progress.report(&self.progress(None)).is_break();
            if let Some(keeper) = self.keeper
                && (is_cancelled || self.elapsed() >= kept + keeper.every())
            {
                kept = self.elapsed();
                self.course.keep(keeper, decoder, kept)?;
            }
            if is_cancelled {
                return Err(InformationError::Cancelled);
            }
        }
        decoder.weights = self.course.mover.result(decoder);
        Ok(self.course.steps)
    }

    /// Time of the fit so far.
    pub fn elapsed(&self) -> Duration {
        self.time.elapsed()
    }

    /// Share of the schedule that is done.
    fn done(&self) -> f64 {
        match self.fit.budget {
            Some(budget) => self.elapsed().as_secs_f64() / (budget.as_secs_f64() * (1.0 - TEST_SHARE)).max(1e-9),
            None => self.course.share(self.fit),
        }
    }

    /// The present progress.
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

/// Number of sites that a training sample reveals, and its weight.
pub(super) fn revealed_in_training(sites: usize, random: &mut ChaCha8Rng) -> Reveal {
    let share = random.random::<f64>().powf(EARLY).min(MOST_REVEALED);
    let count = ((share * sites as f64) as usize).min(sites.saturating_sub(1));
    let weight = (sites as f64 / (sites - count) as f64).min(HEAVIEST).sqrt();
    Reveal::Random { count, weight }
}
