//! Biases: one number per channel for every pixel, and their gradients.

use super::arithmetic::vectorised;

/// Sets every row of `out` (pixels, channels) to `bias` (channels).
pub fn fill_bias(bias: &[f32], out: &mut [f32]) {
    for row in out.chunks_exact_mut(bias.len()) {
        row.copy_from_slice(bias);
    }
}

vectorised! {
    /// Sets every row of `out` (pixels, channels) to that of `input` plus `bias` (channels).
    pub fn add_bias<'a>(bias: &'a [f32], input: &'a [f32], out: &'a mut [f32]) {
        let channels = bias.len();
        for (row, input) in out.chunks_exact_mut(channels).zip(input.chunks_exact(channels)) {
            for ((out, x), b) in row.iter_mut().zip(input).zip(bias) {
                *out = x + b;
            }
        }
    }
}

vectorised! {
    /// Adds the sums over the rows of `values` (pixels, channels) to `sums` (channels).
    pub fn column_sums<'a>(values: &'a [f32], sums: &'a mut [f32]) {
        let channels = sums.len();
        for row in values.chunks_exact(channels) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bias_is_added_to_every_pixel_and_its_gradient_is_the_sum() {
        let mut out = [0.0; 6];
        fill_bias(&[1.0, 2.0], &mut out);
        assert_eq!(out, [1.0, 2.0, 1.0, 2.0, 1.0, 2.0]);
        let mut shifted = [0.0; 6];
        add_bias(&[10.0, 20.0], &out, &mut shifted);
        assert_eq!(shifted, [11.0, 22.0, 11.0, 22.0, 11.0, 22.0]);
        let mut sums = [100.0, 0.0];
        column_sums(&shifted, &mut sums);
        assert_eq!(sums, [133.0, 66.0]);
    }
}
