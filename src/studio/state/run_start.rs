//! Starting the run of the form in the Optimize panel.

use std::sync::Arc;

use crate::design::IdealSettings;
use crate::studio::state::app_state::State;
use crate::studio::state::messages::Severity;
use crate::studio::state::optimize_form::{STARTS, StartMask};
use crate::workbench::{DesignRun, Start};

impl State {
    /// Whether the run of the form can be started.
    pub fn can_start_run(&self) -> bool {
        let has_lenslets =
            self.session.open_design().encoder.lenslets().is_some_and(|array| !array.lenslets.is_empty());
        let is_free = !self.run.as_ref().is_some_and(DesignRun::is_active);
        is_free && (has_lenslets || self.optimize_form.from != StartMask::Design)
    }

    /// Starts the run of the form.
    pub fn start_run(&mut self) {
        let design = Arc::clone(self.session.open_design());
        let form = &mut self.optimize_form;
        (form.checkpoint, form.chosen) = (None, None);
        form.turn_to(form.settings.preset, &design.objects);
        let is_random = matches!(form.from, StartMask::Random | StartMask::RandomStarts);
        let seed = form.seed.filter(|_| is_random).unwrap_or(design.seed);
        let mut settings = IdealSettings { seed, ..form.settings.clone() };
        let random = |seed: u64| Start::random(&design, form.count, seed);
        let starts = match form.from {
            StartMask::Design => {
                settings.locked = self.locks.indices().iter().copied().collect();
                vec![Start { name: design.encoder.describe(), design: Arc::clone(&design) }]
            }
            StartMask::Heuristic => vec![Start::heuristic(&design, form.heuristic)],
            StartMask::Random => vec![random(seed)],
            StartMask::RandomStarts => (0..STARTS).map(|number| random(seed.wrapping_add(number))).collect(),
        };
        if let Err(refusal) = self.session.start_run(starts, settings) {
            self.messages.push(Severity::Failure, refusal);
        }
    }
}
