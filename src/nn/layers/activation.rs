//! Activations and their derivatives, fused into one pass over the channels.

use crate::nn::kernels::arithmetic::{exponential, vectorised};
use crate::nn::kernels::elementwise::{each, elementwise};

elementwise!(Gate<FUSED>, 2 => 3, |[a, b], _| {
    let tanh = 2.0 / (1.0 + exponential::<FUSED>(-2.0 * a)) - 1.0;
    let sigmoid = 1.0 / (1.0 + exponential::<FUSED>(-b));
    [tanh, sigmoid, tanh * sigmoid]
});
elementwise!(GateBackward, 3 => 2, |[t, s, gradient], _| {
    [gradient * s * (1.0 - t * t), gradient * t * s * (1.0 - s)]
});
elementwise!(Elu<FUSED>, 1 => 1, |[x], _| {
    let below = exponential::<FUSED>(x.min(0.0)) - 1.0;
    [if x > 0.0 { x } else { below }]
});
elementwise!(EluBackward, 1 => 1, |[y], [gradient]| [gradient * (1.0 + y.min(0.0))]);
elementwise!(Glu<FUSED>, 2 => 2, |[a, b], _| {
    let sigmoid = 1.0 / (1.0 + exponential::<FUSED>(-b));
    [sigmoid, a * sigmoid]
});
elementwise!(GluBackward, 3 => 2, |[s, y, gradient], _| [gradient * s, gradient * y * (1.0 - s)]);
elementwise!(Silu<FUSED>, 1 => 1, |[x], _| [x / (1.0 + exponential::<FUSED>(-x))]);
elementwise!(SiluPlus<FUSED>, 2 => 1, |[x, other], _| [x / (1.0 + exponential::<FUSED>(-x)) + other]);
elementwise!(SiluBackward<FUSED>, 1 => 1, |[x], [gradient]| {
    let s = 1.0 / (1.0 + exponential::<FUSED>(-x));
    [gradient * (s * (1.0 + x * (1.0 - s)))]
});

vectorised! {
    /// Gated activation (van den Oord et al. 2016): `out = tanh(a) sigmoid(b)` where a and b are the first and second half
    /// of the channels of `features` (pixels, 2 channels).
    ///
    /// `factors` (pixels, 2 channels) keeps tanh and sigmoid for [`gate_backward`]; `out` is (pixels, channels).
    pub fn gate<'a, fused FUSED>(features: &'a [f32], channels: usize, factors: &'a mut [f32], out: &'a mut [f32]) {
        let wide = 2 * channels;
        let rows = features.chunks_exact(wide).zip(factors.chunks_exact_mut(wide)).zip(out.chunks_exact_mut(channels));
        for ((feature, factor), out) in rows {
            let (a, b) = feature.split_at(channels);
            let (tanh, sigmoid) = factor.split_at_mut(channels);
            each(&Gate::<FUSED>, [a, b], [tanh, sigmoid, out]);
        }
    }
}

vectorised! {
    /// Gradient of [`gate`] by its features, from the gradient by its output (pixels, channels).
    pub fn gate_backward<'a>(factors: &'a [f32], channels: usize, gradient: &'a [f32], features: &'a mut [f32]) {
        let wide = 2 * channels;
        let rows = factors.chunks_exact(wide).zip(gradient.chunks_exact(channels)).zip(features.chunks_exact_mut(wide));
        for ((factor, gradient), out) in rows {
            let (tanh, sigmoid) = factor.split_at(channels);
            let (by_a, by_b) = out.split_at_mut(channels);
            each(&GateBackward, [tanh, sigmoid, gradient], [by_a, by_b]);
        }
    }
}

vectorised! {
    /// Exponential linear unit (Clevert et al. 2016): x above 0, `e^x - 1` below.
    pub fn elu<'a, fused FUSED>(input: &'a [f32], out: &'a mut [f32]) {
        each(&Elu::<FUSED>, [input], [out]);
    }
}

vectorised! {
    /// Multiplies `gradient` by the derivative of [`elu`], taken from its output.
    pub fn elu_backward<'a>(output: &'a [f32], gradient: &'a mut [f32]) {
        each(&EluBackward, [output], [gradient]);
    }
}

vectorised! {
    /// Gated linear unit (Dauphin et al. 2017): `out = a sigmoid(b)` where a and b are the first and second half of
    /// the channels of `features` (pixels, 2 channels).
    ///
    /// `sigmoids` and `out` are (pixels, channels); the former is an input of [`glu_backward`].
    pub fn glu<'a, fused FUSED>(features: &'a [f32], channels: usize, sigmoids: &'a mut [f32], out: &'a mut [f32]) {
        let rows = features.chunks_exact(2 * channels).zip(sigmoids.chunks_exact_mut(channels));
        for ((feature, sigmoid), out) in rows.zip(out.chunks_exact_mut(channels)) {
            let (a, b) = feature.split_at(channels);
            each(&Glu::<FUSED>, [a, b], [sigmoid, out]);
        }
    }
}

vectorised! {
    /// Gradient of [`glu`] by its features, from the gradient by its output (pixels, channels) and that output.
    pub fn glu_backward<'a>(
        sigmoids: &'a [f32],
        output: &'a [f32],
        channels: usize,
        gradient: &'a [f32],
        features: &'a mut [f32],
    ) {
        let rows = sigmoids.chunks_exact(channels).zip(output.chunks_exact(channels));
        let rows = rows.zip(gradient.chunks_exact(channels)).zip(features.chunks_exact_mut(2 * channels));
        for (((sigmoid, output), gradient), out) in rows {
            let (by_a, by_b) = out.split_at_mut(channels);
            each(&GluBackward, [sigmoid, output, gradient], [by_a, by_b]);
        }
    }
}

