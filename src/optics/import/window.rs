//! Part of a photograph that holds the light, and its resampling.

use ndarray::{Array2, ArrayView2, s};

use super::options::PixelRectangle;

/// Share of the light that the automatic window holds.
const HELD_SHARE: f64 = 0.99;
/// Standard deviations of the noise above which a pixel has light.
const FLOOR: f64 = 3.0;

/// The smallest square around the centroid that holds 99 % of the light, or the largest one where none does.
///
/// `image` has its dark level subtracted. Pixels of at most three standard deviations `sigma` of the noise have no
/// light. The side is a multiple of `bin` pixels where that fits. The square is moved where it would leave the image.
/// `None` without light.
pub(super) fn light_square(image: ArrayView2<'_, f32>, sigma: f64, bin: usize) -> Option<PixelRectangle> {
    let (rows, cols) = image.dim();
    // Sums of all pixels above and to the left.
    let mut sums = Array2::<f64>::zeros((rows + 1, cols + 1));
    let (mut by_row, mut by_col) = (0.0, 0.0);
    for ((row, col), &value) in image.indexed_iter() {
        let light = Some(f64::from(value)).filter(|&value| value > FLOOR * sigma).unwrap_or(0.0);
        by_row += light * row as f64;
        by_col += light * col as f64;
        sums[(row + 1, col + 1)] = light + sums[(row, col + 1)] + sums[(row + 1, col)] - sums[(row, col)];
    }
    let total = sums[(rows, cols)];
    if total <= 0.0 {
        return None;
    }
    let square = |side: usize| {
        let start = |centre: f64, length: usize| {
            ((centre - (side as f64 - 1.0) / 2.0).round().max(0.0) as usize).min(length - side)
        };
        PixelRectangle { top: start(by_row / total, rows), left: start(by_col / total, cols), rows: side, cols: side }
    };
    let held = |side: usize| {
        let PixelRectangle { top, left, .. } = square(side);
        sums[(top + side, left + side)] - sums[(top, left + side)] - sums[(top + side, left)] + sums[(top, left)]
    };
    // Larger squares hold the smaller ones, so that bisection finds the smallest.
    let (mut below, mut side) = (0, rows.min(cols));
    while side - below > 1 {
        let middle = usize::midpoint(below, side);
        if held(middle) >= HELD_SHARE * total { side = middle } else { below = middle }
    }
    let bin = bin.max(1);
    let most = rows.min(cols) / bin * bin;
    Some(square(if most == 0 { side } else { side.next_multiple_of(bin).min(most) }))
}

/// The central square of an image of these rows and columns.
pub(super) fn central_square(rows: usize, cols: usize) -> PixelRectangle {
    let side = rows.min(cols);
    PixelRectangle { top: (rows - side) / 2, left: (cols - side) / 2, rows: side, cols: side }
}

/// Sums over squares of `bin` pixels; rows and columns that fill none are left out.
pub(super) fn binned(image: ArrayView2<'_, f32>, bin: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    Array2::from_shape_fn((rows / bin, cols / bin), |(row, col)| {
        let square = image.slice(s![row * bin..(row + 1) * bin, col * bin..(col + 1) * bin]);
        square.iter().map(|&value| f64::from(value)).sum::<f64>() as f32
    })
}

/// An image resampled so that its longer side has `grid` pixels, each the mean of the square area that it covers. What
/// fills no pixel on the shorter side is left out, half of it at each end.
pub(super) fn resampled(image: ArrayView2<'_, f32>, grid: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let longest = rows.max(cols);
    let step = longest as f64 / grid as f64;
    // Share of source pixel `source` in target pixel `target` along one axis.
    let overlaps = |length: usize| {
        let count = (length * grid / longest).max(1);
        let start = if length == longest { 0.0 } else { (length as f64 - count as f64 * step) / 2.0 };
        Array2::from_shape_fn((count, length), |(target, source)| {
            let (from, to) = (start + target as f64 * step, start + (target + 1) as f64 * step);
            ((to.min(source as f64 + 1.0) - from.max(source as f64)).max(0.0) / step) as f32
        })
    };
    overlaps(rows).dot(&image).dot(&overlaps(cols).t())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_holds_the_light_and_not_the_noise() {
        let mut image = Array2::from_shape_fn((60, 80), |(row, col)| ((row * 7 + col * 5) % 3) as f32 - 1.0);
        for (row, col) in [(20, 30), (20, 39), (29, 30), (29, 39)] {
            image[(row, col)] = 900.0;
        }
        let found = light_square(image.view(), 1.0, 1).unwrap();
        assert_eq!(found, PixelRectangle { top: 20, left: 30, rows: 10, cols: 10 });
        let found = light_square(image.view(), 1.0, 4).unwrap();
        assert_eq!((found.rows, found.cols), (12, 12), "a multiple of the bin");
        // At the border the square stays inside.
        let mut corner = Array2::zeros((20, 30));
        corner[(1, 28)] = 1.0;
        corner[(9, 28)] = 1.0;
        let found = light_square(corner.view(), 0.0, 1).unwrap();
        assert_eq!((found.top, found.left, found.rows), (1, 21, 9));
        assert_eq!(light_square(Array2::zeros((5, 5)).view(), 0.0, 1), None);
    }

    #[test]
    fn bins_sum_and_areas_average() {
        let image = Array2::from_shape_fn((5, 7), |(row, col)| (row * 7 + col) as f32);
        let bins = binned(image.view(), 2);
        assert_eq!((bins.dim(), bins[(0, 0)], bins[(1, 2)]), ((2, 3), 16.0, 18.0 + 19.0 + 25.0 + 26.0));
        let wide = resampled(Array2::from_elem((48, 64), 2.0).view(), 32);
        assert_eq!(wide.dim(), (24, 32));
        assert!(wide.iter().all(|value| (value - 2.0).abs() < 1e-5));
        let large = resampled(Array2::from_elem((3, 3), 2.0).view(), 7);
        assert!(large.iter().all(|value| (value - 2.0).abs() < 1e-5));
    }

    #[test]
    fn resampling_keeps_the_place() {
        let mut image = Array2::zeros((60, 60));
        image[(30, 45)] = 36.0;
        let small = resampled(image.view(), 10);
        assert!((small[(5, 7)] - 1.0).abs() < 1e-6, "a 6x6 block with 36 has mean 1");
        assert!((small.sum() - 1.0).abs() < 1e-6);
    }
}
