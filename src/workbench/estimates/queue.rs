//! Queue of estimates that take longer than an edit may: the live estimate, refined while the design stays unchanged, and ordered
//! estimates, one at a time and first.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use crate::evaluation::EvaluationError;
use crate::evaluation::progress::{EstimateProgress, FitPoint, thin_out};
use crate::evaluation::request::DensityModel;
use crate::evaluation::scene::Scene;
use crate::progress::CancelToken;
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::Queue;
use crate::workbench::estimates::files::{EstimateFolder, EstimateOrder, FinishedEstimate, InterruptedOrder};
use crate::workbench::live::estimate::LiveEstimate;
use crate::workbench::live::published::{Revisioned, Wanted};

/// Most orders that may wait.
const MOST_ORDERS: usize = 50;

/// The running order.
#[derive(Clone, Debug)]
pub struct RunningEstimate {
    /// Its number in the list of activities.
    pub number: u64,
    /// The density model.
    pub model: DensityModel,
    /// Revision of the design.
    pub revision: u64,
    /// Progress of the estimate.
    pub progress: EstimateProgress,
    /// Curves of the fits, oldest first.
    pub curve: Vec<FitPoint>,
}

/// A finished estimate that was deleted, and its place in the list.
#[derive(Clone)]
pub struct DeletedEstimate {
    /// Index in the list of finished estimates.
    pub place: usize,
    /// The estimate.
    pub finished: Revisioned<FinishedEstimate>,
}

/// Finished and running estimates of the thread.
#[derive(Clone, Default)]
pub struct Estimates {
    /// The newest live estimate.
    pub live: Option<Revisioned<LiveEstimate>>,
    /// Revision of the newest design, and why it has no live estimate.
    pub live_failure: Option<(u64, String)>,
    /// The running order.
    pub running: Option<RunningEstimate>,
    /// All finished orders, also of earlier sessions, oldest first.
    pub finished: Vec<Revisioned<FinishedEstimate>>,
    /// The finished order that was deleted last and can be brought back.
    pub gone: Option<DeletedEstimate>,
}

/// A request for the live estimate of a design.
#[derive(Clone)]
pub(crate) struct LiveRequest {
    pub wanted: Wanted,
    pub scene: Arc<Scene>,
}

/// Contents of a folder of estimates.
pub(crate) struct FolderContents {
    pub folder: EstimateFolder,
    pub finished: Vec<FinishedEstimate>,
    pub interrupted: Option<InterruptedOrder>,
    pub waiting: Vec<EstimateOrder>,
}

/// One task of the thread.
pub(crate) enum EstimateTask {
    /// Reads a folder.
    Read(PathBuf),
    /// Computes an order.
    Order(Box<EstimateOrder>, ActivityHandle),
    /// Writes the waiting orders, because their file is out of date.
    WriteWaiting,
    /// Refines the live estimate of a design.
    Live(LiveRequest),
}

/// Answer to a task.
pub(crate) enum EstimateAnswer {
    /// The folder was read.
    Read(Box<FolderContents>),
    /// The order is finished, with a summary of its result.
    Finished(Box<FinishedEstimate>, String),
    /// The order failed, with the reason.
    Failed(String),
    /// The order was stopped.
    Stopped,
    /// The waiting orders are written.
    Written,
    /// The live estimate converged, or ended before.
    Live(Result<(), EvaluationError>),
}

/// What runs, and what stops it.
enum Running {
    Order(CancelToken),
    Live { revision: u64, is_published: bool, cancel: CancelToken },
}

/// Whether live estimates are computed, and how fast.
#[derive(Clone, Copy)]
struct LiveSwitch {
    /// As the person chose.
    is_on: bool,
    /// Whether they are paused for something else.
    is_held: bool,
    /// Divisor of the times of their schedule.
    speed: f64,
}

/// Waiting, running and finished estimates.
pub(crate) struct EstimateQueue {
    activities: Activities,
    /// Folder whose contents are to be read before anything else.
    folder_to_read: Option<PathBuf>,
    live: Option<LiveRequest>,
    /// Waiting orders, oldest first.
    orders: VecDeque<(EstimateOrder, ActivityHandle)>,
    /// Whether the waiting orders differ from those in their file.
    is_changed: bool,
    /// Newest known revision; a live estimate of an older one is given up.
    newest: u64,
    switch: LiveSwitch,
    is_closed: bool,
    running: Option<Running>,
    /// Folder in which finished, running and waiting orders outlive the program.
    folder: Option<EstimateFolder>,
    estimates: Estimates,
}

impl EstimateQueue {
    /// An empty queue that computes live estimates.
    pub fn new(activities: Activities) -> Self {
        Self {
            activities,
            folder_to_read: None,
            live: None,
            orders: VecDeque::new(),
            is_changed: false,
            newest: 0,
            switch: LiveSwitch { is_on: true, is_held: false, speed: 1.0 },
            is_closed: false,
            running: None,
            folder: None,
            estimates: Estimates::default(),
        }
    }

