//! The fit of a `PixelCNN` to training patches.

use std::time::{Duration, Instant};

use ndarray::{ArrayView3, Axis, s};

use super::batches::{Batches, Purpose, prepared, seed_for};
use super::engine::Engine;
use super::initial_mixture::spread_over;
use super::model::{PixelCnn, check};
use super::protocols::{FitReport, PixelCnnContext, PixelCnnFit, TrainingPatches};
use super::scale::DataScale;
use super::shape::PixelCnnShape;
use crate::information::density::patch_checks::{check_clean, check_values};
use crate::information::error::InformationError;
use crate::information::fit_checkpoint::{FitArrays, FitCheckpoint, RestoredFit, fit_to_bytes, restore_fit, unread};
use crate::information::progress::FitProgress;
use crate::information::stopwatch::Stopwatch;
use crate::nn::{Optimizer, Rule, learning_rate_factor};
use crate::progress::Progress;

/// Largest share of the time of a budgeted fit for validation before the last one.
const VALIDATION_SHARE: f64 = 0.1;
/// Number of steps without finite numbers after which a fit fails.
const MAX_REFUSED: usize = 30;
/// Held-out patches scored between two checks for cancellation.
pub(in crate::information) const SCORED_AT_ONCE: usize = 16;
/// Norm above which a gradient counts as infinite.
const LARGEST_NORM: f64 = 1e15;

impl PixelCnnFit {
    /// Fits a network of the given shape.
    ///
    /// Widths of the mixture stay above `min_width` photons. With a budget the number of steps depends on the
    /// machine. Without one, equal seeds give equal bits on one machine with the engine `cpu`, for any number of
    /// threads.
    ///
    /// # Errors
    /// For too few, constant, too bright or invalid patches, for numbers that stay infinite, for an engine that this
    /// program or machine lacks, and when cancelled. Where the checkpoint cannot be read or written, or belongs to
    /// another fit.
    pub fn fit(
        &self,
        shape: PixelCnnShape,
        min_width: f32,
        &PixelCnnContext { patches, start, keeper }: &PixelCnnContext<'_>,
        progress: &mut dyn Progress<FitProgress>,
    ) -> Result<(PixelCnn, FitReport), InformationError> {
        let validation = self.check(patches)?;
        let scale = DataScale::of(patches.noisy.slice(s![validation.., .., ..]), min_width)?;
        let mut model = PixelCnn::new(shape, scale, seed_for(self.seed, Purpose::Weights, 0));
        if let Some(start) = start.filter(|start| start.shape == model.shape) {
            model.weights.copy_from_slice(&start.weights);
        } else if self.photon_scale {
            spread_over(&mut model, patches.noisy);
        }
        let held_out = patches.noisy.slice(s![..validation, .., ..]);
        let held_out = prepared(held_out, self.dequantise, seed_for(self.seed, Purpose::Validation, 0));
        let mut batches = Batches::new(patches, validation, self.dequantise, self.seed);
        let mut run = Run::new(self, &model, keeper)?;
        run.restore(&mut model)?;
        batches.skip(run.report.steps, self.batch.max(1));
        let cut_short = run.epochs(&mut model, batches, held_out.view(), progress)?;
        let Run { best, report, .. } = run;
        if let Some((weights, _)) = best {
            model.weights = weights;
        }
        Ok((model, FitReport { cut_short, ..report }))
    }

    /// Adam for all tensors, or Muon for the matrices between the first and the last layer.
    fn optimizer(&self, model: &PixelCnn) -> Optimizer {
        Optimizer::new(&model.layout, &model.weights, self.averaging, |tensor| {
            let hidden = tensor.name.starts_with("block") || tensor.name.starts_with("out");
            if self.photon_scale && tensor.name.starts_with("heads") {
                // Means and widths are in photons, logits are not.
                let components = model.shape.components;
                let mut factors = vec![model.scale.deviation.max(1.0); 3 * components];
                factors[2 * components..].fill(1.0);
                Rule::Columns(factors)
            } else if self.muon && hidden {
                Rule::Muon
            } else {
                Rule::Adam
            }
        })
    }

    /// Checks settings and patches; returns the number of validation patches.
    fn check(&self, patches: TrainingPatches<'_>) -> Result<usize, InformationError> {
        let (count, rows, cols) = patches.noisy.dim();
        let validation = (count / 10).min(self.max_validation).max(1);
        if count < self.batch.max(1) + validation {
            let (model, needed) = ("a PixelCNN", self.batch.max(1) + validation);
            return Err(InformationError::TooFewPatches { model, needed, found: count, pixels: rows * cols });
        }
        check(patches.noisy)?;
        if let Some((clean, _)) = patches.clean {
            check_clean(clean, patches.noisy)?;
            check_values(clean, "clean training patches")?;
        }
        Ok(validation)
    }
}

