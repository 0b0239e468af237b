//! The state that panels and dialogs share.

use std::cmp::Reverse;
use std::collections::{BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;

use crate::evaluation::Measurements;
use crate::forward::Design;
use crate::optics::Lenslet;
use crate::studio::canvas::image_view::{ColourPalettes, ImageView};
use crate::studio::state::action::Action;
use crate::studio::state::comparison::Comparison;
use crate::studio::state::edit_history::EditHistory;
use crate::studio::state::estimate_form::EstimateForm;
use crate::studio::state::locks::Locks;
use crate::studio::state::messages::{Messages, Severity};
use crate::studio::state::open_dialogs::{ActionPalette, Onboarding, SettingsDialog};
use crate::studio::state::optimize_form::OptimizeForm;
use crate::studio::state::pane::Pane;
use crate::studio::state::panel_capture::Capture;
use crate::studio::state::path_question::{PathDialog, PathPurpose};
use crate::studio::state::preferences::Preferences;
use crate::studio::state::views::{InformationOverlay, LinkedCursor, MaskDrag, MtfView, Views};
use crate::studio::widgets::clipboard::Clipboard;
use crate::studio::widgets::number_field::Edit;
use crate::workbench::{
    Colormap, Command, DesignRun, Estimates, InspectionKey, InspectionRequest, Live, LiveEstimate, LiveRecord,
    Recovered, Revisioned, SampleInspection, Session, Snapshots,
};

/// The state of the window. Panels read it, and change the design only through [`State::send`].
pub struct State {
    /// The open design and its worker.
    pub session: Session,
    /// Results as of this frame.
    pub live: Live,
    /// Longer estimates as of this frame.
    pub estimates: Estimates,
    /// The run that optimizes the mask, as of this frame.
    pub run: Option<DesignRun>,
    /// Form of the Optimize panel.
    pub optimize_form: OptimizeForm,
    /// Form of the Estimates panel.
    pub estimate_form: EstimateForm,
    /// Whether the mask shows gradient arrows.
    pub arrows: bool,
    /// Index of the patch whose information map is shown; none for the mean.
    pub map_sample: Option<usize>,
    /// Indices of the selected lenslets.
    pub selection: BTreeSet<usize>,
    /// Locked lenslets.
    pub locks: Locks,
    /// The images.
    pub views: Views,
    /// Colours of all maps.
    pub palettes: ColourPalettes,
    /// Index of the shown sample.
    pub sample: usize,
    /// Whether the measurement is shown with noise.
    pub noisy: bool,
    /// View of the MTF panel.
    pub mtf_view: MtfView,
    /// Key of the last requested inspection of the shown measurement.
    pub closer_asked: Option<InspectionKey>,
    /// Information overlay of the measurement.
    pub overlay: InformationOverlay,
    /// Position of the pointer in object or measurement.
    pub cursor: LinkedCursor,
    /// The value under the pointer, for the status bar.
    pub hover: Option<String>,
    /// Information after each edit.
    pub edit_history: EditHistory,
    /// Message log.
    pub messages: Messages,
    /// Clipboard of copied texts.
    pub clipboard: Clipboard,
    /// The question for a path.
    pub path_dialog: PathDialog,
    /// The current drag on the mask.
    pub drag: Option<MaskDrag>,
    /// The transition that waits for a confirmation.
    pub pending_transition: Option<PendingTransition>,
    /// Snapshots of designs.
    pub snapshots: Snapshots,
    /// State of the Compare panel.
    pub comparison: Comparison,
    /// Preferences of the user.
    pub preferences: Preferences,
    /// Name of the renderer; none in tests.
    pub renderer: Option<&'static str>,
    /// Folder of the application data, if any.
    pub folder: Option<PathBuf>,
    /// Requested change of the layout.
    pub layout_request: Option<LayoutRequest>,
    /// The open command palette.
    pub palette: Option<ActionPalette>,
    /// The open settings dialog.
    pub settings_dialog: Option<SettingsDialog>,
    /// Whether the list of jobs is open.
    pub jobs_open: bool,
    /// Pending capture of a panel.
    pub capture: Capture,
    /// Rectangle of each visible panel, points.
    pub panel_rects: Vec<(Pane, egui::Rect)>,
    /// The maximized panel.
    pub maximised: Option<Pane>,
    /// Welcome dialog and tour.
    pub onboarding: Onboarding,
    /// Requested actions, in order.
    pub actions: VecDeque<Action>,
    /// Seed of the last random start.
    random_start: Option<u64>,
}

/// A step that would discard the open design or a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Transition {
    /// Starting from the default design.
    New,
    /// Starting from a sample design.
    Sample(Box<Design>),
    /// Asking for a design file.
    Open,
    /// Opening a design file that was dropped on the window.
    OpenFile(PathBuf),
    /// Closing the window.
    Close,
    /// Starting a run in place of the last one.
    Run,
    /// Opening the previewed mask as a new design.
    Accept,
}

