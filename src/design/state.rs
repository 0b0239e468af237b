//! Where a run of IDEAL has come to.

use std::fmt;
use std::ops::RangeInclusive;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::movement::Momentum;
use super::settings::{IdealSettings, Objective};
use crate::information::PretrainedLowerBound;
use crate::optics::LensletArray;

/// The mask at the beginning of a round, and what it was worth on held-out objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Steps of the mask so far.
    pub step: usize,
    /// The mask; lenslets keep their places in the list.
    pub array: LensletArray,
    /// Bits per pixel by what was climbed: an upper bound by the density model on patches of held-out objects, or a lower
    /// bound by the decoder on fresh scenes.
    pub bits_per_pixel: f64,
    /// Over these patches or scenes.
    pub interval_95: [f64; 2],
    /// Bound from below beside the upper one, in every fifth frame and the last, where the prior of the objects is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<PretrainedLowerBound>,
    /// Bits per pixel by a density model that had begun anew for this mask, where one was asked: of all frames these can be
    /// compared, since models that were fitted longer bound more tightly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub afresh: Option<f64>,
    /// Mean Tamura coefficient of held-out measurements.
    pub tamura: f64,
    /// Lenslets that are neither dark nor coincident.
    pub distinct_lenslets: usize,
    /// The participation ratio of their weights.
    pub effective_lenslets: f64,
    /// Seconds of computing since the start of the run.
    pub seconds: f64,
}

impl Frame {
    /// The 95 % interval of its bound from below, where it has one.
    fn lower(&self, objective: Objective) -> Option<[f64; 2]> {
        match objective {
            Objective::Posterior => Some(self.interval_95),
            Objective::Density | Objective::PixelCnn => self.lower.map(|lower| lower.interval_95),
        }
    }
}

/// What a run says of its gain, by the intervals of its bounds from below at its first and its last mask; nothing where these are
/// not two.
pub fn gain_in_words(frames: &[Frame], objective: Objective) -> Option<&'static str> {
    let mut known = frames.iter().filter_map(|frame| frame.lower(objective));
    let (first, last) = (known.next()?, known.next_back()?);
    Some(if last[0] > first[1] {
        "The lower bound of the run has risen above that of its start"
    } else {
        "The lower bound of the run does not confirm a gain over its start"
    })
}

/// Something that a run had to do besides climbing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum IdealEvent {
    /// A gradient without finite numbers: nothing was learned from it, the mask went back to where its step began, and the
    /// rates were halved.
    Refused {
        /// Steps of the mask so far.
        step: usize,
    },
    /// It had come to its end and was told to go on: rates that had fallen are at their full height again.
    Extended {
        /// Steps of the mask so far.
        step: usize,
    },
    /// It was told on its way to take another number of steps, so that rates fall at another time.
    Replanned {
        /// Steps of the mask so far.
        step: usize,
        /// Steps that it was to take before.
        before: usize,
    },
    /// A lenslet was put at another place, where it tells more: with its own light or, where that was little, with the mean of the others.
    #[serde(alias = "relit")]
    Relocated {
        /// Steps of the mask so far.
        step: usize,
        /// Its place in the list, from 0.
        lenslet: usize,
    },
    /// The mask told less than an earlier one, by bounds from below or by density models that began anew, and the run took that up again.
    Returned {
        /// Steps of the mask so far.
        step: usize,
        /// Steps of the mask that was taken up.
        to: usize,
    },
    /// It was told to go on from an earlier mask. Those after that stay among its frames, but it does not return to them.
    Rewound {
        /// Steps of the mask so far.
        step: usize,
        /// Steps of the mask that was taken up.
        to: usize,
    },
    /// The density model had lost track of the mask: one that began anew knew more and took its place; the rates were halved.
    Refitted {
        /// Steps of the mask so far.
        step: usize,
    },
}

impl IdealEvent {
    /// The steps after which the run had masks that it came back from by this, from the first to the last.
    pub fn given_up(&self) -> Option<RangeInclusive<usize>> {
        match *self {
            Self::Returned { step, to } | Self::Rewound { step, to } => Some(to + 1..=step),
            _ => None,
        }
    }

