//! Exports: what a design is and does, in files that other tools read. They need no window.

use std::path::{Path, PathBuf};

use ndarray::{ArrayViewD, Axis};
use thiserror::Error;

use super::design::{Design, DesignError, DesignFileError};
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
}

/// Writes a design into `folder`, which is made if need be: `psf.npy`, `psf.tiff` (32-bit float), `psf.png` and
/// `psf16.png` (0 to the PSF's maximum), `design.json`, and `lenslets.csv` where there are lenslets.
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
    let mut files = Vec::new();
    let mut file = |name: &str| {
        let path = folder.join(name);
        files.push(path.clone());
        path
    };
    let stack = psf.view();
    if psf.len_of(Axis(0)) == 1 {
        formats::write_array(&file("psf.npy"), stack.index_axis(Axis(0), 0))?;
    } else {
        formats::write_array(&file("psf.npy"), stack)?;
    }
    formats::write_tiff(&file("psf.tiff"), psf.view())?;
    formats::write_png8(&file("psf.png"), image.view(), 0.0, peak)?;
    formats::write_png16(&file("psf16.png"), image.view(), 0.0, peak)?;
    design.save(&file("design.json"))?;
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
        formats::write_csv(&file("lenslets.csv"), &header, rows)?;
    }
    Ok(files)
}

/// File format of measurement stacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasurementFormat {
    /// NPY, 32-bit float.
    Npy,
    /// TIFF, one page of 32-bit floats per measurement.
    Tiff,
}

/// Writes named stacks, shape (n, rows, cols) or (n, planes, rows, cols), into `folder`, which is made if need be. TIFF
/// has one page per plane.
///
/// # Errors
/// [`ExportError`] names the file that could not be written.
pub fn export_measurements(
    stacks: &[(&str, ArrayViewD<'_, f32>)],
    format: MeasurementFormat,
    folder: &Path,
) -> Result<Vec<PathBuf>, ExportError> {
    formats::create_folder(folder)?;
    let mut files = Vec::new();
    for (name, stack) in stacks {
        let path = match format {
            MeasurementFormat::Npy => folder.join(format!("{name}.npy")),
            MeasurementFormat::Tiff => folder.join(format!("{name}.tiff")),
        };
        match format {
            MeasurementFormat::Npy => formats::write_array(&path, stack.view())?,
            MeasurementFormat::Tiff => {
                let sides = stack.shape();
                let (rows, cols) = (sides[sides.len() - 2], sides[sides.len() - 1]);
                // As many pages as hold all pixels, so the shape always fits.
                let pages =
                    stack.to_shape((stack.len() / (rows * cols).max(1), rows, cols)).map_err(std::io::Error::other);
                formats::write_tiff(&path, pages.map_err(|error| FormatError::from_write(&path, error))?.view())?;
            }
        }
        files.push(path);
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
}

impl Curve {
    /// Writes the curve as CSV.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FormatError> {
        let header: Vec<&str> = self.header.iter().map(String::as_str).collect();
        formats::write_csv(path, &header, self.rows.iter().cloned())
    }
}
