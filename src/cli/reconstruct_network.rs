//! Networks of `reconstruct --decoder network` and `unet`: trained for the design, or read from files.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use serde::Serialize;

use super::choices::{BudgetChoice, check_count};
use super::failure::Failure;
use super::output::{self, ProgressLine};
use super::reconstruct_folder::{NetworkFolder, StateFile};
use super::stop::StopSignal;
use crate::formats::{content_key, json_of, read_bytes, remove_if_there, write_safely};
use crate::forward::Design;
use crate::information::{EngineChoice, FitCheckpoint, FitFile, InformationError, NUMBERS_VERSION};
use crate::progress::CancelToken;
use crate::reconstruction::{
    DecoderKind, DecoderScene, DecoderTraining, ImagingModel, LARGEST_WEIGHTS, ReconstructionError, TrainedDecoder,
    TrainingBudget, TrainingMasks, TrainingPoint, TrainingStep,
};

/// Most networks.
const MOST_NETWORKS: usize = 100;
/// Most steps of a training.
const MOST_STEPS: usize = 100_000_000;
/// Budget where none is given, seconds.
const BUDGET_SECONDS: f64 = 60.0;

/// Arguments of trained networks.
#[derive(Args, Debug)]
#[command(next_help_heading = "Trained network")]
pub struct NetworkArgs {
    /// Time of training of each network [default: 60s].
    #[arg(long, value_name = "TIME", conflicts_with_all = ["steps", "measurement"])]
    budget: Option<BudgetChoice>,

    /// Training steps of each network, in place of a time: equal seeds give equal weights.
    #[arg(long, conflicts_with = "measurement")]
    steps: Option<usize>,

    /// Networks, each from its own seed; the result is their mean.
    #[arg(long, default_value_t = 1, conflicts_with = "measurement")]
    networks: usize,

    /// Train for any lenslet mask on this grid, and not for this mask alone.
    #[arg(long, conflicts_with = "measurement")]
    any_mask: bool,

    /// Backend for the training of unet [default: cpu]: cpu, burn:ndarray, burn:wgpu or burn:cuda.
    #[arg(long, conflicts_with = "measurement")]
    engine: Option<EngineChoice>,

    /// Weights of an earlier run. With --budget or --steps training begins there, otherwise they are tested as they are.
    #[arg(long, value_name = "FILE", conflicts_with = "measurement")]
    weights: Option<PathBuf>,
}

/// Training of one network, for the result.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct NetworkResult {
    /// Seed of the training.
    seed: u64,
    /// Steps of the training.
    steps: usize,
    /// Seconds of work of the training.
    training_seconds: f64,
    /// PSNR of the best weights on validation objects, dB.
    validation_psnr_db: f64,
    /// PSNR of the linear estimate of the same objects, dB; absent for the U-net.
    #[serde(skip_serializing_if = "Option::is_none")]
    validation_linear_psnr_db: Option<f64>,
    /// No weights were better than the linear estimate, which is therefore kept.
    keeps_linear: bool,
    /// All validations.
    curve: Vec<TrainingPoint>,
}

impl From<&TrainedDecoder> for NetworkResult {
    fn from(network: &TrainedDecoder) -> Self {
        let training = network.training();
        Self {
            seed: training.seed,
            steps: training.steps,
            training_seconds: training.seconds,
            validation_psnr_db: training.psnr_db,
            validation_linear_psnr_db: network.linear_psnr_db(),
            keeps_linear: network.is_linear(),
            curve: training.curve.clone(),
        }
    }
}

impl NetworkArgs {
    /// Refuses numbers out of range, and arguments that the decoder does not have.
    pub fn check(&self, decoder: DecoderKind) -> anyhow::Result<()> {
        let given = [
            ("--budget", self.budget.is_some()),
            ("--steps", self.steps.is_some()),
            ("--networks", self.networks != 1),
            ("--any-mask", self.any_mask),
            ("--weights", self.weights.is_some()),
        ];
        if self.any_mask && decoder != DecoderKind::Network {
            anyhow::bail!("--any-mask: expected --decoder network, found {decoder}; leave --any-mask out");
        }
        let first = given.iter().find(|(_, given)| *given);
        if let (Some((name, _)), false) = (first, decoder.needs().training) {
            anyhow::bail!(
                "{name}: expected --decoder network or unet, found {decoder}; choose one of these or leave {name} out"
            );
        }
        if self.engine.is_some() && decoder != DecoderKind::Unet {
            anyhow::bail!("--engine: expected --decoder unet, found {decoder}; leave --engine out");
        }
        if let Some((name, _)) = given[2..4].iter().find(|(_, given)| *given && self.is_of_weights_alone()) {
            anyhow::bail!(
                "{name}: expected a training, found --weights alone, which tests one network; add --budget or --steps, or leave \
                 {name} out"
            );
        }
        check_count("--networks", self.networks, 1..=MOST_NETWORKS)?;
        self.steps.map_or(Ok(()), |steps| check_count("--steps", steps, 1..=MOST_STEPS))
    }

