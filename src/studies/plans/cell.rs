//! One cell of a plan: its settings and its result.

use std::ffi::OsStr;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::estimates::EstimateSettings;
use super::reconstruction::ReconstructionSettings;
use super::size::SizeChoice;
use super::study_decoder::StudyDecoder;
use crate::evaluation::{DensityModel, EstimateRequest, EvaluationError, WeightsFiles};
use crate::formats::{DocumentKind, content_key, json_of, text_form};
use crate::forward::{Design, MaskError, MaskSource, OpenedMask, on_grid};
use crate::information::{EngineChoice, Estimate, Estimator, NoiseEntropy, TestPatches};
use crate::objects::ObjectSource;
use crate::optics::{Encoder, LensletArray};
use crate::reconstruction::DecoderQuality;
use crate::sensor::{Noise, PatchSize};
use crate::sparsity::TamuraSummary;
use crate::studies::error::StudyError;
use crate::studies::machine::Machine;
use crate::studies::published::PublishedSet;

/// The kind of a cell's file.
pub(super) const CELL: DocumentKind = DocumentKind::new("lenslet-studio/study-cell", "a cell of a study");
/// Letters of a cell's id.
const ID: usize = 16;
/// What an optimizer run of a cell may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// `ideal:`: places, widths and weights of round lenslets.
    Round,
    /// `ideal-elliptic:`: the same with elliptic lenslets.
    Elliptic,
    /// `ideal-equal:`: places and widths; the weights stay.
    EqualWeights,
}

impl Freedom {
    const ALL: [Self; 3] = [Self::Round, Self::Elliptic, Self::EqualWeights];

    /// Beginning of the name of a mask.
    fn prefix(self) -> &'static str {
        match self {
            Self::Round => "ideal:",
            Self::Elliptic => "ideal-elliptic:",
            Self::EqualWeights => "ideal-equal:",
        }
    }
}

/// A mask of a plan, by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(try_from = "String", into = "String")]
pub enum StudyMask {
    /// A mask as `--mask` names it.
    Given(MaskSource),
    /// `ideal:START` and its like: the design of an optimizer run (IDEAL) from this mask, for the objects and noise of the cell.
    Ideal {
        /// The start of the run.
        start: MaskSource,
        /// What it may change.
        freedom: Freedom,
    },
}

impl StudyMask {
    /// The heuristic layout of `count` lenslets, 1 to 9.
    pub fn heuristic(count: usize) -> Self {
        Self::Given(MaskSource::Heuristic(count))
    }

    /// The mask, or the start of its optimizer run.
    pub fn source(&self) -> &MaskSource {
        match self {
            Self::Given(source) | Self::Ideal { start: source, .. } => source,
        }
    }

    /// The mask of a text that need not be UTF-8.
    ///
    /// # Errors
    /// [`MaskError`] lists the names that there are.
    pub fn from_os(text: &OsStr) -> Result<Self, MaskError> {
        let designed = text.to_str().and_then(|text| {
            Freedom::ALL.into_iter().find_map(|freedom| Some((freedom, text.strip_prefix(freedom.prefix())?)))
        });
        match designed {
            Some((freedom, start)) => Ok(Self::Ideal { start: start.parse()?, freedom }),
            None => MaskSource::from_os(text).map(Self::Given),
        }
    }

    /// The same mask with an absolute path.
    #[must_use]
    pub fn absolute(&self) -> Self {
        match self {
            Self::Given(source) => Self::Given(source.absolute()),
            Self::Ideal { start, freedom } => Self::Ideal { start: start.absolute(), freedom: *freedom },
        }
    }
}

impl FromStr for StudyMask {
    type Err = MaskError;

    fn from_str(text: &str) -> Result<Self, MaskError> {
        Self::from_os(OsStr::new(text))
    }
}

text_form!(StudyMask);

impl fmt::Display for StudyMask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Given(source) => write!(f, "{source}"),
            Self::Ideal { start, freedom } => write!(f, "{}{start}", freedom.prefix()),
        }
    }
}

