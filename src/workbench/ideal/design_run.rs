//! A run as the window sees it, and the results of its starts.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::design::{Frame, IdealEvent, IdealSettings, IdealState, Objective};
use crate::evaluation::scene::Scene;
use crate::evaluation::{DensityModel, EstimateRequest, EvaluationError, WeightsFiles};
use crate::forward::Design;
use crate::information::{EngineChoice, Estimate, Estimator, NUMBERS_VERSION, NamedBound, Protocol};
use crate::optics::{Encoder, LensletArray, heuristic_layout, random_layout};
use crate::studies::StudyRecord;
use crate::workbench::Live;
use crate::workbench::estimates::files::is_estimate_of;
use crate::workbench::ideal::record::IdealRecord;
use crate::workbench::ideal::score::judge_of;

/// What a run is doing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunStatus {
    /// It computes.
    Running,
    /// It waits to be told to go on.
    Paused,
    /// It was stopped; it can go on.
    Stopped,
    /// It came to its end.
    Finished,
    /// It could not go on, and why.
    Failed(String),
}

/// A run and what came of it, as the window sees it.
#[derive(Clone, Debug)]
pub struct DesignRun {
    /// The design that it started from.
    pub start: Arc<Design>,
    /// What it does.
    pub settings: IdealSettings,
    /// Whether it goes on.
    pub status: RunStatus,
    /// The mask now.
    pub array: Arc<LensletArray>,
    /// Where the information pulls the centre of each of its lenslets (x, y), bits per pixel and pixel.
    pub pulls: Arc<Vec<(f64, f64)>>,
    /// Steps of the mask so far.
    pub step: usize,
    /// The masks at all refits so far.
    pub frames: Arc<Vec<Frame>>,
    /// What else happened.
    pub events: Vec<IdealEvent>,
    /// What it is doing besides moving the mask, and how much of that is done.
    pub doing: Option<(String, f64)>,
    /// Seconds of computing so far.
    pub seconds: f64,
    /// Time that is left, once it can be told.
    pub left: Option<Duration>,
    /// Which of how many starts is being run, from 1.
    pub start_number: (usize, usize),
    /// Whether it goes on by itself: the starts after it are done.
    pub alone: bool,
    /// What failed of other starts and of scores, a sentence for each.
    pub failures: Vec<String>,
    /// Results of the starts that came to their end, the best first.
    pub ranked: Vec<RankedStart>,
    /// The best of them beside its start and the heuristic layouts, as far as that was computed.
    pub comparison: Option<Arc<StudyRecord>>,
    /// Why that ended early, where it was not stopped.
    pub comparison_failure: Option<String>,
    /// All that is needed to repeat the run, as of its last refit.
    pub record: Option<Arc<IdealRecord>>,
}

/// What a run knows of a mask, by the values at one of its refits.
#[derive(Clone, Debug, PartialEq)]
pub struct RunBounds {
    /// Whether the values are of this very mask, which has not moved on since.
    pub is_of_mask: bool,
    /// The information is at least this.
    pub lower: Option<NamedBound>,
    /// The information is at most this.
    pub upper: Option<NamedBound>,
}

/// The result of one start.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RankedStart {
    /// What it started from.
    pub name: String,
    /// The design in the end.
    pub design: Arc<Design>,
    /// What it is worth, by an estimate with a model of its own on held-out objects.
    pub estimate: Estimate,
    /// The same for whole measurements, where these are larger than the patches of that estimate.
    #[serde(default)]
    pub sensor: Option<Estimate>,
    /// Whether nothing of its score is to come any more.
    #[serde(default)]
    pub is_scored: bool,
    /// The run that led there.
    #[serde(default)]
    pub record: Option<Arc<IdealRecord>>,
}

/// Steps of the fits by which a result is scored, which can be repeated: about as many as a minute has on two cores.
pub(super) const BRACKET_STEPS: usize = 400;
pub(super) const LIVE_STEPS: usize = 2_000;
/// Share of them in the fits for whole measurements, of which each step takes longer.
const SENSOR_SHARE: usize = 4;

