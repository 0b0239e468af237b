//! The density of a pixel: a mixture of Gaussians whose means, widths and weights are the outputs of the network.

use super::scale::DataScale;
use crate::nn::{exponential, if_not_negligible, logarithm, vectorised};

/// ln(2 pi) / 2.
pub(super) const HALF_LN_TWO_PI: f32 = 0.918_938_5;
/// Numbers summed side by side.
const LANES: usize = 8;

/// Scratch numbers per component.
pub(super) const SCRATCH: usize = 4;

/// Negative log densities, nats, and their gradients.
///
/// `heads` (pixels, 3 components) holds outputs of the network for means, widths and logits. It is overwritten with
/// `weight` times the gradient of the loss by them. `losses` and `by_value` (pixels) receive the negative log density
/// of each of `values` (photons) and `weight` times its direct derivative by the value. `scratch` has [`SCRATCH`]
/// numbers per component.
///
/// The mean is clipped to the range of the data. The width is a softplus, limited to at least the narrowest width and
/// then to at most the deviation of the data. A clipped output has no gradient.
pub(super) fn mixture_losses(
    scale: &DataScale,
    values: &[f32],
    weight: f32,
    heads: &mut [f32],
    losses: &mut [f32],
    by_value: &mut [f32],
    scratch: &mut [f32],
) {
    let components = scratch.len() / SCRATCH;
    match components {
        // A constant length turns the loops into straight vector code.
        40 => pixels_of_40(scale, values, weight, heads, losses, by_value, scratch),
        _ => pixels::<0, false>(components, scale, values, weight, heads, losses, by_value, scratch),
    }
}

/// The mean and width (photons) of a component, from the outputs of the network, as in [`mixture_losses`].
#[inline(always)]
#[allow(clippy::inline_always, reason = "called in the loop over components")]
pub(super) fn component(scale: &DataScale, mean: f32, width: f32) -> (f32, f32) {
    let softplus = width.max(0.0) + logarithm::<false>(1.0 + exponential::<false>(-width.abs()));
    (mean.max(scale.min).min(scale.max), softplus.max(scale.min_width).min(scale.deviation))
}

vectorised! {
    fn pixels_of_40<'a, fused FUSED>(
        scale: &'a DataScale,
        values: &'a [f32],
        weight: f32,
        heads: &'a mut [f32],
        losses: &'a mut [f32],
        by_value: &'a mut [f32],
        scratch: &'a mut [f32],
    ) {
        pixels::<40, FUSED>(40, scale, values, weight, heads, losses, by_value, scratch);
    }
}

