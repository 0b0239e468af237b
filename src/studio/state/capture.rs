//! State of the window that reconstructs a capture of a camera.

use std::path::PathBuf;

use egui::TextureHandle;

use crate::reconstruction::{CaptureFiles, DarkLevel, DecoderKind};
use crate::studio::canvas::image_view::ImageView;
use crate::studio::state::path_dialog::CaptureFile;
use crate::workbench::{CaptureOrder, Colormap};

/// State of the window that reconstructs a capture.
pub struct CaptureDialog {
    /// Whether it is open.
    pub is_open: bool,
    /// Path of the capture, as typed.
    pub measurement: String,
    /// Path of the PSF, as typed.
    pub psf: String,
    /// Grey value or file of the dark level, as typed; empty for the corners of the PSF.
    pub dark: String,
    /// Side of the squares of pixels that are averaged.
    pub bin: usize,
    /// The decoder.
    pub decoder: DecoderKind,
    /// Whether the capture itself is shown.
    pub shows_capture: bool,
    /// Channel on view, of an image in colour; none for all.
    pub channel: Option<usize>,
    /// Image of one channel.
    pub image: ImageView,
    /// Image in colour, and its version: serial number and whether it is the capture.
    pub texture: Option<((u64, bool), TextureHandle)>,
}

impl Default for CaptureDialog {
    fn default() -> Self {
        Self {
            is_open: false,
            measurement: String::new(),
            psf: String::new(),
            dark: String::new(),
            bin: 1,
            decoder: DecoderKind::TotalVariation,
            shows_capture: false,
            channel: None,
            image: ImageView::new("Capture image", "DN", Colormap::Gray),
            texture: None,
        }
    }
}

impl CaptureDialog {
    /// Decoders that need neither objects nor training.
    pub fn decoders() -> impl Iterator<Item = DecoderKind> {
        DecoderKind::ALL.into_iter().filter(|kind| !kind.needs().objects && !kind.needs().training)
    }

    /// Takes a chosen path.
    pub fn choose(&mut self, file: CaptureFile, path: String) {
        match file {
            CaptureFile::Measurement => self.measurement = path,
            CaptureFile::Psf => self.psf = path,
        }
    }

    /// The order of the form; none before both files are chosen.
    ///
    /// # Errors
    /// One sentence where the dark level is no number and no file.
    pub fn order(&self) -> Result<Option<CaptureOrder>, String> {
        let path = |text: &str| Some(PathBuf::from(text.trim())).filter(|path| !path.as_os_str().is_empty());
        let (Some(measurement), Some(psf)) = (path(&self.measurement), path(&self.psf)) else { return Ok(None) };
        let dark = self.dark.trim();
        let dark = if dark.is_empty() { None } else { Some(dark.replace(',', ".").parse::<f64>()) };
        let dark = match dark {
            None => None,
            Some(Ok(level)) if level.is_finite() => Some(DarkLevel::Constant(level)),
            Some(_) => Some(self.dark.trim().parse()?),
        };
        Ok(Some(CaptureOrder { files: CaptureFiles { measurement, psf, dark, bin: self.bin }, decoder: self.decoder }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn form_is_an_order_once_both_files_are_chosen() {
        let mut dialog = CaptureDialog::default();
        dialog.choose(CaptureFile::Measurement, " raw.tif ".into());
        assert_eq!(dialog.order(), Ok(None));
        dialog.choose(CaptureFile::Psf, "psf.tif".into());
        dialog.bin = 4;
        for (typed, dark) in [
            ("", None),
            (" 12,5", Some(DarkLevel::Constant(12.5))),
            ("dark.tif", Some(DarkLevel::File("dark.tif".into()))),
        ] {
            dialog.dark = typed.into();
            let files = CaptureFiles { measurement: "raw.tif".into(), psf: "psf.tif".into(), dark, bin: 4 };
            assert_eq!(dialog.order(), Ok(Some(CaptureOrder { files, decoder: DecoderKind::TotalVariation })));
        }
        dialog.dark = "nan".into();
        assert!(dialog.order().is_err());
    }
}
