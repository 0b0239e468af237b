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
}

impl<'a> RunObserver<'a> {
    /// Clock that starts at `before` seconds.
    pub fn new(progress: &'a mut dyn for<'b> Progress<IdealProgress<'b>>, before: f64) -> Self {
        Self { progress: RefCell::new(progress), started: Instant::now(), before, waited: Cell::default() }
    }

    /// Seconds of computing.
    pub fn seconds(&self) -> f64 {
        self.before + self.started.elapsed().saturating_sub(self.waited.get()).as_secs_f64()
    }

    /// Reports the state and, between steps, the phase with its share that is done. The answer is that of the callback.
    pub fn notify(&self, state: &IdealState, phase: Option<(Phase, f64)>) -> ControlFlow<()> {
        let seconds = self.seconds();
        let called = Instant::now();
        let answer = self.progress.borrow_mut().report(&IdealProgress { state, phase, seconds });
        self.waited.set(self.waited.get() + called.elapsed());
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    #[test]
    fn time_in_the_callback_does_not_count() {
        let pause = Duration::from_millis(20);
        let mut calls = Vec::new();
        let mut wait = |progress: &IdealProgress<'_>| {
            calls.push((progress.phase, progress.seconds));
            std::thread::sleep(pause);
            if calls.len() < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let state = IdealState::new(heuristic_layout(1), 10);
        let began = Instant::now();
        let observer = RunObserver::new(&mut wait, 5.0);
        assert!(observer.notify(&state, Some((Phase::Fitting, 0.5))).is_continue());
        assert!(observer.notify(&state, None).is_break());
        let seconds = observer.seconds();
        assert!(seconds >= 5.0 && seconds - 5.0 <= began.elapsed().saturating_sub(2 * pause).as_secs_f64());
        assert_eq!((calls[0].0, calls[1].0), (Some((Phase::Fitting, 0.5)), None));
        assert!(calls[0].1 <= calls[1].1 && calls[1].1 <= seconds);
    }
}
