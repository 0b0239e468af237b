//! Errors of estimates from the images of a camera.

use std::path::PathBuf;

use thiserror::Error;

use crate::camera::CameraError;
use crate::formats::FormatError;
use crate::information::{Estimator, InformationError};
use crate::plural::counted;
use crate::sensor::SensorError;

/// Reasons why measurements have no estimate.
#[derive(Debug, Error)]
pub enum MeasuredError {
    /// A camera, dark or flat images of one plane for two planes of a mosaic.
    #[error(
        "expected one plane of the mosaics, as camera, dark and flat images belong to one, found both greens; give --channel g1 or g2"
    )]
    TwoGreens,
    /// The text names no measurements.
    #[error("measurements \"{text}\": expected a file or folder of images, or stack:FILE or images:FOLDER")]
    Source {
        /// The text.
        text: String,
    },
    /// A number of the calibration is not valid.
    #[error("the {what} of the measurements must be {expected}, found {found}; measure it from flat images")]
    Calibration {
        /// Name of the number.
        what: &'static str,
        /// The expected values.
        expected: &'static str,
        /// The value given.
        found: f64,
    },
    /// A bin that is larger than an image.
    #[error("expected 1 to {most} pixels on each side of a bin, found {found}; bin less")]
    Bin {
        /// Rows or columns of an image, the smaller number.
        most: usize,
        /// The value given.
        found: usize,
    },
    /// A crop that leaves the images.
    #[error("crop {crop}: expected a part of {rows} x {cols} px, found one beyond their edge; choose a smaller part")]
    Crop {
        /// The crop.
        crop: String,
        /// Rows of the images.
        rows: usize,
        /// Columns of the images.
        cols: usize,
    },
    /// The images are as dark as the offset.
    #[error(
        "the mean of the measurements must be above 0 photons, found {found}; check the offset against a dark image"
    )]
    Dark {
        /// The mean, photons per pixel.
        found: f64,
    },
    /// Training and test patches cannot come from different images.
    #[error(
        "{path}: expected 2 or more images, found {}; training and test patches need images of their own",
        counted(*.found, "image")
    )]
    TooFewImages {
        /// The file or folder.
        path: PathBuf,
        /// Images in it.
        found: usize,
    },
    /// A bound that needs a design.
    #[error("{estimator} needs objects that are known; choose gaussian, gaussian-full, pixelcnn or causal")]
    NeedsObjects {
        /// Name of the estimator.
        estimator: Estimator,
    },
    /// The file.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The camera file, or the colour of the images.
    #[error(transparent)]
    Camera(CameraError),
    /// The patch.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// More photons than a model takes.
    #[error("photon counts up to {limit} can be modelled, found {found}; correct the gain or bin less")]
    TooBright {
        /// The first count beyond the limit.
        found: f64,
        /// The limit.
        limit: f64,
    },
    /// The estimate.
    #[error(transparent)]
    Information(InformationError),
}

impl From<CameraError> for MeasuredError {
    fn from(error: CameraError) -> Self {
        match error {
            CameraError::File(error) => Self::File(error),
            other => Self::Camera(other),
        }
    }
}

impl From<InformationError> for MeasuredError {
    fn from(error: InformationError) -> Self {
        match error {
            InformationError::TooBright { found, limit } => Self::TooBright { found, limit },
            other => Self::Information(other),
        }
    }
}

impl MeasuredError {
    /// Whether the computation was cancelled by its callback.
    pub fn is_cancelled(&self) -> bool {
        matches!(self, Self::Information(InformationError::Cancelled))
    }

    /// Whether the error is about a file that may be there another time.
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::File(error) if error.may_pass())
    }
}
