//! Exact Poisson samples, fast enough for every pixel of every mouse move.
//!
//! Means of at least 10 photons use transformed rejection with a squeeze (PTRS; Hörmann, "The transformed rejection
//! method for generating Poisson random variables", 1993): one division and one comparison settle most samples.
//! Smaller means sum the distribution up to a uniform number.

use rand::Rng;

/// Draws from the Poisson distribution of mean `mean` photons. A mean that is 0, negative or NaN gives 0.
pub fn sample_poisson(mean: f64, random: &mut impl Rng) -> f64 {
    if mean >= 10.0 {
        transformed_rejection(mean, random)
    } else if mean > 0.0 {
        inversion(mean, random)
    } else {
        0.0
    }
}

/// Two independent uniform numbers from one draw, in steps of 2^-32: (-1/2, 1/2) and (0, 1).
fn two_uniforms(random: &mut impl Rng) -> (f64, f64) {
    const STEP: f64 = 1.0 / 4_294_967_296.0;
    let bits = random.next_u64();
    let centred = (f64::from((bits >> 32) as u32) + 0.5) * STEP - 0.5;
    let unit = (f64::from(bits as u32) + 0.5) * STEP;
    (centred, unit)
}

fn transformed_rejection(mean: f64, random: &mut impl Rng) -> f64 {
    let b = 0.931 + 2.53 * mean.sqrt();
    let a = -0.059 + 0.024_83 * b;
    let v_r = 0.9277 - 3.6224 / (b - 2.0);
    loop {
        let (u, v) = two_uniforms(random);
        let us = 0.5 - u.abs();
        let k = ((2.0 * a / us + b) * u + mean + 0.43).floor();
        if us >= 0.07 && v <= v_r {
            return k;
        }
        if k < 0.0 || (us < 0.013 && v > us) {
            continue;
        }
        let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
        let left = (v * inverse_alpha / (a / (us * us) + b)).ln();
        if left <= k * mean.ln() - mean - ln_factorial(k) {
            return k;
        }
    }
}

fn inversion(mean: f64, random: &mut impl Rng) -> f64 {
    // 53 bits: the distribution is summed to the last digit that a uniform number has.
    let uniform = (random.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0;
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
fn ln_factorial(count: f64) -> f64 {
    const HALF_LN_TAU: f64 = 0.918_938_533_204_672_8;
    if let Some(&value) = LN_FACTORIALS.get(count as usize) {
        return value;
    }
    let inverse = 1.0 / count;
    let square = inverse * inverse;
    (count + 0.5) * count.ln() - count + HALF_LN_TAU + inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square / 1260.0))
}

/// ln k! for k = 0 to 9; beyond, four terms of Stirling's series are exact to 1e-10.
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

    /// Pearson's chi-square of a million samples against the distribution, for means on both sides of each method.
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
