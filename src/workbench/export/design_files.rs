//! Exports of a design and its results, in files for other tools. They need no window.

use std::path::{Path, PathBuf};

use ndarray::Axis;
use thiserror::Error;

use crate::evaluation::scene::EvaluationError;
use crate::formats::{self, ArrayWriter, CompleteFile, FormatError, PageWriter};
use crate::forward::{Design, DesignError, DesignFileError};
use crate::optics::Spot;
use crate::workbench::export::colormap::Colormap;

/// Reasons why an export was not written.
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
    /// The computation of the exported data failed.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
}

/// The files of an exported design; the last one is of lenslets alone.
pub const DESIGN_FILES: [&str; 6] = ["psf.npy", "psf.tiff", "psf.png", "psf16.png", DESIGN_FILE, "lenslets.csv"];
/// The file among them that can be opened again.
pub const DESIGN_FILE: &str = "design.json";

/// The file of the PSF in these colours.
fn coloured(colormap: Colormap) -> String {
    format!("psf-{}.png", colormap.to_string().to_lowercase())
}

/// All files that an export into `folder` may write or remove.
pub fn design_outputs(folder: &Path) -> Vec<PathBuf> {
    let colours = Colormap::ALL.map(|colormap| folder.join(coloured(colormap)));
    DESIGN_FILES.iter().map(|name| folder.join(name)).chain(colours).collect()
}

/// Writes a design into `folder`, which is created if it is missing. The files are `psf.npy`, `psf.tiff` (32-bit float), `psf.png` and
/// `psf16.png` (0 to the PSF's maximum), `design.json`, `lenslets.csv` where there are lenslets, and `psf-COLOURS.png` where colours are
/// requested. A table or colours from an earlier export of another mask are removed.
///
/// `psf.npy` and `psf.tiff` hold (rows, cols) values that sum to the throughput of the mask, or (planes, rows, cols) where lenslets are focused
/// on several planes; the PNG files show all planes together. No file appears before all are complete.
///
/// # Errors
/// [`ExportError`] names the file that could not be written, or the folder where another program writes into it.
pub fn export_design(design: &Design, folder: &Path, colours: Option<Colormap>) -> Result<Vec<PathBuf>, ExportError> {
    formats::create_folder(folder)?;
    let _lock = formats::lock_folder(folder)?;
    write_design(design, folder, colours)
}

/// As [`export_design`], into an existing folder that the caller has locked.
///
/// # Errors
/// As [`export_design`].
pub fn write_design(design: &Design, folder: &Path, colours: Option<Colormap>) -> Result<Vec<PathBuf>, ExportError> {
    let psf = design.psf(1)?.mapv(|value| value as f32);
    let image = psf.sum_axis(Axis(0));
    let peak = image.iter().copied().fold(0.0, f32::max);
    let [npy, tiff, png8, png16, json, csv] = DESIGN_FILES.map(|name| folder.join(name));
    let shape = match psf.shape() {
        [1, plane @ ..] => plane,
        all => all,
    };
    // An image of the same mask in other colours may stay.
    let earlier = formats::read_array(&npy).ok();
    let is_of_another = earlier.is_some_and(|earlier| earlier.shape() != shape || !earlier.iter().eq(psf.iter()));
    let mut array = ArrayWriter::create(&npy, shape)?;
    array.append(psf.view())?;
    let mut pages = PageWriter::create(&tiff, psf.dim())?;
    pages.append(psf.view())?;
    let mut complete = vec![
        (npy, array.complete()?),
        (tiff, pages.complete()?),
        (png8.clone(), formats::complete_png8(&png8, image.view(), 0.0, peak)?),
        (png16.clone(), formats::complete_png16(&png16, image.view(), 0.0, peak)?),
        (json.clone(), design.complete_file(&json)?),
    ];
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
        complete.push((csv.clone(), formats::complete_csv(&csv, &header, rows)?));
    }
    if let Some(colormap) = colours {
        let path = folder.join(coloured(colormap));
        complete.push((path.clone(), colormap.complete_png(image.view(), (0.0, peak), &path)?));
    }
    let files = put_in_place(complete)?;
    let colours = Colormap::ALL.map(|colormap| folder.join(coloured(colormap)));
    let stale = colours.iter().filter(|_| is_of_another).chain([&csv]);
    for path in stale.filter(|path| !files.contains(path)) {
        formats::remove_if_there(path)?;
    }
    Ok(files)
}

/// Renames files once all of them are on the disk.
pub(crate) fn put_in_place(complete: Vec<(PathBuf, CompleteFile)>) -> Result<Vec<PathBuf>, ExportError> {
    let place = |(path, file): (PathBuf, CompleteFile)| file.put_in_place().map(|()| path).map_err(ExportError::from);
    complete.into_iter().map(place).collect()
}

/// Named columns of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Names of the columns, with units.
    pub header: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<f64>>,
    /// Names of the rows, for the first column; none where rows have no names.
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
