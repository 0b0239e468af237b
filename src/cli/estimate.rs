//! `estimate`: the information of a design's measurements.

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::Args;

use super::choices::{
    BudgetChoice, EstimatorChoice, PatchChoice, about_objects, check_count, check_fresh, check_patches, is_same_file,
    measurements_argument,
};
use super::design_args::{DesignArgs, SceneArgs, check_inputs_stay};
use super::output::Meter;
use super::{Failure, output};
use crate::formats::check_writable;
use crate::forward::Design;
use crate::information::{Bracket, EngineChoice, Estimate, Estimator, Protocol, interval_behind};
use crate::workbench::{
    Calibration, DensityModel, EstimateProgress, EstimateRequest, MeasuredImages, MeasuredSource, WeightsFiles,
    estimate, has_name_of_fit, tells_of_unwritten_weights,
};

/// Most repetitions.
const MOST_TRIALS: usize = 10_000;
/// Most steps of a fit.
const MOST_STEPS: usize = 100_000_000;

/// Arguments of `estimate`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    #[command(flatten)]
    measured: MeasuredArgs,

    /// The density model.
    #[arg(long, value_enum, default_value_t = EstimatorChoice::Gaussian)]
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

    /// Time for the fits of a trial, such as 60s, 5m or 1h [default: live 60s, full 30m, bracket 5m; of pixelcnn the protocol
    /// decides].
    #[arg(long)]
    budget: Option<BudgetChoice>,

    /// Steps of a live or full fit, or of each fit of a bracket, in place of a time: equal seeds then give equal numbers.
    #[arg(long, conflicts_with = "budget")]
    steps: Option<usize>,

    /// What computes the network of pixelcnn [default: cpu]: cpu, burn:ndarray, burn:wgpu or burn:cuda.
    #[arg(long)]
    engine: Option<EngineChoice>,

    /// Begin the fits of live, full and bracket with nothing, instead of the weights that come with the program.
    #[arg(long)]
    fresh: bool,

    /// Repetitions with other seeds; the smallest estimate is reported.
    #[arg(long, default_value_t = 1)]
    trials: usize,

    /// Keep in this file what estimates by pixelcnn, live, full and bracket have come to, and beside it every 20 s how far the
    /// part has come that goes on; the same command goes on from it, and removes it in the end.
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,

    /// Score these weights of a PixelCNN, a safetensors file, as they are: nothing is fitted.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["budget", "trials", "resume", "save_weights"])]
    weights: Option<PathBuf>,

    /// Write the weights that pixelcnn was fitted to, those of the smallest trial, to this safetensors file.
    #[arg(long, value_name = "FILE")]
    save_weights: Option<PathBuf>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Measurements of a camera in place of a design's.
