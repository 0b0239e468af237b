//! `export`: files of a design: PSF, design, lenslets.

use std::path::PathBuf;

use clap::Args;
use ndarray::Axis;
use serde::Serialize;

use super::choices::{check_folder, names_of};
use super::design_args::{DesignArgs, NotedDesign, SceneArgs, check_no_other};
use super::failure::Failure;
use super::optimize_runs::RECORD;
use super::output;
use crate::optics::modulation_transfer;
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
    /// Mean modulation transfer above frequency 0, up to half the sampling rate of the pixels.
    mean_mtf: f64,
    /// Modulation below which the photograph of the PSF has noise alone; absent where it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    mtf_noise_floor: Option<f64>,
    /// Sentences about the file of the mask.
    notices: Vec<String>,
    /// Paths of the written files.
    files: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let NotedDesign { design, notices } = self.design.noted_design(&self.scene)?;
        check_folder(&self.out)?;
        self.design.check_inputs_stay(&design_outputs(&self.out), &design)?;
        check_no_other(&self.out, &design, &[RECORD, "measurements.npy", "measurements.tiff"])?;
        let files = export_design(&design, &self.out, self.colormap)?;
        let (psf_rows, psf_cols) = design.encoder.grid();
        let files = names_of(&files);
        let (encoder, throughput) = (design.encoder.describe(), design.encoder.throughput());
        let mtf = modulation_transfer(design.psf(1)?.sum_axis(Axis(0)).view());
        let mean_mtf = mtf.mean_below_nyquist();
        let mtf_noise_floor = design.encoder.photograph().map(|quality| quality.noise_floor);
        let mtf_noise_floor = mtf_noise_floor.filter(|floor| *floor > 0.0);
        let result = Exported { encoder, throughput, psf_rows, psf_cols, mean_mtf, mtf_noise_floor, notices, files };
        if self.json {
            return output::print_json(&result);
        }
        let floor = mtf_noise_floor.map_or_else(String::new, |floor| format!(", noise alone below {floor:.3}"));
        let mut lines = vec![
            format!("{}, PSF of {psf_rows} x {psf_cols} px", result.encoder),
            format!("Mean MTF below Nyquist {mean_mtf:.3}{floor}"),
        ];
        lines.extend(result.files);
        output::print(&lines.join("\n"))
    }
}
