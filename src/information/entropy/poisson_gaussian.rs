//! A Poisson count plus Gaussian read noise: entropy of the sum, and its Fisher information about the mean.

use rayon::prelude::*;

use super::noise_entropy::gaussian_entropy;
use super::poisson::poisson_entropy;
use crate::information::statistics::uniform_table::UniformTable;

/// Read noise (photons) below which counts are separated without error: the overlap of neighbouring peaks takes less
/// than 1e-7 bit from the entropy.
const SEPARATE_BELOW: f64 = 0.09;
/// The table spans these logarithms of the mean: below it the count is zero to 1e-8 bit, above it a series serves.
const LN_FIRST: f64 = -20.8;
const LN_STEP: f64 = 1.0 / 32.0;
/// From this mean on (photons) the series is used.
const SERIES_FROM: f64 = 96.0;
/// Half width of every sum over Gaussians, in standard deviations.
const REACH: f64 = 9.0;

/// Differential entropy of `Poisson(x) + sigma e`, tabulated for one `sigma`, as a function of `x`.
///
/// Up to 96 photons the integral is tabulated over ln x. Beyond, the entropy is that of a Gaussian of variance
/// `x + sigma^2` with corrections. They are the Edgeworth terms of skewness and excess (Comon 1994) and the comb of
/// whole counts that remains visible through a small read noise. A remainder in powers of `1/x` is fitted to three
/// integrals. The error is below 1e-6 bit (tests compare with a separate integration).
#[derive(Clone, Debug)]
pub(in crate::information) struct PoissonGaussianEntropy {
    sigma: f64,
    /// None when the peaks are separate.
    table: Option<UniformTable>,
    comb: f64,
    remainder: [f64; 3],
}

impl PoissonGaussianEntropy {
    /// Tabulates the entropy for a read noise of `sigma` photons, which must be positive and finite.
    pub(in crate::information) fn new(sigma: f64) -> Self {
        if sigma < SEPARATE_BELOW {
            return Self { sigma, table: None, comb: 0.0, remainder: [0.0; 3] };
        }
        let nodes = ((SERIES_FROM.ln() - LN_FIRST) / LN_STEP).ceil() as usize + 3;
        let values = (0..nodes)
            .into_par_iter()
            .map(|i| Mixture::new((LN_FIRST + i as f64 * LN_STEP).exp(), sigma).entropy_bits())
            .collect();
        let comb = comb_entropy(sigma);
        let means = [SERIES_FROM, 2.0 * SERIES_FROM, 4.0 * SERIES_FROM];
        let gaps = means.map(|x| Mixture::new(x, sigma).entropy_bits() - leading_terms(x, sigma, comb));
        Self {
            sigma,
            table: Some(UniformTable::new(LN_FIRST, LN_STEP, values)),
            comb,
            remainder: inverse_powers(means, gaps),
        }
    }

    /// Entropy in bits at a mean of `x` photons, `x >= 0`.
    pub(in crate::information) fn bits(&self, x: f64) -> f64 {
        match &self.table {
            None => poisson_entropy(x) + gaussian_entropy(self.sigma * self.sigma),
            Some(table) if x < SERIES_FROM => table.at(x.ln()),
            Some(_) => {
                let r = 1.0 / x;
                let [a, b, c] = self.remainder;
                leading_terms(x, self.sigma, self.comb) + r * (a + r * (b + r * c))
            }
        }
    }
}

/// Gaussian entropy with the first Edgeworth terms and the comb, bits.
fn leading_terms(x: f64, sigma: f64, comb: f64) -> f64 {
    let variance = x + sigma * sigma;
    let skewness_squared = x * x / (variance * variance * variance);
    let excess = x / (variance * variance);
    let negentropy =
        skewness_squared / 12.0 + excess * excess / 48.0 + 7.0 * skewness_squared * skewness_squared / 48.0
            - skewness_squared * excess / 8.0;
    gaussian_entropy(variance) - negentropy / std::f64::consts::LN_2 - comb
}

/// Information about a number's fractional part when whole numbers are blurred by `sigma`, bits: zero for a wide
/// blur, minus the entropy of the blur for a narrow one.
fn comb_entropy(sigma: f64) -> f64 {
    let steps = (1.0 / spacing(sigma)).ceil().max(8.0);
    let reach = (REACH * sigma).ceil() as i64 + 1;
    let mut sum = 0.0;
    for i in 0..steps as usize {
        let u = i as f64 / steps;
        let density: f64 = (-reach..=reach).map(|k| normal(u - k as f64, sigma)).sum();
        sum += density * density.log2();
    }
    sum / steps
}

