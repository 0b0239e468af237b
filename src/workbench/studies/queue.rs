//! Queue of the study: one folder at a time, opened, computed, paused and stopped.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::progress::CancelToken;
use crate::studies::plans::{CellState, Figure, Plan, StudyFolder, figure_of};
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::Queue;

/// Message where another study cannot be opened.
const BUSY: &str = "a study is running; stop it first";

/// State of the study.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StudyStatus {
    /// Its files are read.
    Opening,
    /// It is open, and nothing is computed.
    Idle,
    /// Its cells are computed.
    Running,
    /// It is paused.
    Paused,
    /// It cannot be opened or written, for this reason.
    Failed(String),
}

/// The open study.
#[derive(Clone, Debug)]
pub struct OpenStudy {
    /// Its folder, with plan and cells.
    pub folder: Arc<StudyFolder>,
    /// State of each cell, in the order of the plan.
    pub states: Arc<Vec<CellState>>,
    /// Its figure.
    pub figure: Arc<Figure>,
    /// Sentence on the cells of the plan that are left out, where there are any.
    pub left_out: Option<String>,
}

impl OpenStudy {
    /// A study whose files were read.
    pub(crate) fn new(folder: StudyFolder, states: Vec<CellState>) -> Self {
        let figure = Arc::new(figure_of(folder.plan(), folder.cells(), &states));
        let left_out = folder.plan().left_out().ok().flatten();
        Self { folder: Arc::new(folder), states: Arc::new(states), figure, left_out }
    }

    fn put(&mut self, index: usize, state: CellState) {
        Arc::make_mut(&mut self.states)[index] = state;
        self.figure = Arc::new(figure_of(self.folder.plan(), self.folder.cells(), &self.states));
    }

    /// Number of cells with an estimate.
    pub fn done(&self) -> usize {
        self.states.iter().filter(|state| state.done().is_some()).count()
    }

    /// Number of cells that failed or whose file cannot be used.
    pub fn failed(&self) -> usize {
        self.states.iter().filter(|state| state.failure().is_some()).count()
    }
}

/// The study as the window shows it.
#[derive(Clone, Debug, Default)]
pub struct StudyView {
    /// The open study.
    pub open: Option<OpenStudy>,
    /// State of the study; none before the first one.
    pub status: Option<StudyStatus>,
    /// The cell that is computed.
    pub running: Option<usize>,
    /// The current step of that cell, for people.
    pub step: String,
    /// Remaining time of all cells, where it is known.
    pub left: Option<Duration>,
}

impl StudyView {
    /// Whether cells are computed or the study is paused.
    pub fn is_active(&self) -> bool {
        matches!(self.status, Some(StudyStatus::Running | StudyStatus::Paused))
    }
}

/// Work of the thread.
#[derive(Clone, Debug)]
pub(crate) enum StudyTask {
    /// Begins a plan in a folder, or opens the study that lies there.
    Open { plan: Option<Box<Plan>>, path: PathBuf },
    /// Computes the cells without a result.
    Run(Arc<StudyFolder>),
}

/// End of a task.
pub(crate) enum StudyEnd {
    /// A study was opened.
    Opened(OpenStudy),
    /// All cells were computed; some may have failed.
    Ran,
    /// A person stopped it.
    Stopped,
    /// It failed, for this reason.
    Failed(String),
}

/// The waiting and the running task, and what the window shows.
pub(crate) struct StudyQueue {
    activities: Activities,
    /// The place of the running study among them.
    entry: Option<ActivityHandle>,
    waiting: Option<StudyTask>,
    running: Option<CancelToken>,
    view: StudyView,
}

impl StudyQueue {
    /// An empty queue.
    pub fn new(activities: Activities) -> Self {
        Self { activities, entry: None, waiting: None, running: None, view: StudyView::default() }
    }

    /// Opens a study, or begins a plan.
    ///
    /// # Errors
    /// One sentence where a study is running.
    pub fn open(&mut self, plan: Option<Box<Plan>>, path: PathBuf) -> Result<(), String> {
        if self.view.is_active() {
            return Err(BUSY.into());
        }
        self.view.status = Some(StudyStatus::Opening);
        self.waiting = Some(StudyTask::Open { plan, path });
        Ok(())
    }

    /// Computes the cells without a result. Without an open study nothing happens.
    pub fn start(&mut self) {
        let Some(open) = self.view.open.as_ref().filter(|_| self.view.status == Some(StudyStatus::Idle)) else {
            return;
        };
        let entry = self.activities.add(ActivityKind::Study, format!("Study {}", open.folder.plan().name));
        entry.begin();
        self.waiting = Some(StudyTask::Run(Arc::clone(&open.folder)));
        self.entry = Some(entry);
        self.view.status = Some(StudyStatus::Running);
    }

    /// Pauses or resumes the study, from its next step on.
    pub fn pause(&mut self, pause: bool) {
        if !self.view.is_active() {
            return;
        }
        self.view.status = Some(if pause { StudyStatus::Paused } else { StudyStatus::Running });
        if let Some(entry) = &self.entry {
            entry.pause(pause);
        }
    }

    /// Whether the study waits until it is resumed.
    pub fn is_paused(&self) -> bool {
        self.view.status == Some(StudyStatus::Paused)
    }

    /// Stops the study. Finished cells and the state of the running one stay in the folder.
    pub fn stop(&mut self) {
        if !self.view.is_active() {
            return;
        }
        if let Some(cancel) = &self.running {
            cancel.cancel();
        }
        self.waiting = None;
        self.finish(StudyEnd::Stopped);
    }

