//! `optimize`: optimizes a mask by the information of its measurements.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, bail};
use clap::Args;
use serde::Serialize;

use super::choices::{BudgetChoice, PublishedChoice, check_count, check_folder, mask_argument, shard_of_slurm};
use super::comparison::{failed, run_with_bar};
use super::design_args::{GridArg, SceneArgs, ThroughputArg, check_inputs_stay, files_of, open_design};
use super::failure::Failure;
use super::optimize_runs::{
    check_effects, check_place, lines_of, optimize, outputs, usual_layouts, usual_score, write,
};
use super::optimize_starts::{MultiStart, Ranking, lines_of_ranked};
use super::output;
use super::stop::{StopSignal, is_stopped};
use crate::design::{Checkpoint, Free, IdealSettings, Objective, Preset, Rates, SettingsFile};
use crate::forward::{Design, MaskSource};
use crate::information::NUMBERS_VERSION;
use crate::optics::Encoder;
use crate::plural::counted;
use crate::sensor::PatchSize;
use crate::studies::plans::Shard;
use crate::studies::{PublishedSet, Study, StudyRecord, StudySettings};
use crate::workbench::{IdealRecord, RankedStart, RunStore, Start, comparison_summary, result_lines, score_settings};

/// Arguments of `optimize`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Design file to start from, or - for standard input; flags replace its entries.
    design: Option<PathBuf>,

    /// The mask to start from: random:COUNT, heuristic:1 to 9, depth:1 to 5, fit:FILE, or design:FILE [default: random:25, or the
    /// mask of DESIGN].
    #[arg(long, value_name = "MASK", value_parser = mask_argument())]
    start: Option<MaskSource>,

    #[command(flatten)]
    grid: GridArg,

    #[command(flatten)]
    throughput: ThroughputArg,

    #[command(flatten)]
    scene: SceneArgs,

    /// Seed of the random start, of objects, noise, patches and fits [default: that of DESIGN, or 1].
    #[arg(long)]
    seed: Option<u64>,

    /// Preset of the settings. default: warm refits every few steps; paper: steps, batches, rates and patches as published, with cold
    /// fits (hours) [default: default].
    #[arg(long)]
    preset: Option<Preset>,

    /// Published image set whose rates the paper preset uses [default: the rates for beads].
    #[arg(long, value_enum, value_name = "NAME")]
    published_as: Option<PublishedChoice>,

    /// Objective. posterior: lower bound by a decoder, for beads; density: upper bound by a causal density model, for any objects;
    /// pixelcnn: upper bound by the published density model, for the paper preset [default: pixelcnn for the paper preset, otherwise
    /// posterior for beads and density for other objects].
    #[arg(long)]
    objective: Option<Objective>,

    /// Folder of the run. A run of the same settings that is there is resumed, and extended to --steps.
    #[arg(long, value_name = "DIR", required_unless_present = "print_config")]
    out: Option<PathBuf>,

    /// Steps of the mask.
    #[arg(long)]
    steps: Option<usize>,

    /// Patch of the objective in pixels: 16, 32, 16x24 (rows x cols), or sensor for whole measurements.
    #[arg(long)]
    patch: Option<PatchSize>,

    /// JSON file of settings, such as `{"refit_every": 10, "rates": {"position": 0.02}}`, or that JSON itself. The preset gives the
    /// settings that it leaves out; other flags take precedence. Of several files the later ones do.
    #[arg(long, value_name = "FILE")]
    config: Vec<String>,

    /// Print the settings of the run as JSON, which --config reads, and end.
    #[arg(long)]
    print_config: bool,

    /// Parameters that the optimizer may change: positions, widths and weights, separated by commas.
    #[arg(long, value_name = "PARAMETERS")]
    free: Option<FreeChoice>,

    /// Lenslets that stay as they are, by number from 1, separated by commas.
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    lock: Vec<std::num::NonZeroUsize>,

    /// Least distance between the centres of two lenslets, px.
    #[arg(long, value_name = "PX")]
    min_separation: Option<f64>,

    /// Number of lenslets at the end.
    #[arg(long, alias = "lenslets", value_name = "COUNT")]
    cardinality: Option<usize>,

    /// Lets spots become elliptic.
    #[arg(long)]
    anisotropic: bool,

    /// Number of runs, from random starts with the seed and those after it, in DIR/start-1 and so on. DIR gets the result with the
    /// best score.
    #[arg(long, value_name = "COUNT", default_value_t = 1)]
    starts: usize,

    /// Compute only the starts of task I of N, from 0. The task that computes the last one ranks all of them [default: those of the
    /// Slurm job array, or all].
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,

    /// Time budget of each estimate, such as 60s, in the comparison of the result with its start and the heuristic layouts. It is a
    /// study in DIR/score, in patches of 32 x 32 px and for the whole sensor; none leaves it out [default: that of the comparison that
    /// is there, or 15s].
    #[arg(long, value_name = "TIME|none")]
    score: Option<ScoreChoice>,

    /// Heuristic layouts of the comparison, by their number of lenslets [default: 1 to 9].
    #[arg(long, alias = "against", value_name = "COUNTS", value_delimiter = ',', value_parser = super::choices::layout)]
    baselines: Vec<usize>,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Time for each estimate of a comparison, where there is to be one.
