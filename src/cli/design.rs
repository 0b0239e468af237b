//! `design`: a mask that climbs the information of its measurements.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, bail};
use clap::Args;
use serde::Serialize;

use super::choices::{BudgetChoice, EncoderChoice, PatchChoice, check_count, check_folder, encoder_argument};
use super::design_args::{SceneArgs, check_inputs_stay, files_of, open_design};
use super::design_runs::{
    Ranking, check_effects, check_place, climb, in_words, outputs, rank, usual_layouts, usual_score, write,
};
use super::study::{PublishedChoice, failed, run_with_bar};
use super::{Failure, output};
use crate::design::{Frame, Free, IdealEvent, IdealSettings, Objective, Preset, Rates, gain_in_words};
use crate::forward::Design;
use crate::information::NUMBERS_VERSION;
use crate::optics::Encoder;
use crate::plural::counted;
use crate::studies::{PublishedSet, Study, StudyRecord, StudySettings};
use crate::workbench::{IdealRecord, KeptRun, RankedStart, Start, patches_of, score_settings, verdict, worths};

/// Arguments of `design`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Design file to start from, or - for standard input; flags replace its entries.
    design: Option<PathBuf>,

    /// The mask to start from: random:COUNT, heuristic:1 to 9, depth:1 to 5, fit:FILE, or design:FILE [default: random:25, or the
    /// mask of DESIGN].
    #[arg(long, value_name = "MASK", value_parser = encoder_argument())]
    start: Option<EncoderChoice>,

    #[command(flatten)]
    scene: SceneArgs,

    /// Seed of the random start, of objects, noise, patches and fits [default: that of DESIGN, or 1].
    #[arg(long)]
    seed: Option<u64>,

    /// default: warm refits every few steps of what the mask climbs; paper: steps, batches, rates and patches as published,
    /// with fits from the beginning (hours).
    #[arg(long, default_value_t)]
    preset: Preset,

    /// The published image set that the objects stand for: the paper preset then moves by the rates for it, otherwise by those
    /// for beads.
    #[arg(long, value_enum, value_name = "NAME")]
    published_as: Option<PublishedChoice>,

    /// What the mask climbs. posterior: what can be told of beads, by a decoder; density: a density model of the
    /// measurements, for any objects; pixelcnn: the published density model, for the paper preset [default: pixelcnn for the
    /// paper preset, otherwise posterior for beads and density for other objects].
    #[arg(long)]
    objective: Option<Objective>,

    /// Folder of the run. One that holds a part of the same run is continued.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Steps of the mask.
    #[arg(long)]
    steps: Option<usize>,

    /// Let the run in DIR go on from the mask that it had at this step, or last before it. Steps count on; one that has come to its
    /// end needs more --steps. The same command again goes on with it.
    #[arg(long, value_name = "STEP")]
    rewind: Option<usize>,

    /// Patch of the objective in pixels: 16, 32, 16x24 (rows x cols), or sensor for whole measurements.
    #[arg(long)]
    patch: Option<PatchChoice>,

    /// Other settings of the preset, by their names in the record of a run, separated by commas: objects, patches and moves of
    /// a step, refit_every (steps of a round), first_fit, refit and last_fit (steps of fits), warm (true or false), settle
    /// (share of the steps in which rates fall), rates.position, rates.variance, rates.weight, rates.relative_weight, tried (masks
    /// with a lenslet elsewhere that are tried at a time, up the posterior).
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',')]
    #[allow(clippy::doc_markdown, reason = "the command line prints it as it stands")]
    set: Vec<SettingChoice>,

    /// What may change: positions, widths and weights, separated by commas.
    #[arg(long, value_name = "PARAMETERS")]
    free: Option<FreeChoice>,

    /// Lenslets that stay as they are, by number from 1, separated by commas.
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    lock: Vec<std::num::NonZeroUsize>,

    /// Least distance between the centres of two lenslets, px.
    #[arg(long, value_name = "PX")]
    min_separation: Option<f64>,

    /// Lenslets that are to be left in the end.
    #[arg(long, value_name = "COUNT")]
    lenslets: Option<usize>,

    /// Lets spots become elliptic.
    #[arg(long)]
    anisotropic: bool,

    /// Make so many runs, from random starts with the seed and those after it, in DIR/start-1 and so on; the one whose
    /// result is worth most by an estimate of its own leaves it in DIR.
    #[arg(long, value_name = "COUNT", default_value_t = 1)]
    starts: usize,

    /// Compare the result with the start and the heuristic layouts when the run is done, in patches of 32 x 32 px and for
    /// the whole sensor, with this time for each, such as 60s: a study in DIR/score; none leaves it out [default: the comparison
    /// that is there, or 15s].
    #[arg(long, value_name = "TIME|none")]
    score: Option<ScoreChoice>,

    /// Heuristic layouts to compare with, by their number of lenslets [default: 1 to 9].
    #[arg(long, value_name = "COUNTS", value_delimiter = ',', value_parser = super::study::layout)]
    against: Vec<usize>,

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

