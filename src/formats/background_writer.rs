//! A background thread that writes files atomically. It writes the newest content of each file, and repeats failed
//! writes.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::{FormatError, remove_if_there, write_safely};

/// Function that makes the content of a file, on the writing thread. `None` leaves the file unchanged.
pub type FileContent = Box<dyn FnOnce() -> Option<Vec<u8>> + Send>;
/// Function that runs on the writing thread once the request is fulfilled.
pub type AfterWrite = Box<dyn FnOnce() + Send>;

/// Time after which a failed write is repeated.
const RETRY_AFTER: Duration = Duration::from_secs(5);

/// Requested content of a file.
enum Content {
    Make(FileContent),
    /// Content made but not yet written, because an earlier attempt failed.
    Made(Vec<u8>),
    Removed,
}

/// A file to be written or removed.
struct Task {
    content: Content,
    then: Option<AfterWrite>,
    /// Earliest time of the task.
    due: Option<Instant>,
    /// Time of the first request for this file that is not fulfilled yet.
    since: Instant,
}

/// Data shared by the thread and its owner.
#[derive(Default)]
struct Queue {
    /// The newest task of each file.
    tasks: BTreeMap<PathBuf, Task>,
    /// Whether a file is being written.
    busy: bool,
    stop: bool,
    /// Time of the last write.
    written: Option<Instant>,
    /// Reason why the last write failed, until it is taken.
    failure: Option<String>,
    /// The last reported failure, so that it is reported only once.
    reported: Option<String>,
}

/// Next step of the thread.
enum Next {
    Do(PathBuf, Task),
    Wait(Option<Duration>),
    End,
}

impl Queue {
    /// The next task at a time. After the last task the thread ends, if that was requested.
    fn next(&mut self, now: Instant, every: Duration) -> Next {
        let paced = self.written.map(|at| at + every);
        let due = |task: &Task| match task.content {
            Content::Removed => task.due,
            Content::Make(_) | Content::Made(_) => task.due.max(paced),
        };
        // Of those that are due together, the one that has waited longest: a file that changes all the time delays no other.
        let soonest = self.tasks.iter().min_by_key(|(_, task)| (due(task), task.since));
        let soonest = soonest.map(|(path, task)| (path.clone(), due(task)));
        match soonest {
            None if self.stop => Next::End,
            None => Next::Wait(None),
            Some((path, due)) => match due.filter(|&due| due > now && !self.stop) {
                Some(due) => Next::Wait(Some(due - now)),
                None => self.tasks.remove(&path).map_or(Next::Wait(None), |task| Next::Do(path, task)),
            },
        }
    }

    /// Takes a task, in place of an earlier one of its file.
    fn put(&mut self, path: PathBuf, task: Task) {
        let since = self.tasks.get(&path).map_or(task.since, |earlier| earlier.since);
        self.tasks.insert(path, Task { since, ..task });
    }

    /// Records the result of a task at a time. A failed task stays, unless its file has a newer task or no time is left.
    fn note(&mut self, path: PathBuf, task: Task, error: Option<FormatError>, now: Instant) {
        self.busy = false;
        if matches!(task.content, Content::Make(_) | Content::Made(_)) {
            self.written = Some(now);
        }
        let Some(error) = error else {
            self.reported = None;
            return;
        };
        let reason = error.to_string();
        if self.reported.as_ref() != Some(&reason) {
            self.failure = Some(reason.clone());
            self.reported = Some(reason);
        }
        if !self.stop {
            let retried = Task { due: Some(now + RETRY_AFTER), ..task };
            self.tasks.entry(path).or_insert(retried);
        }
    }
}

impl Task {
    /// Runs the task. Returns the task for a repetition, and the error if it failed.
    fn run(mut self, path: &Path) -> (Self, Option<FormatError>) {
        let done = match std::mem::replace(&mut self.content, Content::Removed) {
            Content::Removed => remove_if_there(path),
            Content::Make(make) => match make() {
                None => Ok(()),
                Some(bytes) => self.write(path, bytes),
            },
            Content::Made(bytes) => self.write(path, bytes),
        };
        if done.is_ok()
            && let Some(then) = self.then.take()
        {
            then();
        }
        (self, done.err())
    }

