//! The PSF plane: the PSF image under one handle per lenslet.
//!
//! Click selects, Shift+click toggles, a drag on a handle moves the selection, a drag on the image selects in a box. A
//! double click adds a lenslet, Delete removes the selection, arrow keys nudge it (Shift: tenfold). The wheel over a
//! handle changes its weight, Alt+wheel its width. Ctrl+wheel, a pinch, plus and minus zoom; a middle drag or Space+drag
//! pans.

use std::collections::BTreeSet;

use egui::{Color32, Key, PointerButton, Pos2, Rect, Sense, Stroke, Ui, Vec2, vec2};

use crate::optics::{Encoder, Lenslet, LensletArray};
use crate::studio::canvas::image_view::{ImageContent, ImageVersion, Shown};
use crate::studio::canvas::overlays::PixelSize;
use crate::studio::canvas::pan_zoom::{CLICK_REACH, PointerMode, is_panning, zoomed_by_keys};
use crate::studio::panels::parts::action_entry;
use crate::studio::panels::parts::image_menu::{self, MenuImage};
use crate::studio::panels::parts::lenslet_menu::{self, inside};
use crate::studio::panels::parts::mask_drawing::{
    Canvas, draw_arrows, draw_handle, draw_limits, frame_of, position_gradients,
};
use crate::studio::panels::parts::trajectories;
use crate::studio::state::action::Action;
use crate::studio::state::mask::{MaskDrag, MaskState};
use crate::studio::state::request::Request;
use crate::studio::state::selection::Selection;
use crate::studio::state::view::View;
use crate::studio::widgets::controls::{placeholder, toolbar};
use crate::studio::widgets::number_field::NumberField;
use crate::workbench::{Command, LensletChange};

/// Step of an arrow key, PSF px.
const NUDGE_PX: f64 = 0.1;
/// Factor of weight or width per notch of the wheel.
const WHEEL_FACTOR: f64 = 1.08;
/// Points of a touch pad that equal one notch of a wheel.
const POINTS_PER_NOTCH: f32 = 40.0;

/// What gestures change.
struct Edited<'a> {
    panel: &'a mut MaskState,
    selection: &'a mut Selection,
    requests: &'a mut Vec<Request>,
}

impl Edited<'_> {
    fn change(&mut self, what: LensletChange, lenslets: Vec<(usize, Lenslet)>) {
        self.requests.push(Request::Change(Command::ChangeLenslets { what, lenslets }));
    }
}

