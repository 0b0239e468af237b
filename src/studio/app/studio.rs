//! The studio: menus, panels, status bar, and the work between frames.

use std::path::{Path, PathBuf};

use egui::{Panel, Ui, ViewportCommand};
use egui_tiles::Tree;

use crate::evaluation::EvaluationError;
use crate::formats::FormatError;
use crate::forward::Design;
use crate::plural::{counted, one_or_many};
use crate::studio::app::app_data::{AppData, SNAPSHOTS};
use crate::studio::app::layout::{self, PanelBehavior, default_layout, restored};
use crate::studio::app::menus;
use crate::studio::app::repaint_throttle::RepaintThrottle;
use crate::studio::app::{capture, dispatch};
use crate::studio::canvas::pan_zoom::CLICK_REACH;
use crate::studio::dialogs::confirm_discard;
use crate::studio::dialogs::dropped_files::{self, Dropped};
use crate::studio::dialogs::{palette, path_dialog, recovery, settings_dialogs, welcome};
use crate::studio::panels::jobs;
use crate::studio::panels::parts::{action_entry, run_results};
use crate::studio::panels::preview_banner;
use crate::studio::panels::status_bar::{self, FrameTimes};
use crate::studio::state::action::Action;
use crate::studio::state::app_state::{LayoutRequest, State, Transition};
use crate::studio::state::messages::Severity;
use crate::studio::state::pane::Pane;
use crate::studio::state::preferences::{RendererChoice, ZOOM};
use crate::studio::widgets::clipboard::Clipboard;
use crate::studio::widgets::format::file_name;
use crate::studio::widgets::missing_glyphs;
use crate::studio::widgets::number_field::take_rejections;
use crate::workbench::{Activity, ActivityState, Outcome, Recovered, RunStatus, Session, Snapshots};

/// The window's contents.
pub struct Studio {
    state: State,
    layout: Tree<Pane>,
    dropped: Dropped,
    title: String,
    /// File names that the window shows.
    named: String,
    /// Closing was confirmed.
    closing: bool,
    /// Drawing times for the status bar.
    frame_times: FrameTimes,
    pace: RepaintThrottle,
    /// Data that outlives the session.
    app_data: Option<AppData>,
    /// Unsaved designs of earlier sessions that are not yet offered.
    left_behind: Vec<Recovered>,
}

