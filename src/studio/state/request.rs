//! Requests of panels that draw a part of the state.

use std::sync::Arc;

use crate::studio::state::path_question::PathPurpose;
use crate::studio::widgets::number_field::Edit;
use crate::workbench::{Activity, Command};

/// A request of a panel. It is served when the panel is drawn.
pub enum Request {
    /// Changes the design, as one undo step with the other changes of the gesture.
    Change(Command),
    /// Changes the design by an edit of a number field.
    ChangeBy(Edit, Command),
    /// Changes the design, as an undo step of its own.
    ChangeInOneStep(Command),
    /// Asks for a path.
    AskPath(PathPurpose),
    /// Copies a text; `what` names it in the message.
    Copy {
        /// The text.
        text: String,
        /// Its name, for example "Log".
        what: &'static str,
    },
    /// Stops a job.
    StopJob(Arc<Activity>),
}
