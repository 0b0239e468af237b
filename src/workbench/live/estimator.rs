//! The live estimate: a causal density model that starts from the model of the design before the edit. It is scored during its fit, until
//! it converges.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ndarray::Axis;

use crate::evaluation::scene::{EvaluationError, Scene};
use crate::forward::{Design, ForwardModel};
use crate::information::{
    CausalFit, CausalModel, CausalStart, FitContext, FitLength, FitStep, InformationError, PatchBatch, PatchStream,
};
use crate::progress::{CancelToken, Progress};
use crate::workbench::live::bounds::{BeadBoundState, SensorBounds};
use crate::workbench::live::estimate::{LiveEstimate, ReplayRecipe, Revision, planned};
use crate::workbench::live::position_gradients::Pulls;
use crate::workbench::live::problem::LiveProblem;
use crate::workbench::live::schedule::{LiveSchedule, SCHEDULE};

/// A converged estimate that is to get more bounds.
struct PendingBounds {
    scene: Arc<Scene>,
    design: Design,
    estimate: LiveEstimate,
    /// Whether only the bounds for whole measurements are missing.
    only_sensor: bool,
}

/// Estimator that keeps the last model for the next design, and the pace of steps.
#[derive(Default)]
pub(crate) struct LiveEstimator {
    last: Option<(Arc<Scene>, Arc<CausalStart>)>,
    /// Amount by which annealed importance sampling lowered the smallest upper bound of such a design, bits per pixel.
    lowered: f64,
    /// Seconds per step, and the patch of that measurement.
    pace: Option<(f64, (usize, usize))>,
    /// A converged estimate whose last bounds were interrupted.
    awaits_bounds: Option<PendingBounds>,
    schedule: LiveSchedule,
}

/// Held-out patches of the scores during a fit. Those of the first score are drawn before the others: at a large field each takes
/// milliseconds.
struct HeldOut<'a> {
    subject: &'a LiveProblem<'a>,
    /// Patches of the first score.
    few: PatchBatch,
    /// Number of all patches, and these once they are needed.
    most: usize,
    all: Option<PatchBatch>,
}

impl<'a> HeldOut<'a> {
    fn new(subject: &'a LiveProblem<'a>, schedule: &LiveSchedule) -> Result<Self, InformationError> {
        let [(_, few), _] = schedule.first_scores;
        Ok(Self { subject, few: subject.test(few)?, most: schedule.score_patches, all: None })
    }

    /// The first of them.
    fn first(&mut self, count: usize) -> Result<PatchBatch, InformationError> {
        if count <= self.few.noisy.len_of(Axis(0)) {
            return Ok(self.few.first(count));
        }
        if self.all.is_none() {
            self.all = Some(self.subject.test(self.most)?);
        }
        Ok(self.all.as_ref().unwrap_or(&self.few).first(count))
    }
}

impl LiveEstimator {
    /// Divides the times of the schedule by `speed`.
    pub fn set_speed(&mut self, speed: f64) {
        self.schedule = SCHEDULE.at_speed(speed);
    }

    /// Sets the pace of steps, seconds per step.
    #[cfg(test)]
    pub fn set_pace(&mut self, pace: f64) {
        self.pace = Some((pace, (crate::evaluation::scene::LIVE_PATCH, crate::evaluation::scene::LIVE_PATCH)));
    }

