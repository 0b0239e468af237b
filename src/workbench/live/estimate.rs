//! The live estimate as it is published, and the recipe by which it is computed again.

use std::sync::Arc;
use std::time::Duration;

use ndarray::{Array2, Array3};
use serde::{Deserialize, Serialize};

use crate::forward::Design;
use crate::information::{CausalModel, CausalStart, NamedBound, PairedDifference};
use crate::workbench::live::bounds::{BoundSource, SensorBounds};
use crate::workbench::live::position_gradients::PositionGradient;
use crate::workbench::live::schedule::SCHEDULE;

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
    pub(crate) fn of((after, pace): (usize, f64), rest: Duration) -> Self {
        Self { after, planned: (after + planned(rest, pace)).min(SCHEDULE.planned_steps.1 as usize) }
    }
}

impl ReplayRecipe {
    /// Before the first step of a fit of so many.
    pub(crate) fn of(planned: usize) -> Self {
        Self { planned, revised: None, steps: 0, test_patches: 0, lower: None, upper: None, sensor: None, edit: None }
    }

    /// Steps in all.
    pub(crate) fn all(&self) -> usize {
        self.revised.map_or(self.planned, |revision| revision.planned)
    }

    /// Whether a fit could have come about like this; others would never end, or not begin.
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

/// Steps for which a time suffices, at a pace in seconds. They are planned ahead, so that the fit does not depend on the clock.
pub(crate) fn planned(time: Duration, pace: f64) -> usize {
    (time.as_secs_f64() / pace.max(1e-9)).clamp(SCHEDULE.planned_steps.0, SCHEDULE.planned_steps.1) as usize
}
