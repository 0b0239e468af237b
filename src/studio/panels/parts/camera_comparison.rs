//! Comparison of systems by the information of their captures.

use std::sync::Arc;

use egui::{Button, ComboBox, Grid, Label, RichText, Ui};

use crate::evaluation::Compared;
use crate::information::{Estimate, Estimator, interval_behind, rounded, with_interval};
use crate::studio::panels::parts::{camera_calibration, fit_length};
use crate::studio::state::camera::{CameraState, ComparisonForm, OF_IMAGES, PATCH, name_of};
use crate::studio::state::request::{CameraRequest, Request};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{ComparisonOrder, ComparisonResults, SystemCaptures, comparison_command};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Largest mean of equal light, photons per pixel.
const MOST_LIGHT: f64 = 1e6;
/// Least decimals of a number of bits.
const DECIMALS: usize = 3;

/// Shows the comparison.
pub fn show(ui: &mut Ui, state: &mut CameraState, view: &View<'_>, requests: &mut Vec<Request>) {
    let captures = state.captures.captures();
    let work = &view.cameras.comparison_state;
    ui.horizontal_wrapped(|ui| form(ui, &mut state.comparison));
    ui.horizontal_wrapped(|ui| {
        let is_ready = captures.as_ref().is_ok_and(|captures| !captures.sources.is_empty());
        let start = ui.add_enabled(is_ready && !work.is_working(), Button::new("Estimate"));
        let why = if is_ready { "An estimate is running" } else { "Add captures first" };
        let start = start.on_hover_text("Estimates the information of all captures").on_disabled_hover_text(why);
        name_widget(&start, "Estimate systems");
        if start.clicked()
            && let Ok(captures) = &captures
        {
            let order = order(&state.comparison, captures, view);
            requests.push(Request::Camera(CameraRequest::Compare(Box::new(order))));
        }
    });
    let stop = || Request::Camera(CameraRequest::StopComparison);
    camera_calibration::progress(ui, work, "Cancel comparison", stop, requests);
    let Some(results) = &view.cameras.comparison else {
        if !work.is_working() {
            ui.weak("Noisy images stand in for noiseless ones, which is accurate above 10 photons per pixel.");
        }
        return;
    };
    ui.separator();
    let order = &results.order;
    if !captures.is_ok_and(|captures| captures.is_same(&order.captures)) {
        ui.horizontal_wrapped(|ui| {
            ui.colored_label(ui.visuals().warn_fg_color, "These numbers belong to earlier captures or options.");
            let back = ui.small_button("Choose them again");
            let back = back.on_hover_text("Replaces the captures and options by those of these numbers");
            name_widget(&back, "Choose the captures of the comparison");
            if back.clicked() {
                state.captures.take(&order.captures);
            }
        });
    }
    if !results.is_of_this_version {
        let text = "These numbers are of an earlier version of the program, which may compute others.";
        ui.colored_label(ui.visuals().warn_fg_color, text);
    }
    table(ui, results);
    details(ui, &mut state.comparison, results, requests);
}

/// Form of the estimates.
fn form(ui: &mut Ui, form: &mut ComparisonForm) {
    let known = OF_IMAGES.iter().find(|(kind, _)| *kind == form.kind);
    let response = ComboBox::from_id_salt("estimator of systems")
        .selected_text(known.map_or("", |(_, name)| name))
        .width(96.0)
        .show_ui(ui, |ui| {
            for (kind, name) in OF_IMAGES {
                if ui.selectable_value(&mut form.kind, kind, name).clicked() {
                    form.length.turn_to(kind);
                }
            }
        })
        .response;
    name_widget(&response, "Estimator of systems");
    // The Gaussian bound needs no fit.
    if form.kind != Estimator::GaussianStationary {
        fit_length::show(ui, &mut form.length, form.kind, "of the fit to systems");
    }
    let text = |patch: Option<(usize, usize)>| {
        patch.map_or("Whole image".to_owned(), |(rows, cols)| format!("{rows} x {cols} px"))
    };
    let response = ComboBox::from_id_salt("patch of systems")
        .selected_text(text(form.patch))
        .width(96.0)
        .show_ui(ui, |ui| {
            for patch in [PATCH, None] {
                ui.selectable_value(&mut form.patch, patch, text(patch));
            }
        })
        .response;
    name_widget(&response, "Patch of systems");
    let equal = ui.checkbox(&mut form.with_equal_light, "Equal light");
    let hint = "Scales all images to one mean and draws fresh noise, as published, in addition to their own light";
    name_widget(&equal.on_hover_text(hint), "Compare at equal light");
    if form.with_equal_light {
        let field = NumberField::new("Equal light", 1.0..=MOST_LIGHT).speed(1.0).unit(" photons");
        field.edit(ui, &mut form.equal_light).on_hover_text("Mean of all images, photons per pixel");
    }
    let same = ui.checkbox(&mut form.is_simultaneous, "Same scenes");
    let hint = "Frames of equal numbers show the same scene; folders of equal file names count so without it";
    name_widget(&same.on_hover_text(hint), "Simultaneous frames");
}

