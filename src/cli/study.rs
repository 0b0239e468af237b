//! `study`: one estimate for every cell of a table (resumable).

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use super::choices::{
    BudgetChoice, EstimatorChoice, InitArgs, PatchChoice, check_folder, check_patches, objects_argument,
};
use super::design_args::{DesignArgs, SceneArgs};
use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use super::study_decoders::DecodersArgs;
use crate::evaluation::format_duration;
use crate::objects::ObjectSource;
use crate::plural::counted;
use crate::sensor::Noise;
use crate::studies::{
    PublishedSet, Study, StudyCell, StudyDesign, StudyEvent, StudyObjects, StudyRecord, StudySettings, StudyStep,
};

/// Arguments of `study`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    /// Estimates of objects and designs beside published values: four bead densities, five heuristic layouts.
    Grid(Grid),
    /// Estimates of one design by patch size: how far patches overstate the whole sensor.
    Patches(Patches),
    /// Lower and upper bounds by bead density, with a plot.
    Bracket(Bracket),
    /// Information of the whole sensor beside the image quality of decoders, with a scatter plot.
    Decoders(DecodersArgs),
}

/// Flags of all studies.
#[derive(Args, Debug)]
struct Common {
    /// Folder of the study. An unfinished study in it is resumed.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Time for the fits of one cell, such as 60s, 5m or 1h [default: causal 60s, pixelcnn and bracket 5m].
    #[arg(long)]
    budget: Option<BudgetChoice>,

    /// Training patches of gaussian and pixelcnn.
    #[arg(long, default_value_t = 10_000)]
    patches_train: usize,

    /// Held-out test patches.
    #[arg(long, default_value_t = 1_500)]
    patches_test: usize,

    #[command(flatten)]
    init: InitArgs,

    /// Print the result file.
    #[arg(long)]
    json: bool,
}

/// Settings shared by the cells of a table.
#[derive(Args, Debug)]
struct CellArgs {
    /// Patch in pixels: 32, 16x24 (rows x cols), or sensor for whole measurements.
    #[arg(long, default_value = "32")]
    patch: PatchChoice,

    /// Noise of the sensor: shot, read:SIGMA or shot+read:SIGMA.
    #[arg(long, default_value_t = Noise::Shot)]
    noise: Noise,

    /// Seed of objects, noise, patches and fits.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Args, Debug)]
struct Grid {
    #[command(flatten)]
    common: Common,

    /// Objects in place of the beads, as in estimate; repeat the flag for several.
    #[arg(long, value_name = "OBJECTS", value_parser = objects_argument())]
    objects: Vec<ObjectSource>,

    /// Published image set of each --objects (or of each that is read from files), in the same order.
    #[arg(long, value_enum, value_name = "NAME", requires = "objects")]
    published_as: Vec<PublishedChoice>,

    /// Heuristic layouts by their number of lenslets [default: 1,2,4,6,9].
    #[arg(long, value_name = "COUNTS", value_delimiter = ',', value_parser = layout)]
    lenslets: Vec<usize>,

    /// The estimator.
    #[arg(long, value_enum, default_value_t = EstimatorChoice::Causal)]
    estimator: EstimatorChoice,

    #[command(flatten)]
    cells: CellArgs,
}

#[derive(Args, Debug)]
struct Patches {
    #[command(flatten)]
    common: Common,

    #[command(flatten)]
    design: DesignArgs,

    #[command(flatten)]
    scene: SceneArgs,

    /// Patches in pixels: sides of squares, rows x cols, or sensor for whole measurements.
    #[arg(long, value_delimiter = ',', default_value = "8,12,16,24,32,48,sensor")]
    sides: Vec<PatchChoice>,

    /// The estimator.
    #[arg(long, value_enum, default_value_t = EstimatorChoice::Causal)]
    estimator: EstimatorChoice,
}

#[derive(Args, Debug)]
struct Bracket {
    #[command(flatten)]
    common: Common,

    /// Heuristic layouts by their number of lenslets [default: 1 to 9].
    #[arg(long, value_name = "COUNTS", value_delimiter = ',', value_parser = layout)]
    lenslets: Vec<usize>,

    /// Bead densities, beads per object pixel [default: 0.005,0.008,0.013,0.02,0.03,0.05].
    #[arg(long, value_delimiter = ',', value_parser = beads)]
    densities: Vec<ObjectSource>,

