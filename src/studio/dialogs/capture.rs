//! The window that reconstructs a capture of a camera: its files, progress, and the image as it comes.

use egui::{ColorImage, ComboBox, ProgressBar, RichText, TextEdit, TextureOptions, Ui, Vec2, vec2};
use ndarray::{Array3, ArrayView3, Axis, s};

use crate::studio::canvas::image_view::{ImageContent, ImageVersion, max_texture_side};
use crate::studio::canvas::overlays::PixelRegion;
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::state::capture::CaptureDialog;
use crate::studio::state::path_dialog::{CaptureFile, PathPurpose};
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{name_widget, toolbar};
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{CaptureReconstruction, CaptureState, SeenRegion, capture_command, colour_levels};

/// Usual size of the window, points.
const SIZE: Vec2 = vec2(660.0, 640.0);
/// Height of the status bar, points.
const STATUS_BAR: f32 = 26.0;
/// Size of the frame with the title, points.
const FRAME: Vec2 = vec2(24.0, 50.0);
/// Least height of the image, points.
const LEAST_IMAGE: f32 = 180.0;
/// Width of the names of the fields, points.
const NAMES: f32 = 76.0;
/// Largest side of squares that are averaged, px.
const LARGEST_BIN: usize = 64;
/// Names of the channels.
const CHANNELS: [&str; 3] = ["Red", "Green", "Blue"];

/// Draws the window if it is open.
pub fn show(ctx: &egui::Context, dialog: &mut CaptureDialog, view: &View<'_>, requests: &mut Vec<Request>) {
    let mut open = dialog.is_open;
    // The status bar stays in sight.
    let place = ctx.content_rect().with_max_y(ctx.content_rect().bottom() - STATUS_BAR);
    let room = (place.size() - FRAME).max(Vec2::splat(80.0));
    let window = egui::Window::new("Capture").open(&mut open).default_size(SIZE.min(room)).max_size(room);
    let window = window.pivot(egui::Align2::CENTER_CENTER).default_pos(place.center()).constrain_to(place);
    window.vscroll(true).show(ctx, |ui| {
        form(ui, dialog, requests);
        let Some(capture) = view.capture else { return };
        ui.separator();
        progress(ui, capture, requests);
        image(ui, dialog, capture, view, requests);
    });
    dialog.is_open = open;
}

/// Files, options and the buttons that start.
fn form(ui: &mut Ui, dialog: &mut CaptureDialog, requests: &mut Vec<Request>) {
    for (text, name, file) in
        [(&mut dialog.measurement, "Capture", CaptureFile::Measurement), (&mut dialog.psf, "PSF", CaptureFile::Psf)]
    {
        ui.horizontal(|ui| {
            field_name(ui, name);
            let width = (ui.available_width() - 84.0).max(80.0);
            let field = ui.add(TextEdit::singleline(text).desired_width(width).hint_text("Path of an image"));
            name_widget(&field, &format!("{name} file"));
            let browse = ui.button("Browse...");
            name_widget(&browse, &format!("Browse for {name}"));
            if browse.clicked() {
                requests.push(Request::AskPath(PathPurpose::ChooseCapture(file)));
            }
        });
    }
    ui.horizontal_wrapped(|ui| {
        field_name(ui, "Dark level");
        let field = TextEdit::singleline(&mut dialog.dark).desired_width(150.0).hint_text("number or file");
        let hint = "Grey value without light in DN, or path of a capture without light; empty: the corners of the PSF";
        let field = ui.add(field).on_hover_text(hint);
        name_widget(&field, "Dark level of the capture");
        ui.label("DN");
        ui.add_space(8.0);
        ui.label("Average squares of");
        let field = NumberField::whole("Capture: bin", 1..=LARGEST_BIN);
        field.edit_whole(ui, &mut dialog.bin).on_hover_text("Side of the squares of pixels that are averaged, px");
        ui.label(format!("x {} px", dialog.bin));
        let response = ComboBox::from_id_salt("capture method")
            .selected_text(dialog.decoder.name())
            .width(118.0)
            .show_ui(ui, |ui| {
                for kind in CaptureDialog::decoders() {
                    ui.selectable_value(&mut dialog.decoder, kind, kind.name());
                }
            })
            .response;
        name_widget(&response, "Method of the capture");
    });
    ui.horizontal(|ui| {
        let order = dialog.order();
        let is_ready = matches!(order, Ok(Some(_)));
        let start = ui.add_enabled(is_ready, egui::Button::new("Reconstruct"));
        let start = start.on_disabled_hover_text("Choose the capture and the PSF first");
        name_widget(&start, "Reconstruct the capture");
        match order {
            Ok(Some(order)) if start.clicked() => requests.push(Request::ReconstructCapture(order)),
            Ok(_) => {}
            Err(sentence) => {
                ui.colored_label(ui.visuals().error_fg_color, sentence);
            }
        }
    });
}