#[derive(Clone, Copy, Debug)]
struct ScoreChoice(Option<BudgetChoice>);

impl FromStr for ScoreChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" { Ok(Self(None)) } else { text.parse().map(|budget| Self(Some(budget))) }
    }
}

/// Parameters that may change, by the names of the command line.
#[derive(Clone, Copy, Debug)]
struct FreeChoice(Free);

impl FromStr for FreeChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut free = Free { positions: false, widths: false, weights: false };
        for name in text.split(',') {
            match name.trim() {
                "positions" => free.positions = true,
                "widths" => free.widths = true,
                "weights" => free.weights = true,
                _ => return Err(format!("{name:?}: expected positions, widths and weights, separated by commas")),
            }
        }
        Ok(Self(free))
    }
}

/// Lenslets of the default random start.
const USUAL_LENSLETS: usize = 25;
/// Largest number of runs.
const MOST_STARTS: usize = 1000;

/// Result as JSON.
#[derive(Debug, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Outcome<'a> {
    /// Folder of the run.
    folder: String,
    /// Paths of the written files.
    files: Vec<String>,
    /// The first checkpoint.
    start: &'a Checkpoint,
    /// The last checkpoint.
    end: &'a Checkpoint,
    /// The record, as `run.json`.
    record: &'a IdealRecord,
    /// Results of several starts, the best first.
    ranked: &'a [RankedStart],
    /// Comparison of the result, by one estimator.
    score: Option<&'a StudyRecord>,
    /// Summary of the comparison, sentence by sentence.
    verdict: Vec<String>,
}

