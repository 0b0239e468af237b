//! Modal dialogs that fit into the window, with their buttons in reach.

use egui::{Context, Id, Modal, ModalResponse, ScrollArea, Ui};

/// Margin around a dialog, points.
const MARGIN: f32 = 40.0;
/// Height of frame and buttons, points.
const BELOW: f32 = 48.0;

/// Shows a dialog of this name and at most this width, points.
pub fn show<R>(ctx: &Context, name: &str, width: f32, add: impl FnOnce(&mut Ui) -> R) -> ModalResponse<R> {
    Modal::new(Id::unique(name)).show(ctx, |ui| {
        ui.set_width(width.min(ctx.content_rect().width() - MARGIN));
        add(ui)
    })
}

/// Body of a dialog above its buttons; it scrolls in a low window.
pub fn body<R>(ui: &mut Ui, add: impl FnOnce(&mut Ui) -> R) -> R {
    let room = (ui.ctx().content_rect().height() - MARGIN - BELOW).max(0.0);
    // `min_scrolled_height` lets it grow beyond its previous height.
    ScrollArea::vertical().max_height(room).min_scrolled_height(room).show(ui, add).inner
}
