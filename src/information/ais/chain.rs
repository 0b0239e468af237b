//! Annealed importance sampling chains, forward and reverse.
//!
//! The forward chain (Neal 2001) draws beads from the initial distribution and raises the inverse temperature `beta` from 0
//! (initial distribution) to 1 (posterior). The product of the ratios of neighbouring distributions is an unbiased
//! estimate of the probability of the measurement, for any number of temperatures and any mixing. Several particles are
//! resampled when few of them carry the weight (Del Moral, Doucet and Jasra 2006); the mean stays unbiased. The reverse
//! chain starts from the true beads, a sample of the posterior. The inverse of its weight has the mean of the inverse
//! probability (Grosse, Ghahramani and Adams 2015).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::light::Light;
use super::proposals::{InitialDistribution, Moves, SweepSize, mcmc_sweep};
use super::state::{Measurement, State};
use crate::progress::Progress;

/// Annealing schedule: (share of the temperatures, inverse temperature there). Linear up to the first entry, then linear in
/// log beta. The schedule is densest at a few hundredths, where beads find their places.
const SCHEDULE: [(f64, f64); 3] = [(0.15, 0.003), (0.55, 0.06), (1.0, 1.0)];
/// Temperatures after which the image is recomputed without accumulated rounding.
pub(super) const RECOMPUTE_EVERY: usize = 16;
/// Particles are resampled when the effective sample size falls below this share.
const RESAMPLE_BELOW: f64 = 0.5;

/// One AIS chain. It reports every temperature; a chain that is cancelled returns NaN.
pub(super) struct AisChain<'a> {
    pub light: &'a Light,
    pub measured: &'a Measurement,
    pub initial: &'a InitialDistribution,
    pub steps: &'a Moves,
    pub effort: SweepSize,
    /// Number of temperatures.
    pub levels: usize,
}

/// Inverse temperature at a share (0 to 1) of the schedule.
pub(super) fn beta(share: f64) -> f64 {
    let mut before: (f64, f64) = (0.0, 0.0);
    for after in SCHEDULE {
        if share <= after.0 {
            let part = (share - before.0) / (after.0 - before.0);
            return if before.1 == 0.0 { after.1 * part } else { before.1 * f64::powf(after.1 / before.1, part) };
        }
        before = after;
    }
    1.0
}

impl<'a> AisChain<'a> {
    fn beta(&self, level: usize) -> f64 {
        beta(level as f64 / self.levels as f64)
    }

