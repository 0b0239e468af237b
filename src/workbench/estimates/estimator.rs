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

    /// Sets the divisor of the times in the schedule of live estimates, from the next one on.
    pub fn set_live_speed(&self, speed: f64) {
        self.thread.change(|queue| queue.set_live_speed(speed));
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

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::mpsc::{Receiver, channel};

    use super::*;
    use crate::evaluation::request::EstimateRequest;
    use crate::forward::Design;
    use crate::progress::CancelToken;
    use crate::workbench::background::activity::ActivityState;
    use crate::workbench::background::threads::lock;
    use crate::workbench::estimates::queue::{EstimateAnswer, EstimateTask};

    /// An estimator whose orders wait until they are cancelled, and the numbers of the orders that began.
    fn endless(activities: &Activities) -> (Estimator, Receiver<u64>) {
        let (begin, begun) = channel();
        let make = move || {
            let (begin, mut real) = (begin.clone(), EstimateComputation::default());
            move |task: &EstimateTask, cancel: &CancelToken, mailbox: &Mailbox<EstimateQueue>| match task {
                EstimateTask::Order(_, entry) => {
                    begin.send(entry.number()).unwrap();
                    assert!(mailbox.wait_while(cancel, |_| true).is_break());
                    EstimateAnswer::Stopped
                }
                other => real.run(other, cancel, mailbox),
            }
        };
        let estimator = Estimator::start_with(Arc::new(|| ()), Threads::default(), activities.clone(), make);
        (estimator.unwrap(), begun)
    }

    fn order() -> EstimateOrder {
        let (design, request) = (Arc::new(Design::default()), EstimateRequest::default());
        EstimateOrder { design, revision: 1, request, measured: None }
    }

    #[test]
    fn stopped_order_gives_way_to_the_next_and_drop_leaves_the_waiting_ones_in_their_file() {
        let folder = tempfile::tempdir().unwrap();
        let activities = Activities::default();
        let (estimator, begun) = endless(&activities);
        estimator.keep_in(folder.path()).unwrap();
        for _ in 0..3 {
            estimator.order(order()).unwrap();
        }
        assert_eq!(begun.recv().unwrap(), 1);
        estimator.cancel();
        assert_eq!(begun.recv().unwrap(), 2);
        assert_eq!(activities.all()[0].state, ActivityState::Stopped);
        drop(estimator);
        let waiting = EstimateFolder::open(folder.path().to_path_buf()).waiting();
        assert_eq!((waiting.len(), waiting[0].name()), (1, order().name()));
        assert!(activities.all().iter().all(|activity| activity.state == ActivityState::Stopped));
        // The next session begins with the order that waited.
        let (estimator, begun) = endless(&Activities::default());
        estimator.keep_in(folder.path()).unwrap();
        assert_eq!(begun.recv().unwrap(), 1);
    }

    #[test]
    fn window_is_woken_after_every_task() {
        let (wake, woken) = channel();
        let wake = Mutex::new(wake);
        let wake: Wake = Arc::new(move || lock(&wake).send(()).unwrap_or_default());
        let make = || {
            |_: &EstimateTask, _: &CancelToken, _: &Mailbox<EstimateQueue>| EstimateAnswer::Failed("too bright".into())
        };
        let activities = Activities::default();
        let estimator = Estimator::start_with(wake, Threads::default(), activities.clone(), make).unwrap();
        estimator.order(order()).unwrap();
        woken.recv().unwrap();
        assert_eq!(activities.all()[0].state, ActivityState::Failed("too bright".into()));
        assert!(estimator.estimates().running.is_none());
    }
}
