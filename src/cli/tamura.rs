//! `tamura`: sparsity of pictures and stacks.

use std::path::PathBuf;

use clap::Args;
use ndarray::Axis;
use serde::Serialize;

use super::{Failure, output};
use crate::formats::{ImageSummary, read_stack};
use crate::plural::counted;
use crate::sparsity::{TamuraSummary, tamura_of_stack};

/// Arguments of `tamura`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// NPY, NPZ, TIFF or image files; stacks count image by image.
    #[arg(required = true)]
    files: Vec<PathBuf>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Mean and spread over pictures.
#[derive(Serialize)]
pub struct Summary {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation.
    pub sd: f64,
    /// Pictures.
    pub count: usize,
}

impl Summary {
    /// Of the coefficients of single pictures.
    pub fn of(values: &[f64]) -> anyhow::Result<Self> {
        let summary = TamuraSummary::of(values);
        let TamuraSummary { mean, sd, count } =
            summary.ok_or_else(|| anyhow::anyhow!("there is no picture to rate"))?;
        Ok(Self { mean, sd, count })
    }
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let mut values = Vec::new();
        for path in &self.files {
            let stack = read_stack(path)?;
            output::tell(format_args!("{}: {}", path.display(), ImageSummary::of(&stack)));
            let stack = stack.into_array();
            for (page, picture) in stack.axis_iter(Axis(0)).enumerate() {
                if let Some(((row, col), value)) = picture.indexed_iter().find(|(_, value)| !value.is_finite()) {
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
