//! Maxima of squares of 2 x 2 px, and their gradient.

use crate::nn::kernels::arithmetic::vectorised;
use crate::nn::kernels::elementwise::{each, elementwise};

elementwise!(Largest, 4 => 1, |[a, b, c, d], _| [a.max(b).max(c.max(d))]);
elementwise!(ToLargest, 5 => 4, |[a, b, c, d, gradient], [by_a, by_b, by_c, by_d]| {
    // Among equals the first in the order of rows, as in `PyTorch`.
    let is_a = a >= b && a >= c && a >= d;
    let is_b = !is_a && b >= c && b >= d;
    let is_c = !is_a && !is_b && c >= d;
    [
        by_a + if is_a { gradient } else { 0.0 },
        by_b + if is_b { gradient } else { 0.0 },
        by_c + if is_c { gradient } else { 0.0 },
        by_d + if is_a || is_b || is_c { 0.0 } else { gradient },
    ]
});

vectorised! {
    /// Largest value of each square of 2 x 2 px of `input` (rows, cols, channels), sides even; `out` is (rows / 2, cols / 2, channels).
    pub fn max_pool<'a>(input: &'a [f32], cols: usize, channels: usize, out: &'a mut [f32]) {
        let (row, pixel) = (cols * channels, 2 * channels);
        for (input, out) in input.chunks_exact(2 * row).zip(out.chunks_exact_mut(row / 2)) {
            let (upper, lower) = input.split_at(row);
            let squares = upper.chunks_exact(pixel).zip(lower.chunks_exact(pixel));
            for ((upper, lower), out) in squares.zip(out.chunks_exact_mut(channels)) {
                let ((a, b), (c, d)) = (upper.split_at(channels), lower.split_at(channels));
                each(&Largest, [a, b, c, d], [out]);
            }
        }
    }
}

vectorised! {
    /// Adds the gradient of [`max_pool`] to `by_input` (rows, cols, channels), from its input and the gradient by its output.
    pub fn max_pool_backward<'a>(
        input: &'a [f32],
        cols: usize,
        channels: usize,
        by_output: &'a [f32],
        by_input: &'a mut [f32],
    ) {
        let (row, pixel) = (cols * channels, 2 * channels);
        let rows = input.chunks_exact(2 * row).zip(by_output.chunks_exact(row / 2));
        for ((input, by_output), by_input) in rows.zip(by_input.chunks_exact_mut(2 * row)) {
            let ((upper, lower), (by_upper, by_lower)) = (input.split_at(row), by_input.split_at_mut(row));
            let squares = upper.chunks_exact(pixel).zip(lower.chunks_exact(pixel));
            let by_squares = by_upper.chunks_exact_mut(pixel).zip(by_lower.chunks_exact_mut(pixel));
            for (((upper, lower), gradient), (by_upper, by_lower)) in
                squares.zip(by_output.chunks_exact(channels)).zip(by_squares)
            {
                let ((a, b), (c, d)) = (upper.split_at(channels), lower.split_at(channels));
                let ((by_a, by_b), (by_c, by_d)) = (by_upper.split_at_mut(channels), by_lower.split_at_mut(channels));
                each(&ToLargest, [a, b, c, d, gradient], [by_a, by_b, by_c, by_d]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_give_their_largest_value_and_its_gradient() {
        // Two channels; the second one has ties.
        let input = [1.0, 0.0, 2.0, 0.0, -5.0, 7.0, -4.0, 7.0, 4.0, 0.0, 3.0, 0.0, -7.0, 6.0, -6.0, 7.0];
        let mut out = [f32::NAN; 4];
        max_pool(&input, 4, 2, &mut out);
        assert_eq!(out, [4.0, 0.0, -4.0, 7.0]);
        let mut by_input = [1.0; 16];
        max_pool_backward(&input, 4, 2, &[10.0, 20.0, 30.0, 40.0], &mut by_input);
        let mut expected = [1.0; 16];
        (expected[8], expected[1], expected[6], expected[5]) = (11.0, 21.0, 31.0, 41.0);
        assert_eq!(by_input, expected);
    }
}
