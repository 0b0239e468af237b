//! The dialog that makes a PSF of a photograph: live preview, options, and what they keep of the light.

use std::path::Path;
use std::sync::mpsc::TryRecvError;

use egui::accesskit::Live;
use egui::{ComboBox, Key, RichText, TextEdit, Ui, vec2};

use crate::formats::{Channel, path_text};
use crate::optics::{ImportedPsf, LensletArray, PixelRectangle, PsfDark, PsfOptionsIn, PsfScale, PsfWindow};
use crate::studio::canvas::image_view::ColourPalettes;
use crate::studio::dialogs::path_dialog::NO_DIALOG;
use crate::studio::dialogs::{psf_images, system_dialog};
use crate::studio::state::path_dialog::{Answer, PathPurpose, Picker};
use crate::studio::state::psf_import::{PsfImportDialog, PsfImportForm};
use crate::studio::state::request::Request;
use crate::studio::widgets::controls::{name_widget, speak};
use crate::studio::widgets::modal;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::PsfPreview;

/// Width of the dialog, points.
const WIDTH: f32 = 780.0;
/// Width of the names of the fields, points.
const NAMES: f32 = 76.0;
/// Width of the drop-down lists, points.
const LISTS: f32 = 150.0;
/// Limits of a typed grey value, DN.
const MOST_GREY: f64 = 1e9;
/// Height of the report, of seven lines, points of the screen.
const REPORT: f32 = 130.0;
/// Initial values of a bin and a grid, pixels.
const BIN: usize = 8;
const GRID: usize = 32;
/// Channels of colour images.
const CHANNELS: [(Channel, &str); 3] = [(Channel::Red, "Red"), (Channel::Green, "Green"), (Channel::Blue, "Blue")];

/// Shows the dialog if it is open. `is_covered` is true while a question for a path is in front of it.
pub fn show(
    ctx: &egui::Context,
    dialog: &mut PsfImportDialog,
    is_covered: bool,
    palettes: &ColourPalettes,
    requests: &mut Vec<Request>,
) {
    let Some(mut form) = dialog.open.take() else { return };
    take_answer(&mut form);
    form.follow(ctx);
    let (mut done, mut cancelled) = (false, false);
    modal::show(ctx, "PSF import", WIDTH, |ui| {
        modal::body(ui, |ui| {
            ui.heading("Import PSF");
            ui.add_space(4.0);
            done = path_row(ui, &mut form);
            ui.add_space(4.0);
            content(ui, &mut form, palettes);
        });
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            let is_named = !form.path.trim().is_empty();
            done |= ui.add_enabled(is_named, egui::Button::new("Import")).clicked();
            let settings = ui.add_enabled(form.photograph.is_some(), egui::Button::new("Save settings..."));
            let settings = settings.on_hover_text("Writes a TOML file that repeats this import: psf:FILE.toml");
            if settings.clicked()
                && let Some(photograph) = form.photograph.clone()
            {
                requests.push(Request::AskPath(PathPurpose::SavePsfSettings(photograph)));
            }
            let cancel = ui.button("Cancel");
            name_widget(&cancel, "Cancel the import");
            cancelled |= cancel.clicked();
        });
        cancelled |= !is_covered && ui.input(|input| input.key_pressed(Key::Escape));
    });
    form.is_confirmed |= done;
    if form.is_confirmed && form.is_current() {
        if form.is_ready()
            && let Some(photograph) = &form.photograph
        {
            requests.push(Request::ImportPsf(photograph.text().into()));
            return;
        }
        form.is_confirmed = false;
    }
    if !cancelled {
        dialog.open = Some(form);
    }
}

/// Takes the answer of the file dialog of the system.
fn take_answer(form: &mut PsfImportForm) {
    let Some(system) = &form.system else { return };
    match system.try_recv() {
        Ok(Answer::Chosen(path)) => {
            form.path = path_text(&path);
            form.path_changed();
        }
        Ok(Answer::Missing) => (form.is_alone, form.focus) = (true, true),
        Ok(Answer::Cancelled) | Err(TryRecvError::Disconnected) => {}
        Err(TryRecvError::Empty) => return,
    }
    form.system = None;
}

