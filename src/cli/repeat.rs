//! `repeat`: a live estimate of the window again, from its record.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::choices::about_objects;
use super::look::Look;
use super::output::Meter;
use super::{Failure, output};
use crate::information::NamedBound;
use crate::workbench::{LiveNumbers, LiveRecord, Repeated};

/// Arguments of `repeat`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// A record of a live estimate, as the Information room writes it.
    record: PathBuf,

    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Result {
    #[serde(flatten)]
    repeated: Repeated,
    look: Look,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> std::result::Result<(), Failure> {
        let record = LiveRecord::open(&self.record)?;
        let look = Look::at(&record.design)?;
        let (meter, total) = (Meter::new(), record.steps());
        let repeated = record.repeat(&|steps| {
            meter.show(steps, total, "");
            true
        });
        let repeated = repeated.map_err(|error| about_objects(&record.design, error))?;
        meter.finish();
        let (same, notes) = (repeated.same, repeated.notes.join("; "));
        let printed = if self.json {
            output::print_json(&Result { repeated, look })
        } else {
            let mut lines = look.lines();
            lines.extend(lines_of(&repeated));
            output::print(&lines.join("\n"))
        };
        if same {
            return printed;
        }
        let reason = if notes.is_empty() { "another processor may have computed them".to_owned() } else { notes };
        Err(Failure::Incomplete(anyhow::anyhow!("the numbers are not the same as those of the record: {reason}")))
    }
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
