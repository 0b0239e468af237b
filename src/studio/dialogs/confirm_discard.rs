//! The confirmation before unsaved changes, a run or unfinished work are discarded.

use egui::Key;

use crate::plural::counted;
use crate::studio::state::action::Action;
use crate::studio::state::app_state::{State, Transition};
use crate::studio::widgets::format::file_name;
use crate::studio::widgets::modal;

/// Whether *Save* was chosen and the file is not yet written.
pub fn waits_for_save(state: &State) -> bool {
    let has_answered = state.pending_transition.as_ref().is_some_and(|leaving| leaving.saving);
    has_answered && (state.path_dialog.is_open() || state.session.is_saving())
}

/// Performs the pending transition after a save; a cancelled or failed save leaves the question open. Returns whether the
/// window closes. Call it after job outcomes were taken, if [`waits_for_save`] was false before.
pub fn after_save(ctx: &egui::Context, state: &mut State) -> bool {
    let Some(leaving) = state.pending_transition.as_mut().filter(|leaving| leaving.saving) else { return false };
    leaving.saving = false;
    if state.session.is_dirty() {
        return false;
    }
    let what = leaving.what.clone();
    let close = what == Transition::Close;
    state.perform_transition(ctx, what);
    close
}

/// Shows the question of a pending transition. Returns whether the window closes.
pub fn ask(ctx: &egui::Context, state: &mut State) -> bool {
    let Some(leaving) = state.pending_transition.as_ref().filter(|leaving| !leaving.saving) else { return false };
    let what = leaving.what.clone();
    // A run leaves the design unchanged.
    let dirty = what != Transition::Run && state.session.is_dirty();
    if !dirty && !matches!(what, Transition::Close | Transition::Run) {
        // An earlier save has finished.
        state.perform_transition(ctx, what);
        return false;
    }
    let work = if what == Transition::Close { state.unfinished_work() } else { None };
    let mut leave = false;
    modal::show(ctx, "leaving", 340.0, |ui| {
        modal::body(ui, |ui| {
            if dirty {
                ui.heading("Save your changes?");
                ui.label(format!("{} has unsaved changes.", file_name(state.session.path())));
            } else if let (Transition::Run, Some(run)) = (&what, &state.run) {
                ui.heading("Discard the last run?");
                let end = if run.can_resume() {
                    format!("It was stopped at {} and can be resumed.", run.place())
                } else if state.session.has_unsaved_result() {
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
                state.act(Action::Save);
                if let Some(leaving) = &mut state.pending_transition {
                    leaving.saving = true;
                }
            }
            let text = match what {
                _ if dirty => "Discard",
                Transition::Run => "Start new run",
                _ => "Close the window",
            };
            leave = ui.button(text).clicked();
            if ui.button("Cancel").clicked() || ui.input(|input| input.key_pressed(Key::Escape)) {
                state.pending_transition = None;
            }
        });
    });
    let close = leave && what == Transition::Close;
    if leave {
        state.perform_transition(ctx, what);
    }
    close
}
