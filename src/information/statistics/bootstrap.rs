//! Intervals by resampling the test patches.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::student_t::student_95;
use crate::information::error::InformationError;
use crate::percentile::interval_95;

/// Resamplings of each of the two terms.
const RESAMPLINGS: u64 = 100;
/// Resamplings of paired differences; the ends of the interval then scatter by a few per cent of its width.
const PAIRED_RESAMPLINGS: u64 = 1000;
/// First random stream, far from those that number patches under the same seed.
const FIRST_STREAM: u64 = 1 << 48;

/// 95 % interval of the mean of `cross_entropy` minus the mean of `entropy_y_given_x`, both per test patch and in one
/// unit (bits per pixel).
///
/// It follows the publication (Kabuli et al. 2026) and serves the paper's protocol only. It makes 100 bootstraps of
/// either mean, independent of each other, and takes the 2.5 and 97.5 percentiles of all 100 x 100 differences. It
/// covers the choice of test patches only, neither the training patches nor the fit. It treats the two terms as
/// independent although they come from the same patches. Where bright patches raise both, as shot noise does, it
/// covers more than it states (0.99 of repeated tests instead of 0.95 in `tests/library/known_truths.rs`). With a single
/// patch both ends are the estimate itself.
///
/// # Errors
/// When either list is empty.
pub fn bootstrap_interval(
    cross_entropy: &[f64],
    entropy_y_given_x: &[f64],
    seed: u64,
) -> Result<[f64; 2], InformationError> {
    if cross_entropy.is_empty() || entropy_y_given_x.is_empty() {
        return Err(InformationError::Empty);
    }
    let first = resampled_means(cross_entropy, RESAMPLINGS, seed, FIRST_STREAM);
    let second = resampled_means(entropy_y_given_x, RESAMPLINGS, seed, FIRST_STREAM + RESAMPLINGS);
    Ok(interval_95(first.iter().flat_map(|a| second.iter().map(move |b| a - b)).collect()))
}

/// 95 % interval of the mean of `information`, the information of each test patch in bits per pixel: its cross-entropy minus
/// the noise entropy, or `log2 p(y|x) - log2 q(y)`. The 2.5 and 97.5 percentiles of 1000 bootstrap means; their distances
/// from the mean are stretched for Student's t and the variance over n - 1, as bootstraps of few values scatter too little.
///
/// Bright patches raise both terms alike and noise moves both logarithms alike, so the difference scatters less than either.
/// The interval covers the choice of test patches only, neither the training patches nor the fit. For a single patch both
/// ends are the estimate.
///
/// # Errors
/// When the list is empty, or a value is not finite.
pub fn paired_interval(information: &[f64], seed: u64) -> Result<[f64; 2], InformationError> {
    if information.is_empty() {
        return Err(InformationError::Empty);
    }
    if let Some(patch) = information.iter().position(|value| !value.is_finite()) {
        return Err(InformationError::NotFinite { what: "differences of log-densities", patch });
    }
    let means = resampled_means(information, PAIRED_RESAMPLINGS, seed, FIRST_STREAM + 2 * RESAMPLINGS);
    let n = information.len() as f64;
    let mean = information.iter().sum::<f64>() / n;
    let stretch = if n > 1.0 { student_95(n - 1.0) / student_95(f64::INFINITY) * (n / (n - 1.0)).sqrt() } else { 1.0 };
    Ok(interval_95(means).map(|end| mean + stretch * (end - mean)))
}

/// Means of as many draws with replacement as there are values; one random stream for each.
fn resampled_means(values: &[f64], resamplings: u64, seed: u64, first_stream: u64) -> Vec<f64> {
    (0..resamplings)
        .map(|index| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(first_stream + index);
            let sum: f64 = values.iter().map(|_| values[rng.random_range(0..values.len())]).sum();
            sum / values.len() as f64
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::StandardNormal;

    fn sample(count: usize, mean: f64, deviation: f64, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| mean + deviation * rng.sample::<f64, _>(StandardNormal)).collect()
    }

    #[test]
    fn interval_covers_the_truth_about_as_often_as_it_says() {
        let trials = 500;
        let covered = (0..trials)
            .filter(|&trial| {
                let cross_entropy = sample(200, 7.5, 0.6, 2 * trial);
                let conditional = sample(200, 7.0, 0.2, 2 * trial + 1);
                let [low, high] = bootstrap_interval(&cross_entropy, &conditional, trial).unwrap();
                low <= 0.5 && 0.5 <= high
            })
            .count();
        let share = covered as f64 / trials as f64;
        assert!((0.90..=0.98).contains(&share), "{share}");
    }

    #[test]
    fn width_is_that_of_the_standard_error() {
        let interval = |count| {
            let [low, high] = bootstrap_interval(&sample(count, 1.0, 0.5, 1), &sample(count, 0.0, 0.5, 2), 3).unwrap();
            high - low
        };
        let expected = 2.0 * 1.96 * 0.5 * (2.0_f64 / 4000.0).sqrt();
        assert!((interval(4000) / expected - 1.0).abs() < 0.2, "{}", interval(4000) / expected);
        assert!(interval(400) > 2.0 * interval(4000));
    }

    #[test]
    fn seed_decides() {
        let (a, b) = (sample(50, 1.0, 1.0, 1), sample(50, 0.0, 1.0, 2));
        assert_eq!(bootstrap_interval(&a, &b, 7), bootstrap_interval(&a, &b, 7));
        assert_ne!(bootstrap_interval(&a, &b, 7), bootstrap_interval(&a, &b, 8));
        assert_eq!(bootstrap_interval(&a[..1], &b[..1], 7), Ok([a[0] - b[0]; 2]));
        assert_eq!(bootstrap_interval(&[], &b, 7), Err(InformationError::Empty));
    }

    #[test]
    fn pairs_need_no_more_than_their_differences() {
        let differences = sample(2000, 0.4, 0.3, 5);
        let [low, high] = paired_interval(&differences, 1).unwrap();
        let expected = 2.0 * 1.96 * 0.3 / 2000.0_f64.sqrt();
        assert!(((high - low) / expected - 1.0).abs() < 0.15, "{low} {high}");
        assert_eq!(paired_interval(&differences, 1), Ok([low, high]));
        assert_ne!(paired_interval(&differences, 2), Ok([low, high]));
        assert_eq!(paired_interval(&[0.5], 1), Ok([0.5, 0.5]));
        assert_eq!(paired_interval(&[], 1), Err(InformationError::Empty));
        let broken = paired_interval(&[0.5, f64::NAN], 1).unwrap_err().to_string();
        assert!(broken.contains("not a finite number at patch 1"), "{broken}");
    }

    #[test]
    fn pairs_cover_as_often_when_they_are_few() {
        for count in [3, 8, 32] {
            let covers = |&trial: &u64| {
                let [low, high] = paired_interval(&sample(count, 0.4, 0.3, trial), trial).unwrap();
                (low..=high).contains(&0.4)
            };
            let covered = (0..400).filter(covers).count();
            assert!((372..=398).contains(&covered), "{count} patches: {covered} of 400");
        }
    }
}