/// The state of one fit.
struct Run<'a> {
    fit: &'a PixelCnnFit,
    time: Stopwatch,
    keeper: Option<&'a dyn FitCheckpoint>,
    /// Time of the last checkpoint.
    kept: Instant,
    optimizer: Optimizer,
    engine: Box<dyn Engine>,
    /// Gradient of the loss of the last batch by all weights.
    gradient: Vec<f32>,
    /// Step scale, halved whenever a step is skipped.
    caution: f64,
    best: Option<(Vec<f32>, f64)>,
    report: FitReport,
    /// Time the last validation took.
    validation: Duration,
}

impl<'a> Run<'a> {
    fn new(
        fit: &'a PixelCnnFit,
        model: &PixelCnn,
        keeper: Option<&'a dyn FitCheckpoint>,
    ) -> Result<Self, InformationError> {
        Ok(Self {
            fit,
            time: Stopwatch::after(Duration::ZERO),
            keeper,
            kept: Instant::now(),
            optimizer: fit.optimizer(model),
            engine: fit.engine.open()?,
            gradient: vec![0.0; model.layout.count()],
            caution: 1.0,
            best: None,
            report: FitReport { steps: 0, epochs: Vec::new(), best_epoch: 0, refused: 0, cut_short: false },
            validation: Duration::ZERO,
        })
    }

    /// Restores the checkpoint, if there is one.
    fn restore(&mut self, model: &mut PixelCnn) -> Result<(), InformationError> {
        let Some(keeper) = self.keeper else { return Ok(()) };
        let Some(kept) = restore_fit(keeper, &mut model.weights, &mut self.optimizer)? else { return Ok(()) };
        let RestoredFit { details, steps, refused, best } = kept;
        let nanoseconds = |name: &str| details.number(name).map(Duration::from_nanos);
        self.caution = details.number("caution")?;
        self.validation = nanoseconds("validation")?;
        if let Some(weights) = best {
            self.best = Some((weights, details.number("best_bits")?));
        }
        let epochs: Result<Vec<(f64, Option<f64>)>, _> = serde_json::from_str(details.text("epochs"));
        let epochs = epochs.map_err(|error| unread(keeper, &error))?;
        let epochs = epochs.into_iter().map(|(seconds, bits)| (seconds, bits.unwrap_or(f64::NAN))).collect();
        let best_epoch = details.number("best_epoch")?;
        self.report = FitReport { steps, epochs, best_epoch, refused, cut_short: false };
        self.time = Stopwatch::after(nanoseconds("nanoseconds")?);
        Ok(())
    }

    /// Writes the checkpoint if it is due.
    fn keep_if_due(&mut self, model: &PixelCnn) -> Result<(), InformationError> {
        let is_due = self.keeper.is_some_and(|keeper| self.kept.elapsed() >= keeper.every());
        if is_due { self.keep(model) } else { Ok(()) }
    }

    /// Writes the checkpoint.
    fn keep(&mut self, model: &PixelCnn) -> Result<(), InformationError> {
        let Some(keeper) = self.keeper else { return Ok(()) };
        let report = &self.report;
        // NaN becomes null in JSON.
        let epochs = serde_json::to_string(&report.epochs);
        let mut details = vec![
            ("caution", self.caution.to_string()),
            ("validation", self.validation.as_nanos().to_string()),
            ("epochs", epochs.map_err(|error| InformationError::Format { reason: error.to_string() })?),
            ("best_epoch", report.best_epoch.to_string()),
            ("nanoseconds", self.time.elapsed().as_nanos().to_string()),
        ];
        let best = self.best.as_ref().map(|(weights, bits)| {
            details.push(("best_bits", bits.to_string()));
            weights.as_slice()
        });
        let numbers = FitArrays { weights: &model.weights, optimizer: &self.optimizer, best };
        keeper.store(&fit_to_bytes(keeper.key(), &numbers, report.steps, report.refused, details)?)?;
        self.kept = Instant::now();
        Ok(())
    }

