//! The run beside the open design. Its masks can be previewed and accepted; the run itself never changes the design.

use std::path::Path;
use std::sync::Arc;

use crate::design::IdealSettings;
use crate::evaluation::scene::EvaluationError;
use crate::forward::Design;
use crate::optics::{Encoder, LensletArray};
use crate::workbench::runs::{DesignRun, RunStatus, RunStore, Start};
use crate::workbench::session::Session;

/// State of the workbench about the run.
#[derive(Debug, Default)]
pub(crate) struct RunPreview {
    /// Whether masks are shown as they come.
    pub following: bool,
    /// Number of the lenslets at the start of the run, where its start was the open design's own mask.
    lenslets: Option<u64>,
    /// Numbers of the contents that the run started from, and of the contents made by its masks.
    contents: Vec<u64>,
    /// The last accepted mask of the run, and the number of the contents that it made; none where an undo went back before it.
    accepted: Option<(LensletArray, u64)>,
}

impl Session {
    /// The running or the last run.
    pub fn run(&self) -> Option<DesignRun> {
        self.designer.run()
    }

    /// Saves the states of runs in a folder, so that they survive the program, and loads the run in that folder: see [`Session::run`].
    ///
    /// # Errors
    /// Where the folder cannot be created, or another program keeps its runs there.
    pub fn persist_runs_in(&self, folder: &Path) -> Result<(), EvaluationError> {
        self.designer.keep_in(RunStore::in_folder(folder)?)
    }

    /// Starts a run from each of `starts`, one after the other, and shows its masks; every result is scored.
    ///
    /// # Errors
    /// One sentence where another run is active, or the mask allows none.
    pub fn start_run(&mut self, starts: Vec<Start>, settings: IdealSettings) -> Result<(), String> {
        let is_own = matches!(&starts[..], [only] if only.design.encoder == self.open_design().encoder);
        self.designer.start(starts, settings)?;
        let lenslets = is_own.then_some(self.lenslets);
        self.watched = RunPreview { following: true, lenslets, contents: vec![self.contents], accepted: None };
        Ok(())
    }

    /// Resumes a stopped run, or extends a finished one by `steps` steps, and shows its masks.
    ///
    /// # Errors
    /// One sentence where there is no run that can be resumed.
    pub fn extend_run(&mut self, steps: usize) -> Result<(), String> {
        self.designer.extend(steps)?;
        self.watched.following = true;
        Ok(())
    }

    /// Compares the best result of the run with its start and the nine heuristic layouts, in patches and for the whole sensor.
    ///
    /// # Errors
    /// One sentence where there is no result yet, or a run is active.
    pub fn compare_result(&self) -> Result<(), String> {
        self.designer.compare()
    }

    /// Pauses or resumes the run.
    pub fn pause_run(&self, pause: bool) {
        self.designer.pause(pause);
    }

    /// Stops the run. Its mask stays, and the run can be resumed later.
    pub fn stop_run(&self) {
        self.designer.stop();
    }

    /// Whether masks of the run are shown as they come.
    pub fn is_following(&self) -> bool {
        self.watched.following
    }

    /// Shows the masks of the run as they come, or leaves what is shown as it is.
    pub fn follow_run(&mut self, follow: bool) {
        self.watched.following = follow;
    }

    /// Synchronizes with the run, previews its mask where masks are shown as they come, and returns the run. To be called for every frame
    /// of the window.
    pub fn sync_run(&mut self) -> Option<DesignRun> {
        let run = self.designer.run();
        self.worker.estimator().hold(run.as_ref().is_some_and(|run| run.status == RunStatus::Running));
        if self.watched.following
            && let Some(run) = &run
        {
            self.preview(&run.array, &run.start);
            self.watched.following = run.is_active();
        }
        run
    }

    /// Previews a mask of the run, with the scene that it was designed for. The open design stays as it is.
    pub fn preview(&mut self, array: &LensletArray, start: &Design) {
        let shown = Design { encoder: Encoder::Lenslets(array.clone()), ..start.clone() };
        if shown == **self.open_design() {
            if let Some(open) = self.open.take() {
                self.show(open);
            }
        } else if shown != *self.design {
            self.open = Some(Arc::clone(self.open_design()));
            self.show(Arc::new(shown));
        }
    }

