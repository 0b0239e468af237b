//! The live estimate: a causal density model that starts from the model of the design before the edit, is scored while it
//! is fitted, and settles.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ndarray::{Array2, Array3};
use serde::{Deserialize, Serialize};

use crate::evaluation::scene::{EvaluationError, Scene};
use crate::forward::Design;
use crate::forward::forward_model;
use crate::information::{
    CausalFit, CausalModel, CausalStart, FitLength, InformationError, NamedBound, PairedDifference, PatchBatch,
    PatchStream,
};
use crate::workbench::live::bounds::{BeadBoundState, BoundSource, SensorBounds};
use crate::workbench::live::position_gradients::{PositionGradient, Pulls};
use crate::workbench::live::problem::{LiveProblem, SCORED, SCORED_LAST};

/// Time for the steps of a fit from the beginning.
const COLD: Duration = Duration::from_mins(1);
/// The same for a fit from the model of a similar design.
const WARM: Duration = Duration::from_secs(20);
/// Steps from which their pace is told before the first fit, and the fewest and most steps of a fit.
const PACED: usize = 8;
const PLANNED: (f64, f64) = (200.0, 100_000.0);
/// Times from the beginning of a fit to its first scores, and their held-out patches: the first is to come soon.
const SCORES: [(Duration, usize); 2] = [(Duration::from_millis(150), 32), (Duration::from_millis(1200), 96)];
/// Time from an edit at which the next score is to be there, on [`SCORED`] patches, and by which the pace of a first fit is known
/// well enough to plan its rest; later scores follow at times that grow by [`GROWTH`].
const SOON: Duration = Duration::from_millis(4750);
const GROWTH: f64 = 1.7;
/// Time from the beginning of a fit from which on each score is followed by a look at where information pulls the lenslets, and how
/// long that takes then, once the estimate has settled, and once all bounds are there.
const FIRST_PULLED: Duration = Duration::from_secs(4);
const PULLED: Duration = Duration::from_millis(400);
const PULLED_LAST: Duration = Duration::from_secs(3);
const PULLED_MORE: Duration = Duration::from_secs(6);
/// Time from the beginning of a fit from which on the lower bound is taken along; the most samples that it rests on
/// then and once the estimate has settled.
const FIRST_LOWER: Duration = Duration::from_millis(700);
const LOWER_SAMPLES: usize = 256;
const LOWER_SAMPLES_LAST: usize = 2048;
/// Time from the beginning of a fit from which on the posterior is followed, and for how long on each side then and once
/// the estimate has settled.
const FIRST_FOLLOWED: Duration = Duration::from_secs(3);
const FOLLOWED: Duration = Duration::from_secs(3);
const FOLLOWED_LAST: Duration = Duration::from_secs(8);
/// The same for whole measurements, which come last.
const LOWER_SAMPLES_WHOLE: usize = 256;
const FOLLOWED_WHOLE: Duration = Duration::from_secs(10);
/// Samples of the comparison with the design before the last edit soon after it, and once the estimate has settled.
const EDIT_SAMPLES: usize = 128;
const EDIT_SAMPLES_LAST: usize = 512;
/// Time for the bound from above soon after an edit, and by how many bits per pixel that bound has to have lowered the smallest one
/// before the edit to be worth it: the density model has fewer steps then.
const FOLLOWED_SOON: Duration = Duration::from_secs(1);
const WORTH_FOLLOWING: f64 = 0.01;