    /// Refines the live estimate of a design until it converges, and compares it with the estimate before the last edit. `publish`
    /// receives every number; `cancel` is checked at every step.
    ///
    /// Every design is scored on the same held-out objects at the same places. Differences between edits then do not drown in the
    /// differences between scenes.
    ///
    /// # Errors
    /// [`InformationError::Cancelled`] when stopped; [`EvaluationError`] where design, objects or noise allow no estimate.
    #[allow(clippy::too_many_lines, reason = "one fit from its start to its last bounds, in the order of time")]
    pub fn refine(
        &mut self,
        design: &Design,
        before: Option<&Arc<Design>>,
        scene: &Arc<Scene>,
        publish: &mut dyn FnMut(LiveEstimate),
        cancel: &CancelToken,
    ) -> Result<(), EvaluationError> {
        let (asked, schedule) = (Instant::now(), self.schedule);
        let bounding = design.bounding();
        let forward = ForwardModel::of_objects(&bounding, Arc::clone(&scene.set))?;
        let subject = LiveProblem::new(&bounding, design.noise, scene, &forward)?;
        let mut beads = subject.beads(before);
        let mut pulls = Pulls::new(&forward, design.encoder.lenslets(), design.seed);
        let is_this = |awaiting: &PendingBounds| Arc::ptr_eq(&awaiting.scene, scene) && awaiting.design == *design;
        if let Some(mut awaiting) = self.awaits_bounds.take().filter(is_this) {
            beads.take_over(&awaiting.estimate, schedule.edit_samples_converged, cancel);
            awaiting.estimate = with_bounds(&beads, awaiting.estimate);
            // An edit may interrupt again.
            publish(awaiting.estimate.clone());
            return self.take_last_bounds(awaiting, &subject, &mut pulls, &mut beads, publish, cancel);
        }
        let serves = |(of, start): &(_, Arc<CausalStart>)| Arc::ptr_eq(of, scene) && start.is_of(bounding.noise);
        // The start is kept in case this fit does not begin.
        let start = self.last.as_ref().filter(|last| serves(last)).map(|(_, start)| Arc::clone(start));
        self.lowered = start.as_ref().map_or(0.0, |_| self.lowered);
        let mut held_out = HeldOut::new(&subject, &schedule)?;
        let (train, validation) = subject.fitting()?;
        let mut model = subject.model(&train, &held_out.few, start.as_deref())?;
        let time = if start.is_some() { schedule.warm_fit } else { schedule.cold_fit };
        let known = self.pace.filter(|(_, of)| *of == model.patch());
        let pace = known.map_or_else(|| trial_pace(&model, &train, cancel), |(pace, _)| Ok(pace))?;
        let mut recipe = ReplayRecipe::of(planned(time, pace));
        let fit = subject.fit(recipe.planned, start.is_some());
        let started = Instant::now();
        let score = |model: &CausalModel,
                     test: &PatchBatch,
                     recipe,
                     remaining: Option<Duration>,
                     cancel: &CancelToken| {
            let estimate = subject.score(model, test, recipe, start.clone(), cancel)?;
            Ok::<_, InformationError>(LiveEstimate { seconds: started.elapsed().as_secs_f64(), remaining, ..estimate })
        };
        let mut scores = schedule.first_scores.into_iter().map(|(after, patches)| (started + after, patches));
        let mut next = scores.next().unwrap_or((started, schedule.score_patches));
        let mut next_followed = schedule.first_ais;
        // Time spent outside the steps.
        let (mut aside, mut failure) = (Duration::ZERO, None);
        let context = FitContext { validation: validation.as_ref(), ..FitContext::new(&train) };
        let fitted = fit.fit(&mut model, &context, &mut |step: &FitStep<'_>| {
            cancel.check()?;
            let progress = &step.progress;
            let pace = progress.elapsed.saturating_sub(aside).as_secs_f64() / progress.step as f64;
            let (due, patches) = next;
            let before = Instant::now();
            recipe.steps = progress.step;
            // The last step gets the last score, which uses more patches.
            if before >= due && progress.step < recipe.all() {
                if known.is_none() && recipe.revised.is_none() && patches == schedule.score_patches {
                    let revision = Revision::of(progress.step, pace, time.saturating_sub(progress.elapsed));
                    recipe.revised = Some(revision);
                    step.plan(revision.planned);
                }
                let remaining = Duration::from_secs_f64(pace * (recipe.all() - progress.step) as f64);
                let test = held_out.first(patches);
                let drawn = Instant::now();
                let estimate = test.and_then(|test| score(&step.model(), &test, recipe, Some(remaining), cancel));
                let scoring = drawn.elapsed().mul_f64(schedule.score_patches as f64 / patches as f64);
                match estimate {
                    Ok(mut estimate) => {
                        estimate.pulls = pulls.gradients();
                        publish(with_bounds(&beads, estimate.clone()));
                        if beads.lower.is_none() && progress.elapsed >= schedule.first_decoder_bound {
                            self.take_first_bounds(&mut beads, &estimate, publish, cancel);
                        }
                        // Steps before the early score are more valuable.
                        if patches == schedule.score_patches
                            && beads.edit.is_none()
                            && beads.compare(schedule.edit_samples, cancel)
                        {
                            publish(with_bounds(&beads, estimate.clone()));
                        }
                        if progress.elapsed >= schedule.first_gradients {
                            estimate = with_pulls(&mut pulls, &subject, &beads, estimate, schedule.gradients, cancel);
                            publish(estimate.clone());
                        }
                        if progress.elapsed >= next_followed {
                            next_followed = Duration::MAX;
                            beads.follow(schedule.ais, cancel);
                            self.lowered = subject.lowered(&beads, estimate.bits_per_pixel).unwrap_or(self.lowered);
                            publish(with_bounds(&beads, estimate));
                        }
                    }
                    Err(error) => {
                        failure = (error != InformationError::Cancelled).then_some(error);
                        return ControlFlow::Break(());
                    }
                }
                aside += before.elapsed();
                next = scores.next().unwrap_or_else(|| {
                    let growing = asked + asked.elapsed().mul_f64(schedule.score_interval_growth);
                    let soon =
                        (asked + schedule.score_after_edit).checked_sub(scoring).filter(|soon| Instant::now() < *soon);
                    (soon.unwrap_or(growing), schedule.score_patches)
                });
            }
            if progress.step >= schedule.paced_steps {
                self.pace = Some((pace, subject.patch));
            }
            ControlFlow::Continue(())
        });
        if let Some(failure) = failure {
            return Err(failure.into());
        }
        // Weights of a diverged fit would spoil the next fit, too.
        let went_well = matches!(fitted, Ok(_) | Err(InformationError::Cancelled));
        self.last = went_well.then(|| (Arc::clone(scene), Arc::new(CausalStart::from(&model))));
        recipe.steps = fitted?.steps;
        // A fit that is complete is no longer lost.
        let mut estimate =
            score(&model, &subject.test(schedule.score_patches_converged)?, recipe, None, &CancelToken::new())?;
        estimate.bounding = beads.channel.is_some();
        estimate.pulls = pulls.gradients();
        publish(with_bounds(&beads, estimate.clone()));
        let awaiting = PendingBounds { scene: Arc::clone(scene), design: design.clone(), estimate, only_sensor: false };
        self.take_last_bounds(awaiting, &subject, &mut pulls, &mut beads, publish, cancel)
    }

    /// Computes the first lower bound, and the upper bound where its expected gain is large enough.
    fn take_first_bounds(
        &self,
        beads: &mut BeadBoundState<'_>,
        estimate: &LiveEstimate,
        publish: &mut dyn FnMut(LiveEstimate),
        cancel: &CancelToken,
    ) {
        let schedule = self.schedule;
        beads.decode(schedule.decoder_samples, cancel);
        publish(with_bounds(beads, estimate.clone()));
        if self.lowered > schedule.least_gain {
            beads.follow_from_above(schedule.ais_after_edit, cancel);
            publish(with_bounds(beads, estimate.clone()));
        }
    }

    /// Computes the position gradients of the converged estimate, then the bounds that use the prior once more, and then the bounds for
    /// whole measurements.
    fn take_last_bounds(
        &mut self,
        mut awaiting: PendingBounds,
        subject: &LiveProblem<'_>,
        pulls: &mut Pulls<'_>,
        beads: &mut BeadBoundState<'_>,
        publish: &mut dyn FnMut(LiveEstimate),
        cancel: &CancelToken,
    ) -> Result<(), EvaluationError> {
        let schedule = self.schedule;
        if !awaiting.only_sensor {
            awaiting.estimate =
                with_pulls(pulls, subject, beads, awaiting.estimate, schedule.gradients_converged, cancel);
            publish(awaiting.estimate.clone());
        }
        if !awaiting.only_sensor && beads.channel.is_some() {
            beads.decode(schedule.decoder_samples_converged, cancel);
            beads.compare(schedule.edit_samples_converged, cancel);
            beads.follow(schedule.ais_converged, cancel);
            awaiting.estimate = with_bounds(beads, awaiting.estimate);
            if !cancel.is_cancelled() {
                awaiting.only_sensor = true;
                publish(awaiting.estimate.clone());
            }
        }
        if !cancel.is_cancelled()
            && let Ok(Some((channel, ceiling))) = subject.whole()
        {
            let mut whole = BeadBoundState::new(Some(&channel), awaiting.design.seed);
            whole.decode(schedule.decoder_samples_sensor, cancel);
            whole.follow(schedule.ais_sensor, cancel);
            if let Some(sensor) = whole.of_sensor(channel.patch, ceiling).filter(|_| !cancel.is_cancelled()) {
                awaiting.estimate = with_sensor(Some(sensor), awaiting.estimate);
                publish(awaiting.estimate.clone());
            }
        }
        if beads.channel.is_some() {
            awaiting.estimate = with_pulls(pulls, subject, beads, awaiting.estimate, schedule.gradients_last, cancel);
        }
        if cancel.is_cancelled() {
            self.awaits_bounds = Some(awaiting);
            return Err(InformationError::Cancelled.into());
        }
        publish(LiveEstimate { bounding: false, ..awaiting.estimate });
        Ok(())
    }
}

