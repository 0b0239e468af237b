//! What a run of IDEAL does, by presets and in detail.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::error::IdealError;
use crate::objects::ObjectSource;
use crate::optics::LensletArray;

/// Named settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Warm refits every few steps of what the mask climbs: whole measurements up the posterior, patches of 32 x 32 px up a density
    /// model.
    #[default]
    Default,
    /// The steps, batches, rates and refits of Kabuli et al. 2026, patches of 16 x 16 px.
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

/// What a mask climbs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Information under a density model of the measurements, a bound from above: for any objects. Where scenes are sparse a
    /// mask can climb what the model does not know.
    #[default]
    Density,
    /// The same under a `PixelCNN`, as published: for the paper preset. Hours where the live model takes minutes.
    #[serde(rename = "pixelcnn")]
    PixelCnn,
    /// Information by what a decoder expects of the clean measurement given the noisy one: for beads, whose prior is known.
    /// A mask climbs what can be told.
    Posterior,
}

impl Objective {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Posterior, Self::Density, Self::PixelCnn];

    /// The one whose designs keep what they promise: that of the posterior where the prior is known. The published
    /// procedure climbs a `PixelCNN`.
    pub fn usual(preset: Preset, objects: &ObjectSource) -> Self {
        match preset {
            Preset::Paper => Self::PixelCnn,
            Preset::Default if objects.is_beads() => Self::Posterior,
            Preset::Default => Self::Density,
        }
    }

    /// Whether a preset can climb this one.
    pub fn suits(self, preset: Preset) -> bool {
        match self {
            Self::Density => true,
            Self::Posterior => preset == Preset::Default,
            Self::PixelCnn => preset == Preset::Paper,
        }
    }

    /// What this one says of a mask, for people.
    pub fn kind_of_value(self) -> &'static str {
        match self {
            Self::Density => "upper bound by the run's density model on held-out objects",
            Self::PixelCnn => "upper bound by the run's PixelCNN on held-out objects",
            Self::Posterior => "lower bound by the run's decoder on fresh scenes",
        }
    }

    /// Whether the information is at "most" or at "least" what this one says.
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

/// Learning rates of the parameters of a lenslet: about how far each moves in one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Of centres, px.
    pub position: f64,
    /// Of variances and covariances, square px.
    pub variance: f64,
    /// Of weights, which sum to 1.
    pub weight: f64,
    /// Least step of a weight as a share of it: bright lenslets gain and lose by steps that matter to them.
    #[serde(default)]
    pub relative_weight: f64,
}

impl Rates {
    /// As published, before beads and Fashion-MNIST. Grid units of the published code are 31/32 px.
    pub const PAPER: Self =
        Self { position: 3e-2 * GRID_UNIT, variance: 1e-3 * GRID_UNIT * GRID_UNIT, weight: 1e-4, relative_weight: 0.0 };
    /// As published, before MNIST.
    pub const PAPER_MNIST: Self = Self { position: 5e-3 * GRID_UNIT, ..Self::PAPER };
    /// As published, before CIFAR-10.
    pub const PAPER_CIFAR: Self = Self { weight: 3e-4, ..Self::PAPER };
}

/// Parameters that may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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

