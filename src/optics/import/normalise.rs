//! Checks of an image, and its scaling to sum 1.

use ndarray::{Array2, ArrayView2};

use super::error::PsfError;
use crate::optics::LensletArray;

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
    check_finite(image.view(), origin)?;
    if let Some(((row, col), &value)) = image.indexed_iter().find(|(_, value)| **value < 0.0) {
        return Err(PsfError::Negative { origin: origin.into(), row, col, value });
    }
    let sum: f64 = image.iter().map(|&value| f64::from(value)).sum();
    if sum <= 0.0 {
        return Err(PsfError::Dark { origin: origin.into(), above: " at all".into() });
    }
    // A PSF that already sums to 1 within rounding stays unchanged, so that saving and opening changes no bit.
    if (sum - 1.0).abs() < 1e-6 { Ok(image) } else { Ok(image.map(|&value| (f64::from(value) / sum) as f32)) }
}

/// Checks that all pixels are finite.
pub(super) fn check_finite(image: ArrayView2<'_, f32>, origin: &str) -> Result<(), PsfError> {
    match image.indexed_iter().find(|(_, value)| !value.is_finite()) {
        Some(((row, col), &value)) => Err(PsfError::NotFinite { origin: origin.into(), row, col, value }),
        None => Ok(()),
    }
}
