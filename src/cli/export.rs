//! `export`: what a design is, in files.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::choices::{check_folder, names_of};
use super::design_args::{DesignArgs, SceneArgs};
use super::{Failure, output};
use crate::workbench::{Colormap, DESIGN_FILES, export_design};

/// Arguments of `export`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Folder to write into; it is made if need be.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,

    /// Also write psf-COLOURS.png in these colours.
    #[arg(long, value_enum)]
    colormap: Option<Colormap>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Exported {
    encoder: String,
    psf_rows: usize,
    psf_cols: usize,
    files: Vec<String>,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let design = self.design.design(&self.scene)?;
        check_folder(&self.out)?;
        let coloured = self.colormap.map(|colormap| {
            let name = format!("psf-{}.png", colormap.to_string().to_lowercase());
            (colormap, self.out.join(name))
        });
        let mut outputs: Vec<PathBuf> = DESIGN_FILES.map(|name| self.out.join(name)).into();
        outputs.extend(coloured.iter().map(|(_, path)| path.clone()));
        self.design.check_inputs_stay(&outputs, &design)?;
        let mut files = export_design(&design, &self.out)?;
        if let Some((colormap, path)) = coloured {
            let image = design.psf(1)?.sum_axis(ndarray::Axis(0)).mapv(|value| value as f32);
            let peak = image.iter().copied().fold(0.0, f32::max);
            colormap.write_png(image.view(), (0.0, peak), &path)?;
            files.push(path);
        }
        let (psf_rows, psf_cols) = design.encoder.grid();
        let files = names_of(&files);
        let result = Exported { encoder: design.encoder.describe(), psf_rows, psf_cols, files };
        if self.json {
            return output::print_json(&result);
        }
        let mut lines = vec![format!("{}, PSF of {psf_rows} x {psf_cols} px", result.encoder)];
        lines.extend(result.files);
        output::print(&lines.join("\n"))
    }
}