    /// Whether weights are tested as they are, without a training.
    fn is_of_weights_alone(&self) -> bool {
        self.weights.is_some() && self.budget.is_none() && self.steps.is_none()
    }

    /// Whether networks of this decoder are trained.
    pub fn trains(&self, decoder: DecoderKind) -> bool {
        decoder.needs().training && !self.is_of_weights_alone()
    }

    /// Files that are read.
    pub fn inputs(&self) -> Vec<PathBuf> {
        self.weights.iter().cloned().collect()
    }

    /// The networks, trained or read. Trained ones are written into the folder as soon as they are, and those of the same settings there are
    /// not trained again. Its file of state resumes a training that was stopped.
    pub fn networks(
        &self,
        kind: DecoderKind,
        (scene, model): (&DecoderScene, &ImagingModel),
        design: &Design,
        (out, stop): (Option<&Path>, &StopSignal),
    ) -> Result<Networks, Failure> {
        let Design { encoder, seed, .. } = design;
        // A training begins with weights of any mask; those that are tested as they are have to serve this one.
        let served = self.is_of_weights_alone().then_some(model);
        let start = self.weights.as_deref().map(|path| read(kind, path, (scene, served), "--weights ")).transpose()?;
        let budget = match (self.budget, self.steps) {
            (_, Some(steps)) => Some(TrainingBudget::Steps(steps)),
            (Some(BudgetChoice(budget)), None) => Some(TrainingBudget::Seconds(budget.as_secs_f64())),
            (None, None) => None,
        };
        if let (Some(start), None) = (&start, budget) {
            return Ok(Networks { networks: vec![start.clone()], files: Vec::new() });
        }
        let budget = budget.unwrap_or(TrainingBudget::Seconds(BUDGET_SECONDS));
        let masks = if self.any_mask {
            TrainingMasks::any(encoder).map_err(anyhow::Error::from).context("--any-mask")?
        } else {
            TrainingMasks::One(model.clone())
        };
        let mut folder = match out {
            Some(out) => Some(NetworkFolder::find(out, self.settings(kind, budget, (scene, design))?)?),
            None => None,
        };
        let mut result = Networks { networks: Vec::new(), files: Vec::new() };
        for index in 0..self.networks {
            let seed = seed.wrapping_add(index as u64);
            let number = index + 1;
            let path = folder.as_ref().map(|folder| folder.weights(number));
            let is_kept = folder.as_ref().is_some_and(NetworkFolder::is_known);
            if let Some(path) = path.as_ref().filter(|path| is_kept && path.is_file()) {
                let network = read(kind, path, (scene, Some(model)), "")?;
                output::report(format_args!("{}: trained before: {}", path.display(), network.summary()));
                result.files.push(path.clone());
                result.networks.push(network);
                continue;
            }
            let state = folder.as_ref().map(|folder| {
                let file = FitFile { path: folder.state(number), key: format!("{} {seed}", folder.settings()) };
                StateFile { file, stop }
            });
            if let Some(state) = state.as_ref().filter(|_| !is_kept) {
                // That of another training, whose settings are gone.
                remove_if_there(&state.file.path).map_err(anyhow::Error::from)?;
            }
            let keeper = state.as_ref().map(|state| state as &dyn FitCheckpoint);
            let line = ProgressLine::of_percent();
            line.show_share(0.0, "Preparing");
            let (mut is_first, mut begun) = (true, Ok(()));
            let mut show = |step: &TrainingStep| {
                // What is refused is so before the first step, and leaves no file.
                if std::mem::take(&mut is_first) {
                    begun = folder.as_mut().map_or(Ok(()), NetworkFolder::begin);
                    if out.is_none() && index == 0 {
                        line.report("the trained weights are in no file: add --out DIR to keep them");
                    }
                }
                line.show_share(step.done, &text_of(step, (number, self.networks)));
                if begun.is_err() { ControlFlow::Break(()) } else { stop.check() }
            };
            let training = DecoderTraining { kind, budget, seed, engine: self.engine.unwrap_or_default() };
            let network = training.train(scene, &masks, start.as_ref(), keeper, &CancelToken::new(), &mut show);
            begun?;
            let network = network.map_err(|error| about_state(error, keeper))?;
            line.finish();
            output::report(format_args!("Network {number}: {}", network.summary()));
            if let Some(path) = path {
                let bytes = network.to_bytes().map_err(anyhow::Error::from)?;
                write_safely(&path, |file| file.write_all(&bytes)).map_err(anyhow::Error::from)?;
                result.files.push(path);
            }
            if let Some(state) = &state {
                remove_if_there(&state.file.path).map_err(anyhow::Error::from)?;
            }
            result.networks.push(network);
        }
        Ok(result)
    }

