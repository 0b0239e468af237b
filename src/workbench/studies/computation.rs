//! Computation of the study: opening its folder, and its cells.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::progress::CancelToken;
use crate::studies::StudyError;
use crate::studies::plans::{CellState, Plan, PlanEvent, Shard, StudyFolder, run_cells};
use crate::workbench::background::mailbox::Mailbox;
use crate::workbench::studies::queue::{OpenStudy, StudyEnd, StudyQueue, StudyTask};

/// Time between two frames of the window for steps.
const WAKE_EVERY: Duration = Duration::from_millis(100);

/// Opens a study or computes its cells.
pub(crate) fn run(task: &StudyTask, cancel: &CancelToken, mailbox: &Mailbox<StudyQueue>) -> StudyEnd {
    let result = match task {
        StudyTask::Open { plan, path } => open(plan.as_deref(), path).map(StudyEnd::Opened),
        StudyTask::Run(folder) => compute(folder, cancel, mailbox).map(|()| StudyEnd::Ran),
    };
    match result {
        Ok(end) => end,
        Err(StudyError::Cancelled) => StudyEnd::Stopped,
        Err(error) => StudyEnd::Failed(error.to_string()),
    }
}

fn open(plan: Option<&Plan>, path: &Path) -> Result<OpenStudy, StudyError> {
    let folder = match plan {
        Some(plan) => StudyFolder::begin(plan.clone(), path)?,
        None => StudyFolder::open(path)?,
    };
    let states = folder.states()?;
    Ok(OpenStudy::new(folder, states))
}

fn compute(folder: &StudyFolder, cancel: &CancelToken, mailbox: &Mailbox<StudyQueue>) -> Result<(), StudyError> {
    let mut woken = Instant::now();
    let mut on_event = |event: &PlanEvent<'_>| -> ControlFlow<()> {
        let is_cell = mailbox.change(|queue| {
            // A stopped study has ended for the window.
            if cancel.is_cancelled() {
                return false;
            }
            match event {
                PlanEvent::Step { index, step, left, .. } => {
                    queue.note_step(*index, step, *left);
                    false
                }
                PlanEvent::Done { index, record, .. } => {
                    let record = Box::new((*record).clone());
                    let is_done = record.estimate.is_some();
                    queue.note_cell(*index, if is_done { CellState::Done(record) } else { CellState::Failed(record) });
                    true
                }
            }
        });
        if is_cell || woken.elapsed() >= WAKE_EVERY {
            woken = Instant::now();
            mailbox.wake();
        }
        mailbox.wait_while(cancel, |queue| queue.is_paused())
    };
    run_cells(folder, Shard::default(), &mut on_event).map(|_| ())
}
