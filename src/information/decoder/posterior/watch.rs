//! Telling of progress, and being stopped, from within long walks on any thread.

use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::bound::{OnPosterior, PosteriorProgress};
use crate::information::Stopwatch;

/// Time between two calls.
const EVERY: Duration = Duration::from_millis(50);

/// The one who is told, shared by all walks.
pub(super) struct Watch<'a> {
    told: Mutex<Told<'a>>,
    stopped: AtomicBool,
    time: Stopwatch,
}

struct Told<'a> {
    on_progress: OnPosterior<'a>,
    progress: PosteriorProgress,
    /// When that was last told.
    at: Instant,
}

impl<'a> Watch<'a> {
    /// Of a bound whose time is taken, with the samples that were followed before, what they came to in bits per pixel, and the most
    /// samples there will be.
    pub fn new(
        on_progress: OnPosterior<'a>,
        (samples, bits_per_pixel): (usize, f64),
        most: usize,
        time: Stopwatch,
    ) -> Self {
        let progress = PosteriorProgress { samples, most, elapsed: Duration::ZERO, bits_per_pixel };
        Self {
            told: Mutex::new(Told { on_progress, progress, at: Instant::now() }),
            stopped: AtomicBool::new(false),
            time,
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
            self.tell(&mut told);
        }
        !self.stopped.load(Ordering::Relaxed)
    }

    fn tell(&self, told: &mut Told<'_>) {
        told.at = Instant::now();
        told.progress.elapsed = self.time.elapsed();
        let Told { on_progress, progress, .. } = told;
        if matches!(on_progress(progress), ControlFlow::Break(())) {
            self.stopped.store(true, Ordering::Relaxed);
        }
    }
}
