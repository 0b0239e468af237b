//! `repeat`: a live estimate of the window, or a run, again from its record.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use serde::Serialize;

use super::choices::about_objects;
use super::look::Look;
use super::output::Meter;
use super::{Failure, output};
use crate::design::IdealProgress;
use crate::information::NamedBound;
use crate::workbench::{IdealRecord, LiveNumbers, LiveRecord, Record, Repeated, patches_of};

/// Arguments of `repeat`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// A record of a live estimate, as the Information room writes it, or of a run (run.json).
    record: PathBuf,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct RepeatedEstimate {
    #[serde(flatten)]
    repeated: Repeated,
    look: Look,
}

#[derive(Serialize)]
struct RepeatedRun<'a> {
    record: &'a IdealRecord,
    recorded: &'a IdealRecord,
    /// Whether masks and values are the same to the last bit.
    same: bool,
    /// Steps of the first mask that is not the recorded one, or has not its value.
    differs_from_step: Option<usize>,
    /// What differs from then, where something does.
    notes: Vec<String>,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        match Record::open(&self.record)? {
            Record::Live(record) => self.repeat_estimate(&record),
            Record::Run(record) => self.repeat_run(&record),
        }
    }

    fn repeat_estimate(&self, record: &LiveRecord) -> Result<(), Failure> {
        let look = Look::at(&record.design)?;
        let (meter, total) = (Meter::new(), record.steps());
        let repeated = record.repeat(&|steps| {
            meter.show(steps, total, "");
            true
        });
        let repeated = repeated.map_err(|error| about_objects(&record.design, error))?;
        meter.finish();
        let (same, notes) = (repeated.same, repeated.notes.clone());
        let printed = if self.json {
            output::print_json(&RepeatedEstimate { repeated, look })
        } else {
            output::print(&[look.lines(), lines_of(&repeated)].concat().join("\n"))
        };
        told(printed, same, &notes, "another processor may have computed them")
    }

    fn repeat_run(&self, recorded: &IdealRecord) -> Result<(), Failure> {
        let parts =
            recorded.parts().map_err(|told| anyhow!("{}: {told}, which cannot be repeated", self.record.display()))?;
        // It may take hours to find out that it comes out otherwise.
        for note in recorded.differences_here() {
            output::tell(format_args!("{}: {note}", self.record.display()));
        }
        let (meter, total) = (Meter::new(), recorded.steps());
        let mut watch = |progress: &IdealProgress<'_>| {
            meter.show(progress.state.step, total, "");
            ControlFlow::Continue(())
        };
        let record = recorded.repeat(&parts, &|_| ControlFlow::Continue(()), &mut watch);
        let record = record.map_err(|error| about_objects(&recorded.start, error))?;
        meter.finish();

        let differs_from_step = recorded.differs_from(&record);
        let (same, mut notes) = (differs_from_step.is_none(), recorded.differences_here());
        if record.objects_fingerprint != recorded.objects_fingerprint {
            notes.push("the objects are no longer those of the record".to_owned());
        }
        let printed = if self.json {
            let notes = notes.clone();
            output::print_json(&RepeatedRun { record: &record, recorded, same, differs_from_step, notes })
        } else {
            output::print(&lines_of_run(&record, recorded, differs_from_step, &notes).join("\n"))
        };
        told(
            printed,
            same,
            &notes,
            "objects, version and processor are those of the record, which may have been changed",
        )
    }
}

/// The result as it was printed, if the numbers are the same; why they are not otherwise, where no note tells for a usual reason.
fn told(printed: Result<(), Failure>, same: bool, notes: &[String], usual: &str) -> Result<(), Failure> {
    if same {
        return printed;
    }
    let reason = if notes.is_empty() { usual.to_owned() } else { notes.join("; ") };
    Err(Failure::Incomplete(anyhow!("the numbers are not the same as those of the record: {reason}")))
}

fn lines_of_run(
    record: &IdealRecord,
    recorded: &IdealRecord,
    differs_from_step: Option<usize>,
    notes: &[String],
) -> Vec<String> {
    let patch = patches_of(record.settings.patch);
    let mut lines = vec![format!("Run before {}, {patch}, bits per pixel (now, recorded):", record.start.objects)];
    let last = recorded.frames.len() - 1;
    for at in [0, last] {
        if let Some(now) = record.frames.get(at) {
            let [low, high] = now.interval_95;
            let (bits, then, step) = (now.bits_per_pixel, recorded.frames[at].bits_per_pixel, now.step);
            lines.push(format!("  step {step}: {bits:.6} [{low:.4}, {high:.4}], {then:.6}"));
        }
    }
    lines.push(differs_from_step.map_or_else(
        || "The same to the last bit, with all masks between.".into(),
        |step| format!("Not the same from step {step} on."),
    ));
    if !recorded.finished {
        lines.push("The recorded run had not come to its end, and is repeated as far as it got.".into());
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
            // Those of another machine may be in another order.
            let compared = then.iter().filter_map(|then| Some((now.iter().find(|now| now.from == then.from)?, then)));
            lines.extend(compared.map(|(now, then)| compared_line(side, now, then)));
        }
    }
    if let (Some(now), Some(then)) = (repeated.numbers.edit, repeated.recorded.edit) {
        let ([low, high], bits, recorded) = (now.interval_95, now.bits_per_pixel, then.bits_per_pixel);
        lines.push(format!("  last edit {bits:+.6} [{low:+.4}, {high:+.4}], {recorded:+.6}"));
    }
    lines.push(if repeated.same { "The same to the last bit." } else { "Not the same." }.into());
    lines.extend(repeated.notes.iter().map(|note| format!("note: {note}")));
    lines
}

/// A bound now and then.
fn compared_line(side: &str, now: &NamedBound, then: &NamedBound) -> String {
    let [low, high] = now.interval_95;
    let (bits, recorded) = (now.bits_per_pixel, then.bits_per_pixel);
    format!("  {side} {bits:.6} [{low:.4}, {high:.4}], {recorded:.6}  {}", now.from)
}

/// The bounds of a live estimate, and the side that they are on.
fn bounds(numbers: &LiveNumbers) -> [(&'static str, Option<NamedBound>); 3] {
    let LiveNumbers { bits_per_pixel, interval_95, .. } = *numbers;
    let live = NamedBound { from: "density model".into(), bits_per_pixel, interval_95 };
    [("at least", numbers.lower.clone()), ("at most", numbers.upper.clone()), ("at most", Some(live))]
}