/// The path field. Returns whether Enter confirmed it.
fn path_row(ui: &mut Ui, form: &mut PsfImportForm) -> bool {
    let mut confirmed = false;
    ui.horizontal(|ui| {
        let width = (ui.available_width() - 80.0).max(80.0);
        let hint = "An image, an array, or the settings of an import (TOML)";
        let field = ui.add(TextEdit::singleline(&mut form.path).desired_width(width).hint_text(hint));
        name_widget(&field, "Path of the PSF");
        if form.focus {
            field.request_focus();
            form.focus = false;
        }
        if field.changed() {
            form.path_changed();
        }
        let is_entered = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
        confirmed = is_entered && !form.path.trim().is_empty();
        let browse = ui.add_enabled(form.system.is_none(), egui::Button::new("Browse..."));
        name_widget(&browse, "Browse for the PSF");
        if browse.clicked() {
            form.system = system_dialog::open(ui.ctx(), Picker::Open, Path::new(&form.path));
        }
    });
    if form.is_alone {
        let notice = ui.colored_label(ui.visuals().warn_fg_color, NO_DIALOG);
        speak(&notice, Live::Assertive);
    }
    confirmed
}

/// Preview, options and report.
fn content(ui: &mut Ui, form: &mut PsfImportForm, palettes: &ColourPalettes) {
    let Some((preview, serial)) = form.preview().map(|(preview, serial)| (preview.clone(), serial)) else {
        if form.path.trim().is_empty() {
            ui.weak("Choose a photograph of a point source behind the mask, or a PSF as an array.");
        } else {
            ui.weak("Reading the file");
        }
        return;
    };
    match preview {
        Ok(preview) => {
            psf_images::show(ui, form, &preview, serial, palettes);
            ui.add_space(4.0);
            options(ui, form, &preview);
            ui.add_space(4.0);
            // A dialog that grows moves under the pointer that drags the window.
            ui.scope(|ui| {
                ui.set_min_height(REPORT);
                report(ui, &preview.psf, preview.psf.as_ref().map(|imported| imported.summary.to_string()).ok());
            });
        }
        Err(sentence) => speak(&ui.colored_label(ui.visuals().warn_fg_color, sentence), Live::Polite),
    }
}

/// What the import does with the light, warnings first.
fn report(ui: &mut Ui, psf: &Result<ImportedPsf, String>, summary: Option<String>) {
    match psf {
        Ok(ImportedPsf { report, .. }) => {
            for warning in report.warnings(PsfOptionsIn::Dialog) {
                speak(&ui.colored_label(ui.visuals().warn_fg_color, sentence_case(&warning)), Live::Polite);
            }
            for fact in report.facts(PsfOptionsIn::Dialog) {
                ui.add(egui::Label::new(RichText::new(sentence_case(&fact)).size(12.0)).wrap());
            }
        }
        Err(sentence) => speak(&ui.colored_label(ui.visuals().error_fg_color, sentence), Live::Polite),
    }
    if let Some(summary) = summary {
        ui.add(egui::Label::new(RichText::new(format!("File: {summary}")).size(12.0).weak()).wrap());
    }
}

