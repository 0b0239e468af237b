//! State of an optimizer run, its checkpoints and its events.

use std::fmt;
use std::ops::RangeInclusive;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::settings::{IdealSettings, Objective};
use crate::information::PretrainedLowerBound;
use crate::optics::LensletArray;

/// The mask at the beginning of a round, and its information on held-out objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Checkpoint {
    /// Steps of the mask so far.
    pub step: usize,
    /// The mask; lenslets keep their places in the list.
    pub array: LensletArray,
    /// Information by the objective model, bits per pixel. A density model gives an upper bound on patches of held-out objects, a
    /// decoder a lower bound on fresh scenes.
    pub bits_per_pixel: f64,
    /// 95 % interval over these patches or scenes, bits per pixel.
    pub interval_95: [f64; 2],
    /// Lower bound beside an upper one: at every fifth checkpoint and the last, where the prior of the objects is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<PretrainedLowerBound>,
    /// Information by a density model that was fitted from a cold start, bits per pixel, where there is one. These numbers
    /// can be compared between checkpoints; those of warm fits cannot, since a longer fit gives a tighter bound.
    #[serde(default, alias = "afresh", skip_serializing_if = "Option::is_none")]
    pub cold_fit_bits: Option<f64>,
    /// Mean Tamura coefficient of held-out measurements.
    pub tamura: f64,
    /// Number of lenslets that are neither dark nor coincident.
    pub distinct_lenslets: usize,
    /// Participation ratio of the weights of these lenslets.
    pub effective_lenslets: f64,
    /// Seconds of computing since the start of the run.
    pub seconds: f64,
}

impl Checkpoint {
    /// The 95 % interval of its lower bound, where it has one.
    fn lower(&self, objective: Objective) -> Option<[f64; 2]> {
        match objective {
            Objective::Posterior => Some(self.interval_95),
            Objective::Density | Objective::PixelCnn => self.lower.map(|lower| lower.interval_95),
        }
    }
}

/// One sentence on the gain of a run, by the intervals of the lower bounds of its first and its last mask; none where there are
/// fewer than two lower bounds.
pub fn gain_summary(checkpoints: &[Checkpoint], objective: Objective) -> Option<&'static str> {
    let mut known = checkpoints.iter().filter_map(|checkpoint| checkpoint.lower(objective));
    let (first, last) = (known.next()?, known.next_back()?);
    Some(if last[0] > first[1] {
        "The lower bound of the run has risen above that of its start"
    } else {
        "The lower bound of the run does not confirm a gain over its start"
    })
}

/// Event of a run besides gradient steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum IdealEvent {
    /// A gradient was not finite: Adam ignored it, the mask went back to where the step began, and the step scale was halved.
    Refused {
        /// Steps of the mask so far.
        step: usize,
    },
    /// A finished run was extended by more steps; rates that had decayed are at their full height again.
    Extended {
        /// Steps of the mask so far.
        step: usize,
    },
    /// A lenslet was relocated, because the decoder gains information with it there. A faint lenslet gets the mean weight of
    /// the others.
    #[serde(alias = "relit")]
    Relocated {
        /// Steps of the mask so far.
        step: usize,
        /// Index of the lenslet in the list.
        lenslet: usize,
    },
    /// The run reverted to an earlier mask, because that one has more information, by lower bounds or by cold fits.
    #[serde(alias = "returned")]
    Reverted {
        /// Steps of the mask so far.
        step: usize,
        /// Steps of the mask that the run reverted to.
        to: usize,
    },
    /// A cold fit replaced a stale density model; the step scale was halved.
    Refitted {
        /// Steps of the mask so far.
        step: usize,
    },
    /// An event that this version does not write, such as a branch to an earlier mask by earlier versions.
    #[serde(other)]
    Unsupported,
}

impl IdealEvent {
    /// The steps after which the run had masks that this event discards, from the first to the last.
    pub fn discarded_steps(&self) -> Option<RangeInclusive<usize>> {
        match *self {
            Self::Reverted { step, to } => Some(to + 1..=step),
            _ => None,
        }
    }

