//! Settings of an optimizer run, and their presets.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::error::IdealError;
use crate::objects::ObjectSource;
use crate::optics::LensletArray;

/// Named set of settings.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let settings = IdealSettings::new(Preset::Paper, Objective::PixelCnn, 1);
/// assert_eq!(settings.patch, Some((16, 16)));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Warm refits of the objective model every few steps: on whole measurements for a decoder, on patches of 32 x 32 px for a
    /// density model.
    #[default]
    Default,
    /// Steps, batches, rates and refits of Kabuli et al. 2026, patches of 16 x 16 px.
    Paper,
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Default => "default",
            Self::Paper => "paper",
        })
    }
}

impl FromStr for Preset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "default" => Ok(Self::Default),
            "paper" => Ok(Self::Paper),
            _ => Err(format!("preset {text:?}: expected default or paper")),
        }
    }
}

/// Objective of a run: the information of the measurements under one kind of model.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// // For objects of unknown prior the objective is a density model.
/// assert_eq!(Objective::default(), Objective::Density);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Upper bound by a causal density model of the measurements, for any objects. Where scenes are sparse, a mask can exploit
    /// the errors of the model.
    #[default]
    Density,
    /// Upper bound by a `PixelCNN`, as published, for the paper preset. It takes hours where the causal model takes minutes.
    #[serde(rename = "pixelcnn")]
    PixelCnn,
    /// Lower bound by a decoder, which estimates the clean measurement given the noisy one; for beads, whose prior is known.
    Posterior,
}

impl Objective {
    /// All objectives.
    pub const ALL: [Self; 3] = [Self::Posterior, Self::Density, Self::PixelCnn];

    /// Default objective: the lower bound where the prior of the objects is known, a density model otherwise, a `PixelCNN` for the
    /// paper preset.
    pub fn usual(preset: Preset, objects: &ObjectSource) -> Self {
        match preset {
            Preset::Paper => Self::PixelCnn,
            Preset::Default if objects.is_beads() => Self::Posterior,
            Preset::Default => Self::Density,
        }
    }

    /// Whether a preset has this objective.
    pub fn suits(self, preset: Preset) -> bool {
        match self {
            Self::Density => true,
            Self::Posterior => preset == Preset::Default,
            Self::PixelCnn => preset == Preset::Paper,
        }
    }

    /// Description of the values of this objective.
    pub fn kind_of_value(self) -> &'static str {
        match self {
            Self::Density => "upper bound by the run's density model on held-out objects",
            Self::PixelCnn => "upper bound by the run's PixelCNN on held-out objects",
            Self::Posterior => "lower bound by the run's decoder on fresh scenes",
        }
    }

    /// "most" where the values are upper bounds, "least" where they are lower bounds.
    pub fn side(self) -> &'static str {
        match self {
            Self::Density | Self::PixelCnn => "most",
            Self::Posterior => "least",
        }
    }
}

impl fmt::Display for Objective {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Density => "density",
            Self::PixelCnn => "pixelcnn",
            Self::Posterior => "posterior",
        })
    }
}

impl FromStr for Objective {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|objective| objective.to_string() == text);
        named.ok_or_else(|| format!("objective {text:?}: expected posterior, density or pixelcnn"))
    }
}

/// Learning rates of the parameters of a lenslet: the size of one step, about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Rates {
    /// Rate of centres, px.
    pub position: f64,
    /// Rate of variances and covariances, square px.
    pub variance: f64,
    /// Rate of weights, which sum to 1.
    pub weight: f64,
    /// Rate of a weight as a share of it; the larger of both weight rates counts.
    #[serde(default)]
    pub relative_weight: f64,
}

impl Rates {
    /// Published rates for beads and Fashion-MNIST. Grid units of the published code are 31/32 px.
    pub const PAPER: Self =
        Self { position: 3e-2 * GRID_UNIT, variance: 1e-3 * GRID_UNIT * GRID_UNIT, weight: 1e-4, relative_weight: 0.0 };
    /// Published rates for MNIST.
    pub const PAPER_MNIST: Self = Self { position: 5e-3 * GRID_UNIT, ..Self::PAPER };
    /// Published rates for CIFAR-10.
    pub const PAPER_CIFAR: Self = Self { weight: 3e-4, ..Self::PAPER };
}

/// Parameters that the optimizer may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Free {
    /// Centres.
    pub positions: bool,
    /// Widths and shapes.
    pub widths: bool,
    /// Weights.
    pub weights: bool,
}

impl Default for Free {
    fn default() -> Self {
        Self { positions: true, widths: true, weights: true }
    }
}

