//! Runs the actions of menus, shortcuts and palette, and serves the requests of panels and dialogs.

use crate::studio::app::state::State;
use crate::studio::state::action::Action;
use crate::studio::state::copied_numbers::numbers_json;
use crate::studio::state::dialogs::{ActionPalette, SettingsDialog};
use crate::studio::state::messages::Severity;
use crate::studio::state::pane::Pane;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{
    CameraRequest, EstimatesRequest, Request, RunRequest, Setting, StudyRequest, TrainingRequest,
};
use crate::studio::state::transition::Transition;
use crate::studio::state::window_layout::LayoutRequest;
use crate::workbench::{Recovered, Session};

/// Serves the requests of a panel or a dialog, in order.
pub fn serve_all(requests: Vec<Request>, ctx: &egui::Context, state: &mut State) {
    for request in requests {
        serve(request, ctx, state);
    }
}

fn serve(request: Request, ctx: &egui::Context, state: &mut State) {
    match request {
        Request::Do(action) => {
            run(action, ctx, state);
            // Panels that are drawn already show the effect in the next frame.
            ctx.request_repaint();
        }
        Request::Change(command) => state.send(&command),
        Request::ChangeBy(edit, command) => state.send_edit(edit, &command),
        Request::ChangeInOneStep(command) => {
            state.session.begin_step();
            state.send(&command);
        }
        Request::ToggleLocks(lenslets) => state.locks.toggle(&lenslets),
        Request::OpenSnapshot(number) => state.open_snapshot(number),
        Request::Transition(what) => state.request_transition(ctx, what),
        Request::Confirmed(what) => state.perform_transition(ctx, what),
        Request::Recover(design) => recover(*design, state),
        Request::OpenObjects(source) => state.session.open_objects(source),
        Request::OpenPsf(path) => state.dialogs.psf_import.ask(path),
        Request::ResizeDiffuser(grid_px) => state.session.resize_diffuser(grid_px),
        Request::ImportPsf(path) => state.session.import_psf(path, None),
        Request::Run(request) => serve_run(request, state),
        Request::Training(request) => serve_training(request, state),
        Request::Study(request) => serve_study(request, ctx, state),
        Request::Camera(request) => serve_camera(request, state),
        Request::Estimates(request) => serve_estimates(request, state),
        Request::Inspect => state.inspect(),
        Request::Reconstruct => {
            if let Some(wait) = state.reconstruct() {
                ctx.request_repaint_after(wait);
            }
        }
        Request::ReconstructCapture(order) => state.session.reconstruct_capture(order),
        Request::StopCapture => state.session.stop_capture(),
        Request::Submit(job) => state.session.submit(job),
        Request::StopJob(activity) => state.session.stop(&activity),
        Request::StopReading => state.session.cancel(),
        Request::ToggleJobs => state.dialogs.jobs_open = !state.dialogs.jobs_open,
        Request::AskPath(purpose) => state.dialogs.path.ask(purpose, state.session.path()),
        Request::UsePath(question) => state.use_path(*question),
        Request::Copy { text, what } => state.copy(ctx, text, what),
        Request::CopyCommand(command) => state.copy_command(ctx, command),
        Request::Describe(text) => state.hover = Some(text),
        Request::Notify(severity, text) => state.messages.push(severity, text),
        Request::Capture(pane) => state.layout.capture(pane),
        Request::Set(setting) => set(setting, state),
    }
}

/// Serves a request about the run.
pub fn serve_run(request: RunRequest, state: &mut State) {
    match request {
        RunRequest::Pause(pause) => state.session.pause_run(pause),
        RunRequest::Extend(steps) => {
            let extended = state.session.extend_run(steps);
            if extended.is_ok() {
                state.panels.optimize.show_newest();
            }
            state.report(extended);
        }
        RunRequest::Follow(follow) => state.session.follow_run(follow),
        RunRequest::Preview { array, start, follow } => {
            state.session.follow_run(follow);
            state.go(|session| session.preview(&array, &start));
        }
        RunRequest::Compare => {
            let compared = state.session.compare_result();
            state.report(compared);
        }
    }
}

fn serve_training(request: TrainingRequest, state: &mut State) {
    match request {
        TrainingRequest::Start(scope, budget) => {
            let started = state.session.train(scope, budget);
            state.report(started);
        }
        TrainingRequest::Pause(pause) => state.session.pause_training(pause),
        TrainingRequest::Stop => state.session.stop_training(),
    }
}

fn serve_study(request: StudyRequest, ctx: &egui::Context, state: &mut State) {
    match request {
        StudyRequest::Open(path) => {
            let opened = state.session.open_study(None, path);
            state.report(opened);
        }
        StudyRequest::Start => state.session.start_study(),
        StudyRequest::Pause(pause) => state.session.pause_study(pause),
        StudyRequest::Stop => state.session.stop_study(),
        StudyRequest::OpenCell(index) => match state.session.design_of_cell(index) {
            Ok(design) => state.request_transition(ctx, Transition::Sample(Box::new(design))),
            Err(sentence) => state.messages.push(Severity::Failure, sentence),
        },
        StudyRequest::Refused(sentence) => state.messages.push(Severity::Failure, sentence),
    }
}

