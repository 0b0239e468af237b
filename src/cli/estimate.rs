//! `estimate`: the information of a design's measurements.

use clap::{Args, ValueEnum};

use super::choices::{BudgetChoice, PatchChoice, about_objects, check_count};
use super::design_args::{DesignArgs, SceneArgs};
use super::{Failure, output};
use crate::information::{EngineChoice, Estimate, Protocol};
use crate::workbench::{DensityModel, EstimateRequest, estimate};

/// Most patches of one kind; those of 32 x 32 px then take 4 GB.
const MOST_PATCHES: usize = 1_000_000;
/// Most repetitions.
const MOST_TRIALS: usize = 10_000;

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

    /// Time for the fit of one pixelcnn trial, such as 60s, 5m or 1h; without it the protocol decides.
    #[arg(long)]
    budget: Option<BudgetChoice>,

    /// What computes the network of pixelcnn [default: cpu]: cpu, burn:ndarray, burn:wgpu or burn:cuda.
    #[arg(long)]
    engine: Option<EngineChoice>,

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
    /// The published autoregressive network fitted to patches.
    #[value(name = "pixelcnn")]
    PixelCnn,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        check_count("--patches-train", self.patches_train, 0..=MOST_PATCHES)?;
        check_count("--patches-test", self.patches_test, 1..=MOST_PATCHES)?;
        check_count("--trials", self.trials, 1..=MOST_TRIALS)?;
        let budget = self.budget.map(|choice| choice.0);
        let of_network = [
            ("--budget is the time of a fit", budget.is_some()),
            ("--engine computes the network", self.engine.is_some()),
        ];
        if !matches!(self.estimator, EstimatorChoice::PixelCnn)
            && let Some((option, _)) = of_network.iter().find(|(_, given)| *given)
        {
            return Err(anyhow::anyhow!("{option} of --estimator pixelcnn; leave it out").into());
        }
        let engine = self.engine.unwrap_or_default();
        let design = self.design.design(Some(&self.scene))?;
        let request = EstimateRequest {
            model: match self.estimator {
                EstimatorChoice::Gaussian => DensityModel::Stationary,
                EstimatorChoice::GaussianFull => DensityModel::Full,
                EstimatorChoice::GaussianAnalytic => DensityModel::Analytic,
                EstimatorChoice::PixelCnn => DensityModel::PixelCnn { budget, engine },
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
        let bar = output::progress_bar();
        let result = estimate(&design, &request, &mut |step, done, total| {
            bar.set_message(step.to_owned());
            bar.set_length(total as u64);
            bar.set_position(done as u64);
        })
        .map_err(|error| about_objects(&design, error))?;
        bar.finish_and_clear();
        if self.json {
            return output::print_json(&result);
        }
        output::print(&lines_of(&result).join("\n"))
    }
}

/// The estimate for people, line by line.
fn lines_of(result: &Estimate) -> Vec<String> {
    let [low, high] = result.interval_95;
    let [rows, cols] = result.patch;
    let engine = result.engine.map_or(String::new(), |engine| format!(" on {engine}"));
    let mut lines = vec![
        format!("{} before {}, {} noise", result.encoder, result.objects, result.noise),
        format!(
            "at most {:.4} bits per pixel  [{low:.4}, {high:.4}]  {}{engine}, {} protocol",
            result.bits_per_pixel, result.estimator, result.protocol
        ),
        format!("H(Y) {:.4}   H(Y|X) {:.4}   bits per pixel", result.entropy_y, result.entropy_y_given_x),
        match result.ceiling {
            Some(ceiling) => format!("ceiling {ceiling:.4} bits per pixel"),
            None => "ceiling unknown: the entropy of these objects is not known, so only upper bounds are".into(),
        },
        format!(
            "patch {rows} x {cols} px, {} training and {} test patches, trials {} (spread {:.4}), seed {}, {:.1} s",
            result.patches_train, result.patches_test, result.trials, result.trial_spread, result.seed, result.seconds
        ),
    ];
    lines.extend(result.notes.iter().map(|note| format!("note: {note}")));
    lines
}
