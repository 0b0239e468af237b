//! The density of a pixel: a mixture of the likelihoods of clean levels, weighted by the network.

use crate::nn::{LANES, exponential, if_not_negligible, logarithm, sum_of_lanes, vectorised};

/// Smallest log weight of a level by the linear prediction, nats.
pub(super) const FARTHEST: f32 = -30.0;
/// Mixtures below this, relative to the best level, are recomputed in double precision.
const SMALLEST: f32 = 1e-15;

vectorised! {
    /// Negative log-likelihoods of pixels, nats, each the mean over the possible measurements there, and their
    /// gradients.
    ///
    /// `outputs` (pixels, levels + 1) holds the outputs of the network; the last one is the weight of the linear
    /// prediction beyond 1. It is overwritten with `weight` times the gradient of the loss by them. `guess` holds the
    /// predicted mean (photons) and -1/2 over its variance. `likelihoods` (pixels, targets) holds those of all levels
    /// relative to the largest, and the logarithm of that one. `losses` (pixels) receives the negative logarithms;
    /// infinity where a likelihood relative to the best level is below [`SMALLEST`]. `scratch` holds two numbers per
    /// level, the log weight by the prediction and the weight at the last pixel, and one per target. The number of
    /// levels is a multiple of [`LANES`].
    #[allow(clippy::too_many_arguments, reason = "slices of one batch, all needed in the same loop")]
    pub(super) fn level_losses<'a, fused FUSED>(
        photons: &'a [f32],
        guess: &'a [(f32, f32)],
        likelihoods: &'a [(&'a [f32], f32)],
        weight: f32,
        outputs: &'a mut [f32],
        losses: &'a mut [f32],
        scratch: &'a mut [f32],
    ) {
        let levels = photons.len();
        let (pulls, rest) = scratch.split_at_mut(levels);
        let targets = likelihoods.len() / losses.len();
        let (weights, rest) = rest.split_at_mut(levels);
        let factors = &mut rest[..targets];
        let pixels = outputs.chunks_exact_mut(levels + 1).zip(likelihoods.chunks_exact(targets)).zip(losses);
        for (((outputs, likelihoods), loss), &(mean, half)) in pixels.zip(guess) {
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
            let mut total = [0.0_f32; LANES];
            let lanes = logits.as_chunks::<LANES>().0.iter().zip(weights.as_chunks_mut::<LANES>().0);
            for (logits, weights) in lanes {
                for k in 0..LANES {
                    weights[k] = if_not_negligible(exponential::<FUSED>(logits[k] - most));
                    total[k] += weights[k];
                }
            }
            let total = sum_of_lanes(total);
            for (mixture, (shares, _)) in factors.iter_mut().zip(likelihoods) {
                let mut sum = [0.0_f32; LANES];
                for (weights, shares) in weights.as_chunks::<LANES>().0.iter().zip(shares.as_chunks::<LANES>().0) {
                    for k in 0..LANES {
                        sum[k] += weights[k] * if_not_negligible(shares[k]);
                    }
                }
                *mixture = sum_of_lanes(sum);
            }
            let (to_weight, log_total) = (weight / total, logarithm::<FUSED>(total));
            let mut nats = 0.0;
            for (factor, (_, largest_log)) in factors.iter_mut().zip(likelihoods) {
                let mixture = *factor;
                // Parts of the mixture below single precision are summed elsewhere; they have no gradient here.
                let trusted = mixture > SMALLEST * total;
                nats += if trusted { log_total - logarithm::<FUSED>(mixture) - largest_log } else { f32::INFINITY };
                *factor = if trusted { weight / (mixture * targets as f32) } else { 0.0 };
            }
            *loss = nats / targets as f32;
            let mut by_scale = [0.0_f32; LANES];
            let lanes = weights.as_chunks::<LANES>().0.iter().zip(pulls.as_chunks::<LANES>().0);
            for (index, ((weights, pulls), logits)) in lanes.zip(logits.as_chunks_mut::<LANES>().0).enumerate() {
                let mut by_weights = [to_weight; LANES];
                for (factor, (shares, _)) in factors.iter().zip(likelihoods) {
                    let shares = &shares.as_chunks::<LANES>().0[index];
                    for k in 0..LANES {
                        by_weights[k] -= if_not_negligible(shares[k]) * factor;
                    }
                }
                for k in 0..LANES {
                    logits[k] = weights[k] * by_weights[k];
                    by_scale[k] += logits[k] * pulls[k];
                }
            }
            scale[0] = sum_of_lanes(by_scale);
        }
    }
}