    /// What a run had to do besides climbing, for people: a line for each kind of event that came, and how often.
    pub fn detours(events: &[Self]) -> Vec<String> {
        let told = |what: &str, is: fn(&Self) -> bool| {
            let count = events.iter().filter(|event| is(event)).count();
            (count > 0).then(|| format!("{what}: {count}"))
        };
        [
            told("Lenslets that tell more where they were put", |event| matches!(event, Self::Relocated { .. })),
            told("Returns to an earlier mask that told more", |event| matches!(event, Self::Returned { .. })),
            told("Returns to a mask that was chosen", |event| matches!(event, Self::Rewound { .. })),
            told("Steps without finite numbers, which were refused", |event| matches!(event, Self::Refused { .. })),
            told("Models that had lost track of the mask and made room for one that began anew", |event| {
                matches!(event, Self::Refitted { .. })
            }),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// Where a run has come to: with the start and the settings it is all that decides how it goes on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdealState {
    /// Steps of the mask so far.
    pub step: usize,
    /// The mask now.
    pub array: LensletArray,
    /// The masks at the beginnings of all rounds so far.
    pub frames: Vec<Frame>,
    /// What else happened.
    pub events: Vec<IdealEvent>,
    /// Whether the last fit is done.
    pub finished: bool,
    /// Steps that it is to take.
    #[serde(default)]
    pub(super) planned: usize,
    /// Steps that are left of a round whose model stays as it is.
    #[serde(default)]
    pub(super) due: usize,
    pub(super) momentum: Momentum,
    /// Lenslets that were taken out; they stay dark.
    pub(super) pruned: Vec<usize>,
    /// Whether the guide was fitted while the mask came to where it is.
    #[serde(default)]
    pub(super) followed: bool,
    /// Factor of the rates.
    pub(super) caution: f64,
    pub(super) seconds: f64,
}

impl IdealState {
    /// A run that begins with a mask and is to take so many steps.
    pub(super) fn new(array: LensletArray, planned: usize) -> Self {
        Self {
            step: 0,
            array,
            frames: Vec::new(),
            events: Vec::new(),
            finished: false,
            planned,
            due: 0,
            momentum: Momentum::default(),
            pruned: Vec::new(),
            followed: false,
            caution: 1.0,
            seconds: 0.0,
        }
    }

    /// Where the information pulls the centre of each lenslet (x, y), by the mean gradient of late, bits per pixel and pixel; empty
    /// before the first step.
    pub fn pulls(&self) -> Vec<(f64, f64)> {
        let lit = self.array.lenslets.iter().map(|lenslet| lenslet.weight > 0.0);
        // One that is dark has no place of its own.
        self.momentum.pulls().zip(lit).map(|(pull, is_lit)| if is_lit { pull } else { (0.0, 0.0) }).collect()
    }

    /// Seconds of computing up to this state.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }
}

/// What a run does between steps of the mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doing {
    /// It fits its model.
    Fitting,
    /// It measures the mask by its model.
    Measuring,
    /// It tries lenslets at other places.
    Searching,
}

impl fmt::Display for Doing {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Fitting => "fitting",
            Self::Measuring => "measuring the mask",
            Self::Searching => "trying lenslets at other places",
        })
    }
}

/// What a run is doing.
#[derive(Clone, Copy, Debug)]
pub struct IdealProgress<'a> {
    /// The run so far.
    pub state: &'a IdealState,
    /// What it does besides moving the mask, and the share of that that is done.
    pub doing: Option<(Doing, f64)>,
    /// Seconds of computing since the start of the run.
    pub seconds: f64,
}

/// Time that is left of a run, from how long its steps have taken so far.
pub fn time_left(state: &IdealState, settings: &IdealSettings, seconds: f64) -> Option<Duration> {
    let first = state.frames.first()?;
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
    fn a_gain_is_confirmed_by_bounds_from_below_alone() {
        let array = LensletArray { rows: 32, cols: 32, lenslets: Vec::new() };
        let frame = |bits_per_pixel: f64, lower: Option<f64>| {
            let around = |bits: f64| [bits - 0.01, bits + 0.01];
            let lower = lower.map(|bits| PretrainedLowerBound {
                bits_per_pixel: bits,
                interval_95: around(bits),
                samples: 256,
            });
            Frame {
                step: 0,
                array: array.clone(),
                bits_per_pixel,
                interval_95: around(bits_per_pixel),
                lower,
                afresh: None,
                tamura: 1.0,
                distinct_lenslets: 0,
                effective_lenslets: 0.0,
                seconds: 0.0,
            }
        };
        let told = |frames: &[Frame], objective| gain_in_words(frames, objective).map(|told| told.contains("not"));
        let frames = [frame(0.3, Some(0.2)), frame(0.5, None), frame(0.4, Some(0.215))];
        assert_eq!(told(&frames, Objective::Posterior), Some(false));
        assert_eq!(told(&frames, Objective::Density), Some(true), "the upper bound is no proof");
        assert_eq!(told(&[frame(0.3, None), frame(0.5, None)], Objective::Density), None);
        assert_eq!(told(&frames[..1], Objective::Posterior), None);
    }
}