    fn state(&self, occupied: impl Iterator<Item = usize>) -> State<'a> {
        State::new(self.light, self.measured, self.initial.free.len(), occupied)
    }

    /// Log of (prior x likelihood) / initial distribution, nats.
    fn ratio(&self, state: &State<'_>) -> f64 {
        state.log_likelihood() + self.initial.prior_over_initial(&state.occupied)
    }

    fn mcmc_sweep(&self, state: &mut State<'_>, level: usize, random: &mut ChaCha8Rng) {
        mcmc_sweep(state, self.initial, self.steps, self.beta(level), self.effort, self.light.grid, random);
        if level.is_multiple_of(RECOMPUTE_EVERY) {
            state.refresh();
        }
    }

    /// Log of an unbiased estimate of the probability of the measurement, nats. Its mean is a lower bound on the log
    /// probability.
    pub fn forward_log_weight(
        &self,
        particles: usize,
        random: &mut ChaCha8Rng,
        progress: &mut dyn Progress<usize>,
    ) -> f64 {
        let mut states: Vec<State<'a>> =
            (0..particles).map(|_| self.state(self.initial.draw(random).into_iter())).collect();
        let mut logs = vec![0.0; states.len()];
        let mut sum = 0.0;
        for level in 1..=self.levels {
            if progress.report(&level).is_break() {
                return f64::NAN;
            }
            let rise = self.beta(level) - self.beta(level - 1);
            for (log, state) in logs.iter_mut().zip(&states) {
                *log += rise * self.ratio(state);
            }
            if level == self.levels {
                break;
            }
            let (mean, weights) = normalized_weights(&logs);
            if weights.iter().map(|weight| weight * weight).sum::<f64>() * RESAMPLE_BELOW * logs.len() as f64 > 1.0 {
                sum += mean;
                logs.fill(0.0);
                states = systematic_resample(&weights, random.random())
                    .into_iter()
                    .map(|index| states[index].clone())
                    .collect();
            }
            for state in &mut states {
                self.mcmc_sweep(state, level, random);
            }
        }
        for (log, state) in logs.iter_mut().zip(&states) {
            *log += state.correction();
        }
        sum + normalized_weights(&logs).0
    }

    /// Log-likelihood of the measurement given beads, under the model of the chain, nats.
    pub fn model_log_likelihood(&self, beads: &[usize]) -> f64 {
        self.state(beads.iter().copied()).log_likelihood()
    }

    /// Log weight of the reverse chain from the true beads, nats. Its mean is an upper bound on the log probability of the
    /// measurement.
    pub fn reverse_log_weight(
        &self,
        truth: &[usize],
        random: &mut ChaCha8Rng,
        progress: &mut dyn Progress<usize>,
    ) -> f64 {
        let mut state = self.state(truth.iter().copied());
        let mut sum = 0.0;
        for level in (1..=self.levels).rev() {
            if progress.report(&level).is_break() {
                return f64::NAN;
            }
            if level < self.levels {
                self.mcmc_sweep(&mut state, level, random);
            }
            sum += (self.beta(level) - self.beta(level - 1)) * self.ratio(&state);
        }
        sum
    }
}

/// Log of the mean weight, and the normalised weights, from log weights.
fn normalized_weights(logs: &[f64]) -> (f64, Vec<f64>) {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() {
        return (largest, vec![1.0 / logs.len().max(1) as f64; logs.len()]);
    }
    let mut weights: Vec<f64> = logs.iter().map(|log| (log - largest).exp()).collect();
    let sum: f64 = weights.iter().sum();
    for weight in &mut weights {
        *weight /= sum;
    }
    (largest + (sum / logs.len() as f64).ln(), weights)
}

/// Systematic resampling: as many indices as weights, each as often as its weight says up to rounding.
fn systematic_resample(normalized_weights: &[f64], start: f64) -> Vec<usize> {
    let (mut sum, mut index) = (0.0, 0);
    let places = (0..normalized_weights.len()).map(|place| (place as f64 + start) / normalized_weights.len() as f64);
    let draw = places.map(|place| {
        while index + 1 < normalized_weights.len() && sum + normalized_weights[index] <= place {
            sum += normalized_weights[index];
            index += 1;
        }
        index
    });
    draw.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beta_rises_from_zero_to_one() {
        assert_eq!((beta(0.0), beta(1.0)), (0.0, 1.0));
        assert!((1..=100).all(|i| beta(f64::from(i) / 100.0) > beta(f64::from(i - 1) / 100.0)));
    }

    #[test]
    fn resampling_follows_the_weights() {
        let normalized_weights = [0.05, 0.6, 0.0, 0.35];
        let mut counts = [0; 4];
        for step in 0..1000 {
            for index in systematic_resample(&normalized_weights, (f64::from(step) + 0.5) / 1000.0) {
                counts[index] += 1;
            }
        }
        for (count, share) in counts.iter().zip(normalized_weights) {
            assert!((f64::from(*count) / 4000.0 - share).abs() < 1e-3, "{counts:?}");
        }
    }

    #[test]
    fn means_of_weights_survive_large_logs() {
        let (mean, parts) = super::normalized_weights(&[-2000.0, -2000.0 + 3.0_f64.ln()]);
        assert!((mean + 2000.0 - 2.0_f64.ln()).abs() < 1e-12);
        assert!((parts[1] - 0.75).abs() < 1e-12);
    }
}