/// The loss of one pixel in double precision, nats, and the posterior of every level. The inputs are the logarithms
/// of the likelihoods of its levels (any constant added). `outputs` is overwritten with `weight` times the gradient
/// by it. It replaces [`level_losses`] where single precision fails: without it the network would never learn pixels
/// to which it gives almost no probability.
pub(super) fn exact_loss(
    photons: &[f32],
    (mean, half): (f32, f32),
    log_likelihoods: &[f64],
    weight: f32,
    outputs: &mut [f32],
) -> (f64, Vec<f64>) {
    let levels = photons.len();
    let scale = f64::from(1.0 + outputs[levels]);
    let pulls: Vec<f64> = photons
        .iter()
        .map(|x| {
            let distance = f64::from(x - mean);
            (distance * distance * f64::from(half)).max(f64::from(FARTHEST))
        })
        .collect();
    let logits: Vec<f64> =
        outputs[..levels].iter().zip(&pulls).map(|(logit, pull)| f64::from(*logit) + scale * pull).collect();
    let terms: Vec<f64> = logits.iter().zip(log_likelihoods).map(|(logit, log)| logit + log).collect();
    let (total, mixture) = (log_sum(&logits), log_sum(&terms));
    let posteriors: Vec<f64> = terms.iter().map(|term| (term - mixture).exp()).collect();
    let mut by_scale = 0.0;
    for (level, out) in outputs[..levels].iter_mut().enumerate() {
        let by_logit = (logits[level] - total).exp() - posteriors[level];
        *out = weight * by_logit as f32;
        by_scale += by_logit * pulls[level];
    }
    outputs[levels] = weight * by_scale as f32;
    (total - mixture, posteriors)
}

/// ln of a sum of exponentials.
fn log_sum(logs: &[f64]) -> f64 {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + logs.iter().map(|log| (log - most).exp()).sum::<f64>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_and_gradients_are_those_of_the_mixture() {
        let (levels, pixels, targets) = (32, 3, 2);
        let number = |i: usize| ((i * 37) % 101) as f32 / 101.0;
        let photons: Vec<f32> = (0..levels).map(|l| 10.0 + 3.0 * l as f32).collect();
        let guess = [(20.0, -0.01), (55.0, -0.5), (90.0, -0.002)];
        let shares: Vec<f32> = (0..pixels * targets * levels).map(|i| number(i * 3 + 1)).collect();
        let log_largest = [-2.0, -1.0, -7.5, -3.0, -0.5, -4.0];
        let outputs: Vec<f32> = (0..pixels * (levels + 1)).map(|i| 2.0 * number(i * 5) - 1.0).collect();
        let plainly = |pixel: usize, outputs: &[f32]| -> f64 {
            let of = |target: usize| {
                let at = pixel * targets + target;
                let shares = &shares[at * levels..(at + 1) * levels];
                let logs: Vec<f64> = shares.iter().map(|share| f64::from(*share).ln()).collect();
                exact_loss(&photons, guess[pixel], &logs, 1.0, &mut outputs.to_vec()).0 - f64::from(log_largest[at])
            };
            f64::midpoint(of(0), of(1))
        };
        let mut found = outputs.clone();
        let (mut losses, mut scratch) = (vec![0.0; pixels], vec![0.0; 2 * levels + targets]);
        let likelihoods: Vec<(&[f32], f32)> = shares.chunks_exact(levels).zip(log_largest).collect();
        level_losses(&photons, &guess, &likelihoods, 2.0, &mut found, &mut losses, &mut scratch);
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
    fn what_is_all_but_impossible_has_a_gradient() {
        let photons: Vec<f32> = (0..16).map(|l| 10.0 * l as f32).collect();
        // The network is certain of the darkest level; the brightest was measured.
        let mut outputs: Vec<f32> = (0..17).map(|l| -10.0 * l as f32).collect();
        outputs[16] = -1.0;
        let logs: Vec<f64> = photons.iter().map(|&x| -0.5 * f64::from(x - 150.0).powi(2) / 25.0).collect();
        let (guess, mut by) = ((0.0, -0.001), outputs.clone());
        let (loss, _) = exact_loss(&photons, guess, &logs, 1.0, &mut by);
        assert!(loss > 100.0 && by[12] < -0.4 && by[13] < -0.4 && by[0] > 0.9, "{loss} {by:?}");
        for k in [0, 7, 14, 15, 16] {
            let moved = |by: f32| {
                let mut outputs = outputs.clone();
                outputs[k] += by;
                exact_loss(&photons, guess, &logs, 1.0, &mut outputs).0
            };
            let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            assert!((f64::from(by[k]) - slope).abs() < 1e-3 * slope.abs() + 1e-3, "{k}: {} {slope}", by[k]);
        }
    }

    #[test]
    fn loss_beyond_single_precision_is_reported() {
        let photons: Vec<f32> = (0..16).map(|l| l as f32).collect();
        let mut shares = vec![0.0; 16];
        shares[15] = 1e-30;
        let (mut outputs, mut losses, mut scratch) = (vec![0.0; 17], vec![0.0], vec![0.0; 64]);
        level_losses(&photons, &[(0.0, -1.0)], &[(&shares, 0.0)], 1.0, &mut outputs, &mut losses, &mut scratch);
        assert!(losses[0] == f32::INFINITY && outputs.iter().all(|x| x.is_finite()));
    }
}
