//! The question before something is left behind: unsaved changes, a run, or work that goes on while the window is closed.

use egui::Key;

use crate::plural::counted;
use crate::studio::app::actions::Action;
use crate::studio::app::studio::file_name;
use crate::studio::state::app_state::{Leave, State};
use crate::studio::widgets::modal;
use crate::workbench::ActivityKind;

/// Whether the answer was to save, and that is still to come: its path is asked for, or the file is written.
pub fn waits_for_save(state: &State) -> bool {
    let has_answered = state.leaving.as_ref().is_some_and(|leaving| leaving.saving);
    has_answered && (state.dialogs.is_open() || state.bench.is_saving())
}

/// Goes on where the design is in its file by now; a save that was cancelled or has failed leaves the question open. Tells whether the
/// window is to be closed. To be called when answers of jobs have been taken, if [`waits_for_save`] was false before.
pub fn after_save(ctx: &egui::Context, state: &mut State) -> bool {
    let Some(leaving) = state.leaving.as_mut().filter(|leaving| leaving.saving) else { return false };
    leaving.saving = false;
    if state.bench.is_dirty() {
        return false;
    }
    let what = leaving.what.clone();
    let close = what == Leave::Close;
    state.leave(ctx, what);
    close
}

/// Asks, where an answer is wanted. Tells whether the window is to be closed.
pub fn ask(ctx: &egui::Context, state: &mut State) -> bool {
    let Some(leaving) = state.leaving.as_ref().filter(|leaving| !leaving.saving) else { return false };
    let what = leaving.what.clone();
    // A run leaves the design as it is.
    let dirty = what != Leave::Run && state.bench.is_dirty();
    if !dirty && !matches!(what, Leave::Close | Leave::Run) {
        // A save from before the question has come.
        state.leave(ctx, what);
        return false;
    }
    let work = if what == Leave::Close { going_on(state) } else { None };
    let mut leave = false;
    modal::show(ctx, "leaving", 340.0, |ui| {
        modal::body(ui, |ui| {
            if dirty {
                ui.heading("Save your changes?");
                ui.label(format!("{} has changes that are not in a file.", file_name(state.bench.path())));
            } else if let (Leave::Run, Some(run)) = (&what, &state.run) {
                ui.heading("Give up the last run?");
                let end = if run.can_go_on() {
                    format!("It was stopped at {} and could still go on.", run.place())
                } else if state.bench.has_untaken_result() {
                    "What it found was not accepted.".into()
                } else if run.ranked.len() > 1 {
                    format!("It has {}.", counted(run.ranked.len(), "result"))
                } else {
                    "Its result was compared with others.".into()
                };
                ui.label(format!("{end} Its masks and their numbers are lost where another run takes its place."));
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
                Action::Save.run(ctx, state);
                if let Some(leaving) = &mut state.leaving {
                    leaving.saving = true;
                }
            }
            let text = match what {
                _ if dirty => "Discard",
                Leave::Run => "Start anew",
                _ => "Close the window",
            };
            leave = ui.button(text).clicked();
            if ui.button("Cancel").clicked() || ui.input(|input| input.key_pressed(Key::Escape)) {
                state.leaving = None;
            }
        });
    });
    let close = leave && what == Leave::Close;
    if leave {
        state.leave(ctx, what);
    }
    close
}

/// What the window's end would interrupt or lose, in words.
pub fn going_on(state: &State) -> Option<String> {
    let open = state.bench.activities();
    let is_open = |kind| open.iter().any(|activity| activity.kind == kind && activity.is_open());
    let run = match (is_open(ActivityKind::Run), state.bench.keeps_run()) {
        (true, true) => Some("A run goes on. It is kept, and the next window can go on with it."),
        (true, false) => Some("A run goes on. What it has found so far would be lost."),
        (false, false) if state.bench.would_miss_run() => Some("Results of the run would be lost."),
        (false, _) => None,
    };
    let why = state.bench.keep_failure().filter(|_| run.is_some()).map(|why| format!("It cannot be kept: {why}."));
    let estimates =
        open.iter().filter(|activity| activity.kind == ActivityKind::Estimate && activity.is_open()).count();
    let estimate = match (estimates, state.bench.keeps_estimates()) {
        (0, _) => None,
        (1, true) => Some("An estimate is being computed. It is kept, and goes on in the next window."),
        (_, true) => Some("Estimates are being computed. They are kept, and go on in the next window."),
        (_, false) => Some("An estimate is being computed. What it has computed so far would be lost."),
    };
    let sentences: Vec<&str> = run.into_iter().chain(why.as_deref()).chain(estimate).collect();
    (!sentences.is_empty()).then(|| sentences.join(" "))
}
