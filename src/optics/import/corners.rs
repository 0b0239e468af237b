//! Grey values in the corners of an image, where a PSF has no light.

use ndarray::{ArrayView2, s};

/// Share of each side that a corner takes.
const CORNER_SHARE: usize = 16;
/// Median absolute deviation of a standard normal number.
const MEDIAN_DEVIATION: f64 = 0.674_489_75;

/// Grey values in the four corners of an image, each a sixteenth of the sides.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CornerLevel {
    /// Their median, DN.
    pub median: f64,
    /// Their standard deviation, from the median absolute deviation, DN.
    pub sigma: f64,
}

impl CornerLevel {
    /// Level of an image, shape (rows, cols); zeros for an empty one.
    pub fn of(image: ArrayView2<'_, f32>) -> Self {
        let (rows, cols) = image.dim();
        let (height, width) = (rows.div_ceil(CORNER_SHARE), cols.div_ceil(CORNER_SHARE));
        let corners = [(0, 0), (0, cols - width), (rows - height, 0), (rows - height, cols - width)];
        let part = |(row, col)| image.slice_move(s![row..row + height, col..col + width]).into_iter().copied();
        let mut values: Vec<f32> = corners.into_iter().flat_map(part).collect();
        let median = upper_median(&mut values);
        let mut deviations: Vec<f32> = values.iter().map(|value| (f64::from(*value) - median).abs() as f32).collect();
        Self { median, sigma: upper_median(&mut deviations) / MEDIAN_DEVIATION }
    }
}

/// The median; the upper one of an even number of values. 0 without values.
fn upper_median(values: &mut [f32]) -> f64 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).map_or(0.0, |&value| f64::from(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn median_and_deviation_are_those_of_the_corners_alone() {
        let mut image = Array2::from_elem((64, 48), 900.0);
        for (row, col) in (0..4).flat_map(|row| (0..3).map(move |col| (row, col))) {
            for (row, col) in [(row, col), (row, 47 - col), (63 - row, col), (63 - row, 47 - col)] {
                image[(row, col)] = if (row + col) % 2 == 0 { 99.0 } else { 101.0 };
            }
        }
        image[(0, 0)] = 5000.0;
        let CornerLevel { median, sigma } = CornerLevel::of(image.view());
        assert!((99.0..=101.0).contains(&median) && sigma < 3.0, "{median} {sigma}");
        assert_eq!(CornerLevel::of(Array2::zeros((0, 3)).view()), CornerLevel::default());
    }
}