    /// Runs all epochs; returns whether the budget cut them short.
    fn epochs(
        &mut self,
        model: &mut PixelCnn,
        mut batches: Batches<'_>,
        held_out: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<FitProgress>,
    ) -> Result<bool, InformationError> {
        let fit = self.fit;
        loop {
            let epoch = self.report.epochs.len() + 1;
            loop {
                self.keep_if_due(model)?;
                let done = self.done();
                let rate = fit.rate * self.caution * if fit.schedule { learning_rate_factor(done) } else { 1.0 };
                self.step(model, &mut batches, rate)?;
                let is_epoch_over = self.out_of_time() || (self.epochs_done(epoch) && self.can_spare_validation());
                if progress.report(&self.progress(epoch)).is_break() {
                    // A resumed fit takes a step first.
                    if !is_epoch_over {
                        self.keep(model)?;
                    }
                    return Err(InformationError::Cancelled);
                }
                if is_epoch_over {
                    break;
                }
            }
            self.validate(model, held_out, progress)?;
            if self.finished() {
                return Ok(false);
            }
            if self.out_of_time() {
                return Ok(!fit.schedule);
            }
        }
    }

    /// Share of the schedule that is done.
    fn done(&self) -> f64 {
        match self.fit.budget {
            Some(budget) if self.fit.schedule => {
                let budget = budget.saturating_sub(self.validation).as_secs_f64();
                (self.time.elapsed().as_secs_f64() / budget.max(1e-9)).min(1.0)
            }
            _ => self.report.steps as f64 / (self.fit.max_epochs * self.fit.steps_per_epoch).max(1) as f64,
        }
    }

    /// Whether the last epoch is done.
    fn epochs_done(&self, epochs: usize) -> bool {
        if self.fit.budget.is_some() && self.fit.schedule {
            self.done() * self.fit.max_epochs as f64 >= epochs as f64
        } else {
            self.report.steps >= epochs * self.fit.steps_per_epoch
        }
    }

    fn out_of_time(&self) -> bool {
        self.fit.budget.is_some_and(|budget| self.time.elapsed() + self.validation >= budget)
    }

    /// Whether one more validation fits into its share of a short budget.
    fn can_spare_validation(&self) -> bool {
        let spent = self.validation * (self.report.epochs.len() as u32 + 1);
        self.fit.budget.is_none()
            || !self.fit.schedule
            || spent.as_secs_f64() < VALIDATION_SHARE * self.time.elapsed().as_secs_f64()
    }

    fn finished(&self) -> bool {
        let epochs = self.report.epochs.len();
        epochs >= self.fit.max_epochs
            || self.fit.patience.is_some_and(|patience| epochs >= self.report.best_epoch + patience)
    }

    fn step(&mut self, model: &mut PixelCnn, batches: &mut Batches<'_>, rate: f64) -> Result<(), InformationError> {
        let batch = batches.draw(self.fit.batch.max(1));
        let loss = self.engine.loss_and_gradients(model, batch.view(), &mut self.gradient, None)?;
        let norm = self.gradient.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt();
        self.report.steps += 1;
        if !(loss.is_finite() && norm < LARGEST_NORM) {
            self.report.refused += 1;
            self.caution *= 0.5;
            let refused = self.report.refused;
            return if refused < MAX_REFUSED { Ok(()) } else { Err(InformationError::Diverged { refused }) };
        }
        let scale = self.fit.max_norm.map_or(1.0, |most| (most / norm.max(1e-30)).min(1.0));
        self.optimizer.step(&mut model.weights, &self.gradient, scale as f32, rate as f32);
        Ok(())
    }

    /// Scores the validation patches and saves the weights if they are the best so far.
    fn validate(
        &mut self,
        model: &mut PixelCnn,
        held_out: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<FitProgress>,
    ) -> Result<(), InformationError> {
        let began = Instant::now();
        let candidate = PixelCnn { weights: self.optimizer.result(&model.weights).to_vec(), ..model.clone() };
        let mut bits = Vec::with_capacity(held_out.len_of(Axis(0)));
        for part in held_out.axis_chunks_iter(Axis(0), SCORED_AT_ONCE) {
            bits.extend(self.engine.cross_entropy_bits(&candidate, part)?);
            if progress.report(&self.progress(self.report.epochs.len() + 1)).is_break() {
                return Err(InformationError::Cancelled);
            }
        }
        let mean = bits.iter().sum::<f64>() / held_out.len_of(Axis(0)) as f64;
        self.report.epochs.push((self.time.elapsed().as_secs_f64(), mean));
        if mean.is_finite() && self.best.as_ref().is_none_or(|(_, best)| mean < *best) {
            self.best = Some((candidate.weights, mean));
            self.report.best_epoch = self.report.epochs.len();
        }
        self.validation = began.elapsed();
        Ok(())
    }

