//! What the window reports of finished jobs and activities.

use crate::studio::app::state::State;
use crate::studio::state::messages::Severity;
use crate::workbench::{Activity, ActivityKind, ActivityState, Outcome};

/// Loads the outcome of a job and reports it.
pub(super) fn report_outcome(state: &mut State, outcome: &Result<Outcome, String>) {
    let notices = outcome.as_ref().map_or(&[][..], Outcome::notices);
    for notice in notices {
        state.messages.push(Severity::Notice, notice);
    }
    match outcome {
        Ok(Outcome::Opened { path, .. }) => {
            state.panels.selection.clear();
            state.preferences.remember(path);
        }
        Ok(Outcome::Saved { path, .. }) => state.preferences.remember(path),
        Ok(Outcome::PsfImported { .. } | Outcome::DiffuserMade { .. } | Outcome::LensletsFitted { .. }) => {
            state.panels.selection.clear();
        }
        Ok(Outcome::Exported { .. }) => state.dialogs.onboarding.exported = true,
        Ok(Outcome::SnapshotMeasured { number, measurement, .. }) => {
            state.panels.compare.snapshots.set_measurement(*number, measurement.clone());
            if let Err(sentence) = measurement {
                state.messages.push(Severity::Failure, sentence);
            }
        }
        Ok(
            Outcome::ObjectsOpened { .. }
            | Outcome::RecordKept { .. }
            | Outcome::NetworkOpened { .. }
            | Outcome::NetworkExported { .. },
        )
        | Err(_) => {}
    }
    if matches!(outcome, Ok(outcome) if outcome.is_asked_for()) {
        // A later success makes the failure message obsolete.
        state.messages.dismiss();
    }
    match outcome {
        Ok(Outcome::Saved { network: Some(Err(sentence)), .. }) | Err(sentence) => {
            state.messages.push(Severity::Failure, sentence);
        }
        Ok(outcome) => state.messages.push(Severity::Done, outcome.sentence()),
    }
}

/// Reports the end of an estimate, a run or a training.
pub(super) fn report_end(state: &mut State, activity: &Activity) {
    match &activity.state {
        ActivityState::Done(text) => state.messages.push(Severity::Done, format!("{}: {text}", activity.name)),
        // The window of the capture shows it.
        ActivityState::Failed(sentence) if activity.kind == ActivityKind::Capture && state.dialogs.capture.is_open => {
            state.messages.log_failure(sentence);
        }
        ActivityState::Failed(sentence) => state.messages.push(Severity::Failure, sentence),
        _ => {}
    }
}
