//! Calibration of a camera: frames in groups, the table of EMVA 1288, and its plots.

use std::sync::Arc;

use egui::{Align, Button, Grid, Label, Layout, ProgressBar, RichText, Ui};

use crate::camera::{CameraCalibration, FrameSeries, GroupSummary};
use crate::studio::panels::parts::camera_plots;
use crate::studio::state::camera::{CalibrationPart, CameraPath, CameraState, CameraTab};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{CameraRequest, Request};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;
use crate::workbench::{CalibrationOrder, CalibrationResults, WorkState};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Height of the rows of a table, points.
const ROW: f32 = 16.0;

/// Shows the calibration.
pub fn show(ui: &mut Ui, state: &mut CameraState, view: &View<'_>, requests: &mut Vec<Request>) {
    let (results, work) = (&view.cameras.calibration, &view.cameras.calibration_state);
    sources(ui, requests);
    regroup(state, results, work, requests);
    show_news(state, results);
    progress(ui, work, "Cancel calibration", || Request::Camera(CameraRequest::StopCalibration), requests);
    if results.series.is_none() && results.camera.is_none() {
        if !work.is_working() {
            ui.weak(
                "A calibration measures gain, noise and saturation of a camera. It needs dark frames and pairs of frames at \
                 several light levels, in a folder or a descriptor of EMVA 1288.",
            );
        }
        return;
    }
    buttons(ui, state, results, work, requests);
    ui.horizontal_wrapped(|ui| {
        for (part, text, needs_camera) in [
            (CalibrationPart::Groups, "Groups", false),
            (CalibrationPart::Values, "Values", true),
            (CalibrationPart::PhotonTransfer, "Photon transfer", true),
            (CalibrationPart::Linearity, "Linearity", true),
            (CalibrationPart::Snr, "SNR", true),
        ] {
            let is_known = if needs_camera { results.camera.is_some() } else { results.series.is_some() };
            ui.add_enabled_ui(is_known, |ui| {
                let response = ui.selectable_value(&mut state.part, part, text);
                name_widget(&response, &format!("Calibration: {}", text.to_lowercase()));
            });
        }
    });
    match (state.part, &results.camera, &results.series) {
        (CalibrationPart::Groups, _, Some(series)) => groups(ui, series, &results.groups),
        (CalibrationPart::PhotonTransfer, Some(camera), _) => {
            camera_plots::photon_transfer(ui, &camera.calibration, &mut state.is_logarithmic);
        }
        (CalibrationPart::Linearity, Some(camera), _) => camera_plots::linearity(ui, &camera.calibration),
        (CalibrationPart::Snr, Some(camera), _) => camera_plots::signal_to_noise(ui, &camera.calibration),
        (_, Some(camera), _) => table(ui, &camera.calibration),
        _ => {}
    }
}

/// Buttons that choose frames or a camera file.
fn sources(ui: &mut Ui, requests: &mut Vec<Request>) {
    ui.horizontal_wrapped(|ui| {
        for (text, name, path) in [
            ("Folder...", "Choose folder of frames", CameraPath::Frames),
            ("Descriptor...", "Choose descriptor of frames", CameraPath::Descriptor),
            ("Open camera...", "Open camera file", CameraPath::CameraFile),
        ] {
            let response = ui.button(text).on_hover_text(path.hint());
            name_widget(&response, name);
            if response.clicked() {
                requests.push(Request::AskPath(PathPurpose::Camera(path)));
            }
        }
    });
}

/// Reads the groups again where another colour is taken.
fn regroup(state: &mut CameraState, results: &CalibrationResults, work: &WorkState, requests: &mut Vec<Request>) {
    if let (Some(path), Some(known)) = (&state.frames, results.colour)
        && known != state.colour
        && !work.is_working()
    {
        let order = CalibrationOrder::Group { path: path.clone(), colour: state.colour };
        requests.push(Request::Camera(CameraRequest::Calibrate(order)));
    }
}

/// Shows the table of a new camera, and the groups of new frames.
fn show_news(state: &mut CameraState, results: &CalibrationResults) {
    let has_camera = results.camera.is_some();
    if has_camera != state.had_camera {
        state.part = if has_camera { CalibrationPart::Values } else { CalibrationPart::Groups };
    }
    state.had_camera = has_camera;
}

/// The step of the work with a button that stops it, or the reason why it failed.
pub fn progress(ui: &mut Ui, work: &WorkState, cancel: &str, stop: impl Fn() -> Request, requests: &mut Vec<Request>) {
    match work {
        WorkState::Idle => {}
        WorkState::Working { step, share } => {
            ui.horizontal(|ui| {
                let button = ui.small_button("Cancel");
                name_widget(&button, cancel);
                if button.clicked() {
                    requests.push(stop());
                }
                ui.add(Label::new(RichText::new(step).size(TEXT).weak()).truncate());
            });
            ui.add(ProgressBar::new(share.unwrap_or(0.0) as f32).desired_height(8.0));
        }
        WorkState::Failed(sentence) => {
            ui.colored_label(ui.visuals().error_fg_color, sentence);
        }
    }
}