/// What the result of a run is scored by, in patches or for whole measurements: a bracket where the prior of the objects is known.
pub(super) fn score_request(design: &Design, patch: Option<(usize, usize)>) -> EstimateRequest {
    let judge = judge_of(design);
    let steps = if judge == Estimator::Bracket { BRACKET_STEPS } else { LIVE_STEPS };
    let steps = if patch.is_some() { steps } else { steps / SENSOR_SHARE };
    EstimateRequest {
        model: DensityModel::new(judge, None, EngineChoice::default()).of_steps(steps),
        protocol: Protocol::Default,
        patch,
        // Fits draw fresh patches at every step.
        patches_train: 10_000,
        patches_test: 1_000,
        fresh: false,
        trials: 1,
        keep: None,
        weights: WeightsFiles::default(),
    }
}

/// What a result is worth by an estimate, bits per pixel: the lower bound where there is one, which nobody can climb by being looked
/// at loosely, and the estimate otherwise.
fn worth(estimate: &Estimate) -> f64 {
    estimate.lower().unwrap_or(estimate.bits_per_pixel)
}

impl RankedStart {
    /// What was asked of the estimates.
    pub fn requests(&self) -> Vec<EstimateRequest> {
        let patches = score_request(&self.design, Some(self.estimate.patch.into()));
        std::iter::once(patches).chain(self.sensor.as_ref().map(|_| score_request(&self.design, None))).collect()
    }

    /// Takes up its score for whole measurements, or that it needs none; where that failed it is still to come, and the result stands
    /// without it.
    ///
    /// # Errors
    /// Why it failed.
    pub fn take_sensor(&mut self, scored: Result<Option<Estimate>, EvaluationError>) -> Result<(), EvaluationError> {
        self.sensor = scored?;
        self.is_scored = true;
        Ok(())
    }

    /// Puts results in their order, the best first: by what they are worth for the whole sensor where that is known of all, for
    /// patches count a point of the objects again in each of them, and in patches otherwise.
    pub fn rank(results: &mut [Self]) {
        let whole = results.iter().all(|result| result.sensor.is_some());
        let worth = |result: &Self| worth(result.sensor.as_ref().filter(|_| whole).unwrap_or(&result.estimate));
        results.sort_by(|one, other| worth(other).total_cmp(&worth(one)));
    }
}

impl DesignRun {
    /// A run that begins.
    pub(super) fn new(start: &Arc<Design>, settings: IdealSettings, starts: usize) -> Self {
        let none = || LensletArray { rows: 0, cols: 0, lenslets: Vec::new() };
        Self {
            start: Arc::clone(start),
            array: Arc::new(start.encoder.lenslets().cloned().unwrap_or_else(none)),
            settings,
            status: RunStatus::Running,
            pulls: Arc::default(),
            step: 0,
            frames: Arc::default(),
            events: Vec::new(),
            doing: Some(("opening objects".into(), 0.0)),
            seconds: 0.0,
            left: None,
            start_number: (1, starts),
            alone: false,
            failures: Vec::new(),
            ranked: Vec::new(),
            comparison: None,
            comparison_failure: None,
            record: None,
        }
    }

    /// The run that led to one of the results, where it is still known, with all masks on its way.
    pub fn that_led_to(&self, result: usize) -> Option<Self> {
        let record = self.ranked.get(result)?.record.as_ref()?;
        let last = record.frames.last()?;
        Some(Self {
            start: Arc::new(record.start.clone()),
            settings: record.settings.clone(),
            array: Arc::new(last.array.clone()),
            pulls: Arc::default(),
            step: last.step,
            frames: Arc::new(record.frames.clone()),
            events: record.events.clone(),
            record: Some(Arc::clone(record)),
            ..self.clone()
        })
    }

