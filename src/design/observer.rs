//! Observer of a run, and the clock of its computing time.

use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::state::{IdealProgress, IdealState, Phase};
use crate::progress::Progress;

/// Progress of a run, with its computing time. Time in the callback, where a paused run waits, does not count.
pub(super) struct RunObserver<'a> {
    progress: RefCell<&'a mut dyn for<'b> Progress<IdealProgress<'b>>>,
    started: Instant,
    /// Computing time before that, seconds.
    before: f64,
    waited: Cell<Duration>,
    now: fn() -> Instant,
}

impl<'a> RunObserver<'a> {
    /// Clock that starts at `before` seconds.
    pub fn new(progress: &'a mut dyn for<'b> Progress<IdealProgress<'b>>, before: f64) -> Self {
        Self::with_clock(progress, before, Instant::now)
    }

    /// The same with the function that tells the time.
    fn with_clock(
        progress: &'a mut dyn for<'b> Progress<IdealProgress<'b>>,
        before: f64,
        now: fn() -> Instant,
    ) -> Self {
        Self { progress: RefCell::new(progress), started: now(), before, waited: Cell::default(), now }
    }

    /// Seconds of computing.
    pub fn seconds(&self) -> f64 {
        self.before + ((self.now)() - self.started).saturating_sub(self.waited.get()).as_secs_f64()
    }

    /// Reports the state and, between steps, the phase with its share that is done. The answer is that of the callback.
    pub fn notify(&self, state: &IdealState, phase: Option<(Phase, f64)>) -> ControlFlow<()> {
        let seconds = self.seconds();
        let called = (self.now)();
        let answer = self.progress.borrow_mut().report(&IdealProgress { state, phase, seconds });
        self.waited.set(self.waited.get() + ((self.now)() - called));
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    thread_local! {
        static NOW: Cell<Instant> = Cell::new(Instant::now());
    }

    fn advance(seconds: u64) {
        NOW.set(NOW.get() + Duration::from_secs(seconds));
    }

    #[test]
    fn time_in_the_callback_does_not_count() {
        let mut calls = Vec::new();
        let mut wait = |progress: &IdealProgress<'_>| {
            calls.push((progress.phase, progress.seconds));
            advance(100);
            if calls.len() < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let state = IdealState::new(heuristic_layout(1), 10);
        let observer = RunObserver::with_clock(&mut wait, 5.0, || NOW.get());
        advance(1);
        assert!(observer.notify(&state, Some((Phase::Fitting, 0.5))).is_continue());
        advance(2);
        assert!(observer.notify(&state, None).is_break());
        advance(3);
        assert_eq!(observer.seconds(), 11.0);
        assert_eq!(calls, [(Some((Phase::Fitting, 0.5)), 6.0), (None, 8.0)]);
    }
}
