//! What a decoder makes of the shown measurement, its error and its uncertainty, and how good it is.

use std::sync::Arc;

use egui::{RichText, Ui};
use serde_json::json;

use crate::information::{NUMBERS_VERSION, with_decimals};
use crate::reconstruction::{DecoderKind, DecoderQuality, ImageQuality};
use crate::studio::canvas::image_view::{ImageContent, ImageVersion};
use crate::studio::canvas::overlays::PixelRegion;
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::image_menu::{self, MenuImage};
use crate::studio::panels::parts::training_curves::Curves;
use crate::studio::panels::parts::{linked_cursor, training};
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::reconstruction::{ReconstructionState, ShownQuantity, TEST_OBJECTS};
use crate::studio::state::request::Request;
use crate::studio::state::samples::{SamplesState, Side};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};
use crate::studio::widgets::format::format_significant;
use crate::workbench::{Reconstruction, ReconstructionKey, SeenRegion, SetQuality, reconstruct_command};

/// Size of the numbers, points.
const NUMBERS: f32 = 12.5;

/// Message where a network is in no file.
const NO_FILE: &str = "the weights of this network are in no file; save the design or export the weights first";

/// Shows the panel.
pub fn show(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    requests.push(Request::Reconstruct);
    let key = samples.reconstruction_key(view.revision, &view.trainings.networks);
    let is_network = key.decoder == DecoderKind::Network;
    let shown = view.reconstructions.shown.as_deref();
    toolbar(ui, |ui| {
        method(ui, &mut samples.reconstruction.decoder);
        samples.reconstruction.view_mut().colour_controls(ui, view.palettes);
        switches(ui, &mut samples.reconstruction, shown);
        if is_network {
            training::switch(ui, &mut samples.reconstruction.training, shown, view);
        }
        more(ui, key, view, requests);
    });
    if is_network {
        let is_current = shown.is_some_and(|shown| shown.key.has_decoder_of(&key));
        training::show(ui, &mut samples.reconstruction.training, shown, is_current, view, requests);
    }
    if let Some((_, failure)) = view.reconstructions.failure.as_ref().filter(|(failed, _)| *failed == key) {
        ui.colored_label(ui.visuals().error_fg_color, failure);
        return;
    }
    if is_network && samples.reconstruction.training.curves {
        Curves::of(shown, view).show(ui, &mut samples.reconstruction.training);
        return;
    }
    let Some(reconstruction) = shown else {
        placeholder(ui, view.failure().unwrap_or("Computing"));
        return;
    };
    // While masks of a run are shown as they come, it lags behind.
    let is_followed = view.preview.is_following && reconstruction.key.decoder == key.decoder;
    let is_current = reconstruction.key == key || is_followed;
    numbers(ui, reconstruction, is_current, key, view);
    let values = samples.reconstruction.values_of(reconstruction);
    samples.reconstruction.centre_error(reconstruction.largest_error);
    let index = samples.reconstruction.shown() as usize;
    let version = ImageVersion { revision: reconstruction.serial, index };
    let content = ImageContent { values, version, is_stale: !is_current };
    let SeenRegion { corner, shape } = reconstruction.seen;
    samples.reconstruction.view_mut().set_region(Some(PixelRegion { corner, shape }));
    let image = samples.reconstruction.view_mut().show(ui, view.palettes, content, PointerMode::View);
    let value = linked_cursor::update(ui, samples, view, Side::Reconstruction, &image, values);
    requests.extend(value.map(Request::Describe));
    let menu = MenuImage { image: values, is_current: reconstruction.key == key, shown: &image };
    if image_menu::show(ui, samples.reconstruction.view_mut(), &menu, requests, |_, _, _| {}) {
        linked_cursor::sync_viewports(ui, samples, view, Side::Reconstruction);
    }
}

/// Drop-down of the decoders.
fn method(ui: &mut Ui, decoder: &mut DecoderKind) {
    let response = egui::ComboBox::from_id_salt("reconstruction method")
        .selected_text(decoder.name())
        .width(118.0_f32.min(ui.max_rect().width() - 8.0))
        .show_ui(ui, |ui| {
            // The published U-net is trained by the command line.
            for kind in DecoderKind::ALL.into_iter().filter(|kind| *kind != DecoderKind::Unet) {
                ui.selectable_value(decoder, kind, kind.name());
            }
        })
        .response;
    name_widget(&response, "Reconstruction method");
}

/// Switches of error and uncertainty.
fn switches(ui: &mut Ui, state: &mut ReconstructionState, shown: Option<&Reconstruction>) {
    let has_deviation = shown.is_some_and(|shown| shown.standard_deviation.is_some());
    for (quantity, text, name, is_possible, hint) in [
        (ShownQuantity::Error, "Error", "Reconstruction error", shown.is_some(), "Object minus reconstruction"),
        (
            ShownQuantity::Uncertainty,
            "Uncertainty",
            "Reconstruction uncertainty",
            state.decoder.has_deviation(),
            "Posterior standard deviation of every pixel",
        ),
    ] {
        let mut is_on = state.wanted() == quantity;
        let response = ui.add_enabled(is_possible, egui::Checkbox::new(&mut is_on, text)).on_hover_text(hint);
        let response = response.on_disabled_hover_text("This method gives none");
        name_widget(&response, &format!("Show {}", name.to_lowercase()));
        if response.clicked() {
            state.want(if is_on { quantity } else { ShownQuantity::Object });
        }
    }
    state.follow(has_deviation);
}

