//! Errors of reconstructions, each one sentence.

use ndarray::{ArrayBase, Data, Dimension};
use thiserror::Error;

use crate::forward::ForwardError;
use crate::information::InformationError;
use crate::objects::ObjectError;
use crate::sensor::SensorError;

/// Reason why there is no reconstruction.
#[derive(Debug, Error)]
pub enum ReconstructionError {
    /// The objects, the mask, or both together.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// Statistics of the results.
    #[error(transparent)]
    Information(#[from] InformationError),
    /// Arrays that belong together differ in shape.
    #[error("{what}: expected shape {expected}, found {found}; use arrays that belong together")]
    Shape {
        /// The array.
        what: &'static str,
        /// The expected shape.
        expected: String,
        /// The shape found.
        found: String,
    },
    /// An image is too small to be compared.
    #[error("images: expected at least {least} px a side, found {rows} x {cols}; compare larger ones")]
    SmallImage {
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
        /// Least side.
        least: usize,
    },
    /// A pixel is NaN or infinite.
    #[error("{what}: expected finite values, found {value} {place}; repair or leave out that image")]
    NotFinite {
        /// The image or stack.
        what: &'static str,
        /// The value.
        value: f32,
        /// Its place.
        place: String,
    },
    /// The decoder has no form for objects with depth planes.
    #[error("{decoder}: expected objects of one plane, found {planes}; choose objects without depth")]
    Planes {
        /// The decoder.
        decoder: &'static str,
        /// Depth planes of the objects.
        planes: usize,
    },
    /// The decoder needs a set of objects.
    #[error(
        "{decoder}: expected a set of objects to learn its prior from, found a single measurement; choose tv or richardson-lucy"
    )]
    NoPrior {
        /// The decoder.
        decoder: &'static str,
    },
    /// The decoder knows beads only.
    #[error("Posterior mean: expected beads, whose prior is known, found other objects; choose linear")]
    NoBeads,
    /// The program has no weights of the trained decoder.
    #[error("Posterior mean: expected the weights of the trained decoder in the program, found none; choose linear")]
    NoWeights,
    /// The decoder needs a trained network.
    #[error("{decoder}: expected trained weights, found none; train it for the objects, or choose linear")]
    NoNetwork {
        /// The decoder.
        decoder: &'static str,
    },
    /// The U-net is trained for one mask.
    #[error("Published U-net: expected one mask to train for, found any; train it for one, or choose network")]
    OneMask,
    /// The masks that a network for any mask learns from are lenslets.
    #[error("network for any mask: expected a mask of lenslets, found {found}; train it for this mask alone")]
    NoLenslets {
        /// The mask.
        found: String,
    },
    /// The masks that a network for any mask learns from keep all light.
    #[error("network for any mask: expected a mask of throughput 1, found {throughput}; train it for this mask alone")]
    Throughput {
        /// Throughput of the mask.
        throughput: f64,
    },
    /// The network for any mask was trained on another grid, or for other masks than this one.
    #[error(
        "network for any mask: expected a mask of lenslets of throughput 1 on a grid of {} x {} px, found {found}; \
         train it for this mask alone", .expected.0, .expected.1
    )]
    BeyondTraining {
        /// Rows and columns of the grid of the training.
        expected: (usize, usize),
        /// What is not so.
        found: String,
    },
    /// There are too few images to train on and to validate with.
    #[error("{decoder}: expected at least {least} images to train on and to test with, found {found}; add images")]
    FewImages {
        /// The decoder.
        decoder: &'static str,
        /// Least number of images of the set.
        least: usize,
        /// Images of the set.
        found: usize,
    },
    /// The decoder has no training.
    #[error("{decoder}: expected a decoder that is trained, found one that is not; choose network or unet")]
    Untrained {
        /// The decoder.
        decoder: &'static str,
    },
    /// The network was trained for another mask.
    #[error("network: expected the mask that it was trained for, found another; train it for this one")]
    OtherMask,
    /// The network was trained for other objects.
    #[error(
        "network: expected the scene that it was trained for ({expected}), found another ({found}); train it for this one"
    )]
    OtherScene {
        /// The objects of the training.
        expected: String,
        /// The objects found.
        found: String,
    },
    /// The measurement is smaller than the point spread function.
    #[error(
        "measurement of {rows} x {cols} px: expected at least the {psf_rows} x {psf_cols} px of the PSF; \
         crop the PSF or bin both alike"
    )]
    SmallMeasurement {
        /// Rows of the measurement.
        rows: usize,
        /// Columns of the measurement.
        cols: usize,
        /// Rows of the PSF.
        psf_rows: usize,
        /// Columns of the PSF.
        psf_cols: usize,
    },
    /// The measurement holds no light above the background.
    #[error("measurement: expected light above the background, found none; check the dark level")]
    Dark,
    /// The arrays do not fit into memory.
    #[error(
        "field of {rows} x {cols} px: expected one that fits into memory, found {gibibytes:.1} GiB; bin the images"
    )]
    TooLarge {
        /// Rows of the field.
        rows: usize,
        /// Columns of the field.
        cols: usize,
        /// Memory that the arrays need, GiB.
        gibibytes: f64,
    },
    /// A matrix that is positive definite in exact arithmetic is not so after rounding.
    #[error(
        "linear estimate: expected a positive definite matrix, found none after rounding; lower the mean of the objects"
    )]
    NotPositiveDefinite,
    /// The progress cancelled.
    #[error("the reconstruction was cancelled")]
    Cancelled,
}

impl From<ObjectError> for ReconstructionError {
    fn from(error: ObjectError) -> Self {
        match error {
            ObjectError::Cancelled => Self::Cancelled,
            error => Self::Forward(error.into()),
        }
    }
}

impl From<SensorError> for ReconstructionError {
    fn from(error: SensorError) -> Self {
        Self::Forward(error.into())
    }
}

impl ReconstructionError {
    /// The error of a network for another scene, by the descriptions of both sets of objects.
    pub(super) fn other_scene(expected: &str, mut found: String) -> Self {
        if found == expected {
            found += " of other content, or in another light, background or noise";
        }
        Self::OtherScene { expected: expected.to_owned(), found }
    }

    /// The error of an array of another shape.
    pub(super) fn shape(what: &'static str, expected: &[usize], found: &[usize]) -> Self {
        let text = |shape: &[usize]| shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(" x ");
        Self::Shape { what, expected: text(expected), found: text(found) }
    }

    /// Refuses NaN and infinities.
    pub(super) fn check_finite<S: Data<Elem = f32>, D: Dimension>(
        what: &'static str,
        array: &ArrayBase<S, D>,
    ) -> Result<(), Self> {
        let Some(offset) = array.iter().position(|value| !value.is_finite()) else { return Ok(()) };
        let (row, col, value) = match array.shape() {
            [.., rows, cols] => (offset / cols % rows, offset % cols, array.iter().nth(offset)),
            _ => (0, offset, array.iter().nth(offset)),
        };
        let image = match array.shape() {
            [_, rows, cols] => format!("in image {} ", offset / (rows * cols) + 1),
            _ => String::new(),
        };
        let place = format!("{image}at row {row}, column {col}");
        Err(Self::NotFinite { what, value: value.copied().unwrap_or_default(), place })
    }
}
