//! `reproduce`: recomputes a live estimate or a run from its record, and compares.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use serde::Serialize;

use super::bounds::DesignBounds;
use super::choices::about_objects;
use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use crate::design::IdealProgress;
use crate::information::{BoundMethod, NamedBound};
use crate::progress::CancelToken;
use crate::workbench::{IdealRecord, LiveNumbers, LiveRecord, Record, Repeated, patches_of};

/// Arguments of `reproduce`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Record of a live estimate (written in the Information panel) or of a run (run.json).
    record: PathBuf,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// The numbers of a live estimate, recomputed, as JSON.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct RepeatedEstimate {
    #[serde(flatten)]
    repeated: Repeated,
    /// Bounds of the design, as `bounds` prints them.
    bounds: DesignBounds,
}

/// A run, recomputed, as JSON.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct RepeatedRun<'a> {
    /// The run now, as `run.json`.
    record: &'a IdealRecord,
    /// The run of the record.
    recorded: &'a IdealRecord,
    /// Whether masks and values are bit-identical.
    same: bool,
    /// First step at which the mask or its value differs from the record.
    differs_from_step: Option<usize>,
    /// Differences of objects, version and machine.
    notes: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    pub fn run(self) -> Result<(), Failure> {
        match Record::open(&self.record)? {
            Record::Live(record) => self.reproduce_estimate(&record),
            Record::Run(record) => self.reproduce_run(&record),
        }
    }

    fn reproduce_estimate(&self, record: &LiveRecord) -> Result<(), Failure> {
        let bounds = DesignBounds::open(&record.design)?;
        let (progress_line, total) = (ProgressLine::new(), record.steps());
        let repeated = record.repeat(&mut |steps: &usize| {
            progress_line.show(*steps, total, "");
            ControlFlow::Continue(())
        });
        let repeated = repeated.map_err(|error| about_objects(&record.design, error))?;
        progress_line.finish();
        let (same, notes) = (repeated.same, repeated.notes.clone());
        let printed = if self.json {
            output::print_json(&RepeatedEstimate { repeated, bounds })
        } else {
            output::print(&[bounds.lines(), lines_of(&repeated)].concat().join("\n"))
        };
        outcome(printed, same, &notes, "another processor may have computed them")
    }

    fn reproduce_run(&self, recorded: &IdealRecord) -> Result<(), Failure> {
        let parts = recorded
            .parts()
            .map_err(|reason| anyhow!("{}: {reason}, which cannot be reproduced", self.record.display()))?;
        // Reported first: the run may take hours.
        for note in recorded.differences_here() {
            output::report(format_args!("{}: {note}", self.record.display()));
        }
        let (progress_line, total) = (ProgressLine::new(), recorded.steps());
        let mut on_progress = |progress: &IdealProgress<'_>| {
            progress_line.show(progress.state.step, total, "");
            ControlFlow::Continue(())
        };
        let record = recorded.reproduce(&parts, &mut CancelToken::new(), &mut on_progress);
        let record = record.map_err(|error| about_objects(&recorded.start, error))?;
        progress_line.finish();

        let differs_from_step = recorded.differs_from(&record);
        let (same, mut notes) = (differs_from_step.is_none(), recorded.differences_here());
        if record.objects_fingerprint != recorded.objects_fingerprint {
            notes.push("the objects differ from those of the record".to_owned());
        }
        let printed = if self.json {
            let notes = notes.clone();
            output::print_json(&RepeatedRun { record: &record, recorded, same, differs_from_step, notes })
        } else {
            output::print(&lines_of_run(&record, recorded, differs_from_step, &notes).join("\n"))
        };
        outcome(
            printed,
            same,
            &notes,
            "objects, version and processor are those of the record; the record may have been edited",
        )
    }
}

