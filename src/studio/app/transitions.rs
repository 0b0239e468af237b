//! Steps that would discard the open design or a run, and what would be lost.

use crate::forward::Design;
use crate::studio::app::state::State;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::transition::{PendingTransition, Transition};
use crate::workbench::{ActivityKind, DesignRun};

impl State {
    /// Performs a transition, after a confirmation if something would be lost.
    pub fn request_transition(&mut self, ctx: &egui::Context, what: Transition) {
        let asks = match what {
            Transition::Run => {
                self.run.as_ref().is_some_and(DesignRun::can_resume) || self.session.would_lose_run_data()
            }
            Transition::Close => self.session.is_dirty() || self.unfinished_work().is_some(),
            _ => self.session.is_dirty(),
        };
        if asks {
            self.dialogs.transition = Some(PendingTransition { what, saving: false });
        } else {
            self.perform_transition(ctx, what);
        }
    }

    /// Performs a transition without confirmation.
    pub fn perform_transition(&mut self, ctx: &egui::Context, what: Transition) {
        self.dialogs.transition = None;
        if matches!(what, Transition::New | Transition::Sample(_)) {
            self.panels.selection.clear();
        }
        match what {
            Transition::New => self.session.start_from(Design::default()),
            Transition::Sample(design) => self.session.start_from(*design),
            Transition::Open => self.dialogs.path.ask(PathPurpose::OpenDesign, self.session.path()),
            Transition::OpenFile(path) => self.session.open_file(path),
            Transition::Close => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Transition::Run => {
                let design = self.session.open_design();
                let (starts, settings) = self.panels.optimize.start(design, self.locks.indices());
                let started = self.session.start_run(starts, settings);
                self.report(started);
            }
            Transition::Accept => self.session.open_as_new(),
        }
    }

    /// Whether *Save* was chosen and the file is not yet written.
    pub fn waits_for_save(&self) -> bool {
        let has_answered = self.dialogs.transition.as_ref().is_some_and(|pending| pending.saving);
        has_answered && (self.dialogs.path.is_open() || self.session.is_saving())
    }

    /// Performs the pending transition after a save; a cancelled or failed save leaves the question open. Returns whether the
    /// window closes. Call it after job outcomes were taken, if [`State::waits_for_save`] was false before.
    pub fn transit_after_save(&mut self, ctx: &egui::Context) -> bool {
        let Some(pending) = self.dialogs.transition.as_mut().filter(|pending| pending.saving) else { return false };
        pending.saving = false;
        if self.session.is_dirty() {
            return false;
        }
        let what = pending.what.clone();
        let close = what == Transition::Close;
        self.perform_transition(ctx, what);
        close
    }

    /// Sentences about work that closing the window would interrupt or lose.
    pub fn unfinished_work(&self) -> Option<String> {
        let open = self.session.activities();
        let is_open = |kind| open.iter().any(|activity| activity.kind == kind && activity.is_open());
        let run = match (is_open(ActivityKind::Run), self.session.run_is_persisted()) {
            (true, true) => Some("A run is active. It is saved and can be resumed in the next window."),
            (true, false) => Some("A run is active. Its progress would be lost."),
            (false, false) if self.session.would_lose_run_data() => Some("Results of the run would be lost."),
            (false, _) => None,
        };
        let why = self
            .session
            .persistence_failure()
            .filter(|_| run.is_some())
            .map(|why| format!("It cannot be saved: {why}."));
        let estimates =
            open.iter().filter(|activity| activity.kind == ActivityKind::Estimate && activity.is_open()).count();
        let estimate = match (estimates, self.session.keeps_estimates()) {
            (0, _) => None,
            (1, true) => Some("An estimate is running. It is saved and resumes in the next window."),
            (_, true) => Some("Estimates are running. They are saved and resume in the next window."),
            (_, false) => Some("An estimate is running. Its progress would be lost."),
        };
        let training = is_open(ActivityKind::Training).then_some("A network is training. Stop it to keep its weights.");
        let network = self.session.has_unsaved_network();
        let network = network.then_some("A trained network is in no file. Save the design or export the weights.");
        let comparison = is_open(ActivityKind::Comparison);
        let comparison = comparison.then_some("A comparison of systems is running. Its progress would be lost.");
        let sentences = run.into_iter().chain(why.as_deref()).chain(estimate).chain(training).chain(network);
        let sentences = sentences.chain(comparison);
        let sentences: Vec<&str> = sentences.collect();
        (!sentences.is_empty()).then(|| sentences.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workbench::Session;

    #[test]
    fn unsaved_changes_wait_for_a_confirmation() {
        let ctx = egui::Context::default();
        let mut state = State::new(Session::new(Design::default(), None, || {}).unwrap());
        let sample = Design { seed: 77, ..Design::default() };
        state.request_transition(&ctx, Transition::Sample(Box::new(sample)));
        assert_eq!(state.session.design().seed, 77, "nothing would be lost");
        state.add_lenslet();
        state.request_transition(&ctx, Transition::New);
        let pending = state.dialogs.transition.as_ref().map(|pending| (&pending.what, pending.saving));
        assert_eq!((pending, state.session.design().seed), (Some((&Transition::New, false)), 77));
        state.perform_transition(&ctx, Transition::New);
        assert!(state.dialogs.transition.is_none() && **state.session.design() == Design::default());
    }

    #[test]
    fn transition_after_a_cancelled_save_keeps_asking() {
        let ctx = egui::Context::default();
        let mut state = State::new(Session::new(Design::default(), None, || {}).unwrap());
        state.add_lenslet();
        state.dialogs.transition = Some(PendingTransition { what: Transition::New, saving: true });
        assert!(!state.transit_after_save(&ctx) && state.session.is_dirty());
        assert_eq!(state.dialogs.transition.map(|pending| pending.saving), Some(false));
    }
}
