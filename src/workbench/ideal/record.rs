//! What a run leaves behind: all that is needed to repeat it, and its curve.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::design::{Frame, Ideal, IdealEvent, IdealSettings, Objective, least_separation_px, merged_result};
use crate::formats::{FormatError, write_json};
use crate::information::NUMBERS_VERSION;
use crate::optics::Encoder;
use crate::workbench::study::Machine;
use crate::workbench::{Curve, Design};

const FORMAT: &str = "lenslet-studio/ideal";
const FORMAT_VERSION: u64 = 1;

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
            format: FORMAT.into(),
            format_version: FORMAT_VERSION,
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

    /// Least distance of two centres in one plane of the mask in the end, px; infinite for one lenslet.
    pub fn least_separation_px(&self) -> f64 {
        self.result.lenslets().and_then(least_separation_px).unwrap_or(f64::INFINITY)
    }

    /// The design with the mask of the end in place.
    pub fn design(&self) -> Design {
        Design { encoder: self.result.clone(), ..self.start.clone() }
    }

    /// Writes the record, safely.
    ///
    /// # Errors
    /// [`FormatError`] where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FormatError> {
        write_json(path, self)
    }
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
