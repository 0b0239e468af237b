//! Preview of the import of a PSF photograph: the photograph, and the PSF that its options make.

use std::path::Path;
use std::sync::Arc;

use ndarray::{Array2, ArrayView2, s};

use crate::formats::{Channel, ImageFile};
use crate::optics::{ImportedPsf, PhotographPixels, PsfError, PsfImportOptions, PsfPhotograph, psf_file};

/// Longest side of the photograph in a preview, pixels.
const LONGEST_SHOWN: usize = 512;

/// A photograph to preview.
#[derive(Clone, Debug, PartialEq)]
pub struct PsfPreviewRequest {
    /// Path as typed, with options.
    pub path: String,
    /// The photograph with chosen options; `None` takes those of the path, or options that fit the photograph.
    pub photograph: Option<PsfPhotograph>,
}

/// Preview of an import.
#[derive(Clone, Debug)]
pub struct PsfPreview {
    /// The photograph with the options of the preview.
    pub photograph: PsfPhotograph,
    /// Whether the file has colours, of which one channel is taken.
    pub has_colours: bool,
    /// Rows and columns of the photograph.
    pub shape: (usize, usize),
    /// Its pixels, averaged to at most 512 pixels a side, DN.
    pub shown: Arc<Array2<f32>>,
    /// The PSF, or one sentence why there is none.
    pub psf: Result<ImportedPsf, String>,
}

/// A photograph that was read.
#[derive(Clone)]
struct ReadPhotograph {
    file: ImageFile,
    has_colours: bool,
    pixels: Arc<PhotographPixels>,
    shown: Arc<Array2<f32>>,
}

/// Makes previews, and keeps the pixels of the last photograph.
#[derive(Clone, Default)]
pub struct PsfPreviewer {
    last: Option<ReadPhotograph>,
}

impl PsfPreviewer {
    /// The preview of a request. It may take seconds for a photograph that was not read before.
    ///
    /// # Errors
    /// One sentence where the photograph cannot be read.
    pub fn preview(&mut self, request: &PsfPreviewRequest) -> Result<PsfPreview, String> {
        self.make(request).map_err(|error| error.in_dialog())
    }

    fn make(&mut self, request: &PsfPreviewRequest) -> Result<PsfPreview, PsfError> {
        let is_chosen = request.photograph.is_some();
        let mut photograph = match &request.photograph {
            Some(chosen) => chosen.clone(),
            None => named(&request.path)?,
        };
        let read = self.read(&mut photograph)?;
        if !is_chosen && photograph.options == PsfImportOptions::default() {
            // Light of one value in all pixels may look like a black level.
            let suggested = read.pixels.suggested();
            if read.pixels.psf(suggested).is_ok() {
                photograph.options = suggested;
            }
        }
        let psf = read.pixels.psf(photograph.options).map_err(|error| error.in_dialog());
        let (has_colours, shape, shown) = (read.has_colours, read.pixels.pixels.dim(), Arc::clone(&read.shown));
        Ok(PsfPreview { photograph, has_colours, shape, shown, psf })
    }

    /// Reads the pixels, unless they are known. A colour image without a channel gets green.
    fn read(&mut self, photograph: &mut PsfPhotograph) -> Result<ReadPhotograph, PsfError> {
        if let Some(read) = self.last.as_ref().filter(|read| read.file == photograph.file) {
            return Ok(read.clone());
        }
        let origin = photograph.file.path.display().to_string();
        let pixels = photograph.read_green(&origin)?;
        // A channel in the path is a channel of colours or of other planes.
        let has_colours = pixels.from_colour || photograph.file.meaning.channel.is_some();
        if pixels.from_colour {
            photograph.file.meaning.channel = Some(Channel::Green);
        }
        let shown = Arc::new(averaged(pixels.pixels.view()));
        let read = ReadPhotograph { file: photograph.file.clone(), has_colours, pixels: Arc::new(pixels), shown };
        self.last = Some(read.clone());
        Ok(read)
    }
}

/// The photograph of a path that may end with a side (`FILE@32`).
fn named(path: &str) -> Result<PsfPhotograph, PsfError> {
    let (path, side) = psf_file(Path::new(path))?;
    let mut photograph = PsfPhotograph::find(&path)?;
    if let Some(side) = side {
        photograph.options = photograph.options.resampled(side, &path.display().to_string())?;
    }
    Ok(photograph)
}

/// Means of equal squares, so that no side exceeds the longest one shown.
fn averaged(image: ArrayView2<'_, f32>) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let bin = rows.max(cols).div_ceil(LONGEST_SHOWN).max(1);
    Array2::from_shape_fn((rows.div_ceil(bin), cols.div_ceil(bin)), |(row, col)| {
        let (bottom, right) = ((row * bin + bin).min(rows), (col * bin + bin).min(cols));
        image.slice(s![row * bin..bottom, col * bin..right]).mean().unwrap_or_default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{PsfDark, PsfScale, PsfWindow};

    #[test]
    fn preview_suggests_options_and_follows_chosen_ones() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.png");
        let photo = image::RgbImage::from_fn(600, 520, |x, y| {
            let is_lit = (200..400).contains(&x) && (150..350).contains(&y) && (x / 10 + y / 10) % 4 == 0;
            if is_lit { image::Rgb([90, 120, 80]) } else { image::Rgb([9, 8, 7]) }
        });
        photo.save(&path).unwrap();
        let mut previewer = PsfPreviewer::default();
        let mut request = PsfPreviewRequest { path: path.display().to_string(), photograph: None };
        let preview = previewer.preview(&request).unwrap();
        let PsfImportOptions { dark, window, scale, .. } = preview.photograph.options;
        assert_eq!((dark, window), (PsfDark::Corners, PsfWindow::Auto));
        assert!(matches!(scale, PsfScale::Bin(4..=5)), "{scale:?}");
        assert_eq!(preview.photograph.file.meaning.channel, Some(Channel::Green));
        assert_eq!((preview.shape, preview.shown.dim(), preview.has_colours), ((520, 600), (260, 300), true));
        assert!(preview.psf.unwrap().image.psf.nrows() <= 48);
        let mut chosen = preview.photograph;
        chosen.options.window = PsfWindow::Square;
        chosen.options.scale = PsfScale::Grid(32);
        request.photograph = Some(chosen.clone());
        let preview = previewer.preview(&request).unwrap();
        assert_eq!(preview.photograph, chosen);
        let psf = preview.psf.unwrap().image.psf;
        let named = crate::optics::import_psf(Path::new(&chosen.text()), None).unwrap();
        assert_eq!(named.image.psf, psf, "the import makes what the preview shows");
        // A small clean PSF stays as it is.
        let small = folder.path().join("small.npy");
        let spot = Array2::from_shape_fn((16, 16), |(row, col)| if row == col { 1.0_f32 } else { 0.0 });
        crate::formats::write_array(&small, spot.view()).unwrap();
        request = PsfPreviewRequest { path: small.display().to_string(), photograph: None };
        let preview = previewer.preview(&request).unwrap();
        assert_eq!((preview.photograph.options, preview.has_colours), (PsfImportOptions::default(), false));
        request.path = format!("{}@8", small.display());
        assert_eq!(previewer.preview(&request).unwrap().psf.unwrap().image.psf.dim(), (8, 8));
        request.path = folder.path().join("none.npy").display().to_string();
        assert!(previewer.preview(&request).unwrap_err().contains("found nothing"));
    }
}
