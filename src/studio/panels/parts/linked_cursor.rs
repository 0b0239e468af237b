//! Linked zoom and cursor of object and measurement.

use egui::Ui;
use ndarray::{ArrayView2, Axis, CowArray, Ix2};

use crate::evaluation::{Measurements, Scene};
use crate::sensor::field_offset;
use crate::studio::canvas::image_view::Shown;
use crate::studio::canvas::overlays;
use crate::studio::state::app_state::State;
use crate::studio::state::views::{CursorPlace, Side};
use crate::studio::widgets::controls::name_widget;

/// An object summed over its planes, shape (rows, cols).
pub fn object_of(scene: &Scene, sample: usize) -> CowArray<'_, f32, Ix2> {
    let last = scene.objects.len_of(Axis(0)).saturating_sub(1);
    let object = scene.objects.index_axis(Axis(0), sample.min(last));
    if object.len_of(Axis(0)) == 1 {
        object.index_axis_move(Axis(0), 0).into()
    } else {
        object.sum_axis(Axis(0)).into()
    }
}

/// Measurement of a sample, shape (rows, cols).
pub fn measurement_of(measurements: &Measurements, sample: usize, noisy: bool) -> ArrayView2<'_, f32> {
    let stack = if noisy { &measurements.noisy } else { &measurements.noiseless };
    let last = stack.len_of(Axis(0)).saturating_sub(1);
    stack.index_axis(Axis(0), sample.min(last))
}

/// Shows the switch.
pub fn switch(ui: &mut Ui, state: &mut State) {
    let response = ui
        .checkbox(&mut state.preferences.link_views, "Link")
        .on_hover_text("Links zoom and cursor of object and measurement");
    name_widget(&response, "Link views");
    if response.clicked() {
        sync_viewports(ui, state, Side::Object);
    }
}

/// Updates the other image and the status bar after an image was drawn.
pub fn update(ui: &Ui, state: &mut State, side: Side, shown: &Shown, image: ArrayView2<'_, f32>) {
    let linked = state.preferences.link_views;
    if shown.moved {
        sync_viewports(ui, state, side);
    }
    let pass = ui.ctx().cumulative_pass_nr();
    let pointer = shown.response.hover_pos().filter(|_| shown.response.hovered() || shown.response.dragged());
    let place = pointer.map(|position| shown.placement.to_pixels(position));
    let before = state.cursor.0;
    if let Some(place) = place {
        state.cursor.0 = Some(CursorPlace { side, place, pass });
        state.hover = side.view(&mut state.views).describe_pixel(image, place);
        if linked {
            describe_other(state, side, place);
        }
    } else if before.is_some_and(|cursor| cursor.side == side) {
        state.cursor.0 = None;
    }
    let moved = |cursor: Option<CursorPlace>| cursor.map(|cursor| (cursor.side, cursor.place));
    if linked && moved(before) != moved(state.cursor.0) {
        // The other image may be drawn already.
        ui.ctx().request_repaint();
    }
    if linked && let Some(cursor) = state.cursor.0.filter(|cursor| cursor.side != side && cursor.pass + 1 >= pass) {
        draw(ui, state, side, cursor, shown, image.dim());
    }
}

/// Copies the viewport to the other image if both are linked.
pub fn sync_viewports(ui: &Ui, state: &mut State, side: Side) {
    let Some(by) = offset_to_other(state, side).filter(|_| state.preferences.link_views) else { return };
    let viewport = side.view(&mut state.views).viewport.shifted(by);
    side.other().view(&mut state.views).viewport = viewport;
    ui.ctx().request_repaint();
}

/// Offset (x, y) from pixel coordinates of this image to those of the other.
fn offset_to_other(state: &State, from: Side) -> Option<(f64, f64)> {
    let (_, _, rows, cols) = state.live.scene.as_ref()?.value.objects.dim();
    let (_, measured_rows, measured_cols) = state.live.measurements.as_ref()?.value.noisy.dim();
    // A stale measurement may have another shape.
    let psf = ((rows + 1).checked_sub(measured_rows)?, (cols + 1).checked_sub(measured_cols)?);
    let (by_row, by_col) = field_offset(psf);
    let sign = if from == Side::Object { -1.0 } else { 1.0 };
    Some((sign * by_col as f64, sign * by_row as f64))
}

/// Adds the value at the same position of the other image to the status bar.
fn describe_other(state: &mut State, side: Side, (x, y): (f64, f64)) {
    let Some(by) = offset_to_other(state, side) else { return };
    let place = (x + by.0, y + by.1);
    let (scene, measurements) = (state.live.scene.clone(), state.live.measurements.clone());
    let text = match side.other() {
        Side::Object => scene
            .and_then(|scene| state.views.object.describe_pixel(object_of(&scene.value, state.sample).view(), place)),
        Side::Measurement => measurements.map(|measured| {
            let image = measurement_of(&measured.value, state.sample, state.noisy);
            let inside = state.views.measurement.describe_pixel(image, place);
            inside.unwrap_or_else(|| "outside the field of view".into())
        }),
    };
    if let (Some(hover), Some(text)) = (&mut state.hover, text) {
        *hover = format!("{hover}   {text}");
    }
}

/// Draws a cross hair at the pointer position of the other image.
fn draw(ui: &Ui, state: &mut State, side: Side, cursor: CursorPlace, shown: &Shown, (rows, cols): (usize, usize)) {
    let Some(by) = offset_to_other(state, cursor.side) else { return };
    let (x, y) = (cursor.place.0 + by.0, cursor.place.1 + by.1);
    let inside = |value: f64, count: usize| (-0.5..count as f64 - 0.5).contains(&value);
    if !(inside(x, cols) && inside(y, rows)) {
        return;
    }
    overlays::cross_hair(&ui.painter_at(shown.seen), shown.placement, shown.seen, (x, y));
    let name = side.view(&mut state.views).name();
    ui.ctx().accesskit_node_builder(shown.response.id, |node| {
        node.set_description(format!("{name}: cursor of the other view at x {x:.1} px, y {y:.1} px"));
    });
}
