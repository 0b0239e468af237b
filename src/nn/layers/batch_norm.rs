//! Batch normalisation followed by a rectified linear unit, and its gradient.
//!
//! A channel is normalised by its mean and variance over all pixels of all samples (Ioffe and Szegedy 2015). The sums over a
//! sample are separate functions, so that callers split samples between threads and add their sums in a fixed order.

use std::ops::Range;

use crate::nn::kernels::arithmetic::vectorised;
use crate::nn::kernels::elementwise::{each, elementwise};

/// Added to a variance before its root.
pub const BATCH_NORM_EPSILON: f64 = 1e-4;
/// Share of a batch in the running statistics.
const MOMENTUM: f64 = 0.1;
/// Pixels that are summed in single precision.
const PIXELS_TOGETHER: usize = 32;

/// Places of the numbers of a batch normalisation among the weights of a network, each (channels).
#[derive(Clone, Debug)]
pub struct BatchNorm {
    /// Factors of normalised channels.
    pub gain: Range<usize>,
    /// Numbers added to them.
    pub shift: Range<usize>,
    /// Running means; no parameters of an optimizer.
    pub mean: Range<usize>,
    /// Running variances, unbiased; no parameters of an optimizer.
    pub variance: Range<usize>,
}

/// Two sums over pixels for each channel.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelSums {
    /// Sums of values, or of gradients.
    pub first: Vec<f64>,
    /// Sums of squared values, or of gradients times distances from the mean.
    pub second: Vec<f64>,
}

impl ChannelSums {
    /// Zeros.
    pub fn new(channels: usize) -> Self {
        Self { first: vec![0.0; channels], second: vec![0.0; channels] }
    }

    /// Adds the sums of other pixels.
    pub fn add(&mut self, other: &Self) {
        self.first.iter_mut().zip(&other.first).for_each(|(sum, value)| *sum += value);
        self.second.iter_mut().zip(&other.second).for_each(|(sum, value)| *sum += value);
    }

    /// Adds single-precision sums, and sets these to zero.
    fn take(&mut self, first: &mut [f32], second: &mut [f32]) {
        for (sums, values) in [(&mut self.first, first), (&mut self.second, second)] {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += f64::from(std::mem::take(value));
            }
        }
    }
}

/// A batch normalisation with known mean and variance: `out = max(0, scale x + offset)`.
#[derive(Clone, Debug)]
pub struct NormRelu {
    mean: Vec<f32>,
    /// 1 / standard deviation.
    inverse: Vec<f32>,
    scale: Vec<f32>,
    offset: Vec<f32>,
}

impl BatchNorm {
    /// The normalisation of a batch, from the [`moment_sums`] of its `pixels`. Moves the running statistics towards it.
    pub fn of_batch(&self, sums: &ChannelSums, pixels: usize, weights: &mut [f32]) -> NormRelu {
        let count = pixels as f64;
        let mean: Vec<f64> = sums.first.iter().map(|sum| sum / count).collect();
        let squares = sums.second.iter().zip(&mean);
        let variance: Vec<f64> = squares.map(|(sum, mean)| (sum / count - mean * mean).max(0.0)).collect();
        let unbiased = count / (count - 1.0).max(1.0);
        let mut follow = |place: &Range<usize>, values: &[f64], factor: f64| {
            for (running, value) in weights[place.clone()].iter_mut().zip(values) {
                *running = (f64::from(*running) * (1.0 - MOMENTUM) + MOMENTUM * factor * value) as f32;
            }
        };
        follow(&self.mean, &mean, 1.0);
        follow(&self.variance, &variance, unbiased);
        self.with_moments(&mean, &variance, weights)
    }

    /// The normalisation by running statistics.
    pub fn of_running(&self, weights: &[f32]) -> NormRelu {
        let wide = |place: &Range<usize>| weights[place.clone()].iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
        self.with_moments(&wide(&self.mean), &wide(&self.variance), weights)
    }

