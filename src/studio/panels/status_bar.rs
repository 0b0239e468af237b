//! The status bar.

use egui::Ui;

use crate::studio::panels::parts::job_progress;
use crate::studio::state::app_state::State;

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

/// Shows the newest message on the left; value under the pointer and jobs on the right.
pub fn show(ui: &mut Ui, state: &mut State, frames: &FrameTimes) {
    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
        let work = job_progress::summary(state).unwrap_or_else(|| {
            if state.session.is_computing() {
                "Computing".into()
            } else if state.failure().is_some() {
                "No results".into()
            } else {
                format!("Up to date, computed in {:.0} ms", 1e3 * state.live.seconds)
            }
        });
        let work = egui::Label::new(egui::RichText::new(work).weak()).sense(egui::Sense::click());
        if ui.add(work).on_hover_text("Shows all jobs").clicked() {
            state.jobs_open = !state.jobs_open;
        }
        if state.live.busy.is_some() && ui.small_button("Cancel reading").clicked() {
            state.session.cancel();
        }
        ui.separator();
        if frames.shown {
            let (last, longest) = (1e3 * frames.last, 1e3 * frames.longest);
            ui.weak(format!("frame {}: {last:.1} ms, longest {longest:.1} ms", frames.count));
            ui.separator();
        }
        if let Some(hover) = &state.hover {
            ui.label(hover);
            ui.separator();
        }
        ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| state.messages.status_line(ui));
    });
}
