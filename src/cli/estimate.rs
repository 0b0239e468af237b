//! `estimate`: information of a design's measurements, or of images of a camera.

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::Args;

use super::choices::{
    BudgetChoice, EstimatorChoice, InitArgs, about_objects, check_count, check_patches, is_same_file,
};
use super::design_args::{DesignArgs, SceneArgs, check_inputs_stay};
use super::failure::Failure;
use super::measurements::{MeasuredArgs, comparison_lines};
use super::output;
use super::output::ProgressLine;
use crate::evaluation::{DensityModel, EstimateProgress, EstimateRequest, WeightsFiles, estimate, is_checkpoint_file};
use crate::formats::check_writable;
use crate::forward::Design;
use crate::information::{Bracket, EngineChoice, Estimate, Estimator, Protocol, interval_behind};
use crate::sensor::PatchSize;

/// Largest number of trials.
const MOST_TRIALS: usize = 10_000;
/// Largest number of steps of a fit.
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

    /// Density model.
    #[arg(long, value_enum, default_value_t = EstimatorChoice::Gaussian)]
    estimator: EstimatorChoice,

    /// default: exact noise entropy, training and test patches of different images; paper: the published procedure.
    #[arg(long, default_value_t = Protocol::Default)]
    protocol: Protocol,

    /// Patch in pixels: 32, 16x24 (rows x cols), or sensor for whole measurements.
    #[arg(long, default_value = "32")]
    patch: PatchSize,

    /// Training patches.
    #[arg(long, default_value_t = 10_000)]
    patches_train: usize,

    /// Held-out test patches.
    #[arg(long, default_value_t = 1_500)]
    patches_test: usize,

    /// Time for the fits of a trial, such as 60s, 5m or 1h [default: causal 60s, bracket 5m; pixelcnn by its protocol].
    #[arg(long)]
    budget: Option<BudgetChoice>,

    /// Steps of each fit of causal or bracket, in place of a time. Equal seeds then give equal numbers.
    #[arg(long, conflicts_with = "budget")]
    steps: Option<usize>,

    /// Backend for the network of pixelcnn [default: cpu]: cpu, burn:ndarray, burn:wgpu or burn:cuda.
    #[arg(long)]
    engine: Option<EngineChoice>,

    #[command(flatten)]
    init: InitArgs,

    /// Repetitions with other seeds; the smallest estimate is reported.
    #[arg(long, default_value_t = 1)]
    trials: usize,

    /// Checkpoint file of pixelcnn, causal and bracket, written every 20 s. The same command resumes from it and removes it at
    /// the end.
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,

    /// Score the PixelCNN weights of this safetensors file without fitting.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["budget", "trials", "resume", "save_weights"])]
    weights: Option<PathBuf>,

    /// Write the fitted weights of pixelcnn (smallest trial) to this safetensors file.
    #[arg(long, value_name = "FILE")]
    save_weights: Option<PathBuf>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        check_patches(self.patches_train, self.patches_test)?;
        check_count("--trials", self.trials, 1..=MOST_TRIALS)?;
        let estimator = self.estimator.estimator();
        // These support the default protocol only.
        let ours = estimator.has_pretrained_weights();
        let budget = self.budget.map(|choice| choice.0);
        if budget.is_some() && estimator.default_budget().is_none() {
            return Err(anyhow::anyhow!("--budget is for --estimator pixelcnn, causal or bracket; leave it out").into());
        }
        if self.engine.is_some() && estimator != Estimator::PixelCnn {
            return Err(anyhow::anyhow!("--engine is for --estimator pixelcnn; leave it out").into());
        }
        if self.protocol == Protocol::Paper && ours {
            return Err(anyhow::anyhow!(
                "--protocol paper is for --estimator pixelcnn and gaussian; leave it out for causal and bracket"
            )
            .into());
        }
        if self.trials > 1 && estimator == Estimator::Bracket {
            return Err(anyhow::anyhow!(
                "--estimator bracket has one trial; leave --trials out and give a longer --budget"
            )
            .into());
        }
        if self.resume.is_some() && estimator.default_budget().is_none() {
            let advice = "--resume is for --estimator pixelcnn, causal or bracket; leave it out";
            return Err(anyhow::anyhow!(advice).into());
        }
        if (self.weights.is_some() || self.save_weights.is_some()) && estimator != Estimator::PixelCnn {
            let advice = "--weights and --save-weights are for --estimator pixelcnn; leave them out";
            return Err(anyhow::anyhow!(advice).into());
        }
        let fresh = self.init.is_random(estimator)?;
        if let Some(steps) = self.steps {
            check_count("--steps", steps, 1..=MOST_STEPS)?;
            if !ours {
                let advice = "--steps is for --estimator causal or bracket; leave it out";
                return Err(anyhow::anyhow!(advice).into());
            }
        }
        self.measured.check()?;
        let mut design = self.design.design(&self.scene)?;
        if let (None, Some(noise)) = (self.scene.noise, self.measured.camera_noise()?) {
            design.noise = noise;
        }
        self.check_files(&design)?;
        let model = DensityModel::new(estimator, budget, self.engine.unwrap_or_default());
        let request = EstimateRequest {
            model: self.steps.map_or(model, |steps| model.of_steps(steps)),
            protocol: self.protocol,
            patch: self.patch.shape(),
            patches_train: self.patches_train,
            patches_test: self.patches_test,
            fresh,
            trials: self.trials,
            keep: self.resume.clone(),
            weights: WeightsFiles { from: self.weights.clone(), to: self.save_weights.clone() },
        };
        let progress_line = ProgressLine::new();
        let mut on_progress = |progress: &EstimateProgress| {
            if let Some(understood) = &progress.understood {
                progress_line.report(understood);
            }
            progress_line.show(progress.done, progress.total, &progress.step);
            ControlFlow::Continue(())
        };
        let conditions = self.measured.conditions(design.noise, design.seed);
        let result = match &self.measured.measurements[..] {
            [] => estimate(&design, &request, &mut on_progress).map_err(|error| about_objects(&design, error))?,
            sources => {
                let is_single = sources.len() == 1;
                if !is_single && (self.resume.is_some() || self.weights.is_some() || self.save_weights.is_some()) {
                    let advice = "--resume, --weights and --save-weights are for one system; give --measurements once";
                    return Err(anyhow::anyhow!(advice).into());
                }
                let mut compared = self.measured.comparison(request.clone(), conditions).run(&mut on_progress)?;
                if is_single && let Some(single) = compared.systems.pop() {
                    single
                } else {
                    progress_line.finish();
                    return if self.json {
                        output::print_json(&compared.marked())
                    } else {
                        output::print(&comparison_lines(&compared, lines_of).join("\n"))
                    };
                }
            }
        };
        progress_line.finish();
        let printed =
            if self.json { output::print_json(&result) } else { output::print(&lines_of(&result).join("\n")) };
        match (printed, result.unwritten_weights) {
            // The checkpoint stays: the same command can write the weights.
            (Ok(()) | Err(Failure::Closed), Some(lost)) => Err(Failure::Incomplete(anyhow::anyhow!("{lost}"))),
            (Ok(()), None) => {
                request.end_kept();
                Ok(())
            }
            // The checkpoint stays: the same command can print the result.
            (printed, _) => printed,
        }
    }
}

