//! Comparison of cameras by the information of their images.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::evaluation::measured::{MeasuredConditions, MeasuredImages};
use crate::evaluation::measured_error::MeasuredError;
use crate::evaluation::measured_open::MeasuredOptions;
use crate::evaluation::measured_source::MeasuredSource;
use crate::evaluation::progress::EstimateProgress;
use crate::evaluation::request::EstimateRequest;
use crate::formats::DocumentKind;
use crate::information::{Estimate, PairedDifference, TestPatches, interval_behind};
use crate::progress::Progress;

/// The kind of the JSON of several systems.
const COMPARISON: DocumentKind = DocumentKind::new("lenslet-studio/system-comparison", "a comparison of systems");
/// Decimals of a number of bits.
const DECIMALS: usize = 4;

/// Images of one camera or several, estimated alike.
#[derive(Clone, Debug)]
pub struct SystemComparison {
    /// Locations of the images.
    pub sources: Vec<MeasuredSource>,
    /// How all images become electrons.
    pub options: MeasuredOptions,
    /// The estimates.
    pub request: EstimateRequest,
    /// Noise, light and seed.
    pub conditions: MeasuredConditions,
    /// Whether frames of equal numbers show the same scene. Folders of equal file names count so without it.
    pub is_simultaneous: bool,
}

/// Difference of two systems.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct SystemDifference {
    /// Location of the images of the first system.
    pub of: String,
    /// Location of those of the second, which is subtracted.
    pub than: String,
    /// The difference, bits per pixel.
    pub bits_per_pixel: f64,
    /// Its 95 % interval (low, high).
    pub interval_95: [f64; 2],
    /// Whether both systems are scored on the same patches of simultaneous frames.
    pub is_paired: bool,
}

impl fmt::Display for SystemDifference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { of, than, bits_per_pixel, interval_95, is_paired } = self;
        let pairing = if *is_paired { "paired: the same patches of simultaneous frames" } else { "not paired" };
        let interval = interval_behind(*interval_95, DECIMALS);
        write!(formatter, "{of} less {than}: {bits_per_pixel:.4} bits per pixel{interval}, {pairing}")
    }
}

/// Estimates of several systems, and what the first has more than each other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Compared {
    /// The estimates, in the order of the command.
    pub systems: Vec<Estimate>,
    /// Differences of the first system and each other.
    pub differences: Vec<SystemDifference>,
    /// Mean of the images of each system, electrons or photons per (binned) pixel.
    #[serde(skip)]
    pub means: Vec<f64>,
}

/// Images of one system with its estimate.
struct System {
    source: MeasuredSource,
    names: Vec<String>,
    shape: (usize, usize, usize),
    mean: f64,
    estimate: Estimate,
    patches: TestPatches,
}

impl SystemComparison {
    /// Estimates all systems and their differences. Up to 100 images of several systems are all tested in turn.
    ///
    /// # Errors
    /// As [`MeasuredImages::open_with`] and [`MeasuredImages::estimate_patches`].
    pub fn run(&self, progress: &mut (dyn Progress<EstimateProgress> + Send)) -> Result<Compared, MeasuredError> {
        let count = self.sources.len();
        let systems = self.sources.iter().enumerate().map(|(index, source)| {
            self.system(source, &mut |step: &EstimateProgress| progress.report(&step.of_system(index, count)))
        });
        let systems = systems.collect::<Result<Vec<System>, _>>()?;
        let mut differences = Vec::new();
        if let Some((first, others)) = systems.split_first() {
            for other in others {
                differences.push(self.difference(first, other)?);
            }
        }
        let means = systems.iter().map(|system| system.mean).collect();
        Ok(Compared { systems: systems.into_iter().map(|system| system.estimate).collect(), differences, means })
    }

    fn system(
        &self,
        source: &MeasuredSource,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<System, MeasuredError> {
        let images = MeasuredImages::open_with(source, &self.options, progress)?;
        // Differences of few images need all of them.
        let (estimate, patches) = if self.sources.len() > 1 {
            images.cross_validated(&self.request, self.conditions, progress)?
        } else {
            images.estimate_patches(&self.request, self.conditions, progress)?
        };
        let name = |file: &PathBuf| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let names = source.files()?.iter().map(name).collect();
        let (shape, mean) = (images.photons().dim(), images.mean());
        Ok(System { source: source.clone(), names, shape, mean, estimate, patches })
    }

    fn difference(&self, of: &System, than: &System) -> Result<SystemDifference, MeasuredError> {
        let is_simultaneous = self.is_simultaneous || of.names.len() > 1 && of.names == than.names;
        let paired = if is_simultaneous && of.shape == than.shape {
            PairedDifference::new(&of.patches.information, &than.patches, self.conditions.seed)?
        } else {
            None
        };
        let (one, other) = (&of.estimate, &than.estimate);
        let bits_per_pixel = one.bits_per_pixel - other.bits_per_pixel;
        // Independent errors add in squares, each side by itself.
        let below = (one.bits_per_pixel - one.interval_95[0]).hypot(other.interval_95[1] - other.bits_per_pixel);
        let above = (one.interval_95[1] - one.bits_per_pixel).hypot(other.bits_per_pixel - other.interval_95[0]);
        let (of, than) = (of.source.to_string(), than.source.to_string());
        if let Some(PairedDifference { bits_per_pixel, interval_95 }) = paired {
            return Ok(SystemDifference { of, than, bits_per_pixel, interval_95, is_paired: true });
        }
        let interval_95 = [bits_per_pixel - below, bits_per_pixel + above];
        Ok(SystemDifference { of, than, bits_per_pixel, interval_95, is_paired: false })
    }
}

impl Compared {
    /// The comparison as JSON with `format` and `format_version`.
    pub fn marked(&self) -> impl Serialize {
        COMPARISON.marked(self)
    }
}
