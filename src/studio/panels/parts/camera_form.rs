//! Form of an estimate from camera images.

use std::path::PathBuf;

use egui::{ComboBox, Ui};

use crate::evaluation::{Calibration, MeasuredOrder};
use crate::information::{EngineChoice, Estimator};
use crate::studio::panels::parts::fit_length;
use crate::studio::state::estimates::{EstimatesState, OF_IMAGES};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::{EstimatesRequest, Request};
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::FileUse;

/// Shows the form.
pub fn show(ui: &mut Ui, estimates: &mut EstimatesState, engine: EngineChoice, requests: &mut Vec<Request>) {
    ui.collapsing("Camera images", |ui| {
        ui.horizontal_wrapped(|ui| {
            if ui.button("Choose images...").clicked() {
                requests.push(Request::AskPath(PathPurpose::ChooseImages));
            }
            let form = &mut estimates.camera;
            let known = OF_IMAGES.iter().find(|(kind, _)| *kind == form.kind);
            let response = ComboBox::from_id_salt("estimator of images")
                .selected_text(known.map_or("", |(_, name)| name))
                .width(84.0)
                .show_ui(ui, |ui| {
                    for (kind, name) in OF_IMAGES {
                        if ui.selectable_value(&mut form.kind, kind, name).clicked() {
                            form.length.turn_to(kind);
                        }
                    }
                })
                .response;
            name_widget(&response, "Estimator of images");
            // The Gaussian bound needs no fit.
            if form.kind != Estimator::GaussianStationary {
                fit_length::show(ui, &mut form.length, form.kind, "of the fit to images");
            }
            let can_start = form.path.is_some();
            let start = ui.add_enabled(can_start, egui::Button::new("Estimate images"));
            let hint = "Estimates with the patch above and the noise of the scene; noisy images stand in for noiseless ones, which is accurate above 10 photons";
            let start = start.on_hover_text(hint).on_disabled_hover_text("Choose images first");
            if start.clicked()
                && let Some(path) = form.path.clone()
            {
                let measured = MeasuredOrder { source: PathBuf::from(path).into(), calibration: form.calibration };
                let model = form.length.model(form.kind, engine);
                let request = estimates.request_of(model);
                requests.push(Request::Estimates(EstimatesRequest::StartOfImages(measured, request)));
            }
        });
        ui.horizontal(|ui| {
            let form = &mut estimates.camera;
            let Calibration { gain, offset, bin } = &mut form.calibration;
            ui.label("gain");
            let field = NumberField::new("Images: gain", 1e-6..=1e6).speed(0.01);
            field.edit(ui, gain).on_hover_text("Grey values per photon");
            ui.label("offset");
            let field = NumberField::new("Images: offset", -1e6..=1e6).speed(0.1);
            field.edit(ui, offset).on_hover_text("Grey value without light");
            ui.label("bin");
            let field = NumberField::whole("Images: bin", 1..=64);
            field.edit_whole(ui, bin).on_hover_text("Side of the squares of pixels that are summed");
        });
        let form = &mut estimates.camera;
        if let Some(path) = &mut form.path {
            ui.add(egui::Label::new(egui::RichText::new(path.as_str()).weak()).truncate());
            form.preview.show(ui, path, FileUse::Measurements);
        }
    });
}
