//! `calibrate`: system gain, noise and nonuniformity of a camera from its frames, after EMVA 1288.

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::choices::is_same_file;
use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use crate::camera::{
    BayerPattern, CalibratedCamera, CalibrationProgress, CameraCalibration, CameraFile, ColourChannel, ColourChoice,
    FrameSeries, Grouping, Quantity, calibrate,
};
use crate::formats::check_writable;

/// Bits of a descriptor for frames whose depth is unknown.
const MOST_BITS: u32 = 16;

/// Arguments of `calibrate`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Folder of frames in the dark and at several light levels, two or more each, or a descriptor file of EMVA 1288.
    #[arg(value_name = "FRAMES")]
    frames: PathBuf,

    #[command(flatten)]
    colour: ColourArgs,

    /// Camera file (JSON) to write, with the maps of the pixels (NPY) and a drawing (SVG) beside it.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Descriptor file of EMVA 1288 to write for these frames.
    #[arg(long, value_name = "FILE")]
    descriptor: Option<PathBuf>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// The colour that is taken from frames.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct ColourArgs {
    /// Channel of colour images (red, green, blue) or plane of raw mosaics (r, g1, g2, b) [default: green of colour images].
    #[arg(long, value_name = "CHANNEL")]
    channel: Option<ColourChannel>,

    /// Pattern of raw mosaics, by the first two rows: RGGB, BGGR, GRBG or GBRG [default with r, g1, g2, b: RGGB].
    #[arg(long, value_name = "PATTERN")]
    bayer: Option<BayerPattern>,
}

impl ColourArgs {
    /// Whether a flag was given.
    pub fn is_given(self) -> bool {
        self.channel.is_some() || self.bayer.is_some()
    }

    /// The choice of the library.
    pub fn choice(self) -> ColourChoice {
        ColourChoice { channel: self.channel, bayer: self.bayer }
    }
}

/// A group of frames as it was understood.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct UnderstoodGroup {
    /// Name of the group.
    label: String,
    /// Whether its frames are dark.
    is_dark: bool,
    /// Exposure time in nanoseconds, or null.
    exposure_ns: Option<f64>,
    /// Mean photons of a pixel, or null.
    photons: Option<f64>,
    /// Paths of its files.
    files: Vec<String>,
}

/// The calibration as JSON.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Calibrated {
    #[serde(flatten)]
    camera: CameraFile,
    /// How the frames were grouped.
    grouping: Grouping,
    /// The groups of frames.
    groups: Vec<UnderstoodGroup>,
    /// Paths of the written files.
    files: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        for file in [&self.out, &self.descriptor].into_iter().flatten() {
            check_writable(file)?;
        }
        let series = FrameSeries::open(&self.frames)?;
        self.check_files(&series)?;
        series.lines().iter().for_each(output::report);
        let progress_line = ProgressLine::new();
        let mut on_progress = |progress: &CalibrationProgress| {
            progress_line.show(progress.done, progress.total, &progress.group);
            ControlFlow::Continue(())
        };
        let camera = calibrate(&series, self.colour.choice(), &mut on_progress)?;
        progress_line.finish();
        let mut files = match &self.out {
            Some(path) => camera.write(path)?,
            None => Vec::new(),
        };
        if let Some(path) = &self.descriptor {
            let shape = (camera.calibration.rows, camera.calibration.cols);
            series.write_descriptor(path, shape, series.bits.unwrap_or(MOST_BITS))?;
            files.push(path.clone());
        }
        let files = super::choices::names_of(&files);
        if !self.json {
            let mut lines = lines_of(&camera.calibration);
            lines.extend(files);
            return output::print(&lines.join("\n"));
        }
        let groups = series.groups.iter().map(|group| UnderstoodGroup {
            label: group.label.clone(),
            is_dark: group.is_dark,
            exposure_ns: group.exposure_ns,
            photons: group.photons,
            files: super::choices::names_of(&group.files),
        });
        let path = self.out.clone().unwrap_or_else(|| "camera.json".into());
        let result =
            Calibrated { camera: camera.file(&path), grouping: series.grouping, groups: groups.collect(), files };
        output::print_json(&CalibratedCamera::marked(&result))
    }

    /// Refuses outputs that would overwrite a frame or the descriptor, or coincide.
    fn check_files(&self, series: &FrameSeries) -> anyhow::Result<()> {
        let outputs: Vec<&PathBuf> = [&self.out, &self.descriptor].into_iter().flatten().collect();
        if let [one, other] = outputs[..]
            && is_same_file(one, other)
        {
            anyhow::bail!(
                "--out and --descriptor: expected two files, found {} for both; choose another name for one",
                one.display()
            );
        }
        let inputs = series.groups.iter().flat_map(|group| &group.files).chain([&series.path]);
        for input in inputs {
            if let Some(output) = outputs.iter().find(|output| is_same_file(output, input)) {
                anyhow::bail!("{}: expected a file to write, found an input; choose another name", output.display());
            }
        }
        Ok(())
    }
}

/// The calibration as a table and notes.
fn lines_of(camera: &CameraCalibration) -> Vec<String> {
    let mut lines: Vec<String> = camera.quantities().iter().map(row).collect();
    lines.extend(camera.remarks());
    lines.push("brackets hold 95 % intervals".into());
    lines
}

/// A row of the table: name, value with its unit, and interval.
fn row(quantity: &Quantity) -> String {
    let unit = quantity.value.map_or("", |_| quantity.unit);
    let (value, interval) = (quantity.value_text(), quantity.interval_text());
    format!("{:<22}{value:>12} {unit:<10}  {interval}", quantity.name).trim_end().to_owned()
}
