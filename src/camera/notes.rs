//! Notes on the frames of a calibration.

use super::frames::{FrameReader, FrameStack};
use super::series::{FrameGroup, FrameSeries};
use crate::plural::{counted, one_or_many};

/// Frames that repeat another frame of their group.
#[derive(Clone, Debug, Default)]
pub(super) struct Copies {
    count: usize,
    /// The first group with copies.
    first: Option<String>,
}

impl Copies {
    /// Counts the copies of a group.
    pub(super) fn add(&mut self, group: &FrameGroup, stack: &FrameStack) {
        self.count += stack.copies;
        if stack.copies > 0 {
            self.first.get_or_insert_with(|| group.label.clone());
        }
    }

    /// A note on the copies; `None` without any.
    pub(super) fn note(&self) -> Option<String> {
        let first = self.first.as_ref()?;
        let repeat = one_or_many(self.count, "repeats", "repeat");
        Some(format!(
            "{} {repeat} another one of the same group, first in {first}: copies have no temporal noise, so dark noise and gain are \
             not those of the sensor; leave them out",
            counted(self.count, "frame")
        ))
    }
}

/// Notes on the frames: stated and found sizes, depths and steps.
pub(super) fn frame_notes(
    series: &FrameSeries,
    reader: &FrameReader<'_>,
    shape: (usize, usize),
    brightest: f64,
) -> Vec<String> {
    let mut notes = series.notes.clone();
    if reader.jpegs > 0 {
        notes.push(format!(
            "{} of {} {} JPEG, which is not linear and smooths noise away: gain, noise and linearity are not those of the sensor; \
             record PNG or TIFF",
            reader.jpegs,
            counted(reader.files, "file"),
            one_or_many(reader.jpegs, "is", "are")
        ));
    }
    if let Some((rows, cols)) = series.shape.filter(|stated| *stated != shape) {
        notes.push(format!("the descriptor states {rows} x {cols} px, the frames have {} x {}", shape.0, shape.1));
    }
    let step = reader.step();
    if step > 1.0 {
        notes.push(format!(
            "all grey values are {step} DN apart, as of fewer bits that were shifted; a step of {step} DN counts as rounding"
        ));
    }
    if step == 0.0 {
        notes.push("the grey values are not whole, so no rounding is taken out of the dark noise".into());
    }
    let stated = series.bits.or(reader.type_bits());
    if let Some(bits) = stated.filter(|bits| brightest > f64::from(*bits).exp2() - 1.0) {
        notes.push(format!("the brightest pixel is {brightest} DN, above the {bits} bits that the descriptor states"));
    }
    notes
}
