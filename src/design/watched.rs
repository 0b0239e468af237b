//! A run while it is watched: who watches it may let it wait.

use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::ideal::OnIdeal;
use super::state::{Doing, IdealProgress, IdealState};

/// Tells whoever watches a run, and counts the seconds of computing: those that a watch takes, as it does while a run is
/// paused, are not among them.
pub(super) struct Watched<'a> {
    watch: RefCell<OnIdeal<'a>>,
    started: Instant,
    /// Seconds before that.
    before: f64,
    waited: Cell<Duration>,
}

impl<'a> Watched<'a> {
    /// Goes on counting from `before`, seconds.
    pub fn new(watch: OnIdeal<'a>, before: f64) -> Self {
        Self { watch: RefCell::new(watch), started: Instant::now(), before, waited: Cell::default() }
    }

    /// Seconds of computing.
    pub fn seconds(&self) -> f64 {
        self.before + self.started.elapsed().saturating_sub(self.waited.get()).as_secs_f64()
    }

    /// Tells where the run is and what it does besides moving the mask; the answer is whether to go on.
    pub fn tell(&self, state: &IdealState, doing: Option<(Doing, f64)>) -> ControlFlow<()> {
        let seconds = self.seconds();
        let asked = Instant::now();
        let answer = self.watch.borrow_mut()(&IdealProgress { state, doing, seconds });
        self.waited.set(self.waited.get() + asked.elapsed());
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    #[test]
    fn waiting_is_no_computing() {
        let pause = Duration::from_millis(20);
        let mut told = Vec::new();
        let mut wait = |progress: &IdealProgress<'_>| {
            told.push((progress.doing, progress.seconds));
            std::thread::sleep(pause);
            if told.len() < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let state = IdealState::new(heuristic_layout(1), 10);
        let began = Instant::now();
        let watch = Watched::new(&mut wait, 5.0);
        assert!(watch.tell(&state, Some((Doing::Fitting, 0.5))).is_continue());
        assert!(watch.tell(&state, None).is_break());
        let seconds = watch.seconds();
        assert!(seconds >= 5.0 && seconds - 5.0 <= began.elapsed().saturating_sub(2 * pause).as_secs_f64());
        assert_eq!((told[0].0, told[1].0), (Some((Doing::Fitting, 0.5)), None));
        assert!(told[0].1 <= told[1].1 && told[1].1 <= seconds);
    }
}
