//! The state of the whole window.

use std::cmp::Reverse;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::studies::plans::StudyFolder;
use crate::studio::canvas::image_view::ColourPalettes;
use crate::studio::state::dialogs::Dialogs;
use crate::studio::state::edit_history::EditHistory;
use crate::studio::state::locks::Locks;
use crate::studio::state::messages::{Messages, Severity};
use crate::studio::state::panel_states::Panels;
use crate::studio::state::preferences::Preferences;
use crate::studio::state::reconstruction::{ShownQuantity, TEST_OBJECTS};
use crate::studio::state::view::{MaskPreview, SharedByPanels, View};
use crate::studio::state::window_layout::WindowLayout;
use crate::studio::widgets::clipboard::Clipboard;
use crate::workbench::{
    CameraResults, CaptureReconstruction, DesignRun, Estimates, InspectionKey, InspectionRequest, Job, Live,
    LiveResults, ReconstructionKey, ReconstructionRequest, Reconstructions, Recovered, Session, StudyView, Trainings,
    bounds_command, reproduce_command,
};

/// Time between two reconstructions while the masks of a run are shown as they come.
const RECONSTRUCT_EVERY: Duration = Duration::from_secs(1);

/// A requested reconstruction.
#[derive(Clone, Copy)]
struct AskedReconstruction {
    key: ReconstructionKey,
    test_objects: usize,
    with_deviation: bool,
    at: Instant,
}

/// The state of the window. Panels and dialogs get [`Parts`] of it.
pub struct State {
    /// The open design and its worker.
    pub session: Session,
    /// Results as of this frame.
    pub live: Live,
    /// Longer estimates as of this frame.
    pub estimates: Estimates,
    /// Reconstructions as of this frame.
    pub reconstructions: Reconstructions,
    /// The training of a network, and the trained networks, as of this frame.
    pub trainings: Trainings,
    /// The study as of this frame.
    pub study: StudyView,
    /// Calibration, captures and comparison of cameras as of this frame.
    pub cameras: CameraResults,
    /// The newest capture of a camera as of this frame.
    capture: Option<CaptureReconstruction>,
    /// The run that optimizes the mask, as of this frame.
    pub run: Option<DesignRun>,
    /// Key of the last requested inspection of the shown measurement.
    inspected: Option<InspectionKey>,
    /// The last requested reconstruction.
    reconstructed: Option<AskedReconstruction>,
    /// Locked lenslets.
    pub locks: Locks,
    /// Information after each edit.
    pub edit_history: EditHistory,
    /// State of the panels.
    pub panels: Panels,
    /// State of the dialogs.
    pub dialogs: Dialogs,
    /// Message log.
    pub messages: Messages,
    /// The value under the pointer, for the status bar.
    pub hover: Option<String>,
    /// Colours of all maps.
    palettes: ColourPalettes,
    /// Clipboard of copied texts.
    pub clipboard: Clipboard,
    /// Preferences of the user.
    pub preferences: Preferences,
    /// Name of the renderer; none in tests.
    pub renderer: Option<&'static str>,
    /// Folder of the application data, if any.
    pub folder: Option<PathBuf>,
    /// What the window shows where.
    pub layout: WindowLayout,
    /// Seed of the last random start.
    pub random_start: Option<u64>,
}

/// The parts of the state that panels and dialogs get.
pub struct Parts<'a> {
    /// What they read.
    pub view: View<'a>,
    /// What panels change themselves.
    pub panels: &'a mut Panels,
    /// What dialogs change themselves.
    pub dialogs: &'a mut Dialogs,
    /// The message log.
    pub messages: &'a mut Messages,
    /// Information after each edit.
    pub edit_history: &'a EditHistory,
}

impl State {
    /// Opens the last study again. A folder that was moved away is no reason for a message.
    pub fn reopen_study(&mut self) {
        if let Some(study) = self.preferences.study.clone().filter(|study| StudyFolder::is_at(study)) {
            let opened = self.session.open_study(None, study);
            self.report(opened);
        }
    }

