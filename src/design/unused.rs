//! Settings of a run that change nothing beside others.

use super::settings::{IdealSettings, Objective};

impl IdealSettings {
    /// Why a setting of this name would change nothing in such a run, where that is so.
    pub fn why_unused(&self, name: &str) -> Option<&'static str> {
        let is_posterior = self.objective == Objective::Posterior;
        match name {
            "objects" if is_posterior => Some("is for density models, the posterior draws scenes by patches"),
            "tried" if !is_posterior => Some("is for the posterior, a density model knows only the mask it follows"),
            "refit" if !self.warm => {
                Some("is for models that go on; those that begin anew are fitted by first_fit and last_fit")
            }
            _ => None,
        }
    }
}