impl Studio {
    /// A studio with an open design; its worker starts at once.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn new(ctx: &egui::Context, design: Design, path: Option<PathBuf>) -> std::io::Result<Self> {
        ctx.all_styles_mut(|style| {
            style.spacing.item_spacing = egui::vec2(6.0, 4.0);
            style.interaction.tooltip_delay = 0.4;
            // The default of secondary text has too little contrast on white.
            style.visuals.weak_text_alpha = 0.75;
        });
        ctx.options_mut(|options| options.input_options.max_click_dist = CLICK_REACH);
        let (repaint, pace) = (ctx.clone(), RepaintThrottle::default());
        let paced = pace.clone();
        let session = Session::new(design, path, move || repaint.request_repaint_after(paced.wait()))?;
        let title = String::new();
        Ok(Self {
            state: State::new(session),
            layout: default_layout(),
            dropped: Dropped::default(),
            title,
            named: String::new(),
            closing: false,
            frame_times: FrameTimes::default(),
            pace,
            app_data: None,
            left_behind: Vec::new(),
        })
    }

    /// Stores the name of the renderer that draws the window.
    pub fn drawn_by(&mut self, renderer: RendererChoice) {
        self.state.renderer = Some(renderer.name());
    }

    /// Sets the clipboard of copied texts.
    pub fn copy_to(&mut self, clipboard: Clipboard) {
        self.state.clipboard = clipboard;
    }

    /// Shows a notice in the status bar and the log.
    pub fn notify(&mut self, notice: String) {
        self.state.messages.push(Severity::Notice, notice);
    }

    /// Stores preferences, layout, unsaved changes, snapshots and runs in a folder, and loads existing ones. A message
    /// reports failures.
    pub fn keep_data_in(&mut self, ctx: &egui::Context, folder: &Path) {
        let (preferences, layout) = AppData::read(folder);
        for sentence in AppData::newer_files(folder) {
            self.state.messages.push(Severity::Failure, sentence);
        }
        ctx.set_theme(preferences.theme);
        ctx.set_zoom_factor(preferences.zoom);
        self.state.session.set_live(preferences.live);
        self.state.preferences = preferences;
        self.layout = layout.clone().unwrap_or_else(default_layout);
        self.state.session.set_threads(self.state.preferences.threads);
        match AppData::in_folder(folder, &self.state.preferences, layout.as_ref()) {
            Ok(app_data) => {
                self.state.onboarding.welcome = !self.state.preferences.welcomed && self.state.session.path().is_none();
                self.app_data = Some(app_data);
                self.state.folder = Some(folder.to_owned());
            }
            Err(error) => self.keep_no_data(&error.to_string()),
        }
        self.read_kept_designs(folder);
        if self.app_data.is_none() {
            return;
        }
        // A design given on the command line is also a recent file.
        if let Some(path) = self.state.session.path().map(Path::to_path_buf) {
            self.state.preferences.remember(&path);
        }
        self.left_behind = self.state.keep_unsaved();
        if let Err(error) = self.state.session.keep_estimates_in(&folder.join("estimates")) {
            self.state.messages.push(Severity::Failure, error.to_string());
        }
        self.keep_runs(folder);
    }

    /// Stores nothing but unsaved changes, if a folder was chosen for them.
    pub fn keep_no_data(&mut self, reason: &str) {
        let text = format!("Nothing is saved when the window closes: {reason}");
        self.state.messages.push(Severity::Failure, text);
        self.left_behind = self.state.keep_unsaved();
    }

    fn read_kept_designs(&mut self, folder: &Path) {
        match Snapshots::read(&folder.join(SNAPSHOTS)) {
            Ok((snapshots, (broken, unlisted))) => {
                self.state.snapshots = snapshots;
                if broken > 0 {
                    let (designs, they) = (counted(broken, "snapshot"), one_or_many(broken, "it is", "they are"));
                    self.notify(format!("{designs} could not be read; {they} left unchanged"));
                }
                if unlisted > 0 {
                    let (designs, are) = (counted(unlisted, "older snapshot"), one_or_many(unlisted, "is", "are"));
                    self.notify(format!("{designs} {are} not listed; the files stay unchanged"));
                }
            }
            // The user knows that this folder is not writable.
            Err(_) if self.app_data.is_none() => {}
            Err(error) => self.state.messages.push(Severity::Failure, error.to_string()),
        }
    }

    fn keep_runs(&mut self, folder: &Path) {
        match self.state.session.persist_runs_in(&folder.join("run")) {
            Ok(()) => match self.state.session.run() {
                Some(run) if run.status == RunStatus::Stopped => {
                    self.notify("A run was interrupted; it can be resumed in Optimize.".into());
                }
                Some(_) if self.state.session.has_unsaved_result() => {
                    self.notify("The result of the last run was not accepted; Optimize shows it.".into());
                }
                _ => {}
            },
            Err(EvaluationError::File(FormatError::Busy { .. })) => {
                self.notify(
                    "Another window stores its runs; a run of this window is lost at its end unless it is accepted."
                        .into(),
                );
            }
            Err(error) => self.state.messages.push(Severity::Failure, error.to_string()),
        }
    }

    /// Applies layout requests and writes changed application data.
    fn store_app_data(&mut self, ctx: &egui::Context) {
        match self.state.layout_request.take() {
            Some(LayoutRequest::Show(pane)) => {
                self.layout.make_active(|_, tile| matches!(tile, egui_tiles::Tile::Pane(found) if *found == pane));
                if self.state.maximised.is_some() {
                    self.state.maximised = Some(pane);
                }
            }
            Some(LayoutRequest::Reset) => {
                self.layout = default_layout();
                self.state.maximised = None;
            }
            Some(LayoutRequest::Remember(number)) => {
                self.state.preferences.layouts.insert(number, self.layout.clone());
                self.notify(format!("Saved as layout {number}"));
            }
            Some(LayoutRequest::Recall(number)) => {
                if let Some(layout) = self.state.preferences.layouts.get(&number) {
                    self.layout = restored(layout.clone()).unwrap_or_else(default_layout);
                    self.state.maximised = None;
                }
            }
            None => {}
        }
        let state = &mut self.state;
        if let Some(failure) = state.session.note_unsaved() {
            state.messages.push(Severity::Failure, failure);
        }
        let Some(app_data) = &mut self.app_data else { return };
        app_data.keep_designs(state.snapshots.changes(self.closing));
        state.preferences.theme = ctx.options(|options| options.theme_preference);
        // Shortcuts zoom beyond the stored range.
        state.preferences.zoom = ctx.zoom_factor().clamp(*ZOOM.start(), *ZOOM.end());
        ctx.set_zoom_factor(state.preferences.zoom);
        state.preferences.live = state.session.is_live();
        // A panel comes to rest when the pointer is released.
        let moved = ctx.input(|input| input.pointer.any_released() || input.viewport().close_requested());
        if let Some(failure) = app_data.keep(&state.preferences, moved.then_some(&self.layout)) {
            state.messages.push(Severity::Failure, failure);
        }
    }

    /// Switches the live estimate on or off.
    pub fn set_live(&self, live: bool) {
        self.state.session.set_live(live);
    }

    /// The session behind the window.
    pub fn session(&self) -> &Session {
        &self.state.session
    }

    /// Whether no dialog has the keyboard focus.
    fn takes_shortcuts(&self) -> bool {
        !self.state.path_dialog.is_open()
            && self.state.pending_transition.is_none()
            && self.state.palette.is_none()
            && self.state.settings_dialog.is_none()
            && self.left_behind.is_empty()
            && !self.dropped.is_open()
            && !self.state.onboarding.welcome
    }

    /// Loads results, answers and shortcuts.
    pub fn logic(&mut self, ctx: &egui::Context) {
        let state = &mut self.state;
        let waits_for_save = confirm_discard::waits_for_save(state);
        for outcome in state.session.take_outcomes() {
            report_outcome(state, &outcome);
        }
        for activity in state.session.take_ended() {
            report_end(state, &activity);
        }
        for refusal in take_rejections(ctx) {
            state.messages.push(Severity::Notice, refusal);
        }
        let (down, pressed) = ctx.input(|input| (input.pointer.any_down(), input.pointer.primary_pressed()));
        state.session.note_pointer(down, pressed);
        run_results::take_up(state);
        state.live = state.session.live();
        state.estimates = state.session.estimates();
        // Masks of a run are no edits and would fill the history.
        let current = |revision| revision == state.session.revision() && !state.session.is_previewing();
        if let Some(information) = state.live.information.as_ref().filter(|known| current(known.revision)) {
            let objects = state.live.scene.as_ref().map_or_else(String::new, |scene| scene.value.set.fingerprint());
            state.edit_history.note(information.revision, &information.value, state.session.design(), &objects);
        }
        if let Some(live) = &state.estimates.live {
            state.edit_history.note_live(live.revision, live.value.bits_per_pixel);
        }
        state.snapshots.take_up(&state.live, &state.estimates);
        let count = state.lenslet_count();
        state.selection.retain(|&index| index < count);
        // Locks belong to the open design, even during a preview.
        state.locks.check(state.session.lenslets());
        if !waits_for_save && confirm_discard::after_save(ctx, state) {
            self.close();
        }
        if ctx.input(|input| input.viewport().close_requested()) && !self.closing {
            if self.state.session.is_dirty() || self.state.unfinished_work().is_some() {
                ctx.send_viewport_cmd(ViewportCommand::CancelClose);
                self.state.request_transition(ctx, Transition::Close);
            } else {
                self.close();
            }
        }
        if self.takes_shortcuts() {
            for action in Action::pressed(ctx) {
                // The previous action may have opened a dialog.
                if self.takes_shortcuts() {
                    dispatch::run(action, ctx, &mut self.state);
                }
            }
        }
        self.dropped.take(ctx, &mut self.state);
        self.store_app_data(ctx);
        let named = format!("{} {}", file_name(self.state.session.path()), self.state.session.design().objects);
        if named != self.named {
            if let Some(sentence) = missing_glyphs::missing_glyphs(ctx, &named) {
                self.notify(sentence);
            }
            self.named = named;
        }
        let title = title(&self.state);
        if title != self.title {
            ctx.send_viewport_cmd(ViewportCommand::Title(title.clone()));
            self.title = title;
        }
    }

    /// Performs an orderly close of the window.
    fn close(&mut self) {
        self.closing = true;
        self.state.session.close();
    }

    /// Draws the window.
    pub fn ui(&mut self, ui: &mut Ui) {
        self.state.hover = None;
        capture::advance(ui.ctx(), &mut self.state);
        Panel::top("menu").show(ui, |ui| self.menu_bar(ui));
        self.state.messages.banner(ui);
        preview_banner::show(ui, &mut self.state);
        // The status bar shows the value under the pointer, which the panels find: its space is allocated first, its text drawn
        // last.
        let status = Panel::bottom("status").exact_size(24.0).show(ui, |ui| ui.available_rect_before_wrap()).inner;
        self.state.panel_rects.clear();
        egui::CentralPanel::no_frame().show(ui, |ui| match self.state.maximised {
            Some(pane) => layout::show_maximised(ui, &mut self.state, pane),
            None => self.layout.ui(&mut PanelBehavior(&mut self.state), ui),
        });
        self.do_actions(ui.ctx());
        let mut bar = ui.new_child(egui::UiBuilder::new().id_salt("status text").max_rect(status));
        status_bar::show(&mut bar, &mut self.state, &self.frame_times);
        let ctx = ui.ctx().clone();
        self.state.messages.log_window(&ctx);
        self.state.messages.toasts(&ctx);
        let activities = self.state.session.activities();
        for request in jobs::show(&ctx, &mut self.state.jobs_open, &activities) {
            dispatch::serve(request, &ctx, &mut self.state);
        }
        path_dialog::show(&ctx, &mut self.state);
        palette::show(&ctx, &mut self.state);
        settings_dialogs::show(&ctx, &mut self.state);
        welcome::show_tour(&ctx, &mut self.state);
        recovery::ask(&ctx, &mut self.state, &mut self.left_behind);
        // One dialog at a time.
        if self.left_behind.is_empty() {
            welcome::show_welcome(&ctx, &mut self.state);
        }
        if confirm_discard::ask(&ctx, &mut self.state) {
            self.close();
        }
        self.dropped.ask(&ctx, &mut self.state);
        dropped_files::show_hint(&ctx);
        self.do_actions(&ctx);
    }

    /// Runs the actions that panels, menus and dialogs have requested.
    fn do_actions(&mut self, ctx: &egui::Context) {
        while let Some(action) = self.state.actions.pop_front() {
            dispatch::run(action, ctx, &mut self.state);
            // Panels that are drawn already show the effect in the next frame.
            ctx.request_repaint();
        }
    }

    fn menu_bar(&mut self, ui: &mut Ui) {
        egui::MenuBar::new().ui(ui, |ui| {
            ui.menu_button("File", |ui| menus::file_menu(ui, &mut self.state));
            ui.menu_button("Edit", |ui| menus::edit_menu(ui, &mut self.state));
            ui.menu_button("Presets", |ui| menus::presets_menu(ui, &mut self.state));
            ui.menu_button("View", |ui| self.view_menu(ui));
            ui.menu_button("Help", |ui| menus::help_menu(ui, &mut self.state));
            ui.separator();
            let design = self.state.session.design();
            let name = file_name(self.state.session.path());
            let dirty = if self.state.session.is_dirty() { " (unsaved changes)" } else { "" };
            let line = format!("{name}{dirty}:  {}, {}", design.encoder.describe(), design.objects);
            ui.add(egui::Label::new(egui::RichText::new(line).weak()).truncate());
        });
    }

    fn view_menu(&mut self, ui: &mut Ui) {
        ui.menu_button("Theme", |ui| {
            if settings_dialogs::theme_choice(ui) {
                ui.close();
            }
        });
        ui.menu_button("Panel", |ui| {
            for pane in Pane::ALL {
                action_entry::entry(ui, &mut self.state, Action::Show(pane));
            }
        });
        ui.menu_button("Layout", |ui| {
            for action in Action::layouts() {
                action_entry::entry(ui, &mut self.state, action);
            }
        });
        action_entry::entry(ui, &mut self.state, Action::Maximise);
        ui.menu_button("Export image of panel", |ui| capture::menu(ui, &mut self.state));
        let mut live = self.state.session.is_live();
        if ui
            .checkbox(&mut live, "Live estimate")
            .on_hover_text("Fits a density model after every edit, with the processor time that the window leaves")
            .clicked()
        {
            self.state.session.set_live(live);
            ui.close();
        }
        if ui.checkbox(&mut self.frame_times.shown, "Frame times").clicked() {
            ui.close();
        }
        action_entry::entry(ui, &mut self.state, Action::Jobs);
        action_entry::entry(ui, &mut self.state, Action::Messages);
    }
}

