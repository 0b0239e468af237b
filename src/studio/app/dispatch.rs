//! Runs the actions of menus, shortcuts, palette, panels and dialogs.

use crate::optics::{Diffuser, Encoder, depth_layout, heuristic_layout, random_layout};
use crate::plural::counted;
use crate::studio::state::action::{Action, Preset};
use crate::studio::state::app_state::{LayoutRequest, State, Transition};
use crate::studio::state::copied_numbers;
use crate::studio::state::open_dialogs::{ActionPalette, SettingsDialog};
use crate::studio::state::pane::Pane;
use crate::studio::state::path_question::PathPurpose;
use crate::studio::state::request::Request;
use crate::workbench::{Command, Job, Session, bounds_command, reproduce_command};

/// Serves a request of a panel.
pub fn serve(request: Request, ctx: &egui::Context, state: &mut State) {
    match request {
        Request::Change(command) => state.send(&command),
        Request::ChangeBy(edit, command) => state.send_edit(edit, &command),
        Request::ChangeInOneStep(command) => {
            state.session.begin_step();
            state.send(&command);
        }
        Request::AskPath(purpose) => state.path_dialog.ask(purpose, state.session.path()),
        Request::Copy { text, what } => state.copy(ctx, text, what),
        Request::StopJob(activity) => state.session.stop(&activity),
    }
}

/// Runs an action.
pub fn run(action: Action, ctx: &egui::Context, state: &mut State) {
    let beside = state.session.path().map(ToOwned::to_owned);
    let mut ask = |purpose| state.path_dialog.ask(purpose, beside.as_deref());
    match action {
        Action::New => state.request_transition(ctx, Transition::New),
        Action::Open => state.request_transition(ctx, Transition::Open),
        Action::Save => match &beside {
            Some(path) => state.session.save_to(path.clone()),
            None => ask(PathPurpose::SaveAs),
        },
        Action::SaveAs => ask(PathPurpose::SaveAs),
        Action::OpenObjects => ask(PathPurpose::OpenObjects),
        Action::ImportPsf => ask(PathPurpose::ImportPsf),
        Action::FitLenslets => state.session.fit_lenslets(),
        Action::ExportDesign => ask(PathPurpose::ExportDesign),
        Action::ExportMeasurements => ask(PathPurpose::ExportMeasurements),
        Action::Undo => state.go(Session::undo),
        Action::Redo => state.go(Session::redo),
        Action::SelectAll => state.selection = (0..state.lenslet_count()).collect(),
        Action::Delete => state.delete_selection(),
        Action::AddLenslet => state.add_lenslet(),
        Action::StartRun => {
            state.request_transition(ctx, Transition::Run);
            state.layout_request = Some(LayoutRequest::Show(Pane::Optimize));
        }
        Action::StopRun => state.session.stop_run(),
        Action::Accept => {
            // Accepts the shown mask, even if the run has advanced.
            state.session.follow_run(false);
            if !state.session.accept() {
                state.request_transition(ctx, Transition::Accept);
            }
        }
        Action::OpenMask => {
            state.session.follow_run(false);
            state.request_transition(ctx, Transition::Accept);
        }
        Action::EndPreview => state.go(Session::end_preview),
        Action::KeepSnapshot => {
            state.keep_snapshot();
            state.layout_request = Some(LayoutRequest::Show(Pane::Compare));
        }
        Action::Preset(preset) => put(preset, state),
        Action::Show(pane) => state.layout_request = Some(LayoutRequest::Show(pane)),
        Action::ResetLayout => state.layout_request = Some(LayoutRequest::Reset),
        Action::RememberLayout(number) => state.layout_request = Some(LayoutRequest::Remember(number)),
        Action::RecallLayout(number) => state.layout_request = Some(LayoutRequest::Recall(number)),
        Action::Maximise => maximise(ctx, state),
        Action::Palette => state.palette = Some(ActionPalette::default()),
        Action::Shortcuts => state.settings_dialog = Some(SettingsDialog::Shortcuts),
        Action::Settings => state.settings_dialog = Some(SettingsDialog::Settings),
        Action::Welcome => state.onboarding.welcome = true,
        Action::Tour => {
            state.onboarding.tour = Some(0);
            state.layout_request = Some(LayoutRequest::Show(Pane::Mask));
        }
        Action::About => state.settings_dialog = Some(SettingsDialog::About),
        Action::CopyNumbers => copied_numbers::copy_numbers(ctx, state),
        Action::CopyCommand => {
            let command = match (state.live_record(), &state.folder) {
                (Some(record), Some(folder)) => {
                    let path = folder.join("records").join(record.file_name());
                    let command = reproduce_command(&path);
                    state.session.submit(Job::ExportLive { record: Box::new(record), path, for_command: true });
                    Ok(command)
                }
                _ => bounds_command(state.session.design()),
            };
            state.copy_command(ctx, command);
        }
        Action::ExportLive => {
            if let Some(record) = state.live_record() {
                state.path_dialog.ask(PathPurpose::ExportLive(Box::new(record)), beside.as_deref());
            }
        }
        Action::Jobs => state.jobs_open = true,
        Action::Messages => state.messages.log_open = true,
        Action::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
    }
}

/// Replaces the mask by a preset.
fn put(preset: Preset, state: &mut State) {
    let seed = state.session.design().seed;
    let (name, encoder) = match preset {
        Preset::Heuristic(count) => (counted(count, "heuristic lenslet"), Encoder::Lenslets(heuristic_layout(count))),
        Preset::Random => {
            let draw = state.next_random_start(seed);
            (format!("25 random lenslets, seed {draw}"), Encoder::Lenslets(random_layout(25, draw)))
        }
        Preset::Depth => ("5 lenslets in depth".into(), Encoder::Lenslets(depth_layout(5))),
        Preset::Diffuser(aperture_px) => {
            (format!("diffuser, aperture {aperture_px} px"), Encoder::Diffuser(Diffuser { aperture_px, seed }))
        }
    };
    state.send(&Command::ReplaceEncoder { name, encoder });
}

/// Maximizes the panel under the pointer, or else the mask; restores all panels if one is maximized.
fn maximise(ctx: &egui::Context, state: &mut State) {
    let pointer = ctx.pointer_latest_pos();
    let under = state.panel_rects.iter().find(|(_, rect)| pointer.is_some_and(|at| rect.contains(at)));
    let wanted = under.map_or(Pane::Mask, |(pane, _)| *pane);
    state.maximised = if state.maximised.is_none() { Some(wanted) } else { None };
}
