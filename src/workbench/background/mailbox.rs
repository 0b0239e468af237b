//! A named thread with a mailbox: it takes tasks from a queue and hands them to a computation.
//!
//! The queue decides which task comes next and which running task is cancelled. It knows no threads, so that plain calls test it. The
//! computation is given at the start: the real one in the program, another one in tests.

use std::ops::{ControlFlow, Deref};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use crate::progress::CancelToken;
use crate::workbench::background::threads::{SpareCores, Threads, Wake, Work, lock};

/// Tasks of a thread, with their results.
pub(crate) trait Queue: Send + 'static {
    /// One piece of work.
    type Task: Send + Sync;
    /// Result of a task.
    type Answer: Send;

    /// Takes the next task; none while there is nothing to do. A queue that cancels single tasks keeps `cancel` until the task ends.
    fn next(&mut self, cancel: &CancelToken) -> Option<Self::Task>;

    /// Receives the answer to the running task, or the message of its panic.
    fn end(&mut self, task: Self::Task, answer: Result<Self::Answer, String>);

    /// Drops the tasks that are not computed any more once the program ends. The thread computes the remaining ones.
    fn close(&mut self);
}

/// Computes the tasks of a queue, one at a time. Closures of this signature are one.
pub(crate) trait Computation<Q: Queue>: Send {
    /// Computes a task, and ends early once `cancel` is cancelled.
    fn run(&mut self, task: &Q::Task, cancel: &CancelToken, mailbox: &Mailbox<Q>) -> Q::Answer;
}

impl<Q, F> Computation<Q> for F
where
    Q: Queue,
    F: FnMut(&Q::Task, &CancelToken, &Mailbox<Q>) -> Q::Answer + Send,
{
    fn run(&mut self, task: &Q::Task, cancel: &CancelToken, mailbox: &Mailbox<Q>) -> Q::Answer {
        self(task, cancel, mailbox)
    }
}

/// The queue that a thread, its computation and the window share.
pub(crate) struct Mailbox<Q> {
    queue: Mutex<Q>,
    changed: Condvar,
    /// Parent of the tokens of all tasks; cancelled when the program ends.
    closed: CancelToken,
    wake: Wake,
}

impl<Q: Queue> Mailbox<Q> {
    /// Looks at the queue.
    pub fn look<R>(&self, look: impl FnOnce(&Q) -> R) -> R {
        look(&lock(&self.queue))
    }

    /// Changes the queue and wakes the thread.
    pub fn change<R>(&self, change: impl FnOnce(&mut Q) -> R) -> R {
        let result = change(&mut lock(&self.queue));
        self.changed.notify_all();
        result
    }

    /// Changes the queue, and wakes the thread and the window.
    pub fn publish<R>(&self, change: impl FnOnce(&mut Q) -> R) -> R {
        let result = self.change(change);
        self.wake();
        result
    }

    /// Wakes the window.
    pub fn wake(&self) {
        (self.wake)();
    }