/// A setting of the schedule and its value.
#[derive(Clone, Debug)]
struct SettingChoice {
    name: String,
    value: String,
}

impl FromStr for SettingChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((name, value)) = text.split_once('=') else {
            return Err(format!("{text:?}: expected NAME=VALUE, such as refit_every=10"));
        };
        Ok(Self { name: name.trim().to_owned(), value: value.trim().to_owned() })
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

/// Lenslets of a random start, where none was chosen.
const USUAL_LENSLETS: usize = 25;
/// Most runs of an order.
const MOST_STARTS: usize = 1000;

/// What is told at the end.
#[derive(Debug, Serialize)]
struct Outcome<'a> {
    folder: String,
    files: Vec<String>,
    start: &'a Frame,
    end: &'a Frame,
    record: &'a IdealRecord,
    /// Results of several starts, the best first.
    ranked: &'a [RankedStart],
    /// The result beside others, by one estimator for all.
    score: Option<&'a StudyRecord>,
    /// What the comparison says, sentence by sentence.
    verdict: Vec<String>,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let design = self.start()?;
        let settings = self.settings(&design)?;
        check_count("--starts", self.starts, 1..=MOST_STARTS)?;
        if matches!(self.score, Some(ScoreChoice(None))) && !self.against.is_empty() {
            let sentence =
                "--against names what a result is compared with, which --score none leaves out; give one of them";
            return Err(anyhow::anyhow!(sentence).into());
        }
        check_folder(&self.out)?;
        let named = [self.design.clone(), self.start.as_ref().and_then(EncoderChoice::file)];
        let inputs = files_of(named, &design.objects);
        check_inputs_stay(&inputs, &outputs(&self.out, self.starts), ("--out", None))?;
        // What a run leaves is read from other folders as well.
        let design = Design { objects: design.objects.absolute(), ..design };
        let kept = KeptRun::in_folder(&self.out)?;
        let _lock = kept.lock()?;
        check_place(&kept, &self.out, self.starts)?;
        if self.starts == 1 {
            let record = climb(&design, &settings, (&kept, &self.out), self.rewind)?;
            return self.finish(&record, &[]);
        }
        let Ranking { record, ranked, failed } = self.rank(&design, &settings, &kept)?;
        let unscored = ranked.iter().filter(|result| !result.is_scored).count();
        match self.finish(&record, &ranked) {
            // Whether anybody reads it or not.
            Ok(()) | Err(Failure::Closed) if failed > 0 => Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected {} to come to their end, found that {failed} failed",
                self.out.display(),
                counted(self.starts, "run")
            ))),
            Ok(()) | Err(Failure::Closed) if unscored > 0 => Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected a number for the whole sensor of every result, found that {unscored} of {} failed; the same \
                 command tries those again",
                self.out.display(),
                ranked.len()
            ))),
            finished => finished,
        }
    }

    /// Runs from several random starts.
    fn rank(&self, design: &Design, settings: &IdealSettings, order: &KeptRun) -> anyhow::Result<Ranking> {
        if self.rewind.is_some() {
            bail!(
                "--rewind is for a single run; leave it out, or let the run in one of the folders of --starts go on by itself"
            );
        }
        let count = match &self.start {
            Some(EncoderChoice::Random(count)) => *count,
            None if self.design.is_none() => USUAL_LENSLETS,
            _ => bail!("--starts repeats runs from random lenslets; give --start random:25"),
        };
        let starts: Vec<Start> = (0..self.starts as u64)
            .map(|number| Start::random(design, count, design.seed.wrapping_add(number)))
            .collect();
        let budget = self.score.and_then(|ScoreChoice(budget)| Some(budget?.0));
        rank(&starts, settings, (&self.out, order), budget)
    }

    /// The design that the run starts from.
    fn start(&self) -> anyhow::Result<Design> {
        let mut design = match &self.design {
            Some(path) => open_design(path)?,
            None => Design::default(),
        };
        design.seed = self.seed.unwrap_or(design.seed);
        self.scene.replace_in(&mut design);
        let usual = EncoderChoice::Random(USUAL_LENSLETS);
        match (&self.start, &self.design) {
            (Some(choice), _) => design.encoder = choice.encoder(design.seed)?,
            (None, None) => design.encoder = usual.encoder(design.seed)?,
            (None, Some(_)) => {}
        }
        design.check()?;
        if !matches!(design.encoder, Encoder::Lenslets(_)) {
            bail!(
                "{} has no lenslets to move; give --start fit:FILE for lenslets that are fitted to a PSF, or random:25",
                design.encoder.describe()
            );
        }
        Ok(design)
    }

    fn settings(&self, design: &Design) -> anyhow::Result<IdealSettings> {
        let objective = self.objective.unwrap_or_else(|| Objective::usual(self.preset, &design.objects));
        let mut preset = IdealSettings::new(self.preset, objective, design.seed);
        if let Some(choice) = self.published_as {
            if self.preset != Preset::Paper {
                bail!("--published-as chooses the rates of --preset paper; leave it out");
            }
            preset.rates = match choice.set() {
                Some(PublishedSet::Mnist) => Rates::PAPER_MNIST,
                Some(PublishedSet::Cifar10) => Rates::PAPER_CIFAR,
                Some(PublishedSet::Fashion) | None => Rates::PAPER,
            };
        }
        for SettingChoice { name, value } in &self.set {
            preset = preset.set(name, value).map_err(anyhow::Error::msg)?;
        }
        let settings = IdealSettings {
            steps: self.steps.unwrap_or(preset.steps),
            patch: self.patch.map_or(preset.patch, PatchChoice::shape),
            free: self.free.map_or(preset.free, |choice| choice.0),
            locked: self.lock.iter().map(|number| number.get() - 1).collect(),
            min_separation_px: self.min_separation.unwrap_or(preset.min_separation_px),
            lenslets: self.lenslets,
            anisotropic: self.anisotropic,
            ..preset
        };
        if let Encoder::Lenslets(array) = &design.encoder {
            settings.check(array)?;
            check_effects(&settings, array.lenslets.len(), self.set.iter().map(|choice| choice.name.as_str()))?;
        }
        Ok(settings)
    }

    /// Writes design, PSF, curve and record, and tells what came of it.
    fn finish(&self, record: &IdealRecord, ranked: &[RankedStart]) -> Result<(), Failure> {
        let files = write(record, &self.out)?;
        let (Some(start), Some(end)) = (record.frames.first(), record.frames.last()) else {
            return Err(anyhow::anyhow!("{}: the run has no frames", self.out.display()).into());
        };
        let (score, unscored) = match self.score(record) {
            Ok(score) => (score, None),
            Err(error) => (None, Some(error)),
        };
        let told = |study: &StudyRecord| [worths(study), verdict(study)].concat();
        let verdict = score.as_ref().map(told).unwrap_or_default();
        let printed = if self.json {
            let files = files.iter().map(|file| file.display().to_string()).collect();
            let folder = self.out.display().to_string();
            let score = score.as_ref();
            output::print_json(&Outcome { folder, files, start, end, record, ranked, score, verdict })
        } else {
            let mut lines = lines_of(record, start, end);
            lines.extend(
                ranked
                    .iter()
                    .enumerate()
                    .map(|(place, result)| format!("{}. {}: {}", place + 1, result.name, in_words(result))),
            );
            lines.extend(verdict);
            lines.push(format!("Written to {}", self.out.display()));
            output::print(&lines.join("\n"))
        };
        if let Some(study) = &score {
            failed(study, &self.out.join(SCORE))?;
        }
        match unscored {
            // The run is worth having without.
            Some(error) => Err(Failure::Incomplete(error.context(format!("{}: no comparison", self.out.display())))),
            None => printed,
        }
    }

    /// Compares the result with its start and with heuristic layouts.
    fn score(&self, record: &IdealRecord) -> anyhow::Result<Option<StudyRecord>> {
        let all: Vec<usize> = (1..=9).collect();
        let against = if self.against.is_empty() { &all } else { &self.against };
        let settings = match self.score {
            Some(ScoreChoice(None)) => return Ok(None),
            Some(ScoreChoice(Some(BudgetChoice(budget)))) => score_settings(record, against, budget)?,
            None if !self.against.is_empty() => usual_score(record, against)?,
            None => {
                // One with others that is there goes on where it was stopped.
                let there = KeptRun::in_folder(&self.out)?.compared(&record.result);
                match there.filter(|study| study.settings.designs.len() > 2) {
                    Some(there) if there.program_version != NUMBERS_VERSION => return Ok(Some(there)),
                    Some(there) => there.settings,
                    None => usual_score(record, usual_layouts(record, &all))?,
                }
            }
        };
        let mut study = open_score(settings, &self.out)?;
        run_with_bar(&mut study)?;
        Ok(Some(study.record().clone()))
    }
}

