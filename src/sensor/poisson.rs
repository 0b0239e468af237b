//! Exact Poisson samples, fast enough to sample every pixel at every mouse move.
//!
//! Means of at least 10 photons use the modified normal distribution (Ahrens and Dieter, "Computer generation of Poisson
//! deviates from modified normal distributions", ACM TOMS 8, 1982). Nearly all samples are a normal number rounded down
//! that passes a cubic squeeze. Exact quotients decide the others. Smaller means sum the distribution up to a uniform
//! number.

use rand::Rng;
use rand_distr::{Distribution, Exp1, StandardNormal};

/// Sample from the Poisson distribution of mean `mean` photons. A mean that is 0, negative or NaN gives 0.
pub fn sample_poisson(mean: f64, random: &mut impl Rng) -> f64 {
    if mean >= 10.0 {
        modified_normal(mean, random)
    } else if mean > 0.0 {
        inversion(mean, random)
    } else {
        0.0
    }
}

/// A uniform number in [0, 1) with all 53 bits.
fn uniform(random: &mut impl Rng) -> f64 {
    (random.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0
}

fn modified_normal(mean: f64, random: &mut impl Rng) -> f64 {
    let deviation = mean.sqrt();
    let normal: f64 = StandardNormal.sample(random);
    let candidate = mean + deviation * normal;
    // Truncation equals rounding down here, and is much cheaper than `floor` without SSE 4.1.
    let count = candidate as i64 as f64;
    // Above the mean the Poisson probability exceeds the normal one. Below, it falls short by a margin that this cubic
    // bounds. One test serves both sides: a branch on the side would be mispredicted half of the time.
    let short = mean - count;
    let u = uniform(random);
    if 6.0 * mean * mean * u >= short * short * short && candidate >= 0.0 {
        return count;
    }
    if candidate < 0.0 {
        return double_exponential(mean, deviation, random);
    }
    let quotient = Quotient::new(mean, deviation);
    if quotient.normal(count) * (1.0 - u) <= quotient.poisson(count) {
        return count;
    }
    double_exponential(mean, deviation, random)
}

/// Samples the part of the Poisson distribution that exceeds the normal one, under a double exponential hat.
fn double_exponential(mean: f64, deviation: f64, random: &mut impl Rng) -> f64 {
    let quotient = Quotient::new(mean, deviation);
    // Height of the hat; it covers the excess for every mean from 10 on.
    let height = 0.1069 / mean;
    loop {
        let exponential: f64 = Exp1.sample(random);
        let u = 2.0 * uniform(random) - 1.0;
        let t = 1.8 + exponential.copysign(u);
        if t <= -0.6744 {
            continue;
        }
        let count = (mean + deviation * t).floor();
        let excess = quotient.poisson(count) - quotient.normal(count);
        if height * u.abs() <= excess * exponential.exp() {
            return count;
        }
    }
}

/// The two compared distributions: Poisson probabilities, and the discrete normal distribution that is sampled first.
/// Both use the expansion of Ahrens and Dieter.
struct Quotient {
    mean: f64,
    deviation: f64,
    omega: f64,
    coefficients: [f64; 4],
}

impl Quotient {
    fn new(mean: f64, deviation: f64) -> Self {
        let b1 = 1.0 / (24.0 * mean);
        let b2 = 0.3 * b1 * b1;
        let c3 = b1 * b2 / 7.0;
        let c2 = b2 - 15.0 * c3;
        let c1 = b1 - 6.0 * b2 + 45.0 * c3;
        let c0 = 1.0 - b1 + 3.0 * b2 - 15.0 * c3;
        Self { mean, deviation, omega: INVERSE_ROOT_TAU / deviation, coefficients: [c0, c1, c2, c3] }
    }

    fn poisson(&self, count: f64) -> f64 {
        (count * self.mean.ln() - self.mean - ln_factorial(count)).exp()
    }

    fn normal(&self, count: f64) -> f64 {
        let x = (0.5 - (self.mean - count)) / self.deviation;
        let square = x * x;
        let [c0, c1, c2, c3] = self.coefficients;
        self.omega * (((c3 * square + c2) * square + c1) * square + c0) * (-0.5 * square).exp()
    }
}

/// 1 / sqrt(2 pi)
const INVERSE_ROOT_TAU: f64 = 0.398_942_280_401_432_7;

fn inversion(mean: f64, random: &mut impl Rng) -> f64 {
    let uniform = uniform(random);
    let mut probability = (-mean).exp();
    let mut sum = probability;
    let mut count = 0.0;
    // Below 10 photons the tail beyond 100 has no weight in 53 bits.
    while uniform > sum && count < 100.0 {
        count += 1.0;
        probability *= mean / count;
        sum += probability;
    }
    count
}

/// Natural logarithm of `count`!, exact to rounding: a table, then Stirling's series.
pub fn ln_factorial(count: f64) -> f64 {
    const HALF_LN_TAU: f64 = 0.918_938_533_204_672_8;
    if let Some(&value) = LN_FACTORIALS.get(count as usize) {
        return value;
    }
    let inverse = 1.0 / count;
    let square = inverse * inverse;
    (count + 0.5) * count.ln() - count + HALF_LN_TAU + inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square / 1260.0))
}

