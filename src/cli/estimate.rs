//! `estimate`: the information of a design's measurements.

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::choices::PatchChoice;
use super::design_args::{DesignArgs, SceneArgs};
use super::{Failure, print_json};
use crate::information::Protocol;
use crate::workbench::{EstimateRequest, GaussianModel, estimate};

/// Arguments of `estimate`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// The density model.
    #[arg(long, value_enum, default_value_t)]
    estimator: EstimatorChoice,

    /// default: exact noise entropy, no base image in both training and test; paper: as published.
    #[arg(long, default_value_t = Protocol::Default)]
    protocol: Protocol,

    /// Patch in pixels: 32, 16x24 (rows x cols), or sensor for whole measurements.
    #[arg(long, default_value = "32")]
    patch: PatchChoice,

    /// Patches that the model is fitted to.
    #[arg(long, default_value_t = 10_000)]
    patches_train: usize,

    /// Held-out patches that it is scored on.
    #[arg(long, default_value_t = 1_500)]
    patches_test: usize,

    /// Repetitions with other seeds; the smallest estimate is reported.
    #[arg(long, default_value_t = 1)]
    trials: usize,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Estimators by the names of the command line.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum EstimatorChoice {
    /// Stationary Gaussian fitted to patches.
    #[default]
    Gaussian,
    /// Gaussian with the full covariance of all pixels of a patch, fitted to patches.
    GaussianFull,
    /// Gaussian of the covariance that objects and PSF have, without fitting.
    GaussianAnalytic,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let design = self.design.design(Some(&self.scene))?;
        let request = EstimateRequest {
            model: match self.estimator {
                EstimatorChoice::Gaussian => GaussianModel::Stationary,
                EstimatorChoice::GaussianFull => GaussianModel::Full,
                EstimatorChoice::GaussianAnalytic => GaussianModel::Analytic,
            },
            protocol: self.protocol,
            patch: match self.patch {
                PatchChoice::Shape(rows, cols) => Some((rows, cols)),
                PatchChoice::Sensor => None,
            },
            patches_train: self.patches_train,
            patches_test: self.patches_test,
            trials: self.trials,
        };
        let bar = ProgressBar::new(1).with_style(
            // The template is fixed and valid; a default bar is as good.
            ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {elapsed}")
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        let result = estimate(&design, &request, &mut |step, done, total| {
            bar.set_message(step.to_owned());
            bar.set_length(total as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        if self.json {
            return print_json(&result);
        }
        let [low, high] = result.interval_95;
        println!("{} before {}, {} noise", result.encoder, result.objects, result.noise);
        println!(
            "at most {:.4} bits per pixel  [{low:.4}, {high:.4}]  {}, {} protocol",
            result.bits_per_pixel, result.estimator, result.protocol
        );
        println!("H(Y) {:.4}   H(Y|X) {:.4}   bits per pixel", result.entropy_y, result.entropy_y_given_x);
        match result.ceiling {
            Some(ceiling) => println!("ceiling {ceiling:.4} bits per pixel"),
            None => println!("ceiling unknown: the entropy of these objects is not known, so only upper bounds are"),
        }
        println!(
            "patch {} x {} px, {} training and {} test patches, trials {} (spread {:.4}), seed {}, {:.1} s",
            result.patch[0],
            result.patch[1],
            result.patches_train,
            result.patches_test,
            result.trials,
            result.trial_spread,
            result.seed,
            result.seconds
        );
        for note in &result.notes {
            println!("note: {note}");
        }
        Ok(())
    }
}
