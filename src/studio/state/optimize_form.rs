//! The form of the Optimize panel.

use std::sync::Arc;

use crate::design::{IdealSettings, Objective, Preset};
use crate::objects::ObjectSource;
use crate::workbench::DesignRun;

/// Random starts of one order.
pub const STARTS: u64 = 8;

/// What a run starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartMask {
    Design,
    Heuristic,
    Random,
    RandomStarts,
}

impl StartMask {
    pub const ALL: [Self; 4] = [Self::Design, Self::Heuristic, Self::Random, Self::RandomStarts];

    pub fn name(self) -> &'static str {
        match self {
            Self::Design => "This design",
            Self::Heuristic => "Heuristic layout",
            Self::Random => "Random lenslets",
            Self::RandomStarts => "8 random starts",
        }
    }
}

/// What the form asks for.
pub struct OptimizeForm {
    pub from: StartMask,
    /// Lenslets of a heuristic start.
    pub heuristic: usize,
    /// Lenslets of random starts.
    pub count: usize,
    /// Seed of the first of them and of the run, where it is not that of the design.
    pub seed: Option<u64>,
    pub settings: IdealSettings,
    /// What the mask climbs, where a person chose.
    pub objective: Option<Objective>,
    /// The frame that is looked at; the newest one where none was chosen.
    pub frame: Option<usize>,
    /// The run that led to the result which was chosen; where none was, the last run is looked at.
    pub chosen: Option<Arc<DesignRun>>,
    /// Whether the mask shows the ways of the lenslets.
    pub trajectories: bool,
}

impl Default for OptimizeForm {
    fn default() -> Self {
        let settings = IdealSettings::new(Preset::Default, Objective::Posterior, 1);
        Self {
            from: StartMask::Design,
            heuristic: 9,
            count: 25,
            seed: None,
            settings,
            objective: None,
            frame: None,
            chosen: None,
            trajectories: true,
        }
    }
}

impl OptimizeForm {
    /// Steps that a run is to take which came to its end.
    pub fn further_steps(&self, run: &DesignRun) -> usize {
        // Steps for another objective say nothing of this run.
        let of_run = Some(&run.settings).filter(|settings| settings.objective != self.settings.objective);
        of_run.unwrap_or(&self.settings).steps
    }

    /// Settings that suit the objects.
    pub fn turn_to(&mut self, preset: Preset, objects: &ObjectSource) {
        // What was chosen for beads says nothing of other objects.
        let chosen = self.objective.filter(|&objective| offered(objective, preset, objects));
        let objective = chosen.unwrap_or_else(|| Objective::usual(preset, objects));
        if (self.settings.preset, self.settings.objective) != (preset, objective) {
            self.settings = self.settings.clone().turned_to(preset, objective);
        }
    }
}

/// Whether a run with this preset can climb this before these objects.
pub fn offered(objective: Objective, preset: Preset, objects: &ObjectSource) -> bool {
    objective.suits(preset) && (objective != Objective::Posterior || objects.is_beads())
}