/// All that decides the steps of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdealSettings {
    /// Where the settings come from.
    pub preset: Preset,
    /// What the mask climbs.
    #[serde(default)]
    pub objective: Objective,
    /// Steps of the mask.
    pub steps: usize,
    /// Training objects that are measured in one step, one at least wherever slopes are taken; for density models.
    pub objects: usize,
    /// Patches of these measurements; for the posterior, scenes of a patch each, of patches larger than 32 x 32 px as many as
    /// have the pixels of so many of these.
    pub patches: usize,
    /// Moves of the mask in one step, along what was learned by the end of the step before, until the last. Between them the slopes
    /// of its patches are taken, two at a time or more.
    #[serde(default = "one")]
    pub moves: usize,
    /// Rows and columns of a patch in pixels; the whole measurement where it is none.
    pub patch: Option<(usize, usize)>,
    /// Steps of the mask in a round, for which what it climbs is fitted.
    pub refit_every: usize,
    /// Steps of the fit of the first round, and of every round where they are not warm; those of a `PixelCNN` end before
    /// where it gets no better.
    pub first_fit: usize,
    /// Steps of the fits of the other rounds, or in the course of one; of a density model fewer where the rates have fallen.
    pub refit: usize,
    /// Steps of the fit to the mask in the end.
    pub last_fit: usize,
    /// Whether the model of a round starts from the one before it. The live model then learns before every move of the mask; a
    /// decoder is fitted while the mask moves through the round before its own, and values the mask that a round began with
    /// between the moves of that.
    pub warm: bool,
    /// Up the posterior: masks that are tried at a time with one lenslet at another place; none where it is 0.
    #[serde(default)]
    pub tried: usize,
    /// Learning rates.
    pub rates: Rates,
    /// Share of the steps, at the end, over which the rates fall.
    pub settle: f64,
    /// What may change.
    pub free: Free,
    /// Lenslets that stay as they are, by index.
    pub locked: Vec<usize>,
    /// Least distance between the centres of two lenslets, px.
    pub min_separation_px: f64,
    /// Lenslets that are to be left in the end; as many as there are where it is none.
    pub lenslets: Option<usize>,
    /// Whether spots may become elliptic.
    pub anisotropic: bool,
    /// Seed of objects, patches, noise and fits.
    pub seed: u64,
}

impl IdealSettings {
    /// Most steps, objects and patches.
    pub const MOST: usize = 1_000_000;