/// An estimate that gets better while one waits: an upper bound on the information at any time.
#[derive(Clone, Debug)]
pub struct LiveEstimate {
    /// Bits per pixel.
    pub bits_per_pixel: f64,
    /// 95 % interval over held-out patches.
    pub interval_95: [f64; 2],
    /// Cross-entropy of the measurements, bits per pixel.
    pub entropy_y: f64,
    /// Entropy of the noise, bits per pixel.
    pub entropy_y_given_x: f64,
    /// Rows and columns of a patch.
    pub patch: (usize, usize),
    /// Seconds of the fit so far.
    pub seconds: f64,
    /// Time left until it settles; none once it has.
    pub remaining: Option<Duration>,
    /// Whether it has settled, but better bounds that know the prior are still to come.
    pub bounding: bool,
    /// How it came about.
    pub recipe: ReplayRecipe,
    /// The model of a similar design that the fit began with; none where it began with the weights of the program.
    pub start: Option<Arc<CausalStart>>,
    /// The model.
    pub model: Arc<CausalModel>,
    /// Where information pulls each lenslet; none for other masks and in the first seconds of a fit.
    pub pulls: Option<Vec<PositionGradient>>,
    /// The largest bound from below; none where the prior of the objects is not known, and in the first second of a fit.
    pub lower: Option<NamedBound>,
    /// Bound from above by posterior sampling; none where the prior is not known, and in the first seconds of a fit.
    pub upper: Option<NamedBound>,
    /// Bounds for whole measurements, once the estimate has settled; none where the prior is not known.
    pub sensor: Option<SensorBounds>,
    /// The design before the last edit, where that can be compared with this.
    pub before: Option<Arc<Design>>,
    /// By how much more is told of the design than of that one, by the decoder that comes with the program on the same scenes.
    pub edit: Option<PairedDifference>,
    /// Bits that each place of a patch adds to what the pixels before it have told, mean over held-out patches.
    pub mean_map: Array2<f32>,
    /// The same for some patches one by one, shape (n, rows, cols).
    pub maps: Array3<f32>,
    /// Those patches, photons, shape (n, rows, cols).
    pub patches: Array3<f32>,
}

/// How a live estimate came about; with what it started from, the same numbers come out again, bit for bit on one machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayRecipe {
    /// Steps that the fit was planned for, which its learning rates depend on.
    pub planned: usize,
    /// The later plan; none where it went on as planned.
    #[serde(default)]
    pub revised: Option<Revision>,
    /// Steps after which it was scored.
    pub steps: usize,
    /// Held-out patches that it was scored on.
    pub test_patches: usize,
    /// What the bound from below was drawn from.
    pub lower: Option<BoundSource>,
    /// What the bound by posterior sampling was drawn from.
    pub upper: Option<BoundSource>,
    /// What the bounds for whole measurements were drawn from, from below and from above.
    #[serde(default)]
    pub sensor: Option<[BoundSource; 2]>,
    /// Samples on which the mask was compared with that before the last edit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edit: Option<usize>,
}

/// Another number of steps for a fit that is going on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Revision {
    /// Steps that had been taken.
    pub after: usize,
    /// Steps in all from then on.
    pub planned: usize,
}

impl Revision {
    /// After so many steps at a pace in seconds, with so much time left: the few steps of a trial, beside which a window may just be
    /// opening, do not tell the pace well.
    fn of((after, pace): (usize, f64), rest: Duration) -> Self {
        Self { after, planned: (after + planned(rest, pace)).min(PLANNED.1 as usize) }
    }
}

impl ReplayRecipe {
    /// Before the first step of a fit of so many.
    pub(crate) fn of(planned: usize) -> Self {
        Self { planned, revised: None, steps: 0, test_patches: 0, lower: None, upper: None, sensor: None, edit: None }
    }

    /// Steps in all.
    fn all(&self) -> usize {
        self.revised.map_or(self.planned, |revision| revision.planned)
    }

    /// Whether a fit could have come about like this; others would never end, or not begin.
    pub(crate) fn is_valid(&self) -> bool {
        let sound = |draws: Option<BoundSource>| draws.is_none_or(BoundSource::is_valid);
        (1..=self.all()).contains(&self.steps)
            && (1..=SCORED_LAST).contains(&self.test_patches)
            && (self.planned.max(self.all()) as f64) <= PLANNED.1
            && self.revised.is_none_or(|revision| (1..self.planned).contains(&revision.after))
            && sound(self.lower)
            && sound(self.upper)
            && self.sensor.iter().flatten().all(|draws| draws.is_valid())
            && self.edit.is_none_or(|samples| (1..=EDIT_SAMPLES_LAST).contains(&samples))
    }
}

