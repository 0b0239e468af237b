//! A requested image of a panel.

use std::sync::mpsc::Receiver;

use egui::Rect;
use ndarray::Array3;

use crate::studio::state::pane::Pane;

/// Frames between request and capture, in which menus and tooltips close.
const FRAMES: u8 = 8;

/// The pending capture, if any.
#[derive(Default)]
pub struct Capture {
    pub pending: Option<PendingCapture>,
}

pub struct PendingCapture {
    pub name: &'static str,
    pub rect: Rect,
    /// Frames to wait.
    pub wait: u8,
    pub image: Option<Receiver<Array3<u8>>>,
}

impl Capture {
    /// Asks for an image of a panel that is drawn; a question for its file follows.
    pub fn request(&mut self, drawn: &[(Pane, Rect)], pane: Pane) {
        if let Some(&(_, rect)) = drawn.iter().find(|(other, _)| *other == pane) {
            self.pending = Some(PendingCapture { name: pane.title(), rect, wait: FRAMES, image: None });
        }
    }
}