/// Menu that copies the numbers or the command that reproduces them, and opens and exports weights.
fn more(ui: &mut Ui, key: ReconstructionKey, view: &View<'_>, requests: &mut Vec<Request>) {
    let shown = view.reconstructions.shown.as_deref().filter(|shown| shown.key == key);
    let set = view.reconstructions.set_of(key);
    let menu = ui.menu_button("...", |ui| {
        if ui.add_enabled(shown.is_some(), egui::Button::new("Copy as JSON")).clicked() {
            let text = shown.map(|shown| numbers_json(shown, set, view));
            requests.extend(text.map(|text| Request::Copy { text, what: "Numbers" }));
            ui.close();
        }
        if ui.button("Copy command line").clicked() {
            let test_objects = set.map_or(TEST_OBJECTS, |set| set.quality.test_objects);
            requests.push(Request::CopyCommand(command(shown, key, view, test_objects)));
            ui.close();
        }
        if key.decoder == DecoderKind::Network {
            ui.separator();
            if ui.button("Open weights...").clicked() {
                requests.push(Request::AskPath(PathPurpose::OpenWeights));
                ui.close();
            }
            let network = shown.and_then(Reconstruction::trained_network);
            if ui.add_enabled(network.is_some(), egui::Button::new("Export weights...")).clicked() {
                let export = |network| Request::AskPath(PathPurpose::ExportWeights(Arc::clone(network)));
                requests.extend(network.map(export));
                ui.close();
            }
        }
    });
    let hint = "Copies the numbers, or the command that tests the method on this design";
    name_widget(&menu.response.on_hover_text(hint), "More of the reconstruction");
}

/// Command that tests what is shown.
fn command(
    shown: Option<&Reconstruction>,
    key: ReconstructionKey,
    view: &View<'_>,
    test_objects: usize,
) -> Result<String, String> {
    let decoder = shown.map_or(key.decoder, Reconstruction::decoder);
    let network = shown.and_then(Reconstruction::trained_network);
    let weights = network.map(|network| view.trainings.networks.file_of(network).ok_or(NO_FILE)).transpose()?;
    reconstruct_command(view.design, decoder, weights, test_objects)
}

/// Quality of the shown image, and of the test set.
fn numbers(ui: &mut Ui, reconstruction: &Reconstruction, is_current: bool, key: ReconstructionKey, view: &View<'_>) {
    let line = match (&reconstruction.quality, reconstruction.iterations) {
        (_, Some((done, most))) => format!("Iteration {done} of at most {most}"),
        (Some(quality), None) => format!("This image: {}", image_line(quality)),
        (None, None) => "Images below 11 px a side have no numbers".into(),
    };
    let line = if is_current { line } else { format!("{line}, of an earlier edit") };
    let text = RichText::new(line).size(NUMBERS);
    let text = if is_current { text } else { text.weak() };
    let text = if reconstruction.iterations.is_some() { text.italics() } else { text };
    ui.label(text);
    let Some(set) = view.reconstructions.set.as_deref() else { return };
    let is_current = set.key.has_decoder_of(&key);
    let text = RichText::new(set_line(set, is_current)).size(NUMBERS);
    let text = if is_current { text } else { text.weak() };
    let is_growing = is_current && set.quality.test_objects < set.planned;
    ui.label(if is_growing { text.italics() } else { text }).on_hover_text(details(&set.quality));
}

fn image_line(quality: &ImageQuality) -> String {
    let r2 = quality.r2.map_or_else(String::new, |r2| format!(", R\u{b2} {r2:.3}"));
    format!("PSNR {:.2} dB, SSIM {:.3}{r2}", quality.psnr_db(), quality.ssim)
}

fn set_line(set: &SetQuality, is_current: bool) -> String {
    let quality = &set.quality;
    let half = |[low, high]: [f64; 2]| 0.5 * (high - low);
    let r2 = quality.r2.zip(quality.r2_interval_95);
    let r2 = r2.map_or_else(String::new, |(r2, interval)| format!(", R\u{b2} {r2:.3} \u{b1} {:.3}", half(interval)));
    let age = if is_current { "" } else { ", of an earlier edit" };
    format!(
        "{} objects: {:.2} \u{b1} {:.2} dB, SSIM {:.3} \u{b1} {:.3}{r2}{age}",
        quality.test_objects,
        quality.psnr_db,
        half(quality.psnr_db_interval_95),
        quality.ssim,
        half(quality.ssim_interval_95),
    )
}

/// All numbers of a test set with their intervals.
fn details(quality: &DecoderQuality) -> String {
    let psnr = with_decimals(quality.psnr_db, quality.psnr_db_interval_95, 2);
    let constant = with_decimals(quality.psnr_constant_db, quality.psnr_constant_db_interval_95, 2);
    let ssim = with_decimals(quality.ssim, quality.ssim_interval_95, 3);
    let peak = format_significant(quality.peak_photons);
    format!(
        "{}, {} test objects\nPSNR {psnr} dB, peak {peak} photons\nSSIM {ssim}\n{constant} dB for the mean object\nIntervals of 95 %",
        quality.decoder, quality.test_objects
    )
}

/// The numbers as JSON.
fn numbers_json(shown: &Reconstruction, set: Option<&SetQuality>, view: &View<'_>) -> String {
    let image = shown.quality.map(
        |quality| json!({ "psnr_db": quality.psnr_db(), "ssim": quality.ssim, "mse": quality.mse, "r2": quality.r2 }),
    );
    let numbers = json!({
        "format": "lenslet-studio/reconstruction-numbers",
        "format_version": 1,
        "program_version": NUMBERS_VERSION,
        "design": &**view.design,
        "decoder": shown.decoder(),
        "network": shown.trained_network().map(|network| &network.training),
        "sample": shown.key.sample + 1,
        "noisy": shown.key.noisy,
        "peak_photons": shown.peak_photons,
        "image": image,
        "test_set": set.map(|set| &set.quality),
    });
    format!("{numbers:#}\n")
}
