//! State of the dialog that imports a PSF photograph.

use std::sync::mpsc::{Receiver, TryRecvError, channel};

use egui::TextureHandle;

use crate::optics::{PixelRectangle, PsfImportOptions, PsfPhotograph, PsfWindow};
use crate::studio::state::path_dialog::Answer;
use crate::workbench::{PsfPreview, PsfPreviewRequest, PsfPreviewer};

/// An answer of the preview thread, with the previewer for the next request.
type PreviewAnswer = (PsfPreviewer, Result<PsfPreview, String>);

/// The dialog that imports a PSF, if it is open.
#[derive(Default)]
pub struct PsfImportDialog {
    /// The open form.
    pub open: Option<PsfImportForm>,
}

impl PsfImportDialog {
    /// Opens the dialog for a path, which may be empty.
    pub fn ask(&mut self, path: String) {
        self.open = Some(PsfImportForm { path, focus: true, ..PsfImportForm::default() });
    }
}

/// The form of an import, and its preview on a thread of its own. The newest request is next.
#[derive(Default)]
pub struct PsfImportForm {
    /// Path as typed.
    pub path: String,
    /// Whether the path field requests the keyboard focus.
    pub focus: bool,
    /// Answer of the file dialog of the system, while it is open.
    pub system: Option<Receiver<Answer>>,
    /// Whether the system has no file dialog.
    pub is_alone: bool,
    /// Whether the import begins as soon as the preview is there.
    pub is_confirmed: bool,
    /// The photograph and the options of the form, once the path is read.
    pub photograph: Option<PsfPhotograph>,
    /// How the window is being dragged.
    pub grab: Option<Grab>,
    /// Textures of photograph and PSF, and the number of their preview.
    pub textures: Option<(u64, [Option<TextureHandle>; 2])>,
    previewer: PsfPreviewer,
    asked: Option<(PsfPreviewRequest, Receiver<PreviewAnswer>)>,
    known: Option<(PsfPreviewRequest, Result<PsfPreview, String>)>,
    /// Number of the known preview.
    serial: u64,
}

/// How the pointer changes the window on a photograph. Places are edges of pixels, (x, y).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Grab {
    /// It moves the window; this is the place of the pointer less that of the top left corner.
    Move {
        /// The distance.
        offset: (f64, f64),
    },
    /// It drags a corner; the opposite one is fixed.
    Resize {
        /// The fixed corner.
        fixed: (f64, f64),
    },
}

impl Grab {
    /// The window with the pointer at a place, in a photograph of shape (rows, cols).
    pub fn window(self, at: (f64, f64), window: PixelRectangle, (rows, cols): (usize, usize)) -> PixelRectangle {
        let inside = |place: f64, most: usize| place.round().clamp(0.0, most as f64) as usize;
        match self {
            Self::Move { offset } => PixelRectangle {
                top: inside(at.1 - offset.1, rows.saturating_sub(window.rows)),
                left: inside(at.0 - offset.0, cols.saturating_sub(window.cols)),
                ..window
            },
            Self::Resize { fixed } => {
                let along = |one: f64, other: f64, most: usize| {
                    let (low, high) = (inside(one.min(other), most), inside(one.max(other), most));
                    let low = low.min(most.saturating_sub(1));
                    (low, (high - low.min(high)).max(1))
                };
                let (top, rows) = along(at.1, fixed.1, rows);
                let (left, cols) = along(at.0, fixed.0, cols);
                PixelRectangle { top, left, rows, cols }
            }
        }
    }
}

