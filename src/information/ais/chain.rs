//! From a guess to the posterior in many small steps, and back.
//!
//! Annealed importance sampling (Neal 2001): beads are drawn from the guess and changed at random at rising heat, from that
//! of the guess (0) to that of the posterior (1); the product of the ratios of neighbouring distributions on the way is
//! an unbiased estimate of the probability of the measurement, whatever the number of steps and however badly the beads
//! mix. Several walkers are weighed by their ratios and drawn anew where few carry the weight (Del Moral, Doucet and
//! Jasra 2006), which leaves the mean as it is. The same walk backwards from the beads that truly made the measurement,
//! which are a fair draw of the posterior, gives ratios whose inverse has the mean of the inverse probability (Grosse,
//! Ghahramani and Adams 2015).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::light::Light;
use super::proposals::{Effort, Guess, Steps, stir};
use super::state::{Measured, State};

/// Share of the way and heat there, the logarithm of heat rising evenly between; evenly from 0 to the first. Beads find
/// their places at a few hundredths of the heat, where it has to rise slowest.
const HEATS: [(f64, f64); 3] = [(0.15, 0.003), (0.55, 0.06), (1.0, 1.0)];
/// Steps after which rounding is cleared away.
const REFRESH: usize = 16;
/// Walkers are drawn anew when fewer than this share of them carry the weight.
const FEW: f64 = 0.5;

/// Everything that belongs to one walk.
pub(super) struct Walk<'a> {
    pub light: &'a Light,
    pub measured: &'a Measured,
    pub guess: &'a Guess,
    pub steps: &'a Steps,
    pub effort: Effort,
    /// Number of steps.
    pub levels: usize,
    /// Asked at every step; what a walk has that was ended early is nothing.
    pub go_on: &'a dyn Fn() -> bool,
}

/// Heat after a share of the way.
fn heat(share: f64) -> f64 {
    let mut before: (f64, f64) = (0.0, 0.0);
    for after in HEATS {
        if share <= after.0 {
            let part = (share - before.0) / (after.0 - before.0);
            return if before.1 == 0.0 { after.1 * part } else { before.1 * f64::powf(after.1 / before.1, part) };
        }
        before = after;
    }
    1.0
}

impl<'a> Walk<'a> {
    fn heat(&self, level: usize) -> f64 {
        heat(level as f64 / self.levels as f64)
    }

    fn state(&self, lit: impl Iterator<Item = usize>) -> State<'a> {
        State::new(self.light, self.measured, self.guess.free.len(), lit)
    }

    /// Log of prior times likelihood over the guess, nats.
    fn ratio(&self, state: &State<'_>) -> f64 {
        state.log_likelihood() + self.guess.prior_over_guess(&state.lit)
    }

    fn stir(&self, state: &mut State<'_>, level: usize, random: &mut ChaCha8Rng) {
        stir(state, self.guess, self.steps, (self.heat(level), self.effort), self.light.grid, random);
        if level.is_multiple_of(REFRESH) {
            state.refresh();
        }
    }

    /// Log of an unbiased estimate of the probability of the measurement, nats; its mean is at most that of the log
    /// probability itself.
    pub fn forwards(&self, walkers: usize, random: &mut ChaCha8Rng) -> f64 {
        let mut states: Vec<State<'a>> =
            (0..walkers).map(|_| self.state(self.guess.draw(random).into_iter())).collect();
        let mut logs = vec![0.0; states.len()];
        let mut sum = 0.0;
        for level in 1..=self.levels {
            if !(self.go_on)() {
                return f64::NAN;
            }
            let rise = self.heat(level) - self.heat(level - 1);
            for (log, state) in logs.iter_mut().zip(&states) {
                *log += rise * self.ratio(state);
            }
            if level == self.levels {
                break;
            }
            let (mean, weights) = shares(&logs);
            if weights.iter().map(|weight| weight * weight).sum::<f64>() * FEW * logs.len() as f64 > 1.0 {
                sum += mean;
                logs.fill(0.0);
                states = drawn(&weights, random.random()).into_iter().map(|index| states[index].clone()).collect();
            }
            for state in &mut states {
                self.stir(state, level, random);
            }
        }
        for (log, state) in logs.iter_mut().zip(&states) {
            *log += state.correction();
        }
        sum + shares(&logs).0
    }

    /// Log of the probability of the measurement given beads, nats.
    pub fn model_of(&self, beads: &[usize]) -> f64 {
        self.state(beads.iter().copied()).log_likelihood()
    }

    /// The log of an estimate of the probability of the measurement, nats, from the beads that made it; its mean is at
    /// least that of the log probability itself.
    pub fn backwards(&self, truth: &[usize], random: &mut ChaCha8Rng) -> f64 {
        let mut state = self.state(truth.iter().copied());
        let mut sum = 0.0;
        for level in (1..=self.levels).rev() {
            if !(self.go_on)() {
                return f64::NAN;
            }
            if level < self.levels {
                self.stir(&mut state, level, random);
            }
            sum += (self.heat(level) - self.heat(level - 1)) * self.ratio(&state);
        }
        sum
    }
}

/// Log of the mean of weights given by their logs, and the shares of each in their sum.
fn shares(logs: &[f64]) -> (f64, Vec<f64>) {
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

/// As many indices as shares, each as often as its share says up to rounding (systematic resampling).
fn drawn(shares: &[f64], start: f64) -> Vec<usize> {
    let (mut sum, mut index) = (0.0, 0);
    let places = (0..shares.len()).map(|place| (place as f64 + start) / shares.len() as f64);
    let draw = places.map(|place| {
        while index + 1 < shares.len() && sum + shares[index] <= place {
            sum += shares[index];
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
    fn heat_rises_from_nothing_to_one() {
        assert_eq!((heat(0.0), heat(1.0)), (0.0, 1.0));
        assert!((1..=100).all(|i| heat(f64::from(i) / 100.0) > heat(f64::from(i - 1) / 100.0)));
    }

    #[test]
    fn walkers_are_drawn_as_often_as_their_shares_say() {
        let shares = [0.05, 0.6, 0.0, 0.35];
        let mut counts = [0; 4];
        for step in 0..1000 {
            for index in drawn(&shares, (f64::from(step) + 0.5) / 1000.0) {
                counts[index] += 1;
            }
        }
        for (count, share) in counts.iter().zip(shares) {
            assert!((f64::from(*count) / 4000.0 - share).abs() < 1e-3, "{counts:?}");
        }
    }

    #[test]
    fn means_of_weights_survive_large_logs() {
        let (mean, parts) = super::shares(&[-2000.0, -2000.0 + 3.0_f64.ln()]);
        assert!((mean + 2000.0 - 2.0_f64.ln()).abs() < 1e-12);
        assert!((parts[1] - 0.75).abs() < 1e-12);
    }
}
