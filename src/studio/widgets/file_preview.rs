//! Preview of an image file: how the program reads it, and buttons for other readings.

use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError, channel};

use egui::accesskit::Live;
use egui::{ScrollArea, Ui};

use crate::studio::widgets::controls::speak;
use crate::workbench::{FilePreview, FileUse, with_option};

/// Height of three lines and the buttons, points.
const HEIGHT: f32 = 84.0;

/// Preview of one file, read on its own thread, one path at a time; the newest path is next.
#[derive(Default)]
pub struct Preview {
    /// Path that is being read, and its pending answer.
    asked: Option<(String, Receiver<FilePreview>)>,
    /// Path that was read last, and its preview.
    known: Option<(String, FilePreview)>,
}

impl Preview {
    /// [`Preview::show`] at a fixed height, so that buttons below do not move when the answer comes.
    pub fn show_in_place(&mut self, ui: &mut Ui, text: &mut String, of: FileUse) {
        let size = egui::vec2(ui.available_width(), HEIGHT);
        ui.allocate_ui_with_layout(size, egui::Layout::top_down(egui::Align::Min), |ui| {
            ui.set_min_size(size);
            ScrollArea::vertical().max_height(HEIGHT).auto_shrink(false).show(ui, |ui| self.show(ui, text, of));
        });
    }

    /// Shows the preview of the file that `text` names; a button puts another reading into `text`.
    pub fn show(&mut self, ui: &mut Ui, text: &mut String, of: FileUse) {
        self.follow(ui.ctx(), text, of);
        let Some((_, known)) = self.known.as_ref().filter(|(named, _)| named == text) else {
            if self.asked.is_some() {
                ui.weak("Reading the file");
            }
            return;
        };
        match &known.understood {
            Ok(understood) => speak(&ui.weak(understood), Live::Polite),
            Err(sentence) => speak(&ui.colored_label(ui.visuals().warn_fg_color, sentence), Live::Polite),
        }
        let mut chosen = None;
        if !known.choices.is_empty() {
            ui.horizontal_wrapped(|ui| {
                ui.label("Read it as");
                for choice in &known.choices {
                    if ui.small_button(choice).clicked() {
                        chosen = Some(choice.clone());
                    }
                }
            });
        }
        if let Some(choice) = chosen {
            *text = with_option(text.trim(), &choice);
        }
    }

    /// Takes a finished answer and starts the preview of `text`.
    fn follow(&mut self, ctx: &egui::Context, text: &str, of: FileUse) {
        if let Some((named, answer)) = &self.asked {
            match answer.try_recv() {
                Ok(preview) => self.known = Some((named.clone(), preview)),
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) => {}
            }
            self.asked = None;
        }
        let is_known = self.known.as_ref().is_some_and(|(named, _)| named == text);
        if text.trim().is_empty() || is_known {
            return;
        }
        let (sender, receiver) = channel();
        let (path, ctx) = (text.trim().to_owned(), ctx.clone());
        let thread = std::thread::Builder::new().name("lenslet-file-preview".into()).spawn(move || {
            // The dialog may be closed already; the answer is then dropped.
            let _ = sender.send(FilePreview::of(Path::new(&path), of));
            ctx.request_repaint();
        });
        self.asked = thread.ok().map(|_| (text.to_owned(), receiver));
    }
}
