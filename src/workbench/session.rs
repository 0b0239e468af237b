//! A session: the open design and its worker.

pub mod cameras;
pub mod estimates;
pub mod reconstructions;
pub mod run_preview;
pub mod snapshots;
pub mod studies;
pub mod trainings;
pub mod unsaved;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::forward::Design;
use crate::objects::ObjectSource;
use crate::optics::Encoder;
use crate::workbench::background::activity::{Activities, Activity, ActivityKind};
use crate::workbench::background::mailbox::MailboxThread;
use crate::workbench::background::threads::{Threads, Wake};
use crate::workbench::cameras::desk::CameraDesk;
use crate::workbench::captures::capturer;
use crate::workbench::captures::queue::CaptureQueue;
use crate::workbench::document::autosave::Autosave;
use crate::workbench::document::command::{Command, CommandError};
use crate::workbench::document::history::{History, Version};
use crate::workbench::jobs::job::{DiffuserOrigin, Job};
use crate::workbench::jobs::outcome::Outcome;
use crate::workbench::jobs::worker::Worker;
use crate::workbench::live::inspection::InspectionRequest;
use crate::workbench::live::published::{Live, Wanted};
use crate::workbench::reconstructions::queue::ReconstructionQueue;
use crate::workbench::reconstructions::reconstructor;
use crate::workbench::runs::RunThread;
use crate::workbench::session::run_preview::RunPreview;
use crate::workbench::studies::queue::StudyQueue;
use crate::workbench::studies::study_thread;
use crate::workbench::trainings::queue::TrainingQueue;
use crate::workbench::trainings::trainer;

/// The open design with its revision, its history, its file, the worker that evaluates it, and the run that optimizes it.
///
/// Every change goes through [`Session::apply`], undo and redo, or [`Session::accept`] for a mask of a run. Every new design on view gets
/// a new revision, and its numbers are requested from the worker. Revisions never repeat, so equal revisions mean equal designs.
pub struct Session {
    /// The design on view: the open design, or the previewed mask of the run.
    pub(crate) design: Arc<Design>,
    /// The open design while a mask of the run is previewed.
    pub(crate) open: Option<Arc<Design>>,
    pub(crate) revision: u64,
    /// Number of the open design's contents. Unlike its revision, it comes back with an undo.
    pub(crate) contents: u64,
    saved_contents: u64,
    /// Number of the document. New and Open change it, even while jobs of the last document are still running.
    pub(crate) document: u64,
    /// Number of the open design's lenslets; like the number of its contents, it comes back with an undo.
    pub(crate) lenslets: u64,
    pub(crate) history: History,
    path: Option<PathBuf>,
    wake: Wake,
    threads: Threads,
    activities: Activities,
    pub(crate) worker: Worker,
    pub(crate) reconstructor: MailboxThread<ReconstructionQueue>,
    pub(crate) capturer: MailboxThread<CaptureQueue>,
    pub(crate) trainer: MailboxThread<TrainingQueue>,
    pub(crate) study: MailboxThread<StudyQueue>,
    pub(crate) cameras: CameraDesk,
    pub(in crate::workbench) designer: RunThread,
    pub(crate) watched: RunPreview,
    autosave: Option<Autosave>,
    /// Autosave in the earlier folder, until the design is saved in the new one.
    earlier_autosave: Option<Autosave>,
}

