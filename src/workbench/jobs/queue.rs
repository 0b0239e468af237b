//! Queue of the worker: the evaluation of the newest design, jobs, and inspections of a measurement.
//!
//! Evaluations are latest-wins: a newer design replaces a waiting one. Jobs run in between, one after the other. Inspections give way to
//! both.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::evaluation::scene::EvaluationError;
use crate::forward::Design;
use crate::progress::CancelToken;
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::Queue;
use crate::workbench::jobs::job::Job;
use crate::workbench::jobs::outcome::Outcome;
use crate::workbench::live::inspection::{InspectionRequest, SampleInspection};
use crate::workbench::live::published::{Live, Wanted};

/// One task of the worker.
#[allow(clippy::large_enum_variant, reason = "one task at a time")]
pub(crate) enum WorkerTask {
    /// Evaluates a design.
    Evaluate(Wanted),
    /// Runs a job.
    Job(Job, ActivityHandle),
    /// Inspects a measurement.
    Inspect(InspectionRequest),
}

/// Answer to a task.
pub(crate) enum WorkerAnswer {
    /// Seconds of the evaluation, or why it has no numbers.
    Evaluated(Result<f64, EvaluationError>),
    /// The answer to a job.
    Job(Result<Outcome, String>),
    /// The job gave way to an edit and is to be restarted.
    GaveWay,
    /// The inspection; none where it gave way to an edit.
    Inspected(Option<SampleInspection>),
}

/// What runs.
enum Running {
    Evaluation(Arc<Design>),
    Job,
    Inspection,
}

/// Tasks of the worker and their results.
pub(crate) struct JobQueue {
    activities: Activities,
    evaluation: Option<Wanted>,
    jobs: VecDeque<(Job, ActivityHandle)>,
    inspection: Option<InspectionRequest>,
    /// Whether a waiting job comes before a waiting evaluation: they take turns.
    job_is_due: bool,
    running: Option<(Running, CancelToken)>,
    /// Whether a person stopped the running task.
    is_stopped: bool,
    live: Live,
    outcomes: Vec<Result<Outcome, String>>,
    /// Jobs submitted whose answers have not been taken.
    open_jobs: usize,
}

impl JobQueue {
    /// An empty queue.
    pub fn new(activities: Activities) -> Self {
        Self {
            activities,
            evaluation: None,
            jobs: VecDeque::new(),
            inspection: None,
            job_is_due: false,
            running: None,
            is_stopped: false,
            live: Live::default(),
            outcomes: Vec::new(),
            open_jobs: 0,
        }
    }

    /// The latest results.
    pub fn live(&self) -> &Live {
        &self.live
    }

    /// The latest results, to publish another one.
    pub fn live_mut(&mut self) -> &mut Live {
        &mut self.live
    }

    /// Requests the numbers of a design; replaces a waiting request. The running evaluation ends if it images other objects, and so does
    /// an inspection.
    pub fn evaluate(&mut self, wanted: Wanted) {
        match &self.running {
            Some((Running::Evaluation(design), cancel)) if !design.has_objects_of(&wanted.design) => {
                cancel.cancel();
            }
            Some((Running::Inspection, cancel)) => cancel.cancel(),
            _ => {}
        }
        self.evaluation = Some(wanted);
    }

    /// The design that waits for its numbers.
    pub fn waiting_evaluation(&self) -> Option<&Wanted> {
        self.evaluation.as_ref()
    }

    /// Requests the inspection of one measurement; replaces a waiting request.
    pub fn inspect(&mut self, request: InspectionRequest) {
        self.inspection = Some(request);
    }

    /// Adds a job behind earlier ones.
    pub fn submit(&mut self, job: Job) {
        let kind = match job {
            Job::OpenObjects { .. } | Job::MeasureSnapshot { .. } => ActivityKind::Objects,
            Job::SaveDesign { .. } => ActivityKind::Save,
            _ => ActivityKind::File,
        };
        let entry = self.activities.add(kind, job.name());
        self.open_jobs += 1;
        self.jobs.push_back((job, entry));
    }

    /// Stops the reading of objects, if there is any.
    pub fn cancel(&mut self) {
        if let Some((Running::Evaluation(_) | Running::Job, cancel)) = &self.running {
            self.is_stopped = true;
            cancel.cancel();
        }
    }

