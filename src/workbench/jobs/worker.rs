//! The worker: one named thread that runs all computations, and reads and writes all files.
//!
//! Evaluations of the design are latest-wins: a newer design replaces a waiting one. Results carry the revision of their design, so that
//! an old one is not mistaken for current. Jobs (files) run in between, one after the other. A panic is caught at the thread's edge and
//! reported as a failure; the thread continues.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use super::evaluator::Evaluator;
use crate::workbench::background::activity::{Activities, ActivityKind, Entry};
use crate::workbench::background::threads::{SpareCores, Threads, Wake, Work, lock};
use crate::workbench::estimates::queue::Estimator;
use crate::workbench::jobs::job::{Job, Outcome};
use crate::workbench::live::inspection::InspectionRequest;
use crate::workbench::live::published::{Live, Wanted};

/// Handle of the worker thread; dropping it ends the thread after the current job.
pub struct Worker {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

pub(super) struct Shared {
    pub(super) mailbox: Mutex<Mailbox>,
    pub(super) arrived: Condvar,
    pub(super) results: Mutex<Results>,
    /// Flag that stops the reading of objects.
    pub(super) cancelled: AtomicBool,
    /// Thread that receives designs for their live estimate.
    pub(super) estimator: Estimator,
    pub(super) threads: Threads,
    pub(super) activities: Activities,
    pub(super) wake: Wake,
}

#[derive(Default)]
pub(super) struct Mailbox {
    pub(super) evaluate: Option<Wanted>,
    pub(super) jobs: VecDeque<(Job, Entry)>,
    pub(super) closer: Option<InspectionRequest>,
    pub(super) quit: bool,
}

#[derive(Default)]
pub(super) struct Results {
    pub(super) live: Live,
    pub(super) outcomes: Vec<Result<Outcome, String>>,
    /// Jobs submitted whose answers have not been taken.
    pub(super) open_jobs: usize,
}

impl Worker {
    /// Starts the thread. `wake` is called from it whenever there is something new to show.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub(crate) fn start(wake: Wake, threads: &Threads, activities: Activities) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            mailbox: Mutex::default(),
            arrived: Condvar::new(),
            results: Mutex::default(),
            cancelled: AtomicBool::new(false),
            estimator: Estimator::start(Arc::clone(&wake), threads.clone(), activities.clone())?,
            threads: threads.clone(),
            activities,
            wake,
        });
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("lenslet-worker".into()).spawn(move || run(&own))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Requests the numbers of a design; replaces a waiting request.
    pub(crate) fn evaluate(&self, wanted: Wanted) {
        self.shared.estimator.supersede(wanted.revision);
        lock(&self.shared.mailbox).evaluate = Some(wanted);
        self.shared.arrived.notify_one();
    }

    /// Requests the inspection of one measurement; replaces a waiting request.
    pub fn inspect(&self, order: InspectionRequest) {
        lock(&self.shared.mailbox).closer = Some(order);
        self.shared.arrived.notify_one();
    }

    /// Submits a job.
    pub fn submit(&self, job: Job) {
        lock(&self.shared.results).open_jobs += 1;
        let kind = match job {
            Job::OpenObjects { .. } | Job::MeasureSnapshot { .. } => ActivityKind::Objects,
            Job::SaveDesign { .. } => ActivityKind::Save,
            _ => ActivityKind::File,
        };
        let entry = self.shared.activities.add(kind, job.name());
        lock(&self.shared.mailbox).jobs.push_back((job, entry));
        self.shared.arrived.notify_one();
    }

    /// Stops the reading of objects, if there is any.
    pub fn cancel(&self) {
        self.shared.cancelled.store(true, Ordering::Relaxed);
    }

    /// Stops the running or waiting reading of objects of this number.
    pub fn cancel_numbered(&self, number: u64) {
        let waiting = {
            let jobs = &mut lock(&self.shared.mailbox).jobs;
            jobs.iter().position(|(_, entry)| entry.number() == number).and_then(|index| jobs.remove(index))
        };
        match waiting {
            Some((job, _)) => {
                let sentence = format!("{} was stopped before it began", job.name());
                let outcome = match job {
                    // The sender waits for an answer.
                    Job::MeasureSnapshot { number, name, .. } => {
                        Ok(Outcome::SnapshotMeasured { number, name, measurement: Err(sentence) })
                    }
                    _ => Err(sentence),
                };
                lock(&self.shared.results).outcomes.push(outcome);
                (self.shared.wake)();
            }
            None => self.cancel(),
        }
    }

    /// The thread of long estimates.
    pub(crate) fn estimator(&self) -> &Estimator {
        &self.shared.estimator
    }

    /// The latest results.
    pub fn live(&self) -> Live {
        lock(&self.shared.results).live.clone()
    }

    /// Answers to jobs since the last call, oldest first.
    pub fn take_outcomes(&self) -> Vec<Result<Outcome, String>> {
        let mut results = lock(&self.shared.results);
        results.open_jobs -= results.outcomes.len();
        std::mem::take(&mut results.outcomes)
    }

    /// Whether a job has not been answered yet, or its answer not been taken.
    pub fn has_open_jobs(&self) -> bool {
        lock(&self.shared.results).open_jobs > 0
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        lock(&self.shared.mailbox).quit = true;
        self.shared.arrived.notify_one();
        if let Some(thread) = self.thread.take() {
            // The thread catches its own panics, so joining fails only where the system killed it.
            let _ = thread.join();
        }
    }
}

