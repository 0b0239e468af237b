//! Progress of a fit.

use std::time::Duration;

/// Progress of a fit; sent after every step and after every group of scored patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitProgress {
    /// Current epoch, from 1.
    pub epoch: usize,
    /// Largest number of epochs.
    pub epochs: usize,
    /// Steps taken.
    pub step: usize,
    /// Latest cross-entropy, bits per pixel: of the validation patches after an epoch, or the running mean over training steps;
    /// `None` before the first.
    pub validation_bits: Option<f64>,
    /// The smallest so far.
    pub best_bits: Option<f64>,
    /// Time since the start.
    pub elapsed: Duration,
    /// Estimated time left; `None` while unknown.
    pub remaining: Option<Duration>,
    /// Held-out patches scored and their total, once the fit is over.
    pub scored: Option<(usize, usize)>,
}
