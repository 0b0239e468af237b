//! Work that closing the window would interrupt.

use crate::studio::state::app_state::State;
use crate::workbench::ActivityKind;

impl State {
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
        let sentences: Vec<&str> = run.into_iter().chain(why.as_deref()).chain(estimate).collect();
        (!sentences.is_empty()).then(|| sentences.join(" "))
    }
}
