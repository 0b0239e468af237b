//! Record of a run, which reproduces it, and its curve.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::design::{
    Checkpoint, IdealEvent, IdealOptimizer, IdealProgress, IdealSettings, Objective, least_separation_px, merged_result,
};
use crate::evaluation::EvaluationError;
use crate::formats::{DocumentKind, FormatError, write_json};
use crate::forward::Design;
use crate::information::{InformationError, NUMBERS_VERSION};
use crate::objects::ReadProgress;
use crate::optics::{Encoder, MASK_DOCUMENT_VERSION};
use crate::progress::Progress;
use crate::studies::Machine;
use crate::workbench::Curve;
use crate::workbench::runs::run::run_ideal;

/// The kind of the file.
pub(crate) const RUN: DocumentKind =
    DocumentKind::new("lenslet-studio/ideal", "a record of a run").at_version(MASK_DOCUMENT_VERSION);

/// Record of a run, as its file holds it. Information is in bits per pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct IdealRecord {
    /// Always "lenslet-studio/ideal".
    pub format: String,
    /// Version of the fields.
    pub format_version: u64,
    /// Version of the program that computed the run.
    pub program_version: String,
    /// Machine that computed the run.
    pub machine: Machine,
    /// Design of the start: mask, objects, light and noise.
    pub start: Design,
    /// Fingerprint of the objects.
    pub objects_fingerprint: String,
    /// Notices on the objects and the result.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notices: Vec<String>,
    /// Settings of the run.
    pub settings: IdealSettings,
    /// Whether the last fit is done.
    pub finished: bool,
    /// The masks at all refits, with their information on held-out objects.
    #[serde(alias = "frames")]
    pub checkpoints: Vec<Checkpoint>,
    /// Events besides gradient steps.
    pub events: Vec<IdealEvent>,
    /// The final mask without dark lenslets and with coincident ones merged.
    pub result: Encoder,
}

impl IdealRecord {
    /// Record of the present state of a run from `start`.
    pub fn new(start: &Design, ideal: &IdealOptimizer<'_>) -> Self {
        let state = ideal.state();
        Self {
            format: RUN.format.into(),
            format_version: start.document_version(),
            program_version: NUMBERS_VERSION.into(),
            machine: Machine::here(),
            start: start.clone(),
            objects_fingerprint: ideal.objects_fingerprint(),
            notices: Vec::new(),
            settings: ideal.settings().clone(),
            finished: state.finished,
            checkpoints: state.checkpoints.clone(),
            events: state.events.clone(),
            result: Encoder::Lenslets(merged_result(&state.array, ideal.settings())),
        }
    }

    /// The record, if it is valid; what is wrong with it otherwise.
    pub(in crate::workbench) fn checked(self) -> Result<Self, String> {
        self.start.check().map_err(|error| error.to_string())?;
        let Some(start) = self.start.encoder.lenslets() else {
            return Err(format!("{} to start from", self.start.encoder.describe()));
        };
        if self.checkpoints.is_empty() {
            return Err("a run without checkpoints".to_owned());
        }
        let ends = segment_lengths(&self.settings, &self.events).unwrap_or_default();
        for settings in std::iter::once(self.settings.clone()).chain(self.of_lengths(ends)) {
            settings.check(start).map_err(|error| format!("invalid settings ({error})"))?;
        }
        Ok(self)
    }

    /// Steps of the final mask.
    pub fn steps(&self) -> usize {
        self.checkpoints.last().map_or(0, |checkpoint| checkpoint.step)
    }

    fn of_lengths(&self, ends: Vec<usize>) -> impl Iterator<Item = IdealSettings> {
        ends.into_iter().map(|steps| IdealSettings { steps, ..self.settings.clone() })
    }

    /// The runs, each resumed from the end of the one before, that lead to the same masks: one more for each extension.
    ///
    /// # Errors
    /// One sentence for a run that branched, as earlier versions allowed.
    pub fn parts(&self) -> Result<Vec<IdealSettings>, String> {
        Ok(self.of_lengths(segment_lengths(&self.settings, &self.events)?).collect())
    }