/// All settings that decide the numbers of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CellSettings {
    /// The mask.
    pub mask: StudyMask,
    /// The objects.
    pub objects: ObjectSource,
    /// Mean of the objects, photons per pixel.
    pub mean_photons: f64,
    /// Background, photons per pixel.
    pub bias_photons: f64,
    /// Noise of the sensor.
    pub noise: Noise,
    /// Patch of the estimate.
    pub patch: PatchSize,
    /// The estimator.
    pub estimator: Estimator,
    /// Seed of mask, objects, noise, patches and fits.
    pub seed: u64,
    /// Rows and columns of the objects.
    #[serde(default, skip_serializing_if = "SizeChoice::is_usual")]
    pub field: SizeChoice,
    /// Side of the PSF grid.
    #[serde(default, skip_serializing_if = "SizeChoice::is_usual")]
    pub grid: SizeChoice,
    /// The published image set that the objects are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_as: Option<PublishedSet>,
    /// Settings of the estimate.
    pub estimates: EstimateSettings,
    /// Settings of the reconstruction, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reconstruction: Option<ReconstructionSettings>,
}

impl CellSettings {
    /// Name of the cell's file: a hash of all settings. It does not depend on the plan around the cell.
    pub fn id(&self) -> String {
        let mut key = content_key(&json_of(self));
        key.truncate(ID);
        key
    }

    /// The mask of the cell on its PSF grid, or the start of its optimizer run.
    ///
    /// # Errors
    /// [`MaskError`] where its file cannot be read, or it cannot be put on the grid.
    pub fn open_mask(&self) -> Result<OpenedMask, MaskError> {
        self.mask.source().mask(self.seed, &self.objects, self.grid.shape())
    }

    /// Name of the cell's estimate: cells that differ in their reconstruction alone have the same one.
    pub(super) fn estimate_id(&self) -> String {
        Self { reconstruction: None, ..self.clone() }.id()
    }

    /// The decoder of the cell.
    pub fn decoder(&self) -> StudyDecoder {
        self.reconstruction.map(|settings| settings.decoder).into()
    }

    /// Whether the decoder of the cell, if any, fits its objects.
    pub(super) fn decoder_fits(&self) -> bool {
        self.reconstruction.is_none_or(|settings| settings.fits(&self.objects))
    }

    /// The design of the cell, with the mask that `encoder` gives.
    pub fn design(&self, encoder: Encoder) -> Design {
        let usual = Design::default();
        let design = Design {
            encoder,
            objects: self.objects.clone(),
            mean_photons: self.mean_photons,
            bias_photons: self.bias_photons,
            noise: self.noise,
            seed: self.seed,
            field: self.field.shape().unwrap_or(usual.field),
            ..usual
        };
        if self.field.is_usual() { design.with_room() } else { design }
    }

    /// The request of the cell's estimate.
    pub(super) fn request(&self) -> EstimateRequest {
        let EstimateSettings { seconds, steps, patches_train, patches_test, trials, protocol, fresh, ideal_steps: _ } =
            self.estimates;
        let budget = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        let model = DensityModel::new(self.estimator, budget, EngineChoice::default());
        EstimateRequest {
            model: steps.map_or(model, |steps| model.of_steps(steps)),
            protocol,
            patch: self.patch.shape(),
            patches_train,
            patches_test,
            fresh,
            trials,
            keep: None,
            weights: WeightsFiles::default(),
        }
    }

    /// Refuses light and noise that allow no estimate, before anything is computed.
    pub(super) fn check(&self) -> Result<(), StudyError> {
        NoiseEntropy::new(self.noise, self.estimates.protocol).map_err(EvaluationError::from)?;
        self.check_sizes()?;
        if let StudyMask::Ideal { start: MaskSource::Diffuser(_) | MaskSource::Psf(..), .. } = &self.mask {
            let expected = "a start with lenslets, such as ideal:random:25".into();
            return Err(StudyError::Plan { what: "mask".into(), expected, found: self.mask.to_string() });
        }
        self.reconstruction.map_or(Ok(()), |settings| settings.check(&self.objects))
    }

