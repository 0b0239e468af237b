//! The live estimate as it is published, and the recipe that reproduces it.

use std::sync::Arc;
use std::time::Duration;

use ndarray::{Array2, Array3};
use serde::{Deserialize, Serialize};

use crate::forward::Design;
use crate::information::{CausalModel, CausalStart, NamedBound, PairedDifference};
use crate::workbench::live::bounds::{BoundSource, SensorBounds};
use crate::workbench::live::position_gradients::PositionGradient;
use crate::workbench::live::schedule::SCHEDULE;

/// A running estimate, which improves with time. It is an upper bound on the information at any time.
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
    /// Time until the estimate converges; none once it has.
    pub remaining: Option<Duration>,
    /// Whether the estimate has converged while better bounds that use the prior are still to come.
    pub bounding: bool,
    /// Recipe that reproduces the estimate.
    pub recipe: ReplayRecipe,
    /// The model of a similar design that the fit started from; none where it started from the pretrained weights.
    pub start: Option<Arc<CausalStart>>,
    /// The model.
    pub model: Arc<CausalModel>,
    /// Position gradient of each lenslet; none for other masks and in the first seconds of a fit.
    pub pulls: Option<Vec<PositionGradient>>,
    /// The largest lower bound; none where the prior of the objects is not known, and in the first second of a fit.
    pub lower: Option<NamedBound>,
    /// Upper bound by annealed importance sampling; none where the prior is not known, and in the first seconds of a fit.
    pub upper: Option<NamedBound>,
    /// Bounds for whole measurements, once the estimate has converged; none where the prior is not known.
    pub sensor: Option<SensorBounds>,
    /// The design before the last edit, where the two can be compared.
    pub before: Option<Arc<Design>>,
    /// Information gain of the design over the one before the last edit, by the pretrained decoder on the same scenes.
    pub edit: Option<PairedDifference>,
    /// Bits that each place of a patch adds to the pixels before it, mean over held-out patches.
    pub mean_map: Array2<f32>,
    /// The same map for some single patches, shape (n, rows, cols).
    pub maps: Array3<f32>,
    /// The patches of these maps, photons, shape (n, rows, cols).
    pub patches: Array3<f32>,
}

/// Recipe of a live estimate. From the same start it reproduces the numbers, bit for bit on one machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct ReplayRecipe {
    /// Steps that the fit was planned for, which its learning rates depend on.
    pub planned: usize,
    /// The later plan; none where the first plan was kept.
    #[serde(default)]
    pub revised: Option<Revision>,
    /// Steps after which the fit was scored.
    pub steps: usize,
    /// Number of held-out patches of the score.
    pub test_patches: usize,
    /// Source of the lower bound.
    pub lower: Option<BoundSource>,
    /// Source of the upper bound by annealed importance sampling.
    pub upper: Option<BoundSource>,
    /// Sources of the lower and the upper bound for whole measurements.
    #[serde(default)]
    pub sensor: Option<[BoundSource; 2]>,
    /// Samples of the comparison with the mask before the last edit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edit: Option<usize>,
}

/// A new number of steps for a running fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Revision {
    /// Steps taken before the change.
    pub after: usize,
    /// Steps in all after the change.
    pub planned: usize,
}

impl Revision {
    /// The revision after `after` steps at a pace in seconds, with `rest` left. The few steps of a trial measure the pace badly, because
    /// a window may be opening at the same time.
    pub(crate) fn of(after: usize, pace: f64, rest: Duration) -> Self {
        Self { after, planned: (after + planned(rest, pace)).min(SCHEDULE.planned_steps.1 as usize) }
    }
}

impl ReplayRecipe {
    /// The recipe before the first step of a fit of `planned` steps.
    pub(crate) fn of(planned: usize) -> Self {
        Self { planned, revised: None, steps: 0, test_patches: 0, lower: None, upper: None, sensor: None, edit: None }
    }

    /// Number of steps in all.
    pub(crate) fn all(&self) -> usize {
        self.revised.map_or(self.planned, |revision| revision.planned)
    }

    /// Whether a fit can have this recipe. Fits by other recipes would never end, or never start.
    pub(crate) fn is_valid(&self) -> bool {
        let sound = |draws: Option<BoundSource>| draws.is_none_or(BoundSource::is_valid);
        (1..=self.all()).contains(&self.steps)
            && (1..=SCHEDULE.score_patches_converged).contains(&self.test_patches)
            && (self.planned.max(self.all()) as f64) <= SCHEDULE.planned_steps.1
            && self.revised.is_none_or(|revision| (1..self.planned).contains(&revision.after))
            && sound(self.lower)
            && sound(self.upper)
            && self.sensor.iter().flatten().all(|draws| draws.is_valid())
            && self.edit.is_none_or(|samples| (1..=SCHEDULE.edit_samples_converged).contains(&samples))
    }
}

/// Steps that fit into a time, at a pace in seconds. They are planned ahead, so that the fit does not depend on the clock.
pub(crate) fn planned(time: Duration, pace: f64) -> usize {
    (time.as_secs_f64() / pace.max(1e-9)).clamp(SCHEDULE.planned_steps.0, SCHEDULE.planned_steps.1) as usize
}