/// Seconds per step, measured with a few steps whose result is discarded.
fn trial_pace(model: &CausalModel, train: &dyn PatchStream, cancel: &CancelToken) -> Result<f64, InformationError> {
    let mut trial = model.clone();
    // Patches are drawn before the first step, for several steps at once.
    let mut first = None;
    let on_step = &mut |_: &FitStep<'_>| {
        first.get_or_insert_with(Instant::now);
        cancel.check()
    };
    CausalFit::new(FitLength::Steps(SCHEDULE.paced_steps), 0).fit(&mut trial, &FitContext::new(train), on_step)?;
    Ok(first.map_or(0.0, |first| first.elapsed().as_secs_f64() / (SCHEDULE.paced_steps - 1) as f64))
}

/// Recomputes a live estimate from its recipe and its start.
///
/// # Errors
/// [`EvaluationError`] where design, objects or noise allow no estimate, or where `progress` cancels. It receives the number of
/// steps after each, and once more before the score and before the bounds.
pub(crate) fn repeated(
    design: &Design,
    before: Option<&Arc<Design>>,
    scene: &Scene,
    recipe: &ReplayRecipe,
    start: Option<&CausalStart>,
    progress: &mut dyn Progress<usize>,
) -> Result<LiveEstimate, EvaluationError> {
    let bounding = design.bounding();
    let forward = ForwardModel::of_objects(&bounding, Arc::clone(&scene.set))?;
    let subject = LiveProblem::new(&bounding, design.noise, scene, &forward)?;
    let test = subject.test(recipe.test_patches)?;
    let (train, validation) = subject.fitting()?;
    let mut model = subject.model(&train, &test, start)?;
    let settled = recipe.steps >= recipe.all();
    let mut scored = None;
    let fit = subject.fit(recipe.planned, start.is_some());
    let context = FitContext { validation: validation.as_ref(), ..FitContext::new(&train) };
    let fitted = fit.fit(&mut model, &context, &mut |step: &FitStep<'_>| {
        let steps = step.progress.step;
        progress.report(&steps)?;
        if steps == recipe.steps && !settled {
            scored = Some(step.model());
            return ControlFlow::Break(());
        }
        if let Some(revision) = recipe.revised.filter(|revision| revision.after == steps) {
            step.plan(revision.planned);
        }
        ControlFlow::Continue(())
    });
    let model = if let Some(scored) = scored {
        scored
    } else {
        fitted?;
        model
    };
    let cancel = &CancelToken::new();
    let mut report =
        || if progress.report(&recipe.steps).is_break() { Err(InformationError::Cancelled) } else { Ok(()) };
    report()?;
    let estimate = subject.score(&model, &test, *recipe, start.cloned().map(Arc::new), cancel)?;
    report()?;
    let mut beads = subject.beads(before);
    beads.repeat(recipe.lower, recipe.upper, cancel);
    if let Some(samples) = recipe.edit {
        beads.compare(samples, cancel);
    }
    let whole = if recipe.sensor.is_some() { subject.whole()? } else { None };
    let sensor = whole.zip(recipe.sensor).and_then(|((channel, ceiling), [lower, upper])| {
        let mut whole = BeadBoundState::new(Some(&channel), design.seed);
        whole.repeat(Some(lower), Some(upper), cancel);
        whole.of_sensor(channel.patch, ceiling)
    });
    Ok(with_sensor(sensor, with_bounds(&beads, estimate)))
}

