//! Errors of objects, PSFs and patches whose shapes do not match.

use thiserror::Error;

/// Reason why objects cannot be measured.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SensorError {
    /// The valid region would be empty.
    #[error(
        "the objects are {object_rows} x {object_cols} pixels and the PSF is {psf_rows} x {psf_cols}; \
         expected objects at least as large as the PSF; use larger objects or a smaller PSF"
    )]
    ObjectSmallerThanPsf {
        /// Rows of the objects.
        object_rows: usize,
        /// Columns of the objects.
        object_cols: usize,
        /// Rows of the PSF.
        psf_rows: usize,
        /// Columns of the PSF.
        psf_cols: usize,
    },
    /// Arrays that belong together differ in shape.
    #[error("{what}: expected shape {expected}, found {found}")]
    Shape {
        /// The array.
        what: &'static str,
        /// The expected shape.
        expected: String,
        /// The shape found.
        found: String,
    },
    /// The patch is larger than the measurement.
    #[error(
        "patches of {patch_rows} x {patch_cols} pixels do not fit measurements of {rows} x {cols}; use smaller patches"
    )]
    PatchTooLarge {
        /// Rows of the patch.
        patch_rows: usize,
        /// Columns of the patch.
        patch_cols: usize,
        /// Rows of the measurement.
        rows: usize,
        /// Columns of the measurement.
        cols: usize,
    },
}

/// The error of an array with the wrong shape.
pub(super) fn shape_error(what: &'static str, expected: &[usize], found: &[usize]) -> SensorError {
    let text = |shape: &[usize]| shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(" x ");
    SensorError::Shape { what, expected: text(expected), found: text(found) }
}
