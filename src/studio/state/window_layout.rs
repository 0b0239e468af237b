//! What the window shows where, and a requested image of a panel.

use std::sync::mpsc::Receiver;

use egui::Rect;
use ndarray::Array3;

use crate::studio::state::pane::Pane;

/// Frames between request and capture, in which menus and tooltips close.
const FRAMES: u8 = 8;

/// What the window shows where.
#[derive(Default)]
pub struct WindowLayout {
    /// Requested change.
    pub request: Option<LayoutRequest>,
    /// The visible panels.
    pub visible: Vec<VisiblePanel>,
    /// The maximized panel.
    pub maximised: Option<Pane>,
    /// Pending capture of a panel.
    pub capture: Option<PendingCapture>,
}

/// A visible panel and its place.
#[derive(Clone, Copy, Debug)]
pub struct VisiblePanel {
    /// The panel.
    pub pane: Pane,
    /// Its rectangle, points.
    pub rect: Rect,
}

/// A requested change of the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayoutRequest {
    /// Brings a panel to the front.
    Show(Pane),
    /// Restores the default layout.
    Reset,
    /// Saves the layout under this number.
    Remember(usize),
    /// Loads the layout of this number.
    Recall(usize),
}

/// A requested capture of a panel.
pub struct PendingCapture {
    /// Name of the panel.
    pub name: &'static str,
    /// Its rectangle, points.
    pub rect: Rect,
    /// Frames to wait.
    pub wait: u8,
    /// The image, shape (rows, cols, 3), when it is there.
    pub image: Option<Receiver<Array3<u8>>>,
}

impl WindowLayout {
    /// Requests a change.
    pub fn ask(&mut self, request: LayoutRequest) {
        self.request = Some(request);
    }

    /// Requests a capture of a visible panel; a question for its file follows.
    pub fn capture(&mut self, pane: Pane) {
        if let Some(&VisiblePanel { rect, .. }) = self.visible.iter().find(|visible| visible.pane == pane) {
            self.capture = Some(PendingCapture { name: pane.title(), rect, wait: FRAMES, image: None });
        }
    }

    /// Maximizes the panel at a place, or else the mask; restores all panels if one is maximized.
    pub fn toggle_maximised(&mut self, place: Option<egui::Pos2>) {
        let under = self.visible.iter().find(|visible| place.is_some_and(|place| visible.rect.contains(place)));
        let wanted = under.map_or(Pane::Mask, |visible| visible.pane);
        self.maximised = if self.maximised.is_none() { Some(wanted) } else { None };
    }
}

#[cfg(test)]
mod tests {
    use egui::{Pos2, pos2};

    use super::*;

    fn layout() -> WindowLayout {
        let panel = |pane, left| {
            let rect = Rect::from_min_max(pos2(left, 0.0), pos2(left + 100.0, 100.0));
            VisiblePanel { pane, rect }
        };
        let visible = vec![panel(Pane::Lenslets, 0.0), panel(Pane::Compare, 100.0)];
        WindowLayout { visible, ..WindowLayout::default() }
    }

    #[test]
    fn panel_under_pointer_is_maximized_and_restored() {
        for (place, pane) in [
            (Some(pos2(150.0, 50.0)), Pane::Compare),
            (Some(Pos2::ZERO - egui::vec2(9.0, 9.0)), Pane::Mask),
            (None, Pane::Mask),
        ] {
            let mut layout = layout();
            layout.toggle_maximised(place);
            assert_eq!(layout.maximised, Some(pane));
            layout.toggle_maximised(place);
            assert_eq!(layout.maximised, None);
        }
    }

    #[test]
    fn hidden_panel_is_not_captured() {
        let mut layout = layout();
        layout.capture(Pane::Mask);
        assert!(layout.capture.is_none());
        layout.capture(Pane::Compare);
        assert_eq!(layout.capture.map(|capture| (capture.name, capture.rect.left())), Some(("Compare", 100.0)));
    }
}