    /// Whether a mask of the run is shown in place of the open design.
    pub fn is_previewing(&self) -> bool {
        self.open.is_some()
    }

    /// Whether the lenslets shown are those of the open design, at most moved. A run from another start has other lenslets, and so has
    /// one that lost some of them.
    pub fn shows_own_lenslets(&self) -> bool {
        let count = |design: &Design| design.encoder.lenslets().map(|array| array.lenslets.len());
        let is_own = self.watched.lenslets == Some(self.lenslets);
        !self.is_previewing() || (is_own && count(&self.design) == count(self.open_design()))
    }

    /// Shows the open design again.
    pub fn end_preview(&mut self) {
        self.watched.following = false;
        if let Some(open) = self.open.take() {
            self.show(open);
        }
    }

    /// Whether the previewed mask can replace the open design. The design must be unchanged since the start of the run, apart from masks
    /// of the run.
    pub fn can_accept(&self) -> bool {
        let is_start = || self.designer.run().is_some_and(|run| *run.start == **self.open_design());
        self.is_previewing() && (self.watched.contents.contains(&self.contents) || is_start())
    }

    /// Replaces the open design by the previewed mask, as one step of its history. Returns whether that was
    /// [possible](Session::can_accept).
    pub fn accept(&mut self) -> bool {
        if !self.can_accept() {
            return false;
        }
        self.watched.following = false;
        // Every accepted mask is a step of its own.
        self.history.note(self.version(), "Optimize the mask".into(), None);
        if !self.shows_own_lenslets() {
            self.lenslets = self.revision;
        }
        self.open = None;
        self.contents = self.revision;
        self.note_accepted();
        true
    }

    /// Notes that a mask of the run is now the open design.
    fn note_accepted(&mut self) {
        self.watched.contents.push(self.contents);
        self.watched.accepted = self.design.encoder.lenslets().map(|array| (array.clone(), self.contents));
    }

    /// Notes that an undo or redo led to the contents of this number.
    pub(crate) fn note_contents(&mut self, number: u64) {
        if self.watched.accepted.as_ref().is_some_and(|(_, accepted)| number < *accepted) {
            self.watched.accepted = None;
        }
    }

    /// Notes that a mask accepted after the contents of this number were saved is lost with its document.
    pub(crate) fn note_discarded(&mut self, saved: u64) {
        self.watched.accepted.take_if(|(_, accepted)| *accepted > saved);
    }

    /// Notes that the open design is saved, and with it the mask of the run that it holds, if any.
    pub(crate) fn note_saved(&mut self) {
        if let Some((mask, _)) = &self.watched.accepted {
            self.designer.note_saved(mask);
        }
    }

    /// Opens the previewed mask as a design of its own, without a file.
    pub fn open_as_new(&mut self) {
        if self.is_previewing() {
            self.load_unsaved(Design::clone(&self.design), None);
            self.note_accepted();
        }
    }

    /// Whether the run has stopped and its best result is not accepted, or its last mask where it has no result.
    pub fn has_unsaved_result(&self) -> bool {
        let Some(run) = self.designer.run().filter(|run| !run.is_active()) else { return false };
        let (saved, accepted) = (self.designer.saved(), self.watched.accepted.as_ref().map(|(mask, _)| mask));
        let is_taken = |mask: &LensletArray| accepted == Some(mask) || saved.as_ref() == Some(mask);
        let best = run.ranked.first().and_then(|best| best.design.encoder.lenslets());
        let newest_will_do = run.ranked.len() <= 1 && is_taken(&run.array);
        (run.step > 0 || best.is_some()) && !newest_will_do && !best.is_some_and(is_taken)
    }

    /// Whether the end of the run would lose data: an unaccepted result, further results, or a comparison.
    pub fn would_lose_run_data(&self) -> bool {
        let Some(run) = self.designer.run().filter(|run| !run.is_active()) else { return false };
        run.ranked.len() > 1 || run.comparison.is_some() || self.has_unsaved_result()
    }

    /// Whether the next session can load the run as it is. It needs a folder that can be written to.
    pub fn run_is_persisted(&self) -> bool {
        self.designer.keeps()
    }

    /// Reason why the run could not be saved.
    pub fn persistence_failure(&self) -> Option<String> {
        self.designer.persistence_failure()
    }
}