    #[command(flatten)]
    cells: CellArgs,
}

/// Image sets by the names of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum PublishedChoice {
    Cifar10,
    Mnist,
    Fashion,
    /// Objects without published values.
    None,
}

impl PublishedChoice {
    pub(super) fn set(self) -> Option<PublishedSet> {
        match self {
            Self::Cifar10 => Some(PublishedSet::Cifar10),
            Self::Mnist => Some(PublishedSet::Mnist),
            Self::Fashion => Some(PublishedSet::Fashion),
            Self::None => None,
        }
    }
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        match self.kind {
            Kind::Grid(grid) => {
                let settings = grid.settings()?;
                grid.common.run(settings)
            }
            Kind::Patches(patches) => {
                let settings = patches.settings()?;
                patches.common.run(settings)
            }
            Kind::Bracket(bracket) => {
                let settings = bracket.settings();
                bracket.common.run(settings)
            }
            Kind::Decoders(decoders) => decoders.run(),
        }
    }
}

impl Grid {
    fn settings(&self) -> anyhow::Result<StudySettings> {
        let published = StudySettings::grid();
        let objects = objects_of(&self.objects, &self.published_as)?;
        Ok(StudySettings {
            objects: if objects.is_empty() { published.objects } else { objects },
            designs: layouts(&self.lenslets, published.designs),
            estimator: self.estimator.estimator(),
            budget_seconds: budget_seconds(self.estimator),
            patches: vec![self.cells.patch.shape()],
            noise: self.cells.noise,
            seed: self.cells.seed,
            ..published
        })
    }
}

impl Patches {
    fn settings(&self) -> anyhow::Result<StudySettings> {
        let design = self.design.design(&self.scene)?;
        Ok(StudySettings {
            patches: self.sides.iter().map(|side| side.shape()).collect(),
            estimator: self.estimator.estimator(),
            budget_seconds: budget_seconds(self.estimator),
            ..StudySettings::patches(&design)
        })
    }
}

impl Bracket {
    fn settings(&self) -> StudySettings {
        let all = StudySettings::bracket();
        let objects: Vec<StudyObjects> =
            self.densities.iter().map(|source| StudyObjects::new(source.clone(), None)).collect();
        StudySettings {
            objects: if objects.is_empty() { all.objects } else { objects },
            designs: layouts(&self.lenslets, all.designs),
            patches: vec![self.cells.patch.shape()],
            noise: self.cells.noise,
            seed: self.cells.seed,
            ..all
        }
    }
}

impl Common {
    fn run(self, mut settings: StudySettings) -> Result<(), Failure> {
        check_patches(self.patches_train, self.patches_test)?;
        if let Some(budget) = self.budget {
            if settings.budget_seconds.is_none() {
                return Err(
                    anyhow::anyhow!("--budget is the time of a fit; leave it out for --estimator gaussian").into()
                );
            }
            settings.budget_seconds = Some(budget.0.as_secs_f64());
        }
        settings.fresh = self.init.is_random(settings.estimator)?;
        settings.patches_train = self.patches_train;
        settings.patches_test = self.patches_test;
        settings.check()?;
        check_folder(&self.out)?;
        let mut study = Study::open(settings, &self.out)?;
        study.record().notices.iter().for_each(output::report);
        run_with_bar(&mut study)?;
        self.print(&study)
    }

    /// The results, and a failure where cells have none.
    fn print(&self, study: &Study) -> Result<(), Failure> {
        let printed = if self.json {
            output::print_json(study.record())
        } else {
            let files = study.files().iter().map(|file| format!("  {}", file.display())).collect::<Vec<_>>().join("\n");
            output::print(&format!("{}\nWritten:\n{files}", study.markdown()))
        };
        // Failed cells are reported even if the table cannot be printed.
        failed(study.record(), &self.out)?;
        printed
    }
}

/// Computes the missing cells, with a progress bar and a line for every cell on standard error.
pub(super) fn run_with_bar(study: &mut Study) -> anyhow::Result<()> {
    output::report(announcement(study));
    let progress_line = ProgressLine::new();
    study.run(&mut |event: &StudyEvent<'_>| {
        match event {
            StudyEvent::Step(step) => {
                progress_line.show(step.number - 1, step.cells, &working(step));
            }
            StudyEvent::Done { number, cells, cell } => {
                progress_line.report(finished(*number, *cells, cell));
            }
        }
        ControlFlow::Continue(())
    })?;
    progress_line.finish();
    Ok(())
}

