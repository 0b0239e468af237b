//! Import of a PSF from an image or an array file.

use std::path::{Path, PathBuf};

use ndarray::{Array2, ArrayView2};
use thiserror::Error;

use super::encoder::PsfImage;
use super::lenslets::LensletArray;
use crate::formats::{self, FormatError, ImageFile, ImageSummary};
use crate::plural::counted;

/// Reason why an image is not a PSF.
#[derive(Debug, Error)]
pub enum PsfError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The file holds more than one image.
    #[error("{origin}: expected one PSF, found {}; add ?frame=1 to the path to take the first", counted(*.found, "image"))]
    Several {
        /// File or name of the PSF.
        origin: String,
        /// Number of images in the file.
        found: usize,
    },
    /// A pixel is negative or not finite.
    #[error(
        "{origin}: expected finite, non-negative light, found {value} at row {row}, column {col}; \
         subtract the background so that nothing is below 0"
    )]
    Pixel {
        /// File or name of the PSF.
        origin: String,
        /// Row of the first offending pixel.
        row: usize,
        /// Its column.
        col: usize,
        /// Its value.
        value: f32,
    },
    /// All pixels are 0.
    #[error("{origin}: expected a PSF, found no light at all; check the exposure or the file")]
    Dark {
        /// File or name of the PSF.
        origin: String,
    },
    /// The text after the @ of a path is not a side in pixels.
    #[error("{origin}: expected 1 to {max} pixels a side after the @, found {found}", max = LensletArray::MAX_SIDE)]
    Side {
        /// File of the PSF.
        origin: String,
        /// The text after the @.
        found: String,
    },
    /// The image is too large, or empty.
    #[error(
        "{origin}: expected a PSF of 1 to {max} pixels a side, found {rows} x {cols}; \
         resample it: add @32 to the path, or --grid 32 to a command", max = LensletArray::MAX_SIDE
    )]
    Shape {
        /// File or name of the PSF.
        origin: String,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
}

