//! Images of panels as shown on the screen.

use std::sync::mpsc::{TryRecvError, channel};

use egui::{Rect, Ui};
use ndarray::Array3;

use crate::studio::app::state::State;
use crate::studio::state::path_dialog::PathPurpose;
use crate::studio::state::request::Request;
use crate::studio::state::window_layout::VisiblePanel;
use crate::studio::widgets::controls::name_widget;

/// Advances a requested capture. Call once per frame.
pub fn advance(ctx: &egui::Context, state: &mut State) {
    let Some(capture) = &mut state.layout.capture else { return };
    if capture.wait > 0 {
        capture.wait -= 1;
        ctx.request_repaint();
        return;
    }
    let Some(pending_image) = &capture.image else {
        let (sender, receiver) = channel();
        let (rect, scale, repaint) = (capture.rect, ctx.pixels_per_point(), ctx.clone());
        capture.image = Some(receiver);
        ctx.request_screenshot(move |screen| {
            // The window may be closed.
            let _ = sender.send(cut(&screen, rect, scale));
            repaint.request_repaint();
        });
        return;
    };
    match pending_image.try_recv() {
        Ok(image) => {
            let name = capture.name;
            state.layout.capture = None;
            state.dialogs.path.ask(PathPurpose::ExportPanel { name, image }, state.session.path());
        }
        Err(TryRecvError::Empty) => {}
        Err(TryRecvError::Disconnected) => state.layout.capture = None,
    }
}

/// A rectangle of the screen, shape (rows, cols, 3); `scale` in pixels per point.
fn cut(screen: &egui::ColorImage, rect: Rect, scale: f32) -> Array3<u8> {
    let [width, height] = screen.size;
    let place = |at: f32, most: usize| ((at * scale).round().max(0.0) as usize).min(most);
    let (left, right) = (place(rect.left(), width), place(rect.right(), width));
    let (top, bottom) = (place(rect.top(), height), place(rect.bottom(), height));
    let shape = (bottom.saturating_sub(top), right.saturating_sub(left), 3);
    Array3::from_shape_fn(shape, |(row, col, channel)| {
        screen.pixels[(top + row) * width + left + col].to_array()[channel]
    })
}

/// One menu entry per visible panel.
pub fn menu(ui: &mut Ui, visible: &[VisiblePanel], requests: &mut Vec<Request>) {
    for &VisiblePanel { pane, .. } in visible {
        let response = ui.button(pane.title());
        name_widget(&response, &format!("Image of {}", pane.title()));
        if response.clicked() {
            requests.push(Request::Capture(pane));
            ui.close();
        }
    }
}

#[cfg(test)]
mod tests {
    use egui::{Color32, ColorImage, pos2};

    use super::*;

    #[test]
    fn panel_image_is_cut_at_whole_pixels() {
        let pixels = (0..6 * 4).map(|index| Color32::from_rgb(index as u8, 7, 0)).collect();
        let screen = ColorImage::new([6, 4], pixels);
        let part = cut(&screen, Rect::from_min_max(pos2(1.0, 0.5), pos2(2.0, 9.0)), 2.0);
        assert_eq!(part.dim(), (3, 2, 3), "what is beyond the screen is left out");
        assert_eq!((part[(0, 0, 0)], part[(2, 1, 0)], part[(2, 1, 1)]), (6 + 2, 3 * 6 + 3, 7));
        assert_eq!(cut(&screen, Rect::NOTHING, 1.0).len(), 0);
    }
}
