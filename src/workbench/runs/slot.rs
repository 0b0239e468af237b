//! The present or last run of a session, and the work on it: at most one piece at a time.

use std::sync::Arc;

use crate::design::IdealSettings;
use crate::evaluation::EvaluationError;
use crate::optics::LensletArray;
use crate::progress::CancelToken;
use crate::studies::StudyError;
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::Queue;
use crate::workbench::runs::design_run::{DesignRun, RunStatus, Start};
use crate::workbench::runs::record::IdealRecord;
use crate::workbench::runs::store::{RunQueue, RunStore};

/// Message where no run can be started.
const BUSY: &str = "a run is active; stop it first";

/// Work on a run.
pub(super) enum RunWork {
    /// Runs the current start and those after it, and scores their results.
    Optimize(Box<IdealSettings>),
    /// Compares the best result with others. The run has its earlier status afterwards.
    Compare { record: Arc<IdealRecord>, before: RunStatus },
}

/// One task of the thread.
pub(super) enum RunTask {
    Work {
        work: RunWork,
        /// Ends the optimizer; what there is then is scored.
        stop: CancelToken,
    },
    /// Writes the queue of starts, because its file is out of date.
    WriteQueue,
}

/// Answer to a task.
pub(super) enum RunAnswer {
    Optimized(Result<(), EvaluationError>),
    /// The comparison with its summary.
    Compared(Result<String, StudyError>),
    Written,
}

/// Tokens of the running work.
struct Running {
    stop: CancelToken,
    cancel: CancelToken,
}

/// The run with its states, its files and the work on it.
pub(super) struct RunSlot {
    activities: Activities,
    /// The run's place among them while it is active.
    entry: Option<ActivityHandle>,
    pub run: Option<DesignRun>,
    /// All starts of the queue.
    pub starts: Vec<Start>,
    /// Newest state of each start.
    pub states: Vec<Option<Vec<u8>>>,
    /// The last mask of the run that was saved in a design file.
    pub saved: Option<LensletArray>,
    /// Store of states between sessions.
    pub folder: Option<RunStore>,
    /// Why the last state or queue could not be written.
    pub persistence_failure: Option<String>,
    waiting: Option<RunWork>,
    /// Whether the waiting work was stopped before it began.
    is_stopped: bool,
    running: Option<Running>,
    is_paused: bool,
    /// Whether the queue differs from that in its file.
    is_out_of_date: bool,
}

impl RunSlot {
    /// A slot without a run.
    pub fn new(activities: Activities) -> Self {
        Self {
            activities,
            entry: None,
            run: None,
            starts: Vec::new(),
            states: Vec::new(),
            saved: None,
            folder: None,
            persistence_failure: None,
            waiting: None,
            is_stopped: false,
            running: None,
            is_paused: false,
            is_out_of_date: false,
        }
    }

    /// Checks that no work is running.
    ///
    /// # Errors
    /// One sentence where the run is active.
    pub fn check_idle(&self) -> Result<(), String> {
        if self.run.as_ref().is_some_and(DesignRun::is_active) { Err(BUSY.into()) } else { Ok(()) }
    }

    /// Begins work on a run, with a name in the list of activities.
    ///
    /// # Errors
    /// One sentence where a run is active.
    pub fn begin(&mut self, run: DesignRun, name: String, work: RunWork) -> Result<(), String> {
        self.check_idle()?;
        let entry = self.activities.add(ActivityKind::Run, name);
        entry.begin();
        (self.entry, self.run, self.waiting) = (Some(entry), Some(run), Some(work));
        (self.is_paused, self.is_stopped) = (false, false);
        Ok(())
    }

    /// Pauses or resumes the run.
    pub fn pause(&mut self, pause: bool) {
        self.is_paused = pause;
        if let Some(run) = self.run.as_mut().filter(|run| run.is_active()) {
            run.status = if pause { RunStatus::Paused } else { RunStatus::Running };
        }
        if let Some(entry) = &self.entry {
            entry.pause(pause);
        }
    }

