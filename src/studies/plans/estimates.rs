//! Settings that the estimates of all cells of a plan share.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::information::{Estimator, Protocol};
use crate::studies::error::StudyError;

/// Settings that the estimates of all cells share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct EstimateSettings {
    /// Time for the fits of one cell, seconds; without it, the usual time of the estimator.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Steps of each fit in place of a time. Equal steps give equal numbers on one machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    /// Training patches of estimators that do not draw fresh ones.
    pub patches_train: usize,
    /// Held-out test patches.
    pub patches_test: usize,
    /// Trials; the smallest estimate counts.
    pub trials: usize,
    /// Exact entropies, or the published procedure.
    pub protocol: Protocol,
    /// Whether fits start from random weights in place of pretrained ones.
    pub fresh: bool,
    /// Steps of each optimizer run of an `ideal:` mask; without it, as many as `optimize` takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ideal_steps: Option<usize>,
}

impl Default for EstimateSettings {
    fn default() -> Self {
        Self {
            seconds: None,
            steps: None,
            patches_train: 10_000,
            patches_test: 1_500,
            trials: 1,
            protocol: Protocol::Default,
            fresh: false,
            ideal_steps: None,
        }
    }
}

/// Refuses the first number that is out of its range.
pub(super) fn check_ranges(
    numbers: impl IntoIterator<Item = (&'static str, usize, RangeInclusive<usize>)>,
) -> Result<(), StudyError> {
    match numbers.into_iter().find(|(_, found, range)| !range.contains(found)) {
        Some((what, found, range)) => Err(StudyError::Plan {
            what: what.into(),
            expected: format!("{} to {}", range.start(), range.end()),
            found: found.to_string(),
        }),
        None => Ok(()),
    }
}

impl EstimateSettings {
    /// The settings of one cell: the time is that of its estimator, or none for one that is not fitted for a time.
    pub(super) fn of(self, estimator: Estimator) -> Self {
        let usual = estimator.default_budget().map(|budget| budget.as_secs_f64());
        let seconds = if self.steps.is_some() { None } else { usual.map(|usual| self.seconds.unwrap_or(usual)) };
        let steps = self.steps.filter(|_| usual.is_some());
        let fresh = self.fresh && estimator.has_pretrained_weights();
        Self { seconds, steps, fresh, ..self }
    }

    pub(super) fn check(&self) -> Result<(), StudyError> {
        let refused = |what: &str, expected: &str, found: String| {
            Err(StudyError::Plan { what: what.into(), expected: expected.into(), found })
        };
        if let (Some(seconds), Some(steps)) = (self.seconds, self.steps) {
            return refused("estimates", "seconds or steps", format!("{seconds} s and {steps} steps"));
        }
        if let Some(seconds) = self.seconds.filter(|seconds| !(0.001..=604_800.0).contains(seconds)) {
            return refused("seconds", "0.001 s to one week", format!("{seconds} s"));
        }
        check_ranges([
            ("steps", self.steps.unwrap_or(1), 1..=10_000_000),
            ("patches_train", self.patches_train, 2..=1_000_000),
            ("patches_test", self.patches_test, 2..=1_000_000),
            ("trials", self.trials, 1..=1_000),
            ("ideal_steps", self.ideal_steps.unwrap_or(1), 1..=1_000_000),
        ])
    }
}
