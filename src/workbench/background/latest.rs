//! A thread whose newest order replaces earlier ones. Its results stay until the next order changes them.

use std::ops::ControlFlow;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::progress::CancelToken;
use crate::workbench::background::activity::{Activities, ActivityHandle, ActivityKind};
use crate::workbench::background::mailbox::{Mailbox, MailboxThread, Queue, ThreadSettings};
use crate::workbench::background::threads::lock;

/// Time between two frames of the window for steps.
const WAKE_EVERY: Duration = Duration::from_millis(100);

/// An order that computes itself.
pub(crate) trait Order: Send + Sync + Sized + 'static {
    /// The results.
    type Results: Clone + Default + Send + 'static;

    /// Kind and name in the list of activities; `None` for an order that takes no time.
    fn activity(&self) -> Option<(ActivityKind, String)>;

    /// Computes the order and publishes its results.
    ///
    /// # Errors
    /// One sentence; that of a cancelled order is dropped.
    fn run(&self, work: &Work<'_, Self>) -> Result<(), String>;
}

/// State of the newest order.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum WorkState {
    /// Nothing is computed.
    #[default]
    Idle,
    /// It waits or is computed.
    Working {
        /// The current step, for people.
        step: String,
        /// Share of it that is done, 0 to 1, where it is known.
        share: Option<f64>,
    },
    /// It failed, for this reason.
    Failed(String),
}

impl WorkState {
    /// Whether an order waits or is computed.
    pub fn is_working(&self) -> bool {
        matches!(self, Self::Working { .. })
    }
}

/// The newest order and the results so far.
pub(crate) struct LatestQueue<O: Order> {
    activities: Activities,
    waiting: Option<(O, Option<ActivityHandle>)>,
    running: Option<CancelToken>,
    state: WorkState,
    results: O::Results,
}

impl<O: Order> LatestQueue<O> {
    fn order(&mut self, order: O) {
        self.cancel();
        let entry = order.activity().map(|(kind, name)| self.activities.add(kind, name));
        self.state = WorkState::Working { step: "Waiting".into(), share: None };
        self.waiting = Some((order, entry));
    }

    fn cancel(&mut self) {
        if let Some(cancel) = &self.running {
            cancel.cancel();
        }
        self.waiting = None;
        if self.state.is_working() {
            self.state = WorkState::Idle;
        }
    }
}

impl<O: Order> Queue for LatestQueue<O> {
    type Task = (O, Option<ActivityHandle>);
    type Answer = Result<(), String>;

    fn next(&mut self, cancel: &CancelToken) -> Option<Self::Task> {
        let (order, entry) = self.waiting.take()?;
        if let Some(entry) = &entry {
            entry.begin();
        }
        self.running = Some(cancel.clone());
        Some((order, entry))
    }

    fn end(&mut self, (_, entry): Self::Task, answer: Result<Self::Answer, String>) {
        let was_cancelled = self.running.take().is_none_or(|cancel| cancel.is_cancelled());
        if was_cancelled {
            // The dropped entry counts as stopped.
            return;
        }
        let answer = answer.and_then(|answer| answer);
        self.state = answer.clone().map_or_else(WorkState::Failed, |()| WorkState::Idle);
        if let Some(entry) = entry {
            entry.end(answer.map(|()| "done".into()));
        }
    }

    fn close(&mut self) {
        self.waiting = None;
    }
}

/// A running order: it receives reports and results.
pub(crate) struct Work<'a, O: Order> {
    cancel: &'a CancelToken,
    mailbox: &'a Mailbox<LatestQueue<O>>,
    entry: Option<&'a ActivityHandle>,
    woken: Mutex<Instant>,
}

impl<O: Order> Work<'_, O> {
    /// Reports a step, and whether the computation goes on.
    pub fn report(&self, step: &str, share: Option<f64>) -> ControlFlow<()> {
        if let Some(entry) = self.entry {
            entry.report(step, share, None);
        }
        self.mailbox.change(|queue| {
            if !self.cancel.is_cancelled() {
                queue.state = WorkState::Working { step: step.to_owned(), share };
            }
        });
        let mut woken = lock(&self.woken);
        if woken.elapsed() >= WAKE_EVERY {
            *woken = Instant::now();
            self.mailbox.wake();
        }
        self.cancel.check()
    }

    /// Changes the results, unless the order is cancelled.
    pub fn publish(&self, change: impl FnOnce(&mut O::Results)) {
        self.mailbox.publish(|queue| {
            if !self.cancel.is_cancelled() {
                change(&mut queue.results);
            }
        });
    }
}