    /// Whether work waits until it is resumed.
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Stops the optimizer at its next step, or a score or comparison that is under way.
    pub fn stop(&mut self) {
        self.is_paused = false;
        let is_scoring = self.run.as_ref().is_some_and(|run| run.is_scoring);
        match &self.running {
            Some(running) if is_scoring => running.cancel.cancel(),
            Some(running) => running.stop.cancel(),
            None => self.is_stopped = true,
        }
    }

    /// The activity of the run.
    pub fn entry(&self) -> Option<&ActivityHandle> {
        self.entry.as_ref()
    }

    /// Notes that a mask of the run was saved in a design file.
    pub fn note_saved(&mut self, mask: LensletArray) {
        self.saved = Some(mask);
        self.is_out_of_date = true;
    }

    /// Whether the queue has to be written.
    pub fn is_out_of_date(&self) -> bool {
        self.is_out_of_date && self.folder.is_some() && self.run.is_some()
    }

    /// The queue with all results so far, to be written. It counts as written from then on.
    pub fn take_queue(&mut self) -> Option<(RunStore, RunQueue)> {
        let (folder, run) = (self.folder.clone()?, self.run.as_ref()?);
        self.is_out_of_date = false;
        let queue = RunQueue {
            starts: self.starts.clone(),
            settings: run.settings.clone(),
            at: run.start_number.0 - 1,
            ranked: run.ranked.clone(),
            failures: run.failures.clone(),
            saved: self.saved.clone(),
            budget_seconds: None,
        };
        Some((folder, queue))
    }

    /// Sets the status at the end of the work; no `outcome` where it was stopped.
    fn end_run(&mut self, status: RunStatus, outcome: Option<Result<String, String>>) {
        if let Some(run) = &mut self.run {
            run.status = status;
            run.position_gradients = Arc::default();
            run.doing = None;
            run.is_scoring = false;
            run.left = None;
        }
        if let (Some(entry), Some(outcome)) = (self.entry.take(), outcome) {
            entry.end(outcome);
        }
    }

    fn end_optimizer(&mut self, result: Result<Result<(), EvaluationError>, String>) {
        let (status, outcome) = match result {
            Ok(Ok(())) => (RunStatus::Finished, self.result_summary().map(Ok)),
            Ok(Err(error)) if error.is_cancelled() => (RunStatus::Stopped, None),
            Ok(Err(error)) => (RunStatus::Failed(error.to_string()), Some(Err(error.to_string()))),
            Err(panic) => (RunStatus::Failed(panic.clone()), Some(Err(panic))),
        };
        self.end_run(status, outcome);
    }

    fn end_comparison(&mut self, before: RunStatus, result: Result<Result<String, StudyError>, String>) {
        let outcome = match result {
            Ok(Ok(summary)) => Some(Ok(summary)),
            Ok(Err(StudyError::Cancelled)) => None,
            Ok(Err(error)) => Some(Err(error.to_string())),
            Err(panic) => Some(Err(panic)),
        };
        if let (Some(run), Some(Err(message))) = (&mut self.run, &outcome) {
            run.comparison_failure = Some(message.clone());
        }
        self.end_run(before, outcome);
    }

    /// Summary of the best result so far.
    fn result_summary(&self) -> Option<String> {
        let best = self.run.as_ref()?.ranked.first()?;
        Some(format!("{}: {}", best.design.encoder.describe(), best.estimate.summary()))
    }
}

impl Queue for RunSlot {
    type Task = RunTask;
    type Answer = RunAnswer;

    fn next(&mut self, cancel: &CancelToken) -> Option<RunTask> {
        if self.is_out_of_date() {
            return Some(RunTask::WriteQueue);
        }
        let work = self.waiting.take()?;
        let stop = cancel.child();
        self.running = Some(Running { stop: stop.clone(), cancel: cancel.clone() });
        if std::mem::take(&mut self.is_stopped) {
            self.stop();
        }
        Some(RunTask::Work { work, stop })
    }

    fn end(&mut self, task: RunTask, answer: Result<RunAnswer, String>) {
        let RunTask::Work { work, .. } = task else { return };
        self.running = None;
        match (work, answer) {
            (RunWork::Optimize(_), Ok(RunAnswer::Optimized(result))) => self.end_optimizer(Ok(result)),
            (RunWork::Optimize(_), Err(panic)) => self.end_optimizer(Err(panic)),
            (RunWork::Compare { before, .. }, Ok(RunAnswer::Compared(result))) => {
                self.end_comparison(before, Ok(result));
            }
            (RunWork::Compare { before, .. }, Err(panic)) => self.end_comparison(before, Err(panic)),
            _ => {}
        }
    }