/// Shows the panel.
pub fn show(
    ui: &mut Ui,
    panel: &mut MaskState,
    selection: &mut Selection,
    view: &View<'_>,
    requests: &mut Vec<Request>,
) {
    toolbar(ui, |ui| {
        panel.psf.colour_controls(ui, view.palettes);
        let arrows = ui.checkbox(&mut panel.arrows, "Arrows");
        arrows.on_hover_ui(|ui| {
            ui.label(
                "Gradient of the information by the position of each lenslet, where it is statistically significant; the longest arrow is 3 px.",
            );
            if let Some(gradients) = position_gradients(view) {
                let significant = gradients.iter().filter(|gradient| gradient.is_significant).count();
                ui.label(format!("Significant: {significant} of {}", gradients.len()));
            }
        });
        throughput(ui, &view.design.encoder, requests);
        let text = match (view.lenslet_count(), selection.indices().len()) {
            (0, _) => view.design.encoder.describe(),
            (_, 0) => "Double-click adds a lenslet, drag moves it, wheel changes its weight".into(),
            (_, 1) => "1 selected".into(),
            (_, more) => format!("{more} selected"),
        };
        // The rest of the row. The text does not change the size of the image.
        let room = vec2(ui.available_size_before_wrap().x, ui.spacing().interact_size.y);
        if room.x > 60.0 {
            ui.allocate_ui(room, |ui| ui.add(egui::Label::new(egui::RichText::new(text).weak()).truncate()));
        }
    });
    let Some(optics) = &view.live.optics else {
        placeholder(ui, "Rendering the PSF");
        return;
    };
    let is_current = view.is_current(optics.revision);
    let image = optics.value.image.view();
    let version = ImageVersion { revision: optics.revision, index: 0 };
    let content = ImageContent { values: image, version, is_stale: !is_current };
    panel.psf.set_pixel(PixelSize::of_sensor(view.design.pixel_pitch_um));
    let shown = panel.psf.show(ui, view.palettes, content, PointerMode::Edit);
    let placement = shown.placement;
    if !panel.psf.viewport.is_fitted() {
        // Hidden lenslets do not cover other controls.
        ui.set_clip_rect(shown.seen);
    }
    if let Some(position) = shown.response.hover_pos() {
        let value = panel.psf.describe_pixel(image, placement.to_pixels(position));
        requests.extend(value.map(Request::Describe));
    }
    let array = view.design.encoder.lenslets();
    let add_here = |ui: &mut Ui, requests: &mut Vec<Request>, (x, y): (f64, f64)| {
        let Some(array) = array else { return };
        if ui.button("Add a lenslet here").clicked() {
            let (x, y) = inside((x, y), array);
            requests.push(Request::Change(Command::AddLenslet(new_lenslet(array, x, y))));
            ui.close();
        }
        action_entry::entry(ui, view, requests, Action::SelectAll);
        ui.separator();
    };
    let menu = MenuImage { image, is_current, shown: &shown };
    image_menu::show(ui, &mut panel.psf, &menu, requests, add_here);
    // A stale image may have another shape than the array.
    let Some(array) = array.filter(|array| (array.rows, array.cols) == image.dim()) else { return };
    let canvas = Canvas { view, array, placement };
    draw_limits(ui, canvas, selection);
    trajectories::draw(ui, view, placement, array);
    let mut edited = Edited { panel, selection, requests };
    canvas_gestures(ui, canvas, &mut edited, &shown.response);
    for index in 0..array.lenslets.len() {
        handle(ui, canvas, &mut edited, index);
    }
    if edited.panel.arrows {
        draw_arrows(ui, canvas);
    }
    keyboard(ui, canvas, &mut edited, &shown);
}

/// Shows the throughput of the mask.
fn throughput(ui: &mut Ui, encoder: &Encoder, requests: &mut Vec<Request>) {
    let field = NumberField::new("Throughput", encoder.throughputs()).prefix("Throughput ").speed(0.002);
    let (response, edit) = field.show(ui, encoder.throughput());
    response.on_hover_text("Sum of the PSF: the share of the light that reaches the sensor");
    if let Some(edit) = edit {
        requests.push(Request::ChangeBy(edit, Command::SetThroughput(edit.value)));
    }
}