/// Folder of the comparison in that of the run.
const SCORE: &str = "score";

/// The comparison in the folder of the run; one of an earlier result, or with other settings, moves out of its way.
fn open_score(settings: StudySettings, run: &Path) -> anyhow::Result<Study> {
    let folder = run.join(SCORE);
    match Study::open(settings.clone(), &folder) {
        Err(error) if error.is_about_another() => {
            let earlier = (1..u32::MAX).map(|number| run.join(format!("{SCORE}-{number}"))).find(|path| !path.exists());
            let earlier = earlier.unwrap_or_else(|| folder.clone());
            std::fs::rename(&folder, &earlier).with_context(|| format!("{}: cannot be moved", folder.display()))?;
            output::report(format_args!(
                "{}: what was there, of an earlier result, other settings or another version, is in {} now",
                folder.display(),
                earlier.display()
            ));
            Ok(Study::open(settings, &folder)?)
        }
        opened => Ok(opened?),
    }
}

/// Distances that differ by less are the same to people, px.
const ROUNDING_PX: f64 = 0.01;

/// The run for people, line by line.
fn lines_of(record: &IdealRecord, start: &Frame, end: &Frame) -> Vec<String> {
    let bits = |frame: &Frame| {
        let [low, high] = frame.interval_95;
        format!("{:.4} [{low:.4}, {high:.4}]", frame.bits_per_pixel)
    };
    let patch = patches_of(record.settings.patch);
    let mut lines = vec![
        format!(
            "{} before {}, {patch}, {} preset, {} objective",
            record.start.encoder.describe(),
            record.start.objects,
            record.settings.preset,
            record.settings.objective
        ),
        format!("from {} to {} bits per pixel, {}", bits(start), bits(end), record.settings.objective.kind_of_value()),
        format!(
            "{}, {:.1} effective; Tamura {:.3} to {:.3}; {} in {:.0} s",
            counted(end.distinct_lenslets, "lenslet"),
            end.effective_lenslets,
            start.tamura,
            end.tamura,
            counted(end.step, "step"),
            end.seconds
        ),
    ];
    lines.extend(gain_in_words(&record.frames, record.settings.objective).map(String::from));
    lines.push("Numbers of a run steer it and can mislead; what judges the design is an estimate of its own".into());
    let (asked, least) = (record.settings.min_separation_px, record.least_separation_px());
    if least < asked - ROUNDING_PX {
        lines.push(format!("some lenslets are {least:.2} px apart, although {asked} px were asked for"));
    }
    lines.extend(IdealEvent::detours(&record.events));
    lines.extend(record.notices.iter().map(|notice| format!("note: {notice}")));
    lines
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::information::Estimator;
    use crate::objects::ObjectSource;
    use crate::sensor::Noise;
    use crate::studies::{StudyDesign, StudyKind, StudyObjects};

    #[test]
    fn a_comparison_of_another_result_moves_out_of_the_way() {
        let run = tempfile::tempdir().unwrap();
        let settings = |lenslets| StudySettings {
            kind: StudyKind::Grid,
            objects: vec![StudyObjects::new(ObjectSource::Beads { density: 0.05 }, None)],
            designs: vec![StudyDesign::heuristic(lenslets)],
            patches: vec![Some((4, 4))],
            estimator: Estimator::GaussianStationary,
            budget_seconds: None,
            patches_train: 60,
            patches_test: 20,
            fresh: false,
            noise: Noise::Shot,
            mean_photons: 100.0,
            bias_photons: 10.0,
            seed: 1,
        };
        let score = |lenslets| {
            let mut study = open_score(settings(lenslets), run.path()).unwrap();
            study.run(&mut |_| ControlFlow::Continue(())).unwrap();
            study.record().clone()
        };
        let names = || {
            let folders = std::fs::read_dir(run.path()).unwrap().map(|entry| entry.unwrap().file_name());
            let mut names: Vec<String> = folders.map(|name| name.into_string().unwrap()).collect();
            names.sort();
            names
        };
        let first = score(2);
        assert_eq!((score(2), names()), (first, vec!["score".to_owned()]), "it is the same comparison");
        score(3);
        score(4);
        assert_eq!(names(), ["score", "score-1", "score-2"]);
        let kept = std::fs::read_to_string(run.path().join("score-1/study.json")).unwrap();
        assert!(kept.contains("heuristic:2"), "the earliest is the first");
        // Nor does one that is damaged stand in the way.
        std::fs::write(run.path().join("score/study.json"), "{").unwrap();
        score(4);
        assert_eq!(names(), ["score", "score-1", "score-2", "score-3"]);
    }

    #[test]
    fn parameters_are_read_from_their_names() {
        let free: FreeChoice = "positions, weights".parse().unwrap();
        assert_eq!(free.0, Free { positions: true, widths: false, weights: true });
        assert!("all".parse::<FreeChoice>().is_err() && "".parse::<FreeChoice>().is_err());
    }
}