    /// All estimates.
    pub fn estimates(&self) -> &Estimates {
        &self.estimates
    }

    /// The folder that was read.
    pub fn folder(&self) -> Option<&EstimateFolder> {
        self.folder.as_ref()
    }

    /// Requests that a folder be read.
    pub fn read(&mut self, folder: PathBuf) {
        self.folder_to_read = Some(folder);
    }

    /// Notes a newer design, which makes the present live estimate useless.
    pub fn supersede(&mut self, revision: u64) {
        self.newest = self.newest.max(revision);
        self.cancel_superseded();
    }

    /// While edits come quickly, each live estimate that was started still gives its first number.
    fn cancel_superseded(&self) {
        if let Some(Running::Live { revision, is_published: true, cancel }) = &self.running
            && *revision < self.newest
        {
            cancel.cancel();
        }
    }

    /// Cancels the live estimate that is running; it resumes later, unless there is a newer design.
    fn interrupt_live(&self) {
        if let Some(Running::Live { cancel, .. }) = &self.running {
            cancel.cancel();
        }
    }

    /// Requests the live estimate of a design; replaces a waiting request.
    pub fn refine(&mut self, request: LiveRequest) {
        self.supersede(request.wanted.revision);
        self.live = Some(request);
    }

    /// Publishes a number of the running live estimate.
    pub fn publish_live(&mut self, revision: u64, estimate: LiveEstimate) {
        self.estimates.live_failure = None;
        self.estimates.live = Some(Revisioned { revision, value: Arc::new(estimate) });
        self.note_published();
    }

    fn note_published(&mut self) {
        if let Some(Running::Live { is_published, .. }) = &mut self.running {
            *is_published = true;
        }
        self.cancel_superseded();
    }

    /// Whether live estimates are switched on.
    pub fn is_live(&self) -> bool {
        self.switch.is_on
    }

    /// Switches live estimates on or off.
    pub fn set_live(&mut self, live: bool) {
        self.switch.is_on = live;
        if !live {
            self.interrupt_live();
        }
    }

    /// Divisor of the times in the schedule of live estimates.
    pub fn live_speed(&self) -> f64 {
        self.switch.speed
    }

    /// Sets the divisor of the times in the schedule, from the next live estimate on.
    pub fn set_live_speed(&mut self, speed: f64) {
        self.switch.speed = speed;
    }

    /// Whether live estimates are paused.
    pub fn is_held(&self) -> bool {
        self.switch.is_held
    }

    /// Pauses live estimates while something more important computes.
    pub fn hold(&mut self, hold: bool) {
        self.switch.is_held = hold;
        if hold {
            self.interrupt_live();
        }
    }

    /// Adds an order behind earlier ones.
    ///
    /// # Errors
    /// One sentence where too many orders wait.
    pub fn order(&mut self, order: EstimateOrder) -> Result<(), String> {
        if self.orders.len() >= MOST_ORDERS {
            return Err(format!("{MOST_ORDERS} estimates wait already; stop some, or let them come to their end"));
        }
        let entry = self.activities.add(ActivityKind::Estimate, order.name());
        self.orders.push_back((order, entry));
        self.is_changed = true;
        self.interrupt_live();
        Ok(())
    }

    /// Stops the running order.
    pub fn cancel(&mut self) {
        if let (Some(running), Some(Running::Order(cancel))) = (&mut self.estimates.running, &self.running) {
            running.progress.step = "stopping".into();
            cancel.cancel();
        }
    }

    /// Stops the order of this number in the list of activities, whether it is running or waiting.
    pub fn cancel_numbered(&mut self, number: u64) {
        let before = self.orders.len();
        self.orders.retain(|(_, entry)| entry.number() != number);
        if self.orders.len() < before {
            self.is_changed = true;
        } else if self.estimates.running.as_ref().is_some_and(|running| running.number == number) {
            self.cancel();
        }
    }

    fn is_out_of_date(&self) -> bool {
        self.is_changed && self.folder.is_some()
    }

    /// The waiting orders, where their file is out of date. It counts as written from then on.
    pub fn take_out_of_date(&mut self) -> Option<(EstimateFolder, Vec<EstimateOrder>)> {
        let folder = self.folder.clone().filter(|_| self.is_out_of_date())?;
        self.is_changed = false;
        Some((folder, self.orders.iter().map(|(order, _)| order.clone()).collect()))
    }

    /// Publishes the progress of the running order.
    pub fn report(&mut self, progress: &EstimateProgress) {
        if let Some(running) = &mut self.estimates.running {
            running.curve.extend(progress.fit);
            thin_out(&mut running.curve);
            running.progress = progress.clone();
        }
    }

    /// Takes the curves of the running order.
    pub fn take_curve(&mut self) -> Vec<FitPoint> {
        self.estimates.running.as_mut().map(|running| std::mem::take(&mut running.curve)).unwrap_or_default()
    }

