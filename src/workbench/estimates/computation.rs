//! Computation of estimates: ordered ones, with their checkpoints, and the live estimate.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use crate::evaluation::EvaluationError;
use crate::evaluation::estimation::estimate;
use crate::evaluation::progress::EstimateProgress;
use crate::evaluation::request::EstimateRequest;
use crate::information::Estimate;
use crate::progress::{CancelToken, Progress};
use crate::workbench::background::activity::{ActivityHandle, step_of};
use crate::workbench::background::mailbox::{Computation, Mailbox};
use crate::workbench::estimates::files::{EstimateFolder, EstimateOrder, FinishedEstimate};
use crate::workbench::estimates::queue::{EstimateAnswer, EstimateQueue, EstimateTask, FolderContents, LiveRequest};
use crate::workbench::live::estimate::LiveEstimate;
use crate::workbench::live::estimator::LiveEstimator;

/// Time between two reports of progress.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Computes estimates, and keeps the model of the last live estimate for the next one.
#[derive(Default)]
pub(crate) struct EstimateComputation {
    live: LiveEstimator,
}

/// Why an order has no result.
struct Failure {
    message: String,
    is_cancelled: bool,
    /// Whether it is about a file that may be there another time; the order's checkpoint is then kept.
    may_pass: bool,
}

impl Computation<EstimateQueue> for EstimateComputation {
    fn run(&mut self, task: &EstimateTask, cancel: &CancelToken, mailbox: &Mailbox<EstimateQueue>) -> EstimateAnswer {
        match task {
            EstimateTask::Read(folder) => {
                let folder = EstimateFolder::open(folder.clone());
                let (finished, interrupted, waiting) = (folder.read(), folder.interrupted(), folder.waiting());
                EstimateAnswer::Read(Box::new(FolderContents { folder, finished, interrupted, waiting }))
            }
            EstimateTask::Order(order, entry) => run_order(order, entry, cancel, mailbox),
            EstimateTask::WriteWaiting => {
                write_waiting(mailbox);
                EstimateAnswer::Written
            }
            EstimateTask::Live(request) => EstimateAnswer::Live(self.refine(request, cancel, mailbox)),
        }
    }
}

impl EstimateComputation {
    fn refine(
        &mut self,
        LiveRequest { wanted, scene }: &LiveRequest,
        cancel: &CancelToken,
        mailbox: &Mailbox<EstimateQueue>,
    ) -> Result<(), EvaluationError> {
        let mut publish =
            |estimate: LiveEstimate| mailbox.publish(|queue| queue.publish_live(wanted.revision, estimate));
        self.live.set_speed(mailbox.look(EstimateQueue::live_speed));
        self.live.refine(&wanted.design, wanted.before.as_ref(), scene, &mut publish, cancel)
    }
}

/// Writes the waiting orders, where their file is out of date.
fn write_waiting(mailbox: &Mailbox<EstimateQueue>) {
    if let Some((folder, orders)) = mailbox.change(EstimateQueue::take_out_of_date) {
        folder.note_waiting(&orders);
    }
}

/// Computes an order, and keeps its checkpoint and its result in the folder.
fn run_order(
    order: &EstimateOrder,
    entry: &ActivityHandle,
    cancel: &CancelToken,
    mailbox: &Mailbox<EstimateQueue>,
) -> EstimateAnswer {
    let folder = mailbox.look(|queue| queue.folder().cloned());
    let keep = folder.as_ref().and_then(|folder| folder.begin(order));
    // The order no longer waits.
    write_waiting(mailbox);
    let is_kept = keep.is_some();
    let request = EstimateRequest { keep, ..order.request.clone() };
    let result = compute(order, &request, &mut reporter(order, entry, cancel, mailbox));
    let is_left = result.as_ref().is_err_and(|failure| failure.may_pass || mailbox.is_closed());
    let answer = match result {
        Ok(estimate) => {
            let mut summary = estimate.summary();
            let mut finished =
                FinishedEstimate::new(order.clone(), estimate, mailbox.change(EstimateQueue::take_curve));
            if let Some(Err(error)) = folder.as_ref().map(|folder| folder.keep(&mut finished)) {
                summary = format!("{summary}; it is not kept for another day: {error}");
            }
            EstimateAnswer::Finished(Box::new(finished), summary)
        }
        Err(failure) if failure.is_cancelled => EstimateAnswer::Stopped,
        Err(Failure { message, may_pass: true, .. }) if is_kept => EstimateAnswer::Failed(format!(
            "{message}; the estimate goes on in the next window, or when it is started again"
        )),
        Err(Failure { message, .. }) => EstimateAnswer::Failed(message),
    };
    match folder {
        // An order that the end of the program interrupts, or a missing file, is left for the next session.
        Some(folder) if is_left => folder.leave(),
        Some(folder) => folder.end(),
        None => {}
    }
    answer
}

/// Receives the progress of an order, and passes on each new step, and the progress of a step from time to time.
fn reporter<'a>(
    order: &'a EstimateOrder,
    entry: &'a ActivityHandle,
    cancel: &'a CancelToken,
    mailbox: &'a Mailbox<EstimateQueue>,
) -> impl FnMut(&EstimateProgress) -> ControlFlow<()> + Send + 'a {
    let began = Instant::now();
    let (mut reported, mut step) = (began, String::new());
    move |progress| {
        let is_new = step_of(&progress.step) != step;
        if (is_new || reported.elapsed() >= REPORT_EVERY) && !cancel.is_cancelled() {
            reported = Instant::now();
            step_of(&progress.step).clone_into(&mut step);
            write_waiting(mailbox);
            let share = progress.done as f64 / progress.total.max(1) as f64;
            entry.report(&progress.step, Some(share), order.request.time_left(began.elapsed(), share));
            mailbox.publish(|queue| queue.report(progress));
        }
        cancel.check()
    }
}

fn compute(
    EstimateOrder { design, measured, .. }: &EstimateOrder,
    request: &EstimateRequest,
    progress: &mut (dyn Progress<EstimateProgress> + Send),
) -> Result<Estimate, Failure> {
    match measured {
        Some(measured) => measured.estimate(request, design.noise, design.seed, progress).map_err(|error| Failure {
            message: error.to_string(),
            is_cancelled: error.is_cancelled(),
            may_pass: error.may_pass(),
        }),
        None => estimate(design, request, progress).map_err(|error| Failure {
            message: error.to_string(),
            is_cancelled: error.is_cancelled(),
            may_pass: error.may_pass(),
        }),
    }
}
