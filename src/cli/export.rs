//! `export`: files of a design: PSF, design, lenslets.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::choices::{check_folder, names_of};
use super::design_args::{DesignArgs, SceneArgs, check_no_other};
use super::failure::Failure;
use super::optimize_runs::RECORD;
use super::output;
use crate::workbench::{Colormap, design_outputs, export_design};

/// Arguments of `export`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Folder to write into; created if missing.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,

    /// Also write psf-COLORMAP.png with this color map.
    #[arg(long, value_enum)]
    colormap: Option<Colormap>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// The export as JSON.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Exported {
    /// Description of the mask.
    encoder: String,
    /// Throughput of the mask: the sum of the exported PSF over all planes.
    throughput: f64,
    /// Rows of the PSF, pixels.
    psf_rows: usize,
    /// Columns of the PSF, pixels.
    psf_cols: usize,
    /// Paths of the written files.
    files: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let design = self.design.design(&self.scene)?;
        check_folder(&self.out)?;
        self.design.check_inputs_stay(&design_outputs(&self.out), &design)?;
        check_no_other(&self.out, &design, &[RECORD, "measurements.npy", "measurements.tiff"])?;
        let files = export_design(&design, &self.out, self.colormap)?;
        let (psf_rows, psf_cols) = design.encoder.grid();
        let files = names_of(&files);
        let (encoder, throughput) = (design.encoder.describe(), design.encoder.throughput());
        let result = Exported { encoder, throughput, psf_rows, psf_cols, files };
        if self.json {
            return output::print_json(&result);
        }
        let mut lines = vec![format!("{}, PSF of {psf_rows} x {psf_cols} px", result.encoder)];
        lines.extend(result.files);
        output::print(&lines.join("\n"))
    }
}
