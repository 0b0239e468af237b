//! Reasons why an image is not a PSF.

use std::path::PathBuf;

use thiserror::Error;

use crate::formats::FormatError;
use crate::optics::LensletArray;
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
    /// A pixel is negative.
    #[error(
        "{origin}: expected light that is not negative, found {value} at row {row}, column {col}; subtract the true \
         background, or add ?dark=corners to the path"
    )]
    Negative {
        /// File or name of the PSF.
        origin: String,
        /// Row of the first offending pixel.
        row: usize,
        /// Its column.
        col: usize,
        /// Its value.
        value: f32,
    },
    /// A pixel is NaN or infinite.
    #[error(
        "{origin}: expected finite light, found {value} at row {row}, column {col}; replace such pixels or choose \
         another image"
    )]
    NotFinite {
        /// File or name of the PSF.
        origin: String,
        /// Row of the first offending pixel.
        row: usize,
        /// Its column.
        col: usize,
        /// Its value.
        value: f32,
    },
    /// No light is left.
    #[error("{origin}: expected a PSF, found no light{above}; check the exposure, the dark level or the file")]
    Dark {
        /// File or name of the PSF.
        origin: String,
        /// What the light was searched above, as the end of the clause.
        above: String,
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
    /// The photograph is larger than a PSF may be.
    #[error(
        "{origin}: expected a PSF of at most {max} pixels a side, found {rows} x {cols}; add ?{query} to the path for \
         one of {side} x {side} px", max = LensletArray::MAX_SIDE
    )]
    Large {
        /// File of the photograph.
        origin: String,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
        /// Options that fit this file.
        query: String,
        /// Side of the PSF that they make, pixels.
        side: usize,
    },
    /// An option of the import has a value that it cannot have.
    #[error("{origin}: expected {expected}, found {found}; {advice}")]
    Option {
        /// File of the photograph.
        origin: String,
        /// The values that there are.
        expected: &'static str,
        /// The option as given.
        found: String,
        /// What to do.
        advice: &'static str,
    },
    /// The window leaves the photograph.
    #[error(
        "{origin}: expected a window within {rows} x {cols} px, found {window} (TOP,LEFT,ROWS,COLS); move or shrink it"
    )]
    Window {
        /// File of the photograph.
        origin: String,
        /// Rows of the photograph.
        rows: usize,
        /// Its columns.
        cols: usize,
        /// The window.
        window: String,
    },
    /// The window is smaller than a bin.
    #[error("{origin}: expected bins of at most the window's {rows} x {cols} px, found {bin}; choose a smaller bin")]
    Bin {
        /// File of the photograph.
        origin: String,
        /// Rows of the window.
        rows: usize,
        /// Its columns.
        cols: usize,
        /// Side of the bins, pixels.
        bin: usize,
    },
    /// The file of an import is no such file.
    #[error("{}: expected {expected}, found {found}; {advice}", .path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// What such a file holds.
        expected: &'static str,
        /// What it holds instead.
        found: String,
        /// What to do.
        advice: &'static str,
    },
}

impl PsfError {
    /// The sentence with advice on the controls of the dialog in place of options of the path.
    pub fn in_dialog(&self) -> String {
        let most = LensletArray::MAX_SIDE;
        match self {
            Self::Negative { origin, row, col, value } => format!(
                "{origin}: expected light that is not negative, found {value} at row {row}, column {col}; subtract the true \
                 background, or choose Median of the corners as dark level"
            ),
            Self::Shape { origin, rows, cols } | Self::Large { origin, rows, cols, .. } => format!(
                "{origin}: expected a PSF of 1 to {most} pixels a side, found {rows} x {cols}; choose Sums of squares of, or \
                 Averages, longer side as pixels"
            ),
            _ => self.to_string(),
        }
    }
}
