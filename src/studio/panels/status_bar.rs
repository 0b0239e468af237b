//! The status bar.

use std::sync::Arc;

use egui::accesskit::Live;
use egui::{RichText, Ui};

use crate::studio::panels::parts::job_progress;
use crate::studio::panels::parts::severity_colour::severity_colour;
use crate::studio::state::messages::Messages;
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::speak;
use crate::workbench::Activity;

/// Drawing times of frames.
#[derive(Default)]
pub struct FrameTimes {
    /// Whether they are shown.
    pub shown: bool,
    /// Last frame and recent maximum, seconds.
    last: f32,
    longest: f32,
    /// Frames drawn since the window was opened.
    count: u64,
}

impl FrameTimes {
    /// Notes the time of a frame, seconds.
    pub fn note(&mut self, seconds: f32) {
        self.last = seconds;
        // The maximum decays within a few hundred frames.
        self.longest = (0.99 * self.longest).max(seconds);
        self.count += 1;
    }
}

/// What the status bar shows beside results and messages.
pub struct StatusBar<'a> {
    /// The value under the pointer.
    pub hover: Option<&'a str>,
    /// All jobs.
    pub activities: &'a [Arc<Activity>],
    /// Whether results are being computed.
    pub is_computing: bool,
    /// Drawing times.
    pub frames: &'a FrameTimes,
}

/// Shows the newest message on the left; value under the pointer and jobs on the right.
pub fn show(ui: &mut Ui, status: StatusBar<'_>, messages: &mut Messages, view: &View<'_>, requests: &mut Vec<Request>) {
    let StatusBar { hover, activities, is_computing, frames } = status;
    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
        let work = job_progress::summary(activities).unwrap_or_else(|| {
            if is_computing {
                "Computing".into()
            } else if view.failure().is_some() {
                "No results".into()
            } else {
                format!("Up to date, computed in {:.0} ms", 1e3 * view.live.seconds)
            }
        });
        let work = egui::Label::new(egui::RichText::new(work).weak()).sense(egui::Sense::click());
        if ui.add(work).on_hover_text("Shows all jobs").clicked() {
            requests.push(Request::ToggleJobs);
        }
        if view.live.busy.is_some() && ui.small_button("Cancel reading").clicked() {
            requests.push(Request::StopReading);
        }
        ui.separator();
        if frames.shown {
            let (last, longest) = (1e3 * frames.last, 1e3 * frames.longest);
            ui.weak(format!("frame {}: {last:.1} ms, longest {longest:.1} ms", frames.count));
            ui.separator();
        }
        if let Some(hover) = hover {
            ui.label(hover);
            ui.separator();
        }
        ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| newest_message(ui, messages));
    });
}

/// Line with the newest message; a click opens or closes the log.
fn newest_message(ui: &mut Ui, messages: &mut Messages) {
    let Some(message) = messages.entries.last() else {
        ui.weak("Ready");
        return;
    };
    let severity = messages.newest_severity().unwrap_or(message.severity);
    let text = RichText::new(&message.text).color(severity_colour(ui, severity));
    let label = egui::Label::new(text).truncate().sense(egui::Sense::click());
    let response = ui.add(label).on_hover_text(format!("{}\n\nClick to show all messages", message.text));
    if response.clicked() {
        messages.log_open = !messages.log_open;
    }
    speak(&response, Live::Polite);
}
