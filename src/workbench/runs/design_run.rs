//! A run as the window shows it, and the results of its starts.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::design::{Checkpoint, IdealEvent, IdealSettings, IdealState, Objective};
use crate::evaluation::{DensityModel, EstimateRequest, EvaluationError, WeightsFiles};
use crate::forward::Design;
use crate::information::{BoundMethod, EngineChoice, Estimate, Estimator, NUMBERS_VERSION, NamedBound, Protocol};
use crate::optics::{Encoder, LensletArray, heuristic_layout, random_layout};
use crate::studies::StudyRecord;
use crate::workbench::Live;
use crate::workbench::live::published::is_estimate_of;
use crate::workbench::runs::record::IdealRecord;
use crate::workbench::runs::score::scoring_estimator;

/// Status of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunStatus {
    /// The run computes.
    Running,
    /// The run is paused.
    Paused,
    /// The run was stopped and can be resumed.
    Stopped,
    /// The last fit is done.
    Finished,
    /// The run failed, with the reason.
    Failed(String),
}

/// A run with its results, as the window shows it.
#[derive(Clone, Debug)]
pub struct DesignRun {
    /// Design of the start.
    pub start: Arc<Design>,
    /// Settings of the run.
    pub settings: IdealSettings,
    /// Status of the run.
    pub status: RunStatus,
    /// Present mask.
    pub array: Arc<LensletArray>,
    /// Gradient of the information by the centre (x, y) of each lenslet, bits per pixel and pixel.
    pub position_gradients: Arc<Vec<(f64, f64)>>,
    /// Steps of the mask so far.
    pub step: usize,
    /// The masks at all refits so far.
    pub checkpoints: Arc<Vec<Checkpoint>>,
    /// Events besides gradient steps.
    pub events: Vec<IdealEvent>,
    /// Work besides gradient steps, and the share of it that is done, 0 to 1.
    pub doing: Option<(String, f64)>,
    /// Seconds of computing so far.
    pub seconds: f64,
    /// Estimated time that is left.
    pub left: Option<Duration>,
    /// Number of the current start, from 1, and number of all starts.
    pub start_number: (usize, usize),
    /// Whether a result is being scored or compared.
    pub is_scoring: bool,
    /// Failures of other starts, one sentence each.
    pub failures: Vec<String>,
    /// Results of the starts so far, the best first.
    pub ranked: Vec<RankedStart>,
    /// Comparison of the best result with its start and the heuristic layouts, as far as it is computed.
    pub comparison: Option<Arc<StudyRecord>>,
    /// Why the comparison failed.
    pub comparison_failure: Option<String>,
    /// Record of the run up to its newest checkpoint.
    pub record: Option<Arc<IdealRecord>>,
}

/// Bounds of a mask by one checkpoint of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunBounds {
    /// Whether the mask is that of the checkpoint; otherwise it has moved on since.
    pub is_of_mask: bool,
    /// Lower bound.
    pub lower: Option<NamedBound>,
    /// Upper bound.
    pub upper: Option<NamedBound>,
}

/// The result of one start.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct RankedStart {
    /// Name of the start.
    pub name: String,
    /// Design with the resulting mask.
    pub design: Arc<Design>,
    /// Score in patches, by an estimate with separate models on held-out objects.
    pub estimate: Estimate,
    /// Score for whole measurements, where these are larger than the patches.
    #[serde(default)]
    pub sensor: Option<Estimate>,
    /// Whether the score is complete.
    #[serde(default)]
    pub is_scored: bool,
    /// Why the last attempt at the score for whole measurements failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_failure: Option<String>,
    /// Record of the run.
    #[serde(default)]
    pub record: Option<Arc<IdealRecord>>,
}

/// Fit steps of a score, fixed so that it is reproducible: about a minute on two cores.
pub(super) const BRACKET_STEPS: usize = 400;
pub(super) const LIVE_STEPS: usize = 2_000;
/// Divisor of these steps for whole measurements, where each step takes longer.
const SENSOR_SHARE: usize = 4;

