//! The signals by which a scheduler or a person asks a command to stop.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::evaluation::EvaluationError;
use crate::reconstruction::ReconstructionError;
use crate::studies::StudyError;

/// Whether SIGTERM or SIGUSR1 has come. Other systems have no such signals.
#[derive(Clone, Debug)]
pub(super) struct StopSignal {
    /// Number of the signal that has come; 0 before.
    received: Arc<AtomicUsize>,
}

impl StopSignal {
    /// Listens from now on.
    pub(super) fn listen() -> Self {
        let received = Arc::new(AtomicUsize::new(0));
        #[cfg(unix)]
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGUSR1] {
            // Without the handler the signal ends the program at once; the last checkpoint stays.
            let number = usize::try_from(signal).unwrap_or_default();
            let _ = signal_hook::flag::register_usize(signal, Arc::clone(&received), number);
        }
        Self { received }
    }

    /// Listens where there is a state to keep. Elsewhere a signal ends the program at once.
    pub(super) fn listen_if(keeps_state: bool) -> Self {
        if keeps_state { Self::listen() } else { Self { received: Arc::default() } }
    }

    /// `Break` once a signal has come.
    pub(super) fn check(&self) -> ControlFlow<()> {
        if self.received.load(Ordering::Relaxed) == 0 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    }

    /// Ends the program by the signal that has come, as without listening, so that its exit code says so.
    pub(super) fn end_program(&self) {
        #[cfg(unix)]
        if let Ok(signal) = i32::try_from(self.received.load(Ordering::Relaxed)) {
            // Where the system refuses, the program ends as usual.
            let _ = signal_hook::low_level::emulate_default_handler(signal);
        }
    }

    /// One that has come, for tests.
    #[cfg(test)]
    pub(super) fn received() -> Self {
        Self { received: Arc::new(AtomicUsize::new(1)) }
    }
}

/// Whether a computation ended because it was asked to.
pub(super) fn is_stopped(error: &anyhow::Error) -> bool {
    error.downcast_ref::<EvaluationError>().is_some_and(EvaluationError::is_cancelled)
        || matches!(error.downcast_ref(), Some(StudyError::Cancelled))
        || matches!(error.downcast_ref(), Some(ReconstructionError::Cancelled))
}