/// The estimate with the bounds known so far and with position gradients, which are computed for `time`.
fn with_pulls(
    pulls: &mut Pulls<'_>,
    subject: &LiveProblem<'_>,
    beads: &BeadBoundState<'_>,
    estimate: LiveEstimate,
    time: Duration,
    cancel: &CancelToken,
) -> LiveEstimate {
    let is_loose = subject.is_loose(beads, estimate.bits_per_pixel);
    let pulls = pulls.look(&estimate.model, is_loose, time, cancel);
    with_bounds(beads, LiveEstimate { pulls, ..estimate })
}

/// The estimate with bounds for whole measurements.
fn with_sensor(sensor: Option<SensorBounds>, estimate: LiveEstimate) -> LiveEstimate {
    let recipe = ReplayRecipe { sensor: sensor.as_ref().map(|sensor| sensor.draws), ..estimate.recipe };
    LiveEstimate { recipe, sensor, ..estimate }
}

/// The estimate with the bounds known so far.
fn with_bounds(beads: &BeadBoundState<'_>, estimate: LiveEstimate) -> LiveEstimate {
    let ((lower, by_lower), (upper, by_upper)) = (beads.lower.clone().unzip(), beads.upper.clone().unzip());
    let (edit, by_edit) = beads.edit.unzip();
    let before = edit.and_then(|_| beads.before.as_ref().map(|(before, _)| Arc::clone(before)));
    let recipe = ReplayRecipe { lower: by_lower, upper: by_upper, edit: by_edit, ..estimate.recipe };
    LiveEstimate { recipe, lower, upper, before, edit, ..estimate }
}
