//! The density of a pixel: a mixture of the likelihoods of clean levels, weighted by the network.

use crate::network::{exponential, logarithm, vectorised};

/// A level is never further from the linear prediction than this says, nats.
pub(super) const FARTHEST: f32 = -30.0;
/// Mixtures of less than this, relative to the best level, are not trusted to single precision.
pub(super) const SMALLEST: f32 = 1e-25;

vectorised! {
    /// Negative log-likelihoods of pixels, nats, and their gradients.
    ///
    /// `outputs` (pixels, levels + 1) holds the outputs of the network, the last of them the weight that the linear
    /// prediction gets beyond 1; it is overwritten with `weight` times the gradient of the loss by them. `guess` holds
    /// the predicted mean (photons) and -1/2 over its variance, `shares` (pixels, levels) and `log_largest` the
    /// likelihoods of the levels. `losses` (pixels) receives the negative logarithms; infinity where the likelihood
    /// relative to the best level is below [`SMALLEST`]. `scratch` is (3, levels).
    #[allow(clippy::too_many_arguments, reason = "slices of one batch, all needed in the same loop")]
    pub(super) fn level_losses<'a>(
        photons: &'a [f32],
        guess: &'a [(f32, f32)],
        shares: &'a [f32],
        log_largest: &'a [f32],
        weight: f32,
        outputs: &'a mut [f32],
        losses: &'a mut [f32],
        scratch: &'a mut [f32],
    ) {
        let levels = photons.len();
        let (pulls, rest) = scratch.split_at_mut(levels);
        let (weights, posteriors) = rest.split_at_mut(levels);
        let posteriors = &mut posteriors[..levels];
        let pixels = outputs.chunks_exact_mut(levels + 1).zip(shares.chunks_exact(levels)).zip(losses);
        for ((((outputs, shares), loss), &(mean, half)), &largest_log) in pixels.zip(guess).zip(log_largest) {
            let (logits, scale) = outputs.split_at_mut(levels);
            let scale_now = 1.0 + scale[0];
            let mut most = [f32::NEG_INFINITY; LANES];
            for ((lanes, logits), pulls) in photons.as_chunks::<LANES>().0.iter()
                .zip(logits.as_chunks_mut::<LANES>().0).zip(pulls.as_chunks_mut::<LANES>().0)
            {
                for k in 0..LANES {
                    let distance = lanes[k] - mean;
                    pulls[k] = (distance * distance * half).max(FARTHEST);
                    logits[k] += scale_now * pulls[k];
                    most[k] = most[k].max(logits[k]);
                }
            }
            let most = most.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let (mut total, mut mixture) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            let lanes = logits.as_chunks::<LANES>().0.iter().zip(shares.as_chunks::<LANES>().0);
            let out = weights.as_chunks_mut::<LANES>().0.iter_mut().zip(posteriors.as_chunks_mut::<LANES>().0);
            for ((logits, shares), (weights, posteriors)) in lanes.zip(out) {
                for k in 0..LANES {
                    weights[k] = exponential(logits[k] - most);
                    posteriors[k] = weights[k] * shares[k];
                    total[k] += weights[k];
                    mixture[k] += posteriors[k];
                }
            }
            let (total, mixture) = (total.iter().sum::<f32>(), mixture.iter().sum::<f32>());
            // A share of the mixture that single precision cannot hold is summed elsewhere; it has no gradient here.
            let trusted = mixture > SMALLEST * total;
            *loss = if trusted { logarithm(total) - logarithm(mixture) - largest_log } else { f32::INFINITY };
            let (to_weight, to_posterior) = (weight / total, if trusted { weight / mixture } else { 0.0 });
            let mut by_scale = [0.0_f32; LANES];
            let lanes = weights.as_chunks::<LANES>().0.iter().zip(posteriors.as_chunks::<LANES>().0);
            let out = logits.as_chunks_mut::<LANES>().0.iter_mut().zip(pulls.as_chunks::<LANES>().0);
            for ((weights, posteriors), (logits, pulls)) in lanes.zip(out) {
                for k in 0..LANES {
                    logits[k] = weights[k] * to_weight - posteriors[k] * to_posterior;
                    by_scale[k] += logits[k] * pulls[k];
                }
            }
            scale[0] = by_scale.iter().sum();
        }
    }
}

