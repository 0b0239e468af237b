//! The confirmation before unsaved changes, a run or unfinished work are discarded.

use egui::Key;

use crate::plural::counted;
use crate::studio::state::action::Action;
use crate::studio::state::request::Request;
use crate::studio::state::transition::{PendingTransition, Transition};
use crate::studio::state::view::View;
use crate::studio::widgets::format::file_name;
use crate::studio::widgets::modal;

/// What closing the window or a new run would lose.
pub struct AtStake {
    /// Work that closing the window would interrupt or lose, in sentences.
    pub work: Option<String>,
    /// Whether the result of the last run was not accepted.
    pub has_unsaved_result: bool,
}

/// Shows the question of a pending transition. Returns whether the window closes.
pub fn ask(
    ctx: &egui::Context,
    open: &mut Option<PendingTransition>,
    at_stake: &AtStake,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) -> bool {
    let Some(pending) = open.as_mut().filter(|pending| !pending.saving) else { return false };
    let what = pending.what.clone();
    // A run leaves the design unchanged.
    let dirty = what != Transition::Run && view.is_dirty;
    if !dirty && !matches!(what, Transition::Close | Transition::Run) {
        // An earlier save has finished.
        requests.push(Request::Confirmed(what));
        return false;
    }
    let work = at_stake.work.as_ref().filter(|_| what == Transition::Close);
    let mut cancelled = false;
    let mut leave = false;
    modal::show(ctx, "leaving", 340.0, |ui| {
        modal::body(ui, |ui| {
            if dirty {
                ui.heading("Save your changes?");
                ui.label(format!("{} has unsaved changes.", file_name(view.path)));
            } else if let (Transition::Run, Some(run)) = (&what, view.run) {
                ui.heading("Discard the last run?");
                let end = if run.can_resume() {
                    format!("It was stopped at {} and can be resumed.", run.place())
                } else if at_stake.has_unsaved_result {
                    "Its result was not accepted.".into()
                } else if run.ranked.len() > 1 {
                    format!("It has {}.", counted(run.ranked.len(), "result"))
                } else {
                    "It has a comparison.".into()
                };
                ui.label(format!("{end} A new run replaces its masks and numbers."));
            } else {
                ui.heading("Close the window?");
            }
            if let Some(work) = work {
                ui.label(work);
            }
        });
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            if dirty && ui.button("Save").clicked() {
                requests.push(Request::Do(Action::Save));
                pending.saving = true;
            }
            let text = match what {
                _ if dirty => "Discard",
                Transition::Run => "Start new run",
                _ => "Close the window",
            };
            leave = ui.button(text).clicked();
            cancelled = ui.button("Cancel").clicked() || ui.input(|input| input.key_pressed(Key::Escape));
        });
    });
    let close = leave && what == Transition::Close;
    if cancelled {
        *open = None;
    }
    if leave {
        requests.push(Request::Confirmed(what));
    }
    close
}