/// Gestures on the image: box selection, deselection, adding.
fn canvas_gestures(ui: &Ui, canvas: Canvas<'_>, edited: &mut Edited<'_>, response: &egui::Response) {
    let Canvas { array, placement, .. } = canvas;
    let shift = ui.input(|input| input.modifiers.shift);
    if response.double_clicked()
        && let Some(position) = response.interact_pointer_pos()
    {
        let (x, y) = inside(placement.to_pixels(position), array);
        edited.requests.push(Request::Change(Command::AddLenslet(new_lenslet(array, x, y))));
        return;
    }
    if response.clicked() && !shift {
        edited.selection.clear();
    }
    if response.drag_started_by(PointerButton::Primary)
        && !is_panning(ui)
        && let Some(position) = ui.input(|input| input.pointer.press_origin())
    {
        // In a slow frame the pointer may already have left the lenslet that it pressed.
        if let Some(pressed) =
            array.lenslets.iter().rposition(|lenslet| frame_of(placement, lenslet).contains(position))
        {
            take_hold(ui, canvas, edited, pressed, position);
        } else {
            let before = if shift { edited.selection.indices().clone() } else { BTreeSet::new() };
            edited.panel.drag = Some(MaskDrag::Select { start: placement.to_pixels(position), before });
        }
    }
    drag_lenslets(canvas, edited, response);
    if let Some(MaskDrag::Select { start, before }) = &edited.panel.drag {
        let held = response.dragged_by(PointerButton::Primary);
        if let (true, Some(position)) = (held, ui.input(|input| input.pointer.latest_pos())) {
            let end = placement.to_pixels(position);
            let between = |a: f64, b: f64, value: f64| (a.min(b)..=a.max(b)).contains(&value);
            let boxed = array.lenslets.iter().enumerate().filter_map(|(index, lenslet)| {
                (between(start.0, end.0, lenslet.x) && between(start.1, end.1, lenslet.y)).then_some(index)
            });
            edited.selection.set(before.iter().copied().chain(boxed));
            let frame = Rect::from_two_pos(placement.to_screen(start.0, start.1), position);
            let visuals = &ui.visuals().selection;
            ui.painter().rect(
                frame,
                0.0,
                visuals.bg_fill.gamma_multiply(0.2),
                visuals.stroke,
                egui::StrokeKind::Inside,
            );
        } else {
            edited.panel.drag = None;
        }
    }
}

/// Starts a drag of a lenslet and its selection.
fn take_hold(ui: &Ui, canvas: Canvas<'_>, edited: &mut Edited<'_>, index: usize, pointer: Pos2) {
    if !edited.selection.contains(index) {
        edited.selection.select(index, ui.input(|input| input.modifiers.shift));
    }
    let (from, start) = (edited.selection.of(canvas.array), canvas.placement.to_pixels(pointer));
    edited.panel.drag = Some(MaskDrag::Move { from, start, begun: false });
}

/// Moves dragged lenslets with the pointer.
fn drag_lenslets(canvas: Canvas<'_>, edited: &mut Edited<'_>, response: &egui::Response) {
    let placement = canvas.placement;
    if response.dragged_by(PointerButton::Primary)
        && let Some(MaskDrag::Move { from, start, begun }) = &mut edited.panel.drag
        && let Some(position) = response.interact_pointer_pos()
    {
        let (x, y) = placement.to_pixels(position);
        *begun |= position.distance(placement.to_screen(start.0, start.1)) > CLICK_REACH;
        if *begun {
            let moved = moved_by(from, x - start.0, y - start.1, canvas.array);
            edited.change(LensletChange::Position, moved);
        }
    }
    if response.drag_stopped() {
        edited.panel.drag = None;
    }
}

/// A new lenslet with the width of the last one and the mean weight.
fn new_lenslet(array: &LensletArray, x: f64, y: f64) -> Lenslet {
    let count = array.lenslets.len().max(1) as f64;
    let weight = array.lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>() / count;
    let sigma = array.lenslets.last().map_or(crate::optics::HEURISTIC_SIGMA, |lenslet| lenslet.spot.mean_sigma());
    Lenslet::round(x, y, sigma, if weight > 0.0 { weight } else { 1.0 })
}

