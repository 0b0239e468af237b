//! Import of PSFs from images and arrays: photographs with a dark level, and PSFs as they are.

mod corners;
mod error;
mod normalise;
mod options;
mod photograph;
mod report;
mod settings_file;
mod window;

use std::path::{Path, PathBuf};

use crate::formats;
use crate::optics::LensletArray;

pub use corners::CornerLevel;
pub use error::PsfError;
pub use normalise::normalised_psf;
pub use options::{PixelRectangle, PsfDark, PsfImportOptions, PsfScale, PsfWindow};
pub use photograph::{ImportedPsf, PhotographPixels, PsfPhotograph};
pub use report::{BlackLevel, NegativePixels, PsfImportReport, PsfOptionsIn};

/// Splits a path into the file and the side to resample to. `FILE@32` stands for 32 pixels where no file has that exact
/// name.
///
/// # Errors
/// [`PsfError::Side`] for a side of no or too many pixels.
pub fn psf_file(named: &Path) -> Result<(PathBuf, Option<usize>), PsfError> {
    let whole = || Ok((named.to_path_buf(), None));
    if PsfPhotograph::find(named).is_ok() {
        return whole();
    }
    match formats::split_end(named, b'@') {
        // An @ may also be part of a path.
        Some((path, side)) if !path.as_os_str().is_empty() && side.bytes().all(|byte| byte.is_ascii_digit()) => {
            match side.parse().ok().filter(|side| (1..=LensletArray::MAX_SIDE).contains(side)) {
                Some(side) => Ok((path, Some(side))),
                None => Err(PsfError::Side { origin: named.display().to_string(), found: format!("{side:?}") }),
            }
        }
        _ => whole(),
    }
}

/// Reads a PSF from an image (PNG, JPEG, TIFF, BMP) or an array (NPY, NPZ) and scales it to sum 1. The throughput is 1.
///
/// The path may hold options of the import: see [`PsfImportOptions`]. With `side`, or the side of a path `FILE@32`, the
/// central square is resampled to `side` x `side` pixels by averaging areas; a window of the options takes its place.
///
/// ```no_run
/// use lenslet_studio::prelude::*;
///
/// let imported = import_psf("photo.tif?channel=green&dark=corners&window=auto&bin=25".as_ref(), None)?;
/// imported.notices().iter().for_each(|notice| println!("{notice}"));
/// let design = Design { encoder: Encoder::Image(imported.image), ..Design::default() };
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PsfError`] names the content of the file that is not a PSF.
pub fn import_psf(path: &Path, side: Option<usize>) -> Result<ImportedPsf, PsfError> {
    let (path, named_side) = psf_file(path)?;
    let photograph = PsfPhotograph::find(&path)?;
    let origin = path.display().to_string();
    let options = match side.or(named_side) {
        Some(side) if side > LensletArray::MAX_SIDE => {
            return Err(PsfError::Shape { origin, rows: side, cols: side });
        }
        Some(side) if side > 0 => photograph.options.resampled(side, &origin)?,
        _ => photograph.options,
    };
    photograph.read(&origin)?.psf(options)
}

#[cfg(test)]
mod tests;
