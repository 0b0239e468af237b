//! One of the live objects, and its measurement.

use egui::{Sense, Ui};
use ndarray::{Axis, s};

use super::image_view::{name_widget, placeholder, toolbar};
use super::state::State;

/// Shows the object.
pub fn show_object(ui: &mut Ui, state: &mut State) {
    toolbar(ui, |ui| {
        state.views.object.colormap_menu(ui);
        sample_controls(ui, state, "object");
    });
    let Some(scene) = state.live.scene.clone() else {
        let text = state.live.busy.clone().unwrap_or_else(|| waiting(state));
        placeholder(ui, &text);
        return;
    };
    let stale = !scene.value.serves(state.bench.design());
    let objects = scene.value.objects.view();
    let index = state.sample.min(objects.len_of(Axis(0)).saturating_sub(1));
    // Volumes are shown as the sensor would see them without optics: all planes together.
    let object = objects.index_axis(Axis(0), index).sum_axis(Axis(0));
    let version = (scene.revision, index);
    let (placement, response) =
        state.views.object.show(ui, &state.palettes, object.view(), version, stale, Sense::hover());
    if let Some(position) = response.hover_pos() {
        state.hover = state.views.object.describe_pixel(object.view(), placement.to_pixels(position));
    }
}

/// Shows the measurement.
pub fn show_measurement(ui: &mut Ui, state: &mut State) {
    toolbar(ui, |ui| {
        state.views.measurement.colormap_menu(ui);
        sample_controls(ui, state, "measurement");
        ui.checkbox(&mut state.noisy, "Noise").on_hover_text("Off shows the noiseless encoded image");
    });
    let Some(measurements) = state.live.measurements.clone() else {
        let text = waiting(state);
        placeholder(ui, &text);
        return;
    };
    let stale = !state.is_current(measurements.revision);
    let stack = if state.noisy { &measurements.value.noisy } else { &measurements.value.noiseless };
    let index = state.sample.min(stack.len_of(Axis(0)).saturating_sub(1));
    let image = stack.slice(s![index, .., ..]);
    let version = (measurements.revision, 2 * index + usize::from(state.noisy));
    let (placement, response) =
        state.views.measurement.show(ui, &state.palettes, image, version, stale, Sense::hover());
    if let Some(position) = response.hover_pos() {
        state.hover = state.views.measurement.describe_pixel(image, placement.to_pixels(position));
    }
}

/// Why there is nothing to see yet.
fn waiting(state: &State) -> String {
    match &state.live.failure {
        Some((_, failure)) => failure.clone(),
        None => "Computing".into(),
    }
}

/// Previous, next, random; object and measurement always show the same sample.
fn sample_controls(ui: &mut Ui, state: &mut State, what: &str) {
    let count = state.live.scene.as_ref().map_or(1, |scene| scene.value.objects.len_of(Axis(0))).max(1);
    state.sample = state.sample.min(count - 1);
    let previous = ui.small_button("<").on_hover_text("Previous sample");
    name_widget(&previous, &format!("Previous {what}"));
    if previous.clicked() {
        state.sample = (state.sample + count - 1) % count;
    }
    ui.label(format!("{} of {count}", state.sample + 1));
    let next = ui.small_button(">").on_hover_text("Next sample");
    name_widget(&next, &format!("Next {what}"));
    if next.clicked() {
        state.sample = (state.sample + 1) % count;
    }
}