    /// The settings of a preset for an objective.
    pub fn new(preset: Preset, objective: Objective, seed: u64) -> Self {
        let paper = Self {
            preset,
            objective,
            steps: 2000,
            objects: 50,
            patches: 4096,
            moves: 1,
            patch: Some((16, 16)),
            refit_every: 20,
            first_fit: 2000,
            refit: 2000,
            last_fit: 2000,
            warm: false,
            tried: 0,
            rates: Rates::PAPER,
            settle: 0.0,
            free: Free::default(),
            locked: Vec::new(),
            min_separation_px: 0.0,
            lenslets: None,
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
                // So that whoever watches sees the mask move ten times a second on two cores.
                moves: 8,
                // Patches of 32 x 32 px count what their neighbours know as well, and end where whole measurements tell a little less.
                patch: None,
                refit_every: 20,
                first_fit: 100,
                refit: 50,
                last_fit: 400,
                warm: true,
                tried: 96,
                rates: Rates { position: 0.03, variance: 1e-2, weight: 1.2e-4, relative_weight: 3e-3 },
                settle: 0.4,
                ..paper
            },
            (Preset::Default, Objective::Density | Objective::PixelCnn) => Self {
                // Light that goes over from the second best lenslet to the best takes some 600 at full rate; the others settle.
                steps: 800,
                objects: 12,
                patches: 24,
                // So that whoever watches sees the mask move ten times a second on two cores that draw the window as well.
                moves: 24,
                patch: Some((32, 32)),
                refit_every: 5,
                first_fit: 1500,
                // The mask must not outrun the model: with a quarter of these steps it climbs into designs that the model
                // merely does not know yet.
                refit: 150,
                last_fit: 1500,
                warm: true,
                // Bright lenslets outgrow the others within some hundred steps where one is best.
                rates: Rates { position: 0.015, variance: 5e-3, weight: 1.2e-4, relative_weight: 5e-3 },
                settle: 0.25,
                ..paper
            },
        }
    }

    /// What decides the way of a run, by names that stay; its length does not.
    pub(super) fn identity(&self) -> Value {
        let Rates { position, variance, weight, relative_weight } = self.rates;
        let Free { positions, widths, weights } = self.free;
        json!({
            "preset": self.preset.to_string(),
            "objective": self.objective.to_string(),
            "objects": self.objects,
            "patches": self.patches,
            "moves": self.moves,
            "patch": self.patch.map(|(rows, cols)| [rows, cols]),
            "refit_every": self.refit_every,
            "first_fit": self.first_fit,
            "refit": self.refit,
            "last_fit": self.last_fit,
            "warm": self.warm,
            "tried": self.tried,
            "rates": [position, variance, weight, relative_weight],
            "settle": self.settle,
            "free": [positions, widths, weights],
            "locked": self.locked,
            "min_separation_px": self.min_separation_px,
            "lenslets": self.lenslets,
            "anisotropic": self.anisotropic,
            "seed": self.seed,
        })
    }

    /// The text that stood for the same before that, in keys of earlier programs.
    pub(super) fn earlier_identity(&self) -> String {
        let Rates { position, variance, weight, relative_weight } = self.rates;
        let Free { positions, widths, weights } = self.free;
        let preset = match self.preset {
            Preset::Default => "Default",
            Preset::Paper => "Paper",
        };
        let objective = match self.objective {
            Objective::Density => "Density",
            Objective::PixelCnn => "PixelCnn",
            Objective::Posterior => "Posterior",
        };
        format!(
            "IdealSettings {{ preset: {preset}, objective: {objective}, steps: 0, objects: {:?}, patches: {:?}, moves: {:?}, \
             patch: {:?}, refit_every: {:?}, first_fit: {:?}, refit: {:?}, last_fit: {:?}, warm: {:?}, tried: {:?}, rates: \
             Rates {{ position: {position:?}, variance: {variance:?}, weight: {weight:?}, relative_weight: \
             {relative_weight:?} }}, settle: {:?}, free: Free {{ positions: {positions:?}, widths: {widths:?}, weights: \
             {weights:?} }}, locked: {:?}, min_separation_px: {:?}, lenslets: {:?}, anisotropic: {:?}, seed: {:?} }}",
            self.objects,
            self.patches,
            self.moves,
            self.patch,
            self.refit_every,
            self.first_fit,
            self.refit,
            self.last_fit,
            self.warm,
            self.tried,
            self.settle,
            self.locked,
            self.min_separation_px,
            self.lenslets,
            self.anisotropic,
            self.seed,
        )
    }

    /// Whether these settings can be followed from a mask.
    ///
    /// # Errors
    /// [`IdealError::Setting`] names the first one that cannot.
    pub fn check(&self, start: &LensletArray) -> Result<(), IdealError> {
        let wrong = |name, found: String, expected| Err(IdealError::Setting { name, found, expected });
        if !self.objective.suits(self.preset) {
            let expected = match self.preset {
                Preset::Default => "posterior or density; the paper preset climbs a PixelCNN",
                Preset::Paper => "pixelcnn or density; the default preset climbs the posterior",
            };
            return wrong("objective", self.objective.to_string(), expected);
        }
        for (name, count) in [
            ("steps", self.steps),
            ("objects", self.objects),
            ("patches", self.patches),
            ("moves", self.moves),
            ("refit_every", self.refit_every),
            ("first_fit", self.first_fit),
            ("refit", self.refit),
            ("last_fit", self.last_fit),
        ] {
            if !(1..=Self::MOST).contains(&count) {
                return wrong(name, count.to_string(), "1 to a million");
            }
        }
        if self.tried > Self::MOST {
            return wrong("tried", self.tried.to_string(), "0 to a million");
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
        if !(0.0..=1.0).contains(&self.settle) {
            return wrong("settle", self.settle.to_string(), "0 to 1");
        }
        let apart = start.rows.min(start.cols) as f64 / 2.0;
        if !(self.min_separation_px >= 0.0 && self.min_separation_px <= apart) {
            return wrong("min_separation_px", self.min_separation_px.to_string(), "0 to half the PSF grid");
        }
        let count = start.lenslets.len();
        if let Some(index) = self.locked.iter().find(|&&index| index >= count) {
            return wrong("locked", (index + 1).to_string(), "numbers of lenslets that the mask has");
        }
        let locked = self.locked.iter().collect::<BTreeSet<_>>().len();
        if self.lenslets.is_some_and(|kept| kept == 0 || kept < locked) {
            let found = self.lenslets.unwrap_or_default().to_string();
            return wrong("lenslets", found, "at least 1, and at least those that are locked");
        }
        let Free { positions, widths, weights } = self.free;
        if !(positions || widths || weights) || locked == count {
            return wrong("free", "nothing".into(), "something that may change");
        }
        if !positions && !widths && locked + 1 == count {
            return wrong(
                "free",
                "the weight of one lenslet".into(),
                "at least two weights that may change: their sum is held",
            );
        }
        Ok(())
    }

    /// The settings of a preset for an objective, with what a person may have set for any: what may move, the number of
    /// lenslets, and steps and patch where they are not those of the preset before.
    #[must_use]
    pub fn turned_to(self, preset: Preset, objective: Objective) -> Self {
        let (before, after) = (Self::new(self.preset, self.objective, 0), Self::new(preset, objective, 0));
        let steps = if self.steps == before.steps { after.steps } else { self.steps };
        let patch = if self.patch == before.patch { after.patch } else { self.patch };
        let Self { free, locked, min_separation_px, lenslets, anisotropic, seed, .. } = self;
        Self { steps, patch, free, locked, min_separation_px, lenslets, anisotropic, seed, ..after }
    }

    /// Places in the list of those of `count` lenslets that may change: none that is locked or was pruned.
    pub(super) fn free_lenslets(&self, count: usize, pruned: &[usize]) -> Vec<usize> {
        (0..count).filter(|index| !self.locked.contains(index) && !pruned.contains(index)).collect()
    }

    /// Factor of the rates at a step.
    pub(super) fn rate(&self, step: usize) -> f64 {
        let left = 1.0 - step as f64 / self.steps.max(1) as f64;
        if left >= self.settle {
            return 1.0;
        }
        let share = (left / self.settle).clamp(0.0, 1.0);
        LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 - (std::f64::consts::PI * share).cos())
    }

    /// Steps of the fit in the course of the round that begins at a step. A density model has less to learn of a mask that moves
    /// more slowly; a decoder learns as much of every mask.
    pub(super) fn refit_from(&self, step: usize) -> usize {
        let share = match self.objective {
            Objective::Density | Objective::PixelCnn => self.rate(step).max(LEAST_REFIT),
            Objective::Posterior => 1.0,
        };
        (share * self.refit as f64).round() as usize
    }
}

