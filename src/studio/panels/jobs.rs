//! The window of jobs: progress, log and a stop button for each job.

use std::sync::Arc;

use egui::{ProgressBar, RichText, ScrollArea, Ui};

use crate::evaluation::format_duration;
use crate::studio::panels::parts::job_progress;
use crate::studio::state::request::Request;
use crate::studio::widgets::controls::name_widget;
use crate::workbench::{Activity, ActivityState};

/// Height of a progress bar, points.
const BAR: f32 = 16.0;

/// Draws the window if it is open.
pub fn show(ctx: &egui::Context, open: &mut bool, all: &[Arc<Activity>], requests: &mut Vec<Request>) {
    // Placed beside the panels that start jobs.
    let corner = ctx.content_rect().center_bottom() - egui::vec2(0.0, 36.0);
    let window = egui::Window::new("Jobs").open(open).default_size([440.0, 320.0]);
    window.pivot(egui::Align2::CENTER_BOTTOM).default_pos(corner).show(ctx, |ui| {
        if all.is_empty() {
            ui.weak("There are no jobs yet. Estimates, runs and file operations are listed here.");
        }
        ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            for activity in all.iter().rev() {
                entry(ui, requests, activity);
                ui.separator();
            }
        });
    });
}

/// One job.
fn entry(ui: &mut Ui, requests: &mut Vec<Request>, activity: &Arc<Activity>) {
    let number = activity.number;
    ui.horizontal(|ui| {
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if activity.can_stop() {
                let stop = ui.small_button("Stop");
                name_widget(&stop, &format!("Stop job {number}"));
                if stop.clicked() {
                    requests.push(Request::StopJob(Arc::clone(activity)));
                }
            }
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                ui.add(egui::Label::new(RichText::new(&activity.name).strong()).truncate());
            });
        });
    });
    let time = format_duration(activity.time());
    match &activity.state {
        ActivityState::Waiting => {
            ui.weak("waiting for other jobs");
        }
        ActivityState::Running | ActivityState::Paused => {
            let left = job_progress::left_of(activity);
            let paused = if activity.state == ActivityState::Paused { "paused, " } else { "" };
            ui.weak(format!("{paused}{time}{left}"));
            let bar = ProgressBar::new(activity.share.unwrap_or(0.0) as f32).desired_height(BAR);
            ui.add(bar.text(RichText::new(&activity.step).small()));
        }
        ActivityState::Done(text) => {
            ui.label(text);
            ui.weak(format!("done in {time}"));
        }
        ActivityState::Failed(sentence) => {
            ui.colored_label(ui.visuals().error_fg_color, sentence);
            ui.weak(format!("failed after {time}"));
        }
        ActivityState::Stopped => {
            ui.weak(format!("stopped after {time}"));
        }
    }
    if activity.log.len() > 1 {
        let log = egui::CollapsingHeader::new("Log").id_salt(("log", number)).show(ui, |ui| {
            let copy = ui.small_button("Copy log");
            name_widget(&copy, &format!("Copy log of job {number}"));
            if copy.clicked() {
                requests.push(Request::Copy { text: log_text(activity), what: "Log" });
            }
            egui::Grid::new(("lines", number)).num_columns(2).show(ui, |ui| {
                for (seconds, text) in &activity.log {
                    ui.weak(format!("{seconds:.1} s"));
                    ui.label(text);
                    ui.end_row();
                }
            });
        });
        name_widget(&log.header_response, &format!("Log of job {number}"));
    }
}

/// The log as text, one entry per line.
fn log_text(activity: &Activity) -> String {
    let lines = activity.log.iter().map(|(seconds, text)| format!("{seconds:>8.1} s  {text}\n"));
    format!("{}\n{}", activity.name, lines.collect::<String>())
}