    fn progress(&self, epoch: usize) -> FitProgress {
        let elapsed = self.time.elapsed();
        let done = self.done();
        let by_schedule =
            (done > 0.0).then(|| Duration::try_from_secs_f64(elapsed.as_secs_f64() * (1.0 / done - 1.0)).ok());
        let by_budget = self.fit.budget.map(|budget| budget.saturating_sub(elapsed));
        FitProgress {
            epoch,
            epochs: self.fit.max_epochs,
            step: self.report.steps,
            validation_bits: self.report.epochs.last().map(|&(_, bits)| bits),
            best_bits: self.best.as_ref().map(|&(_, bits)| bits),
            elapsed,
            remaining: match (by_schedule.flatten(), by_budget) {
                (Some(a), Some(b)) => Some(a.min(b)),
                (a, b) => a.or(b),
            },
            scored: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use ndarray::Array3;

    use super::*;
    use crate::information::fit_checkpoint::InMemory;
    use crate::sensor::Noise;

    fn patches() -> Array3<f32> {
        Array3::from_shape_fn((60, 6, 6), |(n, r, c)| (20 + (n * 31 + r * 17 + c * 7) % 23) as f32)
    }

    fn shape() -> PixelCnnShape {
        PixelCnnShape::new(8, 4, vec![1, 2]).unwrap()
    }

    #[test]
    fn a_stopped_fit_goes_on_bit_for_bit() {
        let clean = patches();
        let noisy = Noise::Shot.draw(clean.view(), 5);
        let paper = PixelCnnFit { batch: 5, steps_per_epoch: 12, max_epochs: 4, ..PixelCnnFit::paper(3) };
        let standard = PixelCnnFit { steps_per_epoch: 12, max_epochs: 4, ..PixelCnnFit::standard(3) };
        for fit in [paper, standard] {
            let run = |keeper: Option<&dyn FitCheckpoint>, stop_at: usize| {
                let mut asked = 0;
                let patches = TrainingPatches { noisy: noisy.view(), clean: Some((clean.view(), Noise::Shot)) };
                let context = PixelCnnContext { keeper, ..PixelCnnContext::new(patches) };
                let fitted = fit.fit(shape(), 1.0, &context, &mut |_: &FitProgress| {
                    asked += 1;
                    if asked == stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
                });
                fitted.map(|(model, report)| (model.weights, report, asked))
            };
            let (weights, report, asked) = run(None, usize::MAX).unwrap();
            assert_eq!(report.steps, 48);
            let left = InMemory::of_cancelled();
            assert_eq!(run(Some(&left), 31).unwrap_err(), InformationError::Cancelled);
            let (resumed, again, _) = run(Some(&left), usize::MAX).unwrap();
            assert_eq!((resumed, again.steps), (weights.clone(), report.steps));
            let kept = InMemory::default();
            // During the third epoch, and during a validation.
            for stop_at in [31, 8] {
                assert_eq!(run(Some(&kept), stop_at).unwrap_err(), InformationError::Cancelled);
            }
            let (resumed, again, rest) = run(Some(&kept), usize::MAX).unwrap();
            assert!(rest < asked - 30, "{rest} {asked}");
            assert_eq!(resumed, weights);
            let bits = |report: &FitReport| report.epochs.iter().map(|epoch| epoch.1.to_bits()).collect::<Vec<_>>();
            assert_eq!((again.steps, again.best_epoch, bits(&again)), (report.steps, report.best_epoch, bits(&report)));
            *kept.state.lock().unwrap() = Some(b"something else".to_vec());
            assert!(run(Some(&kept), usize::MAX).unwrap_err().to_string().contains("memory"));
        }
    }

    #[test]
    fn a_validation_can_be_left() {
        let noisy = patches();
        let noisy = ndarray::concatenate![Axis(0), noisy, noisy, noisy, noisy, noisy, noisy];
        let patches = TrainingPatches { noisy: noisy.view(), clean: None };
        let fit = PixelCnnFit { batch: 2, steps_per_epoch: 3, max_epochs: 1, ..PixelCnnFit::paper(3) };
        let mut asked = 0;
        let fitted = fit.fit(shape(), 1.0, &PixelCnnContext::new(patches), &mut |_: &FitProgress| {
            asked += 1;
            // Three steps, and one part of 36 patches.
            if asked == 4 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert_eq!((fitted.unwrap_err(), asked), (InformationError::Cancelled, 4));
    }
}