#[inline(always)]
#[allow(clippy::inline_always, clippy::too_many_arguments, reason = "the body of the loop above")]
fn pixels<const COMPONENTS: usize, const FUSED: bool>(
    components: usize,
    scale: &DataScale,
    values: &[f32],
    weight: f32,
    heads: &mut [f32],
    losses: &mut [f32],
    by_value: &mut [f32],
    scratch: &mut [f32],
) {
    let components = if COMPONENTS == 0 { components } else { COMPONENTS };
    let (logs, rest) = scratch.split_at_mut(components);
    let (by_mean, rest) = rest.split_at_mut(components);
    let (by_width, shares) = rest.split_at_mut(components);
    let shares = &mut shares[..components];
    let outputs = losses.iter_mut().zip(by_value);
    for ((&value, heads), (loss, by_value)) in values.iter().zip(heads.chunks_exact_mut(3 * components)).zip(outputs) {
        let (means, heads) = heads.split_at_mut(components);
        let (widths, logits) = heads.split_at_mut(components);
        let logits = &mut logits[..components];
        for k in 0..components {
            let (mean, raw) = (means[k], widths[k]);
            let open_mean = mean >= scale.min && mean <= scale.max;
            let e = exponential::<FUSED>(-raw.abs());
            let softplus = raw.max(0.0) + logarithm::<FUSED>(1.0 + e);
            let sigmoid = if raw >= 0.0 { 1.0 } else { e } / (1.0 + e);
            let open_width = softplus >= scale.min_width && softplus <= scale.deviation;
            let width = softplus.max(scale.min_width).min(scale.deviation);
            let inverse = 1.0 / width;
            let z = (value - mean.max(scale.min).min(scale.max)) * inverse;
            logs[k] = logits[k] - 0.5 * z * z - logarithm::<FUSED>(width) - HALF_LN_TWO_PI;
            // Not masked yet: the derivative by the value needs all of them.
            by_mean[k] = z * inverse;
            by_width[k] = if open_width { sigmoid } else { 0.0 } * (z * z - 1.0) * inverse;
            means[k] = if open_mean { 1.0 } else { 0.0 };
        }
        let (largest_log, largest_logit) = (largest(logs), largest(logits));
        for k in 0..components {
            logs[k] = if_not_negligible(exponential::<FUSED>(logs[k] - largest_log));
            shares[k] = if_not_negligible(exponential::<FUSED>(logits[k] - largest_logit));
        }
        let (density, total) = (sum(logs), sum(shares));
        *loss = (largest_logit + total.ln()) - (largest_log + density.ln());
        let (density, total) = (weight / density, weight / total);
        for k in 0..components {
            let responsibility = logs[k] * density;
            let pull = responsibility * by_mean[k];
            by_mean[k] = pull;
            means[k] *= -pull;
            widths[k] = -responsibility * by_width[k];
            logits[k] = shares[k] * total - responsibility;
        }
        *by_value = sum(by_mean);
    }
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "called in the loop over pixels")]
fn largest(values: &[f32]) -> f32 {
    let (lanes, rest) = values.as_chunks::<LANES>();
    let mut best = [f32::NEG_INFINITY; LANES];
    for lane in lanes {
        for (best, value) in best.iter_mut().zip(lane) {
            *best = best.max(*value);
        }
    }
    best.iter().chain(rest).copied().fold(f32::NEG_INFINITY, f32::max)
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "called in the loop over pixels")]
fn sum(values: &[f32]) -> f32 {
    let (lanes, rest) = values.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for lane in lanes {
        for (sum, value) in sums.iter_mut().zip(lane) {
            *sum += value;
        }
    }
    sums.iter().chain(rest).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCALE: DataScale = DataScale { mean: 50.0, deviation: 20.0, min: 5.0, max: 120.0, min_width: 1.0 };

    /// The same in f64 from the definition.
    fn plainly(value: f64, heads: &[f64]) -> f64 {
        let components = heads.len() / 3;
        let (mut density, mut total) = (0.0, 0.0);
        for k in 0..components {
            let mean = heads[k].clamp(5.0, 120.0);
            let width = heads[components + k].exp().ln_1p().clamp(1.0, 20.0);
            let share = heads[2 * components + k].exp();
            let z = (value - mean) / width;
            density += share * (-0.5 * z * z).exp() / (width * (2.0 * std::f64::consts::PI).sqrt());
            total += share;
        }
        -(density / total).ln()
    }

    #[test]
    fn losses_and_gradients_are_those_of_the_definition() {
        for components in [3, 8, 40] {
            let values = [48.0, 52.5, 11.0, 119.0];
            let number = |i: usize| ((i * 37) % 101) as f64 / 101.0;
            // Means on both sides of the range, widths below, inside and above theirs.
            let heads: Vec<f64> = (0..values.len() * 3 * components)
                .map(|i| match i / components % 3 {
                    0 => 150.0 * number(i) - 10.0,
                    1 => 40.0 * number(i) - 8.0,
                    _ => 4.0 * number(i),
                })
                .collect();
            let mut found: Vec<f32> = heads.iter().map(|&x| x as f32).collect();
            let (mut losses, mut by_value) = ([0.0; 4], [0.0; 4]);
            let mut scratch = vec![0.0; SCRATCH * components];
            mixture_losses(&SCALE, &values, 2.0, &mut found, &mut losses, &mut by_value, &mut scratch);
            for (pixel, (&value, heads)) in values.iter().zip(heads.chunks(3 * components)).enumerate() {
                let value = f64::from(value);
                let loss = plainly(value, heads);
                assert!((f64::from(losses[pixel]) - loss).abs() < 1e-5 * loss.abs().max(1.0));
                let step = 1e-4;
                let slope = (plainly(value + step, heads) - plainly(value - step, heads)) / (2.0 * step);
                assert!((f64::from(by_value[pixel]) - 2.0 * slope).abs() < 1e-4, "{} {slope}", by_value[pixel]);
                for k in 0..3 * components {
                    let moved = |by: f64| {
                        let mut heads = heads.to_vec();
                        heads[k] += by;
                        plainly(value, &heads)
                    };
                    let slope = (moved(step) - moved(-step)) / (2.0 * step);
                    let gradient = f64::from(found[pixel * 3 * components + k]);
                    assert!((gradient - 2.0 * slope).abs() < 1e-4, "{k}: {gradient} {slope}");
                }
            }
        }
    }

    #[test]
    fn far_values_have_finite_losses() {
        let mut heads = [0.0; 9];
        let (mut loss, mut by_value) = ([0.0], [0.0]);
        mixture_losses(&SCALE, &[1e7], 1.0, &mut heads, &mut loss, &mut by_value, &mut [0.0; 12]);
        assert!(loss[0].is_finite() && heads.iter().all(|x| x.is_finite()), "{loss:?} {heads:?}");
    }
}
