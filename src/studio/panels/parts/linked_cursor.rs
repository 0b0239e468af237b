//! Linked zoom and cursor of object, measurement and reconstruction.

use egui::Ui;
use ndarray::ArrayView2;

use crate::studio::canvas::image_view::Shown;
use crate::studio::canvas::overlays;
use crate::studio::state::request::{Request, Setting};
use crate::studio::state::samples::{CursorPlace, SamplesState, Side, measurement_of, object_of};
use crate::studio::state::view::View;
use crate::studio::widgets::controls::name_widget;

/// Shows the switch.
pub fn switch(ui: &mut Ui, samples: &mut SamplesState, view: &View<'_>, requests: &mut Vec<Request>) {
    let mut linked = view.preferences.link_views;
    let response = ui
        .checkbox(&mut linked, "Link")
        .on_hover_text("Links zoom and cursor of object, measurement and reconstruction");
    name_widget(&response, "Link views");
    if response.clicked() {
        requests.push(Request::Set(Setting::LinkViews(linked)));
        if linked {
            copy_viewport(ui, samples, view, Side::Object);
        }
    }
}

/// Updates the other images after an image was drawn. Returns the values under the pointer.
pub fn update(
    ui: &Ui,
    samples: &mut SamplesState,
    view: &View<'_>,
    side: Side,
    shown: &Shown,
    image: ArrayView2<'_, f32>,
) -> Option<String> {
    let linked = view.preferences.link_views;
    if shown.moved {
        sync_viewports(ui, samples, view, side);
    }
    let pass = ui.ctx().cumulative_pass_nr();
    let pointer = shown.response.hover_pos().filter(|_| shown.response.hovered() || shown.response.dragged());
    let place = pointer.map(|position| shown.placement.to_pixels(position));
    if samples.move_cursor(side, place, pass) && linked {
        // The other images may be drawn already.
        ui.ctx().request_repaint();
    }
    if linked && let Some(cursor) = samples.cursor_of_other(side, pass) {
        draw(ui, samples, view, side, cursor, shown, image.dim());
    }
    let place = place?;
    let value = samples.image(side).describe_pixel(image, place)?;
    let others = side.others().into_iter().filter(|_| linked);
    let values = others.filter_map(|other| value_of_other(samples, view, (side, place), other));
    Some(std::iter::once(value).chain(values).collect::<Vec<_>>().join("   "))
}

/// Copies the viewport to the other images if they are linked.
pub fn sync_viewports(ui: &Ui, samples: &mut SamplesState, view: &View<'_>, side: Side) {
    if view.preferences.link_views {
        copy_viewport(ui, samples, view, side);
    }
}

fn copy_viewport(ui: &Ui, samples: &mut SamplesState, view: &View<'_>, side: Side) {
    for other in side.others() {
        if let Some(offset) = side.offset_to(other, view.live) {
            samples.copy_viewport(side, other, offset);
            ui.ctx().request_repaint();
        }
    }
}

/// The value of another image at the same position as a place (x, y) of an image.
fn value_of_other(
    samples: &SamplesState,
    view: &View<'_>,
    (side, (x, y)): (Side, (f64, f64)),
    other: Side,
) -> Option<String> {
    let by = side.offset_to(other, view.live)?;
    let place = (x + by.0, y + by.1);
    match other {
        Side::Object => {
            let object = object_of(&view.live.scene.as_ref()?.value, samples.shown.index);
            samples.object.describe_pixel(object.view(), place)
        }
        Side::Measurement => {
            let image = measurement_of(&view.live.measurements.as_ref()?.value, samples.shown);
            let value = samples.measurement.describe_pixel(image, place);
            Some(value.unwrap_or_else(|| "outside the field of view".into()))
        }
        Side::Reconstruction => {
            let key = samples.reconstruction_key(view.revision, &view.trainings.networks);
            let shown = view.reconstructions.shown.as_ref().filter(|shown| shown.key == key)?;
            let values = samples.reconstruction.values_of(shown);
            samples.reconstruction.view().describe_pixel(values.view(), place)
        }
    }
}

/// Draws a cross hair at the pointer position of another image.
fn draw(
    ui: &Ui,
    samples: &SamplesState,
    view: &View<'_>,
    side: Side,
    cursor: CursorPlace,
    shown: &Shown,
    (rows, cols): (usize, usize),
) {
    let Some(by) = cursor.side.offset_to(side, view.live) else { return };
    let (x, y) = (cursor.place.0 + by.0, cursor.place.1 + by.1);
    let inside = |value: f64, count: usize| (-0.5..count as f64 - 0.5).contains(&value);
    if !(inside(x, cols) && inside(y, rows)) {
        return;
    }
    overlays::cross_hair(&ui.painter_at(shown.seen), shown.placement, shown.seen, (x, y));
    let name = samples.image(side).name();
    ui.ctx().accesskit_node_builder(shown.response.id, |node| {
        node.set_description(format!("{name}: cursor of the other view at x {x:.1} px, y {y:.1} px"));
    });
}
