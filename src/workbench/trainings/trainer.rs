//! The thread of trainings.

use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::trainings::computation;
use crate::workbench::trainings::queue::TrainingQueue;

/// Starts the thread. Dropping it stops the training.
///
/// # Errors
/// Where the operating system gives no thread.
pub(crate) fn start(
    wake: Wake,
    threads: Threads,
    activities: Activities,
) -> std::io::Result<MailboxThread<TrainingQueue>> {
    let settings = ThreadSettings { name: "lenslet-trainer", work: Work::Training, threads, wake };
    MailboxThread::start(settings, TrainingQueue::new(activities), || computation::run)
}
