//! The time that something has taken, in all its parts.

use std::time::{Duration, Instant};

/// Runs from when it is made, on top of the time that was taken before.
#[derive(Clone, Copy)]
pub(in crate::information) struct Stopwatch {
    before: Duration,
    since: Instant,
}

impl Stopwatch {
    /// Begins with the time of earlier parts.
    pub fn after(before: Duration) -> Self {
        Self { before, since: Instant::now() }
    }

    /// The time of all parts.
    pub fn elapsed(&self) -> Duration {
        self.before + self.since.elapsed()
    }
}
