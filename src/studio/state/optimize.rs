//! State of the Optimize panel: the form of a run and the shown result.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::design::{IdealSettings, Objective, Preset};
use crate::forward::Design;
use crate::objects::ObjectSource;
use crate::optics::LensletArray;
use crate::studio::state::request::RunRequest;
use crate::workbench::{DesignRun, Start};

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
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Design, Self::Heuristic, Self::Random, Self::RandomStarts];

    /// Its name for display.
    pub fn name(self) -> &'static str {
        match self {
            Self::Design => "This design",
            Self::Heuristic => "Heuristic layout",
            Self::Random => "Random lenslets",
            Self::RandomStarts => "8 random starts",
        }
    }
}

/// State of the Optimize panel: the form of a new run, and the shown checkpoint.
pub struct OptimizeState {
    /// The mask that the run starts from.
    pub from: StartMask,
    /// Lenslets of a heuristic start.
    pub heuristic: usize,
    /// Lenslets of random starts.
    pub count: usize,
    /// Seed of the first random start and of the run, where it differs from that of the design.
    pub seed: Option<u64>,
    /// Settings of the run.
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

impl Default for OptimizeState {
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

impl OptimizeState {
    /// Whether the run of the form can be started.
    pub fn can_start(&self, open_design: &Design, run: Option<&DesignRun>) -> bool {
        let has_lenslets = open_design.encoder.lenslets().is_some_and(|array| !array.lenslets.is_empty());
        !run.is_some_and(DesignRun::is_active) && (has_lenslets || self.from != StartMask::Design)
    }

    /// Starts and settings of the run of the form. `locked` lenslets of the design stay as they are.
    pub fn start(&mut self, design: &Arc<Design>, locked: &BTreeSet<usize>) -> (Vec<Start>, IdealSettings) {
        self.show_newest();
        self.turn_to(self.settings.preset, &design.objects);
        let is_random = matches!(self.from, StartMask::Random | StartMask::RandomStarts);
        let seed = self.seed.filter(|_| is_random).unwrap_or(design.seed);
        let mut settings = IdealSettings { seed, ..self.settings.clone() };
        let random = |seed: u64| Start::random(design, self.count, seed);
        let starts = match self.from {
            StartMask::Design => {
                settings.locked = locked.iter().copied().collect();
                vec![Start { name: design.encoder.describe(), design: Arc::clone(design) }]
            }
            StartMask::Heuristic => vec![Start::heuristic(design, self.heuristic)],
            StartMask::Random => vec![random(seed)],
            StartMask::RandomStarts => (0..STARTS).map(|number| random(seed.wrapping_add(number))).collect(),
        };
        (starts, settings)
    }

    /// Shows the newest checkpoint of the last run.
    pub fn show_newest(&mut self) {
        (self.checkpoint, self.chosen) = (None, None);
    }

    /// Shows a checkpoint and returns the request for its preview.
    pub fn show_checkpoint(&mut self, index: usize, array: &LensletArray, run: &DesignRun) -> RunRequest {
        self.checkpoint = Some(index);
        RunRequest::Preview { array: array.clone(), start: Arc::clone(&run.start), follow: false }
    }

    /// Shows a result and the run that led to it. Returns the request for its preview.
    pub fn show_result(&mut self, run: &DesignRun, place: usize) -> Option<RunRequest> {
        let design = &run.ranked.get(place)?.design;
        let array = design.encoder.lenslets()?.clone();
        self.checkpoint = None;
        self.chosen = run.run_of_result(place).map(Arc::new);
        Some(RunRequest::Preview { array, start: Arc::clone(design), follow: false })
    }

    /// Shows the result of a finished run; of several starts it is the best. This is the scored mask, without dark lenslets.
    pub fn show_end(&mut self, run: &DesignRun) -> Option<RunRequest> {
        let place = if run.start_number.1 == 1 { place_of_own_result(run)? } else { 0 };
        self.show_result(run, place)
    }

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

/// Index of the result of a run among all results.
fn place_of_own_result(run: &DesignRun) -> Option<usize> {
    let record = run.record.as_ref()?;
    run.ranked.iter().position(|result| result.record.as_ref().is_some_and(|other| Arc::ptr_eq(other, record)))
}

/// Whether a preset offers an objective for these objects.
pub fn offered(objective: Objective, preset: Preset, objects: &ObjectSource) -> bool {
    objective.suits(preset) && (objective != Objective::Posterior || objects.is_beads())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Diffuser, Encoder};

    #[test]
    fn random_starts_have_consecutive_seeds() {
        let design = Arc::new(Design { seed: 40, ..Design::default() });
        let mut state = OptimizeState { from: StartMask::RandomStarts, count: 3, ..OptimizeState::default() };
        let (starts, settings) = state.start(&design, &BTreeSet::new());
        let expected: Vec<Start> = (40..48).map(|seed| Start::random(&design, 3, seed)).collect();
        let designs = |starts: &[Start]| starts.iter().map(|start| Arc::clone(&start.design)).collect::<Vec<_>>();
        assert_eq!((settings.seed, designs(&starts)), (40, designs(&expected)));
    }

    #[test]
    fn locks_hold_for_the_lenslets_of_the_design_alone() {
        let (design, locked) = (Arc::new(Design::default()), BTreeSet::from([1, 4]));
        let mut state = OptimizeState::default();
        assert_eq!(state.start(&design, &locked).1.locked, [1, 4]);
        state.from = StartMask::Heuristic;
        assert!(state.start(&design, &locked).1.locked.is_empty());
    }

    #[test]
    fn mask_without_lenslets_needs_another_start() {
        let encoder = Encoder::Diffuser(Diffuser::with_light_kept(8, 1));
        let diffuser = Design { encoder, ..Design::default() };
        let mut state = OptimizeState::default();
        assert!(state.can_start(&Design::default(), None) && !state.can_start(&diffuser, None));
        state.from = StartMask::Random;
        assert!(state.can_start(&diffuser, None));
    }
}
