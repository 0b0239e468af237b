//! `study`: plans of cells, computed into a folder (resumable), and their tables and plots.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::choices::{check_count, check_folder};
use super::failure::Failure;
use super::output;
use super::study_plan::{Changes, PlanArgs};
use super::study_run::{RunArgs, write_table};
use crate::evaluation::format_duration;
use crate::formats::{shell_word, write_safely};
use crate::plural::counted;
use crate::studies::plans::{
    BatchScript, CellState, NamedPlan, Shard, StudyFolder, StudyTable, figure_of, named_plans, shards_of_script,
    times_of, write_figure,
};

/// The batch script in the folder of a study.
const SCRIPT: &str = "study.sbatch";
/// Most tasks of a job array.
const MOST_TASKS: usize = 10_000;

/// Arguments of `study`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    /// Compute the cells of a plan that have no result yet, here or as one task of a job array.
    Run(RunArgs),
    /// Print a plan as a TOML file, to start one's own from, or list the named plans.
    Plan(ShowArgs),
    /// Print the table of a study, whatever is computed so far, and write it as Markdown and CSV.
    Table(FolderArgs),
    /// Draw the plot of a study, whatever is computed so far, as SVG and PNG.
    Plot(PlotArgs),
    /// List the cells of a study without a result, or the command that submits them.
    Missing(MissingArgs),
    /// Write a batch script for a Slurm job array over the cells of a plan.
    Sbatch(SbatchArgs),
    /// Former commands.
    #[command(hide = true)]
    Grid(FormerArgs),
    #[command(hide = true)]
    Patches(FormerArgs),
    #[command(hide = true)]
    Bracket(FormerArgs),
    #[command(hide = true)]
    Decoders(FormerArgs),
}

#[derive(Args, Debug)]
struct ShowArgs {
    /// Name of a plan, its TOML file, or the folder of a study [default: a list of the named plans].
    plan: Option<PathBuf>,

    #[command(flatten)]
    changes: Changes,
}

#[derive(Args, Debug)]
struct FolderArgs {
    /// Folder of the study.
    folder: PathBuf,
}

#[derive(Args, Debug)]
struct PlotArgs {
    /// Folder of the study.
    folder: PathBuf,

    /// File of the plot, SVG or PNG by its ending [default: plot.svg and plot.png in the folder].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Args, Debug)]
struct MissingArgs {
    /// Folder of the study.
    folder: PathBuf,

    /// Print the command that submits the tasks with these cells, for the batch script in the folder.
    #[arg(long)]
    sbatch: bool,
}

#[derive(Args, Debug)]
struct SbatchArgs {
    #[command(flatten)]
    plan: PlanArgs,

    /// Folder of the study, which all tasks share.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Number of tasks.
    #[arg(long, value_name = "N", default_value_t = 8)]
    shards: usize,

    /// Processors of a task.
    #[arg(long, value_name = "N", default_value_t = 2)]
    cpus: usize,
}

/// Whatever a former command was given.
#[derive(Args, Debug)]
struct FormerArgs {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _rest: Vec<std::ffi::OsString>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        match self.kind {
            Kind::Run(arguments) => arguments.run(),
            Kind::Plan(arguments) => arguments.run(),
            Kind::Table(arguments) => arguments.run(),
            Kind::Plot(arguments) => arguments.run(),
            Kind::Missing(arguments) => arguments.run(),
            Kind::Sbatch(arguments) => arguments.run(),
            Kind::Grid(_) => Err(former("grid")),
            Kind::Patches(_) => Err(former("patches")),
            Kind::Bracket(_) => Err(former("bracket")),
            Kind::Decoders(_) => Err(former("decoders")),
        }
    }
}

fn former(name: &str) -> Failure {
    anyhow::anyhow!(
        "study {name} is a named plan now: study run {name} --out DIR; --mask, --objects, --patch and their like replace the \
         values of its axes"
    )
    .into()
}

