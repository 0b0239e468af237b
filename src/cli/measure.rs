//! `measure`: objects and their measurements as stacks.

use std::path::PathBuf;

use clap::Args;
use ndarray::Axis;
use serde::Serialize;

use super::choices::check_folder;
use super::design_args::{DesignArgs, SceneArgs};
use super::tamura::Summary;
use super::{Failure, print_json};
use crate::sparsity::tamura_of_stack;
use crate::workbench::{MeasurementFormat, export_measurements, simulate};

/// Arguments of `measure`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Number of objects.
    #[arg(long, default_value_t = 64)]
    count: usize,

    /// Folder to write into; it is made if need be.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,

    /// Write TIFF (32-bit float) instead of NPY.
    #[arg(long)]
    tiff: bool,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Measured {
    objects: String,
    objects_fingerprint: String,
    encoder: String,
    noise: String,
    seed: u64,
    object_shape: Vec<usize>,
    measurement_shape: Vec<usize>,
    tamura: Summary,
    notices: Vec<String>,
    files: Vec<PathBuf>,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        if self.count == 0 {
            return Err(anyhow::anyhow!("--count 0: expected at least 1 object").into());
        }
        let design = self.design.design(Some(&self.scene))?;
        check_folder(&self.out)?;
        let (set, simulated) = simulate(&design, self.count)?;
        let format = if self.tiff { MeasurementFormat::Tiff } else { MeasurementFormat::Npy };
        let objects = match set.planes() {
            1 => simulated.objects.index_axis(Axis(1), 0).into_dyn(),
            _ => simulated.objects.view().into_dyn(),
        };
        let stacks = [
            ("objects", objects),
            ("noiseless", simulated.noiseless.view().into_dyn()),
            ("measurements", simulated.noisy.view().into_dyn()),
        ];
        let mut files = export_measurements(&stacks, format, &self.out)?;
        let record = self.out.join("design.json");
        design.save(&record)?;
        files.push(record);
        let tamura = Summary::of(tamura_of_stack(simulated.noisy.view()).as_slice().unwrap_or(&[]))?;
        let result = Measured {
            objects: design.objects.to_string(),
            objects_fingerprint: set.fingerprint(),
            encoder: design.encoder.describe(),
            noise: design.noise.to_string(),
            seed: design.seed,
            object_shape: stacks[0].1.shape().to_vec(),
            measurement_shape: simulated.noisy.shape().to_vec(),
            tamura,
            notices: set.notices().to_vec(),
            files,
        };
        if self.json {
            return print_json(&result);
        }
        for notice in &result.notices {
            eprintln!("{notice}");
        }
        let shape: Vec<String> = result.measurement_shape.iter().map(ToString::to_string).collect();
        println!("{} before {}: {} measurements", result.encoder, result.objects, shape.join(" x "));
        println!("Tamura coefficient {:.4} (sd {:.4})", result.tamura.mean, result.tamura.sd);
        for file in &result.files {
            println!("{}", file.display());
        }
        Ok(())
    }
}
