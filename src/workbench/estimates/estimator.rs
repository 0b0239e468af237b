//! The thread of long estimates.

use std::path::Path;
use std::sync::Arc;

use crate::formats::{FormatError, create_folder};
use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{Computation, Mailbox, MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::estimates::computation::EstimateComputation;
use crate::workbench::estimates::files::{EstimateFolder, EstimateOrder, FinishedEstimate};
use crate::workbench::estimates::queue::{EstimateQueue, Estimates};

/// Handle of the thread. Dropping it stops the current estimate and waits for its last step.
pub(crate) struct Estimator {
    thread: MailboxThread<EstimateQueue>,
}

impl Estimator {
    /// Starts the thread.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start(wake: Wake, threads: Threads, activities: Activities) -> std::io::Result<Self> {
        Self::start_with(wake, threads, activities, EstimateComputation::default)
    }

    /// Starts the thread with another computation.
    fn start_with<C: Computation<EstimateQueue>>(
        wake: Wake,
        threads: Threads,
        activities: Activities,
        make: impl Fn() -> C + Send + 'static,
    ) -> std::io::Result<Self> {
        let settings = ThreadSettings { name: "lenslet-estimator", work: Work::Estimate, threads, wake };
        Ok(Self { thread: MailboxThread::start(settings, EstimateQueue::new(activities), make)? })
    }

    /// The mailbox, for designs whose live estimate is wanted.
    pub fn mailbox(&self) -> Arc<Mailbox<EstimateQueue>> {
        self.thread.mailbox()
    }

    /// Stops the current estimate and ends the thread, without waiting for it.
    pub fn close(&self) {
        self.thread.close();
    }

    /// Stores orders in a folder. Existing orders are loaded outside the window's thread, and the interrupted one resumes.
    ///
    /// # Errors
    /// Where the folder cannot be created.
    pub fn keep_in(&self, folder: &Path) -> Result<(), FormatError> {
        create_folder(folder)?;
        self.thread.change(|queue| queue.read(folder.to_path_buf()));
        Ok(())
    }

    /// Whether the next session can resume the running order.
    pub fn keeps_orders(&self) -> bool {
        self.thread.look(|queue| queue.folder().is_some_and(EstimateFolder::keeps_orders))
    }

    /// Deletes a finished order and its file; it can be [brought back](Estimator::bring_back).
    pub fn delete(&self, finished: &Arc<FinishedEstimate>) {
        self.thread.change(|queue| queue.delete(finished));
    }

    /// Restores the finished order that was deleted last to its place.
    pub fn bring_back(&self) {
        self.thread.change(EstimateQueue::bring_back);
    }

    /// Notes a newer design, which makes the present live estimate useless.
    pub fn supersede(&self, revision: u64) {
        self.thread.change(|queue| queue.supersede(revision));
    }

    /// Whether live estimates are computed.
    pub fn is_live(&self) -> bool {
        self.thread.look(EstimateQueue::is_live)
    }

    /// Switches live estimates on or off.
    pub fn set_live(&self, live: bool) {
        self.thread.change(|queue| queue.set_live(live));
    }

    /// Pauses live estimates while something more important computes.
    pub fn hold(&self, hold: bool) {
        if self.thread.look(EstimateQueue::is_held) != hold {
            self.thread.change(|queue| queue.hold(hold));
        }
    }

    /// Orders an estimate; it is computed after earlier orders.
    ///
    /// # Errors
    /// One sentence where too many orders wait.
    pub fn order(&self, order: EstimateOrder) -> Result<(), String> {
        self.thread.change(|queue| queue.order(order))
    }

    /// Stops the running order.
    pub fn cancel(&self) {
        self.thread.change(EstimateQueue::cancel);
    }

    /// Stops the order of this number in the list of activities, whether it is running or waiting.
    pub fn cancel_numbered(&self, number: u64) {
        self.thread.change(|queue| queue.cancel_numbered(number));
    }

    /// A copy of all estimates.
    pub fn estimates(&self) -> Estimates {
        self.thread.look(|queue| queue.estimates().clone())
    }
}
