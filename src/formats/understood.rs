//! Interpretation of files by a reader, as one sentence.

use std::fmt;

use super::{PixelStack, Samples};
use crate::plural::{counted, one_or_many};

/// Interpretation of a file beyond its pixels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Understood {
    /// Name of the array that was read from an archive.
    pub key: Option<String>,
    /// Axis of the array that counts the images, numbered from 1.
    pub axis: Option<usize>,
    /// Number type of the file where it is none of [`Samples`], such as "12 bits" or "16-bit floats".
    pub numbers: Option<String>,
    /// Notes on changed or omitted pixels, a clause each.
    pub notes: Vec<String>,
    /// Other interpretations of the file, as options of its path: `axis=last`.
    pub choices: Vec<String>,
}

/// Summary of how one or more files were interpreted. Its text is one line, rows before columns: "20 images of 64 x 48
/// px, axis 3 counts them, 16 bits, range 3 to 1022".
#[derive(Clone, Debug, PartialEq)]
pub struct ImageSummary {
    files: usize,
    images: usize,
    /// Rows and columns; `None` where files differ.
    shape: Option<(usize, usize)>,
    key: Option<String>,
    axis: Option<usize>,
    /// Number type; `None` where files differ.
    numbers: Option<String>,
    /// Least and greatest finite value.
    range: Option<(f32, f32)>,
    /// Number of values that are NaN or infinite.
    wrong: usize,
    notes: Vec<String>,
    choices: Vec<String>,
}

impl ImageSummary {
    /// Summary of the images of one file.
    pub fn of(stack: &PixelStack) -> Self {
        let Understood { key, axis, notes, choices, .. } = stack.understood.clone();
        let (range, wrong) = stack.samples.range();
        let (images, shape) = (stack.pages, Some((stack.rows, stack.cols)));
        Self { files: 1, images, shape, key, axis, numbers: Some(stack.numbers()), range, wrong, notes, choices }
    }

    /// Other interpretations of the first file, as options of its path: `axis=last`.
    pub fn choices(&self) -> &[String] {
        &self.choices
    }

    /// Merges the summary of another file.
    pub fn join(&mut self, other: Self) {
        self.files += other.files;
        self.images += other.images;
        self.shape = self.shape.filter(|_| self.shape == other.shape);
        self.key.take_if(|key| Some(&*key) != other.key.as_ref());
        self.axis = self.axis.filter(|_| self.axis == other.axis);
        self.numbers.take_if(|numbers| Some(&*numbers) != other.numbers.as_ref());
        self.range = match (self.range, other.range) {
            (Some((least, largest)), Some((low, high))) => Some((least.min(low), largest.max(high))),
            (one, other) => one.or(other),
        };
        self.wrong += other.wrong;
        for note in other.notes {
            if !self.notes.contains(&note) {
                self.notes.push(note);
            }
        }
    }
}

impl fmt::Display for ImageSummary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shape = match self.shape {
            Some((rows, cols)) => format!("of {rows} x {cols} px"),
            None => "of several sizes".to_owned(),
        };
        write!(formatter, "{} {shape}", counted(self.images, "image"))?;
        if self.files > 1 {
            write!(formatter, " in {} files", self.files)?;
        }
        let axis = self.axis.map(|axis| format!("axis {axis} counts {}", one_or_many(self.images, "it", "them")));
        let key = self.key.as_ref().map(|key| format!("array {key}"));
        let numbers = self.numbers.clone().unwrap_or_else(|| "several number types".to_owned());
        let range = self.range.map(|(least, largest)| format!("range {} to {}", short(least), short(largest)));
        let wrong = (self.wrong > 0).then(|| format!("{} NaN or infinite", counted(self.wrong, "value")));
        for part in key.into_iter().chain(axis).chain([numbers]).chain(range).chain(wrong) {
            write!(formatter, ", {part}")?;
        }
        self.notes.iter().try_for_each(|note| write!(formatter, "; {note}"))
    }
}

