//! The thread of the study.

use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::studies::computation;
use crate::workbench::studies::queue::StudyQueue;

/// Starts the thread. Dropping it stops the study.
///
/// # Errors
/// Where the operating system gives no thread.
pub(crate) fn start(
    wake: Wake,
    threads: Threads,
    activities: Activities,
) -> std::io::Result<MailboxThread<StudyQueue>> {
    let settings = ThreadSettings { name: "lenslet-study", work: Work::Study, threads, wake };
    MailboxThread::start(settings, StudyQueue::new(activities), || computation::run)
}
