//! Progress reports and cancellation, of every long computation.
//!
//! A computation that has something to report takes a [`Progress`]: it reports each step, and ends where the answer is `Break`. A
//! computation that only has to end early takes a [`CancelToken`], which is a [`Progress`] of anything too.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Receives the steps of a computation and says whether it continues. Closures of this signature are one.
pub trait Progress<Step: ?Sized> {
    /// Receives one step. After `Break` the computation ends before its next step, with the error of its floor that says "cancelled".
    fn report(&mut self, step: &Step) -> ControlFlow<()>;
}

impl<Step: ?Sized, F: FnMut(&Step) -> ControlFlow<()>> Progress<Step> for F {
    fn report(&mut self, step: &Step) -> ControlFlow<()> {
        self(step)
    }
}

/// Ends computations from another thread. Clones are the same token; a child is cancelled with its parent, not the reverse.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let token = CancelToken::new();
/// let other = token.clone();
/// std::thread::spawn(move || other.cancel()).join().expect("no panic");
/// assert!(token.is_cancelled());
/// ```
#[derive(Clone, Debug, Default)]
pub struct CancelToken {
    state: Arc<State>,
}

#[derive(Debug, Default)]
struct State {
    is_cancelled: AtomicBool,
    parent: Option<CancelToken>,
}

impl CancelToken {
    /// A token that nobody has cancelled. It also receives reports that nobody wants.
    pub fn new() -> Self {
        Self::default()
    }

    /// A token that is cancelled by itself or with this one.
    #[must_use]
    pub fn child(&self) -> Self {
        Self { state: Arc::new(State { is_cancelled: AtomicBool::new(false), parent: Some(self.clone()) }) }
    }

    /// Ends the computations that hold this token or a child of it. Cannot be undone.
    pub fn cancel(&self) {
        self.state.is_cancelled.store(true, Ordering::Release);
    }

    /// Whether the computation should end.
    pub fn is_cancelled(&self) -> bool {
        self.state.is_cancelled.load(Ordering::Acquire)
            || self.state.parent.as_ref().is_some_and(CancelToken::is_cancelled)
    }

    /// `Break` once cancelled.
    pub fn check(&self) -> ControlFlow<()> {
        if self.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl<Step: ?Sized> Progress<Step> for CancelToken {
    fn report(&mut self, _step: &Step) -> ControlFlow<()> {
        self.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(progress: &mut dyn Progress<usize>) -> usize {
        (1..=9).take_while(|step| progress.report(step).is_continue()).count()
    }

    #[test]
    fn child_is_cancelled_with_its_parent_and_not_the_reverse() {
        let parent = CancelToken::new();
        let (child, other) = (parent.child(), parent.child());
        child.cancel();
        assert!(child.is_cancelled() && child.check().is_break());
        assert!(!parent.is_cancelled() && !other.is_cancelled());
        parent.clone().cancel();
        assert!(parent.is_cancelled() && other.is_cancelled());
    }

    #[test]
    fn closures_and_tokens_receive_the_same_reports() {
        let mut token = CancelToken::new();
        assert_eq!(count(&mut token.clone()), 9);
        let mut until = |step: &usize| {
            if *step == 4 {
                token.cancel();
            }
            token.check()
        };
        assert_eq!(count(&mut until), 3);
        assert_eq!(count(&mut token), 0);
    }
}