/// Step of the trapezoid rule, photons. The integrands are analytic up to `pi sigma^2` off the real axis, where two
/// neighbouring peaks cancel, so the error falls as `exp(-2 pi^2 sigma^2 / step)`: below 3e-9.
fn spacing(sigma: f64) -> f64 {
    (sigma * sigma).min(0.25 * sigma)
}

fn normal(u: f64, sigma: f64) -> f64 {
    let z = u / sigma;
    (-0.5 * z * z).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt())
}

/// Coefficients of `a/x + b/x^2 + c/x^3` through three points.
fn inverse_powers(x: [f64; 3], y: [f64; 3]) -> [f64; 3] {
    let r = x.map(f64::recip);
    let z = [y[0] * x[0], y[1] * x[1], y[2] * x[2]];
    let first = (z[1] - z[0]) / (r[1] - r[0]);
    let second = ((z[2] - z[1]) / (r[2] - r[1]) - first) / (r[2] - r[0]);
    [z[0] - first * r[0] + second * r[0] * r[1], first - second * (r[0] + r[1]), second]
}

/// The density of `Poisson(x) + sigma e` on a grid.
struct Mixture {
    sigma: f64,
    /// Count of the first weight.
    first: f64,
    weights: Vec<f64>,
}

impl Mixture {
    fn new(x: f64, sigma: f64) -> Self {
        let mode = x.floor();
        let mut upwards = Vec::new();
        let mut weight = 1.0;
        let mut k = mode;
        // Relative to the mode, terms below 1e-18 change no sum.
        while weight > 1e-18 || k < mode + 2.0 {
            upwards.push(weight);
            k += 1.0;
            weight *= x / k;
        }
        let mut weights = Vec::new();
        weight = 1.0;
        k = mode;
        while k > 0.0 {
            weight *= k / x;
            if weight < 1e-18 {
                break;
            }
            k -= 1.0;
            weights.push(weight);
        }
        weights.reverse();
        weights.append(&mut upwards);
        let total: f64 = weights.iter().sum();
        for weight in &mut weights {
            *weight /= total;
        }
        Self { sigma, first: k, weights }
    }

    /// Sum over a grid of `term(density of each of the given weightings)`, times the step: a trapezoid integral.
    fn integrate<const N: usize>(&self, weights: [&[f64]; N], term: impl Fn([f64; N]) -> f64) -> f64 {
        let step = spacing(self.sigma);
        let reach = REACH * self.sigma;
        let span = (self.weights.len() - 1) as f64 + 2.0 * reach;
        let mut sum = 0.0;
        for i in 0..=(span / step).ceil() as usize {
            // Position relative to the first count.
            let y = i as f64 * step - reach;
            let low = (y - reach).ceil().max(0.0) as usize;
            let high = ((y + reach).floor().max(-1.0) + 1.0) as usize;
            let mut densities = [0.0; N];
            for k in low..high.min(self.weights.len()) {
                let kernel = normal(y - k as f64, self.sigma);
                for (density, weights) in densities.iter_mut().zip(weights) {
                    *density += weights[k] * kernel;
                }
            }
            if densities[0] > 0.0 {
                sum += term(densities);
            }
        }
        sum * step
    }

    fn entropy_bits(&self) -> f64 {
        -self.integrate([&self.weights], |[density]| density * density.log2())
    }

    /// Fisher information about the Poisson mean `x`, per photon squared.
    fn fisher_information(&self, x: f64) -> f64 {
        // The derivative of a Poisson probability by its mean is (k / x - 1) times itself.
        let slopes: Vec<f64> =
            (0..self.weights.len()).map(|i| self.weights[i] * ((self.first + i as f64) / x - 1.0)).collect();
        self.integrate([&self.weights, &slopes], |[density, slope]| slope * slope / density)
    }
}

