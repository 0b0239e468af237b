//! The studio: menus, panels, status bar, and the work between frames.

use std::path::{Path, PathBuf};
use std::time::Instant;

use egui::{Panel, Ui, ViewportCommand};
use egui_tiles::Tree;

use crate::evaluation::EvaluationError;
use crate::formats::FormatError;
use crate::forward::Design;
use crate::plural::{counted, one_or_many};
use crate::studio::app::app_data::{AppData, SNAPSHOTS};
use crate::studio::app::layout::{self, PanelBehavior, default_layout, restored};
use crate::studio::app::outcomes::{report_end, report_outcome};
use crate::studio::app::repaint_throttle::RepaintThrottle;
use crate::studio::app::state::{Parts, State};
use crate::studio::app::{capture as panel_capture, dispatch, menus};
use crate::studio::canvas::pan_zoom::CLICK_REACH;
use crate::studio::dialogs::confirm_discard::{self, AtStake};
use crate::studio::dialogs::dropped_files::{self, Dropped};
use crate::studio::dialogs::settings_dialogs::{self, Environment};
use crate::studio::dialogs::{capture, palette, path_dialog, psf_import, recovery, welcome};
use crate::studio::panels::status_bar::{self, FrameTimes, StatusBar};
use crate::studio::panels::{jobs, messages, preview_banner};
use crate::studio::state::action::Action;
use crate::studio::state::messages::Severity;
use crate::studio::state::pane::Pane;
use crate::studio::state::preferences::{RendererChoice, ZOOM};
use crate::studio::state::request::Request;
use crate::studio::state::transition::Transition;
use crate::studio::state::window_layout::LayoutRequest;
use crate::studio::widgets::clipboard::Clipboard;
use crate::studio::widgets::colours::make_texts_readable;
use crate::studio::widgets::format::file_name;
use crate::studio::widgets::missing_glyphs;
use crate::studio::widgets::number_field::take_rejections;
use crate::workbench::{FoundSnapshots, Recovered, RunStatus, Session, Snapshots};

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
            make_texts_readable(&mut style.visuals);
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
        let (repaint, pace) = (ctx.clone(), self.pace.clone());
        let on_attempt = move || repaint.request_repaint_after(pace.wait());
        match AppData::in_folder(folder, &self.state.preferences, layout.as_ref(), on_attempt) {
            Ok(app_data) => {
                self.state.dialogs.onboarding.welcome =
                    !self.state.preferences.welcomed && self.state.session.path().is_none();
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
        if let Err(error) = self.state.session.keep_comparison_in(folder) {
            self.state.messages.push(Severity::Failure, error.to_string());
        }
        self.keep_runs(folder);
        self.state.reopen_study();
    }

    /// Stores nothing but unsaved changes, if a folder was chosen for them.
    pub fn keep_no_data(&mut self, reason: &str) {
        let text = format!("Nothing is saved when the window closes: {reason}");
        self.state.messages.push(Severity::Failure, text);
        self.left_behind = self.state.keep_unsaved();
    }

    fn read_kept_designs(&mut self, folder: &Path) {
        match Snapshots::read(&folder.join(SNAPSHOTS)) {
            Ok(FoundSnapshots { snapshots, unreadable, unlisted }) => {
                self.state.panels.compare.snapshots = snapshots;
                if unreadable > 0 {
                    let (designs, they) =
                        (counted(unreadable, "snapshot"), one_or_many(unreadable, "it is", "they are"));
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
        match self.state.layout.request.take() {
            Some(LayoutRequest::Show(pane)) => {
                self.layout.make_active(|_, tile| matches!(tile, egui_tiles::Tile::Pane(found) if *found == pane));
                if self.state.layout.maximised.is_some() {
                    self.state.layout.maximised = Some(pane);
                }
            }
            Some(LayoutRequest::Reset) => {
                self.layout = default_layout();
                self.state.layout.maximised = None;
            }
            Some(LayoutRequest::Remember(number)) => {
                self.state.preferences.layouts.insert(number, self.layout.clone());
                self.notify(format!("Saved as layout {number}"));
            }
            Some(LayoutRequest::Recall(number)) => {
                if let Some(layout) = self.state.preferences.layouts.get(&number) {
                    self.layout = restored(layout.clone()).unwrap_or_else(default_layout);
                    self.state.layout.maximised = None;
                }
            }
            None => {}
        }
        let state = &mut self.state;
        if let Some(failure) = state.session.note_unsaved() {
            state.messages.push(Severity::Failure, failure);
        }
        let Some(app_data) = &mut self.app_data else { return };
        let (snapshots, now) = (&mut state.panels.compare.snapshots, Instant::now());
        app_data.keep_designs(snapshots.changes(now, self.closing));
        if let Some(wait) = snapshots.due(now) {
            ctx.request_repaint_after(wait);
        }
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
        !self.state.dialogs.is_one_in_front() && self.left_behind.is_empty() && !self.dropped.is_open()
    }

    /// Loads results, answers and shortcuts.
    pub fn logic(&mut self, ctx: &egui::Context) {
        let state = &mut self.state;
        let waits_for_save = state.waits_for_save();
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
        sync_run(state);
        state.load_results();
        if !waits_for_save && state.transit_after_save(ctx) {
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
        let mut requests = Vec::new();
        self.dropped.take(ctx, &mut requests);
        dispatch::serve_all(requests, ctx, &mut self.state);
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
        panel_capture::advance(ui.ctx(), &mut self.state);
        let mut requests = Vec::new();
        Panel::top("menu").show(ui, |ui| self.menu_bar(ui, &mut requests));
        messages::banner(ui, &mut self.state.messages);
        let can_accept = self.state.session.can_accept();
        preview_banner::show(ui, can_accept, &self.state.parts().view, &mut requests);
        // The status bar shows the value under the pointer, which the panels find: its space is allocated first, its text drawn
        // last.
        let status = Panel::bottom("status").exact_size(24.0).show(ui, |ui| ui.available_rect_before_wrap()).inner;
        self.state.layout.visible.clear();
        egui::CentralPanel::no_frame().show(ui, |ui| match self.state.layout.maximised {
            Some(pane) => layout::show_maximised(ui, &mut self.state, pane),
            None => self.layout.ui(&mut PanelBehavior(&mut self.state), ui),
        });
        let ctx = ui.ctx().clone();
        dispatch::serve_all(requests, &ctx, &mut self.state);
        let bar = ui.new_child(egui::UiBuilder::new().id_salt("status text").max_rect(status));
        self.status_bar(bar);
        messages::log_window(&ctx, &mut self.state.messages);
        messages::toasts(&ctx, &mut self.state.messages);
        self.dialogs(&ctx);
        dropped_files::show_hint(&ctx);
    }

    fn status_bar(&mut self, mut bar: Ui) {
        let mut requests = Vec::new();
        let (activities, is_computing) = (self.state.session.activities(), self.state.session.is_computing());
        let hover = self.state.hover.take();
        let Parts { view, messages, .. } = self.state.parts();
        let status =
            StatusBar { hover: hover.as_deref(), activities: &activities, is_computing, frames: &self.frame_times };
        status_bar::show(&mut bar, status, messages, &view, &mut requests);
        dispatch::serve_all(requests, bar.ctx(), &mut self.state);
    }

    /// Shows the open dialogs. The requests of each are served before the next is drawn.
    fn dialogs(&mut self, ctx: &egui::Context) {
        let activities = self.state.session.activities();
        self.dialog(ctx, |parts, requests| jobs::show(ctx, &mut parts.dialogs.jobs_open, &activities, requests));
        self.dialog(ctx, |parts, requests| capture::show(ctx, &mut parts.dialogs.capture, &parts.view, requests));
        self.dialog(ctx, |parts, requests| {
            let is_covered = parts.dialogs.path.is_open();
            psf_import::show(ctx, &mut parts.dialogs.psf_import, is_covered, parts.view.palettes, requests);
        });
        self.dialog(ctx, |parts, requests| path_dialog::show(ctx, &mut parts.dialogs.path, parts.view.path, requests));
        self.dialog(ctx, |parts, requests| palette::show(ctx, &mut parts.dialogs.palette, &parts.view, requests));
        let (renderer, folder) = (self.state.renderer, self.state.folder.clone());
        let environment = Environment { renderer, folder: folder.as_deref() };
        self.dialog(ctx, |parts, requests| {
            settings_dialogs::show(ctx, &mut parts.dialogs.settings, &environment, &parts.view, requests);
        });
        self.dialog(ctx, |parts, requests| {
            welcome::show_tour(ctx, &mut parts.dialogs.onboarding, &parts.view, requests);
        });
        let mut left_behind = std::mem::take(&mut self.left_behind);
        self.dialog(ctx, |_, requests| recovery::ask(ctx, &mut left_behind, requests));
        self.left_behind = left_behind;
        // One dialog at a time.
        if self.left_behind.is_empty() {
            self.dialog(ctx, |parts, requests| welcome::show_welcome(ctx, &mut parts.dialogs.onboarding, requests));
        }
        if self.state.dialogs.transition.is_some() {
            self.confirm_discard(ctx);
        }
        let mut requests = Vec::new();
        self.dropped.ask(ctx, &mut requests);
        dispatch::serve_all(requests, ctx, &mut self.state);
    }

    fn confirm_discard(&mut self, ctx: &egui::Context) {
        let at_stake =
            AtStake { work: self.state.unfinished_work(), has_unsaved_result: self.state.session.has_unsaved_result() };
        let mut close = false;
        self.dialog(ctx, |parts, requests| {
            close = confirm_discard::ask(ctx, &mut parts.dialogs.transition, &at_stake, &parts.view, requests);
        });
        if close {
            self.close();
        }
    }

    /// Shows a dialog and serves its requests.
    fn dialog(&mut self, ctx: &egui::Context, show: impl FnOnce(&mut Parts<'_>, &mut Vec<Request>)) {
        let mut requests = Vec::new();
        show(&mut self.state.parts(), &mut requests);
        dispatch::serve_all(requests, ctx, &mut self.state);
    }

    fn menu_bar(&mut self, ui: &mut Ui, requests: &mut Vec<Request>) {
        let visible = self.state.layout.visible.clone();
        let Parts { view, panels, .. } = self.state.parts();
        let frame_times = &mut self.frame_times;
        egui::MenuBar::new().ui(ui, |ui| {
            ui.menu_button("File", |ui| menus::file_menu(ui, panels, &view, requests));
            ui.menu_button("Edit", |ui| menus::edit_menu(ui, &view, requests));
            ui.menu_button("Presets", |ui| menus::presets_menu(ui, &view, requests));
            ui.menu_button("View", |ui| menus::view_menu(ui, &visible, &mut frame_times.shown, &view, requests));
            ui.menu_button("Help", |ui| menus::help_menu(ui, &view, requests));
            ui.separator();
            let name = file_name(view.path);
            let dirty = if view.is_dirty { " (unsaved changes)" } else { "" };
            let line = format!("{name}{dirty}:  {}, {}", view.design.encoder.describe(), view.design.objects);
            ui.add(egui::Label::new(egui::RichText::new(line).weak()).truncate());
        });
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

/// Loads the state of the run. A finished run shows its result.
fn sync_run(state: &mut State) {
    let was_followed = state.session.is_following();
    state.run = state.session.sync_run();
    let finished = state.run.as_ref().filter(|run| was_followed && run.status == RunStatus::Finished);
    let preview = finished.and_then(|run| state.panels.optimize.show_end(run));
    if let Some(preview) = preview {
        dispatch::serve_run(preview, state);
    }
}

fn title(state: &State) -> String {
    let mark = if state.session.is_dirty() { "*" } else { "" };
    format!("{}{mark} - Lenslet Studio", file_name(state.session.path()))
}
