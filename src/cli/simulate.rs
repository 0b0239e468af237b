//! `simulate`: stacks of objects and of their simulated measurements.

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::choices::{about_objects, check_count, check_folder, names_of};
use super::design_args::{DesignArgs, SceneArgs, check_no_other};
use super::failure::Failure;
use super::optimize_runs::RECORD;
use super::output;
use super::output::ProgressLine;
use super::tamura::Summary;
use crate::forward::{ForwardModel, notices_of};
use crate::workbench::{DESIGN_FILE, DESIGN_FILES, MEASUREMENT_STACKS, MeasurementFormat, measure_into};

/// Largest number of objects: 370 GB at 96 x 96 px, 32-bit floats.
const MOST_OBJECTS: usize = 10_000_000;

/// Arguments of `simulate`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Number of objects.
    #[arg(long, default_value_t = 64)]
    count: usize,

    /// Folder to write into; created if missing.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,

    /// Write TIFF (32-bit float) instead of NPY.
    #[arg(long)]
    tiff: bool,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// The simulation as JSON.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Measured {
    /// The objects, by the text of their source.
    objects: String,
    /// Fingerprint of the objects.
    objects_fingerprint: String,
    /// Description of the mask.
    encoder: String,
    /// Throughput of the mask.
    throughput: f64,
    /// Noise of the sensor.
    noise: String,
    /// Seed of objects and noise.
    seed: u64,
    /// Shape of the file of objects: (n, rows, cols), or (n, planes, rows, cols).
    object_shape: Vec<usize>,
    /// Shape of the files of measurements: (n, rows, cols).
    measurement_shape: Vec<usize>,
    /// Tamura coefficient of the measurements.
    tamura: Summary,
    /// Notices on the objects.
    notices: Vec<String>,
    /// Paths of the written files.
    files: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        check_count("--count", self.count, 1..=MOST_OBJECTS)?;
        let design = self.design.design(&self.scene)?;
        check_folder(&self.out)?;
        let format = if self.tiff { MeasurementFormat::Tiff } else { MeasurementFormat::Npy };
        let stacks = MEASUREMENT_STACKS.iter().map(|name| format.file(&self.out, name));
        let outputs: Vec<PathBuf> = stacks.chain([self.out.join(DESIGN_FILE)]).collect();
        self.design.check_inputs_stay(&outputs, &design)?;
        check_no_other(&self.out, &design, &[RECORD, DESIGN_FILES[0]])?;
        let forward = ForwardModel::open(&design).map_err(|error| about_objects(&design, error.into()))?;
        if let Some(understood) = forward.set.understood() {
            output::report(format_args!("{}: {understood}", design.objects));
        }
        let progress_line = ProgressLine::new();
        let stacks = measure_into(&self.out, &design, &forward, self.count, format, &mut |done: &usize| {
            progress_line.show(*done, self.count, "Simulating");
            ControlFlow::Continue(())
        })?;
        progress_line.finish();
        let set = &forward.set;
        let result = Measured {
            objects: design.objects.to_string(),
            objects_fingerprint: set.fingerprint(),
            encoder: design.encoder.describe(),
            throughput: design.encoder.throughput(),
            noise: design.noise.to_string(),
            seed: design.seed,
            object_shape: stacks.object_shape,
            measurement_shape: stacks.measurement_shape,
            tamura: Summary::of(&stacks.tamura)?,
            notices: notices_of(&design, set)?,
            files: names_of(&stacks.files),
        };
        if self.json {
            return output::print_json(&result);
        }
        for notice in &result.notices {
            output::report(notice);
        }
        let shape: Vec<String> = result.measurement_shape.iter().map(ToString::to_string).collect();
        let mut lines = vec![
            format!("{} imaging {}: {} measurements", result.encoder, result.objects, shape.join(" x ")),
            format!("Tamura coefficient {:.4} (sd {:.4})", result.tamura.mean, result.tamura.sd),
        ];
        lines.extend(result.files);
        output::print(&lines.join("\n"))
    }
}
