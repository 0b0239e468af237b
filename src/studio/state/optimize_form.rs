//! The form of the Optimize panel.

use std::sync::Arc;

use crate::design::{IdealSettings, Objective, Preset};
use crate::objects::ObjectSource;
use crate::workbench::DesignRun;

/// Number of random starts of one request.
pub const STARTS: u64 = 8;

/// The mask that a run starts from.
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

/// The form of a new run, and the shown checkpoint.
pub struct OptimizeForm {
    pub from: StartMask,
    /// Lenslets of a heuristic start.
    pub heuristic: usize,
    /// Lenslets of random starts.
    pub count: usize,
    /// Seed of the first random start and of the run, where it differs from that of the design.
    pub seed: Option<u64>,
    pub settings: IdealSettings,
    /// The objective, if the user chose one.
    pub objective: Option<Objective>,
    /// Index of the shown checkpoint; the newest if none was chosen.
    pub checkpoint: Option<usize>,
    /// The run of the chosen result; the last run if none was chosen.
    pub chosen: Option<Arc<DesignRun>>,
    /// Whether the mask shows the trajectories of lenslets.
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
            checkpoint: None,
            chosen: None,
            trajectories: true,
        }
    }
}

impl OptimizeForm {
    /// Steps by which a finished run is extended.
    pub fn further_steps(&self, run: &DesignRun) -> usize {
        // Steps set for another objective do not suit this run.
        let of_run = Some(&run.settings).filter(|settings| settings.objective != self.settings.objective);
        of_run.unwrap_or(&self.settings).steps
    }

    /// Switches to a preset, with an objective that suits the objects.
    pub fn turn_to(&mut self, preset: Preset, objects: &ObjectSource) {
        // An objective for beads does not suit other objects.
        let chosen = self.objective.filter(|&objective| offered(objective, preset, objects));
        let objective = chosen.unwrap_or_else(|| Objective::usual(preset, objects));
        if (self.settings.preset, self.settings.objective) != (preset, objective) {
            self.settings = self.settings.clone().with_preset(preset, objective);
        }
    }
}

/// Whether a preset offers an objective for these objects.
pub fn offered(objective: Objective, preset: Preset, objects: &ObjectSource) -> bool {
    objective.suits(preset) && (objective != Objective::Posterior || objects.is_beads())
}
