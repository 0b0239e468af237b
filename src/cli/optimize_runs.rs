//! Runs of `optimize` in their folders: one, or several that are ranked.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};

use super::choices::about_objects;
use super::output::{self, ProgressLine};
use crate::design::{IdealError, IdealOptimizer, IdealProgress, IdealSettings, time_left};
use crate::evaluation::{EstimateProgress, EvaluationError, format_duration};
use crate::formats::check_writable;
use crate::forward::Design;
use crate::information::InformationError;
use crate::objects::ReadProgress;
use crate::plural::counted;
use crate::studies::{StudyDesign, StudySettings};
use crate::workbench::{
    DESIGN_FILES, IdealRecord, RankedStart, RunQueue, RunStore, Start, curve_of, design_outputs, run_ideal,
    score_in_patches, score_settings, score_whole, write_design,
};

/// Runs the optimizer in its folder. An existing run is resumed.
pub(super) fn optimize(
    design: &Design,
    settings: &IdealSettings,
    kept: &RunStore,
    folder: &Path,
) -> anyhow::Result<IdealRecord> {
    let from = kept.load(0)?;
    let progress_line = ProgressLine::new();
    let mut going_on = from.is_some();
    let folder = folder.display();
    let mut on_progress = |progress: &IdealProgress<'_>| {
        if std::mem::take(&mut going_on) {
            let step = progress.state.step;
            progress_line.report(format_args!("{folder}: resuming the run that is there, at step {step}"));
        }
        progress_line.show(progress.state.step, settings.steps, &message(progress, settings));
        ControlFlow::Continue(())
    };
    let mut reading = |progress: &ReadProgress| {
        progress.understood.iter().for_each(|understood| progress_line.report(understood));
        ControlFlow::Continue(())
    };
    let keep = &mut |ideal: &IdealOptimizer<'_>| kept.store(0, &ideal.to_bytes()?);
    let record = run_ideal(design, settings, from.as_deref(), &mut reading, keep, &mut on_progress)
        .map_err(|error| about_state(design, kept, error))
        .with_context(|| format!("{folder}: the run ended"))?;
    progress_line.finish();
    if let (Some((rows, cols)), Some(taken)) = (settings.patch, record.settings.patch)
        && taken != (rows, cols)
    {
        let (most_rows, most_cols) = taken;
        output::report(format_args!(
            "{folder}: a patch of {rows} x {cols} px is larger than the measurement; the run has patches of {most_rows} x {most_cols} px"
        ));
    }
    if let Some(end) = record.checkpoints.last().filter(|end| end.step > settings.steps) {
        let taken = counted(end.step, "step");
        output::report(format_args!("{folder}: the run that is there has taken {taken} already, and stays as it is"));
    }
    Ok(record)
}

/// The error of a run, with the path of its state where the state is wrong.
fn about_state(design: &Design, kept: &RunStore, error: EvaluationError) -> anyhow::Error {
    match error {
        EvaluationError::Ideal(
            error @ (IdealError::OtherRun { .. } | IdealError::Information(InformationError::Network(_))),
        ) => {
            anyhow!("{}: {error}; choose another --out, or remove this file to start again", kept.run_file().display())
        }
        other => about_objects(design, other),
    }
}

/// Refuses flags without effect in a run of `lenslets` lenslets.
pub(super) fn check_effects(settings: &IdealSettings, lenslets: usize) -> anyhow::Result<()> {
    if settings.anisotropic && !settings.free.widths {
        bail!("--anisotropic is for widths that may change; add widths to --free, or leave it out");
    }
    if let Some(left) = settings.cardinality.filter(|&left| left > lenslets) {
        bail!(
            "--cardinality {left}: expected at most the {lenslets} of the start, since a run adds none; choose fewer"
        );
    }
    Ok(())
}

/// Names of the curve and the record of a run.
const CURVE: &str = "curve.csv";
pub(super) const RECORD: &str = "run.json";