    /// Waits in a computation while a condition holds; `Break` once `cancel` is cancelled.
    pub fn wait_while(&self, cancel: &CancelToken, mut is_waiting: impl FnMut(&mut Q) -> bool) -> ControlFlow<()> {
        let mut queue = lock(&self.queue);
        while !cancel.is_cancelled() && is_waiting(&mut queue) {
            queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        cancel.check()
    }

    /// Whether the program ends.
    pub fn is_closed(&self) -> bool {
        self.closed.is_cancelled()
    }

    /// Cancels the running task and ends the thread after the tasks that are still to be computed.
    pub fn close(&self) {
        self.change(|queue| {
            self.closed.cancel();
            queue.close();
        });
    }

    /// Waits for the next task and returns it with its token; none ends the thread.
    fn take(&self) -> Option<(Q::Task, CancelToken)> {
        let mut queue = lock(&self.queue);
        loop {
            let cancel = self.closed.child();
            if let Some(task) = queue.next(&cancel) {
                return Some((task, cancel));
            }
            if self.is_closed() {
                return None;
            }
            queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// How a thread is named and which cores it uses.
pub(crate) struct ThreadSettings {
    /// Name of the thread.
    pub name: &'static str,
    /// Kind of its computations.
    pub work: Work,
    /// Number of cores.
    pub threads: Threads,
    /// Notifies the window.
    pub wake: Wake,
}

/// Handle of a thread and access to its [`Mailbox`]. Dropping it closes the mailbox and waits for the end of the thread.
pub(crate) struct MailboxThread<Q: Queue> {
    mailbox: Arc<Mailbox<Q>>,
    thread: Option<JoinHandle<()>>,
}

impl<Q: Queue> MailboxThread<Q> {
    /// Starts a thread. `make` makes the computation, and another one after a panic, which may leave parts of the last one incomplete.
    ///
    /// # Errors
    /// Where the operating system gives no thread.
    pub fn start<C: Computation<Q>>(
        ThreadSettings { name, work, threads, wake }: ThreadSettings,
        queue: Q,
        make: impl Fn() -> C + Send + 'static,
    ) -> std::io::Result<Self> {
        let mailbox =
            Arc::new(Mailbox { queue: Mutex::new(queue), changed: Condvar::new(), closed: CancelToken::new(), wake });
        let own = Arc::clone(&mailbox);
        let thread = std::thread::Builder::new().name(name.into()).spawn(move || {
            let mut cores = SpareCores::new(work, threads);
            let mut computation = make();
            while let Some((task, cancel)) = own.take() {
                let answer = cores.run(|| computation.run(&task, &cancel, &own));
                if answer.is_err() {
                    computation = make();
                }
                own.publish(|queue| queue.end(task, answer));
            }
        })?;
        Ok(Self { mailbox, thread: Some(thread) })
    }

    /// The mailbox, for other threads.
    pub fn mailbox(&self) -> Arc<Mailbox<Q>> {
        Arc::clone(&self.mailbox)
    }

    /// Closes the mailbox and waits for the end of the thread.
    pub fn finish(&mut self) {
        self.mailbox.close();
        if let Some(thread) = self.thread.take() {
            // The thread catches the panics of computations, so joining fails only where the system killed it.
            let _ = thread.join();
        }
    }
}

impl<Q: Queue> Deref for MailboxThread<Q> {
    type Target = Mailbox<Q>;

    fn deref(&self) -> &Mailbox<Q> {
        &self.mailbox
    }
}

impl<Q: Queue> Drop for MailboxThread<Q> {
    fn drop(&mut self) {
        self.finish();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;

    /// Names, first come first served.
    #[derive(Default)]
    struct Names {
        waiting: Vec<&'static str>,
        running: Option<CancelToken>,
        is_paused: bool,
        ended: Vec<(&'static str, Result<usize, String>)>,
    }

    impl Queue for Names {
        type Task = &'static str;
        type Answer = usize;

        fn next(&mut self, cancel: &CancelToken) -> Option<&'static str> {
            let next = (!self.waiting.is_empty()).then(|| self.waiting.remove(0));
            self.running = next.map(|_| cancel.clone());
            next
        }

        fn end(&mut self, task: &'static str, answer: Result<usize, String>) {
            self.running = None;
            self.ended.push((task, answer));
        }

        fn close(&mut self) {
            self.waiting.retain(|name| *name == "save");
        }
    }

    fn settings(wake: impl Fn() + Send + Sync + 'static) -> ThreadSettings {
        ThreadSettings {
            name: "test-mailbox",
            work: Work::Computation,
            threads: Threads::default(),
            wake: Arc::new(wake),
        }
    }

    /// A thread whose computation reports every task it begins, and continues with each message.
    struct Fixture {
        thread: MailboxThread<Names>,
        begun: Receiver<&'static str>,
        go_on: Sender<()>,
        woken: Receiver<()>,
    }

    fn fixture() -> Fixture {
        let (begin, begun) = channel();
        let (go_on, resumed) = channel();
        let (wake, woken) = channel();
        let resumed = Arc::new(Mutex::new(resumed));
        let make = move || {
            let (begin, resumed) = (begin.clone(), Arc::clone(&resumed));
            let mut count = 0;
            move |name: &&'static str, cancel: &CancelToken, mailbox: &Mailbox<Names>| {
                begin.send(*name).unwrap();
                match *name {
                    "panic" => panic!("no light"),
                    "until cancelled" => {
                        assert!(mailbox.wait_while(cancel, |_| true).is_break());
                        return 0;
                    }
                    "until resumed" => assert!(mailbox.wait_while(cancel, |names| names.is_paused).is_continue()),
                    _ => lock(&resumed).recv().unwrap(),
                }
                count += 1;
                count
            }
        };
        let wake = Mutex::new(wake);
        let settings = settings(move || lock(&wake).send(()).unwrap_or_default());
        Fixture { thread: MailboxThread::start(settings, Names::default(), make).unwrap(), begun, go_on, woken }
    }

    impl Fixture {
        fn add(&self, names: &[&'static str]) {
            self.thread.change(|queue| queue.waiting.extend(names));
        }

        /// Waits for the end of a task and returns all answers so far.
        fn ended(&self) -> Vec<(&'static str, Result<usize, String>)> {
            self.woken.recv().unwrap();
            self.thread.look(|queue| queue.ended.clone())
        }
    }

    #[test]
    fn tasks_are_computed_one_after_the_other_with_one_computation() {
        let fixture = fixture();
        fixture.add(&["one", "two"]);
        assert_eq!(fixture.begun.recv().unwrap(), "one");
        assert_eq!(fixture.thread.look(|queue| (queue.waiting.clone(), queue.ended.len())), (vec!["two"], 0));
        fixture.go_on.send(()).unwrap();
        assert_eq!(fixture.ended(), [("one", Ok(1))]);
        fixture.go_on.send(()).unwrap();
        assert_eq!(fixture.ended(), [("one", Ok(1)), ("two", Ok(2))]);
        assert!(fixture.thread.look(|queue| queue.running.is_none()));
    }

    #[test]
    fn panic_is_an_answer_and_computation_is_made_again() {
        let fixture = fixture();
        fixture.go_on.send(()).unwrap();
        fixture.go_on.send(()).unwrap();
        fixture.add(&["one", "panic", "two"]);
        fixture.ended();
        fixture.ended();
        let ended = fixture.ended();
        let message = "an internal error stopped this computation: no light";
        assert_eq!(ended, [("one", Ok(1)), ("panic", Err(message.into())), ("two", Ok(1))]);
    }

    #[test]
    fn cancel_ends_running_task_only() {
        let fixture = fixture();
        fixture.add(&["until cancelled", "two"]);
        assert_eq!(fixture.begun.recv().unwrap(), "until cancelled");
        fixture.thread.change(|queue| queue.running.as_ref().unwrap().cancel());
        assert_eq!(fixture.ended(), [("until cancelled", Ok(0))]);
        fixture.go_on.send(()).unwrap();
        assert_eq!(fixture.ended()[1], ("two", Ok(1)));
    }

    #[test]
    fn paused_task_waits_until_it_is_resumed() {
        let fixture = fixture();
        fixture.thread.change(|queue| queue.is_paused = true);
        fixture.add(&["until resumed"]);
        assert_eq!(fixture.begun.recv().unwrap(), "until resumed");
        assert!(fixture.thread.look(|queue| queue.ended.is_empty()));
        fixture.thread.change(|queue| queue.is_paused = false);
        assert_eq!(fixture.ended(), [("until resumed", Ok(1))]);
    }

    #[test]
    fn drop_cancels_running_task_and_computes_only_what_close_leaves() {
        let fixture = fixture();
        fixture.go_on.send(()).unwrap();
        fixture.add(&["until cancelled", "one", "save"]);
        assert_eq!(fixture.begun.recv().unwrap(), "until cancelled");
        let mailbox = fixture.thread.mailbox();
        assert!(!mailbox.is_closed());
        drop(fixture.thread);
        assert!(mailbox.is_closed());
        assert_eq!(mailbox.look(|queue| queue.ended.clone()), [("until cancelled", Ok(0)), ("save", Ok(1))]);
    }
}