    fn with_moments(&self, mean: &[f64], variance: &[f64], weights: &[f32]) -> NormRelu {
        let (gain, shift) = (&weights[self.gain.clone()], &weights[self.shift.clone()]);
        let inverse: Vec<f64> = variance.iter().map(|variance| 1.0 / (variance + BATCH_NORM_EPSILON).sqrt()).collect();
        let scale: Vec<f64> = inverse.iter().zip(gain).map(|(inverse, &gain)| inverse * f64::from(gain)).collect();
        let offset = shift.iter().zip(mean.iter().zip(&scale));
        let offset = offset.map(|(&shift, (mean, scale))| (f64::from(shift) - mean * scale) as f32).collect();
        let narrow = |values: &[f64]| values.iter().map(|&value| value as f32).collect();
        NormRelu { mean: narrow(mean), inverse: narrow(&inverse), scale: narrow(&scale), offset }
    }

    /// Writes the gradients by gain and shift to their places in `gradient`, from the [`NormRelu::gradient_sums`] of a batch.
    pub fn by_weights(&self, norm: &NormRelu, sums: &ChannelSums, gradient: &mut [f32]) {
        let by_gain = sums.second.iter().zip(&norm.inverse).map(|(sum, &inverse)| sum * f64::from(inverse));
        gradient[self.gain.clone()].iter_mut().zip(by_gain).for_each(|(to, value)| *to = value as f32);
        gradient[self.shift.clone()].iter_mut().zip(&sums.first).for_each(|(to, &value)| *to = value as f32);
    }
}

/// Sums of values and of their squares over `values` (pixels, channels).
pub fn moment_sums(values: &[f32], channels: usize) -> ChannelSums {
    let mut sums = ChannelSums::new(channels);
    let (mut first, mut second) = (vec![0.0; channels], vec![0.0; channels]);
    for pixels in values.chunks(PIXELS_TOGETHER * channels) {
        add_moments(pixels, &mut first, &mut second);
        sums.take(&mut first, &mut second);
    }
    sums
}

impl NormRelu {
    /// Normalises and rectifies `input` (pixels, channels).
    pub fn forward(&self, input: &[f32], out: &mut [f32]) {
        forward(input, &self.scale, &self.offset, out);
    }

    /// Sums of gradients, and of gradients times distances from the mean, where the output is above 0. `input` and `by_output`
    /// are (pixels, channels).
    pub fn gradient_sums(&self, input: &[f32], by_output: &[f32]) -> ChannelSums {
        let channels = self.mean.len();
        let mut sums = ChannelSums::new(channels);
        let (mut first, mut second) = (vec![0.0; channels], vec![0.0; channels]);
        let together = PIXELS_TOGETHER * channels;
        for (input, by_output) in input.chunks(together).zip(by_output.chunks(together)) {
            add_gradients(input, by_output, [&self.scale, &self.offset, &self.mean], &mut first, &mut second);
            sums.take(&mut first, &mut second);
        }
        sums
    }

    /// Turns the gradient by the output of a sample into that by its input, in a batch of `pixels` with these gradient sums.
    pub fn backward(&self, sums: &ChannelSums, pixels: usize, input: &[f32], gradient: &mut [f32]) {
        let count = pixels as f64;
        // scale (g - mean(g) - x' mean(g x')), with x' = (x - mean) inverse, as a linear function of g and x.
        let per_input = sums.second.iter().zip(self.scale.iter().zip(&self.inverse));
        let per_input: Vec<f64> = per_input
            .map(|(sum, (&scale, &inverse))| -f64::from(scale) * f64::from(inverse).powi(2) * sum / count)
            .collect();
        let constant = sums.first.iter().zip(&self.scale).zip(self.mean.iter().zip(&per_input));
        let constant: Vec<f32> = constant
            .map(|((sum, &scale), (&mean, per_input))| {
                (-f64::from(scale) * sum / count - per_input * f64::from(mean)) as f32
            })
            .collect();
        let per_input: Vec<f32> = per_input.into_iter().map(|value| value as f32).collect();
        backward(input, [&self.scale, &self.offset, &per_input, &constant], gradient);
    }
}

