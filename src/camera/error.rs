//! Errors of the calibration of a camera, each one sentence.

use std::path::PathBuf;

use thiserror::Error;

use crate::formats::FormatError;

/// Reasons why a camera has no calibration.
#[derive(Debug, Error)]
pub enum CameraError {
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FormatError),
    /// The series has no frames without light.
    #[error(
        "{}: expected dark frames, found none; add a sub-folder or files whose name holds \"dark\", or lines d in a descriptor",
        .path.display()
    )]
    NoDark {
        /// The folder or descriptor.
        path: PathBuf,
    },
    /// The series has no frames with light.
    #[error("{}: expected a light level or more, found none; record pairs of frames at several exposures", .path.display())]
    NoLight {
        /// The folder or descriptor.
        path: PathBuf,
    },
    /// A group has a single frame.
    #[error("{}: expected 2 or more frames of {group}, found 1; the temporal noise needs two frames of the same light", .path.display())]
    OneFrame {
        /// The only file of the group.
        path: PathBuf,
        /// Name of the group.
        group: String,
    },
    /// A frame has another size than those before it.
    #[error(
        "{}: expected {} x {} px, as {}, found {} x {} px; keep frames of one camera and one crop together",
        .path.display(), .expected.0, .expected.1, .first.display(), .found.0, .found.1
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// The first file.
        first: PathBuf,
        /// Rows and columns of the first frame.
        expected: (usize, usize),
        /// Rows and columns found.
        found: (usize, usize),
    },
    /// A frame has another number type than those before it.
    #[error("{}: expected {expected}, as {}, found {found}; one system gain holds for one bit depth", .path.display(), .first.display())]
    Depth {
        /// The file.
        path: PathBuf,
        /// The first file.
        first: PathBuf,
        /// Number type of the first frame.
        expected: String,
        /// Number type found.
        found: String,
    },
    /// A pixel is NaN or infinite.
    #[error("{}: expected finite pixels, found {value} at row {row}, column {col}; leave that frame out", .path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The value.
        value: f32,
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        col: usize,
    },
    /// Dark frames are as bright as those with light.
    #[error("{}: expected dark frames below {dimmest} DN, the dimmest light level, found {dark} DN; check which frames are dark", .path.display())]
    DarkIsBright {
        /// The folder or descriptor.
        path: PathBuf,
        /// Mean of the dark frames, DN.
        dark: f64,
        /// Mean of the dimmest light level, DN.
        dimmest: f64,
    },
    /// Negative values of dark frames wrapped around zero.
    #[error(
        "{}: expected dark frames near one value, found {percent:.1} % of them above {above} DN at a median of {median} DN: negative values \
         wrapped around zero; subtract the dark signal in signed numbers or floats, or leave it in",
        .path.display()
    )]
    DarkWrapped {
        /// The folder or descriptor.
        path: PathBuf,
        /// Share of the dark values that wrapped, per cent.
        percent: f64,
        /// Value above which they lie, DN.
        above: f64,
        /// Median of the dark values, DN.
        median: f64,
    },
    /// The temporal variance does not grow with the light.
    #[error("{}: expected a temporal variance that grows with the light, found at most {found} DN^2 at {dark} DN^2 in the dark; {advice}", .path.display())]
    NoShotNoise {
        /// The folder or descriptor.
        path: PathBuf,
        /// Largest variance with light, DN^2.
        found: String,
        /// Variance in the dark, DN^2.
        dark: String,
        /// What to do.
        advice: &'static str,
    },
    /// Frames of one group differ in brightness.
    #[error(
        "{}: expected frames of the same light in {group}, found means of {low:.1} to {high:.1} DN; put each light level into a sub-folder of its own",
        .path.display()
    )]
    Unsteady {
        /// The folder or descriptor.
        path: PathBuf,
        /// Name of the group.
        group: String,
        /// Smallest mean of a frame, DN.
        low: f64,
        /// Largest mean of a frame, DN.
        high: f64,
    },
    /// The chosen colour is not in the frames.
    #[error("{}: expected {expected}, found {found}; {advice}", .path.display())]
    Colour {
        /// The file.
        path: PathBuf,
        /// The frames that are needed.
        expected: &'static str,
        /// The frames found.
        found: &'static str,
        /// What to do.
        advice: &'static str,
    },
    /// The computation was cancelled.
    #[error("the calibration was cancelled; start it again")]
    Cancelled,
}
