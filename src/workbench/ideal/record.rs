//! What a run leaves behind: all that is needed to repeat it, and its curve.

use std::ops::ControlFlow;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::design::{Frame, Ideal, IdealEvent, IdealSettings, Objective, OnIdeal, least_separation_px, merged_result};
use crate::evaluation::EvaluationError;
use crate::formats::{FormatError, write_json};
use crate::forward::Design;
use crate::information::{InformationError, NUMBERS_VERSION};
use crate::objects::Progress;
use crate::optics::Encoder;
use crate::studies::Machine;
use crate::workbench::Curve;
use crate::workbench::export::record::RUN;
use crate::workbench::ideal::run::{GoOn, run_ideal};

/// A run as it stands in its file. Information is in bits per pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IdealRecord {
    /// Always "lenslet-studio/ideal".
    pub format: String,
    /// Version of the fields.
    pub format_version: u64,
    /// Version of the program that computed it.
    pub program_version: String,
    /// What computed it.
    pub machine: Machine,
    /// The design that it started from: mask, objects, light and noise.
    pub start: Design,
    /// Fingerprint of the objects.
    pub objects_fingerprint: String,
    /// What a reader must know of the objects.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notices: Vec<String>,
    /// What was done.
    pub settings: IdealSettings,
    /// Whether it came to its end.
    pub finished: bool,
    /// The masks at all refits, with what they were worth on objects that nothing was fitted to.
    pub frames: Vec<Frame>,
    /// What else happened.
    pub events: Vec<IdealEvent>,
    /// The mask in the end, dark lenslets left out and coincident ones made one.
    pub result: Encoder,
}

impl IdealRecord {
    /// Of a run from `start` as it is now.
    pub fn new(start: &Design, ideal: &Ideal<'_>) -> Self {
        let state = ideal.state();
        Self {
            format: RUN.format.into(),
            format_version: RUN.version,
            program_version: NUMBERS_VERSION.into(),
            machine: Machine::here(),
            start: start.clone(),
            objects_fingerprint: ideal.objects_fingerprint(),
            notices: Vec::new(),
            settings: ideal.settings().clone(),
            finished: state.finished,
            frames: state.frames.clone(),
            events: state.events.clone(),
            result: Encoder::Lenslets(merged_result(&state.array, ideal.settings())),
        }
    }

    /// The record, if it is one that a run may have left; what was found otherwise.
    pub(in crate::workbench) fn checked(self) -> Result<Self, String> {
        self.start.check().map_err(|error| error.to_string())?;
        let Some(start) = self.start.encoder.lenslets() else {
            return Err(format!("{} to start from", self.start.encoder.describe()));
        };
        if self.frames.is_empty() {
            return Err("a run without any mask".to_owned());
        }
        let ends = ends_of(&self.settings, &self.events).unwrap_or_default();
        for settings in std::iter::once(self.settings.clone()).chain(self.of_lengths(ends)) {
            settings.check(start).map_err(|error| format!("settings of no run ({error})"))?;
        }
        Ok(self)
    }

    /// Steps of its mask.
    pub fn steps(&self) -> usize {
        self.frames.last().map_or(0, |frame| frame.step)
    }

    fn of_lengths(&self, ends: Vec<usize>) -> impl Iterator<Item = IdealSettings> {
        ends.into_iter().map(|steps| IdealSettings { steps, ..self.settings.clone() })
    }

    /// The runs, each from where the one before has ended, that lead to the same masks: one that went on beyond its end was told so
    /// once for each of them but the first.
    ///
    /// # Errors
    /// What the run was told on its way that these cannot be told.
    pub fn parts(&self) -> Result<Vec<IdealSettings>, String> {
        Ok(self.of_lengths(ends_of(&self.settings, &self.events)?).collect())
    }

