//! Elapsed time over several sessions.

use std::time::{Duration, Instant};

/// Stopwatch that starts with the time of earlier sessions.
#[derive(Clone, Copy)]
pub(in crate::information) struct Stopwatch {
    before: Duration,
    since: Instant,
}

impl Stopwatch {
    /// Starts with the time of earlier sessions.
    pub fn after(before: Duration) -> Self {
        Self { before, since: Instant::now() }
    }

    /// Total time of all sessions.
    pub fn elapsed(&self) -> Duration {
        self.before + self.since.elapsed()
    }
}
