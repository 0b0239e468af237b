//! Shared parts of the threads beside the window: cores with low priority, locks, and panics as sentences.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use thread_priority::{ThreadPriority, ThreadPriorityValue, set_current_thread_priority};

/// Callback that notifies the window of news.
pub(crate) type Wake = Arc<dyn Fn() + Send + Sync>;

/// Locks a mutex, even if an earlier holder panicked: its values are whole, because every critical section only moves values.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Number of computing threads, which may change at any time. Clones share the number.
#[derive(Clone, Default)]
pub(crate) struct Threads(Arc<AtomicUsize>);

impl Threads {
    /// Sets the number; none stands for one thread per core.
    pub fn set(&self, count: Option<usize>) {
        self.0.store(count.unwrap_or(0), Ordering::Relaxed);
    }

    fn count(&self) -> usize {
        match self.0.load(Ordering::Relaxed) {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            chosen => chosen,
        }
    }
}

/// Kind of computation beside the window. All kinds yield to the window, and the kind that people wait for least yields to all others. A
/// thread of the window with something to draw gets a core at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// The numbers that every edit shows.
    Computation,
    /// The live estimate, and those that take longer.
    Estimate,
    /// What a decoder makes of measurements.
    Reconstruction,
    /// A run that optimizes a mask.
    Run,
    /// The training of a network.
    Training,
    /// The cells of a study.
    Study,
}

impl Work {
    /// Name in messages and of threads.
    fn name(self) -> &'static str {
        match self {
            Self::Computation => "computation",
            Self::Estimate => "estimate",
            Self::Reconstruction => "reconstruction",
            Self::Run => "run",
            Self::Training => "training",
            Self::Study => "study",
        }
    }

    /// Priority from 0, the least, to 99. Every system with priorities puts all of them below its usual one; their distances depend on the
    /// system.
    fn priority(self) -> u8 {
        match self {
            Self::Computation => 29,
            Self::Estimate => 22,
            Self::Reconstruction => 19,
            Self::Run => 16,
            Self::Training => 13,
            Self::Study => 10,
        }
    }
}

/// Pool of threads for one kind of work, made when it is first needed.
pub(crate) struct SpareCores {
    pool: Option<rayon::ThreadPool>,
    /// Threads of the pool, 0 before it is made.
    count: usize,
    /// Wanted number of threads.
    wanted: Threads,
    work: Work,
}

impl SpareCores {
    /// A pool with the wanted number of threads.
    pub fn new(work: Work, wanted: Threads) -> Self {
        Self { pool: None, count: 0, wanted, work }
    }

    /// Runs `work` on these cores.
    ///
    /// # Errors
    /// One sentence where it panicked.
    pub fn run<R: Send>(&mut self, work: impl FnOnce() -> R + Send) -> Result<R, String> {
        let count = self.wanted.count();
        if self.count != count {
            (self.pool, self.count) = (pool(self.work, count), count);
        }
        let done = catch_unwind(AssertUnwindSafe(|| match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }));
        done.map_err(|panic| {
            format!("an internal error stopped this {}: {}", self.work.name(), panic_text(panic.as_ref()))
        })
    }
}

/// Named threads of low priority; where the system gives none, the work runs on the calling thread.
fn pool(work: Work, count: usize) -> Option<rayon::ThreadPool> {
    let builder = rayon::ThreadPoolBuilder::new().num_threads(count);
    let builder = builder.thread_name(move |index| format!("lenslet-{}-{index}", work.name()));
    let give_way = move |_| {
        let priority = ThreadPriorityValue::try_from(work.priority()).map(ThreadPriority::Crossplatform);
        // Where the system refuses, they compete with the window.
        let _ = priority.map(set_current_thread_priority);
    };
    builder.start_handler(give_way).build().ok()
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    panic
        .downcast_ref::<&str>()
        .map(ToString::to_string)
        .or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no reason given".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_sentence_and_the_cores_go_on() {
        let threads = Threads::default();
        let mut cores = SpareCores::new(Work::Estimate, threads.clone());
        let failed = cores.run(|| -> usize { panic!("{}", "no light") });
        assert_eq!(failed.unwrap_err(), "an internal error stopped this estimate: no light");
        assert_eq!(cores.run(|| 2 + 2), Ok(4));
        threads.set(Some(3));
        assert_eq!(cores.run(rayon::current_num_threads), Ok(3), "a choice counts from the next work on");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn what_is_computed_gives_way_to_the_window_and_runs_to_edits() {
        // The 19th field of the thread's line, counted from behind its name: 0 for the window, more for threads of low priority.
        let nice = || {
            let line = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
            line.rsplit_once(") ").unwrap().1.split(' ').nth(16).unwrap().parse::<i32>().unwrap()
        };
        let here = nice();
        if here != 0 {
            return eprintln!("not looked into: these tests give way to others themselves");
        }
        let works = [Work::Computation, Work::Estimate, Work::Reconstruction, Work::Run, Work::Training];
        let mut nices = vec![here];
        nices.extend(works.map(|work| SpareCores::new(work, Threads::default()).run(nice).unwrap()));
        assert!(nices.is_sorted_by(|one, other| one < other), "{nices:?}");
        assert_eq!(nice(), here);
    }
}