    fn write(&mut self, path: &Path, bytes: Vec<u8>) -> Result<(), FormatError> {
        let written = write_safely(path, |file| file.write_all(&bytes));
        self.content = Content::Made(if written.is_ok() { Vec::new() } else { bytes });
        written
    }
}

/// Writes and removes files on a thread of its own. Dropping it performs the remaining tasks without delay, and ends the
/// thread.
pub struct FileWriter {
    queue: Arc<(Mutex<Queue>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

impl FileWriter {
    /// A writer with a named thread that writes at most one file per `every`. `on_attempt` is called on that thread after each attempt to
    /// write or remove a file, when [`FileWriter::is_idle`] and [`FileWriter::take_failure`] know of it.
    ///
    /// # Errors
    /// Where the operating system provides no thread.
    pub fn start(name: &str, every: Duration, on_attempt: impl Fn() + Send + 'static) -> io::Result<Self> {
        let queue: Arc<(Mutex<Queue>, Condvar)> = Arc::default();
        let shared = Arc::clone(&queue);
        let thread = std::thread::Builder::new().name(name.into()).spawn(move || work(&shared, every, &on_attempt))?;
        Ok(Self { queue, thread: Some(thread) })
    }

    /// Requests that a file be written soon, in place of its earlier request. `then` runs after the write.
    pub fn write(&self, path: PathBuf, content: FileContent, then: Option<AfterWrite>) {
        self.put(path, Task { content: Content::Make(content), then, due: None, since: Instant::now() });
    }

    /// Requests that a file be removed at once. A missing file is no error.
    pub fn remove(&self, path: PathBuf, then: Option<AfterWrite>) {
        self.put(path, Task { content: Content::Removed, then, due: None, since: Instant::now() });
    }

    fn put(&self, path: PathBuf, task: Task) {
        lock(&self.queue.0).put(path, task);
        self.queue.1.notify_all();
    }

    /// Whether all requests are fulfilled.
    pub fn is_idle(&self) -> bool {
        let queue = lock(&self.queue.0);
        queue.tasks.is_empty() && !queue.busy
    }

    /// Reason why the last write failed, reported once.
    pub fn take_failure(&self) -> Option<String> {
        lock(&self.queue.0).failure.take()
    }
}

impl FileWriter {
    /// Performs the remaining tasks without delay, and ends the thread. Nothing is written after that.
    pub fn finish(&mut self) {
        lock(&self.queue.0).stop = true;
        self.queue.1.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for FileWriter {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Body of the thread.
fn work((queue, changed): &(Mutex<Queue>, Condvar), every: Duration, on_attempt: &dyn Fn()) {
    let mut guard = lock(queue);
    loop {
        match guard.next(Instant::now(), every) {
            Next::End => return,
            Next::Wait(None) => guard = changed.wait(guard).unwrap_or_else(PoisonError::into_inner),
            Next::Wait(Some(time)) => {
                guard = changed.wait_timeout(guard, time).unwrap_or_else(PoisonError::into_inner).0;
            }
            Next::Do(path, task) => {
                guard.busy = true;
                drop(guard);
                let (task, error) = task.run(&path);
                lock(queue).note(path, task, error, Instant::now());
                on_attempt();
                guard = lock(queue);
            }
        }
    }
}

/// The lock of the queue. A panic of another thread that held it does not stop the writes.
fn lock(queue: &Mutex<Queue>) -> MutexGuard<'_, Queue> {
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVERY: Duration = Duration::from_secs(3);

    fn text(text: &str) -> Content {
        let bytes = text.as_bytes().to_vec();
        Content::Make(Box::new(|| Some(bytes)))
    }

    fn task(content: Content) -> Task {
        Task { content, then: None, due: None, since: Instant::now() }
    }

    /// Performs the tasks that are due at a time, and returns the time until the next write.
    fn do_all(queue: &mut Queue, now: Instant) -> Option<Duration> {
        loop {
            match queue.next(now, EVERY) {
                Next::End => return None,
                Next::Wait(time) => return time,
                Next::Do(path, task) => {
                    let (task, error) = task.run(&path);
                    queue.note(path, task, error, now);
                }
            }
        }
    }

    #[test]
    fn the_newest_content_is_written_at_most_every_so_often_and_removal_does_not_wait() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        let (mut queue, start) = (Queue::default(), Instant::now());
        queue.tasks.insert(path.clone(), task(text("one")));
        assert_eq!(do_all(&mut queue, start), None);
        queue.tasks.insert(path.clone(), task(text("two")));
        queue.tasks.insert(path.clone(), task(text("three")));
        std::fs::write(&other, b"x").unwrap();
        queue.tasks.insert(other.clone(), task(Content::Removed));
        let second = Duration::from_secs(1);
        assert_eq!(do_all(&mut queue, start + second), Some(Duration::from_secs(2)));
        assert!(std::fs::read(&path).unwrap() == b"one" && !other.exists());
        assert_eq!(do_all(&mut queue, start + EVERY), None);
        assert_eq!(std::fs::read(&path).unwrap(), b"three");
    }

    #[test]
    fn a_file_that_changes_all_the_time_delays_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        let (mut queue, start) = (Queue::default(), Instant::now());
        queue.put(path.clone(), task(text("one")));
        do_all(&mut queue, start);
        queue.put(path.clone(), task(text("two")));
        queue.put(other.clone(), task(text("other")));
        do_all(&mut queue, start + EVERY);
        assert!(std::fs::read(&path).unwrap() == b"two" && !other.exists());
        // A change of the first file, again before each write.
        queue.put(path.clone(), task(text("three")));
        do_all(&mut queue, start + 2 * EVERY);
        assert!(std::fs::read(&path).unwrap() == b"two" && other.exists());
    }

    #[test]
    fn a_write_that_fails_is_reported_once_and_tried_again_until_it_succeeds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::create_dir(&path).unwrap();
        let (mut queue, start) = (Queue::default(), Instant::now());
        queue.tasks.insert(path.clone(), task(text("one")));
        assert_eq!(do_all(&mut queue, start), Some(RETRY_AFTER));
        assert!(queue.failure.take().unwrap().contains("a folder or device"));
        assert_eq!(do_all(&mut queue, start + RETRY_AFTER), Some(RETRY_AFTER));
        assert_eq!(queue.failure.take(), None, "it is known");
        std::fs::remove_dir(&path).unwrap();
        assert_eq!(do_all(&mut queue, start + 2 * RETRY_AFTER), None);
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
    }

    #[test]
    fn what_is_left_is_written_in_the_end_without_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let (sender, receiver) = std::sync::mpsc::channel();
        let (attempt, attempts) = std::sync::mpsc::channel();
        let on_attempt = move || attempt.send(()).unwrap();
        let writer = FileWriter::start("test-writer", Duration::from_hours(1), on_attempt).unwrap();
        for text in ["one", "two", "three"] {
            let sender = sender.clone();
            let then: AfterWrite = Box::new(move || sender.send(text).unwrap());
            writer.write(path.clone(), Box::new(|| Some(text.into())), Some(then));
        }
        writer.write(folder.path().join("b"), Box::new(|| None), None);
        drop(writer);
        assert_eq!(std::fs::read(&path).unwrap(), b"three");
        assert_eq!(receiver.try_iter().last(), Some("three"));
        assert!((2..=4).contains(&attempts.try_iter().count()), "one for each file, more where the thread was quick");
        assert!(!folder.path().join("b").exists());
        // A folder in place of a file does not keep the program from ending.
        let writer = FileWriter::start("test-writer", EVERY, || ()).unwrap();
        writer.write(folder.path().to_path_buf(), Box::new(|| Some(Vec::new())), None);
        drop(writer);
    }
}