#[derive(Args, Debug)]
#[command(next_help_heading = "Measurements of a camera")]
struct MeasuredArgs {
    /// Images of a camera: a file (NPY, NPZ, TIFF, PNG) or a folder of them, in place of a design; FILE?axis=last tells which
    /// axis of an array counts them.
    #[arg(
        long, value_name = "PATH", value_parser = measurements_argument(),
        conflicts_with_all = ["design", "lenslets", "objects", "mean_photons", "bias"]
    )]
    measurements: Option<MeasuredSource>,

    /// Grey levels per photon: photons = (grey - offset) / gain. The noise is that of the photons.
    #[arg(long, value_name = "GREY", default_value_t = 1.0, requires = "measurements")]
    gain: f64,

    /// Grey level of no light.
    #[arg(long, value_name = "GREY", default_value_t = 0.0, requires = "measurements", allow_negative_numbers = true)]
    offset: f64,

    /// Add up the photons of squares of this many rows and columns of pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 1, requires = "measurements")]
    bin: usize,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        check_patches(self.patches_train, self.patches_test)?;
        check_count("--trials", self.trials, 1..=MOST_TRIALS)?;
        let estimator = self.estimator.estimator();
        // Those that are made for the default protocol alone.
        let ours = estimator.begins_with_weights();
        let budget = self.budget.map(|choice| choice.0);
        if budget.is_some() && estimator.usual_budget().is_none() {
            return Err(anyhow::anyhow!(
                "--budget is the time of a fit by --estimator pixelcnn, live, full or bracket; leave it out"
            )
            .into());
        }
        if self.engine.is_some() && estimator != Estimator::PixelCnn {
            return Err(anyhow::anyhow!("--engine computes the network of --estimator pixelcnn; leave it out").into());
        }
        if self.protocol == Protocol::Paper && ours {
            return Err(anyhow::anyhow!(
                "--protocol paper is that of --estimator pixelcnn and gaussian; leave it out for live, full and bracket"
            )
            .into());
        }
        if self.trials > 1 && estimator == Estimator::Bracket {
            return Err(anyhow::anyhow!("--estimator bracket is fitted once; give it a longer --budget").into());
        }
        if self.resume.is_some() && estimator.usual_budget().is_none() {
            let advice = "--resume is for fits by --estimator pixelcnn, live, full or bracket; leave it out";
            return Err(anyhow::anyhow!(advice).into());
        }
        if (self.weights.is_some() || self.save_weights.is_some()) && estimator != Estimator::PixelCnn {
            let advice = "--weights and --save-weights are for --estimator pixelcnn; leave them out";
            return Err(anyhow::anyhow!(advice).into());
        }
        check_fresh(self.fresh, estimator)?;
        if let Some(steps) = self.steps {
            check_count("--steps", steps, 1..=MOST_STEPS)?;
            if !ours {
                let advice = "--steps is the length of a fit by --estimator live, full or bracket; leave it out";
                return Err(anyhow::anyhow!(advice).into());
            }
        }
        let design = self.design.design(&self.scene)?;
        self.check_files(&design)?;
        let model = DensityModel::new(estimator, budget, self.engine.unwrap_or_default());
        let request = EstimateRequest {
            model: self.steps.map_or(model, |steps| model.of_steps(steps)),
            protocol: self.protocol,
            patch: self.patch.shape(),
            patches_train: self.patches_train,
            patches_test: self.patches_test,
            fresh: self.fresh,
            trials: self.trials,
            keep: self.resume.clone(),
            weights: WeightsFiles { from: self.weights.clone(), to: self.save_weights.clone() },
        };
        let meter = Meter::new();
        let mut watch = |progress: &EstimateProgress| {
            if let Some(understood) = &progress.understood {
                meter.tell(understood);
            }
            meter.show(progress.done, progress.total, &progress.step);
            ControlFlow::Continue(())
        };
        let result = if let Some(source) = &self.measured.measurements {
            let MeasuredArgs { gain, offset, bin, .. } = self.measured;
            let images = MeasuredImages::open(source, &Calibration { gain, offset, bin }, &mut watch)?;
            images.estimate(&request, design.noise, design.seed, &mut watch)?
        } else {
            estimate(&design, &request, &mut watch).map_err(|error| about_objects(&design, error))?
        };
        meter.finish();
        let printed =
            if self.json { output::print_json(&result) } else { output::print(&lines_of(&result).join("\n")) };
        let lost = result.notes.iter().find(|note| tells_of_unwritten_weights(note));
        match (printed, lost) {
            // Whether anybody reads the result or not; what was kept is there for the same command.
            (Ok(()) | Err(Failure::Closed), Some(lost)) => Err(Failure::Incomplete(anyhow::anyhow!("{lost}"))),
            (Ok(()), None) => {
                request.end_kept();
                Ok(())
            }
            // Whatever could not be printed is there for the same command.
            (printed, _) => printed,
        }
    }
}

impl Arguments {
    /// Refuses files of the result that cannot be written, are one, or would take the place of one that is read.
    fn check_files(&self, design: &Design) -> anyhow::Result<()> {
        for file in [&self.resume, &self.save_weights].into_iter().flatten() {
            check_writable(file)?;
        }
        if let (Some(kept), Some(weights)) = (&self.resume, &self.save_weights)
            && is_same_file(kept, weights)
        {
            anyhow::bail!(
                "--resume and --save-weights: expected two files, found {} for both; choose another name for one",
                weights.display()
            );
        }
        let mut inputs = self.design.files(design);
        if let Some(source) = &self.measured.measurements {
            inputs.extend(source.files()?);
        }
        // Such files are removed before an estimate begins and in its end.
        let named = inputs.iter().chain(&self.save_weights);
        if let Some(kept) = &self.resume
            && let Some(file) = named.into_iter().find(|file| has_name_of_fit(kept, file))
        {
            anyhow::bail!(
                "{}: expected another name than those of the states beside --resume {}; choose another one",
                file.display(),
                kept.display()
            );
        }
        for (flag, file) in [("--resume", &self.resume), ("--save-weights", &self.save_weights)] {
            check_inputs_stay(&inputs, file.as_slice(), (flag, None))?;
        }
        Ok(())
    }
}

