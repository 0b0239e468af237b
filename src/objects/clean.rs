//! Checks that pixels can be photons: finite and not negative, except for a camera's dark-frame residue.

use std::path::Path;

use crate::formats::{FormatError, GreyValues, PixelStack, Samples};
use crate::plural::{counted, one_or_many};

/// Largest negative residue of a subtracted dark frame, as a share of the largest pixel.
const LARGEST_NEGATIVE_SHARE: f32 = 0.05;

/// Least share of saturated pixels for a notice.
const LEAST_SATURATED: f64 = 0.01;

/// A notice of grey values at a limit of their number type.
pub(super) fn at_limits(values: &GreyValues) -> Option<String> {
    let wrapped = values.wrapped().map(|wrapped| wrapped.to_string());
    let saturated = values.saturated().filter(|saturated| saturated.share >= LEAST_SATURATED);
    wrapped.or(saturated.map(|saturated| format!("{saturated}: where they are saturated, what was brighter is lost")))
}

/// Checks every pixel and sets slightly negative ones to 0.
///
/// Returns a notice for the user where pixels were changed.
pub(super) fn clean(path: &Path, stack: &mut PixelStack) -> Result<Option<String>, FormatError> {
    let (pages, rows, cols) = (stack.pages, stack.rows, stack.cols);
    if stack.samples.is_empty() || pages > u32::MAX as usize {
        let found = format!("{} of {rows} x {cols} px", counted(pages, "image"));
        return Err(FormatError::malformed(path, "images with pixels", found, "choose another file"));
    }
    let Samples::F32(values) = &mut stack.samples else { return Ok(None) };
    let refused = |index: usize, value: f32, advice: &str| {
        let (page, row, col) = (index / (rows * cols), index / cols % rows, index % cols);
        let found = format!("{value} in image {}, row {row}, column {col}", page + 1);
        Err(FormatError::malformed(path, "finite pixels that are not negative", found, advice))
    };
    if let Some(index) = values.iter().position(|value| !value.is_finite()) {
        return refused(index, values[index], "replace such pixels or leave the image out");
    }
    let largest = values.iter().copied().fold(0.0, f32::max);
    let least = -LARGEST_NEGATIVE_SHARE * largest;
    if let Some(index) = values.iter().position(|&value| value < least) {
        return refused(index, values[index], "subtract the true background so that pixels are photon counts");
    }
    let (mut changed, mut lowest) = (0_usize, 0.0_f32);
    for value in values.iter_mut().filter(|value| **value < 0.0) {
        changed += 1;
        lowest = lowest.min(*value);
        *value = 0.0;
    }
    Ok((changed > 0).then(|| {
        let pixels = counted(changed, "slightly negative pixel");
        let were = one_or_many(changed, "was", "were");
        format!("{}: {pixels} (down to {lowest}) {were} set to 0", path.display())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stack(values: &[f32]) -> PixelStack {
        PixelStack::new(values.len() / 4, 2, 2, Samples::F32(values.to_vec()))
    }

    #[test]
    fn the_first_bad_pixel_is_named() {
        let path = Path::new("a.npy");
        for (bad, found) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (-0.2, "-0.2")] {
            let error = clean(path, &mut stack(&[1.0, 0.0, 2.0, 3.0, 0.0, 0.0, bad, -9.0])).unwrap_err().to_string();
            assert!(error.contains(&format!("found {found} in image 2, row 1, column 0")), "{error}");
        }
        assert!(clean(path, &mut stack(&[])).is_err());
    }

    #[test]
    fn dark_frame_residue_becomes_zero_and_is_reported() {
        let mut pixels = stack(&[1.0, -0.05, 0.0, -0.01]);
        let notice = clean(Path::new("a.npy"), &mut pixels).unwrap().unwrap();
        assert!(notice.contains("2 slightly negative pixels (down to -0.05)"), "{notice}");
        assert_eq!(pixels.samples, Samples::F32(vec![1.0, 0.0, 0.0, 0.0]));
        assert_eq!(clean(Path::new("a.npy"), &mut pixels).unwrap(), None);
    }
}
