//! Telling of progress, and being stopped, from within long walks on any thread.

use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::bound::{AisProgress, OnAis};
use crate::information::stopwatch::Stopwatch;

/// Time between two calls.
const EVERY: Duration = Duration::from_millis(50);

/// The one who is told, shared by all walks.
pub(super) struct Watch<'a> {
    told: Mutex<Told<'a>>,
    stopped: AtomicBool,
    time: Stopwatch,
    budget: Option<Duration>,
}

struct Told<'a> {
    on_progress: OnAis<'a>,
    progress: AisProgress,
    /// Time by which so many samples were followed.
    noted: Duration,
    /// When that was last told.
    at: Instant,
}

impl<'a> Watch<'a> {
    /// Of a bound whose time is taken, with the samples that were followed before, what they came to in bits per pixel, and the most
    /// samples and the most time there will be.
    pub fn new(
        on_progress: OnAis<'a>,
        (samples, bits_per_pixel): (usize, f64),
        (most, budget): (usize, Option<Duration>),
        time: Stopwatch,
    ) -> Self {
        let (elapsed, remaining) = (Duration::ZERO, None);
        let progress = AisProgress { samples, most, elapsed, remaining, bits_per_pixel };
        Self {
            told: Mutex::new(Told { on_progress, progress, noted: time.elapsed(), at: Instant::now() }),
            stopped: AtomicBool::new(false),
            time,
            budget,
        }
    }

    /// Whether to go on. To be asked often: it tells now and then, and costs next to nothing in between.
    pub fn goes_on(&self) -> bool {
        // Where another walk is telling, that is enough.
        if let Ok(mut told) = self.told.try_lock()
            && told.at.elapsed() >= EVERY
        {
            self.tell(&mut told);
        }
        !self.stopped.load(Ordering::Relaxed)
    }

    /// Notes the bound after so many samples, bits per pixel, and tells it; whether to go on.
    pub fn note(&self, samples: usize, bits_per_pixel: f64) -> bool {
        if let Ok(mut told) = self.told.lock()
            && !self.stopped.load(Ordering::Relaxed)
        {
            (told.progress.samples, told.progress.bits_per_pixel) = (samples, bits_per_pixel);
            told.noted = self.time.elapsed();
            self.tell(&mut told);
        }
        !self.stopped.load(Ordering::Relaxed)
    }

    fn tell(&self, told: &mut Told<'_>) {
        told.at = Instant::now();
        told.progress.elapsed = self.time.elapsed();
        told.progress.remaining = remaining(&told.progress, self.budget, told.noted);
        let Told { on_progress, progress, .. } = told;
        if matches!(on_progress(progress), ControlFlow::Break(())) {
            self.stopped.store(true, Ordering::Relaxed);
        }
    }
}

/// Time left: of a budget, or by how long the samples had taken by when they were `noted`; none before the first.
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
    fn the_time_that_is_left_falls_between_two_samples() {
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
