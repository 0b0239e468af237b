//! One sample: object and measurement.

use egui::Ui;
use ndarray::Axis;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::studio::canvas::image_view::{ImageContent, ImageVersion};
use crate::studio::canvas::overlays::PixelSize;
use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::image_menu::{self, MenuImage};
use crate::studio::panels::parts::{information_overlay, linked_cursor};
use crate::studio::state::request::Request;
use crate::studio::state::samples::{SamplesState, ShownSample, Side, measurement_of, object_of};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};
use crate::workbench::Live;

/// Width of the number of the sample with the buttons for the previous and the next one, points.
const SAMPLE_NUMBER: f32 = 112.0;

/// Shows the object.
pub fn show_object(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    toolbar(ui, |ui| {
        samples.object.colour_controls(ui, view.palettes);
        sample_controls(ui, samples, view.live, "object");
        linked_cursor::switch(ui, samples, view, requests);
    });
    let Some(scene) = &view.live.scene else {
        placeholder(ui, view.live.busy.as_deref().unwrap_or_else(|| waiting(view)));
        return;
    };
    let index = samples.shown.index.min(scene.value.objects.len_of(Axis(0)).saturating_sub(1));
    let object = object_of(&scene.value, index);
    let content = ImageContent {
        values: object.view(),
        version: ImageVersion { revision: scene.revision, index },
        is_stale: !scene.value.serves(view.design),
    };
    let shown = samples.object.show(ui, view.palettes, content, PointerMode::View);
    let value = linked_cursor::update(ui, samples, view, Side::Object, &shown, object.view());
    requests.extend(value.map(Request::Describe));
    let menu = MenuImage { image: object.view(), is_current: view.is_current(scene.revision), shown: &shown };
    if image_menu::show(ui, &mut samples.object, &menu, requests, |_, _, _| {}) {
        linked_cursor::sync_viewports(ui, samples, view, Side::Object);
    }
}

/// Shows the measurement.
pub fn show_measurement(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    toolbar(ui, |ui| {
        samples.measurement.colour_controls(ui, view.palettes);
        sample_controls(ui, samples, view.live, "measurement");
        ui.checkbox(&mut samples.shown.noisy, "Noise").on_hover_text("Off shows the noiseless measurement");
        information_overlay::switch(ui, &mut samples.overlay, view);
    });
    let Some(measurements) = &view.live.measurements else {
        placeholder(ui, waiting(view));
        return;
    };
    let is_current = view.is_current(measurements.revision);
    let ShownSample { index, noisy } = samples.shown;
    let image = measurement_of(&measurements.value, samples.shown);
    let version = ImageVersion { revision: measurements.revision, index: 2 * index + usize::from(noisy) };
    let content = ImageContent { values: image, version, is_stale: !is_current };
    samples.measurement.set_pixel(PixelSize::of_sensor(view.design.pixel_pitch_um));
    let shown = samples.measurement.show(ui, view.palettes, content, PointerMode::View);
    let value = linked_cursor::update(ui, samples, view, Side::Measurement, &shown, image);
    requests.push(Request::Inspect);
    let bits = information_overlay::draw(ui, samples, view, &shown);
    let text = value.map(|value| bits.map_or(value.clone(), |bits| format!("{value}, {bits}")));
    requests.extend(text.map(Request::Describe));
    let menu = MenuImage { image, is_current, shown: &shown };
    if image_menu::show(ui, &mut samples.measurement, &menu, requests, |_, _, _| {}) {
        linked_cursor::sync_viewports(ui, samples, view, Side::Measurement);
    }
}

/// Text in place of a missing image.
fn waiting<'a>(view: &'a View<'_>) -> &'a str {
    view.failure().unwrap_or("Computing")
}

/// Buttons for previous, next and random sample; object and measurement share it.
fn sample_controls(ui: &mut Ui, samples: &mut SamplesState, live: &Live, what: &str) {
    let count = live.scene.as_ref().map_or(1, |scene| scene.value.objects.len_of(Axis(0))).max(1);
    let sample = &mut samples.shown.index;
    *sample = (*sample).min(count - 1);
    // Both buttons stand beside the number.
    if ui.available_size_before_wrap().x < SAMPLE_NUMBER {
        ui.end_row();
    }
    let previous = ui.small_button("<").on_hover_text("Previous sample");
    name_widget(&previous, &format!("Previous {what}"));
    if previous.clicked() {
        *sample = (*sample + count - 1) % count;
    }
    ui.label(format!("{} of {count}", *sample + 1));
    let next = ui.small_button(">").on_hover_text("Next sample");
    name_widget(&next, &format!("Next {what}"));
    if next.clicked() {
        *sample = (*sample + 1) % count;
    }
    let random = ui.add_enabled(count > 1, egui::Button::new("Any").small()).on_hover_text("Show a random sample");
    name_widget(&random, &format!("Random {what}"));
    if random.clicked() {
        let mut random = ChaCha8Rng::seed_from_u64(ui.ctx().cumulative_frame_nr());
        *sample = (*sample + random.random_range(1..count)) % count;
    }
}