/// Request of a score in patches, or for whole measurements: a bracket where the prior of the objects is known.
pub(super) fn score_request(design: &Design, patch: Option<(usize, usize)>) -> EstimateRequest {
    let judge = scoring_estimator(design);
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

/// Score by an estimate, bits per pixel: the lower bound where there is one, and the estimate otherwise.
fn score_of(estimate: &Estimate) -> f64 {
    estimate.lower().unwrap_or(estimate.bits_per_pixel)
}

impl RankedStart {
    /// Requests of the scores.
    pub fn requests(&self) -> Vec<EstimateRequest> {
        let patches = score_request(&self.design, Some(self.estimate.patch.into()));
        std::iter::once(patches).chain(self.sensor.as_ref().map(|_| score_request(&self.design, None))).collect()
    }

    /// Sets the score for whole measurements, or that there is none; a failed score stays open.
    ///
    /// # Errors
    /// The error of the score.
    pub fn set_sensor(&mut self, scored: Result<Option<Estimate>, EvaluationError>) -> Result<(), EvaluationError> {
        self.sensor_failure = scored.as_ref().err().map(ToString::to_string);
        self.sensor = scored?;
        self.is_scored = true;
        Ok(())
    }

    /// Sorts results, the best first: by the score for the whole sensor where all have one, since neighbouring patches share
    /// information; by the score in patches otherwise.
    pub fn rank(results: &mut [Self]) {
        let whole = results.iter().all(|result| result.sensor.is_some());
        let score = |result: &Self| score_of(result.sensor.as_ref().filter(|_| whole).unwrap_or(&result.estimate));
        results.sort_by(|one, other| score(other).total_cmp(&score(one)));
    }
}

impl DesignRun {
    /// A run before its first step.
    pub(super) fn new(start: &Arc<Design>, settings: IdealSettings, starts: usize) -> Self {
        let none = || LensletArray::new(0, 0, Vec::new());
        Self {
            start: Arc::clone(start),
            array: Arc::new(start.encoder.lenslets().cloned().unwrap_or_else(none)),
            settings,
            status: RunStatus::Running,
            position_gradients: Arc::default(),
            step: 0,
            checkpoints: Arc::default(),
            events: Vec::new(),
            doing: Some(("opening objects".into(), 0.0)),
            seconds: 0.0,
            left: None,
            start_number: (1, starts),
            is_scoring: false,
            failures: Vec::new(),
            ranked: Vec::new(),
            comparison: None,
            comparison_failure: None,
            record: None,
        }
    }

    /// The run of one of the results, where its record is known.
    pub fn run_of_result(&self, result: usize) -> Option<Self> {
        let record = self.ranked.get(result)?.record.as_ref()?;
        let last = record.checkpoints.last()?;
        Some(Self {
            start: Arc::new(record.start.clone()),
            settings: record.settings.clone(),
            array: Arc::new(last.array.clone()),
            position_gradients: Arc::default(),
            step: last.step,
            checkpoints: Arc::new(record.checkpoints.clone()),
            events: record.events.clone(),
            record: Some(Arc::clone(record)),
            ..self.clone()
        })
    }

    /// Updates the run to a state of the optimizer.
    pub(super) fn sync(&mut self, state: &IdealState) {
        let more_checkpoints = self.checkpoints.len() != state.checkpoints.len();
        // Before the first step the mask is that of the start; normalising its weights again could change their last digits.
        let has_moved = state.step > 0 || !self.checkpoints.is_empty();
        if more_checkpoints || (has_moved && *self.array != state.array) {
            self.array = Arc::new(state.array.clone());
            self.position_gradients = Arc::new(state.position_gradients());
        }
        self.step = state.step;
        if more_checkpoints {
            self.checkpoints = Arc::new(state.checkpoints.clone());
        }
        self.events.clone_from(&state.events);
    }

    /// Failures of other starts and of scores, one sentence each.
    pub fn all_failures(&self) -> impl Iterator<Item = String> {
        let of_score = |result: &RankedStart| {
            let error = result.sensor_failure.as_ref()?;
            Some(format!("{} has no number for the whole sensor: {error}", result.name))
        };
        self.failures.iter().cloned().chain(self.ranked.iter().filter_map(of_score))
    }

    /// Whether the run computes or is paused.
    pub fn is_active(&self) -> bool {
        matches!(self.status, RunStatus::Running | RunStatus::Paused)
    }

    /// Whether all steps are taken and the result is not scored yet.
    pub fn is_being_scored(&self) -> bool {
        self.status != RunStatus::Finished && self.step >= self.settings.steps
    }

    /// Bounds of a design whose mask is that of a checkpoint, or the present one, for patches of this shape (rows, cols) or for whole
    /// measurements.
    pub fn bounds_of(&self, design: &Design, patch: Option<(usize, usize)>) -> Option<RunBounds> {
        let start = &self.start;
        let is_seen_alike = (start.bias_photons, start.noise) == (design.bias_photons, design.noise);
        if self.settings.patch != patch || !start.has_objects_of(design) || !is_seen_alike {
            return None;
        }
        let array = design.encoder.lenslets()?;
        let at = self.checkpoints.iter().rposition(|checkpoint| checkpoint.array == *array);
        let newest = || self.checkpoints.len().checked_sub(1).filter(|_| *self.array == *array);
        let checkpoint = &self.checkpoints[at.or_else(newest)?];
        let bound = |bits_per_pixel, interval_95| NamedBound {
            from: BoundMethod::Run { step: checkpoint.step },
            bits_per_pixel,
            interval_95,
        };
        let climbed = bound(checkpoint.bits_per_pixel, checkpoint.interval_95);
        let (lower, upper) = match self.settings.objective {
            Objective::Posterior => (Some(climbed), None),
            Objective::Density | Objective::PixelCnn => {
                (checkpoint.lower.map(|lower| bound(lower.bits_per_pixel, lower.interval_95)), Some(climbed))
            }
        };
        Some(RunBounds { is_of_mask: at.is_some(), lower, upper })
    }

    /// Scores of this design with these objects, by this version of the program.
    pub fn scores_of(&self, design: &Arc<Design>, live: &Live) -> impl Iterator<Item = &Estimate> {
        let is_of_today = |result: &&RankedStart| {
            let version = result.record.as_ref().map(|record| &*record.program_version);
            version == Some(NUMBERS_VERSION) && is_estimate_of(&result.estimate, &result.design, design, live)
        };
        let scored = self.ranked.iter().filter(is_of_today);
        scored.flat_map(|result| std::iter::once(&result.estimate).chain(&result.sensor))
    }

    /// Whether the run was stopped before its last step.
    pub fn can_resume(&self) -> bool {
        self.status == RunStatus::Stopped && (self.step > 0 || self.start_number.0 > 1)
    }

    /// Text of the present step, and of the start where there are several.
    pub fn place(&self) -> String {
        let (number, all) = self.start_number;
        let of_starts = if all > 1 { format!("start {number} of {all}, ") } else { String::new() };
        format!("{of_starts}step {} of {}", self.step, self.settings.steps)
    }
}

/// Start of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// Name of the start.
    pub name: String,
    /// The design.
    pub design: Arc<Design>,
}