/// Settings of a run. They decide every step of it.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let settings = IdealSettings { steps: 50, ..IdealSettings::new(Preset::Default, Objective::Density, 1) };
/// assert!(settings.check(&heuristic_layout(9)).is_ok());
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct IdealSettings {
    /// Preset that the settings come from.
    pub preset: Preset,
    /// Objective of the run.
    #[serde(default)]
    pub objective: Objective,
    /// Steps of the mask.
    pub steps: usize,
    /// Training objects that are measured in one step; for density models. Each substep with patches measures at least one.
    pub objects: usize,
    /// Patches of these measurements in one step. For a decoder: scenes of one patch each, fewer where patches are larger than
    /// 32 x 32 px, so that the count of pixels stays.
    pub patches: usize,
    /// Substeps of one step: small moves along the direction of the step before. The gradient of the next step is computed between
    /// them, by two patches at a time or more.
    #[serde(default = "one", alias = "moves")]
    pub substeps: usize,
    /// Shape of a patch (rows, cols), px; the whole measurement where it is none.
    pub patch: Option<(usize, usize)>,
    /// Steps of the mask in one round; the objective model is refitted once in every round.
    pub refit_every: usize,
    /// Fit steps of the first round, and of every round where fits are cold. A `PixelCNN` stops early.
    pub first_fit: usize,
    /// Fit steps of every other round. A density model takes fewer where the rates have decayed.
    pub refit: usize,
    /// Fit steps for the last mask.
    pub last_fit: usize,
    /// Whether each fit starts from the one before. A causal model then trains before every substep. A decoder trains in the course
    /// of one round for the next; the mask at the beginning of a round is evaluated in the course of it.
    pub warm: bool,
    /// Candidates of one relocation search, for a decoder; no search where it is 0.
    #[serde(default, alias = "tried")]
    pub relocation_candidates: usize,
    /// Learning rates.
    pub rates: Rates,
    /// Share of the steps, at the end, over which the rates decay.
    #[serde(alias = "settle")]
    pub decay_fraction: f64,
    /// Parameters that the optimizer may change.
    pub free: Free,
    /// Indices of the lenslets that stay as they are.
    pub locked: Vec<usize>,
    /// Least distance between the centres of two lenslets, px.
    pub min_separation_px: f64,
    /// Number of lenslets at the end; that of the start where it is none.
    #[serde(alias = "lenslets")]
    pub cardinality: Option<usize>,
    /// Whether spots may become elliptic.
    pub anisotropic: bool,
    /// Seed of objects, patches, noise and fits.
    pub seed: u64,
}

impl IdealSettings {
    /// Largest number of steps, objects or patches.
    pub const MOST: usize = 1_000_000;

    /// The settings of a preset for an objective.
    pub fn new(preset: Preset, objective: Objective, seed: u64) -> Self {
        let paper = Self {
            preset,
            objective,
            steps: 2000,
            objects: 50,
            patches: 4096,
            substeps: 1,
            patch: Some((16, 16)),
            refit_every: 20,
            first_fit: 2000,
            refit: 2000,
            last_fit: 2000,
            warm: false,
            relocation_candidates: 0,
            rates: Rates::PAPER,
            decay_fraction: 0.0,
            free: Free::default(),
            locked: Vec::new(),
            min_separation_px: 0.0,
            cardinality: None,
            anisotropic: false,
            seed,
        };
        match (preset, objective) {
            (Preset::Paper, Objective::PixelCnn) => {
                Self { first_fit: 20_000, refit: 20_000, last_fit: 20_000, ..paper }
            }
            (Preset::Paper, _) => paper,
            (Preset::Default, Objective::Posterior) => Self {
                steps: 1600,
                patches: 32,
                // The mask then moves ten times a second on two cores.
                substeps: 8,
                // Patches of 32 x 32 px count information twice that neighbours share, so that their optimum is another one.
                patch: None,
                refit_every: 20,
                first_fit: 100,
                refit: 50,
                last_fit: 400,
                warm: true,
                relocation_candidates: 96,
                rates: Rates { position: 0.03, variance: 1e-2, weight: 1.2e-4, relative_weight: 3e-3 },
                decay_fraction: 0.4,
                ..paper
            },
            (Preset::Default, Objective::Density | Objective::PixelCnn) => Self {
                // Some 600 steps at full rate take the light from the second best lenslet to the best.
                steps: 800,
                objects: 12,
                patches: 24,
                // The mask then moves ten times a second on two cores that draw the window as well.
                substeps: 24,
                patch: Some((32, 32)),
                refit_every: 5,
                first_fit: 1500,
                // With a quarter of these steps the model lags behind, and the mask exploits its errors.
                refit: 150,
                last_fit: 1500,
                warm: true,
                // Where one lenslet is best it outgrows the others within some hundred steps.
                rates: Rates { position: 0.015, variance: 5e-3, weight: 1.2e-4, relative_weight: 5e-3 },
                decay_fraction: 0.25,
                ..paper
            },
        }
    }