/// Handle of the thread. Dropping it cancels the running order.
pub(crate) struct LatestThread<O: Order> {
    thread: MailboxThread<LatestQueue<O>>,
}

impl<O: Order> LatestThread<O> {
    /// Starts the thread.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start(settings: ThreadSettings, activities: Activities) -> std::io::Result<Self> {
        let (state, results) = (WorkState::Idle, O::Results::default());
        let queue = LatestQueue { activities, waiting: None, running: None, state, results };
        let compute =
            |(order, entry): &(O, Option<ActivityHandle>), cancel: &CancelToken, mailbox: &Mailbox<LatestQueue<O>>| {
                order.run(&Work { cancel, mailbox, entry: entry.as_ref(), woken: Mutex::new(Instant::now()) })
            };
        Ok(Self { thread: MailboxThread::start(settings, queue, move || compute)? })
    }

    /// Gives an order in place of earlier ones.
    pub fn order(&self, order: O) {
        self.thread.publish(|queue| queue.order(order));
    }

    /// Shows results of an earlier session.
    pub fn restore(&self, results: O::Results) {
        self.thread.publish(|queue| queue.results = results);
    }

    /// Cancels the running and drops the waiting order. Results so far stay.
    pub fn cancel(&self) {
        self.thread.publish(LatestQueue::cancel);
    }

    /// State of the newest order.
    pub fn state(&self) -> WorkState {
        self.thread.look(|queue| queue.state.clone())
    }

    /// The results so far.
    pub fn results(&self) -> O::Results {
        self.thread.look(|queue| queue.results.clone())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::mpsc::{Receiver, channel};

    use super::*;
    use crate::workbench::background::activity::ActivityState;
    use crate::workbench::background::threads::{Threads, Work as Kind};

    /// Appends its name, after it was cancelled where it is endless.
    struct Named(&'static str);

    impl Order for Named {
        type Results = Vec<&'static str>;

        fn activity(&self) -> Option<(ActivityKind, String)> {
            Some((ActivityKind::Comparison, self.0.to_owned()))
        }

        fn run(&self, work: &Work<'_, Self>) -> Result<(), String> {
            work.publish(|names| names.push(self.0));
            match self.0 {
                "endless" => {
                    while work.report("turning", Some(0.5)).is_continue() {
                        std::thread::yield_now();
                    }
                    work.publish(|names| names.push("too late"));
                    Err("was cancelled".into())
                }
                "broken" => Err("no light".into()),
                _ => Ok(()),
            }
        }
    }

    fn start() -> (LatestThread<Named>, Activities, Receiver<()>) {
        let (wake, woken) = channel();
        let wake = Mutex::new(wake);
        let settings = ThreadSettings {
            name: "test-latest",
            work: Kind::Computation,
            threads: Threads::default(),
            wake: Arc::new(move || lock(&wake).send(()).unwrap_or_default()),
        };
        let activities = Activities::default();
        (LatestThread::start(settings, activities.clone()).unwrap(), activities, woken)
    }

    fn wait(thread: &LatestThread<Named>, woken: &Receiver<()>, wanted: impl Fn(&LatestThread<Named>) -> bool) {
        while !wanted(thread) {
            woken.recv().unwrap();
        }
    }

    #[test]
    fn newest_order_replaces_the_running_one() {
        let (thread, activities, woken) = start();
        thread.order(Named("endless"));
        wait(&thread, &woken, |thread| thread.results() == ["endless"]);
        assert!(thread.state().is_working());
        thread.order(Named("one"));
        wait(&thread, &woken, |thread| !thread.state().is_working());
        assert_eq!(thread.results(), ["endless", "one"], "a cancelled order publishes nothing");
        assert_eq!(activities.all()[0].state, ActivityState::Stopped);
        assert_eq!(activities.all()[1].state, ActivityState::Done("done".into()));
    }

    #[test]
    fn failure_is_one_sentence_and_the_next_order_works() {
        let (thread, activities, woken) = start();
        thread.order(Named("broken"));
        wait(&thread, &woken, |thread| thread.state() == WorkState::Failed("no light".into()));
        assert_eq!(activities.all()[0].state, ActivityState::Failed("no light".into()));
        thread.order(Named("endless"));
        wait(&thread, &woken, |thread| thread.results().len() == 2);
        thread.cancel();
        assert_eq!(thread.state(), WorkState::Idle, "a cancelled order has ended for the window");
        thread.order(Named("one"));
        wait(&thread, &woken, |thread| !thread.state().is_working());
        assert_eq!(thread.results(), ["broken", "endless", "one"]);
    }
}
