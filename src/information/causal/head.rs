//! The density of a pixel: a mixture of the likelihoods of clean levels, weighted by the network.

use crate::network::{exponential, logarithm, vectorised};

/// A level is never further from the linear prediction than this says, nats.
pub(super) const FARTHEST: f32 = -30.0;
/// Mixtures of less than this, relative to the best level, are not trusted to single precision.
const SMALLEST: f32 = 1e-15;
/// Weights and likelihoods of levels below this, relative to the best one, count for nothing: products of such numbers are
/// subnormal, with which processors calculate a hundred times more slowly. A dark scene would be full of them.
const NEGLIGIBLE: f32 = 1e-19;

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
                    let weight = exponential(logits[k] - most);
                    weights[k] = if weight > NEGLIGIBLE { weight } else { 0.0 };
                    let share = if shares[k] > NEGLIGIBLE { shares[k] } else { 0.0 };
                    posteriors[k] = weights[k] * share;
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

/// The loss of one pixel in double precision, nats, from the logarithms of the likelihoods of its levels (any constant
/// added), and the posterior of every level; `outputs` is overwritten with `weight` times the gradient by it. For what [`level_losses`] cannot hold: without it
/// a pixel that the network holds for all but impossible would never be learned.
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

/// ln of the sum of exponentials.
fn log_sum(logs: &[f64]) -> f64 {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + logs.iter().map(|log| (log - most).exp()).sum::<f64>().ln()
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
            let shares = &shares[pixel * levels..(pixel + 1) * levels];
            let logs: Vec<f64> = shares.iter().map(|share| f64::from(*share).ln()).collect();
            exact_loss(&photons, guess[pixel], &logs, 1.0, &mut outputs.to_vec()).0 - f64::from(log_largest[pixel])
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
    fn what_single_precision_cannot_hold_is_told() {
        let photons: Vec<f32> = (0..16).map(|l| l as f32).collect();
        let mut shares = vec![0.0; 16];
        shares[15] = 1e-30;
        let (mut outputs, mut losses, mut scratch) = (vec![0.0; 17], vec![0.0], vec![0.0; 48]);
        level_losses(&photons, &[(0.0, -1.0)], &shares, &[0.0], 1.0, &mut outputs, &mut losses, &mut scratch);
        assert!(losses[0] == f32::INFINITY && outputs.iter().all(|x| x.is_finite()));
    }
}