/// Moves in a step of runs whose records do not tell.
fn one() -> usize {
    1
}

/// One unit of the published grid, px: 32 samples span -16 to 16.
const GRID_UNIT: f64 = 31.0 / 32.0;
/// Factor of the rates at the last step.
const LAST_RATE: f64 = 0.05;
/// Least share of the steps of a fit that is left where the rates have fallen.
const LEAST_REFIT: f64 = 0.5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    #[test]
    fn presets_can_be_followed_and_what_cannot_is_named() {
        let start = heuristic_layout(3);
        for preset in [Preset::Default, Preset::Paper] {
            let beads = "beads:0.02".parse().unwrap();
            IdealSettings::new(preset, Objective::usual(preset, &beads), 1).check(&start).unwrap();
            assert_eq!(preset.to_string().parse(), Ok(preset));
        }
        let told = |change: &dyn Fn(&mut IdealSettings)| {
            let mut settings = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
            change(&mut settings);
            settings.check(&start).unwrap_err().to_string()
        };
        for (told, part) in [
            (told(&|settings| settings.preset = Preset::Paper), "objective is posterior"),
            (told(&|settings| settings.objective = Objective::PixelCnn), "objective is pixelcnn"),
            (told(&|settings| settings.steps = 0), "steps is 0"),
            (told(&|settings| settings.rates.position = f64::NAN), "rates.position is NaN"),
            (told(&|settings| settings.locked = vec![3]), "locked is 4"),
            (told(&|settings| settings.locked = vec![0, 1, 2]), "may change"),
            (told(&|settings| settings.locked = vec![0, 2, 1, 0]), "may change"),
            (told(&|settings| settings.min_separation_px = 40.0), "min_separation_px is 40"),
            (told(&|settings| settings.lenslets = Some(0)), "at least 1"),
            (
                told(&|settings| settings.free = Free { positions: false, widths: false, weights: false }),
                "free is nothing",
            ),
        ] {
            assert!(told.contains(part), "{part} in {told}");
        }
        let usual = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
        IdealSettings { locked: vec![1, 1, 1], lenslets: Some(1), ..usual }.check(&start).unwrap();
    }

    #[test]
    fn rates_fall_at_the_end() {
        let settings =
            IdealSettings { steps: 100, settle: 0.4, ..IdealSettings::new(Preset::Default, Objective::Density, 1) };
        assert_eq!([settings.rate(0), settings.rate(60)], [1.0, 1.0]);
        assert!(settings.rate(80) < settings.rate(70) && (settings.rate(80) - 0.525).abs() < 1e-9);
        assert!((settings.rate(100) - LAST_RATE).abs() < 1e-12);
        assert_eq!(IdealSettings::new(Preset::Paper, Objective::Density, 1).rate(1999), 1.0);
    }

    #[test]
    fn a_density_model_learns_less_of_a_mask_that_moves_more_slowly() {
        let refits = |preset, objective| {
            let settings =
                IdealSettings { steps: 100, settle: 0.4, refit: 50, ..IdealSettings::new(preset, objective, 1) };
            [0, 60, 80, 100].map(|step| settings.refit_from(step))
        };
        assert_eq!(refits(Preset::Default, Objective::Density), [50, 50, 26, 25]);
        assert_eq!(refits(Preset::Default, Objective::Posterior), [50; 4]);
    }

    #[test]
    fn objectives_have_names_and_beads_a_posterior() {
        for objective in Objective::ALL {
            assert_eq!(objective.to_string().parse(), Ok(objective));
            assert_eq!(serde_json::to_string(&objective).unwrap(), format!("\"{objective}\""));
        }
        assert!("gaussian".parse::<Objective>().is_err());
        let usual = |preset, objects: &str| Objective::usual(preset, &objects.parse().unwrap());
        assert_eq!(usual(Preset::Default, "volume:5:0.01"), Objective::Posterior);
        assert_eq!(usual(Preset::Default, "idx:digits"), Objective::Density);
        assert_eq!(usual(Preset::Paper, "beads:0.02"), Objective::PixelCnn);
        // What a person set stays.
        let set = |settings| IdealSettings { lenslets: Some(7), patch: Some((24, 24)), ..settings };
        let settings = set(IdealSettings::new(Preset::Default, Objective::Density, 4));
        let turned = settings.turned_to(Preset::Default, Objective::Posterior);
        assert_eq!(turned, set(IdealSettings::new(Preset::Default, Objective::Posterior, 4)));
        let turned = IdealSettings { steps: 77, ..turned }.turned_to(Preset::Paper, Objective::Density);
        assert_eq!((turned.steps, turned.patch, turned.patches), (77, Some((24, 24)), 4096));
        // What it did not set is that of the new preset.
        let usual = IdealSettings::new(Preset::Default, Objective::Posterior, 4);
        assert_eq!(usual.turned_to(Preset::Default, Objective::Density).patch, Some((32, 32)));
    }
}
