//! Progress reports and cancellation of AIS chains on many threads.

use std::ops::ControlFlow;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use super::bound::AisProgress;
use crate::information::stopwatch::Stopwatch;
use crate::progress::{CancelToken, Progress};

/// Time between two reports.
const EVERY: Duration = Duration::from_millis(50);

/// Observer of a bound, shared by all chains.
pub(super) struct AisObserver<'a> {
    state: Mutex<ObserverState<'a>>,
    cancel: CancelToken,
    time: Stopwatch,
    budget: Option<Duration>,
}

struct ObserverState<'a> {
    receiver: &'a mut (dyn Progress<AisProgress> + Send),
    progress: AisProgress,
    /// Time when the last sample was done.
    noted: Duration,
    /// Time of the last report.
    at: Instant,
}

impl<'a> AisObserver<'a> {
    /// An observer of a bound that starts or resumes with this progress.
    pub fn new(
        receiver: &'a mut (dyn Progress<AisProgress> + Send),
        progress: AisProgress,
        budget: Option<Duration>,
        time: Stopwatch,
    ) -> Self {
        Self {
            state: Mutex::new(ObserverState { receiver, progress, noted: time.elapsed(), at: Instant::now() }),
            cancel: CancelToken::new(),
            time,
            budget,
        }
    }

    /// `Break` where the bound should end. Cheap; reports every 50 ms.
    pub fn poll(&self) -> ControlFlow<()> {
        // One report at a time.
        if let Ok(mut state) = self.state.try_lock()
            && state.at.elapsed() >= EVERY
        {
            self.report(&mut state);
        }
        self.cancel.check()
    }

    /// Records and reports the bound (bits per pixel) after `samples`; `Break` where it should end.
    pub fn note(&self, samples: usize, bits_per_pixel: f64) -> ControlFlow<()> {
        if let Ok(mut state) = self.state.lock()
            && !self.cancel.is_cancelled()
        {
            (state.progress.samples, state.progress.bits_per_pixel) = (samples, bits_per_pixel);
            state.noted = self.time.elapsed();
            self.report(&mut state);
        }
        self.cancel.check()
    }

    fn report(&self, state: &mut ObserverState<'_>) {
        state.at = Instant::now();
        state.progress.elapsed = self.time.elapsed();
        state.progress.remaining = remaining(&state.progress, self.budget, state.noted);
        let ObserverState { receiver, progress, .. } = state;
        if receiver.report(progress).is_break() {
            self.cancel.cancel();
        }
    }
}

/// Time left: of a budget, or from the mean time per sample until `noted`; `None` before the first.
fn remaining(progress: &AisProgress, budget: Option<Duration>, noted: Duration) -> Option<Duration> {
    let &AisProgress { samples, most, elapsed, .. } = progress;
    let all = match budget {
        Some(budget) => budget,
        None => Duration::try_from_secs_f64(noted.as_secs_f64() * most as f64 / samples as f64).ok()?,
    };
    Some(all.saturating_sub(elapsed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remaining_time_falls_between_samples() {
        let seconds = Duration::from_secs;
        let progress = |samples, elapsed| AisProgress {
            samples,
            most: 40,
            elapsed: seconds(elapsed),
            remaining: None,
            bits_per_pixel: 0.0,
        };
        assert_eq!(remaining(&progress(0, 3), None, seconds(0)), None);
        assert_eq!(remaining(&progress(10, 5), None, seconds(5)), Some(seconds(15)));
        assert_eq!(remaining(&progress(10, 8), None, seconds(5)), Some(seconds(12)));
        assert_eq!(remaining(&progress(10, 8), Some(seconds(9)), seconds(5)), Some(seconds(1)));
        assert_eq!(remaining(&progress(0, 11), Some(seconds(9)), seconds(5)), Some(seconds(0)));
    }
}
