//! Images of one camera or several in place of a design, for `estimate`.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::calibrate::ColourArgs;
use super::choices::measurements_argument;
use crate::camera::CalibratedCamera;
use crate::evaluation::{
    Calibration, Crop, EqualLight, EstimateProgress, EstimateRequest, MeasuredConditions, MeasuredError,
    MeasuredImages, MeasuredOptions, MeasuredSource, View,
};
use crate::formats::DocumentKind;
use crate::information::{Estimate, PairedDifference, TestPatches, interval_behind};
use crate::progress::Progress;
use crate::sensor::Noise;

/// The kind of the JSON of several systems.
const COMPARISON: DocumentKind = DocumentKind::new("lenslet-studio/system-comparison", "a comparison of systems");
/// Decimals of a number of bits.
const DECIMALS: usize = 4;

/// Images of a camera in place of a design.
#[derive(Args, Debug)]
#[command(next_help_heading = "Measurements of a camera")]
pub(super) struct MeasuredArgs {
    /// Images of a camera in place of a design: a file (NPY, NPZ, TIFF, PNG) or a folder. FILE?axis=last names the axis of an
    /// array that counts images. Repeat it to compare systems on equal patches.
    #[arg(
        long, value_name = "PATH", value_parser = measurements_argument(),
        conflicts_with_all = ["design", "mask", "objects", "mean_photons", "bias"]
    )]
    pub measurements: Vec<MeasuredSource>,

    /// System gain, grey value (DN) per photon: photons = (DN - offset) / gain. --noise is that of the photons.
    #[arg(long, value_name = "DN", default_value_t = 1.0, requires = "measurements")]
    gain: f64,

    /// Grey value (DN) without light.
    #[arg(long, value_name = "DN", default_value_t = 0.0, requires = "measurements", allow_negative_numbers = true)]
    offset: f64,

    /// Sum photons over squares of this side.
    #[arg(long, value_name = "PIXELS", default_value_t = 1, requires = "measurements")]
    bin: usize,

    /// Camera file of calibrate: gain, dark signal, response and bad pixels. The default of --noise is then shot noise with the
    /// camera's read noise.
    #[arg(long, value_name = "FILE", requires = "measurements", conflicts_with_all = ["gain", "offset"])]
    camera: Option<PathBuf>,

    #[command(flatten)]
    colour: ColourArgs,

    /// Dark images, a file or folder: their mean is subtracted pixel by pixel.
    #[arg(long, value_name = "PATH", requires = "measurements", conflicts_with = "offset")]
    dark: Option<PathBuf>,

    /// Images of even light, a file or folder: their mean, less the dark signal, is the response of each pixel.
    #[arg(long, value_name = "PATH", requires = "measurements")]
    flat: Option<PathBuf>,

    /// Part of the images in pixels.
    #[arg(long, value_name = "ROWSxCOLS+TOP+LEFT", requires = "measurements")]
    crop: Option<Crop>,

    /// Turn the images counter-clockwise, after the crop.
    #[arg(long, value_name = "DEGREES", requires = "measurements", value_parser = ["90", "180", "270"])]
    rotate: Option<String>,

    /// Mirror the images left to right, after the turn.
    #[arg(long, requires = "measurements")]
    mirror: bool,

    /// Scale the images to this mean in photons, add a background of 10 and draw fresh noise, as published [value without a
    /// number: 500].
    #[arg(long, value_name = "PHOTONS", requires = "measurements", num_args = 0..=1, default_missing_value = "500")]
    equal_light: Option<f64>,

    /// Frames of equal numbers in all --measurements show the same scene. Folders of equal file names count so without it.
    #[arg(long, requires = "measurements")]
    simultaneous: bool,
}

/// Largest mean of equal light, photons per pixel.
const MOST_LIGHT: f64 = 1e6;

/// Difference of two systems.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct SystemDifference {
    /// Location of the images of the first system.
    of: String,
    /// Location of those of the second, which is subtracted.
    than: String,
    /// The difference, bits per pixel.
    bits_per_pixel: f64,
    /// Its 95 % interval (low, high).
    interval_95: [f64; 2],
    /// Whether both systems are scored on the same patches of simultaneous frames.
    is_paired: bool,
}

/// Estimates of several systems, and what the first has more than each other.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Compared {
    /// The estimates, in the order of the command.
    systems: Vec<Estimate>,
    /// Differences of the first system and each other.
    differences: Vec<SystemDifference>,
}

/// Images of one system with its estimate.
struct System {
    source: MeasuredSource,
    names: Vec<String>,
    shape: (usize, usize, usize),
    estimate: Estimate,
    patches: TestPatches,
}

