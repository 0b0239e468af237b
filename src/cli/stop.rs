//! The signals by which a scheduler or a person asks a command to stop.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::evaluation::EvaluationError;
use crate::reconstruction::ReconstructionError;
use crate::studies::StudyError;

/// Whether SIGTERM or SIGUSR1 has come. Other systems have no such signals.
#[derive(Clone, Debug)]
pub(super) struct StopSignal(Arc<AtomicBool>);

impl StopSignal {
    /// Listens from now on.
    pub(super) fn listen() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        #[cfg(unix)]
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGUSR1] {
            // Without the handler the signal ends the program at once; the last checkpoint stays.
            let _ = signal_hook::flag::register(signal, Arc::clone(&stop));
        }
        Self(stop)
    }

    /// Listens where there is a state to keep. Elsewhere a signal ends the program at once.
    pub(super) fn listen_if(keeps_state: bool) -> Self {
        if keeps_state { Self::listen() } else { Self(Arc::default()) }
    }

    /// `Break` once a signal has come.
    pub(super) fn check(&self) -> ControlFlow<()> {
        if self.0.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// Whether a computation ended because it was asked to.
pub(super) fn is_stopped(error: &anyhow::Error) -> bool {
    error.downcast_ref::<EvaluationError>().is_some_and(EvaluationError::is_cancelled)
        || matches!(error.downcast_ref(), Some(StudyError::Cancelled))
        || matches!(error.downcast_ref(), Some(ReconstructionError::Cancelled))
}