    fn close(&mut self) {
        self.waiting = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{Objective, Preset};
    use crate::forward::Design;
    use crate::information::InformationError;
    use crate::workbench::background::activity::ActivityState;

    fn slot() -> (RunSlot, Activities) {
        let activities = Activities::default();
        (RunSlot::new(activities.clone()), activities)
    }

    fn optimize(slot: &mut RunSlot) -> Result<(), String> {
        let settings = IdealSettings::new(Preset::Default, Objective::Density, 1);
        let run = DesignRun::new(&Arc::new(Design::default()), settings.clone(), 1);
        slot.begin(run, "Optimize".into(), RunWork::Optimize(Box::new(settings)))
    }

    fn stop_of(task: &RunTask) -> &CancelToken {
        let RunTask::Work { stop, .. } = task else { panic!("no work") };
        stop
    }

    #[test]
    fn stop_ends_the_optimizer_and_then_the_score() {
        let (mut slot, activities) = slot();
        optimize(&mut slot).unwrap();
        assert_eq!(optimize(&mut slot).unwrap_err(), BUSY);
        let cancel = CancelToken::new();
        let task = slot.next(&cancel).unwrap();
        slot.stop();
        assert!(stop_of(&task).is_cancelled() && !cancel.is_cancelled());
        slot.run.as_mut().unwrap().is_scoring = true;
        slot.stop();
        assert!(cancel.is_cancelled());
        slot.end(task, Ok(RunAnswer::Optimized(Err(InformationError::Cancelled.into()))));
        let run = slot.run.as_ref().unwrap();
        assert!(run.status == RunStatus::Stopped && !run.is_scoring && slot.entry().is_none());
        assert_eq!(activities.all()[0].state, ActivityState::Stopped);
        assert!(slot.next(&CancelToken::new()).is_none());
    }

    #[test]
    fn work_that_is_stopped_before_it_begins_ends_at_once() {
        let (mut slot, _) = slot();
        slot.stop();
        optimize(&mut slot).unwrap();
        let task = slot.next(&CancelToken::new()).unwrap();
        assert!(!stop_of(&task).is_cancelled(), "the stop was of an earlier run");
        slot.end(task, Ok(RunAnswer::Optimized(Ok(()))));
        optimize(&mut slot).unwrap();
        slot.pause(true);
        slot.stop();
        assert!(!slot.is_paused());
        assert!(stop_of(&slot.next(&CancelToken::new()).unwrap()).is_cancelled());
    }

    #[test]
    fn comparison_restores_the_status_and_its_failure_is_kept() {
        for (result, failure) in [
            (Ok(RunAnswer::Compared(Ok("+0.1 bits per pixel".into()))), None),
            (Ok(RunAnswer::Compared(Err(StudyError::Cancelled))), None),
            (Err("no light".to_owned()), Some("no light")),
        ] {
            let (mut slot, _) = slot();
            optimize(&mut slot).unwrap();
            let task = slot.next(&CancelToken::new()).unwrap();
            slot.end(task, Ok(RunAnswer::Optimized(Ok(()))));
            let run = DesignRun { status: RunStatus::Running, is_scoring: true, ..slot.run.clone().unwrap() };
            let text = include_str!("../../../tests/data/golden/run-v1-density.json");
            let record: Arc<IdealRecord> = Arc::new(serde_json::from_str(text).unwrap());
            slot.begin(run, "Compare".into(), RunWork::Compare { record, before: RunStatus::Finished }).unwrap();
            let cancel = CancelToken::new();
            let task = slot.next(&cancel).unwrap();
            slot.stop();
            assert!(cancel.is_cancelled());
            slot.end(task, result);
            let run = slot.run.as_ref().unwrap();
            assert_eq!((&run.status, run.comparison_failure.as_deref()), (&RunStatus::Finished, failure));
        }
    }
}
