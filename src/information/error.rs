//! Errors of entropies, models and estimates.

use thiserror::Error;

use super::engine_choice::{EngineChoice, UnknownEngine};
use crate::formats::FormatError;
use crate::nn::NetworkError;
use crate::plural::counted;

/// Reason why an entropy, a model or an estimate could not be computed. Each message states the cause and the remedy.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InformationError {
    /// There is no noise, so the information is not finite.
    #[error("information is unbounded without noise; choose shot noise, read noise or both")]
    NoNoise,
    /// The read noise is zero, negative or not finite.
    #[error("read noise must be a positive number of photons, found {sigma}; use shot noise alone when there is none")]
    ReadNoise {
        /// The standard deviation given, photons.
        sigma: f64,
    },
    /// A protocol name is unknown.
    #[error("unknown protocol \"{found}\"; write \"default\" or \"paper\"")]
    UnknownProtocol {
        /// The text given.
        found: String,
    },
    /// A photon count cannot be the mean of a noisy pixel.
    #[error("photon counts must be finite and not negative, found {found}; check the units and the bias")]
    Photons {
        /// The first bad value.
        found: f64,
    },
    /// The Gaussian approximation of shot-noise entropy diverges at zero photons.
    #[error(
        "the paper protocol approximates shot noise by a Gaussian, which needs more than 0 photons in every pixel; \
         add a bias or use the default protocol"
    )]
    DarkPixel,
    /// A value in the data is NaN or infinite.
    #[error("{what} hold a value that is not a finite number at patch {patch}; remove it before estimating")]
    NotFinite {
        /// Which data.
        what: &'static str,
        /// Index of the patch.
        patch: usize,
    },
    /// Too few patches for the model.
    #[error(
        "{model} needs at least {} of {}, found {found}; use more or smaller patches",
        counted(*needed, "patch"),
        counted(*pixels, "pixel")
    )]
    TooFewPatches {
        /// The model to be fitted or scored.
        model: &'static str,
        /// Smallest sufficient number.
        needed: usize,
        /// The number given.
        found: usize,
        /// Pixels of one patch.
        pixels: usize,
    },
    /// More patches than memory should hold.
    #[error("{count} patches of {rows} x {cols} pixels do not fit into memory; use at most {most} or smaller patches")]
    TooManyPatches {
        /// Requested number of patches.
        count: usize,
        /// Rows of a patch.
        rows: usize,
        /// Columns of a patch.
        cols: usize,
        /// The largest allowed number.
        most: usize,
    },
    /// All training values are equal.
    #[error("all training patches hold the same value {value}, so there is no density to fit; check the measurements")]
    Constant {
        /// The value found everywhere.
        value: f64,
    },
    /// Patch shapes differ between two arrays.
    #[error("{what} are {found_rows} x {found_cols} pixels, expected {rows} x {cols}; cut all patches alike")]
    PatchShape {
        /// Which data.
        what: &'static str,
        /// Rows expected.
        rows: usize,
        /// Columns expected.
        cols: usize,
        /// Rows found.
        found_rows: usize,
        /// Columns found.
        found_cols: usize,
    },
    /// The numbers of noisy and clean test patches differ.
    #[error(
        "expected a clean patch for each of {}, found {clean}; give them in the same order",
        counted(*noisy, "noisy test patch")
    )]
    PatchCount {
        /// Noisy test patches.
        noisy: usize,
        /// Clean test patches.
        clean: usize,
    },
    /// The patch has no pixels, or too many for a dense covariance.
    #[error("patches of {rows} x {cols} pixels cannot be modelled; use 1 to {limit} pixels")]
    PatchSize {
        /// Rows of the patch.
        rows: usize,
        /// Columns of the patch.
        cols: usize,
        /// Largest number of pixels.
        limit: usize,
    },
    /// A covariance is not that of any random field.
    #[error(
        "the covariance is not positive definite at patch row {row}; check the data for missing noise or repeated patches"
    )]
    NotPositiveDefinite {
        /// The first patch row whose prediction error is not positive.
        row: usize,
    },
    /// An autocovariance has the wrong shape.
    #[error("an autocovariance must be (2L+1) x (2L+1) with L at least {needed} px, found {rows} x {cols}")]
    Lags {
        /// The smallest largest lag, px.
        needed: usize,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// A point spread function or bead response has an unexpected shape.
    #[error("the {what} is {found_rows} x {found_cols} pixels, expected at most {rows} x {cols} and at least 1 x 1")]
    SpotShape {
        /// Which array.
        what: &'static str,
        /// Most rows.
        rows: usize,
        /// Most columns.
        cols: usize,
        /// Rows found.
        found_rows: usize,
        /// Columns found.
        found_cols: usize,
    },
    /// A probability lies outside (0, 1).
    #[error("the bead probability must lie between 0 and 1, found {found}")]
    Probability {
        /// The value given.
        found: f64,
    },
    /// A bead adds no photons.
    #[error(
        "a bead adds no photons to the sensor, so its measurements hold no information; check the point spread function"
    )]
    NoLight,
    /// More object pixels reach the patch than a decoder can hold.
    #[error(
        "{found} object pixels reach the patch, a decoder holds at most {limit}; use a smaller patch or fewer planes"
    )]
    TooManySites {
        /// Object pixels of all planes.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// Invalid settings of a decoder fit.
    #[error("a decoder fit needs {expected}, found {found}")]
    DecoderFit {
        /// The expected settings.
        expected: &'static str,
        /// The settings found.
        found: String,
    },
    /// No test patches or no trials.
    #[error("an interval needs at least one test patch and an estimate at least one trial")]
    Empty,
    /// Trials of different settings cannot be one estimate.
    #[error("the trials differ in {what}; an estimate combines trials of the same settings only")]
    TrialsDiffer {
        /// The setting that differs.
        what: &'static str,
    },
    /// A photon count is beyond what a network in single precision can resolve.
    #[error("photon counts up to {limit} can be modelled, found {found}; lower the light")]
    TooBright {
        /// The first value beyond the limit.
        found: f64,
        /// The limit.
        limit: f64,
    },
    /// A network has no layers, or absurdly many.
    #[error(
        "a network of {}, {} and dilations {dilations:?} cannot be built; use 1 to 512 channels and components, and 1 to \
         64 blocks of dilations up to 64",
        counted(*channels, "channel"),
        counted(*components, "component")
    )]
    NetworkShape {
        /// Requested number of channels.
        channels: usize,
        /// Requested number of components.
        components: usize,
        /// Requested dilations.
        dilations: Vec<usize>,
    },
    /// The loss of too many steps was not finite.
    #[error("the loss was not finite in {}; check the measurements for extreme values", counted(*refused, "step"))]
    Diverged {
        /// Number of skipped steps.
        refused: usize,
    },
    /// New patches could not be drawn.
    #[error("{reason}")]
    Stream {
        /// The reason.
        reason: String,
    },
    /// An engine name is unknown.
    #[error(transparent)]
    UnknownEngine(#[from] UnknownEngine),
    /// The engine was not built in.
    #[error(
        "the engine {engine} is not part of this program; choose cpu, or build with `cargo build --release --features \
         {feature}`"
    )]
    EngineNotBuilt {
        /// The requested engine.
        engine: EngineChoice,
        /// The cargo feature that brings it.
        feature: &'static str,
    },
    /// The engine has no device on this machine, or the device failed.
    #[error("the engine {engine} cannot be used: {reason}")]
    Engine {
        /// The requested engine.
        engine: EngineChoice,
        /// The cause and the remedy.
        reason: String,
    },
    /// The checkpoint belongs to another fit.
    #[error("the checkpoint belongs to another estimate; repeat the command that wrote it, or choose another file")]
    OtherFit,
    /// The computation was cancelled.
    #[error("the estimate was cancelled")]
    Cancelled,
    /// Weights that are not those of a network.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A file of weights that cannot be read or written.
    #[error("{path}: {reason}")]
    WeightsFile {
        /// The file.
        path: String,
        /// The cause and the remedy.
        reason: String,
    },
    /// A file is not an estimate, or has a newer format.
    #[error("cannot read the estimate: {reason}")]
    Format {
        /// The expected and the found contents.
        reason: String,
    },
}

impl From<FormatError> for InformationError {
    fn from(error: FormatError) -> Self {
        let (path, text) = (error.path().display().to_string(), error.to_string());
        // The text of the error begins with the file; this removes the second mention.
        let reason = text.strip_prefix(&format!("{path}: ")).unwrap_or(&text).to_owned();
        Self::WeightsFile { path, reason }
    }
}