/// Decimals of a number of bits.
const DECIMALS: usize = 4;

/// The bounds that are known and where they come from.
fn bracket_line(bracket: &Bracket, knows_prior: bool) -> String {
    let others = bracket.upper_bounds.iter().skip(1);
    let others: Vec<String> = others.map(|bound| format!("{} {:.4}", bound.from, bound.bits_per_pixel)).collect();
    let others = if others.is_empty() { String::new() } else { format!(" (others: {})", others.join(", ")) };
    let (above_95, from_above) = (interval_behind(bracket.upper_interval_95, DECIMALS), &bracket.upper_from);
    if let (Some(lower), Some(from), Some(lower_95)) = (bracket.lower, &bracket.lower_from, bracket.lower_interval_95) {
        let (least, most) = Bracket::in_order(lower, bracket.upper);
        // Where they cross, the smaller number is not the lower bound.
        let (below, above) = if lower > bracket.upper {
            (format!(" {lower:.4}"), format!(" {:.4}", bracket.upper))
        } else {
            (String::new(), String::new())
        };
        return format!(
            "between {least:.4} and {most:.4} bits per pixel: lower bound{below} from the {from}{}, \
             upper{above} from the {from_above}{above_95}{others}",
            interval_behind(lower_95, DECIMALS)
        );
    }
    let below = if knows_prior { "" } else { "; no lower bound is known" };
    format!("at most {:.4} bits per pixel{above_95}, from the {from_above}{others}{below}", bracket.upper)
}

/// The same numbers for all pixels together: where the patch is the sensor, of a whole measurement.
fn per_patch(result: &Estimate) -> String {
    let [rows, cols] = result.patch;
    let pixels = result.pixels();
    let most = result.bracket.as_ref().map_or(result.bits_per_patch, |bracket| bracket.upper * pixels);
    let patch = format!("bits in each {rows} x {cols} px patch");
    match result.lower() {
        Some(lower) => {
            let (least, most) = Bracket::in_order(lower * pixels, most);
            format!("{least:.1} to {most:.1} {patch}")
        }
        None => format!("{} {most:.1} {patch}", result.relation()),
    }
}

/// The estimate for people, line by line.
fn lines_of(result: &Estimate) -> Vec<String> {
    let [rows, cols] = result.patch;
    let smallest = result.smallest_trial.map_or(String::new(), |trial| format!(", the smallest is trial {trial}"));
    let engine = result.engine.map_or(String::new(), |engine| format!(" on {engine}"));
    let mut lines = vec![format!("{} before {}, {} noise", result.encoder, result.objects, result.noise)];
    lines.extend(result.bracket.as_ref().map(|bracket| bracket_line(bracket, result.ceiling.is_some())));
    if result.is_of_one_model() {
        lines.push(format!(
            "{} {:.4} bits per pixel{}  {}{engine}, {} protocol",
            result.relation(),
            result.bits_per_pixel,
            interval_behind(result.interval_95, DECIMALS),
            result.estimator,
            result.protocol
        ));
    }
    lines.extend([
        per_patch(result),
        format!("H(Y) {:.4}   H(Y|X) {:.4}   bits per pixel", result.entropy_y, result.entropy_y_given_x),
        match result.ceiling {
            Some(ceiling) => format!("ceiling {ceiling:.4} bits per pixel"),
            None => "ceiling unknown: the entropy of these objects is not known, so only upper bounds are".into(),
        },
        format!(
            "patch {rows} x {cols} px, {} training and {} test patches, trials {} (spread {:.4}{smallest}), seed {}, {:.1} s",
            result.patches_train, result.patches_test, result.trials, result.trial_spread, result.seed, result.seconds
        ),
    ]);
    lines.extend(result.notes.iter().map(|note| format!("note: {note}")));
    lines
}