/// The printed result if the numbers are identical; otherwise an error with `notes`, or the `usual` reason where there are none.
fn outcome(printed: Result<(), Failure>, same: bool, notes: &[String], usual: &str) -> Result<(), Failure> {
    if same {
        return printed;
    }
    let reason = if notes.is_empty() { usual.to_owned() } else { notes.join("; ") };
    Err(Failure::Incomplete(anyhow!("the numbers differ from those of the record: {reason}")))
}

fn lines_of_run(
    record: &IdealRecord,
    recorded: &IdealRecord,
    differs_from_step: Option<usize>,
    notes: &[String],
) -> Vec<String> {
    let patch = patches_of(record.settings.patch);
    let mut lines = vec![format!("Run on {}, {patch}, bits per pixel (now, recorded):", record.start.objects)];
    let last = recorded.checkpoints.len() - 1;
    for at in [0, last] {
        if let Some(now) = record.checkpoints.get(at) {
            let [low, high] = now.interval_95;
            let (bits, then, step) = (now.bits_per_pixel, recorded.checkpoints[at].bits_per_pixel, now.step);
            lines.push(format!("  step {step}: {bits:.6} [{low:.4}, {high:.4}], {then:.6}"));
        }
    }
    lines.push(differs_from_step.map_or_else(
        || "All masks and values are bit-identical.".into(),
        |step| format!("Different from step {step}."),
    ));
    if !recorded.finished {
        lines.push("The recorded run is unfinished; its recorded steps are reproduced.".into());
    }
    lines.extend(notes.iter().map(|note| format!("note: {note}")));
    lines
}

fn lines_of(repeated: &Repeated) -> Vec<String> {
    let [rows, cols] = repeated.numbers.patch;
    let mut lines = vec![format!("Live estimate of a {rows} x {cols} px patch, bits per pixel (now, recorded):")];
    for ((side, now), (_, then)) in bounds(&repeated.numbers).into_iter().zip(bounds(&repeated.recorded)) {
        if let (Some(now), Some(then)) = (now, then) {
            lines.push(compared_line(side, &now, &then));
        }
    }
    if let (Some(now), Some(then)) = (&repeated.numbers.sensor, &repeated.recorded.sensor) {
        lines.push("Whole measurements:".into());
        let sides =
            [("at least", &now.lower_bounds, &then.lower_bounds), ("at most", &now.upper_bounds, &then.upper_bounds)];
        for (side, now, then) in sides {
            // The order may differ between machines.
            let compared = then.iter().filter_map(|then| Some((now.iter().find(|now| now.from == then.from)?, then)));
            lines.extend(compared.map(|(now, then)| compared_line(side, now, then)));
        }
    }
    if let (Some(now), Some(then)) = (repeated.numbers.edit, repeated.recorded.edit) {
        let ([low, high], bits, recorded) = (now.interval_95, now.bits_per_pixel, then.bits_per_pixel);
        lines.push(format!("  last edit {bits:+.6} [{low:+.4}, {high:+.4}], {recorded:+.6}"));
    }
    lines.push(if repeated.same { "Bit-identical." } else { "Different." }.into());
    lines.extend(repeated.notes.iter().map(|note| format!("note: {note}")));
    lines
}

/// Line of one bound, recomputed and recorded.
fn compared_line(side: &str, now: &NamedBound, then: &NamedBound) -> String {
    let [low, high] = now.interval_95;
    let (bits, recorded) = (now.bits_per_pixel, then.bits_per_pixel);
    format!("  {side} {bits:.6} [{low:.4}, {high:.4}], {recorded:.6}  {}", now.from)
}

/// Bounds of a live estimate with their side.
fn bounds(numbers: &LiveNumbers) -> [(&'static str, Option<NamedBound>); 3] {
    let LiveNumbers { bits_per_pixel, interval_95, .. } = *numbers;
    let live = NamedBound { from: BoundMethod::Density, bits_per_pixel, interval_95 };
    [("at least", numbers.lower.clone()), ("at most", numbers.upper.clone()), ("at most", Some(live))]
}