    /// Does the run again in its [`parts`](Self::parts), as far as this one got; `reading` hears how far the objects are read.
    ///
    /// # Errors
    /// As [`run_ideal`].
    pub fn repeat(
        &self,
        parts: &[IdealSettings],
        reading: &dyn Fn(Progress) -> ControlFlow<()>,
        watch: OnIdeal<'_>,
    ) -> Result<Self, EvaluationError> {
        let (mut state, mut reached) = (None::<Vec<u8>>, None);
        for settings in parts {
            let mut end = Vec::new();
            let keep = &mut |ideal: &Ideal<'_>| {
                if ideal.is_finished() {
                    end = ideal.to_bytes()?;
                } else if !self.finished && ideal.state().frames.len() >= self.frames.len() {
                    reached = Some(Self::new(&self.start, ideal));
                    return Err(InformationError::Cancelled.into());
                }
                Ok(())
            };
            let from = state.as_deref().map(|state| GoOn { state, rewind_to: None });
            match run_ideal(&self.start, settings, from, reading, keep, watch) {
                Ok(record) => reached = Some(record),
                Err(error) => return reached.filter(|record| !record.finished).ok_or(error),
            }
            state = Some(end);
        }
        reached.ok_or_else(|| InformationError::Cancelled.into())
    }

    /// What is known beforehand to let a run come out otherwise than this one.
    pub fn differences_here(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.program_version != NUMBERS_VERSION {
            notes.push(format!("the record was written by version {}", self.program_version));
        }
        let processor = &self.machine.processor;
        if *processor != Machine::here().processor {
            notes.push(format!("it was computed on another processor, {processor}"));
        }
        notes
    }

    /// Steps of the first mask at which another run has not the mask and the values of this one, to the last bit, as far as this one
    /// got; none where it has them all.
    pub fn differs_from(&self, other: &Self) -> Option<usize> {
        let untimed = |frame: &Frame| Frame { seconds: 0.0, ..frame.clone() };
        let mut others = other.frames.iter().map(untimed);
        if let Some(first) = self.frames.iter().find(|frame| others.next() != Some(untimed(frame))) {
            return Some(first.step);
        }
        let last = || other.frames.last().map_or(0, |frame| frame.step);
        let ends_alike = self.result == other.result && self.frames.len() == other.frames.len();
        (self.finished && !ends_alike).then(last)
    }

    /// Least distance of two centres in one plane of the mask in the end, px; infinite for one lenslet.
    pub fn least_separation_px(&self) -> f64 {
        self.result.lenslets().and_then(least_separation_px).unwrap_or(f64::INFINITY)
    }

    /// The design with the mask of the end in place.
    pub fn design(&self) -> Design {
        Design { encoder: self.result.clone(), ..self.start.clone() }
    }

    /// Writes the record, safely; files of objects are named so that they are found from any folder.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FormatError> {
        let start = Design { objects: self.start.objects.absolute(), ..self.start.clone() };
        write_json(path, &Self { start, ..self.clone() })
    }
}

/// The numbers of steps after which a run that did this had come to its end, each time that it had.
///
/// # Errors
/// What it was told before an end, which settings do not hold: another number of steps, or to go back.
pub(in crate::workbench) fn ends_of(settings: &IdealSettings, events: &[IdealEvent]) -> Result<Vec<usize>, String> {
    let mut ends = Vec::new();
    for event in events {
        match event {
            IdealEvent::Replanned { step, before } => {
                return Err(format!("at step {step} of {before} this run was told to take another number of steps"));
            }
            IdealEvent::Rewound { step, to } => {
                return Err(format!("at step {step} this run was told to go back to step {to}"));
            }
            IdealEvent::Extended { step } => ends.push(*step),
            _ => {}
        }
    }
    ends.push(settings.steps);
    Ok(ends)
}

/// What information is counted in, for people; the whole measurement where there is no patch.
pub fn patches_of(patch: Option<(usize, usize)>) -> String {
    patch.map_or("whole sensor".into(), |(rows, cols)| format!("{rows} x {cols} px patches"))
}

/// How a run went, as columns.
pub fn curve_of(objective: Objective, frames: &[Frame]) -> Curve {
    let row = |frame: &Frame| {
        let [low, high] = frame.interval_95;
        let mut row = vec![
            frame.step as f64,
            frame.bits_per_pixel,
            low,
            high,
            frame.tamura,
            frame.distinct_lenslets as f64,
            frame.effective_lenslets,
            frame.seconds,
        ];
        if objective != Objective::Posterior {
            row.push(frame.lower.map_or(f64::NAN, |lower| lower.bits_per_pixel));
        }
        row
    };
    let mut header = vec![
        "step",
        "bits_per_pixel",
        "low_95_bits_per_pixel",
        "high_95_bits_per_pixel",
        "tamura",
        "distinct_lenslets",
        "effective_lenslets",
        "seconds",
    ];
    match objective {
        Objective::Density | Objective::PixelCnn => header.push("lower_bound_bits_per_pixel"),
        Objective::Posterior => header[1] = "lower_bound_bits_per_pixel",
    }
    let header = header.into_iter().map(String::from).collect();
    Curve { header, rows: frames.iter().map(row).collect(), names: Vec::new() }
}
