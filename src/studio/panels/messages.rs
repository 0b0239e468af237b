//! Display of messages: failure banner, toasts and log window.

use std::time::Duration;

use egui::accesskit::Live;
use egui::{Color32, RichText, Ui};

use crate::studio::panels::parts::severity_colour::severity_colour;
use crate::studio::state::messages::{Message, Messages, Severity};
use crate::studio::widgets::controls::speak;

/// Display time of a toast, seconds, and maximal number of toasts.
const SHOWN_SECONDS: f64 = 5.0;
const MOST_SHOWN: usize = 3;
/// Maximal width of a toast, points.
const TOAST_WIDTH: f32 = 320.0;

/// Banner with the newest failure.
pub fn banner(ui: &mut Ui, messages: &mut Messages) {
    let Some(failure) = &messages.failure else { return };
    let colour = ui.visuals().error_fg_color;
    let fill = ui.visuals().panel_fill.lerp_to_gamma(colour, 0.12);
    let frame = egui::Frame::new().fill(fill).inner_margin(egui::Margin::symmetric(8, 5));
    let mut dismissed = false;
    egui::Panel::top("failure").frame(frame).show(ui, |ui| {
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            dismissed = ui.button("Dismiss").clicked();
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                let label = ui.add(egui::Label::new(RichText::new(failure).color(colour)).wrap());
                speak(&label, Live::Assertive);
            });
        });
    });
    if dismissed {
        messages.dismiss();
    }
}

/// Toasts of the newest messages; failures have a banner instead.
pub fn toasts(ctx: &egui::Context, messages: &mut Messages) {
    let now = ctx.input(|input| input.time);
    let left = |message: &Message| SHOWN_SECONDS - message.seen.map_or(0.0, |seen| now - seen);
    let recent = messages.entries.iter_mut().rev().take_while(|message| left(message) > 0.0);
    let mut shown: Vec<&mut Message> =
        recent.filter(|message| message.severity != Severity::Failure).take(MOST_SHOWN).collect();
    for message in &mut shown {
        message.seen.get_or_insert(now);
    }
    let Some(oldest) = shown.last() else { return };
    ctx.request_repaint_after(Duration::from_secs_f64(left(oldest)));
    egui::Area::new(egui::Id::unique("toasts"))
        .anchor(egui::Align2::RIGHT_BOTTOM, [-12.0, -34.0])
        .order(egui::Order::Foreground)
        .interactable(false)
        .show(ctx, |ui| {
            for message in shown.iter().rev() {
                egui::Frame::popup(ui.style()).show(ui, |ui| {
                    // Painted: the status line already serves assistive technology.
                    let font = egui::TextStyle::Body.resolve(ui.style());
                    let text = message.text.clone();
                    let galley = ui.painter().layout(text, font, severity_colour(ui, message.severity), TOAST_WIDTH);
                    let (rect, _) = ui.allocate_exact_size(galley.size(), egui::Sense::hover());
                    ui.painter().galley(rect.min, galley, Color32::PLACEHOLDER);
                });
            }
        });
}

/// Log window with all messages, newest first.
pub fn log_window(ctx: &egui::Context, messages: &mut Messages) {
    let mut open = messages.log_open;
    let corner = ctx.content_rect().left_bottom() + egui::vec2(12.0, -36.0);
    let window = egui::Window::new("Messages").open(&mut open).default_size([520.0, 260.0]);
    window.pivot(egui::Align2::LEFT_BOTTOM).default_pos(corner).show(ctx, |ui| {
        if messages.entries.is_empty() {
            ui.weak("There are no messages yet.");
        }
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            for message in messages.entries.iter().rev() {
                ui.label(RichText::new(&message.text).color(severity_colour(ui, message.severity)));
            }
        });
    });
    messages.log_open = open;
}
