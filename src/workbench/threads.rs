//! What the threads beside the window share: the cores that it leaves to them, locks, panics that become sentences.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Tells the window that there is something new.
pub(super) type Wake = Arc<dyn Fn() + Send + Sync>;

/// A mutex whose holder panicked still holds whole values here: every critical section only moves values.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// How many threads compute; it may change at any time. Clones are the same number.
#[derive(Clone, Default)]
pub(super) struct Threads(Arc<AtomicUsize>);

impl Threads {
    /// Chooses a number, or leaves it to the machine: all cores but one, which is left to the window.
    pub fn set(&self, count: Option<usize>) {
        self.0.store(count.unwrap_or(0), Ordering::Relaxed);
    }

    fn count(&self) -> usize {
        match self.0.load(Ordering::Relaxed) {
            0 => std::thread::available_parallelism().map_or(1, usize::from).saturating_sub(1).max(1),
            chosen => chosen,
        }
    }
}

/// The cores that are left for computing.
pub(super) struct SpareCores {
    pool: Option<rayon::ThreadPool>,
    /// Threads of the pool, and how many there ought to be.
    count: usize,
    wanted: Threads,
    /// What is done on them.
    what: &'static str,
}

impl SpareCores {
    /// Cores for `what` is done on them ("estimate").
    pub fn new(what: &'static str, wanted: Threads) -> Self {
        let count = wanted.count();
        Self { pool: pool(what, count), count, wanted, what }
    }

    /// Does `work` on these cores.
    ///
    /// # Errors
    /// One sentence where it panicked.
    pub fn run<R: Send>(&mut self, work: impl FnOnce() -> R + Send) -> Result<R, String> {
        let count = self.wanted.count();
        if self.count != count {
            (self.pool, self.count) = (pool(self.what, count), count);
        }
        let done = catch_unwind(AssertUnwindSafe(|| match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }));
        done.map_err(|panic| format!("an internal error stopped this {}: {}", self.what, panic_text(panic.as_ref())))
    }
}

/// Named threads; where the system gives none, the work is done on the one that asks for it.
fn pool(what: &'static str, count: usize) -> Option<rayon::ThreadPool> {
    let builder = rayon::ThreadPoolBuilder::new().num_threads(count);
    builder.thread_name(move |index| format!("lenslet-{what}-{index}")).build().ok()
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
        let mut cores = SpareCores::new("test", threads.clone());
        let failed = cores.run(|| -> usize { panic!("{}", "no light") });
        assert_eq!(failed.unwrap_err(), "an internal error stopped this test: no light");
        assert_eq!(cores.run(|| 2 + 2), Ok(4));
        threads.set(Some(3));
        assert_eq!(cores.run(rayon::current_num_threads), Ok(3), "a choice counts from the next work on");
    }
}