    /// Receives a step of a cell.
    pub fn note_step(&mut self, index: usize, step: &str, left: Duration) {
        self.view.running = Some(index);
        step.clone_into(&mut self.view.step);
        self.view.left = Some(left);
        if let (Some(entry), Some(open)) = (&self.entry, &self.view.open) {
            let share = open.done() as f64 / open.states.len().max(1) as f64;
            let name = open.folder.plan().name_of(&open.folder.cells()[index]);
            entry.report(&format!("{name}: {step}"), Some(share), Some(left));
        }
    }

    /// Receives the result of a cell.
    pub fn note_cell(&mut self, index: usize, state: CellState) {
        if let Some(open) = &mut self.view.open {
            open.put(index, state);
        }
    }

    /// What the window shows.
    pub fn view(&self) -> &StudyView {
        &self.view
    }

    fn finish(&mut self, end: StudyEnd) {
        let view = &mut self.view;
        (view.running, view.left) = (None, None);
        view.step.clear();
        let entry = self.entry.take();
        match end {
            StudyEnd::Opened(open) => {
                (view.open, view.status) = (Some(open), Some(StudyStatus::Idle));
            }
            StudyEnd::Failed(sentence) => {
                view.status = Some(StudyStatus::Failed(sentence.clone()));
                if let Some(entry) = entry {
                    entry.end(Err(sentence));
                }
            }
            // The dropped entry counts as stopped.
            StudyEnd::Stopped => view.status = Some(StudyStatus::Idle),
            StudyEnd::Ran => {
                view.status = Some(StudyStatus::Idle);
                let (done, failed) = view.open.as_ref().map_or((0, 0), |open| (open.done(), open.failed()));
                if let Some(entry) = entry {
                    let outcome = format!("{done} cells done, {failed} failed");
                    entry.end(if failed == 0 { Ok(outcome) } else { Err(outcome) });
                }
            }
        }
    }
}

impl Queue for StudyQueue {
    type Task = StudyTask;
    type Answer = StudyEnd;

    fn next(&mut self, cancel: &CancelToken) -> Option<StudyTask> {
        let task = self.waiting.take()?;
        self.running = Some(cancel.clone());
        Some(task)
    }

    fn end(&mut self, task: StudyTask, answer: Result<StudyEnd, String>) {
        self.running = None;
        // While a task waits, the answer is that of a run that was stopped before.
        let is_of_view = match task {
            StudyTask::Open { .. } => true,
            StudyTask::Run(_) => self.view.is_active(),
        };
        if self.waiting.is_none() && is_of_view {
            self.finish(answer.unwrap_or_else(StudyEnd::Failed));
        }
    }

    fn close(&mut self) {
        self.waiting = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studies::plans::{Axes, Axis, Facet, PlotSettings, StudyMask};

    fn opened(place: &std::path::Path) -> OpenStudy {
        let axes = Axes::new(vec![StudyMask::heuristic(1), StudyMask::heuristic(2)], vec!["beads:0.02".into()]);
        let plot = PlotSettings {
            x: Facet::Axis(Axis::Mask),
            lines: Facet::Axis(Axis::Objects),
            panels: None,
            logarithmic: false,
            optima: false,
            scatter: false,
        };
        let folder = StudyFolder::begin(Plan::new("two", "Two cells", axes, plot), place).unwrap();
        let states = folder.states().unwrap();
        OpenStudy::new(folder, states)
    }

    #[test]
    fn a_study_is_opened_computed_paused_and_stopped() {
        let place = tempfile::tempdir().unwrap();
        let activities = Activities::default();
        let mut queue = StudyQueue::new(activities.clone());
        let cancel = CancelToken::new();
        queue.start();
        assert!(queue.next(&cancel).is_none(), "nothing is open");
        queue.open(None, place.path().into()).unwrap();
        let task = queue.next(&cancel).unwrap();
        queue.end(task, Ok(StudyEnd::Opened(opened(place.path()))));
        assert_eq!(queue.view().status, Some(StudyStatus::Idle));
        queue.start();
        assert_eq!(queue.open(None, place.path().into()), Err(BUSY.into()));
        let task = queue.next(&cancel).unwrap();
        queue.note_step(1, "fit", Duration::from_secs(9));
        assert_eq!((queue.view().running, queue.view().step.as_str()), (Some(1), "fit"));
        queue.pause(true);
        assert!(queue.is_paused() && queue.view().status == Some(StudyStatus::Paused));
        queue.note_cell(1, CellState::Unusable("broken".into()));
        assert_eq!(queue.view().open.as_ref().map(|open| (open.done(), open.failed())), Some((0, 1)));
        queue.stop();
        assert!(cancel.is_cancelled() && queue.view().status == Some(StudyStatus::Idle));
        // The answer of the stopped run changes nothing.
        queue.end(task, Ok(StudyEnd::Failed("late".into())));
        assert_eq!(queue.view().status, Some(StudyStatus::Idle));
        assert_eq!(activities.all().len(), 1);
    }

    #[test]
    fn a_folder_that_cannot_be_opened_leaves_the_open_study() {
        let place = tempfile::tempdir().unwrap();
        let mut queue = StudyQueue::new(Activities::default());
        let cancel = CancelToken::new();
        queue.open(None, place.path().into()).unwrap();
        let task = queue.next(&cancel).unwrap();
        queue.end(task, Ok(StudyEnd::Opened(opened(place.path()))));
        queue.open(None, "nowhere".into()).unwrap();
        let task = queue.next(&cancel).unwrap();
        queue.end(task, Ok(StudyEnd::Failed("nowhere: no plan".into())));
        assert_eq!(queue.view().status, Some(StudyStatus::Failed("nowhere: no plan".into())));
        assert!(queue.view().open.is_some());
    }
}
