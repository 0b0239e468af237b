//! `study run`: the cells of a plan, with progress, until they are done or a signal asks to stop.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Serialize;

use super::choices::{check_folder, shard_of_slurm};
use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use super::stop::StopSignal;
use super::study_plan::PlanArgs;
use crate::evaluation::format_duration;
use crate::formats::{write_csv_text, write_safely};
use crate::plural::counted;
use crate::studies::StudyError;
use crate::studies::plans::{
    CORRELATION_HEADER, CSV_HEADER, CellRecord, CellSettings, CellState, Correlation, Plan, PlanEvent, RunSummary,
    Shard, StudyFolder, StudyTable, figure_of, run_cells, times_of, write_figure,
};

/// Arguments of `study run`.
#[derive(Args, Debug)]
pub(super) struct RunArgs {
    #[command(flatten)]
    plan: PlanArgs,

    /// Folder of the study; an unfinished study in it is resumed [default: PLAN, where that is the folder of a study].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Compute only the cells of task I of N, from 0 [default: those of the Slurm job array, or all].
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,

    /// Print the cells and their estimated time, and compute nothing.
    #[arg(long)]
    dry_run: bool,

    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// The results of a study, as `--json` prints them.
#[derive(Serialize)]
struct Results<'a> {
    plan: &'a Plan,
    cells: Vec<&'a CellRecord>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    correlations: Vec<Correlation>,
    waiting: usize,
    failed: usize,
}

impl RunArgs {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        let plan = self.plan.plan()?;
        let shard = self.shard.map_or_else(shard_of_slurm, Ok)?;
        if self.dry_run {
            return output::print(&listed(&plan, shard)?);
        }
        let Some(out) = self.out.as_deref().or_else(|| self.plan.study_folder()) else {
            return Err(anyhow::anyhow!("--out: expected the folder of the study, found none; name one").into());
        };
        check_folder(out)?;
        let folder = StudyFolder::begin(plan, out)?;
        if let Some(sentence) = folder.plan().left_out()? {
            output::report(format_args!("{sentence}"));
        }
        for sentence in folder.plan().missing_files(folder.cells()) {
            output::report(format_args!("{sentence}"));
        }
        let Some(summary) = run_with_bar(&folder, shard)? else {
            // The scheduler or a person asked to stop, and the state is kept.
            output::report(format_args!("{}: stopped; the same command resumes it", out.display()));
            return Ok(());
        };
        let states = folder.states()?;
        let table = StudyTable::new(&folder, &states);
        // Tasks of an array would write the same files at once; study table and study plot write them afterwards.
        if shard.count == 1 {
            write_table(&table, out)?;
            let figure = figure_of(folder.plan(), folder.cells(), &states);
            for name in ["plot.svg", "plot.png"] {
                write_figure(&figure, &out.join(name))?;
            }
        }
        let printed = if self.json {
            print_json(&folder, &states, table.correlations())
        } else {
            output::print(&table.markdown())
        };
        if summary.failed > 0 {
            return Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected an estimate in every cell, found {} of {} failed; run the same command to retry them",
                out.display(),
                summary.failed,
                summary.cells
            )));
        }
        printed
    }
}

/// Prints plan and results as JSON.
fn print_json(folder: &StudyFolder, states: &[CellState], correlations: Vec<Correlation>) -> Result<(), Failure> {
    let cells: Vec<&CellRecord> = states.iter().filter_map(CellState::done).collect();
    let failed = states.iter().filter(|state| state.failure().is_some()).count();
    let waiting = states.len() - cells.len() - failed;
    output::print_json(&Results { plan: folder.plan(), cells, correlations, waiting, failed })
}

/// Writes the table of a study into its folder, for people and for programs.
pub(super) fn write_table(table: &StudyTable<'_>, folder: &Path) -> anyhow::Result<()> {
    let text = table.markdown();
    write_safely(&folder.join("table.md"), |writer| writer.write_all(text.as_bytes()))?;
    write_csv_text(&folder.join("table.csv"), &CSV_HEADER, table.csv_rows().into_iter())?;
    let correlations = table.correlations();
    if !correlations.is_empty() {
        let rows = correlations.iter().map(Correlation::csv_row);
        write_csv_text(&folder.join("correlations.csv"), &CORRELATION_HEADER, rows)?;
    }
    Ok(())
}

/// The cells of a share and their time, for people.
fn listed(plan: &Plan, shard: Shard) -> anyhow::Result<String> {
    let cells = plan.cells()?;
    let ids: Vec<String> = cells.iter().map(CellSettings::id).collect();
    let ranks = Shard::ranks(&cells);
    let own: Vec<usize> = (0..cells.len()).filter(|&index| shard.holds(ranks[index])).collect();
    let time: Duration = times_of(own.iter().map(|&index| &cells[index])).iter().sum();
    let mut lines: Vec<String> =
        own.iter().map(|&index| format!("{}  {}", ids[index], plan.name_of(&cells[index]))).collect();
    lines.extend(plan.left_out()?);
    lines.extend(plan.missing_files(&cells));
    lines.push(format!("{}, about {} on one machine", counted(own.len(), "cell"), format_duration(time)));
    Ok(lines.join("\n"))
}

/// Computes the cells of a share, with a progress bar and a line for every cell on standard error; none where a signal stopped it.
fn run_with_bar(folder: &StudyFolder, shard: Shard) -> anyhow::Result<Option<RunSummary>> {
    let stop = StopSignal::listen();
    let progress_line = ProgressLine::new();
    let mut is_announced = false;
    let result = run_cells(folder, shard, &mut |event: &PlanEvent<'_>| {
        match event {
            PlanEvent::Step { number, cells, cell, step, left, .. } => {
                let left = format_duration(*left);
                if !is_announced {
                    progress_line.report(format_args!("{}: about {left} to go", counted(*cells, "cell")));
                    is_announced = true;
                }
                let text =
                    format!("Cell {number} of {cells}, about {left} to go: {}: {step}", folder.plan().name_of(cell));
                progress_line.show(number - 1, *cells, &text);
            }
            PlanEvent::Done { number, cells, record, .. } => {
                let name = folder.plan().name_of(&record.settings);
                progress_line.report(format_args!("Cell {number} of {cells}: {name}: {}", result_of(record)));
            }
        }
        stop.check()
    });
    progress_line.finish();
    match result {
        Ok(summary) => Ok(Some(summary)),
        Err(StudyError::Cancelled) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn result_of(record: &CellRecord) -> String {
    match (&record.estimate, &record.failure) {
        (Some(estimate), _) => format!("{}, {:.1} s", estimate.bounds(), record.seconds),
        (None, failure) => format!("failed: {}", failure.as_deref().unwrap_or("no reason is known")),
    }
}
