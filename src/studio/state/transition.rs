//! Steps that would discard the open design or a run.

use std::path::PathBuf;

use crate::forward::Design;

/// A step that would discard the open design or a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Transition {
    /// Starting from the default design.
    New,
    /// Starting from a sample design.
    Sample(Box<Design>),
    /// Asking for a design file.
    Open,
    /// Opening a design file that was dropped on the window.
    OpenFile(PathBuf),
    /// Closing the window.
    Close,
    /// Starting a run in place of the last one.
    Run,
    /// Opening the previewed mask as a new design.
    Accept,
}

/// A transition that waits for a confirmation.
pub struct PendingTransition {
    /// The transition.
    pub what: Transition,
    /// *Save* was chosen: the transition follows when the file is written.
    pub saving: bool,
}
