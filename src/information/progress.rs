//! What a fit tells while it runs.

use std::ops::ControlFlow;
use std::time::Duration;

/// Where a fit is; sent after every step, and after every group of patches that is scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitProgress {
    /// Epoch that is running, from 1.
    pub epoch: usize,
    /// Most epochs there will be.
    pub epochs: usize,
    /// Steps taken.
    pub step: usize,
    /// Cross-entropy at the moment, bits per pixel: of the validation patches after the last epoch where there are epochs,
    /// of the training patches of late otherwise; none before.
    pub validation_bits: Option<f64>,
    /// The smallest so far.
    pub best_bits: Option<f64>,
    /// Time since the start.
    pub elapsed: Duration,
    /// Time left at most, where it can be told.
    pub remaining: Option<Duration>,
    /// Held-out patches scored and to be scored, once the fit is over.
    pub scored: Option<(usize, usize)>,
}

/// Receives progress; `ControlFlow::Break` cancels the fit before its next step.
pub type OnProgress<'a> = &'a mut dyn FnMut(&FitProgress) -> ControlFlow<()>;
