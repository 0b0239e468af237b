//! One sample: object and measurement.

use egui::Ui;
use ndarray::Axis;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::studio::canvas::pan_zoom::PointerMode;
use crate::studio::panels::parts::image_menu::{self, View};
use crate::studio::panels::parts::{information_overlay, linked_cursor};
use crate::studio::state::app_state::State;
use crate::studio::state::views::Side;
use crate::studio::widgets::controls::{name_widget, placeholder, toolbar};

/// Shows the object.
pub fn show_object(ui: &mut Ui, state: &mut State) {
    toolbar(ui, |ui| {
        state.views.object.colour_controls(ui, &state.palettes);
        sample_controls(ui, state, "object");
        linked_cursor::switch(ui, state);
    });
    let Some(scene) = state.live.scene.clone() else {
        let text = state.live.busy.clone().unwrap_or_else(|| waiting(state));
        placeholder(ui, &text);
        return;
    };
    let stale = !scene.value.serves(state.session.design());
    let index = state.sample.min(scene.value.objects.len_of(Axis(0)).saturating_sub(1));
    let object = linked_cursor::object_of(&scene.value, index);
    let version = (scene.revision, index);
    let shown = state.views.object.show(ui, &state.palettes, object.view(), version, stale, PointerMode::View);
    linked_cursor::update(ui, state, Side::Object, &shown, object.view());
    image_menu::show(ui, state, View::Object, &shown, |_, _, _| {});
}

/// Shows the measurement.
pub fn show_measurement(ui: &mut Ui, state: &mut State) {
    toolbar(ui, |ui| {
        state.views.measurement.colour_controls(ui, &state.palettes);
        sample_controls(ui, state, "measurement");
        ui.checkbox(&mut state.noisy, "Noise").on_hover_text("Off shows the noiseless measurement");
        information_overlay::switch(ui, state);
    });
    let Some(measurements) = state.live.measurements.clone() else {
        let text = waiting(state);
        placeholder(ui, &text);
        return;
    };
    let stale = !state.is_current(measurements.revision);
    let image = linked_cursor::measurement_of(&measurements.value, state.sample, state.noisy);
    let version = (measurements.revision, 2 * state.sample + usize::from(state.noisy));
    let shown = state.views.measurement.show(ui, &state.palettes, image, version, stale, PointerMode::View);
    linked_cursor::update(ui, state, Side::Measurement, &shown, image);
    let closer = state.inspect(&measurements);
    information_overlay::draw(ui, state, &shown, closer.as_deref());
    image_menu::show(ui, state, View::Measurement, &shown, |_, _, _| {});
}

/// Text in place of a missing image.
fn waiting(state: &State) -> String {
    state.failure().unwrap_or("Computing").to_owned()
}

/// Buttons for previous, next and random sample; object and measurement share it.
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
    let random = ui.add_enabled(count > 1, egui::Button::new("Any").small()).on_hover_text("Show a random sample");
    name_widget(&random, &format!("Random {what}"));
    if random.clicked() {
        let mut random = ChaCha8Rng::seed_from_u64(ui.ctx().cumulative_frame_nr());
        state.sample = (state.sample + random.random_range(1..count)) % count;
    }
}