impl MeasuredArgs {
    /// Refuses flags that need images.
    pub fn check(&self) -> anyhow::Result<()> {
        if self.measurements.is_empty() && self.colour.is_given() {
            anyhow::bail!("--channel and --bayer are for --measurements; leave them out");
        }
        if let Some(light) = self.equal_light
            && !(light > 0.0 && light <= MOST_LIGHT)
        {
            anyhow::bail!("--equal-light {light}: expected photons per pixel above 0, at most {MOST_LIGHT}");
        }
        Ok(())
    }

    /// Input files beside the images.
    pub fn files(&self) -> Vec<PathBuf> {
        [&self.camera, &self.dark, &self.flat].into_iter().flatten().cloned().collect()
    }

    /// Noise where none was stated: that of the camera file.
    pub fn camera_noise(&self) -> anyhow::Result<Option<Noise>> {
        let Some(path) = &self.camera else { return Ok(None) };
        let camera = CalibratedCamera::open(path)?.calibration;
        // Bins add the variances of their pixels.
        let sigma = camera.temporal_dark_noise_electrons * self.bin.max(1) as f64;
        Ok((sigma > 1e-3).then_some(Noise::ShotRead { sigma: (sigma * 1e4).round() / 1e4 }))
    }

    /// Noise, light and seed of the estimates.
    pub fn conditions(&self, noise: Noise, seed: u64) -> MeasuredConditions {
        let light = self.equal_light.map(|mean_photons| EqualLight { mean_photons, ..EqualLight::default() });
        MeasuredConditions { noise, light, seed }
    }

    fn options(&self) -> MeasuredOptions {
        let quarter_turns = self.rotate.as_ref().and_then(|angle| angle.parse::<u16>().ok()).unwrap_or_default() / 90;
        MeasuredOptions {
            calibration: Calibration { gain: self.gain, offset: self.offset, bin: self.bin },
            camera: self.camera.clone(),
            colour: self.colour.choice(),
            dark: self.dark.clone(),
            flat: self.flat.clone(),
            view: View { crop: self.crop, quarter_turns: quarter_turns as u8, is_mirrored: self.mirror },
        }
    }

    fn system(
        &self,
        source: &MeasuredSource,
        request: &EstimateRequest,
        conditions: MeasuredConditions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<System, MeasuredError> {
        let images = MeasuredImages::open_with(source, &self.options(), progress)?;
        // Differences of few images need all of them.
        let (estimate, patches) = if self.measurements.len() > 1 {
            images.cross_validated(request, conditions, progress)?
        } else {
            images.estimate_patches(request, conditions, progress)?
        };
        let name = |file: &PathBuf| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let names = source.files()?.iter().map(name).collect();
        Ok(System { source: source.clone(), names, shape: images.photons().dim(), estimate, patches })
    }

    /// The estimate of the only system.
    pub fn estimate(
        &self,
        source: &MeasuredSource,
        request: &EstimateRequest,
        conditions: MeasuredConditions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Estimate, MeasuredError> {
        Ok(self.system(source, request, conditions, progress)?.estimate)
    }

    /// Estimates of all systems and their differences.
    pub fn compare(
        &self,
        request: &EstimateRequest,
        conditions: MeasuredConditions,
        progress: &mut (dyn Progress<EstimateProgress> + Send),
    ) -> Result<Compared, MeasuredError> {
        let systems = self.measurements.iter().map(|source| self.system(source, request, conditions, progress));
        let systems = systems.collect::<Result<Vec<System>, _>>()?;
        let mut differences = Vec::new();
        if let Some((first, others)) = systems.split_first() {
            for other in others {
                differences.push(self.difference(first, other, conditions.seed)?);
            }
        }
        Ok(Compared { systems: systems.into_iter().map(|system| system.estimate).collect(), differences })
    }

    fn difference(&self, of: &System, than: &System, seed: u64) -> Result<SystemDifference, MeasuredError> {
        let is_simultaneous = self.simultaneous || of.names.len() > 1 && of.names == than.names;
        let paired = if is_simultaneous && of.shape == than.shape {
            PairedDifference::new(&of.patches.information, &than.patches, seed)?
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

    /// Text of the comparison; `lines_of` is that of one estimate.
    pub fn lines(&self, lines_of: impl Fn(&Estimate) -> Vec<String>) -> Vec<String> {
        let mut lines: Vec<String> = self
            .systems
            .iter()
            .flat_map(|system| {
                let mut lines = lines_of(system);
                lines.push(String::new());
                lines
            })
            .collect();
        lines.extend(self.differences.iter().map(|difference| {
            let SystemDifference { of, than, bits_per_pixel, interval_95, is_paired } = difference;
            let pairing = if *is_paired { "paired: the same patches of simultaneous frames" } else { "not paired" };
            let interval = interval_behind(*interval_95, DECIMALS);
            format!("{of} less {than}: {bits_per_pixel:.4} bits per pixel{interval}, {pairing}")
        }));
        lines
    }
}
