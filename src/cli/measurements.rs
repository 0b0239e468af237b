//! Images of one camera or several in place of a design, for `estimate`.

use std::path::PathBuf;

use clap::Args;

use super::calibrate::ColourArgs;
use super::choices::measurements_argument;
use crate::evaluation::{
    Calibration, Compared, Crop, EqualLight, EstimateRequest, MeasuredConditions, MeasuredOptions, MeasuredSource,
    SystemComparison, View,
};
use crate::information::Estimate;
use crate::sensor::Noise;

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
        Ok(self.options().camera_noise()?)
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

    /// The comparison of all systems.
    pub fn comparison(&self, request: EstimateRequest, conditions: MeasuredConditions) -> SystemComparison {
        let (sources, options) = (self.measurements.clone(), self.options());
        SystemComparison { sources, options, request, conditions, is_simultaneous: self.simultaneous }
    }
}

/// Text of a comparison; `lines_of` is that of one estimate.
pub(super) fn comparison_lines(compared: &Compared, lines_of: impl Fn(&Estimate) -> Vec<String>) -> Vec<String> {
    let mut lines: Vec<String> = compared
        .systems
        .iter()
        .flat_map(|system| {
            let mut lines = lines_of(system);
            lines.push(String::new());
            lines
        })
        .collect();
    lines.extend(compared.differences.iter().map(ToString::to_string));
    lines
}
