//! The thread of trainings.

use std::path::Path;
use std::sync::Arc;

use crate::reconstruction::TrainedNetwork;
use crate::workbench::background::activity::Activities;
use crate::workbench::background::mailbox::{Computation, MailboxThread, ThreadSettings};
use crate::workbench::background::threads::{Threads, Wake, Work};
use crate::workbench::reconstructions::networks::KnownNetwork;
use crate::workbench::trainings::computation;
use crate::workbench::trainings::queue::{TrainingOrder, TrainingQueue, Trainings};

/// Handle of the thread. Dropping it stops the training.
pub(crate) struct Trainer {
    thread: MailboxThread<TrainingQueue>,
}

impl Trainer {
    /// Starts the thread.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start(wake: Wake, threads: Threads, activities: Activities) -> std::io::Result<Self> {
        Self::start_with(wake, threads, activities, || computation::run)
    }

    /// Starts the thread with another computation.
    fn start_with<C: Computation<TrainingQueue>>(
        wake: Wake,
        threads: Threads,
        activities: Activities,
        make: impl Fn() -> C + Send + 'static,
    ) -> std::io::Result<Self> {
        let settings = ThreadSettings { name: "lenslet-trainer", work: Work::Training, threads, wake };
        Ok(Self { thread: MailboxThread::start(settings, TrainingQueue::new(activities), make)? })
    }

    /// Orders a training.
    ///
    /// # Errors
    /// One sentence where one is active.
    pub fn order(&self, order: TrainingOrder) -> Result<(), String> {
        self.thread.change(|queue| queue.order(order))
    }

    /// Pauses or resumes the training.
    pub fn pause(&self, pause: bool) {
        self.thread.publish(|queue| queue.pause(pause));
    }

    /// Stops the training. The best weights so far are kept.
    pub fn stop(&self) {
        self.thread.publish(TrainingQueue::stop);
    }

    /// Adds a network that was read from a file.
    pub fn add(&self, known: KnownNetwork) {
        self.thread.publish(|queue| queue.networks_mut().add(known));
    }

    /// Notes the file of a network.
    pub fn note_file(&self, network: &Arc<TrainedNetwork>, path: &Path) {
        self.thread.change(|queue| queue.networks_mut().note_file(network, path));
    }

    /// The present or last training, and the networks.
    pub fn trainings(&self) -> Trainings {
        self.thread.look(|queue| queue.trainings().clone())
    }

    /// Looks at the networks and at the training.
    pub fn look<R>(&self, look: impl FnOnce(&Trainings) -> R) -> R {
        self.thread.look(|queue| look(queue.trainings()))
    }
}
