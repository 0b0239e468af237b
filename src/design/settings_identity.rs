//! The identity of the settings of a run, for the key of its states.

use serde_json::{Value, json};

use super::settings::{Free, IdealSettings, Objective, Preset, Rates};

impl IdealSettings {
    /// Canonical JSON of all settings that decide the steps of a run, under names that never change. The number of steps is left
    /// out.
    pub(super) fn identity(&self) -> Value {
        let Rates { position, variance, weight, relative_weight } = self.rates;
        let Free { positions, widths, weights } = self.free;
        json!({
            "preset": self.preset.to_string(),
            "objective": self.objective.to_string(),
            "objects": self.objects,
            "patches": self.patches,
            "moves": self.substeps,
            "patch": self.patch.map(|(rows, cols)| [rows, cols]),
            "refit_every": self.refit_every,
            "first_fit": self.first_fit,
            "refit": self.refit,
            "last_fit": self.last_fit,
            "warm": self.warm,
            "tried": self.relocation_candidates,
            "rates": [position, variance, weight, relative_weight],
            "settle": self.decay_fraction,
            "free": [positions, widths, weights],
            "locked": self.locked,
            "min_separation_px": self.min_separation_px,
            "lenslets": self.cardinality,
            "anisotropic": self.anisotropic,
            "seed": self.seed,
        })
    }

    /// The same identity in the notation of earlier versions, for their keys.
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
            self.substeps,
            self.patch,
            self.refit_every,
            self.first_fit,
            self.refit,
            self.last_fit,
            self.warm,
            self.relocation_candidates,
            self.decay_fraction,
            self.locked,
            self.min_separation_px,
            self.cardinality,
            self.anisotropic,
            self.seed,
        )
    }
}
