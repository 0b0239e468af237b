//! The line at the lower edge of the window.

use egui::Ui;

use crate::studio::panels::parts::job_progress;
use crate::studio::state::app_state::State;

/// How long the processor works on each frame.
#[derive(Default)]
pub struct FrameTimes {
    /// Whether they are shown.
    pub shown: bool,
    /// Of the last frame and the longest of late, seconds.
    last: f32,
    longest: f32,
    /// Frames drawn since the window was opened.
    count: u64,
}

impl FrameTimes {
    /// Notes the time of a frame, seconds.
    pub fn note(&mut self, seconds: f32) {
        self.last = seconds;
        // The longest fades within a few hundred frames.
        self.longest = (0.99 * self.longest).max(seconds);
        self.count += 1;
    }
}

/// Left: the newest message, or the value under the pointer. Right: what is going on.
pub fn show(ui: &mut Ui, state: &mut State, frames: &FrameTimes) {
    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
        let work = job_progress::summary(state).unwrap_or_else(|| {
            if state.bench.is_computing() {
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
            state.bench.cancel();
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
