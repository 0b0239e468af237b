//! Checks of patches before a model uses them.

use ndarray::ArrayView3;

use crate::information::error::InformationError;

/// Largest count that the network resolves: above, single photons are lost in `f32` differences.
pub(in crate::information) const MAX_PHOTONS: f32 = 1e7;

/// Checks that patches are finite, not too bright, and not empty.
pub(in crate::information) fn check_values(
    patches: ArrayView3<'_, f32>,
    what: &'static str,
) -> Result<(), InformationError> {
    if patches.is_empty() {
        return Err(InformationError::Empty);
    }
    for (patch, values) in patches.outer_iter().enumerate() {
        if let Some(&value) = values.iter().find(|value| !value.is_finite() || value.abs() > MAX_PHOTONS) {
            return Err(if value.is_finite() {
                InformationError::TooBright { found: f64::from(value), limit: f64::from(MAX_PHOTONS) }
            } else {
                InformationError::NotFinite { what, patch }
            });
        }
    }
    Ok(())
}

/// Checks that clean test patches match the noisy ones in shape and number.
pub(in crate::information) fn check_clean(
    clean: ArrayView3<'_, f32>,
    test: ArrayView3<'_, f32>,
) -> Result<(), InformationError> {
    let (count, found_rows, found_cols) = clean.dim();
    let (noisy, rows, cols) = test.dim();
    if (found_rows, found_cols) != (rows, cols) {
        return Err(InformationError::PatchShape { what: "clean patches", rows, cols, found_rows, found_cols });
    }
    if count != noisy {
        return Err(InformationError::PatchCount { noisy, clean: count });
    }
    Ok(())
}
