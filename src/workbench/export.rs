//! Exports: what a design is and does, in files that other tools read. They need no window.

use std::path::{Path, PathBuf};

use ndarray::Axis;
use thiserror::Error;

use super::design::{Design, DesignError, DesignFileError};
use super::evaluation::EvaluationError;
use crate::formats::{self, FormatError};
use crate::optics::Spot;

/// Why an export was not written.
#[derive(Debug, Error)]
pub enum ExportError {
    /// A file.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The design file.
    #[error(transparent)]
    Design(#[from] DesignFileError),
    /// The mask cannot be rendered.
    #[error(transparent)]
    Mask(#[from] DesignError),
    /// What was to be exported could not be computed.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
}

/// The files of an exported design; the last one is of lenslets alone.
pub const DESIGN_FILES: [&str; 6] = ["psf.npy", "psf.tiff", "psf.png", "psf16.png", DESIGN_FILE, "lenslets.csv"];
/// The one of them that can be opened.
pub const DESIGN_FILE: &str = "design.json";

/// Writes a design into `folder`, which is made if need be: `psf.npy`, `psf.tiff` (32-bit float), `psf.png` and
/// `psf16.png` (0 to the PSF's maximum), `design.json`, and `lenslets.csv` where there are lenslets; where there are
/// none, that of an earlier export is removed.
///
/// `psf.npy` and `psf.tiff` hold (rows, cols) values that sum to 1, or (planes, rows, cols) where lenslets are focused
/// on several planes; the PNG files show all planes together.
///
/// # Errors
/// [`ExportError`] names the file that could not be written.
pub fn export_design(design: &Design, folder: &Path) -> Result<Vec<PathBuf>, ExportError> {
    let psf = design.psf(1)?.mapv(|value| value as f32);
    let image = psf.sum_axis(Axis(0));
    let peak = image.iter().copied().fold(0.0, f32::max);
    formats::create_folder(folder)?;
    let [npy, tiff, png8, png16, json, csv] = DESIGN_FILES.map(|name| folder.join(name));
    let stack = psf.view();
    if psf.len_of(Axis(0)) == 1 {
        formats::write_array(&npy, stack.index_axis(Axis(0), 0))?;
    } else {
        formats::write_array(&npy, stack)?;
    }
    formats::write_tiff(&tiff, psf.view())?;
    formats::write_png8(&png8, image.view(), 0.0, peak)?;
    formats::write_png16(&png16, image.view(), 0.0, peak)?;
    design.save(&json)?;
    let mut files = vec![npy, tiff, png8, png16, json];
    if let Some(array) = design.encoder.lenslets() {
        let header = ["x_px", "y_px", "sigma_px", "weight", "plane", "cov_xx_px2", "cov_xy_px2", "cov_yy_px2"];
        let rows = array.lenslets.iter().map(|lenslet| {
            let (xx, xy, yy) = lenslet.spot.covariance();
            let sigma = match lenslet.spot {
                Spot::Isotropic(sigma) => sigma,
                Spot::Anisotropic { .. } => lenslet.spot.mean_sigma(),
            };
            vec![lenslet.x, lenslet.y, sigma, lenslet.weight, lenslet.plane as f64, xx, xy, yy]
        });
        formats::write_csv(&csv, &header, rows)?;
        files.push(csv);
    } else {
        // Those of an earlier export are not of this mask.
        formats::remove_if_there(&csv)?;
    }
    Ok(files)
}

/// Columns of numbers with names.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Names of the columns, with units.
    pub header: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<f64>>,
    /// Names of the rows, which make the first column; none where they have no names.
    pub names: Vec<String>,
}

impl Curve {
    /// Writes the curve as CSV.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FormatError> {
        let header: Vec<&str> = self.header.iter().map(String::as_str).collect();
        if self.names.is_empty() {
            return formats::write_csv(path, &header, self.rows.iter().cloned());
        }
        let header = [&["name"], header.as_slice()].concat();
        let rows = self.names.iter().zip(&self.rows).map(|(name, row)| {
            let values = row.iter().map(|value| format!("{value:?}"));
            std::iter::once(name.clone()).chain(values).collect()
        });
        formats::write_csv_text(path, &header, rows)
    }
}
