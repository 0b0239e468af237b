//! A run as the window sees it, and the results of its starts.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::record::IdealRecord;
use super::score::judge_of;
use crate::design::{Frame, IdealEvent, IdealSettings, IdealState};
use crate::information::{EngineChoice, Estimate, Estimator, Protocol};
use crate::optics::LensletArray;
use crate::workbench::{DensityModel, Design, EstimateRequest};

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
    /// Results of the starts that came to their end, the best first.
    pub ranked: Vec<RankedStart>,
    /// All that is needed to repeat the run, as of its last refit.
    pub record: Option<Arc<IdealRecord>>,
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
}

/// Steps of the fits by which a result is scored, which can be repeated: about as many as a minute has on two cores.
pub(super) const BRACKET_STEPS: usize = 400;
pub(super) const LIVE_STEPS: usize = 2_000;

/// Rows and columns of the patches that results are scored by, px, where a measurement has as many.
pub(super) const SCORED_PATCH: (usize, usize) = (32, 32);

/// What the result of a run is scored by: a bracket where the prior of the objects is known.
pub(super) fn score_request(design: &Design, patch: (usize, usize)) -> EstimateRequest {
    let judge = judge_of(design);
    let steps = if judge == Estimator::Bracket { BRACKET_STEPS } else { LIVE_STEPS };
    EstimateRequest {
        model: DensityModel::new(judge, None, EngineChoice::default()).of_steps(steps),
        protocol: Protocol::Default,
        patch: Some(patch),
        // Fits draw fresh patches at every step.
        patches_train: 10_000,
        patches_test: 1_000,
        fresh: false,
        trials: 1,
        keep: None,
    }
}

impl RankedStart {
    /// What was asked of the estimate.
    pub fn request(&self) -> EstimateRequest {
        score_request(&self.design, self.estimate.patch.into())
    }

    /// What results are ranked by, bits per pixel: the lower bound where there is one, which nobody can climb by being
    /// looked at loosely, and the estimate otherwise.
    pub fn worth(&self) -> f64 {
        self.estimate.lower().unwrap_or(self.estimate.bits_per_pixel)
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
            step: 0,
            frames: Arc::default(),
            events: Vec::new(),
            doing: Some(("opening objects".into(), 0.0)),
            seconds: 0.0,
            left: None,
            start_number: (1, starts),
            ranked: Vec::new(),
            record: None,
        }
    }

    /// Takes over where the run has come to.
    pub(super) fn take_up(&mut self, state: &IdealState) {
        let more_frames = self.frames.len() != state.frames.len();
        // Before its first step the mask is that of the start; normalising its weights again may change their last digits.
        if self.step != state.step || more_frames {
            self.array = Arc::new(state.array.clone());
            self.step = state.step;
        }
        if more_frames {
            self.frames = Arc::new(state.frames.clone());
        }
        self.events.clone_from(&state.events);
    }

    /// Whether it computes, or waits to.
    pub fn is_active(&self) -> bool {
        matches!(self.status, RunStatus::Running | RunStatus::Paused)
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
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Start {
    /// What it is called.
    pub name: String,
    /// The design.
    pub design: Arc<Design>,
}
