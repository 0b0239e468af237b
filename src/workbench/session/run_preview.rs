//! The run beside the open design: its masks are looked at, and accepted if they please; it never touches the design itself.

use std::path::Path;
use std::sync::Arc;

use crate::design::IdealSettings;
use crate::evaluation::scene::EvaluationError;
use crate::forward::Design;
use crate::optics::{Encoder, LensletArray};
use crate::workbench::runs::{DesignRun, RunStatus, RunStore, Start};
use crate::workbench::session::Session;

/// What the workbench knows of the run beside the run itself.
#[derive(Debug, Default)]
pub(crate) struct RunPreview {
    /// Whether masks are shown as they come.
    pub following: bool,
    /// Number of the lenslets that it started with, where that was the open design's own mask.
    lenslets: Option<u64>,
    /// Numbers of the contents from which the run was started, and of those that its masks made of them.
    contents: Vec<u64>,
    /// The last of its masks that was accepted, and the number of the contents that it made; none where an undo has gone
    /// back before it.
    accepted: Option<(LensletArray, u64)>,
}

impl Session {
    /// The run that goes on or went on last.
    pub fn run(&self) -> Option<DesignRun> {
        self.designer.run()
    }

    /// Keeps the states of runs in a folder, so that they survive the program, and takes up the run that is there:
    /// [`Session::run`] tells which.
    ///
    /// # Errors
    /// Where the folder cannot be made, or another program keeps its runs there.
    pub fn persist_runs_in(&self, folder: &Path) -> Result<(), EvaluationError> {
        self.designer.keep_in(RunStore::in_folder(folder)?)
    }

    /// Starts a run from each of `starts`, one after the other, and follows it; every result is scored.
    ///
    /// # Errors
    /// One sentence where another run goes on, or the mask allows none.
    pub fn start_run(&mut self, starts: Vec<Start>, settings: IdealSettings) -> Result<(), String> {
        let is_own = matches!(&starts[..], [only] if only.design.encoder == self.open_design().encoder);
        self.designer.start(starts, settings)?;
        let lenslets = is_own.then_some(self.lenslets);
        self.watched = RunPreview { following: true, lenslets, contents: vec![self.contents], accepted: None };
        Ok(())
    }

    /// Resumes a stopped run, or extends a finished one by `steps` steps, and follows it.
    ///
    /// # Errors
    /// One sentence where there is none that can be resumed.
    pub fn extend_run(&mut self, steps: usize) -> Result<(), String> {
        self.designer.extend(steps)?;
        self.watched.following = true;
        Ok(())
    }

    /// Compares the best result of the run with its start and the nine heuristic layouts, in patches and for the whole sensor.
    ///
    /// # Errors
    /// One sentence where there is no result yet, or a run goes on.
    pub fn compare_result(&self) -> Result<(), String> {
        self.designer.compare()
    }

    /// Lets the run wait, or go on.
    pub fn pause_run(&self, pause: bool) {
        self.designer.pause(pause);
    }

    /// Ends the run; its mask stays, and it can go on later.
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

    /// Takes up what has become of the run, shows its mask where it is followed, and returns it. To be called for every
    /// frame of the window.
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

    /// Shows a mask of the run, before the scene that it was designed for, in place of the open design, which stays as it is.
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

    /// Whether the lenslets that are shown are those of the open design, at most moved: a mask of a run from something else has
    /// others, and one that has lost some of them, too.
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

    /// Whether the mask that is looked at can take the place of the open design: that has not changed since the run was
    /// started, but by masks of the run.
    pub fn can_accept(&self) -> bool {
        let is_start = || self.designer.run().is_some_and(|run| *run.start == **self.open_design());
        self.is_previewing() && (self.watched.contents.contains(&self.contents) || is_start())
    }

    /// Puts the mask that is looked at in the place of the open design, as one step of its past; tells whether that was
    /// [possible](Session::can_accept).
    pub fn accept(&mut self) -> bool {
        if !self.can_accept() {
            return false;
        }
        self.watched.following = false;
        // Every mask that is accepted is a step of its own.
        self.history.note(self.version(), "Optimize the mask".into(), None);
        if !self.shows_own_lenslets() {
            self.lenslets = self.revision;
        }
        self.open = None;
        self.contents = self.revision;
        self.note_accepted();
        true
    }

    /// Notes that a mask of the run is the open design now.
    fn note_accepted(&mut self) {
        self.watched.contents.push(self.contents);
        self.watched.accepted = self.design.encoder.lenslets().map(|array| (array.clone(), self.contents));
    }

    /// Notes that the open design has gone back or forth to the contents of this number.
    pub(crate) fn note_contents(&mut self, number: u64) {
        if self.watched.accepted.as_ref().is_some_and(|(_, accepted)| number < *accepted) {
            self.watched.accepted = None;
        }
    }

    /// Notes that a mask which was accepted since the contents of this number were saved is gone with its document.
    pub(crate) fn note_discarded(&mut self, saved: u64) {
        self.watched.accepted.take_if(|(_, accepted)| *accepted > saved);
    }

    /// Notes that the open design is in a file, and a mask of the run with it, if it holds one.
    pub(crate) fn note_saved(&mut self) {
        if let Some((mask, _)) = &self.watched.accepted {
            self.designer.note_saved(mask);
        }
    }

    /// Opens the mask that is looked at as a design of its own, which is in no file yet.
    pub fn open_as_new(&mut self) {
        if self.is_previewing() {
            self.load_unsaved(Design::clone(&self.design), None);
            self.note_accepted();
        }
    }

    /// Whether the run has come to rest and nobody has accepted its best result, or its last mask where it has no other.
    pub fn has_unsaved_result(&self) -> bool {
        let Some(run) = self.designer.run().filter(|run| !run.is_active()) else { return false };
        let (saved, accepted) = (self.designer.saved(), self.watched.accepted.as_ref().map(|(mask, _)| mask));
        let is_taken = |mask: &LensletArray| accepted == Some(mask) || saved.as_ref() == Some(mask);
        let best = run.ranked.first().and_then(|best| best.design.encoder.lenslets());
        let newest_will_do = run.ranked.len() <= 1 && is_taken(&run.array);
        (run.step > 0 || best.is_some()) && !newest_will_do && !best.is_some_and(is_taken)
    }

    /// Whether the end of the run would lose something: a result that nobody has accepted, results beside that, or a comparison.
    pub fn would_lose_run_data(&self) -> bool {
        let Some(run) = self.designer.run().filter(|run| !run.is_active()) else { return false };
        run.ranked.len() > 1 || run.comparison.is_some() || self.has_unsaved_result()
    }

    /// Whether the next program can take up the run as it is: it has a folder to be kept in, which can be written to.
    pub fn run_is_persisted(&self) -> bool {
        self.designer.keeps()
    }

    /// Why the run cannot be kept, where it was to be.
    pub fn persistence_failure(&self) -> Option<String> {
        self.designer.persistence_failure()
    }
}