    /// Stops the running or waiting reading of objects of this number.
    pub fn cancel_numbered(&mut self, number: u64) {
        let waiting = self.jobs.iter().position(|(_, entry)| entry.number() == number);
        let Some((job, _)) = waiting.and_then(|index| self.jobs.remove(index)) else { return self.cancel() };
        let message = format!("{} was stopped before it began", job.name());
        self.outcomes.push(match job {
            // The sender waits for an answer.
            Job::MeasureSnapshot { number, name, .. } => {
                Ok(Outcome::SnapshotMeasured { number, name, measurement: Err(message) })
            }
            _ => Err(message),
        });
    }

    /// Takes the answers to jobs since the last call, oldest first.
    pub fn take_outcomes(&mut self) -> Vec<Result<Outcome, String>> {
        self.open_jobs -= self.outcomes.len();
        std::mem::take(&mut self.outcomes)
    }

    /// Whether a job has not been answered yet, or its answer not been taken.
    pub fn has_open_jobs(&self) -> bool {
        self.open_jobs > 0
    }

    fn take_job(&mut self) -> Option<WorkerTask> {
        let (job, entry) = self.jobs.pop_front()?;
        entry.begin();
        Some(WorkerTask::Job(job, entry))
    }

    /// Notes the end of an evaluation.
    fn end_evaluation(&mut self, wanted: &Wanted, result: Result<f64, EvaluationError>) {
        let error = match result {
            Ok(seconds) => return self.live.seconds = seconds,
            Err(error) => error,
        };
        let mut newest = wanted.revision;
        if error.is_cancelled() {
            if !self.is_stopped {
                // A newer design waits, and images other objects.
                return;
            }
            // A waiting edit would restart what was just stopped.
            let restarts = |newer: &mut Wanted| wanted.design.has_objects_of(&newer.design);
            newest = self.evaluation.take_if(restarts).map_or(newest, |newer| newer.revision);
        }
        self.live.failure = Some((newest, error.to_string()));
    }
}

impl Queue for JobQueue {
    type Task = WorkerTask;
    type Answer = WorkerAnswer;

    fn next(&mut self, cancel: &CancelToken) -> Option<WorkerTask> {
        let mut task = None;
        if std::mem::take(&mut self.job_is_due) || self.evaluation.is_none() {
            task = self.take_job();
        }
        if task.is_none() {
            task = self.evaluation.take().map(WorkerTask::Evaluate);
            self.job_is_due = task.is_some();
        }
        let task = task.or_else(|| self.inspection.take().map(WorkerTask::Inspect))?;
        let running = match &task {
            WorkerTask::Evaluate(wanted) => Running::Evaluation(Arc::clone(&wanted.design)),
            WorkerTask::Job(..) => Running::Job,
            WorkerTask::Inspect(_) => Running::Inspection,
        };
        (self.running, self.is_stopped) = (Some((running, cancel.clone())), false);
        Some(task)
    }

    fn end(&mut self, task: WorkerTask, answer: Result<WorkerAnswer, String>) {
        self.running = None;
        self.live.busy = None;
        match (task, answer) {
            (WorkerTask::Evaluate(wanted), Ok(WorkerAnswer::Evaluated(result))) => {
                self.end_evaluation(&wanted, result);
            }
            (WorkerTask::Evaluate(wanted), Err(panic)) => self.live.failure = Some((wanted.revision, panic)),
            (WorkerTask::Job(job, entry), Ok(WorkerAnswer::GaveWay)) => self.jobs.push_back((job, entry)),
            (WorkerTask::Job(_, entry), Ok(WorkerAnswer::Job(answer))) => self.answer(entry, answer),
            (WorkerTask::Job(_, entry), Err(panic)) => self.answer(entry, Err(panic)),
            (WorkerTask::Inspect(_), Ok(WorkerAnswer::Inspected(Some(inspection)))) => {
                self.live.closer = Some(Arc::new(inspection));
            }
            (WorkerTask::Inspect(_), Err(_)) => self.live.closer = None,
            _ => {}
        }
    }

    /// Every job gets an answer, a save above all.
    fn close(&mut self) {
        (self.evaluation, self.inspection) = (None, None);
    }
}

impl JobQueue {
    /// Answers a job and ends its activity.
    fn answer(&mut self, entry: ActivityHandle, answer: Result<Outcome, String>) {
        let summary = answer.as_ref().map(Outcome::sentence).map_err(Clone::clone);
        self.outcomes.push(answer);
        entry.end(summary);
    }
}

#[cfg(test)]
mod tests;
