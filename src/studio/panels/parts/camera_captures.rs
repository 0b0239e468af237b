//! Captures of systems: their files, how they become electrons, and what was understood.

use std::sync::Arc;

use egui::{Button, ComboBox, Label, RichText, TextEdit, Ui};

use crate::evaluation::Calibration;
use crate::studio::panels::parts::camera_images;
use crate::studio::state::camera::{CameraPath, CameraState, CapturesForm, name_of};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{CameraRequest, Request};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{CapturePreview, SystemCaptures};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Largest side of squares that are summed, px.
const LARGEST_BIN: usize = 64;

/// Shows the captures.
pub fn show(ui: &mut Ui, state: &mut CameraState, view: &View<'_>, requests: &mut Vec<Request>) {
    let form = &mut state.captures;
    ui.horizontal_wrapped(|ui| {
        for (text, name, path) in [
            ("Add folder...", "Add folder of captures", CameraPath::CaptureFolder),
            ("Add file...", "Add file of captures", CameraPath::CaptureFile),
        ] {
            let response = ui.button(text).on_hover_text(path.hint());
            name_widget(&response, name);
            if response.clicked() {
                requests.push(Request::AskPath(PathPurpose::Camera(path)));
            }
        }
    });
    files(ui, form, requests);
    options(ui, form);
    let captures = match form.captures() {
        Ok(captures) => captures,
        Err(sentence) => {
            ui.colored_label(ui.visuals().error_fg_color, sentence);
            return;
        }
    };
    ask(form, &captures, requests);
    ui.separator();
    if captures.sources.is_empty() {
        ui.weak("Add the images of a camera; add those of other cameras to compare them.");
        return;
    }
    // Earlier previews belong to other captures.
    let previews = &view.cameras.previews;
    let known = if previews.of.as_deref() == Some(&captures) { previews.systems.as_slice() } else { &[] };
    systems(ui, form, known);
    if let Some(Ok(preview)) = known.get(form.shown) {
        camera_images::show(ui, form, preview, previews.serial, view, requests);
    }
}

/// Reads the captures once after each change.
fn ask(form: &mut CapturesForm, captures: &SystemCaptures, requests: &mut Vec<Request>) {
    if form.asked.as_deref() != Some(captures) {
        let captures = Arc::new(captures.clone());
        form.asked = Some(Arc::clone(&captures));
        requests.push(Request::Camera(CameraRequest::Preview(captures)));
    }
}

/// Camera file, dark and flat images: a button for each that is missing, the name of each that is chosen.
fn files(ui: &mut Ui, form: &mut CapturesForm, requests: &mut Vec<Request>) {
    ui.horizontal_wrapped(|ui| {
        for (name, path, value) in [
            ("camera file", CameraPath::CameraOfCaptures, &mut form.camera),
            ("dark images", CameraPath::Dark, &mut form.dark),
            ("flat images", CameraPath::Flat, &mut form.flat),
        ] {
            let text = value.as_ref().map_or_else(|| sentence_case(name) + "...", |known| name_of(known));
            let choose = ui.button(text);
            let hint = value.as_ref().map_or_else(|| path.hint().to_owned(), |known| format!("{name}: {known}"));
            name_widget(&choose.clone().on_hover_text(hint), &format!("Choose {name}"));
            if choose.clicked() {
                requests.push(Request::AskPath(PathPurpose::Camera(path)));
            }
            if value.is_some() {
                let clear = ui.small_button("\u{d7}").on_hover_text("Leaves it out");
                name_widget(&clear, &format!("Leave out {name}"));
                if clear.clicked() {
                    *value = None;
                }
            }
        }
    });
}

/// A text with a capital at its start.
fn sentence_case(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Gain, bins, crop and orientation.
fn options(ui: &mut Ui, form: &mut CapturesForm) {
    ui.horizontal_wrapped(|ui| {
        let Calibration { gain, offset, bin } = &mut form.calibration;
        if form.camera.is_none() {
            ui.label("Gain");
            let field = NumberField::new("Captures: gain", 1e-6..=1e6).speed(0.01);
            field.edit(ui, gain).on_hover_text("Grey values (DN) per photon");
            if form.dark.is_none() {
                ui.label("Offset");
                let field = NumberField::new("Captures: offset", -1e6..=1e6).speed(0.1);
                field.edit(ui, offset).on_hover_text("Grey value (DN) without light");
            }
        }
        ui.label("Bin");
        let field = NumberField::whole("Captures: bin", 1..=LARGEST_BIN);
        field.edit_whole(ui, bin).on_hover_text("Side of the squares of pixels that are summed");
        ui.label("Crop");
        let field = TextEdit::singleline(&mut form.typed_crop).desired_width(92.0).hint_text("64x96+10+20");
        let field = ui.add(field).on_hover_text("ROWSxCOLS+TOP+LEFT in pixels; empty for whole images");
        name_widget(&field, "Captures: crop");
        if field.lost_focus() {
            form.crop.clone_from(&form.typed_crop);
        }
        let turns = |turns: u8| format!("{}\u{b0}", 90 * u16::from(turns));
        let response = ComboBox::from_id_salt("turn of captures")
            .selected_text(turns(form.quarter_turns))
            .width(52.0)
            .show_ui(ui, |ui| {
                for choice in 0..4 {
                    ui.selectable_value(&mut form.quarter_turns, choice, turns(choice));
                }
            })
            .response;
        name_widget(
            &response.on_hover_text("Turns the images counter-clockwise, after the crop"),
            "Captures: rotation",
        );
        let mirror = ui.checkbox(&mut form.is_mirrored, "Mirror");
        name_widget(&mirror.on_hover_text("Mirrors left to right, after the turn"), "Captures: mirror");
    });
}

/// The systems with what was understood of each.
fn systems(ui: &mut Ui, form: &mut CapturesForm, known: &[Result<CapturePreview, String>]) {
    let mut removed = None;
    for index in 0..form.systems.len() {
        let name = form.name(index);
        ui.horizontal(|ui| {
            let remove = ui.add(Button::new("\u{d7}").small()).on_hover_text("Takes this system out");
            name_widget(&remove, &format!("Remove system {}", index + 1));
            if remove.clicked() {
                removed = Some(index);
            }
            let response = ui.selectable_label(form.shown == index, RichText::new(&name).strong());
            name_widget(&response, &format!("System {}: {name}", index + 1));
            if response.on_hover_text(form.systems[index].as_str()).clicked() {
                form.shown = index;
            }
        });
        match known.get(index) {
            None => {
                ui.weak("Reading the files");
            }
            Some(Ok(preview)) => {
                ui.add(Label::new(RichText::new(&preview.understood).size(TEXT)).wrap());
                if preview.images == 1 {
                    ui.weak("One image is shown. An estimate needs 2 or more.");
                }
            }
            Some(Err(sentence)) => {
                ui.colored_label(ui.visuals().error_fg_color, sentence);
            }
        }
    }
    if let Some(index) = removed {
        form.remove(index);
    }
}