/// A settled estimate that is to have more bounds.
struct PendingBounds {
    scene: Arc<Scene>,
    design: Design,
    estimate: LiveEstimate,
    /// Whether those for whole measurements are all that is missing.
    only_sensor: bool,
}

/// Keeps the last model for the next design, and how fast steps are.
#[derive(Default)]
pub(crate) struct LiveEstimator {
    last: Option<(Arc<Scene>, Arc<CausalStart>)>,
    /// By how much posterior sampling lowered the smallest bound from above of such a design, bits per pixel.
    lowered: f64,
    /// Seconds of a step, and the patch that they are of.
    pace: Option<(f64, (usize, usize))>,
    /// A settled estimate whose last bounds were interrupted.
    awaits_bounds: Option<PendingBounds>,
}

impl LiveEstimator {
    /// Takes steps for as slow as this, seconds.
    #[cfg(test)]
    pub fn set_pace(&mut self, pace: f64) {
        self.pace = Some((pace, (crate::evaluation::scene::LIVE_PATCH, crate::evaluation::scene::LIVE_PATCH)));
    }

    /// Refines the live estimate of a design until it settles, and compares it with what it was before the last edit. `publish` gets
    /// every number; `stop` is asked at every step.
    ///
    /// Every design is scored on the same held-out objects at the same places, so that differences between edits are not
    /// drowned in those of the scenes.
    ///
    /// # Errors
    /// [`InformationError::Cancelled`] when stopped; [`EvaluationError`] where design, objects or noise allow no estimate.
    pub fn refine(
        &mut self,
        (design, before): (&Design, Option<&Arc<Design>>),
        scene: &Arc<Scene>,
        publish: &mut dyn FnMut(LiveEstimate),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), EvaluationError> {
        let asked = Instant::now();
        let bounding = design.bounding();
        let imaging = forward_model(&bounding, &scene.set)?;
        let subject = LiveProblem::new(&bounding, design.noise, scene, &imaging)?;
        let mut beads = subject.beads(before);
        let mut pulls = Pulls::new(&imaging, design.encoder.lenslets(), design.seed);
        let is_this = |awaiting: &PendingBounds| Arc::ptr_eq(&awaiting.scene, scene) && awaiting.design == *design;
        if let Some(mut awaiting) = self.awaits_bounds.take().filter(is_this) {
            beads.take_over(&awaiting.estimate, EDIT_SAMPLES_LAST, stop);
            awaiting.estimate = with_bounds(&beads, awaiting.estimate);
            // An edit may interrupt again.
            publish(awaiting.estimate.clone());
            return self.take_last_bounds(awaiting, (&subject, &mut pulls), &mut beads, publish, stop);
        }
        let serves = |(of, start): &(_, Arc<CausalStart>)| Arc::ptr_eq(of, scene) && start.is_of(bounding.noise);
        // Kept where this fit does not get to begin.
        let start = self.last.as_ref().filter(|last| serves(last)).map(|(_, start)| Arc::clone(start));
        self.lowered = start.as_ref().map_or(0.0, |_| self.lowered);
        let test = subject.test(SCORED)?;
        let (train, validation) = subject.fitting()?;
        let mut model = subject.model(&train, &test, start.as_deref())?;
        let time = if start.is_some() { WARM } else { COLD };
        let known = self.pace.filter(|(_, of)| *of == model.patch());
        let pace = known.map_or_else(|| trial_pace(&model, &train, stop), |(pace, _)| Ok(pace))?;
        let mut recipe = ReplayRecipe::of(planned(time, pace));
        let fit = subject.fit(recipe.planned, start.is_some());
        let started = Instant::now();
        let score = |of: (&CausalModel, &PatchBatch), recipe, remaining: Option<Duration>, stop: &dyn Fn() -> bool| {
            let estimate = subject.score(of, recipe, start.clone(), stop)?;
            Ok::<_, InformationError>(LiveEstimate { seconds: started.elapsed().as_secs_f64(), remaining, ..estimate })
        };
        let mut scores = SCORES.into_iter().map(|(after, patches)| (started + after, patches));
        let mut next = scores.next().unwrap_or((started, SCORED));
        let mut next_followed = FIRST_FOLLOWED;
        // Time beside the steps.
        let (mut aside, mut failure) = (Duration::ZERO, None);
        let fitted = fit.fit_watched(&mut model, (&train, validation.as_ref()), &mut |progress, snapshot| {
            if stop() {
                return ControlFlow::Break(());
            }
            let pace = progress.elapsed.saturating_sub(aside).as_secs_f64() / progress.step as f64;
            let (due, patches) = next;
            let before = Instant::now();
            recipe.steps = progress.step;
            let mut revision = None;
            // The last step has the last score, which is on more patches.
            if before >= due && progress.step < recipe.all() {
                if known.is_none() && recipe.revised.is_none() && patches == SCORED {
                    recipe.revised = Some(Revision::of((progress.step, pace), time.saturating_sub(progress.elapsed)));
                    revision = recipe.revised.map(|revision| revision.planned);
                }
                let remaining = Duration::from_secs_f64(pace * (recipe.all() - progress.step) as f64);
                let estimate = score((&snapshot(), &test.first(patches)), recipe, Some(remaining), stop);
                let scoring = before.elapsed().mul_f64(SCORED as f64 / patches as f64);
                match estimate {
                    Ok(mut estimate) => {
                        estimate.pulls = pulls.told();
                        publish(with_bounds(&beads, estimate.clone()));
                        if beads.lower.is_none() && progress.elapsed >= FIRST_LOWER {
                            self.take_first_bounds(&mut beads, &estimate, publish, stop);
                        }
                        // Steps before the score that is to be there soon are worth more.
                        if patches == SCORED && beads.edit.is_none() && beads.compare(EDIT_SAMPLES, stop) {
                            publish(with_bounds(&beads, estimate.clone()));
                        }
                        if progress.elapsed >= FIRST_PULLED {
                            estimate = with_pulls(&mut pulls, (&subject, &beads), estimate, PULLED, stop);
                            publish(estimate.clone());
                        }
                        if progress.elapsed >= next_followed {
                            next_followed = Duration::MAX;
                            beads.follow(FOLLOWED, stop);
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
                    let growing = asked + asked.elapsed().mul_f64(GROWTH);
                    let soon = (asked + SOON).checked_sub(scoring).filter(|soon| Instant::now() < *soon);
                    (soon.unwrap_or(growing), SCORED)
                });
            }
            if progress.step >= PACED {
                self.pace = Some((pace, subject.patch));
            }
            ControlFlow::Continue(revision)
        });
        if let Some(failure) = failure {
            return Err(failure.into());
        }
        // Weights of a fit that went astray would lead the next one astray, too.
        let went_well = matches!(fitted, Ok(_) | Err(InformationError::Cancelled));
        self.last = went_well.then(|| (Arc::clone(scene), Arc::new(CausalStart::from(&model))));
        recipe.steps = fitted?;
        // A fit that has come to its end is not lost any more.
        let mut estimate = score((&model, &subject.test(SCORED_LAST)?), recipe, None, &|| false)?;
        estimate.bounding = beads.channel.is_some();
        estimate.pulls = pulls.told();
        publish(with_bounds(&beads, estimate.clone()));
        let awaiting = PendingBounds { scene: Arc::clone(scene), design: design.clone(), estimate, only_sensor: false };
        self.take_last_bounds(awaiting, (&subject, &mut pulls), &mut beads, publish, stop)
    }

    /// Takes the bound from below for the first time, and that from above where it is worth it.
    fn take_first_bounds(
        &self,
        beads: &mut BeadBoundState<'_>,
        estimate: &LiveEstimate,
        publish: &mut dyn FnMut(LiveEstimate),
        stop: &(dyn Fn() -> bool + Sync),
    ) {
        beads.decode(LOWER_SAMPLES, stop);
        publish(with_bounds(beads, estimate.clone()));
        if self.lowered > WORTH_FOLLOWING {
            beads.follow_from_above(FOLLOWED_SOON, stop);
            publish(with_bounds(beads, estimate.clone()));
        }
    }

    /// Looks where information pulls the lenslets where the estimate has settled, takes the bounds that know the prior once more, and
    /// those for whole measurements.
    fn take_last_bounds(
        &mut self,
        mut awaiting: PendingBounds,
        (subject, pulls): (&LiveProblem<'_>, &mut Pulls<'_>),
        beads: &mut BeadBoundState<'_>,
        publish: &mut dyn FnMut(LiveEstimate),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), EvaluationError> {
        if !awaiting.only_sensor {
            awaiting.estimate = with_pulls(pulls, (subject, beads), awaiting.estimate, PULLED_LAST, stop);
            publish(awaiting.estimate.clone());
        }
        if !awaiting.only_sensor && beads.channel.is_some() {
            beads.decode(LOWER_SAMPLES_LAST, stop);
            beads.compare(EDIT_SAMPLES_LAST, stop);
            beads.follow(FOLLOWED_LAST, stop);
            awaiting.estimate = with_bounds(beads, awaiting.estimate);
            if !stop() {
                awaiting.only_sensor = true;
                publish(awaiting.estimate.clone());
            }
        }
        if !stop()
            && let Ok(Some((channel, ceiling))) = subject.whole()
        {
            let mut whole = BeadBoundState::new(Some(&channel), awaiting.design.seed);
            whole.decode(LOWER_SAMPLES_WHOLE, stop);
            whole.follow(FOLLOWED_WHOLE, stop);
            if let Some(sensor) = whole.of_sensor(channel.patch, ceiling).filter(|_| !stop()) {
                awaiting.estimate = with_sensor(Some(sensor), awaiting.estimate);
                publish(awaiting.estimate.clone());
            }
        }
        if beads.channel.is_some() {
            awaiting.estimate = with_pulls(pulls, (subject, beads), awaiting.estimate, PULLED_MORE, stop);
        }
        if stop() {
            self.awaits_bounds = Some(awaiting);
            return Err(InformationError::Cancelled.into());
        }
        publish(LiveEstimate { bounding: false, ..awaiting.estimate });
        Ok(())
    }
}

/// Steps for which a time suffices, at a pace in seconds. They are planned ahead, so that the fit does not depend on the clock.
fn planned(time: Duration, pace: f64) -> usize {
    (time.as_secs_f64() / pace.max(1e-9)).clamp(PLANNED.0, PLANNED.1) as usize
}

/// Seconds of a step, by a few that nothing comes of.
fn trial_pace(model: &CausalModel, train: &dyn PatchStream, stop: &dyn Fn() -> bool) -> Result<f64, InformationError> {
    let mut trial = model.clone();
    // Patches are drawn before the first step, for many.
    let mut first = None;
    CausalFit::new(FitLength::Steps(PACED), 0).fit(&mut trial, train, &mut |_| {
        first.get_or_insert_with(Instant::now);
        if stop() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    Ok(first.map_or(0.0, |first| first.elapsed().as_secs_f64() / (PACED - 1) as f64))
}

/// Computes a live estimate again from its recipe and what it started from.
///
/// # Errors
/// [`EvaluationError`] where design, objects or noise allow no estimate, or when cancelled: `go_on` is asked at every step
/// and told how many are done.
pub(crate) fn repeated(
    (design, before): (&Design, Option<&Arc<Design>>),
    scene: &Scene,
    (recipe, start): (&ReplayRecipe, Option<&CausalStart>),
    go_on: &(dyn Fn(usize) -> bool + Sync),
) -> Result<LiveEstimate, EvaluationError> {
    let bounding = design.bounding();
    let imaging = forward_model(&bounding, &scene.set)?;
    let subject = LiveProblem::new(&bounding, design.noise, scene, &imaging)?;
    let test = subject.test(recipe.test_patches)?;
    let (train, validation) = subject.fitting()?;
    let mut model = subject.model(&train, &test, start)?;
    let settled = recipe.steps >= recipe.all();
    let mut scored = None;
    let fit = subject.fit(recipe.planned, start.is_some());
    let fitted = fit.fit_watched(&mut model, (&train, validation.as_ref()), &mut |progress, snapshot| {
        if !go_on(progress.step) {
            return ControlFlow::Break(());
        }
        if progress.step == recipe.steps && !settled {
            scored = Some(snapshot());
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(recipe.revised.filter(|by| by.after == progress.step).map(|by| by.planned))
    });
    let model = if let Some(scored) = scored {
        scored
    } else {
        fitted?;
        model
    };
    let stop = || !go_on(recipe.steps);
    let estimate = subject.score((&model, &test), *recipe, start.cloned().map(Arc::new), &stop)?;
    let mut beads = subject.beads(before);
    beads.repeat((recipe.lower, recipe.upper), &stop);
    if let Some(samples) = recipe.edit {
        beads.compare(samples, &stop);
    }
    let whole = if recipe.sensor.is_some() { subject.whole()? } else { None };
    let sensor = whole.zip(recipe.sensor).and_then(|((channel, ceiling), [lower, upper])| {
        let mut whole = BeadBoundState::new(Some(&channel), design.seed);
        whole.repeat((Some(lower), Some(upper)), &stop);
        whole.of_sensor(channel.patch, ceiling)
    });
    // Bounds that were stopped are missing, which is no other number.
    if stop() {
        return Err(InformationError::Cancelled.into());
    }
    Ok(with_sensor(sensor, with_bounds(&beads, estimate)))
}

/// An estimate with the bounds that are known so far, and with where information pulls the lenslets, after a look for so long.
fn with_pulls(
    pulls: &mut Pulls<'_>,
    (subject, beads): (&LiveProblem<'_>, &BeadBoundState<'_>),
    estimate: LiveEstimate,
    time: Duration,
    stop: &dyn Fn() -> bool,
) -> LiveEstimate {
    let is_loose = subject.is_loose(beads, estimate.bits_per_pixel);
    let pulls = pulls.look((&estimate.model, is_loose), time, stop);
    with_bounds(beads, LiveEstimate { pulls, ..estimate })
}

/// An estimate with bounds for whole measurements.
fn with_sensor(sensor: Option<SensorBounds>, estimate: LiveEstimate) -> LiveEstimate {
    let recipe = ReplayRecipe { sensor: sensor.as_ref().map(|sensor| sensor.draws), ..estimate.recipe };
    LiveEstimate { recipe, sensor, ..estimate }
}

/// An estimate with the bounds that are known so far.
fn with_bounds(beads: &BeadBoundState<'_>, estimate: LiveEstimate) -> LiveEstimate {
    let ((lower, by_lower), (upper, by_upper)) = (beads.lower.clone().unzip(), beads.upper.clone().unzip());
    let (edit, by_edit) = beads.edit.unzip();
    let before = edit.and_then(|_| beads.before.as_ref().map(|(before, _)| Arc::clone(before)));
    let recipe = ReplayRecipe { lower: by_lower, upper: by_upper, edit: by_edit, ..estimate.recipe };
    LiveEstimate { recipe, lower, upper, before, edit, ..estimate }
}
