//! Does actions.

use crate::optics::{Diffuser, Encoder, depth_layout, heuristic_layout, random_layout};
use crate::plural::counted;
use crate::studio::state::action::{Action, Preset};
use crate::studio::state::app_state::{Arrange, Leave, State};
use crate::studio::state::copied_numbers;
use crate::studio::state::open_dialogs::{Palette, Sheet};
use crate::studio::state::pane::Pane;
use crate::studio::state::path_question::Purpose;
use crate::workbench::{Command, Job, Workbench, look_command, repeat_command};

/// Does an action.
pub fn run(action: Action, ctx: &egui::Context, state: &mut State) {
    let beside = state.bench.path().map(ToOwned::to_owned);
    let mut ask = |purpose| state.dialogs.ask(purpose, beside.as_deref());
    match action {
        Action::New => state.guard(ctx, Leave::New),
        Action::Open => state.guard(ctx, Leave::Open),
        Action::Save => match &beside {
            Some(path) => state.bench.save_to(path.clone()),
            None => ask(Purpose::SaveAs),
        },
        Action::SaveAs => ask(Purpose::SaveAs),
        Action::OpenObjects => ask(Purpose::OpenObjects),
        Action::ImportPsf => ask(Purpose::ImportPsf),
        Action::FitLenslets => state.bench.fit_lenslets(),
        Action::ExportDesign => ask(Purpose::ExportDesign),
        Action::ExportMeasurements => ask(Purpose::ExportMeasurements),
        Action::Undo => state.go(Workbench::undo),
        Action::Redo => state.go(Workbench::redo),
        Action::SelectAll => state.selection = (0..state.lenslet_count()).collect(),
        Action::Delete => state.delete_selection(),
        Action::AddLenslet => state.add_lenslet(),
        Action::StartRun => {
            state.guard(ctx, Leave::Run);
            state.arrange = Some(Arrange::Show(Pane::Optimize));
        }
        Action::StopRun => state.bench.stop_run(),
        Action::Accept => {
            // What is shown is what was meant, however the run goes on.
            state.bench.follow_run(false);
            if !state.bench.accept() {
                state.guard(ctx, Leave::Accept);
            }
        }
        Action::OpenMask => {
            state.bench.follow_run(false);
            state.guard(ctx, Leave::Accept);
        }
        Action::LookAway => state.go(Workbench::look_away),
        Action::KeepDesign => {
            state.keep_snapshot();
            state.arrange = Some(Arrange::Show(Pane::Compare));
        }
        Action::Preset(preset) => put(preset, state),
        Action::Show(pane) => state.arrange = Some(Arrange::Show(pane)),
        Action::ResetLayout => state.arrange = Some(Arrange::Reset),
        Action::RememberLayout(number) => state.arrange = Some(Arrange::Remember(number)),
        Action::RecallLayout(number) => state.arrange = Some(Arrange::Recall(number)),
        Action::Maximise => maximise(ctx, state),
        Action::Palette => state.palette = Some(Palette::default()),
        Action::Shortcuts => state.sheet = Some(Sheet::Shortcuts),
        Action::Settings => state.sheet = Some(Sheet::Settings),
        Action::Welcome => state.guide.welcome = true,
        Action::Tour => {
            state.guide.tour = Some(0);
            state.arrange = Some(Arrange::Show(Pane::Mask));
        }
        Action::About => state.sheet = Some(Sheet::About),
        Action::CopyNumbers => copied_numbers::copy_numbers(ctx, state),
        Action::CopyCommand => {
            let command = match (state.live_record(), &state.folder) {
                (Some(record), Some(folder)) => {
                    let path = folder.join("records").join(record.file_name());
                    let command = repeat_command(&path);
                    state.bench.submit(Job::ExportLive { record: Box::new(record), path, for_command: true });
                    Ok(command)
                }
                _ => look_command(state.bench.design()),
            };
            state.copy_command(ctx, command);
        }
        Action::ExportLive => {
            if let Some(record) = state.live_record() {
                state.dialogs.ask(Purpose::ExportLive(Box::new(record)), beside.as_deref());
            }
        }
        Action::Jobs => state.jobs_open = true,
        Action::Messages => state.messages.log_open = true,
        Action::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
    }
}

/// Puts a preset mask in place.
fn put(preset: Preset, state: &mut State) {
    let seed = state.bench.design().seed;
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

/// Lets the room under the pointer fill the window; the mask where there is none; all rooms where one fills it.
fn maximise(ctx: &egui::Context, state: &mut State) {
    let pointer = ctx.pointer_latest_pos();
    let under = state.rooms.iter().find(|(_, rect)| pointer.is_some_and(|at| rect.contains(at)));
    let wanted = under.map_or(Pane::Mask, |(pane, _)| *pane);
    state.maximised = if state.maximised.is_none() { Some(wanted) } else { None };
}