impl PsfImportForm {
    /// Takes a finished preview and requests the next one. Call once per frame.
    pub fn follow(&mut self, ctx: &egui::Context) {
        if let Some((request, answer)) = &self.asked {
            match answer.try_recv() {
                Ok((previewer, preview)) => {
                    let mut request = request.clone();
                    if let Ok(preview) = &preview
                        && request == self.wanted()
                    {
                        // The form shows the options of the preview.
                        self.photograph = Some(preview.photograph.clone());
                        request.photograph.clone_from(&self.photograph);
                    }
                    self.previewer = previewer;
                    self.known = Some((request, preview));
                    self.serial += 1;
                }
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) => {
                    let sentence = "The preview failed; choose another file.".to_owned();
                    self.known = Some((request.clone(), Err(sentence)));
                }
            }
            self.asked = None;
        }
        let request = self.wanted();
        if request.path.is_empty() || self.known.as_ref().is_some_and(|(known, _)| *known == request) {
            return;
        }
        let (sender, receiver) = channel();
        let (mut previewer, ctx, wanted) = (std::mem::take(&mut self.previewer), ctx.clone(), request.clone());
        let thread = std::thread::Builder::new().name("lenslet-psf-preview".into()).spawn(move || {
            let preview = previewer.preview(&wanted);
            // The dialog may be closed already; the answer is then dropped.
            let _ = sender.send((previewer, preview));
            ctx.request_repaint();
        });
        self.asked = thread.ok().map(|_| (request, receiver));
    }

    /// The request of the form as it is.
    fn wanted(&self) -> PsfPreviewRequest {
        PsfPreviewRequest { path: self.path.trim().to_owned(), photograph: self.photograph.clone() }
    }

    /// Forgets the photograph of an earlier path.
    pub fn path_changed(&mut self) {
        (self.photograph, self.is_confirmed, self.grab) = (None, false, None);
    }

    /// The newest preview of this path and its number. It may belong to earlier options.
    pub fn preview(&self) -> Option<(&Result<PsfPreview, String>, u64)> {
        let known = self.known.as_ref().filter(|(request, _)| request.path == self.path.trim());
        known.map(|(_, preview)| (preview, self.serial))
    }

    /// Whether the preview belongs to the form as it is.
    pub fn is_current(&self) -> bool {
        self.known.as_ref().is_some_and(|(request, _)| *request == self.wanted())
    }

    /// Whether the form can be imported as it is.
    pub fn is_ready(&self) -> bool {
        let psf = self.preview().is_some_and(|(preview, _)| matches!(preview, Ok(PsfPreview { psf: Ok(_), .. })));
        psf && self.is_current()
    }

    /// The options of the form.
    pub fn options(&mut self) -> Option<&mut PsfImportOptions> {
        self.photograph.as_mut().map(|photograph| &mut photograph.options)
    }

    /// The window on the photograph: that of the form, or the one that its rule found.
    pub fn window(&self) -> Option<PixelRectangle> {
        let options = self.photograph.as_ref()?.options;
        if let PsfWindow::Rectangle(window) = options.window {
            return Some(window);
        }
        let Ok(preview) = self.preview()?.0 else { return None };
        let (rows, cols) = preview.shape;
        let whole = PixelRectangle { top: 0, left: 0, rows, cols };
        Some(preview.psf.as_ref().map_or(whole, |imported| imported.report.window))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn window_follows_the_pointer_and_stays_inside() {
        let window = PixelRectangle { top: 10, left: 20, rows: 30, cols: 40 };
        let shape = (100, 120);
        let moved = Grab::Move { offset: (5.0, 5.0) };
        assert_eq!(moved.window((26.2, 17.0), window, shape), PixelRectangle { top: 12, left: 21, ..window });
        assert_eq!(moved.window((500.0, -9.0), window, shape), PixelRectangle { top: 0, left: 80, ..window });
        let resized = Grab::Resize { fixed: (20.0, 10.0) };
        let expected = PixelRectangle { top: 10, left: 20, rows: 20, cols: 10 };
        assert_eq!(resized.window((30.4, 29.6), window, shape), expected);
        let expected = PixelRectangle { top: 0, left: 8, rows: 10, cols: 12 };
        assert_eq!(resized.window((8.0, -50.0), window, shape), expected);
        let smallest = Grab::Resize { fixed: (120.0, 100.0) }.window((120.0, 100.0), window, shape);
        assert_eq!(smallest, PixelRectangle { top: 99, left: 119, rows: 1, cols: 1 });
    }
}