    /// Refuses a grid that is not square, and a field in which a mask on the grid has no room.
    fn check_sizes(&self) -> Result<(), StudyError> {
        let refused =
            |what: &str, expected: String, found: String| Err(StudyError::Plan { what: what.into(), expected, found });
        if let Some((rows, cols)) = self.grid.shape()
            && (rows != cols || rows > LensletArray::MAX_SIDE)
        {
            let expected = format!("a square of at most {0} x {0} px", LensletArray::MAX_SIDE);
            return refused("axis grid", expected, format!("{rows} x {cols} px"));
        }
        let usual = on_grid(Design::default().encoder, self.grid.shape());
        let design = self.design(usual.unwrap_or_else(|_| Design::default().encoder));
        design.check().map_err(EvaluationError::from)?;
        // The sizes of stacks and of masks from files are known once these are read.
        let is_known = self.mask.source().path().is_none() && !matches!(self.objects, ObjectSource::Stack(_));
        let Some((rows, cols)) = self.patch.shape().filter(|_| is_known) else { return Ok(()) };
        let (psf_rows, psf_cols) = design.encoder.grid();
        let sensor = (design.field.0 + 1 - psf_rows, design.field.1 + 1 - psf_cols);
        if rows > sensor.0 || cols > sensor.1 {
            let expected = format!("at most the sensor of {} x {} px", sensor.0, sensor.1);
            return refused("axis patch", expected, format!("{rows} x {cols} px"));
        }
        Ok(())
    }

    /// Share of the pixels that hold a bead, where the objects are beads.
    pub fn density(&self) -> Option<f64> {
        match self.objects {
            ObjectSource::Beads { density }
            | ObjectSource::BeadsMax { density }
            | ObjectSource::Volume { density, .. } => Some(density),
            _ => None,
        }
    }

    /// Objects, mask, patch, estimator and decoder for people, and what is not as published.
    pub fn name(&self) -> String {
        self.name_with(&self.objects.to_string())
    }

    /// The name with another one for the objects, as a plan has for its sets.
    pub(super) fn name_with(&self, objects: &str) -> String {
        let patch = self.patch.shape().map_or("sensor".into(), |(rows, cols)| format!("{rows} x {cols} px"));
        let usual = Design::default();
        let others = [
            (self.mean_photons != usual.mean_photons).then(|| format!("{} photons", self.mean_photons)),
            (self.bias_photons != usual.bias_photons).then(|| format!("background {}", self.bias_photons)),
            (self.noise != usual.noise).then(|| format!("{} noise", self.noise)),
            (self.seed != usual.seed).then(|| format!("seed {}", self.seed)),
            self.field.shape().map(|(rows, cols)| format!("field {rows} x {cols} px")),
            self.grid.shape().map(|(rows, cols)| format!("grid {rows} x {cols} px")),
            self.reconstruction.map(|_| format!("decoder {}", self.decoder())),
        ];
        let parts = [objects.to_owned(), self.mask.to_string(), patch, self.estimator.to_string()];
        parts.into_iter().chain(others.into_iter().flatten()).collect::<Vec<_>>().join(", ")
    }
}

/// Result of a cell: its estimate, or the sentence that says why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct CellRecord {
    /// Settings of the cell.
    pub settings: CellSettings,
    /// Version of the numbers of the program that computed the cell.
    pub program_version: String,
    /// Number of lenslets of the mask, where it has lenslets.
    pub lenslets: Option<usize>,
    /// Description of the mask.
    pub encoder: String,
    /// Fingerprint of the mask.
    pub mask_fingerprint: String,
    /// The estimate; none where it failed.
    pub estimate: Option<Estimate>,
    /// Id of the cell whose estimate this one has, where both differ in their reconstruction alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimate_of: Option<String>,
    /// Why it failed.
    pub failure: Option<String>,
    /// Sentences on how the files of mask and objects were understood, for people.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notices: Vec<String>,
    /// Tamura coefficient of noisy patches of 32 x 32 px, or of the whole sensor where that is smaller.
    pub sensor_tamura: Option<TamuraSummary>,
    /// Image quality of the plan's decoder on held-out objects, where the plan has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reconstruction: Option<DecoderQuality>,
    /// Information of each test patch by the density model, bits per pixel, and the images that it shows.
    pub test_patches: TestPatches,
    /// Time of the cell with all that surrounds its estimate, seconds.
    pub seconds: f64,
    /// Machine that computed it.
    pub machine: Machine,
}

impl CellRecord {
    /// The estimate, an upper bound: bits per pixel.
    pub fn bits_per_pixel(&self) -> Option<f64> {
        self.estimate.as_ref().map(|estimate| estimate.bits_per_pixel)
    }

    /// The lower bound, bits per pixel, where one was computed.
    pub fn lower(&self) -> Option<f64> {
        self.estimate.as_ref()?.lower()
    }
}