impl Session {
    /// Opens `design`, which counts as saved because it can be restored. `wake` is called from other threads whenever there is
    /// something new to show.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn new(
        design: Design,
        path: Option<PathBuf>,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let wake: Wake = Arc::new(wake);
        let (threads, activities) = (Threads::default(), Activities::default());
        let worker = Worker::start(Arc::clone(&wake), &threads, activities.clone())?;
        let trainer = trainer::start(Arc::clone(&wake), threads.clone(), activities.clone())?;
        let design = Arc::new(design);
        worker.evaluate(Wanted { revision: 1, design: Arc::clone(&design), before: None });
        let session = Self {
            design,
            open: None,
            revision: 1,
            contents: 1,
            saved_contents: 1,
            document: 1,
            lenslets: 1,
            history: History::default(),
            path,
            worker,
            reconstructor: reconstructor::start(Arc::clone(&wake), threads.clone())?,
            trainer,
            study: study_thread::start(Arc::clone(&wake), threads.clone(), activities.clone())?,
            cameras: CameraDesk::start(&wake, &threads, &activities)?,
            capturer: capturer::start(Arc::clone(&wake), threads.clone(), activities.clone())?,
            designer: RunThread::start_thread(Arc::clone(&wake), threads.clone(), activities.clone())?,
            wake,
            threads,
            activities,
            watched: RunPreview::default(),
            autosave: None,
            earlier_autosave: None,
        };
        session.find_network();
        Ok(session)
    }

    /// The design on view: the open design, or the mask of the run that is [previewed](Session::preview).
    pub fn design(&self) -> &Arc<Design> {
        &self.design
    }

    /// The open design, also while a mask of the run is previewed.
    pub fn open_design(&self) -> &Arc<Design> {
        self.open.as_ref().unwrap_or(&self.design)
    }

    /// Revision of the design on view.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Whether the open design differs from its file (or, without one, from how it was opened).
    pub fn is_dirty(&self) -> bool {
        self.contents != self.saved_contents
    }

    /// Number of the open design's lenslets. While it stays the same, indices mean the same lenslets, even if they were moved.
    pub fn lenslets(&self) -> u64 {
        self.lenslets
    }

    /// The design's file.
    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// The latest results; compare their revisions with [`Session::revision`].
    pub fn live(&self) -> Live {
        self.worker.live()
    }

    /// Whether results of the open design are still to come.
    pub fn is_computing(&self) -> bool {
        let live = self.worker.live();
        let done = |revision: Option<u64>| revision == Some(self.revision);
        !done(live.information.map(|information| information.revision))
            && !done(live.failure.map(|(revision, _)| revision))
    }

    /// Requests the inspection of one measurement of the latest results.
    pub fn inspect(&self, order: InspectionRequest) {
        self.worker.inspect(order);
    }

    /// Sets the number of computing threads, from the next computation on; none stands for one thread per core.
    pub fn set_threads(&self, count: Option<usize>) {
        self.threads.set(count);
    }

    /// Activities that are running, waiting or finished, oldest first.
    pub fn activities(&self) -> Vec<Arc<Activity>> {
        self.activities.all()
    }

    /// Long activities that ended since the last call, oldest first.
    pub fn take_ended(&self) -> Vec<Arc<Activity>> {
        self.activities.take_ended()
    }

    /// Stops an activity, if it can be stopped.
    pub fn stop(&self, activity: &Activity) {
        match activity.kind {
            ActivityKind::Save | ActivityKind::File => {}
            ActivityKind::Objects => self.worker.cancel_numbered(activity.number),
            ActivityKind::Estimate => self.worker.estimator().cancel_numbered(activity.number),
            ActivityKind::Capture => self.stop_capture(),
            ActivityKind::Run => self.stop_run(),
            ActivityKind::Training => self.stop_training(),
            ActivityKind::Study => self.stop_study(),
            ActivityKind::Calibration => self.stop_calibration(),
            ActivityKind::Comparison => self.stop_comparison(),
        }
    }

    /// Applies a command to the design. An edit of a previewed mask accepts that mask. Every other command changes the
    /// open design, which is then shown again.
    ///
    /// # Errors
    /// [`CommandError`] where the command is not possible; the design then stays as it was.
    pub fn apply(&mut self, command: &Command) -> Result<(), CommandError> {
        if !command.edits_mask() {
            self.end_preview();
        }
        let changed = command.applied_to(&self.design)?;
        if changed == *self.design {
            return Ok(());
        }
        if self.is_previewing() && !self.accept() {
            return Err(CommandError::OfRun);
        }
        self.watched.following = false;
        self.history.note(self.version(), command.label(), command.kind());
        self.show(Arc::new(changed));
        self.contents = self.revision;
        if !command.keeps_lenslets() {
            self.lenslets = self.revision;
        }
        Ok(())
    }

    /// Notes whether the pointer is held down, which groups changes into one gesture. Also notes whether it was pressed since the last
    /// call, which starts a new gesture.
    pub fn note_pointer(&mut self, down: bool, pressed: bool) {
        self.history.note_pointer(down, pressed);
    }

    /// Begins a step of its own for the next change, such as the click of a button.
    pub fn begin_step(&mut self) {
        self.history.begin_step();
    }

    /// Label of the step that [`Session::undo`] undoes.
    pub fn undoes(&self) -> Option<&str> {
        if self.is_previewing() { Some("Look at the run") } else { self.history.undoes() }
    }

    /// Label of the step that [`Session::redo`] redoes.
    pub fn redoes(&self) -> Option<&str> {
        self.history.redoes().filter(|_| !self.is_previewing())
    }

    /// Goes one step back; from a previewed mask of the run to the open design.
    pub fn undo(&mut self) {
        if self.is_previewing() {
            self.end_preview();
        } else if let Some(version) = self.history.undo(self.version()) {
            self.go_to(version);
        }
    }

    /// Goes one step forward.
    pub fn redo(&mut self) {
        if !self.is_previewing()
            && let Some(version) = self.history.redo(self.version())
        {
            self.go_to(version);
        }
    }

    fn go_to(&mut self, version: Version) {
        self.watched.following = false;
        (self.contents, self.lenslets) = (version.number, version.lenslets);
        self.note_contents(version.number);
        self.show(version.design);
    }

    /// The open design as a step of the history.
    pub(crate) fn version(&self) -> Version {
        Version { design: Arc::clone(self.open_design()), number: self.contents, lenslets: self.lenslets }
    }

    /// Opens a design that was read from `path`.
    pub fn open(&mut self, design: Design, path: PathBuf) {
        self.take_up(design, Some(path));
        self.find_network();
    }

    /// Opens a design that has no file and can be restored.
    pub fn start_from(&mut self, design: Design) {
        self.take_up(design, None);
    }

    /// Replaces the document and clears its history.
    fn take_up(&mut self, design: Design, path: Option<PathBuf>) {
        self.watched.following = false;
        self.note_discarded(self.saved_contents);
        self.open = None;
        self.document += 1;
        self.history.clear();
        self.show(Arc::new(design));
        (self.contents, self.lenslets) = (self.revision, self.revision);
        self.saved_contents = self.contents;
        self.path = path;
    }

    /// Opens a document that is not saved in a file yet.
    pub(crate) fn load_unsaved(&mut self, design: Design, path: Option<PathBuf>) {
        self.take_up(design, path);
        self.saved_contents = 0;
    }

    pub(crate) fn show(&mut self, design: Arc<Design>) {
        self.revision += 1;
        self.design = design;
        // Masks of a run are no edits.
        let before = self.history.before().filter(|_| !self.is_previewing()).cloned();
        self.worker.evaluate(Wanted { revision: self.revision, design: Arc::clone(&self.design), before });
    }

    /// Stops the reading of objects, if there is any.
    pub fn cancel(&self) {
        self.worker.cancel();
    }

    /// Hands a job to the worker.
    pub fn submit(&self, job: Job) {
        self.worker.submit(job);
    }

    /// Saves the open design as it is now.
    pub fn save_to(&self, path: PathBuf) {
        let (design, document, contents) = (Arc::clone(self.open_design()), self.document, self.contents);
        let network = self.network_to_save();
        self.submit(Job::SaveDesign { design, document, contents, network, path });
    }

    /// Whether a design is being saved, or waits to be saved. Once this is false, the outcome can be taken.
    pub fn is_saving(&self) -> bool {
        self.activities.all().iter().any(|activity| activity.kind == ActivityKind::Save && activity.is_open())
    }

    /// Opens a design file in place of the open design, unless the design changes before the file has been read.
    pub fn open_file(&self, path: PathBuf) {
        self.submit(Job::OpenDesign { replaces: self.contents, path });
    }

    /// Reads objects; the design images them once they are known to be valid.
    pub fn open_objects(&self, source: ObjectSource) {
        let design = Design { objects: source, ..Design::clone(self.open_design()) };
        self.submit(Job::OpenObjects { design: Arc::new(design), document: self.document });
    }

    /// Reads a PSF image, resampled to `side` pixels where that is given; it replaces the mask.
    pub fn import_psf(&self, path: PathBuf, side: Option<usize>) {
        self.submit(Job::ImportPsf { path, side, document: self.document });
    }

    /// Makes a diffuser on the PSF grid of the design. It replaces the mask, unless the design changes before.
    pub fn make_diffuser(&self, aperture_px: usize) {
        let (seed, (rows, cols)) = (self.open_design().seed, self.open_design().encoder.grid());
        let origin = DiffuserOrigin::Aperture { aperture_px, seed };
        self.submit(Job::MakeDiffuser { origin, grid_px: rows.min(cols), replaces: self.contents });
    }

    /// Sets the PSF grid of a diffuser, in a job; that of lenslets is changed at once by [`Command::SetGrid`].
    pub fn resize_diffuser(&self, grid_px: usize) {
        let Encoder::Diffuser(diffuser) = self.open_design().encoder else { return };
        let origin = DiffuserOrigin::OtherGrid(diffuser);
        self.submit(Job::MakeDiffuser { origin, grid_px, replaces: self.contents });
    }

    /// Fits lenslets to the PSF of a mask without lenslets. They replace the mask, unless it changes before.
    pub fn fit_lenslets(&self) {
        self.submit(Job::FitLenslets { encoder: self.open_design().encoder.clone(), replaces: self.contents });
    }

    /// Whether a job has not been answered yet.
    pub fn has_open_jobs(&self) -> bool {
        self.worker.has_open_jobs()
    }

    /// Applies the outcomes of jobs: opens designs, installs objects and PSFs, notes saved revisions. Returns the outcomes to report,
    /// oldest first.
    pub fn take_outcomes(&mut self) -> Vec<Result<Outcome, String>> {
        let mut outcomes = self.worker.take_outcomes();
        for outcome in &mut outcomes {
            let refused = match outcome {
                Ok(Outcome::Opened { replaces, path, .. }) if *replaces != self.contents => Some(format!(
                    "{} was not opened: the design has been changed meanwhile. Open it again.",
                    path.display()
                )),
                Ok(Outcome::DiffuserMade { replaces, name, .. }) if *replaces != self.contents => {
                    Some(format!("The {name} is not used: the design has been changed meanwhile. Choose it again."))
                }
                Ok(Outcome::DiffuserMade { diffuser, name, .. }) => {
                    let command = Command::ReplaceEncoder { name: name.clone(), encoder: Encoder::Diffuser(*diffuser) };
                    self.apply(&command).err().map(|error| error.to_string())
                }
                Ok(Outcome::LensletsFitted { replaces, .. }) if *replaces != self.contents => Some(
                    "The fitted lenslets are not used: the design has been changed meanwhile. Fit them again.".into(),
                ),
                Ok(Outcome::LensletsFitted { fitted, .. }) => {
                    let encoder = Encoder::Lenslets(fitted.array.clone());
                    let command = Command::ReplaceEncoder { name: "fitted lenslets".into(), encoder };
                    self.apply(&command).err().map(|error| error.to_string())
                }
                Ok(Outcome::Opened { design, path, .. }) => {
                    self.open(Design::clone(design), path.clone());
                    None
                }
                Ok(Outcome::NetworkOpened { network, document, path }) => {
                    self.add_network(network, *document, Some(path));
                    None
                }
                Ok(Outcome::NetworkExported { network, path }) => {
                    self.trainer.change(|queue| queue.networks_mut().note_file(network, path));
                    None
                }
                Ok(Outcome::Saved { document, contents, network, path }) => {
                    if let Some(Ok((network, weights))) = network {
                        self.trainer.change(|queue| queue.networks_mut().note_file(network, weights));
                    }
                    if *document == self.document {
                        self.saved_contents = *contents;
                        self.path = Some(path.clone());
                        self.note_saved();
                    }
                    None
                }
                Ok(Outcome::ObjectsOpened { source, document, .. }) if *document != self.document => {
                    Some(format!("{source} is not used: another design has been opened meanwhile. Open it again."))
                }
                Ok(Outcome::PsfImported { encoder, document, .. }) if *document != self.document => Some(format!(
                    "{} is not used: another design has been opened meanwhile. Import it again.",
                    encoder.describe()
                )),
                Ok(Outcome::ObjectsOpened { source, .. }) => {
                    let before = self.revision;
                    let refused = self.apply(&Command::SetObjects(source.clone())).err();
                    if refused.is_none() && self.revision == before {
                        // The same design with the objects just read.
                        self.show(Arc::clone(&self.design));
                    }
                    refused.map(|error| error.to_string())
                }
                Ok(Outcome::PsfImported { encoder, .. }) => {
                    let command = Command::ReplaceEncoder { name: encoder.describe(), encoder: encoder.clone() };
                    self.apply(&command).err().map(|error| error.to_string())
                }
                Ok(Outcome::Exported { .. } | Outcome::RecordKept { .. } | Outcome::SnapshotMeasured { .. })
                | Err(_) => None,
            };
            if let Some(reason) = refused {
                *outcome = Err(reason);
            }
        }
        outcomes
    }
}