    /// One line for each kind of event that occurred, with its count.
    pub fn event_summary(events: &[Self]) -> Vec<String> {
        let line = |what: &str, is: fn(&Self) -> bool| {
            let count = events.iter().filter(|event| is(event)).count();
            (count > 0).then(|| format!("{what}: {count}"))
        };
        [
            line("Relocated lenslets", |event| matches!(event, Self::Relocated { .. })),
            line("Reverts to an earlier mask with more information", |event| matches!(event, Self::Reverted { .. })),
            line("Steps refused for a gradient that is not finite", |event| matches!(event, Self::Refused { .. })),
            line("Stale models replaced by a cold fit", |event| matches!(event, Self::Refitted { .. })),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// State of a run. Start, settings and state decide how the run continues.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdealState {
    /// Steps of the mask so far.
    pub step: usize,
    /// The current mask.
    pub array: LensletArray,
    /// The masks at the beginnings of all rounds so far.
    #[serde(alias = "frames")]
    pub checkpoints: Vec<Checkpoint>,
    /// All events so far.
    pub events: Vec<IdealEvent>,
    /// Whether the last fit is done.
    pub finished: bool,
    /// Steps that the run is planned for; 0 in states of early versions.
    #[serde(default)]
    pub(super) planned: usize,
    /// Steps that are left in a round whose model stays as it is.
    #[serde(default, alias = "due")]
    pub(super) steps_left_in_round: usize,
    #[serde(alias = "momentum")]
    pub(super) adam: Adam,
    /// Indices of the lenslets that were removed; they stay dark.
    pub(super) pruned: Vec<usize>,
    /// Whether the objective model was fitted to the mask as it is, in the course of the round before.
    #[serde(default, alias = "followed")]
    pub(super) model_up_to_date: bool,
    /// Factor of the rates, at most 1.
    #[serde(alias = "caution")]
    pub(super) step_scale: f64,
    pub(super) seconds: f64,
}

impl IdealState {
    /// The state before the first step of a run of `planned` steps.
    pub(super) fn new(array: LensletArray, planned: usize) -> Self {
        Self {
            step: 0,
            array,
            checkpoints: Vec::new(),
            events: Vec::new(),
            finished: false,
            planned,
            steps_left_in_round: 0,
            adam: Adam::default(),
            pruned: Vec::new(),
            model_up_to_date: false,
            step_scale: 1.0,
            seconds: 0.0,
        }
    }

    /// Smoothed gradient of the information by the centre (x, y) of each lenslet, bits per pixel and pixel; empty before the first
    /// step, zero for dark lenslets.
    pub fn position_gradients(&self) -> Vec<(f64, f64)> {
        let lit = self.array.lenslets.iter().map(|lenslet| lenslet.weight > 0.0);
        let gradients = self.adam.position_gradients().zip(lit);
        gradients.map(|(gradient, is_lit)| if is_lit { gradient } else { (0.0, 0.0) }).collect()
    }

    /// Seconds of computing up to this state.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }
}

/// Phase of a run between two steps of the mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The objective model is fitted.
    Fitting,
    /// The information of the mask is measured.
    Measuring,
    /// Relocation candidates are compared.
    Searching,
}

impl fmt::Display for Phase {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Fitting => "fitting the model",
            Self::Measuring => "measuring the information",
            Self::Searching => "relocation search",
        })
    }
}

/// Progress of a run.
#[derive(Clone, Copy, Debug)]
pub struct IdealProgress<'a> {
    /// The run so far.
    pub state: &'a IdealState,
    /// The phase between two steps and the share of it that is done, 0 to 1; none while the mask moves.
    pub phase: Option<(Phase, f64)>,
    /// Seconds of computing since the start of the run.
    pub seconds: f64,
}

/// Time that is left of a run, extrapolated from its steps so far; none in the first two rounds.
pub fn time_left(state: &IdealState, settings: &IdealSettings, seconds: f64) -> Option<Duration> {
    let first = state.checkpoints.first()?;
    let (done, all) = (state.step, settings.steps);
    if done < 2 * settings.refit_every.min(all) || state.finished {
        return None;
    }
    let per_step = (seconds - first.seconds).max(0.0) / done as f64;
    Duration::try_from_secs_f64(per_step * (all - done.min(all)) as f64).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_is_confirmed_by_lower_bounds_alone() {
        let array = LensletArray::new(32, 32, Vec::new());
        let checkpoint = |bits_per_pixel: f64, lower: Option<f64>| {
            let around = |bits: f64| [bits - 0.01, bits + 0.01];
            let lower = lower.map(|bits| PretrainedLowerBound {
                bits_per_pixel: bits,
                interval_95: around(bits),
                samples: 256,
            });
            Checkpoint {
                step: 0,
                array: array.clone(),
                bits_per_pixel,
                interval_95: around(bits_per_pixel),
                lower,
                cold_fit_bits: None,
                tamura: 1.0,
                distinct_lenslets: 0,
                effective_lenslets: 0.0,
                seconds: 0.0,
            }
        };
        let is_unconfirmed = |checkpoints: &[Checkpoint], objective| {
            gain_summary(checkpoints, objective).map(|sentence| sentence.contains("not"))
        };
        let checkpoints = [checkpoint(0.3, Some(0.2)), checkpoint(0.5, None), checkpoint(0.4, Some(0.215))];
        assert_eq!(is_unconfirmed(&checkpoints, Objective::Posterior), Some(false));
        assert_eq!(is_unconfirmed(&checkpoints, Objective::Density), Some(true), "an upper bound proves nothing");
        let upper_only = [checkpoint(0.3, None), checkpoint(0.5, None)];
        assert_eq!(is_unconfirmed(&upper_only, Objective::Density), None);
        assert_eq!(is_unconfirmed(&checkpoints[..1], Objective::Posterior), None);
    }

    #[test]
    fn events_of_earlier_versions_are_read() {
        let read = |text: &str| serde_json::from_str::<IdealEvent>(text).unwrap();
        assert_eq!(
            read(r#"{"kind": "relit", "step": 3, "lenslet": 1}"#),
            IdealEvent::Relocated { step: 3, lenslet: 1 }
        );
        assert_eq!(read(r#"{"kind": "returned", "step": 3, "to": 1}"#), IdealEvent::Reverted { step: 3, to: 1 });
        for branch in [r#"{"kind": "rewound", "step": 6, "to": 5}"#, r#"{"kind": "replanned", "step": 5, "before": 9}"#]
        {
            assert_eq!(read(branch), IdealEvent::Unsupported);
        }
        let written = serde_json::to_string(&IdealEvent::Unsupported).unwrap();
        assert_eq!(read(&written), IdealEvent::Unsupported);
    }
}
