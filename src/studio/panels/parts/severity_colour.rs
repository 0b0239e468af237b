//! Colours of messages.

use egui::{Color32, Ui};

use crate::studio::state::messages::Severity;

/// Colour of a message of this severity.
pub fn severity_colour(ui: &Ui, severity: Severity) -> Color32 {
    match severity {
        Severity::Done => ui.visuals().text_color(),
        Severity::Notice => ui.visuals().warn_fg_color,
        Severity::Failure => ui.visuals().error_fg_color,
    }
}
