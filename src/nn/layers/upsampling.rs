//! Bilinear upsampling by two, concatenation of channels, and their gradients.

use crate::nn::kernels::arithmetic::vectorised;
use crate::nn::kernels::elementwise::{Elementwise, each, elementwise};

/// Weight of the input pixel that an output pixel lies in, and of its neighbour on the nearer side.
const NEAR: f32 = 0.75;
const FAR: f32 = 0.25;

elementwise!(Blend, 2 => 1, |[near, far], _| [NEAR * near + FAR * far]);

/// `to += weight * from`.
struct AddScaled(f32);

impl Elementwise<1, 1> for AddScaled {
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "loops around it become vector code only when it is inlined")]
    fn apply(&self, [from]: [f32; 1], [to]: [f32; 1]) -> [f32; 1] {
        [to + self.0 * from]
    }
}

/// Neighbour of pixel `at / 2` on the side of output pixel `at`, or the pixel itself at an edge of `count` pixels.
fn neighbour(at: usize, count: usize) -> usize {
    if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { (at / 2 + 1).min(count - 1) }
}

vectorised! {
    /// Doubles both sides of `input` (rows, cols, channels) by bilinear interpolation between pixel centres; `out` is
    /// (2 rows, 2 cols, channels). Outside the image lies its edge: `align_corners` is false in `PyTorch`'s words.
    pub fn upsample<'a>(input: &'a [f32], cols: usize, channels: usize, out: &'a mut [f32]) {
        let length = cols * channels;
        let rows = input.len() / length;
        let mut blended = vec![0.0; length];
        let line = |row: usize| &input[row * length..(row + 1) * length];
        for (row, out) in out.chunks_exact_mut(2 * length).enumerate() {
            each(&Blend, [line(row / 2), line(neighbour(row, rows))], [&mut blended]);
            let pixel = |col: usize| &blended[col * channels..(col + 1) * channels];
            for (col, out) in out.chunks_exact_mut(channels).enumerate() {
                each(&Blend, [pixel(col / 2), pixel(neighbour(col, cols))], [out]);
            }
        }
    }
}

vectorised! {
    /// Writes the gradient of [`upsample`] by its input (rows, cols, channels), from that by its output.
    pub fn upsample_backward<'a>(by_output: &'a [f32], cols: usize, channels: usize, by_input: &'a mut [f32]) {
        let length = cols * channels;
        let rows = by_input.len() / length;
        by_input.fill(0.0);
        let mut narrow = vec![0.0; length];
        for (row, by_output) in by_output.chunks_exact(2 * length).enumerate() {
            narrow.fill(0.0);
            for (col, gradient) in by_output.chunks_exact(channels).enumerate() {
                for (to, weight) in [(col / 2, NEAR), (neighbour(col, cols), FAR)] {
                    each(&AddScaled(weight), [gradient], [&mut narrow[to * channels..(to + 1) * channels]]);
                }
            }
            for (to, weight) in [(row / 2, NEAR), (neighbour(row, rows), FAR)] {
                each(&AddScaled(weight), [&narrow], [&mut by_input[to * length..(to + 1) * length]]);
            }
        }
    }
}

/// Sets every row of `out` (pixels, first and second channels) to those of `first` and `second`, the former of `channels`.
pub fn concatenate(first: &[f32], channels: usize, second: &[f32], out: &mut [f32]) {
    let others = second.len() / (first.len() / channels);
    let rows = first.chunks_exact(channels).zip(second.chunks_exact(others));
    for (out, (first, second)) in out.chunks_exact_mut(channels + others).zip(rows) {
        let (out_first, out_second) = out.split_at_mut(channels);
        out_first.copy_from_slice(first);
        out_second.copy_from_slice(second);
    }
}

/// The reverse of [`concatenate`].
pub fn split_channels(joined: &[f32], first: &mut [f32], channels: usize, second: &mut [f32]) {
    let others = second.len() / (first.len() / channels);
    let rows = first.chunks_exact_mut(channels).zip(second.chunks_exact_mut(others));
    for (joined, (first, second)) in joined.chunks_exact(channels + others).zip(rows) {
        first.copy_from_slice(&joined[..channels]);
        second.copy_from_slice(&joined[channels..]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::test_numbers::numbers;

    #[test]
    fn upsampling_interpolates_between_pixel_centres() {
        for (rows, cols, channels) in [(3, 4, 2), (1, 1, 3), (2, 5, 17)] {
            let input = numbers(rows * cols * channels, 1);
            let mut out = vec![f32::NAN; 4 * input.len()];
            upsample(&input, cols, channels, &mut out);
            for (at, found) in out.iter().enumerate() {
                let (pixel, channel) = (at / channels, at % channels);
                // Output pixel i lies at (i + 1/2) / 2 - 1/2 of the input.
                let place = |at: usize, count: usize| {
                    let place = (at as f64 / 2.0 - 0.25).clamp(0.0, count as f64 - 1.0);
                    (place as usize, (place as usize + 1).min(count - 1), place.fract())
                };
                let (top, bottom, down) = place(pixel / (2 * cols), rows);
                let (left, right, along) = place(pixel % (2 * cols), cols);
                let value = |row: usize, col: usize| f64::from(input[(row * cols + col) * channels + channel]);
                let upper = value(top, left) * (1.0 - along) + value(top, right) * along;
                let lower = value(bottom, left) * (1.0 - along) + value(bottom, right) * along;
                let expected = upper * (1.0 - down) + lower * down;
                assert!((f64::from(*found) - expected).abs() < 1e-6, "{at}: {found} {expected}");
            }
            // The map is linear: its gradient is its transpose.
            let by_output = numbers(out.len(), 2);
            let mut by_input = vec![f32::NAN; input.len()];
            upsample_backward(&by_output, cols, channels, &mut by_input);
            for at in 0..input.len() {
                let mut unit = vec![0.0; input.len()];
                unit[at] = 1.0;
                upsample(&unit, cols, channels, &mut out);
                let expected: f32 = out.iter().zip(&by_output).map(|(a, b)| a * b).sum();
                assert!((by_input[at] - expected).abs() < 1e-5, "{at}");
            }
        }
    }

    #[test]
    fn channels_are_joined_and_split() {
        let mut joined = [0.0; 6];
        concatenate(&[1.0, 2.0], 1, &[3.0, 4.0, 5.0, 6.0], &mut joined);
        assert_eq!(joined, [1.0, 3.0, 4.0, 2.0, 5.0, 6.0]);
        let (mut first, mut second) = ([0.0; 2], [0.0; 4]);
        split_channels(&joined, &mut first, 1, &mut second);
        assert_eq!((first, second), ([1.0, 2.0], [3.0, 4.0, 5.0, 6.0]));
    }
}