/// A layout on the PSF grid of a design, with its throughput.
fn on_grid_of(design: &Design, layout: LensletArray) -> Encoder {
    let (rows, cols) = design.encoder.grid();
    Encoder::Lenslets(layout.on_grid(rows, cols)).with_throughput(design.encoder.throughput())
}

impl Start {
    /// The design with `count` random lenslets, its own PSF grid and its own throughput.
    pub fn random(design: &Design, count: usize, seed: u64) -> Self {
        let encoder = on_grid_of(design, random_layout(count, seed));
        Self { name: format!("{count} random, seed {seed}"), design: Arc::new(Design { encoder, ..design.clone() }) }
    }

    /// The design with the published layout of `count` lenslets, 1 to 9, its own PSF grid and its own throughput.
    pub fn heuristic(design: &Design, count: usize) -> Self {
        let encoder = on_grid_of(design, heuristic_layout(count));
        Self { name: format!("heuristic, {count}"), design: Arc::new(Design { encoder, ..design.clone() }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::Preset;
    use crate::evaluation::estimate;
    use crate::information::InformationError;
    use crate::progress::CancelToken;

    fn checkpoint(step: usize, array: &LensletArray) -> Checkpoint {
        Checkpoint {
            step,
            array: array.clone(),
            bits_per_pixel: 0.3,
            interval_95: [0.2, 0.4],
            lower: None,
            tamura: 0.8,
            cold_fit_bits: None,
            distinct_lenslets: 9,
            effective_lenslets: 9.0,
            seconds: 1.0,
        }
    }

    #[test]
    fn failed_score_stays_open() {
        let start = Start::random(&Design::default(), 3, 1);
        let request = EstimateRequest {
            model: DensityModel::Stationary,
            patches_train: 80,
            patches_test: 20,
            ..score_request(&start.design, Some((32, 32)))
        };
        let estimate = estimate(&start.design, &request, &mut CancelToken::new()).unwrap();
        let Start { name, design } = start;
        let scored = Some(estimate.clone());
        let mut result =
            RankedStart { name, design, estimate, sensor: None, is_scored: false, sensor_failure: None, record: None };
        let failure = EvaluationError::Information(InformationError::Empty);
        assert!(result.set_sensor(Err(failure)).is_err());
        assert!(!result.is_scored && result.sensor.is_none());
        let failures = |result: &RankedStart| {
            let settings = IdealSettings::new(Preset::Default, Objective::Density, 1);
            let run = DesignRun::new(&result.design, settings, 1);
            DesignRun { failures: vec!["other".into()], ranked: vec![result.clone()], ..run }.all_failures().collect()
        };
        let sentences: Vec<String> = failures(&result);
        assert!(
            sentences.len() == 2 && sentences[1].starts_with("3 random, seed 1 has no number for"),
            "{sentences:?}"
        );
        result.set_sensor(Ok(scored.clone())).unwrap();
        assert!(result.is_scored && result.sensor == scored);
        assert_eq!(failures(&result), ["other"]);
    }

    #[test]
    fn run_bounds_its_own_masks_only() {
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
        run.checkpoints = Arc::new(vec![checkpoint(0, &first), checkpoint(20, &second)]);
        run.array = Arc::new(newest.clone());
        let bound = |step: usize| {
            Some(NamedBound { from: BoundMethod::Run { step }, bits_per_pixel: 0.3, interval_95: [0.2, 0.4] })
        };
        let below = |is_of_mask, step| Some(RunBounds { is_of_mask, lower: bound(step), upper: None });
        assert_eq!(run.bounds_of(&start, Some((32, 32))), below(true, 0));
        assert_eq!(run.bounds_of(&with(&second), Some((32, 32))), below(true, 20));
        assert_eq!(run.bounds_of(&with(&newest), Some((32, 32))), below(false, 20));
        assert_eq!(run.bounds_of(&with(&newest), Some((16, 16))), None, "of other patches");
        let other = Design { seed: 2, ..with(&second) };
        assert_eq!(run.bounds_of(&other, Some((32, 32))), None, "another scene");
        newest.lenslets[1].x += 1.0;
        assert_eq!(run.bounds_of(&with(&newest), Some((32, 32))), None, "another mask");
        run.settings = settings(Objective::Density);
        let above = Some(RunBounds { is_of_mask: true, lower: None, upper: bound(20) });
        assert_eq!(run.bounds_of(&with(&second), Some((32, 32))), above);
    }
}
