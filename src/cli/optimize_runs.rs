//! Runs of `optimize` in their folders.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow, bail};

use super::choices::about_objects;
use super::output::{self, ProgressLine};
use super::stop::StopSignal;
use crate::design::{
    Checkpoint, IdealError, IdealEvent, IdealOptimizer, IdealProgress, IdealSettings, gain_summary, time_left,
};
use crate::evaluation::{EvaluationError, format_duration};
use crate::formats::check_writable;
use crate::forward::Design;
use crate::information::InformationError;
use crate::objects::ReadProgress;
use crate::plural::counted;
use crate::studies::{StudyDesign, StudySettings};
use crate::workbench::{
    DESIGN_FILES, IdealRecord, RunStore, curve_of, design_outputs, patches_of, run_ideal, score_settings, write_design,
};

/// Runs the optimizer in its folder. An existing run is resumed.
pub(super) fn optimize(
    design: &Design,
    settings: &IdealSettings,
    (kept, folder): (&RunStore, &Path),
    stop: &StopSignal,
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
        stop.check()
    };
    let mut reading = |progress: &ReadProgress| {
        progress.understood.iter().for_each(|understood| progress_line.report(understood));
        stop.check()
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
pub(super) fn start_folder(out: &Path, number: usize) -> PathBuf {
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

/// Tolerance of distances, px.
const ROUNDING_PX: f64 = 0.01;

/// Summary of the run, line by line.
pub(super) fn lines_of(record: &IdealRecord, start: &Checkpoint, end: &Checkpoint) -> Vec<String> {
    let bits = |checkpoint: &Checkpoint| {
        let [low, high] = checkpoint.interval_95;
        format!("{:.4} [{low:.4}, {high:.4}]", checkpoint.bits_per_pixel)
    };
    let patch = patches_of(record.settings.patch);
    let mut lines = vec![
        format!(
            "{}, {}, {patch}, {} preset, {} objective",
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
    lines.extend(gain_summary(&record.checkpoints, record.settings.objective).map(String::from));
    lines.push("Numbers of a run can mislead; a separate estimate scores the design".into());
    let (asked, least) = (record.settings.min_separation_px, record.least_separation_px());
    if least < asked - ROUNDING_PX {
        lines.push(format!("some lenslets are {least:.2} px apart; expected at least {asked} px"));
    }
    lines.extend(IdealEvent::event_summary(&record.events));
    lines.extend(record.notices.iter().map(|notice| format!("note: {notice}")));
    lines
}