    /// Runs the [`parts`](Self::parts) again, as far as this run got. `reading` receives the progress of reading the objects.
    ///
    /// # Errors
    /// As [`run_ideal`].
    pub fn reproduce(
        &self,
        parts: &[IdealSettings],
        reading: &mut dyn Progress<ReadProgress>,
        progress: &mut dyn for<'a> Progress<IdealProgress<'a>>,
    ) -> Result<Self, EvaluationError> {
        let (mut state, mut reached) = (None::<Vec<u8>>, None);
        for settings in parts {
            let mut end = Vec::new();
            let keep = &mut |ideal: &IdealOptimizer<'_>| {
                if ideal.is_finished() {
                    end = ideal.to_bytes()?;
                } else if !self.finished && ideal.state().checkpoints.len() >= self.checkpoints.len() {
                    reached = Some(Self::new(&self.start, ideal));
                    return Err(InformationError::Cancelled.into());
                }
                Ok(())
            };
            match run_ideal(&self.start, settings, state.as_deref(), reading, keep, progress) {
                Ok(record) => reached = Some(record),
                Err(error) => return reached.filter(|record| !record.finished).ok_or(error),
            }
            state = Some(end);
        }
        reached.ok_or_else(|| InformationError::Cancelled.into())
    }

    /// Known reasons for which a reproduction here may differ from the record.
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

    /// Step of the first checkpoint of this run that differs from that of another one by at least a bit; none where all are equal.
    pub fn differs_from(&self, other: &Self) -> Option<usize> {
        let untimed = |checkpoint: &Checkpoint| Checkpoint { seconds: 0.0, ..checkpoint.clone() };
        let mut others = other.checkpoints.iter().map(untimed);
        if let Some(first) = self.checkpoints.iter().find(|checkpoint| others.next() != Some(untimed(checkpoint))) {
            return Some(first.step);
        }
        let last = || other.checkpoints.last().map_or(0, |checkpoint| checkpoint.step);
        let ends_alike = self.result == other.result && self.checkpoints.len() == other.checkpoints.len();
        (self.finished && !ends_alike).then(last)
    }

    /// Least distance of two centres in one plane of the result, px; infinite for one lenslet.
    pub fn least_separation_px(&self) -> f64 {
        self.result.lenslets().and_then(least_separation_px).unwrap_or(f64::INFINITY)
    }

    /// The design with the result as its mask.
    pub fn design(&self) -> Design {
        Design { encoder: self.result.clone(), ..self.start.clone() }
    }

    /// Writes the record atomically; paths of objects are absolute.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FormatError> {
        let start = Design { objects: self.start.objects.absolute(), ..self.start.clone() };
        write_json(path, &Self { start, ..self.clone() })
    }
}

/// Steps at the end of each part of a run: one for each extension, and the last one.
///
/// # Errors
/// One sentence for a run with events that cannot be reproduced.
pub(in crate::workbench) fn segment_lengths(
    settings: &IdealSettings,
    events: &[IdealEvent],
) -> Result<Vec<usize>, String> {
    if events.contains(&IdealEvent::Unsupported) {
        return Err("the run branched, as earlier versions allowed, and cannot be reproduced".into());
    }
    let extensions = events.iter().filter_map(|event| match event {
        IdealEvent::Extended { step } => Some(*step),
        _ => None,
    });
    Ok(extensions.chain([settings.steps]).collect())
}

/// Text for a patch shape (rows, cols); the whole sensor where there is none.
pub fn patches_of(patch: Option<(usize, usize)>) -> String {
    patch.map_or("whole sensor".into(), |(rows, cols)| format!("{rows} x {cols} px patches"))
}

/// Curve of a run, as table columns.
pub fn curve_of(objective: Objective, checkpoints: &[Checkpoint]) -> Curve {
    let row = |checkpoint: &Checkpoint| {
        let [low, high] = checkpoint.interval_95;
        let mut row = vec![
            checkpoint.step as f64,
            checkpoint.bits_per_pixel,
            low,
            high,
            checkpoint.tamura,
            checkpoint.distinct_lenslets as f64,
            checkpoint.effective_lenslets,
            checkpoint.seconds,
        ];
        if objective != Objective::Posterior {
            row.push(checkpoint.lower.map_or(f64::NAN, |lower| lower.bits_per_pixel));
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
    Curve { header, rows: checkpoints.iter().map(row).collect(), names: Vec::new() }
}
