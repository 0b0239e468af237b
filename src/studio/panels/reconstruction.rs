//! What a decoder makes of the shown measurement, its error and its uncertainty, and how good it is.

use std::sync::Arc;

use egui::{Align, Label, Layout, RichText, ScrollArea, Ui, vec2};
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
const NUMBERS: f32 = 12.0;
/// Least height of the image, points. Below it the panel scrolls.
const LEAST_IMAGE: f32 = 120.0;
/// Width of the drop-down of the decoders, points: that of the longest name.
const METHOD: f32 = 130.0;
/// Width of the menu beside it, points.
const MORE: f32 = 36.0;

/// Message where a network is in no file.
const NO_FILE: &str = "the weights of this network are in no file; save the design or export the weights first";

/// Shows the panel: controls, the image, and below it its numbers and the trained network. A low panel scrolls.
pub fn show(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    requests.push(Request::Reconstruct);
    let bottom = ui.available_height();
    ScrollArea::vertical().auto_shrink(false).min_scrolled_height(0.0).show(ui, |ui| {
        let top = ui.cursor().top();
        controls(ui, samples, view, requests);
        let above = ui.cursor().top() - top;
        let below = samples.reconstruction.below;
        let room = vec2(ui.available_width(), (bottom - above - below).max(LEAST_IMAGE));
        ui.allocate_ui_with_layout(room, Layout::top_down(Align::Min), |ui| {
            ui.set_min_size(room);
            ui.set_max_size(room);
            content(ui, samples, view, requests);
        });
        let top = ui.cursor().top();
        captions(ui, samples, view, requests);
        let below = ui.cursor().top() - top;
        if (samples.reconstruction.below - below).abs() > 0.5 {
            samples.reconstruction.below = below;
            ui.ctx().request_repaint();
        }
    });
}

/// Key of what is to be shown.
fn key_of(samples: &SamplesState, view: &View<'_>) -> ReconstructionKey {
    samples.reconstruction_key(view.revision, &view.trainings.networks)
}

/// Method, colours and switches.
fn controls(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let key = key_of(samples, view);
    let shown = view.reconstructions.shown.as_deref();
    let state = &mut samples.reconstruction;
    state.set_uncertainty_of(shown.and_then(Reconstruction::deviation_of));
    toolbar(ui, |ui| {
        method(ui, &mut state.decoder);
        more(ui, key, view, requests);
        state.view_mut().colour_controls(ui, view.palettes);
        switches(ui, state, shown);
        if state.decoder == DecoderKind::Network {
            training::switch(ui, &mut state.training, shown, view);
        }
    });
}

/// The image, or what stands in its place.
fn content(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let key = key_of(samples, view);
    let shown = view.reconstructions.shown.as_deref();
    if let Some(failure) = failure_of(key, view) {
        ui.colored_label(ui.visuals().error_fg_color, failure);
        return;
    }
    if key.decoder == DecoderKind::Network && samples.reconstruction.training.curves {
        Curves::of(shown, view).show(ui, &mut samples.reconstruction.training);
        return;
    }
    let Some(reconstruction) = shown else {
        placeholder(ui, view.failure().unwrap_or("Computing"));
        return;
    };
    let is_current = is_current(reconstruction, key, view);
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

/// Why what is to be shown has no reconstruction.
fn failure_of<'a>(key: ReconstructionKey, view: &'a View<'_>) -> Option<&'a str> {
    let (failed, failure) = view.reconstructions.failure.as_ref()?;
    (*failed == key).then_some(failure.as_str())
}

/// Whether the image belongs to what is to be shown. While masks of a run are shown as they come, it lags behind.
fn is_current(reconstruction: &Reconstruction, key: ReconstructionKey, view: &View<'_>) -> bool {
    reconstruction.key == key || view.preview.is_following && reconstruction.key.decoder == key.decoder
}

/// What the image is of, its numbers, and the trained network.
fn captions(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let key = key_of(samples, view);
    let shown = view.reconstructions.shown.as_deref();
    let is_network = key.decoder == DecoderKind::Network;
    let state = &mut samples.reconstruction;
    let has_image = failure_of(key, view).is_none() && !(is_network && state.training.curves);
    if let Some(reconstruction) = shown.filter(|_| has_image) {
        let of = reconstruction.deviation_of().filter(|_| state.shown() == ShownQuantity::Uncertainty);
        if let Some(of) = of {
            let label = Label::new(RichText::new(format!("Uncertainty {of}")).size(NUMBERS)).truncate();
            ui.add(label).on_hover_text(uncertainty_hint(reconstruction.decoder()));
        }
        numbers(ui, reconstruction, is_current(reconstruction, key, view), key, view);
    }
    if is_network {
        let is_current = shown.is_some_and(|shown| shown.key.has_decoder_of(&key));
        training::show(ui, &mut state.training, shown, is_current, view, requests);
    }
}

/// What the standard deviation of a method says.
fn uncertainty_hint(decoder: DecoderKind) -> &'static str {
    match decoder {
        DecoderKind::Network => {
            "Posterior standard deviation of every pixel by the linear estimate: a network has none of its own"
        }
        DecoderKind::Posterior => {
            "Spread of every pixel over short Markov chains, about the image shown, which is the mean by the decoder"
        }
        _ => "Posterior standard deviation of every pixel",
    }
}