fn serve_camera(request: CameraRequest, state: &mut State) {
    let session = &state.session;
    match request {
        CameraRequest::Calibrate(order) => session.calibrate(order),
        CameraRequest::StopCalibration => session.stop_calibration(),
        CameraRequest::Preview(captures) => session.preview_captures(captures),
        CameraRequest::Compare(order) => session.compare_systems(*order),
        CameraRequest::StopComparison => session.stop_comparison(),
    }
}

fn serve_estimates(request: EstimatesRequest, state: &mut State) {
    let session = &state.session;
    let started = match request {
        EstimatesRequest::Start(request) => session.order_estimate(request),
        EstimatesRequest::Cancel => return session.cancel_estimate(),
        EstimatesRequest::Delete(finished) => return session.delete_estimate(&finished),
        EstimatesRequest::Restore => return session.bring_back_estimate(),
    };
    state.report(started);
}

fn set(setting: Setting, state: &mut State) {
    let preferences = &mut state.preferences;
    match setting {
        Setting::Live(live) => state.session.set_live(live),
        Setting::LinkViews(linked) => preferences.link_views = linked,
        Setting::Threads(count) => {
            preferences.threads = count;
            state.session.set_threads(count);
        }
        Setting::Engine(engine) => preferences.engine = engine,
        Setting::Renderer(renderer) => preferences.renderer = renderer,
        Setting::UnsavedFolder(folder) => state.move_unsaved(folder),
        Setting::Welcomed => preferences.welcomed = true,
        Setting::ClearRecent => preferences.recent.clear(),
    }
}

fn recover(design: Recovered, state: &mut State) {
    state.session.recover(design);
    state.panels.selection.clear();
    // A recovered design replaces the welcome dialog.
    state.dialogs.onboarding.welcome = false;
    state.preferences.welcomed = true;
    state.messages.push(Severity::Done, "Design recovered; save it to keep it");
}

/// Runs an action.
pub fn run(action: Action, ctx: &egui::Context, state: &mut State) {
    let mut ask = |purpose| state.dialogs.path.ask(purpose, state.session.path());
    match action {
        Action::New => state.request_transition(ctx, Transition::New),
        Action::Open => state.request_transition(ctx, Transition::Open),
        Action::Save => match state.session.path() {
            Some(path) => state.session.save_to(path.to_owned()),
            None => ask(PathPurpose::SaveAs),
        },
        Action::SaveAs => ask(PathPurpose::SaveAs),
        Action::OpenObjects => ask(PathPurpose::OpenObjects),
        Action::OpenCapture => state.dialogs.capture.is_open = true,
        Action::ImportPsf => state.dialogs.psf_import.ask(String::new()),
        Action::FitLenslets => state.session.fit_lenslets(),
        Action::ExportDesign => ask(PathPurpose::ExportDesign),
        Action::ExportMeasurements => ask(PathPurpose::ExportMeasurements),
        Action::Undo => state.go(Session::undo),
        Action::Redo => state.go(Session::redo),
        Action::SelectAll => state.panels.selection.set(0..state.lenslet_count()),
        Action::Delete => state.delete_selection(),
        Action::AddLenslet => state.add_lenslet(),
        Action::StartRun => {
            state.request_transition(ctx, Transition::Run);
            state.layout.ask(LayoutRequest::Show(Pane::Optimize));
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
            state.layout.ask(LayoutRequest::Show(Pane::Compare));
        }
        Action::Preset(preset) => state.put_preset(preset),
        Action::Show(pane) => state.layout.ask(LayoutRequest::Show(pane)),
        Action::ResetLayout => state.layout.ask(LayoutRequest::Reset),
        Action::RememberLayout(number) => state.layout.ask(LayoutRequest::Remember(number)),
        Action::RecallLayout(number) => state.layout.ask(LayoutRequest::Recall(number)),
        Action::Maximise => state.layout.toggle_maximised(ctx.pointer_latest_pos()),
        Action::Palette => state.dialogs.palette = Some(ActionPalette::default()),
        Action::Shortcuts => state.dialogs.settings = Some(SettingsDialog::Shortcuts),
        Action::Settings => state.dialogs.settings = Some(SettingsDialog::Settings),
        Action::Welcome => state.dialogs.onboarding.welcome = true,
        Action::Tour => {
            state.dialogs.onboarding.tour = Some(0);
            state.layout.ask(LayoutRequest::Show(Pane::Mask));
        }
        Action::About => state.dialogs.settings = Some(SettingsDialog::About),
        Action::CopyNumbers => {
            let numbers = numbers_json(&state.parts().view);
            match numbers {
                Some(numbers) => state.copy(ctx, numbers, "Numbers"),
                None => state.messages.push(Severity::Failure, "The numbers of this design are not computed yet"),
            }
        }
        Action::CopyCommand => {
            let command = state.command_of_numbers();
            state.copy_command(ctx, command);
        }
        Action::ExportLive => {
            let record = state.parts().view.live_record();
            if let Some(record) = record {
                state.dialogs.path.ask(PathPurpose::ExportLive(Box::new(record)), state.session.path());
            }
        }
        Action::Jobs => state.dialogs.jobs_open = true,
        Action::Messages => state.messages.log_open = true,
        Action::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
    }
}