    /// State of a new window on a session.
    pub fn new(session: Session) -> Self {
        let (live, estimates) = (session.live(), session.estimates());
        Self {
            session,
            live,
            estimates,
            reconstructions: Reconstructions::default(),
            trainings: Trainings::default(),
            study: StudyView::default(),
            cameras: CameraResults::default(),
            capture: None,
            run: None,
            inspected: None,
            reconstructed: None,
            locks: Locks::default(),
            edit_history: EditHistory::default(),
            panels: Panels::default(),
            dialogs: Dialogs::default(),
            messages: Messages::default(),
            hover: None,
            palettes: ColourPalettes::default(),
            clipboard: Clipboard::default(),
            preferences: Preferences::default(),
            renderer: None,
            folder: None,
            layout: WindowLayout::default(),
            random_start: None,
        }
    }

    /// The parts that panels and dialogs get, as of now.
    pub fn parts(&mut self) -> Parts<'_> {
        let session = &self.session;
        let view = View {
            design: session.design(),
            revision: session.revision(),
            open_design: session.open_design(),
            path: session.path(),
            is_dirty: session.is_dirty(),
            undoes: session.undoes(),
            redoes: session.redoes(),
            preview: MaskPreview {
                is_shown: session.is_previewing(),
                is_following: session.is_following(),
                has_own_lenslets: session.shows_own_lenslets(),
            },
            is_live: session.is_live(),
            live: &self.live,
            estimates: &self.estimates,
            reconstructions: &self.reconstructions,
            trainings: &self.trainings,
            study: &self.study,
            cameras: &self.cameras,
            capture: self.capture.as_ref(),
            run: self.run.as_ref(),
            inspected: self.inspected,
            locks: &self.locks,
            preferences: &self.preferences,
            palettes: &self.palettes,
            shared: SharedByPanels::of(&self.panels, session.open_design(), self.run.as_ref()),
        };
        Parts {
            view,
            panels: &mut self.panels,
            dialogs: &mut self.dialogs,
            messages: &mut self.messages,
            edit_history: &self.edit_history,
        }
    }

    /// Loads the results of the session.
    pub fn load_results(&mut self) {
        self.live = self.session.live();
        self.estimates = self.session.estimates();
        self.reconstructions = self.session.reconstructions();
        self.trainings = self.session.trainings();
        self.study = self.session.study();
        if let Some(open) = &self.study.open
            && self.preferences.study.as_deref() != Some(open.folder.path())
        {
            self.preferences.study = Some(open.folder.path().to_path_buf());
        }
        self.cameras = self.session.cameras();
        self.capture = self.session.capture();
        // Masks of a run are no edits and would fill the history.
        let current = |revision| revision == self.session.revision() && !self.session.is_previewing();
        if let Some(information) = self.live.information.as_ref().filter(|known| current(known.revision)) {
            let objects = self.live.scene.as_ref().map_or_else(String::new, |scene| scene.value.set.fingerprint());
            self.edit_history.note(information.revision, &information.value, self.session.design(), &objects);
        }
        if let Some(live) = &self.estimates.live {
            self.edit_history.note_live(live.revision, live.value.bits_per_pixel);
        }
        let results =
            LiveResults { live: &self.live, estimates: &self.estimates, reconstructions: &self.reconstructions };
        self.panels.compare.snapshots.take_up(results);
        let count = self.session.design().encoder.lenslets().map_or(0, |array| array.lenslets.len());
        self.panels.selection.truncate(count);
        // Locks belong to the open design, even during a preview.
        self.locks.check(self.session.lenslets());
    }

    /// Requests the inspection of the shown measurement (spectrum, information map), once.
    pub fn inspect(&mut self) {
        let Parts { view, panels, .. } = self.parts();
        let Some(measurements) = &view.live.measurements else { return };
        let is_map_wanted = panels.samples.overlay.shown && view.is_current(measurements.revision);
        let live = view.live_estimate().filter(|_| is_map_wanted);
        let (steps, model) = live.map(|live| (live.recipe.steps, Arc::clone(&live.model))).unzip();
        let shown = panels.samples.shown;
        let key = InspectionKey { revision: measurements.revision, sample: shown.index, noisy: shown.noisy, steps };
        let measurements = Arc::clone(&measurements.value);
        if self.inspected != Some(key) {
            self.inspected = Some(key);
            self.session.inspect(InspectionRequest { key, measurements, model });
        }
    }

    /// Requests the reconstruction of the shown measurement, once. During a run it comes from time to time: returns the time until the next.
    pub fn reconstruct(&mut self) -> Option<Duration> {
        let asked = self.reconstructed;
        let Parts { view, panels, .. } = self.parts();
        let measurements = view.current_measurements()?;
        let optics = view.live.optics.as_ref().filter(|optics| view.is_current(optics.revision))?;
        let scene = view.live.scene.as_ref().filter(|scene| scene.value.serves(view.design))?;
        let networks = &view.trainings.networks;
        let key = panels.samples.reconstruction_key(view.revision, networks);
        let is_live = view.is_live && !view.is_live_paused();
        let test_objects = if is_live { TEST_OBJECTS } else { 0 };
        let with_deviation = panels.samples.reconstruction.wanted() == ShownQuantity::Uncertainty;
        let wanted = (key, test_objects, with_deviation);
        if asked.is_some_and(|asked| (asked.key, asked.test_objects, asked.with_deviation) == wanted) {
            return None;
        }
        let wait = asked.filter(|_| view.preview.is_following);
        let wait = wait.map(|asked| RECONSTRUCT_EVERY.saturating_sub(asked.at.elapsed()));
        if let Some(wait) = wait.filter(|wait| *wait > Duration::ZERO) {
            return Some(wait);
        }
        let request = ReconstructionRequest {
            key,
            design: Arc::clone(view.design),
            scene: Arc::clone(&scene.value),
            optics: Arc::clone(&optics.value),
            measurements: Arc::clone(&measurements.value),
            test_objects,
            with_deviation,
            networks: networks.clone(),
        };
        self.reconstructed = Some(AskedReconstruction { key, test_objects, with_deviation, at: Instant::now() });
        self.session.reconstruct(request);
        None
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

    /// Command line that reproduces the numbers of the shown design. Where it needs a record, that is written.
    pub fn command_of_numbers(&mut self) -> Result<String, String> {
        let record = self.parts().view.live_record();
        match (record, &self.folder) {
            (Some(record), Some(folder)) => {
                let path = folder.join("records").join(record.file_name());
                let command = reproduce_command(&path);
                self.session.submit(Job::ExportLive { record: Box::new(record), path, for_command: true });
                Ok(command)
            }
            _ => bounds_command(self.session.design()),
        }
    }

    /// Reports a refusal as a failure.
    pub fn report(&mut self, done: Result<(), String>) {
        if let Err(refusal) = done {
            self.messages.push(Severity::Failure, refusal);
        }
    }

    /// Takes a snapshot of the open design.
    pub fn keep_snapshot(&mut self) {
        let open = (self.session.design(), self.session.revision());
        let compare = &mut self.panels.compare;
        let results =
            LiveResults { live: &self.live, estimates: &self.estimates, reconstructions: &self.reconstructions };
        match compare.snapshots.keep(open.0, open.1, results) {
            Ok(()) => {
                let Some(last) = compare.snapshots.entries.last() else { return };
                let (number, name) = (last.number, last.name.clone());
                compare.compare_new(number);
                self.messages.push(Severity::Done, format!("Snapshot taken: {name}"));
            }
            Err(reason) => self.messages.push(Severity::Failure, reason),
        }
    }
}