    /// Takes over where the run has come to.
    pub(super) fn take_up(&mut self, state: &IdealState) {
        let more_frames = self.frames.len() != state.frames.len();
        // Before its first move the mask is that of the start; normalising its weights again may change their last digits.
        let has_moved = state.step > 0 || !self.frames.is_empty();
        if more_frames || (has_moved && *self.array != state.array) {
            self.array = Arc::new(state.array.clone());
            self.pulls = Arc::new(state.pulls());
        }
        self.step = state.step;
        if more_frames {
            self.frames = Arc::new(state.frames.clone());
        }
        self.events.clone_from(&state.events);
    }

    /// Whether it computes, or waits to.
    pub fn is_active(&self) -> bool {
        matches!(self.status, RunStatus::Running | RunStatus::Paused)
    }

    /// Whether it was stopped after a step and before its last.
    pub fn can_end_here(&self) -> bool {
        self.status == RunStatus::Stopped && self.step > 0 && !self.is_being_scored()
    }

    /// Whether it has come to its end but for the score of its result.
    pub fn is_being_scored(&self) -> bool {
        self.status != RunStatus::Finished && self.step >= self.settings.steps
    }

    /// What is known of a design whose mask is one at a refit, or the newest one, for patches of this shape (rows, cols) or
    /// for whole measurements.
    pub fn bounds_of(&self, design: &Design, patch: Option<(usize, usize)>) -> Option<RunBounds> {
        let start = &self.start;
        let is_seen_alike = (start.bias_photons, start.noise) == (design.bias_photons, design.noise);
        if self.settings.patch != patch || !Scene::same_objects(start, design) || !is_seen_alike {
            return None;
        }
        let array = design.encoder.lenslets()?;
        let at = self.frames.iter().rposition(|frame| frame.array == *array);
        let newest = || self.frames.len().checked_sub(1).filter(|_| *self.array == *array);
        let frame = &self.frames[at.or_else(newest)?];
        let bound = |bits_per_pixel, interval_95| NamedBound {
            from: format!("run, step {}", frame.step),
            bits_per_pixel,
            interval_95,
        };
        let climbed = bound(frame.bits_per_pixel, frame.interval_95);
        let (lower, upper) = match self.settings.objective {
            Objective::Posterior => (Some(climbed), None),
            Objective::Density | Objective::PixelCnn => {
                (frame.lower.map(|lower| bound(lower.bits_per_pixel, lower.interval_95)), Some(climbed))
            }
        };
        Some(RunBounds { is_of_mask: at.is_some(), lower, upper })
    }

    /// The scores of its results that are of this design and its objects as they were read last, by this version of the program.
    pub fn scores_of(&self, design: &Arc<Design>, live: &Live) -> impl Iterator<Item = &Estimate> {
        let is_of_today = |result: &&RankedStart| {
            let version = result.record.as_ref().map(|record| &*record.program_version);
            version == Some(NUMBERS_VERSION) && is_estimate_of((&result.estimate, &result.design), design, live)
        };
        let scored = self.ranked.iter().filter(is_of_today);
        scored.flat_map(|result| std::iter::once(&result.estimate).chain(&result.sensor))
    }

    /// Whether it was stopped on its way.
    pub fn can_go_on(&self) -> bool {
        self.status == RunStatus::Stopped && (self.step > 0 || self.start_number.0 > 1)
    }

    /// How far it is: which step, and of which start where there are several.
    pub fn place(&self) -> String {
        let (number, all) = self.start_number;
        let of_starts = if all > 1 { format!("start {number} of {all}, ") } else { String::new() };
        format!("{of_starts}step {} of {}", self.step, self.settings.steps)
    }
}

/// A mask to start from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// What it is called.
    pub name: String,
    /// The design.
    pub design: Arc<Design>,
}

impl Start {
    /// Random lenslets in place of those of a design.
    pub fn random(design: &Design, count: usize, seed: u64) -> Self {
        let encoder = Encoder::Lenslets(random_layout(count, seed));
        Self { name: format!("{count} random, seed {seed}"), design: Arc::new(Design { encoder, ..design.clone() }) }
    }