/// Splits a path into the file and the side to resample to. `FILE@32` stands for 32 pixels where no file has that exact
/// name.
///
/// # Errors
/// [`PsfError::Side`] for a side of no or too many pixels.
pub fn psf_file(named: &Path) -> Result<(PathBuf, Option<usize>), PsfError> {
    let whole = || Ok((named.to_path_buf(), None));
    if ImageFile::find(named).is_ok() {
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
/// With `side`, or the side of a path `FILE@32`, the central square is first resampled to `side` x `side` pixels by
/// averaging areas. The second value summarises how the file was read.
///
/// ```no_run
/// use lenslet_studio::prelude::*;
///
/// let (image, summary) = import_psf("diffuser.png".as_ref(), Some(32))?;
/// println!("{summary}");
/// let design = Design { encoder: Encoder::Image(image), ..Design::default() };
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PsfError`] names the content of the file that is not a PSF.
pub fn import_psf(path: &Path, side: Option<usize>) -> Result<(PsfImage, ImageSummary), PsfError> {
    let (path, named_side) = psf_file(path)?;
    let side = side.or(named_side);
    let origin = path.display().to_string();
    let stack = formats::read_stack(&path)?;
    if stack.pages != 1 {
        return Err(PsfError::Several { origin, found: stack.pages });
    }
    let understood = ImageSummary::of(&stack);
    let image = stack.image(0);
    check_pixels(image.view(), &origin)?;
    if let Some(side) = side.filter(|&side| side > LensletArray::MAX_SIDE) {
        return Err(PsfError::Shape { origin, rows: side, cols: side });
    }
    let image = match side {
        Some(side) if side > 0 && !image.is_empty() => resample_square(image.view(), side),
        _ => image,
    };
    Ok((PsfImage { psf: normalised_psf(image, &origin)?, origin, throughput: 1.0 }, understood))
}

/// Checks an image and scales it to sum 1. `origin` names it in messages.
///
/// # Errors
/// [`PsfError`] where the image is empty, too large, dark, or has a pixel that is negative or not finite.
pub fn normalised_psf(image: Array2<f32>, origin: &str) -> Result<Array2<f32>, PsfError> {
    let (rows, cols) = image.dim();
    let side = 1..=LensletArray::MAX_SIDE;
    if !side.contains(&rows) || !side.contains(&cols) {
        return Err(PsfError::Shape { origin: origin.into(), rows, cols });
    }
    check_pixels(image.view(), origin)?;
    let sum: f64 = image.iter().map(|&value| f64::from(value)).sum();
    if sum <= 0.0 {
        return Err(PsfError::Dark { origin: origin.into() });
    }
    // A PSF that already sums to 1 within rounding stays unchanged, so that saving and opening changes no bit.
    if (sum - 1.0).abs() < 1e-6 { Ok(image) } else { Ok(image.map(|&value| (f64::from(value) / sum) as f32)) }
}

/// Checks that light is finite and not negative.
fn check_pixels(image: ArrayView2<'_, f32>, origin: &str) -> Result<(), PsfError> {
    match image.indexed_iter().find(|(_, value)| !(value.is_finite() && **value >= 0.0)) {
        Some(((row, col), &value)) => Err(PsfError::Pixel { origin: origin.into(), row, col, value }),
        None => Ok(()),
    }
}

/// The central square of `image` resampled to `side` x `side` pixels, each the mean of the area it covers.
fn resample_square(image: ArrayView2<'_, f32>, side: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let square = rows.min(cols);
    let (top, left) = ((rows - square) / 2, (cols - square) / 2);
    let step = square as f64 / side as f64;
    // Share of source pixel `source` in target pixel `target` along one axis.
    let overlaps = Array2::from_shape_fn((side, square), |(target, source)| {
        let (from, to) = (target as f64 * step, (target + 1) as f64 * step);
        ((to.min(source as f64 + 1.0) - from.max(source as f64)).max(0.0) / step) as f32
    });
    let middle = image.slice(ndarray::s![top..top + square, left..left + square]);
    overlaps.dot(&middle).dot(&overlaps.t())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resampling_keeps_the_mean_and_the_place() {
        let mut image = Array2::zeros((60, 90));
        image[(30, 45)] = 36.0;
        let small = resample_square(image.view(), 10);
        assert_eq!(small.dim(), (10, 10));
        assert!((small[(5, 5)] - 1.0).abs() < 1e-6, "a 6x6 block with 36 has mean 1");
        assert!((small.sum() - 1.0).abs() < 1e-6);
        let large = resample_square(Array2::from_elem((3, 3), 2.0).view(), 7);
        assert!(large.iter().all(|value| (value - 2.0).abs() < 1e-5));
    }

    #[test]
    fn pixels_are_checked_before_they_are_averaged_and_one_pixel_is_a_square() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        let mut image = Array2::<f32>::ones((6, 6));
        image[(2, 3)] = -0.5;
        formats::write_array(&path, image.clone().into_dyn().view()).unwrap();
        let message = import_psf(&path, Some(2)).unwrap_err().to_string();
        assert!(message.contains("-0.5 at row 2, column 3"), "{message}");
        formats::write_array(&path, Array2::<f32>::ones((1, 1)).into_dyn().view()).unwrap();
        assert_eq!(import_psf(&path, Some(8)).unwrap().0.psf.dim(), (8, 8));
    }

    #[test]
    fn an_at_sign_is_a_side_unless_a_file_has_that_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        formats::write_array(&path("psf@32"), Array2::<f32>::ones((6, 6)).into_dyn().view()).unwrap();
        formats::write_array(&path("a.npy"), Array2::<f32>::ones((6, 6)).into_dyn().view()).unwrap();
        let side = |name: &str| import_psf(&path(name), None).map(|(image, _)| image.psf.dim().0).ok();
        assert_eq!([side("psf@32"), side("psf@32@3"), side("a.npy@4"), side("a.npy")], [6, 3, 4, 6].map(Some));
        assert_eq!(side("a.npy?channel=luma@2"), Some(2));
        assert_eq!(side("b.npy@4"), None);
        for wrong in ["a.npy@0", "a.npy@9999", "a.npy@"] {
            let error = import_psf(&path(wrong), None).unwrap_err().to_string();
            assert!(error.contains("pixels a side after the @"), "{error}");
        }
    }

    #[test]
    fn what_is_not_light_is_refused_by_its_pixel() {
        let mut image = Array2::<f32>::ones((4, 5));
        image[(2, 3)] = -1.0;
        let message = normalised_psf(image.clone(), "p.npy").unwrap_err().to_string();
        assert!(message.contains("-1 at row 2, column 3"), "{message}");
        image[(2, 3)] = f32::NAN;
        assert!(matches!(normalised_psf(image, "p.npy"), Err(PsfError::Pixel { .. })));
        assert!(matches!(normalised_psf(Array2::zeros((4, 4)), "p.npy"), Err(PsfError::Dark { .. })));
        assert!(matches!(normalised_psf(Array2::zeros((0, 4)), "p.npy"), Err(PsfError::Shape { .. })));
    }

    #[test]
    fn a_normalised_psf_is_left_to_the_bit() {
        let once = normalised_psf(Array2::from_shape_fn((9, 9), |(r, c)| (r * c) as f32 + 0.1), "p").unwrap();
        assert_eq!(normalised_psf(once.clone(), "p").unwrap(), once);
    }
}