/// Paths of all result files of `starts` starts.
pub(super) fn outputs(out: &Path, starts: usize) -> Vec<PathBuf> {
    let own = (1..=starts).filter(|_| starts > 1).map(|number| start_folder(out, number));
    let files = |folder: PathBuf| {
        let own = [CURVE, RECORD].map(|name| folder.join(name));
        design_outputs(&folder).into_iter().chain(own)
    };
    own.chain([out.to_path_buf()]).flat_map(files).collect()
}

/// Checks that the folder has no results of another kind of run, and that its files can be written.
pub(super) fn check_place(kept: &RunStore, out: &Path, starts: usize) -> anyhow::Result<()> {
    if starts == 1 && (kept.has_order() || start_folder(out, 1).exists()) {
        bail!(
            "{}: expected a folder for one run, found the runs of several starts; choose another --out, or give their --starts",
            out.display()
        );
    }
    if starts > 1 && kept.run_file().exists() {
        bail!(
            "{}: expected a folder for the runs of several starts, found a single run; choose another --out, or leave --starts out",
            out.display()
        );
    }
    kept.check_writable()?;
    DESIGN_FILES.iter().chain(&[CURVE, RECORD]).try_for_each(|name| check_writable(&out.join(name)))?;
    Ok(())
}

/// The folder of one of several starts, by its number from 1.
fn start_folder(out: &Path, number: usize) -> PathBuf {
    out.join(format!("start-{number}"))
}

/// Writes design, PSF, curve and record.
pub(super) fn write(record: &IdealRecord, folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = write_design(&record.design(), folder, None)?;
    let curve = folder.join(CURVE);
    curve_of(record.settings.objective, &record.checkpoints).write(&curve)?;
    let path = folder.join(RECORD);
    record.save(&path)?;
    files.extend([curve, path]);
    Ok(files)
}

/// Default time budget of each estimate of a comparison.
const USUAL_SCORE: Duration = Duration::from_secs(15);
/// Test patches of each estimate. Whole measurements take long.
const USUAL_PATCHES: usize = 300;

/// The comparison with these layouts in the default time.
pub(super) fn usual_score(record: &IdealRecord, against: &[usize]) -> Result<StudySettings, EvaluationError> {
    Ok(StudySettings { patches_test: USUAL_PATCHES, ..score_settings(record, against, USUAL_SCORE)? })
}

/// Default baselines of a result: none on a grid of another size, where the measurements differ.
pub(super) fn usual_layouts<'a>(record: &IdealRecord, all: &'a [usize]) -> &'a [usize] {
    let grid = StudyDesign::heuristic(1).encoder.grid();
    if record.start.encoder.grid() == grid { all } else { &[] }
}

/// Results of several starts.
pub(super) struct Ranking {
    /// Record of the best result.
    pub record: IdealRecord,
    /// All results, the best first.
    pub ranked: Vec<RankedStart>,
    /// Number of starts without a result.
    pub failed: usize,
}

/// The run from a start in its folder, and its score unless `known` holds it.
fn ranked_start(
    start: &Start,
    settings: &IdealSettings,
    (folder, budget): (&Path, Option<Duration>),
    known: &[RankedStart],
) -> anyhow::Result<(IdealRecord, RankedStart)> {
    let kept = RunStore::in_folder(folder)?;
    let _lock = kept.lock()?;
    let record = optimize(&start.design, settings, &kept, folder)?;
    write(&record, folder)?;
    let (name, design) = (start.name.clone(), Arc::new(record.design()));
    let known = known.iter().find(|result| result.name == name && result.design == design);
    if let Some(result) = known.filter(|result| result.is_scored) {
        return Ok((record, result.clone()));
    }
    let progress_line = ProgressLine::new();
    let mut on_progress = |progress: &EstimateProgress| {
        progress_line.show(progress.done, progress.total, &progress.step);
        ControlFlow::Continue(())
    };
    let mut result = if let Some(known) = known {
        known.clone()
    } else {
        let estimate =
            score_in_patches(&design, budget, &mut on_progress).map_err(|error| about_objects(&design, error))?;
        let design = Arc::clone(&design);
        RankedStart { name, design, estimate, sensor: None, is_scored: false, sensor_failure: None, record: None }
    };
    let scored = score_whole(&design, &result.estimate, budget, &mut on_progress);
    progress_line.finish();
    if let Err(error) = result.set_sensor(scored) {
        output::report(format_args!("{}: no score for the whole sensor: {error}", folder.display()));
    }
    Ok((record, result))
}

