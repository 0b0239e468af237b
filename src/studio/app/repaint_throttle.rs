//! Limits how often background results repaint the window.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Shortest and longest time between two frames that background results request.
const EVERY: (Duration, Duration) = (Duration::from_millis(16), Duration::from_millis(80));
/// Ratio of frame interval to drawing time; computations get the rest of the time. Software rendering takes several times
/// as long as the thread of the window.
const SPARE: f32 = 7.0;
/// Weight of the last frame in the mean time of a frame.
const NEWEST: f32 = 0.2;

/// Times of the drawn frames. Clones share them.
#[derive(Clone, Default)]
pub struct RepaintThrottle(Arc<Mutex<Frames>>);

#[derive(Default)]
struct Frames {
    last: Option<Instant>,
    /// Mean time of a frame, seconds.
    mean: f32,
}

impl RepaintThrottle {
    /// Records that a frame is drawn now, and the drawing time of the previous one, seconds.
    pub fn drawn(&self, seconds: f32) {
        let mut frames = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        frames.last = Some(Instant::now());
        frames.mean += NEWEST * (seconds - frames.mean);
    }

    /// Time until the next frame may be drawn, at least 1 ms: egui draws two frames for a repaint without delay.
    pub fn wait(&self) -> Duration {
        let frames = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let wait = frames.last.map_or(Duration::ZERO, |last| every(frames.mean).saturating_sub(last.elapsed()));
        wait.max(Duration::from_millis(1))
    }
}

/// Frame interval for a mean drawing time, seconds.
fn every(seconds: f32) -> Duration {
    Duration::try_from_secs_f32(SPARE * seconds).unwrap_or(EVERY.1).clamp(EVERY.0, EVERY.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_frames_come_less_often() {
        assert_eq!(every(1e-4), EVERY.0);
        assert!(EVERY.0 < every(5e-3) && every(5e-3) < every(9e-3) && every(9e-3) < EVERY.1);
        assert_eq!((every(0.5), every(f32::NAN)), (EVERY.1, EVERY.1));
        assert_eq!(RepaintThrottle::default().wait(), Duration::from_millis(1), "the first one at once");
    }
}