fn order(form: &ComparisonForm, captures: &SystemCaptures, view: &View<'_>) -> ComparisonOrder {
    ComparisonOrder {
        captures: Arc::new(captures.clone()),
        request: form.request(view.preferences.engine),
        noise: view.open_design.noise,
        equal_light: form.with_equal_light.then_some(form.equal_light),
        seed: view.open_design.seed,
        is_simultaneous: form.is_simultaneous,
    }
}

/// One row for each system.
fn table(ui: &mut Ui, results: &ComparisonResults) {
    let order = &results.order;
    let unit = if order.captures.options.camera.is_some() { "e-/px" } else { "photons/px" };
    let equal = order.equal_light.map_or(String::new(), |light| format!("At {light} photons/px"));
    Grid::new("systems").num_columns(4).striped(true).spacing([14.0, 3.0]).show(ui, |ui| {
        let own = "Own light (bits/px)";
        for heading in ["System", own, equal.as_str(), &format!("Mean ({unit})")] {
            ui.label(RichText::new(heading).size(TEXT).strong());
        }
        ui.end_row();
        for (index, estimate) in results.own.systems.iter().enumerate() {
            let path = order.captures.sources.get(index).map_or_else(String::new, ToString::to_string);
            ui.label(RichText::new(name_of(&path)).size(TEXT)).on_hover_text(path);
            let bits = |estimate: &Estimate| with_interval(estimate.bits_per_pixel, estimate.interval_95);
            ui.label(RichText::new(bits(estimate)).size(TEXT));
            let equal = results.equal.as_ref().and_then(|equal| equal.systems.get(index));
            ui.label(RichText::new(equal.map_or_else(String::new, bits)).size(TEXT));
            let mean = results.own.means.get(index).copied().unwrap_or_default();
            ui.label(RichText::new(format!("{mean:.1}")).size(TEXT));
            ui.end_row();
        }
    });
}

/// Differences, notes and copies of the shown light.
fn details(ui: &mut Ui, form: &mut ComparisonForm, results: &ComparisonResults, requests: &mut Vec<Request>) {
    let shows_equal = form.shows_equal && results.equal.is_some();
    let shown: &Compared = results.equal.as_ref().filter(|_| shows_equal).unwrap_or(&results.own);
    ui.add_space(4.0);
    ui.horizontal_wrapped(|ui| {
        if results.equal.is_some() {
            for (equal, text) in [(false, "Own light"), (true, "Equal light")] {
                let response = ui.selectable_label(shows_equal == equal, text);
                name_widget(&response, &format!("Details at {}", text.to_lowercase()));
                if response.clicked() {
                    form.shows_equal = equal;
                }
            }
            ui.separator();
        }
        let copy = ui.small_button("Copy command line");
        let copy = copy.on_hover_text("Copies the command line that reproduces these numbers");
        name_widget(&copy, "Copy command line of the comparison");
        if copy.clicked() {
            requests.push(Request::CopyCommand(Ok(comparison_command(&results.order, shows_equal))));
        }
        let copy = ui.small_button("Copy as JSON");
        name_widget(&copy, "Copy comparison as JSON");
        if copy.clicked()
            && let Some(text) = json(shown)
        {
            requests.push(Request::Copy { text, what: "Comparison" });
        }
    });
    for difference in &shown.differences {
        let (of, than) = (name_of(&difference.of), name_of(&difference.than));
        let pairing = if difference.is_paired { "paired" } else { "not paired" };
        let bits = rounded(difference.bits_per_pixel);
        let interval = interval_behind(difference.interval_95, DECIMALS);
        let text = format!("{of} less {than}: {bits} bits/px{interval}, {pairing}");
        ui.label(RichText::new(text).size(TEXT)).on_hover_text(difference.to_string());
    }
    for (index, estimate) in shown.systems.iter().enumerate() {
        let path = results.order.captures.sources.get(index).map_or_else(String::new, ToString::to_string);
        let [rows, cols] = estimate.patch;
        let settings = format!(
            "{}: {}, {} noise, patch {rows} x {cols} px, {:.1} s",
            name_of(&path),
            estimate.estimator,
            estimate.noise,
            estimate.seconds
        );
        ui.label(RichText::new(settings).size(TEXT).strong());
        for note in &estimate.notes {
            let text = RichText::new(format!("note: {note}")).size(TEXT);
            let is_error = note.starts_with("error");
            let text = if is_error { text.color(ui.visuals().error_fg_color) } else { text.weak() };
            ui.add(Label::new(text).wrap());
        }
    }
}

/// The JSON that the command line prints.
fn json(compared: &Compared) -> Option<String> {
    match compared.systems.as_slice() {
        [single] => serde_json::to_string_pretty(single).ok(),
        _ => serde_json::to_string_pretty(&compared.marked()).ok(),
    }
}
