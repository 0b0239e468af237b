//! Root-mean-square normalisation of the channels of a pixel.

use crate::nn::kernels::arithmetic::vectorised;

/// Added to the mean square, so that pixels whose channels are all 0 stay finite.
const EPSILON: f32 = 1e-4;

vectorised! {
    /// `out = gain x / rms(x)` (Zhang and Sennrich 2019) for each pixel of `input` (pixels, channels).
    ///
    /// `inverses` (pixels) keeps 1 / rms for [`rms_norm_backward`]; `gain` is (channels).
    pub fn rms_norm<'a>(input: &'a [f32], gain: &'a [f32], inverses: &'a mut [f32], out: &'a mut [f32]) {
        let channels = gain.len();
        let rows = input.chunks_exact(channels).zip(out.chunks_exact_mut(channels));
        for ((row, out), inverse) in rows.zip(inverses) {
            *inverse = 1.0 / (dot(row, row) / channels as f32 + EPSILON).sqrt();
            for ((x, gain), out) in row.iter().zip(gain).zip(out) {
                *out = x * *inverse * gain;
            }
        }
    }
}

vectorised! {
    /// Adds the gradient of [`rms_norm`] by its input to `by_input` (pixels, channels), and that by the gain to
    /// `by_gain` (channels), from the gradient by its output (pixels, channels).
    pub fn rms_norm_backward<'a>(
        input: &'a [f32],
        gain: &'a [f32],
        inverses: &'a [f32],
        gradient: &'a [f32],
        by_input: &'a mut [f32],
        by_gain: &'a mut [f32],
    ) {
        let channels = gain.len();
        let rows = input.chunks_exact(channels).zip(gradient.chunks_exact(channels));
        for (((row, gradient), by_row), inverse) in rows.zip(by_input.chunks_exact_mut(channels)).zip(inverses) {
            let mut lanes = [0.0_f32; LANES];
            let (xs, gs, ks) = (row.as_chunks::<LANES>(), gradient.as_chunks::<LANES>(), gain.as_chunks::<LANES>());
            for ((x, g), k) in xs.0.iter().zip(gs.0).zip(ks.0) {
                for (lane, ((x, g), k)) in lanes.iter_mut().zip(x.iter().zip(g).zip(k)) {
                    *lane += x * g * k;
                }
            }
            let rest: f32 = xs.1.iter().zip(gs.1).zip(ks.1).map(|((x, g), k)| x * g * k).sum();
            let pull = (lanes.iter().sum::<f32>() + rest) * inverse * inverse / channels as f32;
            let values = row.iter().zip(gradient).zip(gain);
            for (((x, g), k), (by_row, by_gain)) in values.zip(by_row.iter_mut().zip(by_gain.iter_mut())) {
                *by_row += inverse * (g * k - x * pull);
                *by_gain += g * x * inverse;
            }
        }
    }
}

/// Numbers summed side by side.
const LANES: usize = 8;

#[inline(always)]
#[allow(clippy::inline_always, reason = "called in the loops over pixels")]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a_lanes, a_rest) = a.as_chunks::<LANES>();
    let (b_lanes, b_rest) = b.as_chunks::<LANES>();
    let mut lanes = [0.0_f32; LANES];
    for (a, b) in a_lanes.iter().zip(b_lanes) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    lanes.iter().sum::<f32>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plainly(row: &[f64], gain: &[f64], cotangent: &[f64]) -> f64 {
        let rms = (row.iter().map(|x| x * x).sum::<f64>() / row.len() as f64 + f64::from(EPSILON)).sqrt();
        row.iter().zip(gain).zip(cotangent).map(|((x, k), c)| c * k * x / rms).sum()
    }

    #[test]
    fn the_norm_and_its_gradients_are_those_of_the_formula() {
        let channels = 11;
        let numbers = |seed: usize| -> Vec<f64> {
            (0..channels).map(|i| ((i * 37 + seed * 11) % 101) as f64 * 0.04 - 2.0).collect()
        };
        let (row, gain, cotangent) = (numbers(1), numbers(2), numbers(3));
        let single = |values: &[f64]| -> Vec<f32> { values.iter().map(|&x| x as f32).collect() };
        let (mut inverse, mut out) = ([0.0], vec![0.0; channels]);
        rms_norm(&single(&row), &single(&gain), &mut inverse, &mut out);
        let found: f64 = out.iter().zip(&cotangent).map(|(y, c)| f64::from(*y) * c).sum();
        assert!((found - plainly(&row, &gain, &cotangent)).abs() < 1e-5);
        let (mut by_row, mut by_gain) = (vec![1.0; channels], vec![2.0; channels]);
        let gradient = single(&cotangent);
        rms_norm_backward(&single(&row), &single(&gain), &inverse, &gradient, &mut by_row, &mut by_gain);
        for i in 0..channels {
            let moved = |values: &[f64], by: f64| {
                let mut values = values.to_vec();
                values[i] += by;
                values
            };
            let slope = |f: &dyn Fn(f64) -> f64| (f(1e-5) - f(-1e-5)) / 2e-5;
            let expected = slope(&|by| plainly(&moved(&row, by), &gain, &cotangent));
            assert!((f64::from(by_row[i]) - 1.0 - expected).abs() < 1e-4, "{i}: {} {expected}", by_row[i]);
            let expected = slope(&|by| plainly(&row, &moved(&gain, by), &cotangent));
            assert!((f64::from(by_gain[i]) - 2.0 - expected).abs() < 1e-4);
        }
    }
}