impl Arguments {
    /// Refuses output files that cannot be written, coincide, or would overwrite an input.
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
        for source in &self.measured.measurements {
            inputs.extend(source.files()?);
        }
        inputs.extend(self.measured.files());
        // Checkpoint files are removed before and after an estimate.
        let named = inputs.iter().chain(&self.save_weights);
        if let Some(kept) = &self.resume
            && let Some(file) = named.into_iter().find(|file| is_checkpoint_file(kept, file))
        {
            anyhow::bail!(
                "{}: expected a name that differs from the checkpoint files of --resume {}; choose another name",
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

/// Lower and upper bound with their sources.
fn bracket_line(bracket: &Bracket, knows_prior: bool) -> String {
    let others = bracket.upper_bounds.iter().skip(1);
    let others: Vec<String> = others.map(|bound| format!("{} {:.4}", bound.from, bound.bits_per_pixel)).collect();
    let others = if others.is_empty() { String::new() } else { format!(" (others: {})", others.join(", ")) };
    let (above_95, from_above) =
        (interval_behind(bracket.upper_interval_95, DECIMALS), bracket.upper_from.in_sentence());
    if let (Some(lower), Some(from), Some(lower_95)) = (bracket.lower, &bracket.lower_from, bracket.lower_interval_95) {
        let (least, most) = Bracket::in_order(lower, bracket.upper);
        // Where the bounds cross, both are printed with their names.
        let (below, above) = if lower > bracket.upper {
            (format!(" {lower:.4}"), format!(" {:.4}", bracket.upper))
        } else {
            (String::new(), String::new())
        };
        return format!(
            "between {least:.4} and {most:.4} bits per pixel: lower bound{below} by {}{}, \
             upper{above} by {from_above}{above_95}{others}",
            from.in_sentence(),
            interval_behind(lower_95, DECIMALS)
        );
    }
    let below = if knows_prior { "" } else { "; no lower bound is known" };
    format!("at most {:.4} bits per pixel{above_95}, by {from_above}{others}{below}", bracket.upper)
}

/// The same numbers in bits per patch; the patch may be the whole sensor.
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

/// Text of the estimate, line by line.
fn lines_of(result: &Estimate) -> Vec<String> {
    let [rows, cols] = result.patch;
    let smallest = result.smallest_trial.map_or(String::new(), |trial| format!(", the smallest is trial {trial}"));
    let engine = result.engine.map_or(String::new(), |engine| format!(" on {engine}"));
    let mut lines = vec![format!("{} imaging {}, {} noise", result.encoder, result.objects, result.noise)];
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
            Some(ceiling) => format!("object-entropy bound {ceiling:.4} bits per pixel"),
            None => "no object-entropy bound: the entropy of these objects is unknown".into(),
        },
        format!(
            "patch {rows} x {cols} px, {} training and {} test patches, trials {} (spread {:.4}{smallest}), seed {}, {:.1} s",
            result.patches_train, result.patches_test, result.trials, result.trial_spread, result.seed, result.seconds
        ),
    ]);
    lines.extend(result.notes.iter().map(|note| format!("note: {note}")));
    lines
}