/// Fisher information of one pixel of `Poisson(x) + sigma e` about `x`, per photon squared.
///
/// It lies between `1/(x + sigma^2)`, the value of a Gaussian of that variance, and `1/x`, that of the bare count;
/// infinite only for `x = 0` with a read noise that leaves counts separate.
pub(in crate::information) fn fisher_information(x: f64, sigma: f64) -> f64 {
    if sigma < SEPARATE_BELOW {
        return 1.0 / x;
    }
    // At x = 0 the density is one Gaussian that starts to pass weight to the next: E[(f1/f0 - 1)^2] = exp(1/sigma^2) -
    // 1.
    let limit = (1.0 / (sigma * sigma)).exp_m1();
    if x <= 0.0 {
        return limit;
    }
    let information = Mixture::new(x, sigma).fisher_information(x);
    information.clamp(1.0 / (x + sigma * sigma), (1.0 / x).min(limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Brute force: a plain Riemann sum on a much finer and wider grid, every Gaussian evaluated everywhere.
    fn entropy_by_brute_force(x: f64, sigma: f64) -> f64 {
        let (low, high) = ((x - 12.0 * x.sqrt() - 20.0).max(0.0) as usize, (x + 14.0 * x.sqrt() + 40.0) as usize);
        let probabilities: Vec<(f64, f64)> = (0..=high)
            .scan(0.0, |ln_factorial, k| {
                *ln_factorial += if k > 1 { (k as f64).ln() } else { 0.0 };
                let power = if k == 0 { 0.0 } else { k as f64 * x.ln() };
                Some((k as f64, (power - x - *ln_factorial).exp()))
            })
            .skip(low)
            .collect();
        let step = 0.037 * sigma.min(1.0);
        let from = low as f64 - 11.0 * sigma;
        let count = ((high as f64 + 11.0 * sigma - from) / step) as usize;
        let sum: f64 = (0..count)
            .map(|i| {
                let y = from + i as f64 * step;
                let near = probabilities.iter().filter(|(k, _)| (y - k).abs() < 12.0 * sigma);
                let density: f64 = near.map(|(k, p)| p * normal(y - k, sigma)).sum();
                if density > 0.0 { density * density.log2() } else { 0.0 }
            })
            .sum();
        -sum * step
    }

    #[test]
    fn table_and_series_agree_with_brute_force() {
        for sigma in [0.05, 0.0899, 0.0901, 0.2, 0.45, 0.8, 2.0, 5.0, 30.0] {
            let entropy = PoissonGaussianEntropy::new(sigma);
            for x in [1e-4, 0.03, 0.4, 1.7, 10.0, 33.3, 95.9, 96.1, 140.0, 700.0] {
                let (found, expected) = (entropy.bits(x), entropy_by_brute_force(x, sigma));
                assert!((found - expected).abs() < 1e-6, "sigma {sigma}, x {x}: {found} {expected}");
            }
        }
    }

    #[test]
    fn no_photons_leave_the_read_noise() {
        for sigma in [0.05, 0.3, 4.0] {
            let entropy = PoissonGaussianEntropy::new(sigma);
            assert!((entropy.bits(0.0) - gaussian_entropy(sigma * sigma)).abs() < 1e-6);
        }
    }

    #[test]
    fn many_photons_tend_to_a_gaussian_of_the_summed_variance() {
        let entropy = PoissonGaussianEntropy::new(3.0);
        for x in [1e3, 1e4, 1e6] {
            let gap = gaussian_entropy(x + 9.0) - entropy.bits(x);
            assert!(gap > 0.0 && gap < 0.13 / x, "{x}: {gap}");
        }
    }

    #[test]
    fn fisher_information_lies_between_its_limits_and_matches_a_difference_quotient() {
        for (x, sigma) in [(0.5, 0.4), (3.0, 1.0), (10.0, 0.3), (10.0, 5.0), (200.0, 2.0), (5e4, 10.0)] {
            let information = fisher_information(x, sigma);
            assert!(information >= 1.0 / (x + sigma * sigma) && information <= 1.0 / x, "{x} {sigma}: {information}");
        }
        // Kullback-Leibler divergence between neighbouring means is half the information times their squared distance.
        let (x, sigma, h) = (4.0, 0.6, 0.02);
        let (left, right) = (Mixture::new(x - h, sigma), Mixture::new(x + h, sigma));
        let mut divergence = 0.0;
        for i in -4000..20000 {
            let y = f64::from(i) * 0.002;
            let density = |mixture: &Mixture| -> f64 {
                let weights = mixture.weights.iter().enumerate();
                weights.map(|(k, p)| p * normal(y - mixture.first - k as f64, sigma)).sum()
            };
            let (p, q) = (density(&left), density(&right));
            if p > 1e-200 && q > 1e-200 {
                divergence += (p - q) * (p / q).ln() * 0.002;
            }
        }
        let information = fisher_information(x, sigma);
        assert!((divergence / (4.0 * h * h) - information).abs() < 1e-4 * information);
    }
}