elementwise!(Moments, 1 => 2, |[x], [sum, squares]| [sum + x, squares + x * x]);
elementwise!(Forward, 3 => 1, |[x, scale, offset], _| [(x * scale + offset).max(0.0)]);
elementwise!(Gradients, 5 => 2, |[x, gradient, scale, offset, mean], [sum, products]| {
    let gradient = if x * scale + offset > 0.0 { gradient } else { 0.0 };
    [sum + gradient, products + gradient * (x - mean)]
});
elementwise!(Backward, 5 => 1, |[x, scale, offset, per_input, constant], [gradient]| {
    let gradient = if x * scale + offset > 0.0 { gradient } else { 0.0 };
    [scale * gradient + (per_input * x + constant)]
});

vectorised! {
    fn add_moments<'a>(values: &'a [f32], first: &'a mut [f32], second: &'a mut [f32]) {
        for pixel in values.chunks_exact(first.len()) {
            each(&Moments, [pixel], [first, second]);
        }
    }
}

vectorised! {
    fn forward<'a>(input: &'a [f32], scale: &'a [f32], offset: &'a [f32], out: &'a mut [f32]) {
        let channels = scale.len();
        for (input, out) in input.chunks_exact(channels).zip(out.chunks_exact_mut(channels)) {
            each(&Forward, [input, scale, offset], [out]);
        }
    }
}

vectorised! {
    fn add_gradients<'a>(
        input: &'a [f32],
        by_output: &'a [f32],
        numbers: [&'a [f32]; 3],
        first: &'a mut [f32],
        second: &'a mut [f32],
    ) {
        let [scale, offset, mean] = numbers;
        let channels = mean.len();
        for (input, by_output) in input.chunks_exact(channels).zip(by_output.chunks_exact(channels)) {
            each(&Gradients, [input, by_output, scale, offset, mean], [first, second]);
        }
    }
}