/// Name of a field, of the same width for all.
fn field_name(ui: &mut Ui, name: &str) {
    ui.allocate_ui_with_layout(vec2(NAMES, 18.0), egui::Layout::left_to_right(egui::Align::Center), |ui| {
        ui.set_min_width(NAMES);
        ui.label(name);
    });
}

/// State of the capture, with the buttons that end it or write it.
fn progress(ui: &mut Ui, capture: &CaptureReconstruction, requests: &mut Vec<Request>) {
    toolbar(ui, |ui| {
        match &capture.state {
            CaptureState::Reading => {
                ui.label("Reading the files");
            }
            CaptureState::Reconstructing { channel, channels, done, most } => {
                let share = *done as f32 / (*most).max(1) as f32;
                let of_channels =
                    if *channels > 1 { format!("{}, ", channel_name(*channel - 1)) } else { String::new() };
                let text = format!("{of_channels}iteration {done} of {most}");
                let bar = ProgressBar::new(share).desired_width(220.0).text(RichText::new(&text).size(12.0));
                let bar = ui.add(bar);
                name_widget(&bar, &format!("Progress: {text}"));
            }
            CaptureState::Done { seconds, quality } => {
                let of_most = |(done, most)| format!(", {done} of at most {most} iterations");
                let iterations = quality.iterations.map_or_else(String::new, of_most);
                let residual = format!("residual {:.1} times the noise", quality.residual);
                ui.label(format!("{}{iterations}, {residual}, {seconds:.1} s", capture.order.decoder)).on_hover_text(
                    "Where it is far above 1, the PSF does not fit the capture, or the iterations ended early",
                );
            }
            CaptureState::Stopped => {
                ui.label("Stopped");
            }
            CaptureState::Failed(sentence) => {
                ui.colored_label(ui.visuals().error_fg_color, sentence);
                if capture.earlier.is_none() {
                    return;
                }
            }
        }
        if let Some(earlier) = &capture.earlier {
            let name = earlier.files.measurement.file_name().unwrap_or_default().to_string_lossy();
            ui.weak(format!("Shown: the earlier reconstruction of {name}, by {}", earlier.decoder));
        }
        if capture.state.is_open() {
            let stop = ui.button("Cancel");
            name_widget(&stop, "Cancel the reconstruction");
            if stop.clicked() {
                requests.push(Request::StopCapture);
            }
        }
        let export =
            ui.add_enabled(capture.is_complete(), egui::Button::new("Export...")).on_hover_text("Writes PNG and NPY");
        name_widget(&export, "Export the reconstruction");
        if export.clicked()
            && let (Some(object), Some(measurement)) = (capture.object.clone(), capture.measurement.clone())
        {
            requests.push(Request::AskPath(PathPurpose::ExportCapture { object, measurement }));
        }
        let copy = ui.button("Copy command line");
        name_widget(&copy, "Copy command line of the capture");
        if copy.clicked() {
            let shown = capture.earlier.as_ref().unwrap_or(&capture.order);
            requests.push(Request::CopyCommand(Ok(capture_command(shown))));
        }
    });
    for notice in &capture.notices {
        ui.add(egui::Label::new(RichText::new(notice).size(12.0).weak()).wrap());
    }
}