#[allow(clippy::large_enum_variant, reason = "one task at a time")]
enum Task {
    Evaluate(Wanted),
    Job(Job, Entry),
    SampleInspection(InspectionRequest),
}

fn run(shared: &Shared) {
    let mut cores = SpareCores::new(Work::Computation, shared.threads.clone());
    let mut evaluator = Evaluator::default();
    let mut job_is_due = false;
    while let Some(task) = next_task(shared, &mut job_is_due) {
        let done = cores.run(|| match &task {
            Task::Evaluate(wanted) => {
                evaluator.evaluate(wanted, shared);
                None
            }
            Task::Job(job, entry) => {
                entry.begin();
                evaluator.run_job(job, entry, shared)
            }
            Task::SampleInspection(order) => {
                let edited = || lock(&shared.mailbox).evaluate.is_some();
                if let Some(closer) = order.look(&|| !edited()) {
                    lock(&shared.results).live.closer = Some(Arc::new(closer));
                }
                None
            }
        });
        let answer = done.unwrap_or_else(|text| {
            // Parts of the interrupted computation may be incomplete.
            evaluator = Evaluator::default();
            let mut results = lock(&shared.results);
            results.live.busy = None;
            match task {
                Task::Evaluate(Wanted { revision, .. }) => {
                    results.live.failure = Some((revision, text));
                    None
                }
                Task::Job(..) => Some(Err(text)),
                Task::SampleInspection(_) => {
                    results.live.closer = None;
                    None
                }
            }
        });
        if let Task::Job(job, entry) = task {
            match answer {
                Some(answer) => {
                    let told = answer.as_ref().map(Outcome::sentence).map_err(Clone::clone);
                    // The answer is there before the end of the job is visible.
                    lock(&shared.results).outcomes.push(answer);
                    entry.end(told);
                }
                None => lock(&shared.mailbox).jobs.push_back((job, entry)),
            }
        }
        (shared.wake)();
    }
}

/// Waits for the next task; evaluations and jobs take turns where both wait. `None` ends the thread.
fn next_task(shared: &Shared, job_is_due: &mut bool) -> Option<Task> {
    let mut mailbox = lock(&shared.mailbox);
    loop {
        // Every job gets an answer, a save above all: the thread ends only when none is left.
        if mailbox.quit && mailbox.jobs.is_empty() {
            return None;
        }
        if mailbox.quit || *job_is_due || mailbox.evaluate.is_none() {
            *job_is_due = false;
            if let Some((job, entry)) = mailbox.jobs.pop_front() {
                return Some(Task::Job(job, entry));
            }
        }
        if let Some(wanted) = mailbox.evaluate.take() {
            *job_is_due = true;
            return Some(Task::Evaluate(wanted));
        }
        if let Some(order) = mailbox.closer.take() {
            return Some(Task::SampleInspection(order));
        }
        mailbox = shared.arrived.wait(mailbox).unwrap_or_else(PoisonError::into_inner);
    }
}
