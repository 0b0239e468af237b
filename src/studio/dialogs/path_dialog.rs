//! The dialog that asks for a path, typed or chosen in the file dialog of the system.
//!
//! If the system has no file dialog, a message says so and the path field takes the keyboard.

use std::path::Path;
use std::sync::mpsc::TryRecvError;

use egui::accesskit::Live;
use egui::{Key, TextEdit};

use crate::formats::path_text;
use crate::studio::dialogs::system_dialog;
use crate::studio::state::path_dialog::{Answer, PathDialog, PathPurpose, PathQuestion, Picker};
use crate::studio::state::request::Request;
use crate::studio::widgets::controls::{name_widget, speak};
use crate::studio::widgets::modal;
use crate::workbench::MeasurementFormat;

/// Message if the system has no file dialog.
pub const NO_DIALOG: &str =
    "This system has no file dialog: neither a desktop portal nor zenity answers. Type the path above.";

/// Shows the open question. `own` is the file of the design.
pub fn show(ctx: &egui::Context, dialog: &mut PathDialog, own: Option<&Path>, requests: &mut Vec<Request>) {
    let Some(mut question) = dialog.open.take() else { return };
    if let Some(system) = &question.system {
        match system.try_recv() {
            Ok(Answer::Chosen(path)) => {
                question.path = path_text(&path);
                question.chosen = Some(path.clone());
                question.system = None;
                // The dialog of the system has asked about this file already.
                let has_asked = question.purpose.picker() == Picker::Save && question.target() == path;
                question.replaced = if has_asked { question.would_replace(own) } else { Vec::new() };
            }
            Ok(Answer::Missing) => {
                question.system = None;
                (question.is_alone, question.focus) = (true, true);
            }
            Ok(Answer::Cancelled) | Err(TryRecvError::Disconnected) => question.system = None,
            Err(TryRecvError::Empty) => {}
        }
    }
    let mut done = false;
    let mut cancelled = false;
    modal::show(ctx, "path question", 480.0, |ui| {
        ui.heading(question.purpose.title());
        ui.add_space(4.0);
        ui.label(question.purpose.hint());
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            let browse = 80.0;
            let width = (ui.available_width() - browse).max(80.0);
            let field = ui.add(TextEdit::singleline(&mut question.path).desired_width(width).hint_text("Path"));
            name_widget(&field, "Path");
            if question.focus {
                field.request_focus();
                question.focus = false;
            }
            let confirmed = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            done |= confirmed && !question.path.trim().is_empty();
            if ui.add_enabled(question.system.is_none(), egui::Button::new("Browse...")).clicked() {
                question.system = system_dialog::open(ui.ctx(), question.purpose.picker(), Path::new(&question.path));
            }
        });
        if question.is_alone {
            let notice = ui.colored_label(ui.visuals().warn_fg_color, NO_DIALOG);
            speak(&notice, Live::Assertive);
        }
        if let Some(of) = question.purpose.file_use() {
            question.preview.show_in_place(ui, &mut question.path, of);
        }
        let mut action = question.purpose.action();
        if let Some(text) = PathQuestion::ask_to_replace(&question.replaced)
            && question.replaced == question.would_replace(own)
        {
            let asked = ui.colored_label(ui.visuals().warn_fg_color, text);
            speak(&asked, Live::Assertive);
            action = "Replace";
        }
        if matches!(question.purpose, PathPurpose::ExportMeasurements) {
            ui.horizontal(|ui| {
                ui.radio_value(&mut question.format, MeasurementFormat::Npy, "NPY");
                ui.radio_value(&mut question.format, MeasurementFormat::Tiff, "TIFF, 32-bit float");
            });
        }
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            let ready = !question.path.trim().is_empty();
            done |= ui.add_enabled(ready, egui::Button::new(action)).clicked();
            cancelled |= ui.button("Cancel").clicked() || ui.input(|input| input.key_pressed(Key::Escape));
        });
    });
    if done {
        let there = question.would_replace(own);
        done = there.iter().all(|file| question.replaced.contains(file));
        question.replaced = there;
        // The field takes the keyboard: Enter confirms, typing chooses another name.
        question.focus = !done;
    }
    if done {
        requests.push(Request::UsePath(Box::new(question)));
    } else if !cancelled {
        dialog.open = Some(question);
    }
}
