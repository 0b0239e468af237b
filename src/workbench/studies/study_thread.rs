//! The thread of the study.

use std::path::PathBuf;

use crate::studies::plans::Plan;
use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::studies::computation;
use crate::workbench::studies::queue::{StudyQueue, StudyView};

/// Handle of the thread. Dropping it stops the study.
pub(crate) struct StudyThread {
    thread: MailboxThread<StudyQueue>,
}

impl StudyThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start(wake: Wake, threads: Threads, activities: Activities) -> std::io::Result<Self> {
        let settings = ThreadSettings { name: "lenslet-study", work: Work::Study, threads, wake };
        Ok(Self { thread: MailboxThread::start(settings, StudyQueue::new(activities), || computation::run)? })
    }

    /// Opens the study of a folder, or begins a plan there.
    ///
    /// # Errors
    /// One sentence where a study is running.
    pub fn open(&self, plan: Option<Plan>, path: PathBuf) -> Result<(), String> {
        self.thread.change(|queue| queue.open(plan.map(Box::new), path))
    }

    /// Computes the cells without a result.
    pub fn start_cells(&self) {
        self.thread.publish(StudyQueue::start);
    }

    /// Pauses or resumes the study.
    pub fn pause(&self, pause: bool) {
        self.thread.publish(|queue| queue.pause(pause));
    }

    /// Stops the study. Finished cells stay in the folder.
    pub fn stop(&self) {
        self.thread.publish(StudyQueue::stop);
    }

    /// What the window shows.
    pub fn view(&self) -> StudyView {
        self.thread.look(|queue| queue.view().clone())
    }
}
