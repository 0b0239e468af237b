//! What the threads beside the window share: the cores that it leaves to them, locks, panics that become sentences.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Tells the window that there is something new.
pub(super) type Wake = Arc<dyn Fn() + Send + Sync>;

/// A mutex whose holder panicked still holds whole values here: every critical section only moves values.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// All cores but one, which is left to the window.
pub(super) struct SpareCores {
    pool: Option<rayon::ThreadPool>,
    /// What is done on them.
    what: &'static str,
}

impl SpareCores {
    /// Cores for `what` is done on them ("estimate").
    pub fn new(what: &'static str) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(cores.saturating_sub(1).max(1))
            .thread_name(move |index| format!("lenslet-{what}-{index}"))
            .build();
        // Where the system gives no threads, the work is done on the one that asks for it.
        Self { pool: pool.ok(), what }
    }

    /// Does `work` on these cores.
    ///
    /// # Errors
    /// One sentence where it panicked.
    pub fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> Result<R, String> {
        let done = catch_unwind(AssertUnwindSafe(|| match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }));
        done.map_err(|panic| format!("an internal error stopped this {}: {}", self.what, panic_text(panic.as_ref())))
    }
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
        let cores = SpareCores::new("test");
        let failed = cores.run(|| -> usize { panic!("{}", "no light") });
        assert_eq!(failed.unwrap_err(), "an internal error stopped this test: no light");
        assert_eq!(cores.run(|| 2 + 2), Ok(4));
    }
}