    /// Key of all that decides the networks.
    fn settings(
        &self,
        decoder: DecoderKind,
        budget: TrainingBudget,
        (scene, design): (&DecoderScene, &Design),
    ) -> anyhow::Result<String> {
        let start = self.weights.as_deref().map(|path| read_bytes(path, LARGEST_WEIGHTS)).transpose()?;
        let own = [
            ("budget", json_of(&budget)),
            ("any_mask", self.any_mask.into()),
            ("engine", json_of(&self.engine.unwrap_or_default())),
            ("start", start.map(|bytes| blake3::hash(&bytes).to_hex().to_string()).into()),
        ];
        Ok(settings_key(decoder, (scene, design), own))
    }
}

/// Key of all that decides the results of a decoder in a scene, with settings of its own.
pub fn settings_key<const N: usize>(
    decoder: DecoderKind,
    (scene, design): (&DecoderScene, &Design),
    own: [(&str, serde_json::Value); N],
) -> String {
    let mut settings = serde_json::json!({
        "program_version": NUMBERS_VERSION,
        "decoder": decoder.name(),
        "objects": scene.set.fingerprint(),
        "protocol": scene.protocol.to_string(),
        "light": [design.mean_photons, design.bias_photons],
        "noise": scene.noise.to_string(),
        "mask": json_of(&design.encoder),
        "seed": design.seed,
    });
    for (name, value) in own {
        settings[name] = value;
    }
    content_key(&settings)
}

/// Networks and the files that they were written to.
pub struct Networks {
    /// The networks.
    pub networks: Vec<TrainedDecoder>,
    /// One file each, where there is a folder.
    pub files: Vec<PathBuf>,
}

/// The error of a training. One of its state says what to do: a state is no file that the person chose.
fn about_state(error: ReconstructionError, keeper: Option<&dyn FitCheckpoint>) -> anyhow::Error {
    match (error, keeper.map(FitCheckpoint::place)) {
        (ReconstructionError::Information(InformationError::WeightsFile { path, reason }), Some(place))
            if path == place =>
        {
            let cause = reason.split("; ").next().unwrap_or_default();
            anyhow!("{path}: expected the state of this training ({cause}); delete it, and the training begins again")
        }
        (error, _) => error.into(),
    }
}

/// The network of a file, for a mask where there is a model; `flag` precedes its name in an error.
fn read(
    kind: DecoderKind,
    path: &Path,
    (scene, model): (&DecoderScene, Option<&ImagingModel>),
    flag: &str,
) -> anyhow::Result<TrainedDecoder> {
    let about = || format!("{flag}{}", path.display());
    let network = TrainedDecoder::from_bytes(kind, &read_bytes(path, LARGEST_WEIGHTS)?).with_context(about)?;
    network.training().check_scene(scene).with_context(about)?;
    model.map_or(Ok(()), |model| network.training().check_mask(model)).with_context(about)?;
    Ok(network)
}

fn text_of(step: &TrainingStep, (number, of): (usize, usize)) -> String {
    let name = if of == 1 { "Training".to_owned() } else { format!("Training network {number} of {of}") };
    let validated = step.validation.map_or(String::new(), |point| format!("{:.2} dB, ", point.psnr_db));
    let linear = step.linear_psnr_db.map_or(String::new(), |linear| format!("linear {linear:.2} dB, "));
    format!("{name}: step {}, {validated}{linear}{:.1} steps/s", step.steps, step.steps_per_second)
}
