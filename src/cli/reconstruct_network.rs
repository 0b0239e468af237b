//! Networks of `reconstruct --decoder network` and `unet`: trained for the design, or read from files.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use serde::{Deserialize, Serialize};

use super::choices::{BudgetChoice, check_count};
use super::failure::Failure;
use super::output::{self, ProgressLine};
use super::stop::StopSignal;
use crate::formats::{DocumentKind, content_key, json_of, read_bytes, remove_if_there, write_safely};
use crate::forward::Design;
use crate::information::{EngineChoice, FitCheckpoint, FitFile, NUMBERS_VERSION};
use crate::progress::CancelToken;
use crate::reconstruction::{
    DecoderKind, DecoderScene, DecoderTraining, ImagingModel, LARGEST_WEIGHTS, TrainedDecoder, TrainingBudget,
    TrainingMasks, TrainingPoint, TrainingStep,
};

/// The kind of the file of settings.
const SETTINGS: DocumentKind = DocumentKind::new("lenslet-studio/networks", "settings of trained networks");
/// Its name.
const SETTINGS_FILE: &str = "networks.json";
/// Most networks.
const MOST_NETWORKS: usize = 100;
/// Most steps of a training.
const MOST_STEPS: usize = 100_000_000;
/// Budget where none is given, seconds.
const BUDGET_SECONDS: f64 = 60.0;
/// Parts of the budget that the progress line counts.
const PARTS: f64 = 1000.0;

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
pub struct NetworkResult {
    seed: u64,
    steps: usize,
    training_seconds: f64,
    validation_psnr_db: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    validation_linear_psnr_db: Option<f64>,
    /// No weights were better than the linear estimate, which is therefore kept.
    keeps_linear: bool,
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
        let first = given.iter().find(|(_, given)| *given);
        if let (Some((name, _)), false) = (first, decoder.needs().training) {
            anyhow::bail!(
                "{name}: expected --decoder network or unet, found {decoder}; choose one of these or leave {name} out"
            );
        }
        if self.engine.is_some() && decoder != DecoderKind::Unet {
            anyhow::bail!("--engine: expected --decoder unet, found {decoder}; leave --engine out");
        }
        if self.any_mask && decoder != DecoderKind::Network {
            anyhow::bail!("--any-mask: expected --decoder network, found {decoder}; leave --any-mask out");
        }
        let is_tested_as_it_is = self.weights.is_some() && self.budget.is_none() && self.steps.is_none();
        if let Some((name, _)) = given[2..4].iter().find(|(_, given)| *given && is_tested_as_it_is) {
            anyhow::bail!(
                "{name}: expected a training, found --weights alone, which tests one network; add --budget or --steps, or leave \
                 {name} out"
            );
        }
        check_count("--networks", self.networks, 1..=MOST_NETWORKS)?;
        self.steps.map_or(Ok(()), |steps| check_count("--steps", steps, 1..=MOST_STEPS))
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
        let start = self.weights.as_deref().map(|path| read(kind, path, scene, "--weights ")).transpose()?;
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
        let folder = out.map(|out| self.begin_folder(out, (kind, budget), (scene, design))).transpose()?;
        let mut result = Networks { networks: Vec::new(), files: Vec::new() };
        for index in 0..self.networks {
            let seed = seed.wrapping_add(index as u64);
            let file = |ending: &str| out.map(|out| out.join(format!("network-{}{ending}", index + 1)));
            let path = file(".safetensors");
            let is_kept = folder.as_ref().is_some_and(|folder| folder.is_begun);
            if let Some(path) = path.as_ref().filter(|path| is_kept && path.is_file()) {
                let network = read(kind, path, scene, "")?;
                output::report(format_args!("{}: trained before: {}", path.display(), network.summary()));
                result.files.push(path.clone());
                result.networks.push(network);
                continue;
            }
            let line = ProgressLine::new();
            line.show(0, PARTS as usize, "Preparing");
            let mut show = |step: &TrainingStep| {
                line.show((PARTS * step.done) as usize, PARTS as usize, &text_of(step, (index + 1, self.networks)));
                stop.check()
            };
            let state = file(".state").zip(folder.as_ref());
            let state = state.map(|(path, folder)| FitFile { path, key: format!("{} {seed}", folder.settings) });
            if let Some(state) = state.as_ref().filter(|_| !is_kept) {
                // That of another training, whose settings are gone.
                remove_if_there(&state.path).map_err(anyhow::Error::from)?;
            }
            let keeper = state.as_ref().map(|state| state as &dyn FitCheckpoint);
            let training = DecoderTraining { kind, budget, seed, engine: self.engine.unwrap_or_default() };
            let network = training.train(scene, &masks, start.as_ref(), keeper, &CancelToken::new(), &mut show)?;
            line.finish();
            output::report(format_args!("Network {}: {}", index + 1, network.summary()));
            if let Some(path) = path {
                let bytes = network.to_bytes().map_err(anyhow::Error::from)?;
                write_safely(&path, |file| file.write_all(&bytes)).map_err(anyhow::Error::from)?;
                result.files.push(path);
            }
            if let Some(state) = &state {
                remove_if_there(&state.path).map_err(anyhow::Error::from)?;
            }
            result.networks.push(network);
        }
        Ok(result)
    }

    /// The folder with a file of these settings, which is written where there is none.
    fn begin_folder(
        &self,
        out: &Path,
        (decoder, budget): (DecoderKind, TrainingBudget),
        (scene, design): (&DecoderScene, &Design),
    ) -> anyhow::Result<NetworkFolder> {
        let start = self.weights.as_deref().map(|path| read_bytes(path, LARGEST_WEIGHTS)).transpose()?;
        let own = [
            ("budget", json_of(&budget)),
            ("any_mask", self.any_mask.into()),
            ("engine", json_of(&self.engine.unwrap_or_default())),
            ("start", start.map(|bytes| blake3::hash(&bytes).to_hex().to_string()).into()),
        ];
        let settings = KeptSettings { settings: settings_key(decoder, (scene, design), own) };
        let file = out.join(SETTINGS_FILE);
        if !file.exists() {
            SETTINGS.write(&file, &settings)?;
            return Ok(NetworkFolder { settings: settings.settings, is_begun: false });
        }
        if SETTINGS.read::<KeptSettings>(&file)? != settings {
            anyhow::bail!(
                "{}: expected the settings of the networks that are there, found others; choose another --out",
                out.display()
            );
        }
        Ok(NetworkFolder { settings: settings.settings, is_begun: true })
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

/// A folder of networks.
struct NetworkFolder {
    /// Key of all that decides the networks.
    settings: String,
    /// Whether it had these settings before.
    is_begun: bool,
}

/// Content of the file of settings: the key of all that decides the networks.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct KeptSettings {
    settings: String,
}

/// Networks and the files that they were written to.
pub struct Networks {
    /// The networks.
    pub networks: Vec<TrainedDecoder>,
    /// One file each, where there is a folder.
    pub files: Vec<PathBuf>,
}

/// The network of a file; `flag` precedes its name in an error.
fn read(kind: DecoderKind, path: &Path, scene: &DecoderScene, flag: &str) -> anyhow::Result<TrainedDecoder> {
    let about = || format!("{flag}{}", path.display());
    let network = TrainedDecoder::from_bytes(kind, &read_bytes(path, LARGEST_WEIGHTS)?).with_context(about)?;
    network.training().check_scene(scene).with_context(about)?;
    Ok(network)
}

fn text_of(step: &TrainingStep, (number, of): (usize, usize)) -> String {
    let name = if of == 1 { "Training".to_owned() } else { format!("Training network {number} of {of}") };
    let validated = step.validation.map_or(String::new(), |point| format!("{:.2} dB, ", point.psnr_db));
    let linear = step.linear_psnr_db.map_or(String::new(), |linear| format!("linear {linear:.2} dB, "));
    format!("{name}: {validated}{linear}{:.1} steps/s", step.steps_per_second)
}