impl PixelStack {
    /// Number type of the file as text.
    pub(super) fn numbers(&self) -> String {
        self.understood.numbers.clone().unwrap_or_else(|| self.samples.numbers().to_owned())
    }

    /// Adds a note, unless it is there already.
    pub(super) fn note(&mut self, note: impl Into<String>) {
        let note = note.into();
        if !self.understood.notes.contains(&note) {
            self.understood.notes.push(note);
        }
    }
}

impl Samples {
    /// Number type as text.
    fn numbers(&self) -> &'static str {
        match self {
            Self::U8(_) => "8 bits",
            Self::U16(_) => "16 bits",
            Self::F32(_) => "32-bit floats",
        }
    }

    /// Least and greatest finite value, and the number of values that are not finite.
    fn range(&self) -> (Option<(f32, f32)>, usize) {
        fn of_counts<T: Copy + Ord + Into<f32>>(values: &[T]) -> Option<(f32, f32)> {
            Some(((*values.iter().min()?).into(), (*values.iter().max()?).into()))
        }
        match self {
            Self::U8(values) => (of_counts(values), 0),
            Self::U16(values) => (of_counts(values), 0),
            Self::F32(values) => {
                let finite = || values.iter().copied().filter(|value| value.is_finite());
                let range = finite().fold(None, |range, value| match range {
                    None => Some((value, value)),
                    Some((least, largest)) => Some((value.min(least), value.max(largest))),
                });
                (range, values.len() - finite().count())
            }
        }
    }
}

/// A number with at most five significant digits. Whole numbers keep all digits.
fn short(value: f32) -> String {
    let value = f64::from(value);
    if value.fract() == 0.0 && value.abs() < 1e9 {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor();
    if (-5.0..9.0).contains(&magnitude) {
        let text = format!("{value:.*}", (4.0 - magnitude).max(0.0) as usize);
        return if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    }
    format!("{value:.4e}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_sentence_tells_number_shape_axis_depth_and_range() {
        let summary = |stack: &PixelStack| ImageSummary::of(stack).to_string();
        let mut stack = PixelStack::new(20, 1, 2, Samples::U16((3..43).collect()));
        stack.understood.axis = Some(3);
        assert_eq!(summary(&stack), "20 images of 1 x 2 px, axis 3 counts them, 16 bits, range 3 to 42");
        stack.understood.key = Some("psf".into());
        stack.note("one note");
        stack.note("one note");
        assert_eq!(
            summary(&stack),
            "20 images of 1 x 2 px, array psf, axis 3 counts them, 16 bits, range 3 to 42; one note"
        );
        let floats = PixelStack::new(1, 2, 2, Samples::F32(vec![f32::NAN, 0.125, -1.0 / 3.0, 70_000.0]));
        assert_eq!(
            summary(&floats),
            "1 image of 2 x 2 px, 32-bit floats, range -0.33333 to 70000, 1 value NaN or infinite"
        );
        assert_eq!(summary(&PixelStack::new(0, 2, 2, Samples::U8(vec![]))), "0 images of 2 x 2 px, 8 bits");
    }

    #[test]
    fn several_files_have_one_summary() {
        let of = |rows, level: u8| ImageSummary::of(&PixelStack::new(1, rows, 2, Samples::U8(vec![level; 2 * rows])));
        let mut all = of(3, 7);
        all.join(of(3, 2));
        assert_eq!(all.to_string(), "2 images of 3 x 2 px in 2 files, 8 bits, range 2 to 7");
        all.join(ImageSummary::of(&PixelStack::new(2, 4, 2, Samples::U16(vec![900; 16]))));
        assert_eq!(all.to_string(), "4 images of several sizes in 3 files, several number types, range 2 to 900");
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in
            [(0.0, "0"), (1e-7, "1.0000e-7"), (2.5e-5, "0.000025"), (1_234.567, "1234.6"), (3e12, "3.0000e12")]
        {
            assert_eq!(short(value), text);
        }
    }
}