    /// Deletes a finished order and its file; it can be [brought back](Self::bring_back).
    pub fn delete(&mut self, finished: &Arc<FinishedEstimate>) {
        let estimates = &mut self.estimates;
        let Some(place) = estimates.finished.iter().position(|other| Arc::ptr_eq(&other.value, finished)) else {
            return;
        };
        estimates.gone = Some(DeletedEstimate { place, finished: estimates.finished.remove(place) });
        if let Some(folder) = &self.folder {
            folder.delete(finished);
        }
    }

    /// Restores the finished order that was deleted last to its place.
    pub fn bring_back(&mut self) {
        let Some(DeletedEstimate { place, finished }) = self.estimates.gone.take() else { return };
        if let Some(folder) = &self.folder {
            folder.bring_back(&finished.value);
        }
        let place = place.min(self.estimates.finished.len());
        self.estimates.finished.insert(place, finished);
    }

    /// Loads the finished orders of earlier sessions, the interrupted one and the waiting ones.
    fn load(&mut self, contents: FolderContents) {
        let FolderContents { folder, finished, interrupted, waiting } = contents;
        let finished = finished.into_iter().map(|finished| Revisioned { revision: 0, value: Arc::new(finished) });
        self.estimates.finished.splice(0..0, finished);
        let mut orders = VecDeque::new();
        if let Some(InterruptedOrder { order, given_up }) = interrupted {
            let name = format!("{}, which was interrupted", order.name());
            let entry = self.activities.add(ActivityKind::Estimate, name);
            match given_up {
                None => orders.push_back((order, entry)),
                Some(why) => {
                    entry.begin();
                    entry.end(Err(why));
                }
            }
        }
        for order in waiting {
            let entry = self.activities.add(ActivityKind::Estimate, order.name());
            orders.push_back((order, entry));
        }
        // Orders since then come later.
        orders.append(&mut self.orders);
        self.orders = orders;
        self.folder = Some(folder);
    }

    /// Notes the end of a live estimate. One that was interrupted resumes later, unless there is a newer design.
    fn end_live(&mut self, request: LiveRequest, result: Result<(), EvaluationError>) {
        let revision = request.wanted.revision;
        match result {
            Ok(()) => {}
            Err(error) if error.is_cancelled() => {
                if revision >= self.newest && self.live.is_none() {
                    self.live = Some(request);
                }
            }
            Err(error) => self.estimates.live_failure = Some((revision, error.to_string())),
        }
    }
}

impl Queue for EstimateQueue {
    type Task = EstimateTask;
    type Answer = EstimateAnswer;

    fn next(&mut self, cancel: &CancelToken) -> Option<EstimateTask> {
        if self.is_closed {
            return self.is_out_of_date().then_some(EstimateTask::WriteWaiting);
        }
        if let Some(folder) = self.folder_to_read.take() {
            return Some(EstimateTask::Read(folder));
        }
        if let Some((order, entry)) = self.orders.pop_front() {
            self.is_changed = true;
            self.running = Some(Running::Order(cancel.clone()));
            self.estimates.running = Some(RunningEstimate {
                number: entry.number(),
                model: order.request.model,
                revision: order.revision,
                progress: EstimateProgress { step: "Waiting".into(), done: 0, total: 1, fit: None, understood: None },
                curve: Vec::new(),
            });
            entry.begin();
            return Some(EstimateTask::Order(Box::new(order), entry));
        }
        if self.is_out_of_date() {
            return Some(EstimateTask::WriteWaiting);
        }
        if !self.switch.is_on || self.switch.is_held {
            return None;
        }
        let request = self.live.take().filter(|request| request.wanted.revision >= self.newest)?;
        let revision = request.wanted.revision;
        self.running = Some(Running::Live { revision, is_published: false, cancel: cancel.clone() });
        Some(EstimateTask::Live(request))
    }

    fn end(&mut self, task: EstimateTask, answer: Result<EstimateAnswer, String>) {
        self.running = None;
        self.estimates.running = None;
        match (task, answer) {
            (_, Ok(EstimateAnswer::Read(contents))) => self.load(*contents),
            (EstimateTask::Order(order, entry), Ok(EstimateAnswer::Finished(finished, summary))) => {
                let finished = Revisioned { revision: order.revision, value: Arc::new(*finished) };
                self.estimates.finished.push(finished);
                entry.end(Ok(summary));
            }
            (EstimateTask::Order(_, entry), Ok(EstimateAnswer::Failed(message))) => entry.end(Err(message)),
            (EstimateTask::Order(_, entry), Err(panic)) => {
                if let Some(folder) = &self.folder {
                    folder.end();
                }
                entry.end(Err(panic));
            }
            (EstimateTask::Live(request), Ok(EstimateAnswer::Live(result))) => self.end_live(request, result),
            (EstimateTask::Live(request), Err(panic)) => {
                self.estimates.live_failure = Some((request.wanted.revision, panic));
            }
            // The entry of an order that was stopped is dropped without an end.
            _ => {}
        }
    }

    fn close(&mut self) {
        self.is_closed = true;
    }
}

#[cfg(test)]
mod tests;
