//! Questions and sheets in front of the window: no larger than it, with their buttons in reach.

use egui::{Context, Id, Modal, ModalResponse, ScrollArea, Ui};

/// Left free around a question, points.
const MARGIN: f32 = 40.0;
/// Room for the frame of a question and the buttons under what it says, points.
const BELOW: f32 = 48.0;

/// Shows a question of this name and width, points; it is narrower where the window is.
pub fn show<R>(ctx: &Context, name: &str, width: f32, add: impl FnOnce(&mut Ui) -> R) -> ModalResponse<R> {
    Modal::new(Id::unique(name)).show(ctx, |ui| {
        ui.set_width(width.min(ctx.content_rect().width() - MARGIN));
        add(ui)
    })
}

/// What a question says above its buttons: it scrolls where the window is too low for all of it.
pub fn body<R>(ui: &mut Ui, add: impl FnOnce(&mut Ui) -> R) -> R {
    let room = (ui.ctx().content_rect().height() - MARGIN - BELOW).max(0.0);
    // Without the second of these it is no higher than what was shown before.
    ScrollArea::vertical().max_height(room).min_scrolled_height(room).show(ui, add).inner
}