/// A requested change of the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayoutRequest {
    /// Brings a panel to the front.
    Show(Pane),
    /// Restores the default layout.
    Reset,
    /// Saves the layout under this number.
    Remember(usize),
    /// Loads the layout of this number.
    Recall(usize),
}

/// A transition that waits for a confirmation.
pub struct PendingTransition {
    /// The transition.
    pub what: Transition,
    /// *Save* was chosen: the transition follows when the file is written.
    pub saving: bool,
}

impl State {
    /// State of a new window on a session.
    pub fn new(session: Session) -> Self {
        let (live, estimates) = (session.live(), session.estimates());
        Self {
            session,
            live,
            estimates,
            run: None,
            optimize_form: OptimizeForm::default(),
            estimate_form: EstimateForm::default(),
            arrows: true,
            map_sample: None,
            selection: BTreeSet::new(),
            locks: Locks::default(),
            views: Views {
                psf: ImageView::new("PSF", "", Colormap::Viridis),
                object: ImageView::new("Object", "photons", Colormap::Gray),
                measurement: ImageView::new("Measurement", "photons", Colormap::Gray),
                mtf: ImageView::new("MTF map", "", Colormap::Viridis),
                information: ImageView::new("Information map", "bits", Colormap::Inferno),
            },
            palettes: ColourPalettes::default(),
            sample: 0,
            noisy: true,
            mtf_view: MtfView::default(),
            closer_asked: None,
            overlay: InformationOverlay::default(),
            cursor: LinkedCursor::default(),
            hover: None,
            edit_history: EditHistory::default(),
            messages: Messages::default(),
            clipboard: Clipboard::default(),
            path_dialog: PathDialog::default(),
            drag: None,
            pending_transition: None,
            snapshots: Snapshots::default(),
            comparison: Comparison::default(),
            preferences: Preferences::default(),
            renderer: None,
            folder: None,
            layout_request: None,
            palette: None,
            settings_dialog: None,
            jobs_open: false,
            capture: Capture::default(),
            panel_rects: Vec::new(),
            maximised: None,
            onboarding: Onboarding::default(),
            actions: VecDeque::new(),
            random_start: None,
        }
    }

    /// Performs a transition, after a confirmation if something would be lost.
    pub fn request_transition(&mut self, ctx: &egui::Context, what: Transition) {
        let asks = match what {
            Transition::Run => {
                self.run.as_ref().is_some_and(DesignRun::can_resume) || self.session.would_lose_run_data()
            }
            Transition::Close => self.session.is_dirty() || self.unfinished_work().is_some(),
            _ => self.session.is_dirty(),
        };
        if asks {
            self.pending_transition = Some(PendingTransition { what, saving: false });
        } else {
            self.perform_transition(ctx, what);
        }
    }

    /// Performs a transition without confirmation.
    pub fn perform_transition(&mut self, ctx: &egui::Context, what: Transition) {
        self.pending_transition = None;
        if matches!(what, Transition::New | Transition::Sample(_)) {
            self.selection.clear();
        }
        match what {
            Transition::New => self.session.start_from(Design::default()),
            Transition::Sample(design) => self.session.start_from(*design),
            Transition::Open => self.path_dialog.ask(PathPurpose::OpenDesign, self.session.path()),
            Transition::OpenFile(path) => self.session.open_file(path),
            Transition::Close => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Transition::Run => self.start_run(),
            Transition::Accept => self.session.open_as_new(),
        }
    }

