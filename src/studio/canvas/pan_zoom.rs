//! Zoom and pan by pointer and keys.

use egui::{
    CursorIcon, EventFilter, InputState, Key, PointerButton, Pos2, Rect, Response, Stroke, StrokeKind, Ui, Vec2, vec2,
};

use crate::studio::canvas::viewport::Viewport;

/// Zoom per point of the wheel: a notch of 40 points is a factor of 1.22, as in egui.
const WHEEL_SPEED: f64 = 1.0 / 200.0;
/// Points of the wheel that one key press equals.
const KEY_NOTCH: f64 = 40.0;
/// Share of the image width by which an arrow key pans.
const KEY_PAN: f32 = 0.1;

/// Maximal pointer movement of a click, points.
pub const CLICK_REACH: f32 = 3.0;

/// Meaning of pointer gestures on an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointerMode {
    /// Wheel zooms, drag pans, double click resets.
    View,
    /// Wheel, drag and double click edit; Ctrl+wheel zooms, a middle drag or Space+drag pans.
    Edit,
}

impl PointerMode {
    /// Viewport after the gestures of this frame on an image of shape (rows, cols). `fit` is its rectangle without zoom,
    /// `response` that of its visible part.
    pub fn apply(self, view: Viewport, ui: &Ui, response: &Response, fit: Rect, dim: (usize, usize)) -> Viewport {
        let view = self.turned(view, ui, response, fit, dim).panned(self.pan(ui, response), fit, dim);
        if self == Self::Edit {
            return view;
        }
        if response.double_clicked() {
            return Viewport::default();
        }
        if !view.is_fitted() {
            let held = response.dragged();
            response.clone().on_hover_and_drag_cursor(if held { CursorIcon::Grabbing } else { CursorIcon::Grab });
        }
        if response.has_focus() { by_keys(view, ui, response, fit, dim) } else { view }
    }

    /// Zooms around the pointer.
    fn turned(self, view: Viewport, ui: &Ui, response: &Response, fit: Rect, dim: (usize, usize)) -> Viewport {
        let pointer = ui.input(|input| input.pointer.hover_pos());
        let Some(pointer) = pointer.filter(|_| ui.rect_contains_pointer(response.rect)) else { return view };
        let factor = ui.input_mut(|input| {
            let pinch = f64::from(input.zoom_delta());
            if self == Self::Edit {
                return pinch;
            }
            // The wheel does not scroll the surroundings as well.
            let turned = std::mem::take(&mut input.smooth_scroll_delta);
            pinch * (f64::from(turned.y) * WHEEL_SPEED).exp()
        });
        if factor == 1.0 { view } else { view.zoomed(factor, pointer, fit, dim) }
    }

    /// Pan of this frame, points.
    fn pan(self, ui: &Ui, response: &Response) -> Vec2 {
        let pointer = |input: &InputState| (input.pointer.press_origin(), input.pointer.latest_pos());
        match self {
            Self::View => {
                let held = response.dragged_by(PointerButton::Primary) || response.dragged_by(PointerButton::Middle);
                match (held, ui.input(pointer)) {
                    // Includes the movement before egui recognized the drag.
                    (true, (Some(from), Some(to))) if response.drag_started() => to - from,
                    (true, _) => response.drag_delta(),
                    _ => Vec2::ZERO,
                }
            }
            // Also over handles, which would take the drag.
            Self::Edit => match ui.input(pointer) {
                (Some(from), Some(_)) if is_panning(ui) && response.rect.contains(from) => {
                    let ours = ui.ctx().layer_id_at(from) == Some(ui.layer_id());
                    if ours { ui.input(|input| input.pointer.delta()) } else { Vec2::ZERO }
                }
                _ => Vec2::ZERO,
            },
        }
    }
}

/// Viewport after key presses: plus and minus zoom, 0 resets, arrows pan.
fn by_keys(view: Viewport, ui: &Ui, response: &Response, fit: Rect, dim: (usize, usize)) -> Viewport {
    let filter = EventFilter { horizontal_arrows: true, vertical_arrows: true, ..Default::default() };
    ui.memory_mut(|memory| memory.set_focus_lock_filter(response.id, filter));
    let frame = Stroke::new(1.5, ui.visuals().selection.stroke.color);
    ui.painter().rect_stroke(response.rect.expand(1.0), 0.0, frame, StrokeKind::Outside);
    let by = ui.input(|input| {
        let pressed = |key| input.key_pressed(key) && !input.modifiers.command;
        vec2(
            axis(pressed(Key::ArrowLeft), pressed(Key::ArrowRight)),
            axis(pressed(Key::ArrowUp), pressed(Key::ArrowDown)),
        )
    });
    zoomed_by_keys(view.panned(by * KEY_PAN * fit.width(), fit, dim), ui, fit.center(), fit, dim)
}

/// Viewport after key presses: plus and minus zoom around a screen position, 0 resets.
pub fn zoomed_by_keys(view: Viewport, ui: &Ui, around: Pos2, fit: Rect, dim: (usize, usize)) -> Viewport {
    let (notches, all) = ui.input(|input| {
        // With Ctrl these keys change the interface zoom.
        let pressed = |key| input.key_pressed(key) && !input.modifiers.command;
        (axis(pressed(Key::Plus) || pressed(Key::Equals), pressed(Key::Minus)), pressed(Key::Num0))
    });
    match (all, notches == 0.0) {
        (true, _) => Viewport::default(),
        (false, true) => view,
        (false, false) => view.zoomed((f64::from(notches) * KEY_NOTCH * WHEEL_SPEED).exp(), around, fit, dim),
    }
}

fn axis(plus: bool, minus: bool) -> f32 {
    f32::from(u8::from(plus)) - f32::from(u8::from(minus))
}

/// Whether a drag pans in [`PointerMode::Edit`].
pub fn is_panning(ui: &Ui) -> bool {
    let typing = ui.ctx().text_edit_focused();
    ui.input(|input| {
        let space = input.key_down(egui::Key::Space) && input.pointer.primary_down();
        input.pointer.middle_down() || (space && !typing)
    })
}