impl eframe::App for Studio {
    fn logic(&mut self, ctx: &egui::Context, _frame: &mut eframe::Frame) {
        Self::logic(self, ctx);
    }

    fn persist_egui_memory(&self) -> bool {
        // Application data are stored in separate files.
        false
    }

    fn ui(&mut self, ui: &mut Ui, frame: &mut eframe::Frame) {
        let seconds = frame.info().cpu_usage.unwrap_or(0.0);
        self.frame_times.note(seconds);
        self.pace.drawn(seconds);
        Self::ui(self, ui);
    }
}

/// Loads the outcome of a job and reports it.
fn report_outcome(state: &mut State, outcome: &Result<Outcome, String>) {
    match outcome {
        Ok(Outcome::Opened { path, .. }) => {
            state.selection.clear();
            state.preferences.remember(path);
        }
        Ok(Outcome::Saved { path, .. }) => state.preferences.remember(path),
        Ok(Outcome::ObjectsOpened { notices, .. }) => {
            for notice in notices {
                state.messages.push(Severity::Notice, notice);
            }
        }
        Ok(Outcome::PsfImported { .. } | Outcome::LensletsFitted { .. }) => state.selection.clear(),
        Ok(Outcome::Exported { .. }) => state.onboarding.exported = true,
        Ok(Outcome::SnapshotMeasured { number, measurement, .. }) => {
            state.snapshots.set_measurement(*number, measurement.clone());
            if let Err(sentence) = measurement {
                state.messages.push(Severity::Failure, sentence);
            }
        }
        Ok(Outcome::RecordKept { .. }) | Err(_) => {}
    }
    if matches!(outcome, Ok(outcome) if outcome.is_asked_for()) {
        // A later success makes the failure message obsolete.
        state.messages.dismiss();
    }
    match outcome {
        Ok(outcome) => state.messages.push(Severity::Done, outcome.sentence()),
        Err(error) => state.messages.push(Severity::Failure, error),
    }
}

/// Reports the end of an estimate or a run.
fn report_end(state: &mut State, activity: &Activity) {
    match &activity.state {
        ActivityState::Done(text) => state.messages.push(Severity::Done, format!("{}: {text}", activity.name)),
        ActivityState::Failed(sentence) => state.messages.push(Severity::Failure, sentence),
        _ => {}
    }
}

fn title(state: &State) -> String {
    let mark = if state.session.is_dirty() { "*" } else { "" };
    format!("{}{mark} - Lenslet Studio", file_name(state.session.path()))
}
