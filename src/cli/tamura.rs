//! `tamura`: sparsity of images and stacks.

use std::path::PathBuf;

use clap::Args;
use ndarray::Axis;
use serde::Serialize;

use super::failure::Failure;
use super::output;
use crate::formats::{ImageSummary, read_stack};
use crate::plural::counted;
use crate::sparsity::{TamuraSummary, tamura_of_stack};

/// Arguments of `tamura`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// NPY, NPZ, TIFF or image files. Each image of a stack counts.
    #[arg(required = true)]
    files: Vec<PathBuf>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Mean and standard deviation of Tamura coefficients.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Summary {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation.
    pub sd: f64,
    /// Number of images.
    pub count: usize,
}

impl Summary {
    /// Summary of the coefficients of single images.
    pub fn of(values: &[f64]) -> anyhow::Result<Self> {
        let summary = TamuraSummary::of(values);
        let TamuraSummary { mean, sd, count } =
            summary.ok_or_else(|| anyhow::anyhow!("expected images, found none"))?;
        Ok(Self { mean, sd, count })
    }
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let mut values = Vec::new();
        for path in &self.files {
            let stack = read_stack(path)?;
            output::report(format_args!("{}: {}", path.display(), ImageSummary::of(&stack)));
            let stack = stack.into_array();
            for (page, image) in stack.axis_iter(Axis(0)).enumerate() {
                if let Some(((row, col), value)) = image.indexed_iter().find(|(_, value)| !value.is_finite()) {
                    return Err(anyhow::anyhow!(
                        "{}: expected finite values, found {value} in image {} at row {row}, column {col}; \
                         repair or leave out that image",
                        path.display(),
                        page + 1
                    )
                    .into());
                }
            }
            if stack.is_empty() {
                return Err(anyhow::anyhow!(
                    "{}: expected images with pixels, found none; choose another file",
                    path.display()
                )
                .into());
            }
            values.extend(tamura_of_stack(stack.view()));
        }
        let summary = Summary::of(&values)?;
        if self.json {
            return output::print_json(&summary);
        }
        let Summary { mean, sd, count } = summary;
        output::print(&format!("Tamura coefficient {mean:.6} (sd {sd:.6}) over {}", counted(count, "image")))
    }
}