fn sentence_case(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// The options of the import.
fn options(ui: &mut Ui, form: &mut PsfImportForm, preview: &PsfPreview) {
    if preview.has_colours
        && let Some(photograph) = &mut form.photograph
    {
        ui.horizontal_wrapped(|ui| {
            field_name(ui, "Channel");
            let mut channel = photograph.file.meaning.channel.unwrap_or(Channel::Green);
            let text = CHANNELS.iter().find(|(known, _)| *known == channel);
            let text = text.map_or_else(|| format!("Channel {channel}"), |(_, text)| (*text).to_owned());
            list(ui, "PSF: channel", &text, &mut channel, &CHANNELS);
            photograph.file.meaning.channel = Some(channel);
        });
    }
    let window = form.window().unwrap_or_default();
    let Some(options) = form.options() else { return };
    ui.horizontal_wrapped(|ui| {
        field_name(ui, "Dark level");
        let level = match options.dark {
            PsfDark::Level(level) => level,
            _ => preview.psf.as_ref().ok().and_then(|psf| psf.report.dark).map_or(0.0, |dark| dark.level),
        };
        let choices = [
            (PsfDark::None, "None"),
            (PsfDark::Corners, "Median of the corners"),
            (PsfDark::Level(level), "Grey value"),
        ];
        let text = name_of(&choices, |dark| std::mem::discriminant(dark) == std::mem::discriminant(&options.dark));
        list(ui, "PSF: dark level", text, &mut options.dark, &choices);
        if let PsfDark::Level(level) = &mut options.dark {
            NumberField::new("PSF: dark grey value", -MOST_GREY..=MOST_GREY).unit(" DN").decimals(3).edit(ui, level);
        }
    });
    ui.horizontal_wrapped(|ui| {
        field_name(ui, "Window");
        let choices = [
            (PsfWindow::All, "Whole photograph"),
            (PsfWindow::Auto, "Square around the light"),
            (PsfWindow::Square, "Central square"),
            (PsfWindow::Rectangle(window), "Rectangle"),
        ];
        let text =
            name_of(&choices, |choice| std::mem::discriminant(choice) == std::mem::discriminant(&options.window));
        list(ui, "PSF: window", text, &mut options.window, &choices);
        rectangle(ui, &mut options.window, window, preview.shape);
    });
    ui.horizontal_wrapped(|ui| {
        field_name(ui, "Pixels");
        let choices = [
            (PsfScale::One, "As they are"),
            (PsfScale::Bin(BIN), "Sums of squares of"),
            (PsfScale::Grid(GRID), "Averages, longer side"),
        ];
        let text = name_of(&choices, |scale| std::mem::discriminant(scale) == std::mem::discriminant(&options.scale));
        list(ui, "PSF: pixels", text, &mut options.scale, &choices);
        let longest = preview.shape.0.max(preview.shape.1).max(1);
        match &mut options.scale {
            PsfScale::One => {}
            PsfScale::Bin(bin) => {
                NumberField::whole("PSF: bin", 1..=longest).unit(" px").edit_whole(ui, bin);
            }
            PsfScale::Grid(grid) => {
                NumberField::whole("PSF: grid", 1..=LensletArray::MAX_SIDE).unit(" px").edit_whole(ui, grid);
            }
        }
        ui.separator();
        ui.label("Turn");
        let turns = [(0, "0\u{b0}"), (1, "90\u{b0}"), (2, "180\u{b0}"), (3, "270\u{b0}")];
        let text = name_of(&turns, |turn| *turn == options.quarter_turns % 4);
        let response = ComboBox::from_id_salt("PSF: turn").selected_text(text).width(64.0).show_ui(ui, |ui| {
            for (turn, text) in turns {
                ui.selectable_value(&mut options.quarter_turns, turn, text);
            }
        });
        name_widget(&response.response, "PSF: turn counter-clockwise");
        ui.checkbox(&mut options.is_mirrored, "Mirror left to right");
    });
}

/// Fields of the window; a change makes a rectangle of it.
fn rectangle(ui: &mut Ui, choice: &mut PsfWindow, window: PixelRectangle, (rows, cols): (usize, usize)) {
    let mut edited = window;
    for (name, label, most, value) in [
        ("PSF: top", "top", rows.saturating_sub(1), &mut edited.top),
        ("PSF: left", "left", cols.saturating_sub(1), &mut edited.left),
        ("PSF: rows", "rows", rows, &mut edited.rows),
        ("PSF: columns", "columns", cols, &mut edited.cols),
    ] {
        ui.label(label);
        NumberField::whole(name, usize::from(label.ends_with('s'))..=most).edit_whole(ui, value);
    }
    if edited != window {
        // A window that would leave the photograph is made smaller.
        edited.rows = edited.rows.min(rows - edited.top.min(rows)).max(1);
        edited.cols = edited.cols.min(cols - edited.left.min(cols)).max(1);
        *choice = PsfWindow::Rectangle(edited);
    }
}

/// Name of the first choice that is the chosen one.
fn name_of<T>(choices: &[(T, &'static str)], is_chosen: impl Fn(&T) -> bool) -> &'static str {
    choices.iter().find(|(choice, _)| is_chosen(choice)).map_or("", |(_, name)| name)
}

/// A drop-down list.
fn list<T: Copy + PartialEq>(ui: &mut Ui, name: &str, text: &str, chosen: &mut T, choices: &[(T, &str)]) {
    let response = ComboBox::from_id_salt(name).selected_text(text).width(LISTS).show_ui(ui, |ui| {
        for (choice, label) in choices {
            ui.selectable_value(chosen, *choice, *label);
        }
    });
    name_widget(&response.response, name);
}

/// Name of a field, of the same width for all.
fn field_name(ui: &mut Ui, name: &str) {
    ui.allocate_ui_with_layout(vec2(NAMES, 18.0), egui::Layout::left_to_right(egui::Align::Center), |ui| {
        ui.set_min_width(NAMES);
        ui.label(name);
    });
}