/// ln k! for k = 0 to 9. Beyond, four terms of Stirling's series are exact to 1e-10.
const LN_FACTORIALS: [f64; 10] = [
    0.0,
    0.0,
    std::f64::consts::LN_2,
    1.791_759_469_228_055,
    3.178_053_830_347_945_8,
    4.787_491_742_782_046,
    6.579_251_212_010_101,
    8.525_161_361_065_415,
    10.604_602_902_745_25,
    12.801_827_480_081_469,
];

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn ln_factorial_is_the_sum_of_logarithms() {
        let mut sum = 0.0;
        for k in 1..200 {
            sum += f64::from(k).ln();
            assert!((ln_factorial(f64::from(k)) - sum).abs() < 2e-9, "{k}");
        }
    }

    /// Pearson's chi-square of a million samples against the distribution, for means on both sides of each method's
    /// limit.
    #[test]
    fn samples_follow_the_distribution() {
        const SAMPLES: usize = 1_000_000;
        for (seed, mean) in [0.3, 4.0, 9.99, 10.0, 13.7, 110.0, 2345.6].into_iter().enumerate() {
            let mut random = ChaCha8Rng::seed_from_u64(seed as u64);
            let largest = (mean + 12.0 * f64::sqrt(mean) + 20.0) as usize;
            let mut counts = vec![0_usize; largest + 1];
            for _ in 0..SAMPLES {
                counts[(sample_poisson(mean, &mut random) as usize).min(largest)] += 1;
            }
            // Bins with fewer than 20 expected samples are pooled with their neighbours.
            let (mut chi_square, mut bins) = (0.0, 0_usize);
            let (mut expected, mut found) = (0.0, 0.0);
            for (k, &count) in counts.iter().enumerate() {
                let k = k as f64;
                expected += SAMPLES as f64 * (k * mean.ln() - mean - ln_factorial(k)).exp();
                found += count as f64;
                if expected >= 20.0 {
                    chi_square += (found - expected).powi(2) / expected;
                    bins += 1;
                    (expected, found) = (0.0, 0.0);
                }
            }
            let freedom = bins as f64 - 1.0;
            let z = (chi_square - freedom) / (2.0 * freedom).sqrt();
            assert!(z < 4.5, "mean {mean}: chi-square {chi_square} with {freedom} degrees of freedom");
        }
    }

    #[test]
    fn no_light_no_photons() {
        let mut random = ChaCha8Rng::seed_from_u64(0);
        for mean in [0.0, -1.0, f64::NAN] {
            assert_eq!(sample_poisson(mean, &mut random), 0.0);
        }
    }
}