impl ShowArgs {
    fn run(self) -> Result<(), Failure> {
        if let Some(named) = &self.plan {
            return output::print(&self.changes.applied_to(named)?.to_toml()?);
        }
        let line = |named: &NamedPlan| -> anyhow::Result<String> {
            Ok(format!("{:<10} {:>4} cells  {}", named.plan.name, named.cell_count()?, named.question))
        };
        output::print(&named_plans().iter().map(line).collect::<anyhow::Result<Vec<_>>>()?.join("\n"))
    }
}

impl FolderArgs {
    fn run(self) -> Result<(), Failure> {
        let folder = StudyFolder::open(&self.folder)?;
        let states = folder.states()?;
        let table = StudyTable::new(&folder, &states);
        write_table(&table, &self.folder)?;
        output::print(&table.markdown())
    }
}

impl PlotArgs {
    fn run(self) -> Result<(), Failure> {
        let folder = StudyFolder::open(&self.folder)?;
        let figure = figure_of(folder.plan(), folder.cells(), &folder.states()?);
        let files = match self.out {
            Some(file) => vec![file],
            None => ["plot.svg", "plot.png"].map(|name| self.folder.join(name)).into(),
        };
        for file in &files {
            write_figure(&figure, file)?;
        }
        let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        output::print(&names.join("\n"))
    }
}

impl MissingArgs {
    fn run(self) -> Result<(), Failure> {
        let folder = StudyFolder::open(&self.folder)?;
        let states = folder.states()?;
        let missing: Vec<usize> = (0..states.len()).filter(|&index| states[index].done().is_none()).collect();
        if self.sbatch {
            return self.command(&folder, &missing);
        }
        if missing.is_empty() {
            return output::print(&format!("Nothing is missing: {} done", counted(states.len(), "cell")));
        }
        let line = |&index: &usize| {
            let state = match &states[index] {
                CellState::Waiting => "waiting".to_owned(),
                other => other.failure().map_or(String::new(), |failure| format!("failed: {failure}")),
            };
            format!("{}  {}  {state}", folder.ids()[index], folder.plan().name_of(&folder.cells()[index]))
        };
        output::print(&missing.iter().map(line).collect::<Vec<_>>().join("\n"))
    }

    fn command(&self, folder: &StudyFolder, missing: &[usize]) -> Result<(), Failure> {
        let script = self.folder.join(SCRIPT);
        let tasks = std::fs::read_to_string(&script).ok().as_deref().and_then(shards_of_script).ok_or_else(|| {
            anyhow::anyhow!(
                "{}: expected the batch script of study sbatch, found none; write one with study sbatch",
                script.display()
            )
        })?;
        if missing.is_empty() {
            return output::print("# Nothing is missing.");
        }
        let ranks = folder.ranks();
        let array = BatchScript::array_of(missing.iter().map(|&index| ranks[index]), tasks);
        output::print(&format!("sbatch --array={array} {}", shell_word(&script.display().to_string())))
    }
}

impl SbatchArgs {
    fn run(self) -> Result<(), Failure> {
        let tasks = self.shards;
        check_count("--shards", tasks, 1..=MOST_TASKS)?;
        check_count("--cpus", self.cpus, 1..=1024)?;
        let plan = self.plan.plan()?;
        check_folder(&self.out)?;
        let folder = StudyFolder::begin(plan, &self.out)?;
        let ranks = folder.ranks();
        let mut times = vec![Duration::ZERO; tasks];
        for (rank, time) in ranks.into_iter().zip(times_of(folder.cells())) {
            times[Shard::of(rank, tasks).index] += time;
        }
        let script = BatchScript {
            name: folder.plan().name.clone(),
            program: std::env::current_exe()?,
            folder: std::path::absolute(&self.out)?,
            tasks,
            processors: self.cpus,
            time: times.into_iter().max().unwrap_or_default(),
        };
        let file = self.out.join(SCRIPT);
        let text = script.to_string();
        write_safely(&file, |writer| writer.write_all(text.as_bytes()))?;
        output::print(&format!(
            "{}: {} in {}, about {} each at most; submit it with sbatch {}",
            file.display(),
            counted(folder.cells().len(), "cell"),
            counted(tasks, "task"),
            format_duration(script.time),
            shell_word(&file.display().to_string())
        ))
    }
}