/// Buttons that calibrate, save and use the camera.
fn buttons(
    ui: &mut Ui,
    state: &mut CameraState,
    results: &CalibrationResults,
    work: &WorkState,
    requests: &mut Vec<Request>,
) {
    let path = results.series.as_ref().map(|series| &series.path).or(results.file.as_ref());
    if let Some(path) = path {
        ui.add(Label::new(RichText::new(path.display().to_string()).size(TEXT).weak()).truncate());
    }
    ui.horizontal_wrapped(|ui| {
        if let Some(series) = &results.series {
            let start = ui.add_enabled(!work.is_working(), Button::new("Calibrate"));
            name_widget(&start.clone().on_disabled_hover_text("The frames are read"), "Calibrate");
            if start.clicked() {
                state.saved = None;
                let order = CalibrationOrder::Calibrate { series: Arc::clone(series), colour: state.colour };
                requests.push(Request::Camera(CameraRequest::Calibrate(order)));
            }
        }
        let Some(camera) = &results.camera else { return };
        let save =
            ui.button("Save camera...").on_hover_text("Writes the camera file, its maps (NPY) and a drawing (SVG)");
        name_widget(&save, "Save camera");
        if save.clicked() {
            requests.push(Request::AskPath(PathPurpose::SaveCamera(Arc::clone(camera))));
        }
        if let Some(file) = results.file.as_ref().or(state.saved.as_ref()) {
            let response = ui.button("Use for captures").on_hover_text("Converts the captures with this camera file");
            name_widget(&response, "Use camera for captures");
            if response.clicked() {
                state.captures.camera = Some(file.display().to_string());
                state.tab = CameraTab::Captures;
            }
        }
    });
}

/// A number at the right of its column.
fn number(ui: &mut Ui, text: String) {
    ui.with_layout(Layout::right_to_left(Align::Center), |ui| ui.label(RichText::new(text).size(TEXT)));
}

/// The groups of frames, before they are used.
fn groups(ui: &mut Ui, series: &FrameSeries, known: &[GroupSummary]) {
    ui.label(RichText::new(format!("Groups by {}", series.grouping)).size(TEXT));
    let grid = Grid::new("groups of frames").num_columns(6).striped(true).spacing([12.0, 2.0]);
    grid.min_row_height(ROW).show(ui, |ui| {
        for heading in ["Role", "Group", "Exposure", "Frames", "Size", "Mean (DN)"] {
            ui.label(RichText::new(heading).size(TEXT).strong());
        }
        ui.end_row();
        for (index, group) in series.groups.iter().enumerate() {
            let summary = known.get(index);
            let size = match summary.map(|summary| summary.shape) {
                None => String::new(),
                Some(None) => "several sizes".into(),
                Some(Some((rows, cols))) => format!("{rows} x {cols} px"),
            };
            for text in [
                if group.is_dark { "dark" } else { "light" }.to_owned(),
                group.label.clone(),
                group.exposure_text().unwrap_or_default(),
            ] {
                ui.label(RichText::new(text).size(TEXT));
            }
            number(ui, summary.map_or(String::new(), |summary| summary.frames.to_string()));
            ui.label(RichText::new(size).size(TEXT));
            number(ui, summary.map_or(String::new(), |summary| format!("{:.1}", summary.mean_dn)));
            ui.end_row();
        }
    });
}

/// The table of the quantities, and notes.
fn table(ui: &mut Ui, camera: &CameraCalibration) {
    let grid = Grid::new("quantities of the camera").num_columns(5).striped(true).spacing([12.0, 2.0]);
    grid.min_row_height(ROW).show(ui, |ui| {
        for heading in ["Quantity", "Symbol", "Value", "Unit", "95 % interval"] {
            ui.label(RichText::new(heading).size(TEXT).strong());
        }
        ui.end_row();
        for quantity in camera.quantities() {
            let unit = quantity.value.map_or("", |_| quantity.unit);
            let (value, interval) = (quantity.value_text(), quantity.interval_text());
            for text in [quantity.name, quantity.symbol] {
                ui.label(RichText::new(text).size(TEXT));
            }
            number(ui, value);
            for text in [unit, interval.as_str()] {
                ui.label(RichText::new(text).size(TEXT));
            }
            ui.end_row();
        }
    });
    for remark in camera.remarks() {
        ui.add(Label::new(RichText::new(remark).size(TEXT).weak()).wrap());
    }
}