vectorised! {
    /// Sigmoid linear unit (Elfwing et al. 2018): `out = x sigmoid(x)`.
    pub fn silu<'a, fused FUSED>(input: &'a [f32], out: &'a mut [f32]) {
        each(&Silu::<FUSED>, [input], [out]);
    }
}

vectorised! {
    /// `out = silu(input) + other`.
    pub fn silu_plus<'a, fused FUSED>(input: &'a [f32], other: &'a [f32], out: &'a mut [f32]) {
        each(&SiluPlus::<FUSED>, [input, other], [out]);
    }
}

vectorised! {
    /// Multiplies `gradient` by the derivative of [`silu`] at `input`.
    pub fn silu_backward<'a, fused FUSED>(input: &'a [f32], gradient: &'a mut [f32]) {
        each(&SiluBackward::<FUSED>, [input], [gradient]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 37 + seed * 11) % 101) as f32 * 0.08 - 4.0).collect()
    }

    #[test]
    fn gate_is_its_formula_and_its_derivative() {
        let (channels, pixels) = (5, 7);
        let features = numbers(2 * channels * pixels, 1);
        let (mut factors, mut out) = (vec![0.0; features.len()], vec![0.0; channels * pixels]);
        gate(&features, channels, &mut factors, &mut out);
        let gradient = numbers(channels * pixels, 2);
        let mut found = vec![0.0; features.len()];
        gate_backward(&factors, channels, &gradient, &mut found);
        for (i, out) in out.iter().enumerate() {
            let at = i / channels * 2 * channels + i % channels;
            let (a, b) = (f64::from(features[at]), f64::from(features[at + channels]));
            let sigmoid = 1.0 / (1.0 + (-b).exp());
            assert!((f64::from(*out) - a.tanh() * sigmoid).abs() < 1e-6);
            let g = f64::from(gradient[i]);
            let by_a = g * sigmoid / a.cosh().powi(2);
            let by_b = g * a.tanh() * sigmoid * (1.0 - sigmoid);
            assert!((f64::from(found[at]) - by_a).abs() < 3e-6, "{} {by_a}", found[at]);
            assert!((f64::from(found[at + channels]) - by_b).abs() < 3e-6);
        }
    }

    #[test]
    fn elu_is_its_formula_and_its_derivative() {
        let input = numbers(50, 3);
        let mut out = vec![0.0; 50];
        elu(&input, &mut out);
        let mut gradient = vec![2.0; 50];
        elu_backward(&out, &mut gradient);
        for ((x, y), g) in input.iter().zip(&out).zip(&gradient) {
            let (expected, slope) = if *x > 0.0 { (*x, 1.0) } else { (x.exp_m1(), x.exp()) };
            assert!((y - expected).abs() < 1e-6 && (g - 2.0 * slope).abs() < 1e-6, "{x}: {y}, {g}");
        }
    }

    #[test]
    fn glu_is_its_formula_and_its_derivative() {
        let (channels, pixels) = (6, 5);
        let features = numbers(2 * channels * pixels, 4);
        let (mut sigmoids, mut out) = (vec![0.0; channels * pixels], vec![0.0; channels * pixels]);
        glu(&features, channels, &mut sigmoids, &mut out);
        let gradient = numbers(channels * pixels, 5);
        let mut found = vec![0.0; features.len()];
        glu_backward(&sigmoids, &out, channels, &gradient, &mut found);
        for (i, out) in out.iter().enumerate() {
            let at = i / channels * 2 * channels + i % channels;
            let (a, b) = (f64::from(features[at]), f64::from(features[at + channels]));
            let (sigmoid, g) = (1.0 / (1.0 + (-b).exp()), f64::from(gradient[i]));
            assert!((f64::from(*out) - a * sigmoid).abs() < 2e-6);
            assert!((f64::from(found[at]) - g * sigmoid).abs() < 3e-6);
            let by_b = g * a * sigmoid * (1.0 - sigmoid);
            assert!((f64::from(found[at + channels]) - by_b).abs() < 5e-6);
        }
    }

    #[test]
    fn silu_is_its_formula_and_its_derivative() {
        let input = numbers(50, 6);
        let mut out = vec![0.0; 50];
        silu(&input, &mut out);
        let mut gradient = vec![3.0; 50];
        silu_backward(&input, &mut gradient);
        for ((x, y), g) in input.iter().zip(&out).zip(&gradient) {
            let formula = |x: f64| x / (1.0 + (-x).exp());
            let x = f64::from(*x);
            let slope = (formula(x + 1e-5) - formula(x - 1e-5)) / 2e-5;
            assert!((f64::from(*y) - formula(x)).abs() < 2e-6 && (f64::from(*g) - 3.0 * slope).abs() < 1e-5);
        }
        let mut sums = vec![0.0; 50];
        silu_plus(&input, &numbers(50, 7), &mut sums);
        for ((sum, y), other) in sums.iter().zip(&out).zip(numbers(50, 7)) {
            assert!((sum - y - other).abs() < 1e-6);
        }
    }
}