/// Results so far as JSON, while starts of other tasks have none.
#[derive(Serialize)]
struct ShareOutcome<'a> {
    folder: String,
    shard: String,
    ranked: &'a [RankedStart],
    waiting: Vec<usize>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let design = self.start()?;
        let settings = self.settings(&design)?;
        if self.print_config {
            return output::print_json(&settings);
        }
        check_count("--starts", self.starts, 1..=MOST_STARTS)?;
        if matches!(self.score, Some(ScoreChoice(None))) && !self.baselines.is_empty() {
            let sentence = "--baselines is for a comparison, which --score none leaves out; give one of them";
            return Err(anyhow::anyhow!(sentence).into());
        }
        check_folder(self.out())?;
        let named = [self.design.clone(), self.start.as_ref().and_then(MaskSource::file)];
        let inputs = files_of(named, &design.objects);
        check_inputs_stay(&inputs, &outputs(self.out(), self.starts), ("--out", None))?;
        let shard = self.shard()?;
        // Records are read from other folders as well.
        let design = Design { objects: design.objects.absolute(), ..design };
        match self.compute(&design, &settings, shard) {
            Err(Failure::Input(error)) if is_stopped(&error) => {
                // The scheduler or a person asked to stop, and the state is kept.
                output::report(format_args!("{}: stopped; the same command resumes it", self.out().display()));
                Ok(())
            }
            finished => finished,
        }
    }

    /// The share of the starts that this command computes.
    fn shard(&self) -> anyhow::Result<Shard> {
        match self.shard {
            Some(_) if self.starts == 1 => {
                bail!("--shard: expected several starts to share, found one; give --starts 8")
            }
            Some(shard) => Ok(shard),
            // Tasks of an array that have runs of their own share nothing.
            None if self.starts == 1 => Ok(Shard::default()),
            None => shard_of_slurm(),
        }
    }

    /// Computes one run, or the starts of a share.
    fn compute(&self, design: &Design, settings: &IdealSettings, shard: Shard) -> Result<(), Failure> {
        let stop = StopSignal::listen();
        let kept = RunStore::in_folder(self.out())?;
        // The tasks of an array have the folder together, and each start has a lock of its own.
        let lock = if shard.count == 1 { kept.lock()? } else { None };
        check_place(&kept, self.out(), self.starts)?;
        if self.starts == 1 {
            let record = optimize(design, settings, (&kept, self.out()), &stop)?;
            return self.finish(&record, &[], &stop);
        }
        let starts = self.random_starts(design, settings, (&kept, &stop))?;
        let Ranking { record, ranked, failed, waiting } = starts.rank(shard)?;
        if failed > 0 && shard.count > 1 {
            return Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected the starts of task {shard} to finish, found that {failed} failed; the same command tries them again",
                self.out().display()
            )));
        }
        let Some(record) = record else { return self.print_share(shard, &ranked, waiting) };
        let Ok(_lock) = lock.map_or_else(|| kept.lock(), |lock| Ok(Some(lock))) else {
            output::report(format_args!("{}: another task writes the ranking", self.out().display()));
            return Ok(());
        };
        let unscored = ranked.iter().filter(|result| !result.is_scored).count();
        match self.finish(&record, &ranked, &stop) {
            // A closed pipe does not change the outcome.
            Ok(()) | Err(Failure::Closed) if failed > 0 => Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected {} to finish, found that {failed} failed",
                self.out().display(),
                counted(self.starts, "run")
            ))),
            Ok(()) | Err(Failure::Closed) if unscored > 0 => Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected a score for the whole sensor of every result, found that {unscored} of {} failed; the same \
                 command tries those again",
                self.out().display(),
                ranked.len()
            ))),
            finished => finished,
        }
    }

    /// Random starts with the seed and those after it.
    fn random_starts<'a>(
        &'a self,
        design: &Design,
        settings: &'a IdealSettings,
        (order, stop): (&'a RunStore, &'a StopSignal),
    ) -> anyhow::Result<MultiStart<'a>> {
        let count = match &self.start {
            Some(MaskSource::Random(count)) => *count,
            None if self.design.is_none() => USUAL_LENSLETS,
            _ => bail!("--starts repeats runs from random lenslets; give --start random:25"),
        };
        let starts = (0..self.starts as u64)
            .map(|number| Start::random(design, count, design.seed.wrapping_add(number)))
            .collect();
        let budget = self.score.and_then(|ScoreChoice(budget)| Some(budget?.0));
        Ok(MultiStart { starts, settings, out: self.out(), order, budget, stop })
    }

    /// Prints the results that are there while starts of other tasks have none.
    fn print_share(&self, shard: Shard, ranked: &[RankedStart], waiting: Vec<usize>) -> Result<(), Failure> {
        let folder = self.out().display().to_string();
        if self.json {
            return output::print_json(&ShareOutcome { folder, shard: shard.to_string(), ranked, waiting });
        }
        let mut lines = lines_of_ranked(ranked);
        let numbers: Vec<String> = waiting.iter().map(usize::to_string).collect();
        lines.push(format!(
            "{folder}: {} of {} have a result; without one: {}. The task that computes the last one ranks them",
            ranked.len(),
            counted(self.starts, "start"),
            numbers.join(", ")
        ));
        output::print(&lines.join("\n"))
    }

    /// Folder of the run.
    fn out(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new("."))
    }

    /// The design of the start.
    fn start(&self) -> anyhow::Result<Design> {
        let mut design = match &self.design {
            Some(path) => open_design(path)?,
            None => Design::default(),
        };
        design.seed = self.seed.unwrap_or(design.seed);
        self.scene.replace_in(&mut design);
        let usual = MaskSource::Random(USUAL_LENSLETS);
        let start = self.start.as_ref().or_else(|| self.design.is_none().then_some(&usual));
        self.grid.put_mask(&mut design, start, &self.scene)?;
        self.throughput.replace_in(&mut design);
        design.check()?;
        if !matches!(design.encoder, Encoder::Lenslets(_)) {
            bail!(
                "{} has no lenslets to move; give --start fit:FILE for lenslets that are fitted to a PSF, or random:25",
                design.encoder.describe()
            );
        }
        Ok(design)
    }

    /// The settings files as one.
    fn config(&self) -> anyhow::Result<SettingsFile> {
        let mut all = SettingsFile::default();
        for source in &self.config {
            let (name, text) = if source.trim_start().starts_with('{') {
                ("--config", source.clone())
            } else {
                let text = std::fs::read_to_string(source).with_context(|| format!("{source}: cannot be read"))?;
                (source.as_str(), text)
            };
            all = all.then(SettingsFile::parse(&text).map_err(|error| anyhow::anyhow!("{name}: {error}"))?);
        }
        Ok(all)
    }

    fn settings(&self, design: &Design) -> anyhow::Result<IdealSettings> {
        let config = self.config()?;
        let wrong = |error: String| anyhow::anyhow!("--config: {error}");
        let preset = self.preset.or(config.preset().map_err(wrong)?).unwrap_or_default();
        let objective = self.objective.or(config.objective().map_err(wrong)?);
        let objective = objective.unwrap_or_else(|| Objective::usual(preset, &design.objects));
        let mut settings = IdealSettings::new(preset, objective, design.seed);
        if let Some(choice) = self.published_as {
            if preset != Preset::Paper {
                bail!("--published-as chooses the rates of --preset paper; leave it out");
            }
            settings.rates = match choice.set() {
                Some(PublishedSet::Mnist) => Rates::PAPER_MNIST,
                Some(PublishedSet::Cifar10) => Rates::PAPER_CIFAR,
                Some(PublishedSet::Fashion) | None => Rates::PAPER,
            };
        }
        let file = config.applied_to(&settings).map_err(wrong)?;
        let locked: Vec<usize> = self.lock.iter().map(|number| number.get() - 1).collect();
        let settings = IdealSettings {
            preset,
            objective,
            steps: self.steps.unwrap_or(file.steps),
            patch: self.patch.map_or(file.patch, PatchSize::shape),
            free: self.free.map_or(file.free, |choice| choice.0),
            locked: if locked.is_empty() { file.locked.clone() } else { locked },
            min_separation_px: self.min_separation.unwrap_or(file.min_separation_px),
            cardinality: self.cardinality.or(file.cardinality),
            anisotropic: self.anisotropic || file.anisotropic,
            // Objects, noise and fits of one run have the seed of its design.
            seed: design.seed,
            ..file
        };
        if let Encoder::Lenslets(array) = &design.encoder {
            settings.check(array)?;
            check_effects(&settings, array.lenslets.len())?;
        }
        Ok(settings)
    }

    /// Writes design, PSF, curve and record, and prints a summary.
    fn finish(&self, record: &IdealRecord, ranked: &[RankedStart], stop: &StopSignal) -> Result<(), Failure> {
        let files = write(record, self.out())?;
        let (Some(start), Some(end)) = (record.checkpoints.first(), record.checkpoints.last()) else {
            return Err(anyhow::anyhow!("{}: the run has no checkpoints", self.out().display()).into());
        };
        let (score, unscored) = match self.score(record, stop) {
            Ok(score) => (score, None),
            Err(error) if is_stopped(&error) => return Err(error.into()),
            Err(error) => (None, Some(error)),
        };
        let summary = |study: &StudyRecord| [result_lines(study), comparison_summary(study)].concat();
        let verdict = score.as_ref().map(summary).unwrap_or_default();
        let printed = if self.json {
            let files = files.iter().map(|file| file.display().to_string()).collect();
            let folder = self.out().display().to_string();
            let score = score.as_ref();
            output::print_json(&Outcome { folder, files, start, end, record, ranked, score, verdict })
        } else {
            let mut lines = lines_of(record, start, end);
            lines.extend(lines_of_ranked(ranked));
            lines.extend(verdict);
            lines.push(format!("Written to {}", self.out().display()));
            output::print(&lines.join("\n"))
        };
        if let Some(study) = &score {
            failed(study, &self.out().join(SCORE))?;
        }
        match unscored {
            // The run is useful without its comparison.
            Some(error) => Err(Failure::Incomplete(error.context(format!("{}: no comparison", self.out().display())))),
            None => printed,
        }
    }

    /// Compares the result with its start and the baselines.
    fn score(&self, record: &IdealRecord, stop: &StopSignal) -> anyhow::Result<Option<StudyRecord>> {
        let all: Vec<usize> = (1..=9).collect();
        let against = if self.baselines.is_empty() { &all } else { &self.baselines };
        let settings = match self.score {
            Some(ScoreChoice(None)) => return Ok(None),
            Some(ScoreChoice(Some(BudgetChoice(budget)))) => score_settings(record, against, budget)?,
            None if !self.baselines.is_empty() => usual_score(record, against)?,
            None => {
                // A comparison that is there is continued.
                let there = RunStore::in_folder(self.out())?.compared(&record.result);
                match there.filter(|study| study.settings.designs.len() > 2) {
                    Some(there) if there.program_version != NUMBERS_VERSION => return Ok(Some(there)),
                    Some(there) => there.settings,
                    None => usual_score(record, usual_layouts(record, &all))?,
                }
            }
        };
        let mut study = open_score(settings, self.out())?;
        run_with_bar(&mut study, stop)?;
        Ok(Some(study.record().clone()))
    }
}

/// Folder of the comparison in that of the run.
const SCORE: &str = "score";

/// The comparison in the folder of the run; one of another result or with other settings is renamed.
fn open_score(settings: StudySettings, run: &Path) -> anyhow::Result<Study> {
    let folder = run.join(SCORE);
    match Study::open(settings.clone(), &folder) {
        Err(error) if error.is_about_another() => {
            let earlier = (1..u32::MAX).map(|number| run.join(format!("{SCORE}-{number}"))).find(|path| !path.exists());
            let earlier = earlier.unwrap_or_else(|| folder.clone());
            std::fs::rename(&folder, &earlier).with_context(|| format!("{}: cannot be moved", folder.display()))?;
            output::report(format_args!(
                "{}: the comparison that was there, of another result, other settings or another version, is in {} now",
                folder.display(),
                earlier.display()
            ));
            Ok(Study::open(settings, &folder)?)
        }
        opened => Ok(opened?),
    }
}

#[cfg(test)]
mod tests;
