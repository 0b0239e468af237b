//! The worker: one named thread that evaluates every edit, and reads and writes all files. Results carry the revision of their design, so
//! that an old one is not mistaken for current.

use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{Computation, MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::estimates::estimator::Estimator;
use crate::workbench::jobs::evaluator::Evaluator;
use crate::workbench::jobs::job::Job;
use crate::workbench::jobs::outcome::Outcome;
use crate::workbench::jobs::queue::JobQueue;
use crate::workbench::live::inspection::InspectionRequest;
use crate::workbench::live::published::{Live, Wanted};

/// Handle of the worker thread and of the thread of long estimates. Dropping it ends both; waiting jobs are answered before.
pub struct Worker {
    thread: MailboxThread<JobQueue>,
    estimator: Estimator,
}

impl Worker {
    /// Starts the threads. `wake` is called from them whenever there is something new to show.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub(crate) fn start(wake: Wake, threads: &Threads, activities: Activities) -> std::io::Result<Self> {
        let estimator = Estimator::start(wake.clone(), threads.clone(), activities.clone())?;
        let (estimates, of_evaluator) = (estimator.mailbox(), activities.clone());
        let make = move || Evaluator::new(estimates.clone(), of_evaluator.clone());
        Self::start_with(wake, threads, activities, estimator, make)
    }

    /// Starts the worker with another computation.
    fn start_with<C: Computation<JobQueue>>(
        wake: Wake,
        threads: &Threads,
        activities: Activities,
        estimator: Estimator,
        make: impl Fn() -> C + Send + 'static,
    ) -> std::io::Result<Self> {
        let settings =
            ThreadSettings { name: "lenslet-worker", work: Work::Computation, threads: threads.clone(), wake };
        Ok(Self { thread: MailboxThread::start(settings, JobQueue::new(activities), make)?, estimator })
    }

    /// Requests the numbers of a design; replaces a waiting request.
    pub(crate) fn evaluate(&self, wanted: Wanted) {
        self.estimator.supersede(wanted.revision);
        self.thread.change(|queue| queue.evaluate(wanted));
    }

    /// Requests the inspection of one measurement; replaces a waiting request.
    pub fn inspect(&self, request: InspectionRequest) {
        self.thread.change(|queue| queue.inspect(request));
    }

    /// Submits a job.
    pub fn submit(&self, job: Job) {
        self.thread.change(|queue| queue.submit(job));
    }

    /// Stops the reading of objects, if there is any.
    pub fn cancel(&self) {
        self.thread.change(JobQueue::cancel);
    }

    /// Stops the running or waiting reading of objects of this number.
    pub fn cancel_numbered(&self, number: u64) {
        self.thread.publish(|queue| queue.cancel_numbered(number));
    }

    /// The thread of long estimates.
    pub(crate) fn estimator(&self) -> &Estimator {
        &self.estimator
    }

    /// The latest results.
    pub fn live(&self) -> Live {
        self.thread.look(|queue| queue.live().clone())
    }

    /// Answers to jobs since the last call, oldest first.
    pub fn take_outcomes(&self) -> Vec<Result<Outcome, String>> {
        self.thread.change(JobQueue::take_outcomes)
    }

    /// Whether a job has not been answered yet, or its answer not been taken.
    pub fn has_open_jobs(&self) -> bool {
        self.thread.look(JobQueue::has_open_jobs)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // Both end at the same time.
        self.estimator.close();
        self.thread.close();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::forward::Design;
    use crate::progress::CancelToken;
    use crate::workbench::background::mailbox::Mailbox;
    use crate::workbench::background::threads::lock;
    use crate::workbench::jobs::queue::{WorkerAnswer, WorkerTask};

    #[test]
    fn edits_during_an_evaluation_are_evaluated_once_and_drop_answers_all_jobs() {
        let (begin, begun) = channel();
        let (go_on, resumed) = channel::<()>();
        let resumed = Arc::new(Mutex::new(resumed));
        let make = move || {
            let (begin, resumed) = (begin.clone(), Arc::clone(&resumed));
            move |task: &WorkerTask, _: &CancelToken, _: &Mailbox<JobQueue>| match task {
                WorkerTask::Evaluate(wanted) => {
                    begin.send(wanted.revision).unwrap();
                    lock(&resumed).recv().unwrap();
                    WorkerAnswer::Evaluated(Ok(0.5))
                }
                WorkerTask::Job(job, _) => WorkerAnswer::Job(job.run()),
                WorkerTask::Inspect(_) => WorkerAnswer::Inspected(None),
            }
        };
        let (wake, threads, activities) = (Arc::new(|| ()), Threads::default(), Activities::default());
        let estimator = Estimator::start(wake.clone(), threads.clone(), activities.clone()).unwrap();
        let worker = Worker::start_with(wake, &threads, activities, estimator, make).unwrap();
        let design = Arc::new(Design::default());
        let evaluate = |revision| worker.evaluate(Wanted { revision, design: Arc::clone(&design), before: None });
        evaluate(1);
        assert_eq!(begun.recv().unwrap(), 1);
        evaluate(2);
        evaluate(3);
        go_on.send(()).unwrap();
        assert_eq!(begun.recv().unwrap(), 3);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("design.json");
        let (design_of_job, path_of_job) = (Arc::clone(&design), path.clone());
        let job = Job::SaveDesign { design: design_of_job, document: 1, contents: 1, network: None, path: path_of_job };
        worker.submit(job);
        assert!(worker.has_open_jobs());
        go_on.send(()).unwrap();
        drop(worker);
        assert_eq!(Design::open(&path).unwrap(), *design);
    }
}