    /// Checks the settings of a run from `start`.
    ///
    /// # Errors
    /// [`IdealError::Setting`] for the first setting that is out of range.
    pub fn check(&self, start: &LensletArray) -> Result<(), IdealError> {
        let wrong = |name, found: String, expected| Err(IdealError::Setting { name, found, expected });
        if !self.objective.suits(self.preset) {
            let expected = match self.preset {
                Preset::Default => "posterior or density; pixelcnn is for the paper preset",
                Preset::Paper => "pixelcnn or density; posterior is for the default preset",
            };
            return wrong("objective", self.objective.to_string(), expected);
        }
        for (name, count) in [
            ("steps", self.steps),
            ("objects", self.objects),
            ("patches", self.patches),
            ("substeps", self.substeps),
            ("refit_every", self.refit_every),
            ("first_fit", self.first_fit),
            ("refit", self.refit),
            ("last_fit", self.last_fit),
        ] {
            if !(1..=Self::MOST).contains(&count) {
                return wrong(name, count.to_string(), "1 to a million");
            }
        }
        if self.relocation_candidates > Self::MOST {
            return wrong("relocation_candidates", self.relocation_candidates.to_string(), "0 to a million");
        }
        let Rates { position, variance, weight, relative_weight } = self.rates;
        for (name, rate) in [
            ("rates.position", position),
            ("rates.variance", variance),
            ("rates.weight", weight),
            ("rates.relative_weight", relative_weight),
        ] {
            if !(0.0..=10.0).contains(&rate) {
                return wrong(name, rate.to_string(), "0 to 10");
            }
        }
        if !(0.0..=1.0).contains(&self.decay_fraction) {
            return wrong("decay_fraction", self.decay_fraction.to_string(), "0 to 1");
        }
        let apart = start.rows.min(start.cols) as f64 / 2.0;
        if !(self.min_separation_px >= 0.0 && self.min_separation_px <= apart) {
            return wrong("min_separation_px", self.min_separation_px.to_string(), "0 to half the PSF grid");
        }
        let count = start.lenslets.len();
        if let Some(index) = self.locked.iter().find(|&&index| index >= count) {
            return wrong("locked", (index + 1).to_string(), "numbers of lenslets of the mask");
        }
        let locked = self.locked.iter().collect::<BTreeSet<_>>().len();
        if self.cardinality.is_some_and(|kept| kept == 0 || kept < locked) {
            let found = self.cardinality.unwrap_or_default().to_string();
            return wrong("cardinality", found, "at least 1, and at least the number of locked lenslets");
        }
        let Free { positions, widths, weights } = self.free;
        if !(positions || widths || weights) || locked == count {
            return wrong("free", "nothing".into(), "something that may change");
        }
        if !positions && !widths && locked + 1 == count {
            return wrong(
                "free",
                "the weight of one lenslet".into(),
                "at least two weights that may change, since their sum is fixed",
            );
        }
        Ok(())
    }

    /// The settings of another preset or objective. The constraints of the mask and the seed stay; so do steps and patch where they
    /// differ from the preset before.
    #[must_use]
    pub fn with_preset(self, preset: Preset, objective: Objective) -> Self {
        let (before, after) = (Self::new(self.preset, self.objective, 0), Self::new(preset, objective, 0));
        let steps = if self.steps == before.steps { after.steps } else { self.steps };
        let patch = if self.patch == before.patch { after.patch } else { self.patch };
        let Self { free, locked, min_separation_px, cardinality, anisotropic, seed, .. } = self;
        Self { steps, patch, free, locked, min_separation_px, cardinality, anisotropic, seed, ..after }
    }

    /// Indices of the lenslets among `count` that are neither locked nor pruned.
    pub(super) fn free_lenslets(&self, count: usize, pruned: &[usize]) -> Vec<usize> {
        (0..count).filter(|index| !self.locked.contains(index) && !pruned.contains(index)).collect()
    }

    /// Factor of the rates at a step: 1, with a cosine decay at the end.
    pub(super) fn rate(&self, step: usize) -> f64 {
        let left = 1.0 - step as f64 / self.steps.max(1) as f64;
        if left >= self.decay_fraction {
            return 1.0;
        }
        let share = (left / self.decay_fraction).clamp(0.0, 1.0);
        LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 - (std::f64::consts::PI * share).cos())
    }

    /// Fit steps of the round that begins at a step. A density model takes fewer where the mask moves more slowly.
    pub(super) fn refit_from(&self, step: usize) -> usize {
        let share = match self.objective {
            Objective::Density | Objective::PixelCnn => self.rate(step).max(LEAST_REFIT),
            Objective::Posterior => 1.0,
        };
        (share * self.refit as f64).round() as usize
    }
}

/// Substeps of runs whose records do not hold them.
fn one() -> usize {
    1
}

/// One unit of the published grid, px: 32 samples span -16 to 16.
const GRID_UNIT: f64 = 31.0 / 32.0;
/// Factor of the rates at the last step.
const LAST_RATE: f64 = 0.05;
/// Least share of the fit steps where the rates have decayed.
const LEAST_REFIT: f64 = 0.5;

#[cfg(test)]
mod tests;