/// Text of a result.
pub(super) fn format_result(result: &RankedStart) -> String {
    let sensor = result.sensor.as_ref().map_or(String::new(), |sensor| format!("; whole sensor: {}", sensor.summary()));
    format!("{}{sensor}", result.estimate.summary())
}

/// Runs from several starts in folders of `out`. Each result is scored in this time, or by a fixed number of steps.
/// `order` stores the results.
pub(super) fn rank(
    starts: &[Start],
    settings: &IdealSettings,
    out: &Path,
    order: &RunStore,
    budget: Option<Duration>,
) -> anyhow::Result<Ranking> {
    let budget_seconds = budget.map(|budget| budget.as_secs_f64());
    // Scores of an interrupted command are reused.
    let last = order.last().map(|run| run.queue);
    if last.as_ref().is_some_and(|last| !is_same(last, starts, settings)) {
        bail!(
            "{}: expected the starts and settings of the runs that are there, found others; choose another --out",
            out.display()
        );
    }
    let known = last.filter(|order| order.budget_seconds == budget_seconds);
    let known = known.map_or_else(Vec::new, |order| order.ranked);
    let (mut records, mut ranked, mut failed) = (Vec::new(), Vec::<RankedStart>::new(), 0);
    for (at, start) in starts.iter().enumerate() {
        let folder = start_folder(out, at + 1);
        output::report(format_args!("{}: {}, start {} of {}", folder.display(), start.name, at + 1, starts.len()));
        match ranked_start(start, settings, (&folder, budget), &known) {
            Ok((record, result)) => {
                output::report(format_args!("{}: {}", folder.display(), format_result(&result)));
                records.push((result.name.clone(), record));
                ranked.push(result);
            }
            // The results of other starts stay useful.
            Err(error) if starts.len() - failed > 1 => {
                failed += 1;
                output::report(format_args!("{error:#}"));
            }
            Err(error) => return Err(error),
        }
        RankedStart::rank(&mut ranked);
        let begun = RunQueue::new(starts.to_vec(), settings.clone());
        let ranked = with_known(&ranked, &known, &starts[at + 1..]);
        order.note(&RunQueue { at, ranked, budget_seconds, ..begun })?;
    }
    let best = ranked.first().map(|best| &best.name);
    let record = records.into_iter().find(|(name, _)| Some(name) == best).map(|(_, record)| record);
    let record = record.context("--starts: no run has finished")?;
    Ok(Ranking { record, ranked, failed })
}

/// Whether a queue has these starts and settings; the number of starts and steps may differ.
fn is_same(order: &RunQueue, starts: &[Start], settings: &IdealSettings) -> bool {
    let but_steps = |settings: &IdealSettings| IdealSettings { steps: 0, ..settings.clone() };
    but_steps(&order.settings) == but_steps(settings)
        && order.starts.iter().zip(starts).all(|(one, other)| one == other)
}

/// The results, with those in `known` for the starts `ahead`.
fn with_known(ranked: &[RankedStart], known: &[RankedStart], ahead: &[Start]) -> Vec<RankedStart> {
    let is_ahead = |result: &&RankedStart| ahead.iter().any(|start| start.name == result.name);
    let mut results: Vec<RankedStart> = ranked.iter().chain(known.iter().filter(is_ahead)).cloned().collect();
    RankedStart::rank(&mut results);
    results
}

fn message(progress: &IdealProgress<'_>, settings: &IdealSettings) -> String {
    let state = progress.state;
    let value = state.checkpoints.last().map_or(String::new(), |checkpoint| {
        format!("{:.4} bits per pixel, {}", checkpoint.bits_per_pixel, counted(checkpoint.distinct_lenslets, "lenslet"))
    });
    let left = time_left(state, settings, progress.seconds)
        .map_or(String::new(), |left| format!(", about {} to go", format_duration(left)));
    match progress.phase {
        Some(_) if state.checkpoints.is_empty() => "First fit".into(),
        _ => format!("{value}{left}"),
    }
}