    /// Requests an action. It runs after all panels are drawn.
    pub fn act(&mut self, action: Action) {
        self.actions.push_back(action);
    }

    /// Seed of the next random preset: that of the design first, then consecutive ones.
    pub fn next_random_start(&mut self, seed: u64) -> u64 {
        let next = self.random_start.map_or(seed, |last| last.wrapping_add(1));
        self.random_start = Some(next);
        next
    }

    /// Applies a command to the design; a message reports a refusal.
    pub fn send(&mut self, command: &Command) {
        let are_others = !self.session.shows_own_lenslets();
        if let Err(error) = self.session.apply(command) {
            return self.messages.push(Severity::Failure, error.to_string());
        }
        match command {
            Command::AddLenslet(_) => self.selection = self.lenslet_count().checked_sub(1).into_iter().collect(),
            Command::DeleteLenslets(_) | Command::ReplaceEncoder { .. } | Command::ReplaceDesign { .. } => {
                self.selection.clear();
                self.drag = None; // its indices now belong to other lenslets
            }
            _ => {}
        }
        match (are_others, command.edits_lenslets()) {
            // An edit of a previewed mask accepts it.
            (true, true) => self.locks.check(self.session.lenslets()),
            // The preview has ended.
            (true, false) => self.selection.clear(),
            (false, _) => {}
        }
        self.locks.follow(command, self.session.lenslets());
    }

    /// Applies a command of a number field; a typed number is one undo step.
    pub fn send_edit(&mut self, edit: Edit, command: &Command) {
        if edit.is_typed {
            self.session.begin_step();
        }
        self.send(command);
        if edit.is_typed {
            self.session.begin_step();
        }
    }

    /// Switches to another design, as by undo. Drag, selection and locks are reset if its lenslets differ.
    pub fn go(&mut self, go: impl FnOnce(&mut Session)) {
        let shown = |session: &Session| (session.lenslets(), session.shows_own_lenslets());
        let before = shown(&self.session);
        go(&mut self.session);
        self.drag = None;
        if shown(&self.session) != before {
            self.selection.clear();
        }
        self.locks.check(self.session.lenslets());
    }

    /// Number of lenslets of the shown design.
    pub fn lenslet_count(&self) -> usize {
        self.session.design().encoder.lenslets().map_or(0, |array| array.lenslets.len())
    }

    /// The selected lenslets with their indices.
    pub fn selected_lenslets(&self) -> Vec<(usize, Lenslet)> {
        let Some(array) = self.session.design().encoder.lenslets() else { return Vec::new() };
        self.selection.iter().filter_map(|&index| Some((index, *array.lenslets.get(index)?))).collect()
    }

    /// Adds a copy of the last lenslet in the middle of the grid.
    pub fn add_lenslet(&mut self) {
        let Some(array) = self.session.design().encoder.lenslets() else { return };
        let (x, y) = ((array.cols / 2) as f64, (array.rows / 2) as f64);
        let like = array.lenslets.last();
        let sigma = like.map_or(crate::optics::HEURISTIC_SIGMA, |lenslet| lenslet.spot.mean_sigma());
        let weight = like.map_or(1.0, |lenslet| lenslet.weight.max(1e-3));
        self.send(&Command::AddLenslet(Lenslet::round(x, y, sigma, weight)));
    }

    /// Stores unsaved changes in the folder of the preferences, or else the default one. Returns the unsaved designs of earlier
    /// sessions in either, newest first.
    pub fn keep_unsaved(&mut self) -> Vec<Recovered> {
        let usual = self.folder.as_ref().map(|home| home.join("unsaved"));
        // The default folder serves if that of the preferences is missing.
        for folder in self.preferences.unsaved.iter().chain(&usual) {
            match self.session.keep_unsaved_in(folder) {
                Ok(mut found) => {
                    // The last session may have used the default folder.
                    if let Some(usual) = usual.as_ref().filter(|&usual| usual != folder) {
                        found.extend(Session::left_unsaved_in(usual));
                        found.sort_by_key(|left| Reverse(left.kept_at));
                    }
                    return found;
                }
                Err(error) => self.messages.push(Severity::Failure, error.to_string()),
            }
        }
        Vec::new()
    }