    /// The published layout of so many lenslets, 1 to 9, in place of those of a design.
    pub fn heuristic(design: &Design, count: usize) -> Self {
        let encoder = Encoder::Lenslets(heuristic_layout(count));
        Self { name: format!("heuristic, {count}"), design: Arc::new(Design { encoder, ..design.clone() }) }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::design::Preset;
    use crate::evaluation::estimate;
    use crate::information::InformationError;

    fn frame(step: usize, array: &LensletArray) -> Frame {
        Frame {
            step,
            array: array.clone(),
            bits_per_pixel: 0.3,
            interval_95: [0.2, 0.4],
            lower: None,
            tamura: 0.8,
            afresh: None,
            distinct_lenslets: 9,
            effective_lenslets: 9.0,
            seconds: 1.0,
        }
    }

    #[test]
    fn a_score_that_failed_is_still_to_come() {
        let start = Start::random(&Design::default(), 3, 1);
        let request = EstimateRequest {
            model: DensityModel::Stationary,
            patches_train: 80,
            patches_test: 20,
            ..score_request(&start.design, Some((32, 32)))
        };
        let estimate = estimate(&start.design, &request, &mut |_| ControlFlow::Continue(())).unwrap();
        let Start { name, design } = start;
        let scored = Some(estimate.clone());
        let mut result = RankedStart { name, design, estimate, sensor: None, is_scored: false, record: None };
        let failure = EvaluationError::Information(InformationError::Empty);
        assert!(result.take_sensor(Err(failure)).is_err());
        assert!(!result.is_scored && result.sensor.is_none());
        result.take_sensor(Ok(scored.clone())).unwrap();
        assert!(result.is_scored && result.sensor == scored);
    }

    #[test]
    fn a_run_bounds_its_own_masks_alone() {
        let start = Arc::new(Design::default());
        let with = |array: &LensletArray| Design { encoder: Encoder::Lenslets(array.clone()), ..Design::clone(&start) };
        let first = start.encoder.lenslets().unwrap().clone();
        let mut second = first.clone();
        second.lenslets[0].x += 1.0;
        let mut newest = second.clone();
        newest.lenslets[0].x += 1.0;
        let settings =
            |objective| IdealSettings { patch: Some((32, 32)), ..IdealSettings::new(Preset::Default, objective, 1) };
        let mut run = DesignRun::new(&start, settings(Objective::Posterior), 1);
        assert_eq!(run.bounds_of(&start, Some((32, 32))), None, "nothing is known yet");
        run.frames = Arc::new(vec![frame(0, &first), frame(20, &second)]);
        run.array = Arc::new(newest.clone());
        let told = |step: usize| {
            Some(NamedBound { from: format!("run, step {step}"), bits_per_pixel: 0.3, interval_95: [0.2, 0.4] })
        };
        let below = |is_of_mask, step| Some(RunBounds { is_of_mask, lower: told(step), upper: None });
        assert_eq!(run.bounds_of(&start, Some((32, 32))), below(true, 0));
        assert_eq!(run.bounds_of(&with(&second), Some((32, 32))), below(true, 20));
        assert_eq!(run.bounds_of(&with(&newest), Some((32, 32))), below(false, 20));
        assert_eq!(run.bounds_of(&with(&newest), Some((16, 16))), None, "of other patches");
        let other = Design { seed: 2, ..with(&second) };
        assert_eq!(run.bounds_of(&other, Some((32, 32))), None, "another scene");
        newest.lenslets[1].x += 1.0;
        assert_eq!(run.bounds_of(&with(&newest), Some((32, 32))), None, "another mask");
        run.settings = settings(Objective::Density);
        let above = Some(RunBounds { is_of_mask: true, lower: None, upper: told(20) });
        assert_eq!(run.bounds_of(&with(&second), Some((32, 32))), above);
    }
}
