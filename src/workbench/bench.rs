//! The open design and its worker.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::command::{Command, CommandError};
use super::design::Design;
use super::estimation::EstimateRequest;
use super::estimator::{EstimateOrder, Estimates};
use super::jobs::{Job, Outcome};
use super::worker::{Live, Worker};
use crate::objects::ObjectSource;

/// The open design, its revision, its file, and the worker that computes it.
///
/// Every change goes through [`Workbench::apply`]; every change makes a new revision and asks the worker for its
/// numbers. Revisions never repeat, so equal revisions mean equal designs.
pub struct Workbench {
    design: Arc<Design>,
    revision: u64,
    saved_revision: u64,
    path: Option<PathBuf>,
    worker: Worker,
}

impl Workbench {
    /// Opens `design`, which counts as saved: it can be had again. `wake` is called from the worker's thread whenever
    /// there is something new to show.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn new(
        design: Design,
        path: Option<PathBuf>,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let worker = Worker::start(wake)?;
        let design = Arc::new(design);
        worker.evaluate(1, Arc::clone(&design));
        Ok(Self { design, revision: 1, saved_revision: 1, path, worker })
    }

    /// The open design.
    pub fn design(&self) -> &Arc<Design> {
        &self.design
    }

    /// Its revision.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Whether the design differs from its file (or, without one, from how it was opened).
    pub fn is_dirty(&self) -> bool {
        self.revision != self.saved_revision
    }

    /// The design's file.
    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// The latest results; compare their revisions with [`Workbench::revision`].
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

    /// Live estimate and ordered estimates; compare their revisions with [`Workbench::revision`].
    pub fn estimates(&self) -> Estimates {
        self.worker.estimator().estimates()
    }

    /// Whether live estimates are computed.
    pub fn is_live(&self) -> bool {
        self.worker.estimator().is_live()
    }

    /// Switches live estimates on or off.
    pub fn set_live(&self, live: bool) {
        self.worker.estimator().set_live(live);
    }

    /// Orders an estimate of the design as it is now.
    ///
    /// # Errors
    /// One sentence where another one is computed.
    pub fn order_estimate(&self, request: EstimateRequest) -> Result<(), String> {
        let (design, revision) = (Arc::clone(&self.design), self.revision);
        self.worker.estimator().order(EstimateOrder { design, revision, request })
    }

    /// Stops the ordered estimate.
    pub fn cancel_estimate(&self) {
        self.worker.estimator().cancel();
    }

    /// Changes the design.
    ///
    /// # Errors
    /// [`CommandError`] where the command cannot be done; the design is then as it was.
    pub fn apply(&mut self, command: &Command) -> Result<(), CommandError> {
        let changed = command.applied_to(&self.design)?;
        if changed != *self.design {
            self.show(changed);
        }
        Ok(())
    }

    /// Takes up a design that was read from `path`.
    pub fn open(&mut self, design: Design, path: PathBuf) {
        self.show(design);
        self.saved_revision = self.revision;
        self.path = Some(path);
    }

    /// Starts anew from the embedded default design.
    pub fn open_default(&mut self) {
        self.show(Design::default());
        self.saved_revision = self.revision;
        self.path = None;
    }

    fn show(&mut self, design: Design) {
        self.revision += 1;
        self.design = Arc::new(design);
        self.worker.evaluate(self.revision, Arc::clone(&self.design));
    }

    /// Stops reading objects, if that is going on.
    pub fn cancel(&self) {
        self.worker.cancel();
    }

    /// Hands a job to the worker.
    pub fn submit(&self, job: Job) {
        self.worker.submit(job);
    }

    /// Saves the design as it is now.
    pub fn save_to(&self, path: PathBuf) {
        self.submit(Job::SaveDesign { design: Arc::clone(&self.design), revision: self.revision, path });
    }

    /// Reads objects; the design images them once they are known to be good.
    pub fn open_objects(&self, source: ObjectSource) {
        let design = Design { objects: source, ..Design::clone(&self.design) };
        self.submit(Job::OpenObjects { design: Arc::new(design) });
    }

    /// Whether a job has not been answered yet.
    pub fn has_open_jobs(&self) -> bool {
        self.worker.has_open_jobs()
    }

    /// Takes up what jobs have brought: designs are opened, objects and PSFs put in place, saved revisions noted.
    /// Returns what to tell the person, oldest first.
    pub fn take_outcomes(&mut self) -> Vec<Result<Outcome, String>> {
        let mut outcomes = self.worker.take_outcomes();
        for outcome in &mut outcomes {
            let refused = match outcome {
                Ok(Outcome::Opened { design, path }) => {
                    self.open(Design::clone(design), path.clone());
                    None
                }
                Ok(Outcome::Saved { revision, path }) => {
                    self.saved_revision = *revision;
                    self.path = Some(path.clone());
                    None
                }
                Ok(Outcome::ObjectsOpened { source, .. }) => self.apply(&Command::SetObjects(source.clone())).err(),
                Ok(Outcome::PsfImported { encoder }) => {
                    let command = Command::ReplaceEncoder { name: encoder.describe(), encoder: encoder.clone() };
                    self.apply(&command).err()
                }
                Ok(Outcome::Exported { .. }) | Err(_) => None,
            };
            if let Some(error) = refused {
                *outcome = Err(error.to_string());
            }
        }
        outcomes.extend(self.worker.estimator().take_failures().into_iter().map(Err));
        outcomes
    }
}