/// Drop-down of the decoders. The menu beside it has room in the same row.
fn method(ui: &mut Ui, decoder: &mut DecoderKind) {
    let width = METHOD.min((ui.max_rect().width() - MORE).max(40.0));
    ui.allocate_ui_with_layout(vec2(width, 22.0), Layout::left_to_right(Align::Center), |ui| {
        let response = egui::ComboBox::from_id_salt("reconstruction method")
            .selected_text(decoder.name())
            .width(width)
            .truncate()
            .show_ui(ui, |ui| {
                // The published U-net is trained by the command line.
                for kind in DecoderKind::ALL.into_iter().filter(|kind| *kind != DecoderKind::Unet) {
                    ui.selectable_value(decoder, kind, kind.name());
                }
            })
            .response;
        name_widget(&response, "Reconstruction method");
    });
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
            uncertainty_hint(state.decoder),
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

/// Quality of the shown image, and of the test set, a line each.
fn numbers(ui: &mut Ui, reconstruction: &Reconstruction, is_current: bool, key: ReconstructionKey, view: &View<'_>) {
    let age = if is_current { "" } else { ", of an earlier edit" };
    let line = match (&reconstruction.quality, reconstruction.iterations) {
        (_, Some((done, most))) => format!("Iteration {done} of at most {most}{age}"),
        (Some(quality), None) => format!("This image{age}: {}", image_line(quality)),
        (None, None) => format!("Images below 11 px a side have no numbers{age}"),
    };
    let text = RichText::new(line).size(NUMBERS);
    let text = if is_current { text } else { text.weak() };
    let text = if reconstruction.iterations.is_some() { text.italics() } else { text };
    // Of one line, so that the image stands still. A cut line is whole under the pointer.
    ui.add(Label::new(text).truncate());
    let Some(set) = view.reconstructions.set.as_deref() else { return };
    let is_current = set.key.has_decoder_of(&key);
    let text = RichText::new(set_line(set, is_current)).size(NUMBERS);
    let text = if is_current { text } else { text.weak() };
    let is_growing = is_current && set.quality.test_objects < set.planned;
    let label = Label::new(if is_growing { text.italics() } else { text }).truncate().show_tooltip_when_elided(false);
    ui.add(label).on_hover_text(details(&set.quality));
}

fn image_line(quality: &ImageQuality) -> String {
    let r2 = quality.r2.map_or_else(String::new, |r2| format!(", R\u{b2} {r2:.3}"));
    format!("PSNR {:.2} dB, SSIM {:.3}{r2}", quality.psnr_db(), quality.ssim)
}

fn set_line(set: &SetQuality, is_current: bool) -> String {
    let quality = &set.quality;
    let [low, high] = quality.psnr_db_interval_95;
    let r2 = quality.r2.map_or_else(String::new, |r2| format!(", R\u{b2} {r2:.3}"));
    let age = if is_current { "" } else { ", of an earlier edit" };
    let (objects, psnr_db, half) = (quality.test_objects, quality.psnr_db, 0.5 * (high - low));
    format!("{objects} objects{age}: {psnr_db:.2} \u{b1} {half:.2} dB, SSIM {:.3}{r2}", quality.ssim)
}

/// All numbers of a test set with their intervals.
fn details(quality: &DecoderQuality) -> String {
    let psnr = with_decimals(quality.psnr_db, quality.psnr_db_interval_95, 2);
    let constant = with_decimals(quality.psnr_constant_db, quality.psnr_constant_db_interval_95, 2);
    let ssim = with_decimals(quality.ssim, quality.ssim_interval_95, 3);
    let r2 = quality.r2.zip(quality.r2_interval_95);
    let r2 = r2.map_or_else(String::new, |(r2, interval)| format!("\nR\u{b2} {}", with_decimals(r2, interval, 3)));
    let peak = format_significant(quality.peak_photons);
    format!(
        "{}, {} test objects\nPSNR {psnr} dB, peak {peak} photons\nSSIM {ssim}{r2}\n{constant} dB for the mean object\nIntervals of 95 %",
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