/// Shows one handle and handles its gestures.
fn handle(ui: &Ui, canvas: Canvas<'_>, edited: &mut Edited<'_>, index: usize) {
    let Canvas { view, array, placement } = canvas;
    let lenslet = &array.lenslets[index];
    let rect = frame_of(placement, lenslet);
    let id = ui.scope_id().with(("lenslet", index));
    let response = ui.interact(rect, id, Sense::click_and_drag());
    let name = format!("Lenslet {}", index + 1);
    let selected = edited.selection.contains(index);
    response.widget_info(|| egui::WidgetInfo::selected(egui::Role::Button, true, selected, &name));
    let shift = ui.input(|input| input.modifiers.shift);

    if response.clicked() {
        // Space counts as a click and is held for panning: it keeps the selection.
        if response.clicked_by(PointerButton::Primary) || shift || !selected {
            edited.selection.select(index, shift);
        }
        response.request_focus();
    }
    if response.drag_started_by(PointerButton::Primary) && !is_panning(ui) {
        response.request_focus();
        if let Some(origin) = ui.input(|input| input.pointer.press_origin()) {
            take_hold(ui, canvas, edited, index, origin);
        }
    }
    drag_lenslets(canvas, edited, &response);
    if response.has_focus() {
        // Arrow keys nudge lenslets instead of moving the focus.
        let filter = egui::EventFilter { horizontal_arrows: true, vertical_arrows: true, ..Default::default() };
        ui.memory_mut(|memory| memory.set_focus_lock_filter(id, filter));
        // Focus by Tab; a click has changed the selection already.
        if response.gained_focus() && !response.clicked() && !edited.selection.contains(index) {
            edited.selection.select(index, false);
        }
    }
    if response.hovered() {
        wheel(ui, canvas, edited, index);
    }
    draw_handle(ui, canvas, &response, lenslet, selected);
    if view.is_locked(index) {
        let centre = placement.to_screen(lenslet.x, lenslet.y);
        let mark = Rect::from_center_size(centre, Vec2::splat(5.0));
        ui.painter().rect_filled(mark, 0.0, Color32::WHITE);
        ui.painter().rect_stroke(mark, 0.0, Stroke::new(1.0, Color32::BLACK), egui::StrokeKind::Outside);
    }
    if response.hovered() {
        let (minor, major) = lenslet.spot.principal_sigmas();
        let width =
            if (major - minor) < 1e-9 { format!("{minor:.3} px") } else { format!("{minor:.3} to {major:.3} px") };
        let Lenslet { x, y, weight, .. } = lenslet;
        let tip = format!("{name}: x {x:.2} px, y {y:.2} px, width {width}, weight {weight:.4}");
        edited.requests.push(Request::Describe(tip));
    }
    response.context_menu(|ui| lenslet_menu::show(ui, edited.selection, view, index, edited.requests));
}

/// Lenslets moved together, as far as all of them stay inside the grid.
fn moved_by(from: &[(usize, Lenslet)], dx: f64, dy: f64, array: &LensletArray) -> Vec<(usize, Lenslet)> {
    let limit = |change: f64, last: f64, of: &dyn Fn(&Lenslet) -> f64| {
        let smallest = from.iter().map(|(_, lenslet)| of(lenslet)).fold(f64::INFINITY, f64::min);
        let largest = from.iter().map(|(_, lenslet)| of(lenslet)).fold(f64::NEG_INFINITY, f64::max);
        change.min((last - largest).max(0.0)).max((-smallest).min(0.0))
    };
    let dx = limit(dx, array.cols as f64 - 1.0, &|lenslet| lenslet.x);
    let dy = limit(dy, array.rows as f64 - 1.0, &|lenslet| lenslet.y);
    from.iter().map(|&(index, lenslet)| (index, Lenslet { x: lenslet.x + dx, y: lenslet.y + dy, ..lenslet })).collect()
}