vectorised! {
    fn backward<'a>(input: &'a [f32], numbers: [&'a [f32]; 4], gradient: &'a mut [f32]) {
        let [scale, offset, per_input, constant] = numbers;
        let channels = scale.len();
        for (input, gradient) in input.chunks_exact(channels).zip(gradient.chunks_exact_mut(channels)) {
            each(&Backward, [input, scale, offset, per_input, constant], [gradient]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::test_numbers::numbers;

    const CHANNELS: usize = 27;
    const NORM: BatchNorm = BatchNorm {
        gain: 0..CHANNELS,
        shift: CHANNELS..2 * CHANNELS,
        mean: 2 * CHANNELS..3 * CHANNELS,
        variance: 3 * CHANNELS..4 * CHANNELS,
    };

    fn wide(values: &[f32]) -> Vec<f64> {
        values.iter().map(|&value| f64::from(value)).collect()
    }

    /// The layer by its definition: outputs, means and variances.
    fn expected(input: &[f64], weights: &[f64]) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let pixels = input.len() / CHANNELS;
        let of_channel = |c: usize| input[c..].iter().step_by(CHANNELS);
        let mean: Vec<f64> = (0..CHANNELS).map(|c| of_channel(c).sum::<f64>() / pixels as f64).collect();
        let variance = |c: usize| of_channel(c).map(|x| (x - mean[c]).powi(2)).sum::<f64>() / pixels as f64;
        let variance: Vec<f64> = (0..CHANNELS).map(variance).collect();
        let out = input.iter().enumerate().map(|(at, x)| {
            let c = at % CHANNELS;
            ((x - mean[c]) / (variance[c] + 1e-4).sqrt() * weights[c] + weights[CHANNELS + c]).max(0.0)
        });
        (out.collect(), mean, variance)
    }

    #[test]
    fn batch_is_normalised_by_its_own_statistics_and_gradients_are_differences() {
        let (pixels, half) = (70, 30 * CHANNELS);
        let input: Vec<f32> = numbers(pixels * CHANNELS, 1).iter().map(|x| 3.0 + 0.5 * x).collect();
        let mut weights = numbers(4 * CHANNELS, 2);
        let before = weights.clone();
        // Two samples, of 30 and 40 pixels.
        let (first, second) = input.split_at(half);
        let mut sums = moment_sums(first, CHANNELS);
        sums.add(&moment_sums(second, CHANNELS));
        let norm = NORM.of_batch(&sums, pixels, &mut weights);
        let mut out = vec![f32::NAN; input.len()];
        norm.forward(&input, &mut out);
        let (values, mean, variance) = expected(&wide(&input), &wide(&weights));
        assert!(out.iter().zip(&values).all(|(found, expected)| (f64::from(*found) - expected).abs() < 2e-5));
        for c in 0..CHANNELS {
            let (of_mean, of_variance) = (NORM.mean.start + c, NORM.variance.start + c);
            let follow = |before: f32, batch: f64| 0.9 * f64::from(before) + 0.1 * batch;
            assert!((f64::from(weights[of_mean]) - follow(before[of_mean], mean[c])).abs() < 1e-6);
            let unbiased = variance[c] * 70.0 / 69.0;
            assert!((f64::from(weights[of_variance]) - follow(before[of_variance], unbiased)).abs() < 1e-6);
        }
        assert_eq!(weights[..2 * CHANNELS], before[..2 * CHANNELS]);

        let by_output = numbers(input.len(), 3);
        let mut sums = norm.gradient_sums(first, &by_output[..half]);
        sums.add(&norm.gradient_sums(second, &by_output[half..]));
        let mut by_weights = vec![0.0; 2 * CHANNELS];
        NORM.by_weights(&norm, &sums, &mut by_weights);
        let mut by_input = by_output.clone();
        norm.backward(&sums, pixels, first, &mut by_input[..half]);
        norm.backward(&sums, pixels, second, &mut by_input[half..]);
        let loss = |input: &[f64], weights: &[f64]| -> f64 {
            expected(input, weights).0.iter().zip(&by_output).map(|(value, by)| value * f64::from(*by)).sum()
        };
        let (input, weights) = (wide(&input), wide(&weights));
        let difference = |values: &[f64], at: usize, of: &dyn Fn(&[f64]) -> f64| {
            let moved = |by: f64| {
                let mut values = values.to_vec();
                values[at] += by;
                of(&values)
            };
            (moved(1e-6) - moved(-1e-6)) / 2e-6
        };
        for at in (0..input.len()).step_by(101) {
            let expected = difference(&input, at, &|input| loss(input, &weights));
            assert!((f64::from(by_input[at]) - expected).abs() < 1e-4, "{at}: {} {expected}", by_input[at]);
        }
        for (at, found) in by_weights.iter().enumerate() {
            let expected = difference(&weights, at, &|weights| loss(&input, weights));
            assert!((f64::from(*found) - expected).abs() < 1e-4, "{at}: {found} {expected}");
        }
    }

    #[test]
    fn running_statistics_normalise_each_pixel_alone() {
        let mut weights = numbers(4 * CHANNELS, 4);
        weights[NORM.variance].iter_mut().for_each(|variance| *variance = variance.abs());
        let input = numbers(3 * CHANNELS, 5);
        let mut out = vec![f32::NAN; input.len()];
        NORM.of_running(&weights).forward(&input, &mut out);
        for (at, found) in out.iter().enumerate() {
            let [gain, shift, mean, variance] =
                std::array::from_fn(|k| f64::from(weights[k * CHANNELS + at % CHANNELS]));
            let expected = ((f64::from(input[at]) - mean) / (variance + 1e-4).sqrt() * gain + shift).max(0.0);
            assert!((f64::from(*found) - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}