fn channel_name(index: usize) -> &'static str {
    CHANNELS.get(index).copied().unwrap_or("Channel")
}

/// The reconstruction as far as it is known, or the capture.
fn image(
    ui: &mut Ui,
    dialog: &mut CaptureDialog,
    capture: &CaptureReconstruction,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    let Some(measurement) = &capture.measurement else { return };
    let channels = measurement.len_of(Axis(2));
    let shows_capture = dialog.shows_capture || capture.object.is_none();
    let values: &Array3<f32> = capture.object.as_ref().filter(|_| !shows_capture).unwrap_or(measurement);
    let channel = if channels == 1 { Some(0) } else { dialog.channel.filter(|&channel| channel < channels) };
    toolbar(ui, |ui| {
        for (is_capture, text) in [(false, "Reconstruction"), (true, "Capture")] {
            let response = ui.selectable_label(shows_capture == is_capture, text);
            name_widget(&response, &format!("Show the {} image", text.to_lowercase()));
            if response.clicked() {
                dialog.shows_capture = is_capture;
            }
        }
        if channels > 1 {
            ui.separator();
            for choice in std::iter::once(None).chain((0..channels).map(Some)) {
                let text = choice.map_or("Colour", channel_name);
                let response = ui.selectable_label(channel == choice, text);
                name_widget(&response, &format!("{text} of the capture"));
                if response.clicked() {
                    dialog.channel = choice;
                }
            }
        }
        if channel.is_some() {
            dialog.image.colour_controls(ui, view.palettes);
        }
    });
    let below = ui.clip_rect().bottom() - ui.cursor().top() - 8.0;
    let size = vec2(ui.available_width(), below.max(LEAST_IMAGE));
    let Some(channel) = channel else {
        coloured(ui, dialog, values.view(), (capture.serial, shows_capture), size);
        return;
    };
    let SeenRegion { corner, shape } = capture.seen;
    dialog.image.set_region((!shows_capture).then_some(PixelRegion { corner, shape }));
    ui.allocate_ui(size, |ui| {
        ui.set_min_size(size);
        ui.set_max_size(size);
        let version = ImageVersion { revision: capture.serial, index: 2 * channel + usize::from(shows_capture) };
        let values = values.index_axis(Axis(2), channel);
        let content = ImageContent { values, version, is_stale: false };
        let shown = dialog.image.show(ui, view.palettes, content, PointerMode::View);
        let place = shown.response.hover_pos().map(|position| shown.placement.to_pixels(position));
        let value = place.and_then(|place| dialog.image.describe_pixel(values, place));
        requests.extend(value.map(Request::Describe));
    });
}

/// An image in colour.
fn coloured(ui: &mut Ui, dialog: &mut CaptureDialog, values: ArrayView3<'_, f32>, version: (u64, bool), size: Vec2) {
    if dialog.texture.as_ref().is_none_or(|(known, _)| *known != version) {
        let longest = max_texture_side(ui.ctx()).max(1);
        let step = |count: usize| count.div_ceil(longest).max(1) as isize;
        let (rows, cols, _) = values.dim();
        let levels = colour_levels(values.slice(s![..;step(rows), ..;step(cols), ..]));
        let (rows, cols, _) = levels.dim();
        let bytes: Vec<u8> = levels.iter().copied().collect();
        let pixels = ColorImage::from_rgb([cols, rows], &bytes);
        if let Some((known, texture)) = &mut dialog.texture {
            texture.set(pixels, TextureOptions::NEAREST);
            *known = version;
        } else {
            let texture = ui.ctx().load_texture("capture in colour", pixels, TextureOptions::NEAREST);
            dialog.texture = Some((version, texture));
        }
    }
    if let Some((_, texture)) = &dialog.texture {
        let image = egui::Image::new((texture.id(), texture.size_vec2())).fit_to_exact_size(size);
        ui.add(image.maintain_aspect_ratio(true).alt_text("Capture in colour"));
    }
}
