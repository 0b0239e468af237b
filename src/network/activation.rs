//! Activations and their derivatives, fused into one pass over the channels.

use super::arithmetic::{exponential, vectorised};

vectorised! {
    /// Gated activation (van den Oord et al. 2016): `out = tanh(a) sigmoid(b)` where a and b are the first and second half
    /// of the channels of `features` (pixels, 2 channels).
    ///
    /// `factors` (pixels, 2 channels) keeps tanh and sigmoid for [`gate_backward`]; `out` is (pixels, channels).
    pub fn gate<'a>(features: &'a [f32], channels: usize, factors: &'a mut [f32], out: &'a mut [f32]) {
        let wide = 2 * channels;
        let rows = features.chunks_exact(wide).zip(factors.chunks_exact_mut(wide)).zip(out.chunks_exact_mut(channels));
        for ((feature, factor), out) in rows {
            let (a, b) = feature.split_at(channels);
            let (tanh, sigmoid) = factor.split_at_mut(channels);
            let inputs = a.iter().zip(b);
            for ((((a, b), tanh), sigmoid), out) in inputs.zip(tanh).zip(sigmoid).zip(out) {
                let t = 2.0 / (1.0 + exponential(-2.0 * a)) - 1.0;
                let s = 1.0 / (1.0 + exponential(-b));
                *tanh = t;
                *sigmoid = s;
                *out = t * s;
            }
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
            for ((((t, s), g), by_a), by_b) in tanh.iter().zip(sigmoid).zip(gradient).zip(by_a).zip(by_b) {
                *by_a = g * s * (1.0 - t * t);
                *by_b = g * t * s * (1.0 - s);
            }
        }
    }
}

vectorised! {
    /// Exponential linear unit (Clevert et al. 2016): x above 0, `e^x - 1` below.
    pub fn elu<'a>(input: &'a [f32], out: &'a mut [f32]) {
        for (x, out) in input.iter().zip(out) {
            let below = exponential(x.min(0.0)) - 1.0;
            *out = if *x > 0.0 { *x } else { below };
        }
    }
}

vectorised! {
    /// Multiplies `gradient` by the derivative of [`elu`], taken from its output.
    pub fn elu_backward<'a>(output: &'a [f32], gradient: &'a mut [f32]) {
        for (y, gradient) in output.iter().zip(gradient) {
            *gradient *= 1.0 + y.min(0.0);
        }
    }
}

vectorised! {
    /// Sigmoid linear unit (Hendrycks and Gimpel 2016): `x sigmoid(x)`.
    pub fn silu<'a>(input: &'a [f32], out: &'a mut [f32]) {
        for (x, out) in input.iter().zip(out) {
            *out = x / (1.0 + exponential(-x));
        }
    }
}

vectorised! {
    /// Multiplies `gradient` by the derivative of [`silu`], taken from its input.
    pub fn silu_backward<'a>(input: &'a [f32], gradient: &'a mut [f32]) {
        for (x, gradient) in input.iter().zip(gradient) {
            let s = 1.0 / (1.0 + exponential(-x));
            *gradient *= s * (1.0 + x * (1.0 - s));
        }
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
    fn silu_is_its_formula_and_its_derivative() {
        let input = numbers(50, 5);
        let mut out = vec![0.0; 50];
        silu(&input, &mut out);
        let mut gradient = vec![2.0; 50];
        silu_backward(&input, &mut gradient);
        for ((x, y), g) in input.iter().map(|x| f64::from(*x)).zip(&out).zip(&gradient) {
            let formula = |x: f64| x / (1.0 + (-x).exp());
            let slope = (formula(x + 1e-4) - formula(x - 1e-4)) / 2e-4;
            assert!((f64::from(*y) - formula(x)).abs() < 2e-6 && (f64::from(*g) - 2.0 * slope).abs() < 4e-6, "{x}");
        }
    }
}