/// Error that counts the failed cells. Their sentences are in the record.
pub(super) fn failed(record: &StudyRecord, folder: &std::path::Path) -> Result<(), Failure> {
    match record.summary.failed {
        0 => Ok(()),
        failed => Err(Failure::Incomplete(anyhow::anyhow!(
            "{}: expected an estimate in every cell, found {failed} of {} failed; run the same command to retry them",
            folder.display(),
            record.summary.cells
        ))),
    }
}

/// Number of cells and expected time.
fn announcement(study: &Study) -> String {
    let settings = &study.record().settings;
    let (cells, missing) = (settings.cells(), study.missing());
    let there = match cells - missing {
        0 => String::new(),
        there => format!(", {there} of them there already"),
    };
    let each = match settings.budget_seconds {
        Some(_) => format!("{} each", format_duration(settings.budget())),
        None => "seconds each".to_owned(),
    };
    let left = study.time_left();
    let time = match missing {
        0 => "nothing is left to compute".to_owned(),
        _ if left.is_zero() => format!("{missing} left to compute"),
        _ => format!("about {} to go", format_duration(left)),
    };
    format!("{}, {each}{there}: {time}", counted(cells, "cell"))
}

fn working(step: &StudyStep<'_>) -> String {
    let StudyStep { number, cells, name, progress, left } = step;
    let left = if left.is_zero() { String::new() } else { format!(", about {} to go", format_duration(*left)) };
    format!("Cell {number} of {cells}{left}: {name}: {}", progress.step)
}

fn finished(number: usize, cells: usize, cell: &StudyCell) -> String {
    let name = cell.name();
    let result = match (&cell.estimate, &cell.failure) {
        (Some(estimate), _) => {
            let lower = cell.lower().map_or(String::new(), |bits| format!("at least {bits:.4}, "));
            let published =
                cell.published.map_or(String::new(), |known| format!(", published {:.4}", known.bits_per_pixel));
            let (relation, bits) = (estimate.relation(), estimate.bits_per_pixel);
            format!("{lower}{relation} {bits:.4} bits per pixel{published}, {:.1} s", estimate.seconds)
        }
        (None, Some(failure)) => format!("failed: {failure}"),
        (None, None) => "failed".to_owned(),
    };
    format!("Cell {number} of {cells}: {name}: {result}")
}

/// Objects with the published set that each corresponds to; no names for objects without published values.
pub(super) fn objects_of(
    sources_of: &[ObjectSource],
    published_as: &[PublishedChoice],
) -> anyhow::Result<Vec<StudyObjects>> {
    let (sources, names) = (sources_of.len(), published_as.len());
    let read = sources_of.iter().filter(|source| source.is_read()).count();
    if ![0, sources, read].contains(&names) {
        anyhow::bail!(
            "--published-as: expected one for each of {sources} --objects in the same order, or for each of {read} that are \
             read from files, found {names}; give none for objects without published values"
        );
    }
    let mut choices = published_as.iter();
    let mut objects = Vec::with_capacity(sources);
    for source in sources_of {
        let choice = if names == sources || source.is_read() { choices.next() } else { None };
        let set = choice.and_then(|choice| choice.set());
        if !source.is_read() && set.is_some() {
            anyhow::bail!(
                "{source}: expected images of a published set, found beads; give --published-as none for beads"
            );
        }
        objects.push(StudyObjects::new(source.clone(), set));
    }
    Ok(objects)
}

/// Default time of a cell, seconds.
fn budget_seconds(estimator: EstimatorChoice) -> Option<f64> {
    estimator.estimator().default_budget().map(|budget| budget.as_secs_f64())
}

/// Heuristic layouts by their counts, or the default ones.
fn layouts(counts: &[usize], usual: Vec<StudyDesign>) -> Vec<StudyDesign> {
    if counts.is_empty() { usual } else { counts.iter().map(|&count| StudyDesign::heuristic(count)).collect() }
}

/// A heuristic layout by its number of lenslets.
pub(super) fn layout(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if (1..=9).contains(&count) => Ok(count),
        _ => Err(format!("lenslets {text:?}: expected numbers of lenslets from 1 to 9, such as 1,2,4")),
    }
}

/// Beads by their density.
fn beads(text: &str) -> Result<ObjectSource, String> {
    format!("beads:{text}").parse::<ObjectSource>().map_err(|error| error.to_string())
}