    /// Sets the folder of unsaved changes; `None` for the default one. Designs in it are offered at the next start.
    pub fn move_unsaved(&mut self, folder: Option<PathBuf>) {
        self.preferences.unsaved = folder;
        drop(self.keep_unsaved());
    }

    /// The live estimate, if it belongs to the current revision.
    pub fn live_estimate(&self) -> Option<&LiveEstimate> {
        let live = self.estimates.live.as_ref()?;
        Some(&*live.value).filter(|_| self.is_current(live.revision))
    }

    /// The measurements, if they belong to the current revision.
    pub fn current_measurements(&self) -> Option<&Revisioned<Measurements>> {
        self.live.measurements.as_ref().filter(|measurements| self.is_current(measurements.revision))
    }

    /// Reason why the current revision has no results, if it failed.
    pub fn failure(&self) -> Option<&str> {
        let (revision, failure) = self.live.failure.as_ref()?;
        self.is_current(*revision).then_some(failure.as_str())
    }

    /// Requests the inspection of the shown measurement (spectrum, information map) and returns the newest one.
    pub fn inspect(&mut self, measurements: &Revisioned<Measurements>) -> Option<Arc<SampleInspection>> {
        let live = self.live_estimate().filter(|_| self.overlay.shown && self.is_current(measurements.revision));
        let (steps, model) = live.map(|live| (live.recipe.steps, Arc::clone(&live.model))).unzip();
        let key = InspectionKey { revision: measurements.revision, sample: self.sample, noisy: self.noisy, steps };
        if self.closer_asked != Some(key) {
            self.closer_asked = Some(key);
            self.session.inspect(InspectionRequest { key, measurements: Arc::clone(&measurements.value), model });
        }
        self.live.closer.clone()
    }

    /// Record from which the live estimate is reproduced.
    pub fn live_record(&self) -> Option<LiveRecord> {
        let scene = self.live.scene.as_ref().filter(|scene| scene.value.serves(self.session.design()))?;
        Some(LiveRecord::new(self.session.design(), &scene.value, self.live_estimate()?))
    }

    /// Copies a text and reports whether that worked; `what` names the text in the message, for example "Numbers".
    pub fn copy(&mut self, ctx: &egui::Context, text: String, what: &str) {
        match self.clipboard.put(ctx, text) {
            Ok(()) => self.messages.push(Severity::Done, format!("{what} copied to the clipboard")),
            Err(reason) => {
                let failure = format!("{what} not copied to the system clipboard: {reason}");
                self.messages.push(Severity::Failure, failure);
            }
        }
    }

    /// Copies a command line, or reports why none exists.
    pub fn copy_command(&mut self, ctx: &egui::Context, command: Result<String, String>) {
        match command {
            Ok(text) => self.copy(ctx, text, "Command line"),
            Err(reason) => self.messages.push(Severity::Failure, reason),
        }
    }

    /// Deletes the selected lenslets.
    pub fn delete_selection(&mut self) {
        let indices: Vec<usize> = self.selection.iter().copied().collect();
        if !indices.is_empty() {
            self.send(&Command::DeleteLenslets(indices));
        }
    }

    /// Whether a result of this revision is current.
    pub fn is_current(&self, revision: u64) -> bool {
        revision == self.session.revision()
    }
}

impl State {
    /// Takes a snapshot of the open design.
    pub fn keep_snapshot(&mut self) {
        let open = (self.session.design(), self.session.revision());
        match self.snapshots.keep(open, &self.live, &self.estimates) {
            Ok(()) => {
                let Some(last) = self.snapshots.entries.last() else { return };
                // The first two snapshots are compared at once.
                let free = self.comparison.pair.iter_mut().find(|number| number.is_none());
                if let Some(free) = free {
                    *free = Some(last.number);
                }
                self.messages.push(Severity::Done, format!("Snapshot taken: {}", last.name));
            }
            Err(reason) => self.messages.push(Severity::Failure, reason),
        }
    }
}