/// The wheel over a handle changes the weight of the selection, with Alt the width.
///
/// Raw wheel events carry their own modifiers; egui's smoothed scrolling would continue after Alt is released.
fn wheel(ui: &Ui, canvas: Canvas<'_>, edited: &mut Edited<'_>, index: usize) {
    let turns: Vec<(f64, bool)> = ui.input(|input| {
        let turn = |event: &egui::Event| match event {
            // Ctrl+wheel zooms.
            egui::Event::MouseWheel { unit, delta, modifiers, .. } if !modifiers.command => {
                // Some systems report a horizontal wheel while Alt or Shift is held.
                let notches = match unit {
                    egui::MouseWheelUnit::Point => (delta.x + delta.y) / POINTS_PER_NOTCH,
                    egui::MouseWheelUnit::Line | egui::MouseWheelUnit::Page => delta.x + delta.y,
                };
                Some((f64::from(notches), modifiers.alt))
            }
            _ => None,
        };
        input.events.iter().filter_map(turn).collect()
    });
    if turns.is_empty() {
        return;
    }
    if !edited.selection.contains(index) {
        edited.selection.select(index, false);
    }
    let mut lenslets = edited.selection.of(canvas.array);
    for (notches, alt) in turns {
        let factor = WHEEL_FACTOR.powf(notches);
        let change = |lenslet: Lenslet| {
            if alt {
                let sigma = (lenslet.spot.mean_sigma() * factor).clamp(0.2, 100.0);
                Lenslet { spot: lenslet.spot.with_mean_sigma(sigma), ..lenslet }
            } else {
                Lenslet { weight: (lenslet.weight * factor).clamp(0.0, 1e6), ..lenslet }
            }
        };
        for (_, lenslet) in &mut lenslets {
            *lenslet = change(*lenslet);
        }
        edited.change(if alt { LensletChange::Width } else { LensletChange::Weight }, lenslets.clone());
    }
}

/// Keys that nudge the selection or zoom around it, unless another control has the keyboard.
fn keyboard(ui: &Ui, canvas: Canvas<'_>, edited: &mut Edited<'_>, shown: &Shown) {
    let array = canvas.array;
    let is_behind_a_question = !ui.memory(|memory| memory.allows_interaction(ui.layer_id()));
    if ui.ctx().text_edit_focused() || is_behind_a_question {
        return;
    }
    if !a_handle_or_nothing_has_focus(ui, array) {
        return;
    }
    let nudge = ui.input(|input| {
        let axis =
            |plus, minus| f64::from(u8::from(input.key_pressed(plus))) - f64::from(u8::from(input.key_pressed(minus)));
        let step = if input.modifiers.shift { 10.0 * NUDGE_PX } else { NUDGE_PX };
        (axis(Key::ArrowRight, Key::ArrowLeft) * step, axis(Key::ArrowDown, Key::ArrowUp) * step)
    });
    let selected = edited.selection.of(array);
    let around =
        selected.first().map_or(shown.fit.center(), |(_, lenslet)| shown.placement.to_screen(lenslet.x, lenslet.y));
    let viewport = &mut edited.panel.psf.viewport;
    *viewport = zoomed_by_keys(*viewport, ui, around, shown.fit, (array.rows, array.cols));
    if nudge != (0.0, 0.0) && !selected.is_empty() {
        edited.change(LensletChange::Position, moved_by(&selected, nudge.0, nudge.1, array));
    }
}

/// Whether a handle or no control has the keyboard.
fn a_handle_or_nothing_has_focus(ui: &Ui, array: &LensletArray) -> bool {
    match ui.memory(egui::Memory::focused) {
        None => true,
        Some(id) => (0..array.lenslets.len()).any(|index| ui.scope_id().with(("lenslet", index)) == id),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::heuristic_layout;

    #[test]
    fn group_stops_at_border_and_keeps_its_shape() {
        let array = heuristic_layout(3);
        let from: Vec<_> = array.lenslets.iter().copied().enumerate().collect();
        let moved = moved_by(&from, 100.0, -100.0, &array);
        let rightmost = moved.iter().map(|(_, lenslet)| lenslet.x).fold(0.0, f64::max);
        let topmost = moved.iter().map(|(_, lenslet)| lenslet.y).fold(f64::INFINITY, f64::min);
        assert!((rightmost - 31.0).abs() < 1e-9 && topmost.abs() < 1e-9);
        let gap = |lenslets: &[(usize, Lenslet)]| lenslets[1].1.x - lenslets[0].1.x;
        assert!((gap(&moved) - gap(&from)).abs() < 1e-9);
    }
}
