//! The first capture of a system, and beside it a simulated measurement of the design.

use egui::{Align, Label, Layout, RichText, Ui, vec2};
use ndarray::ArrayView2;

use crate::studio::canvas::image_view::{ImageContent, ImageVersion, ImageView};
use crate::studio::canvas::overlays::PixelSize;
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::state::camera::CapturesForm;
use crate::studio::state::request::Request;
use crate::studio::state::samples::{ShownSample, measurement_of};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{rest_of_panel, toolbar};
use crate::studio::widgets::format::format_significant;
use crate::workbench::{CapturePreview, range_of};

/// Size of the texts, points.
const TEXT: f32 = 12.5;
/// Least height of an image, points.
const LEAST_IMAGE: f32 = 160.0;
/// Least width of an image with its colour bar, points. In a narrower panel the images stand below each other.
const LEAST_WIDTH: f32 = 190.0;

/// Shows both images.
pub fn show(
    ui: &mut Ui,
    form: &mut CapturesForm,
    preview: &CapturePreview,
    serial: u64,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    toolbar(ui, |ui| {
        form.image.colour_controls(ui, view.palettes);
        form.simulated.colormap = form.image.colormap;
        ui.weak("Each image has a range of its own.");
    });
    let captured = (ImageVersion { revision: serial, index: form.shown }, preview);
    if ui.available_width() < 2.0 * LEAST_WIDTH {
        capture(ui, &mut form.image, captured, Some(LEAST_IMAGE), (view, requests));
        simulated(ui, form, Some(LEAST_IMAGE), view, requests);
    } else {
        ui.columns_const(|[left, right]| {
            capture(left, &mut form.image, captured, None, (view, requests));
            simulated(right, form, None, view, requests);
        });
    }
}

fn capture(
    ui: &mut Ui,
    image: &mut ImageView,
    (version, preview): (ImageVersion, &CapturePreview),
    height: Option<f32>,
    (view, requests): (&View<'_>, &mut Vec<Request>),
) {
    let mean = format!("; mean of all {}", format_significant(preview.mean));
    let values = preview.image.view();
    caption(ui, "First image", values, preview.range, &format!("{}{mean}", preview.unit.name()));
    let content = ImageContent { values, version, is_stale: false };
    draw(ui, image, content, height, (view, requests));
}

/// The noisy measurement of the shown sample, as the worker computes it for each revision of the design.
fn simulated(ui: &mut Ui, form: &mut CapturesForm, height: Option<f32>, view: &View<'_>, requests: &mut Vec<Request>) {
    let Some(measurements) = &view.live.measurements else {
        ui.weak(view.failure().unwrap_or("Computing the simulated measurement"));
        return;
    };
    let index = view.shared.sample.index;
    let values = measurement_of(&measurements.value, ShownSample { index, noisy: true });
    let version = ImageVersion { revision: measurements.revision, index };
    let known = form.simulated_range.filter(|(of, _)| *of == version);
    let (_, range) = *form.simulated_range.insert(known.unwrap_or_else(|| (version, range_of(values))));
    let is_stale = !view.is_current(measurements.revision);
    let what = if is_stale { "Simulated measurement of the earlier design" } else { "Simulated measurement" };
    caption(ui, what, values, range, "photons");
    form.simulated.set_pixel(PixelSize::of_sensor(view.design.pixel_pitch_um));
    draw(ui, &mut form.simulated, ImageContent { values, version, is_stale }, height, (view, requests));
}

/// Name, size and range of an image.
fn caption(ui: &mut Ui, what: &str, values: ArrayView2<'_, f32>, (low, high): (f32, f32), unit: &str) {
    let (rows, cols) = values.dim();
    let [low, high] = [low, high].map(|value| format_significant(f64::from(value)));
    let text = format!("{what}: {rows} x {cols} px, {low} to {high} {unit}");
    // Columns justify their lines; these stay as they are.
    ui.with_layout(Layout::top_down(Align::LEFT), |ui| ui.add(Label::new(RichText::new(text).size(TEXT)).wrap()));
}

/// An image of this height, or down to the end of the panel.
fn draw(
    ui: &mut Ui,
    image: &mut ImageView,
    content: ImageContent<'_>,
    height: Option<f32>,
    (view, requests): (&View<'_>, &mut Vec<Request>),
) {
    let size = vec2(ui.available_width(), height.unwrap_or_else(|| rest_of_panel(ui, LEAST_IMAGE)));
    ui.allocate_ui(size, |ui| {
        ui.set_min_size(size);
        ui.set_max_size(size);
        let shown = image.show(ui, view.palettes, content, PointerMode::View);
        let place = shown.response.hover_pos().map(|position| shown.placement.to_pixels(position));
        let value = place.and_then(|place| image.describe_pixel(content.values, place));
        requests.extend(value.map(Request::Describe));
    });
}