/// Levels that are worked on side by side; the number of levels is a multiple.
const LANES: usize = 16;

/// ln of the softmax of the logits of one pixel, linear prediction included: what [`level_losses`] mixes by.
pub(super) fn log_weights(photons: &[f32], (mean, half): (f32, f32), outputs: &[f32]) -> Vec<f64> {
    let (logits, scale) = outputs.split_at(photons.len());
    let scale = f64::from(1.0 + scale[0]);
    let logs: Vec<f64> = photons
        .iter()
        .zip(logits)
        .map(|(x, logit)| {
            let distance = f64::from(x - mean);
            f64::from(*logit) + scale * (distance * distance * f64::from(half)).max(f64::from(FARTHEST))
        })
        .collect();
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total = most + logs.iter().map(|log| (log - most).exp()).sum::<f64>().ln();
    logs.iter().map(|log| log - total).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_and_gradients_are_those_of_the_mixture() {
        let (levels, pixels) = (32, 3);
        let number = |i: usize| ((i * 37) % 101) as f32 / 101.0;
        let photons: Vec<f32> = (0..levels).map(|l| 10.0 + 3.0 * l as f32).collect();
        let guess = [(20.0, -0.01), (55.0, -0.5), (90.0, -0.002)];
        let shares: Vec<f32> = (0..pixels * levels).map(|i| number(i * 3 + 1)).collect();
        let log_largest = [-2.0, -1.0, -7.5];
        let outputs: Vec<f32> = (0..pixels * (levels + 1)).map(|i| 2.0 * number(i * 5) - 1.0).collect();
        let plainly = |pixel: usize, outputs: &[f32]| -> f64 {
            let logs = log_weights(&photons, guess[pixel], outputs);
            let shares = &shares[pixel * levels..(pixel + 1) * levels];
            let mixture: f64 = logs.iter().zip(shares).map(|(log, share)| log.exp() * f64::from(*share)).sum();
            -mixture.ln() - f64::from(log_largest[pixel])
        };
        let mut found = outputs.clone();
        let (mut losses, mut scratch) = (vec![0.0; pixels], vec![0.0; 3 * levels]);
        level_losses(&photons, &guess, &shares, &log_largest, 2.0, &mut found, &mut losses, &mut scratch);
        for (pixel, loss) in losses.iter().enumerate() {
            let range = pixel * (levels + 1)..(pixel + 1) * (levels + 1);
            let outputs = &outputs[range.clone()];
            assert!((f64::from(*loss) - plainly(pixel, outputs)).abs() < 1e-5);
            for (k, gradient) in found[range].iter().enumerate() {
                let moved = |by: f32| {
                    let mut outputs = outputs.to_vec();
                    outputs[k] += by;
                    plainly(pixel, &outputs)
                };
                let slope = (moved(1e-3) - moved(-1e-3)) / 2e-3;
                assert!(
                    (f64::from(*gradient) - 2.0 * slope).abs() < 1e-3 * slope.abs() + 1e-3,
                    "{k}: {gradient} {slope}"
                );
            }
        }
    }

    #[test]
    fn what_single_precision_cannot_hold_is_told() {
        let photons: Vec<f32> = (0..16).map(|l| l as f32).collect();
        let mut shares = vec![0.0; 16];
        shares[15] = 1e-30;
        let (mut outputs, mut losses, mut scratch) = (vec![0.0; 17], vec![0.0], vec![0.0; 48]);
        level_losses(&photons, &[(0.0, -1.0)], &shares, &[0.0], 1.0, &mut outputs, &mut losses, &mut scratch);
        assert!(losses[0] == f32::INFINITY && outputs.iter().all(|x| x.is_finite()));
    }
}
