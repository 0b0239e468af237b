//! Comparisons of masks as part of a run: computing their cells with progress on standard error.

use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use super::stop::StopSignal;
use crate::evaluation::format_duration;
use crate::plural::counted;
use crate::studies::{Study, StudyCell, StudyEvent, StudyRecord, StudyStep};

/// Computes the missing cells, with a progress bar and a line for every cell on standard error.
pub(super) fn run_with_bar(study: &mut Study, stop: &StopSignal) -> anyhow::Result<()> {
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
        stop.check()
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
            let published =
                cell.published.map_or(String::new(), |known| format!(", published {:.4}", known.bits_per_pixel));
            format!("{}{published}, {:.1} s", estimate.bounds(), estimate.seconds)
        }
        (None, Some(failure)) => format!("failed: {failure}"),
        (None, None) => "failed".to_owned(),
    };
    format!("Cell {number} of {cells}: {name}: {result}")
}
