//! Estimates on fields of known information in closed form.

use lenslet_studio::information::{
    Covariance, GaussianRequest, Protocol, Trial, gaussian_entropy, gaussian_estimate, log2_determinant,
    poisson_entropy,
};
use lenslet_studio::sensor::Noise;
use ndarray::{Array2, Array3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

const SIDE: usize = 12;
const SIGMA: f64 = 2.0;
/// Kernel that filters white noise into a stationary field, photons.
const KERNEL: [[f64; 3]; 3] = [[1.0, 2.5, 0.5], [0.0, 3.0, 2.0], [-1.0, 1.5, 0.5]];

/// Clean and noisy patches of the filtered field.
fn gaussian_patches(count: usize, seed: u64) -> (Array3<f32>, Array3<f32>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut clean, mut noisy) = (Array3::zeros((count, SIDE, SIDE)), Array3::zeros((count, SIDE, SIDE)));
    for n in 0..count {
        let white = Array2::from_shape_simple_fn((SIDE + 2, SIDE + 2), || rng.sample::<f64, _>(StandardNormal));
        for r in 0..SIDE {
            for c in 0..SIDE {
                let mut value = 50.0;
                for (i, line) in KERNEL.iter().enumerate() {
                    for (j, weight) in line.iter().enumerate() {
                        value += weight * white[[r + i, c + j]];
                    }
                }
                clean[[n, r, c]] = value as f32;
                noisy[[n, r, c]] = (value + SIGMA * rng.sample::<f64, _>(StandardNormal)) as f32;
            }
        }
    }
    (clean, noisy)
}

/// `1/2 log2 det(C + sigma^2 I) / det(sigma^2 I)`, bits per pixel.
fn gaussian_truth() -> f64 {
    let lag = SIDE - 1;
    let mut autocovariance = Array2::zeros((2 * lag + 1, 2 * lag + 1));
    for i in 0..9 {
        for j in 0..9 {
            let (a, b) = (KERNEL[i / 3][i % 3], KERNEL[j / 3][j % 3]);
            autocovariance[[lag + i / 3 - j / 3, lag + i % 3 - j % 3]] += a * b;
        }
    }
    autocovariance[[lag, lag]] += SIGMA * SIGMA;
    let pixels = (SIDE * SIDE) as f64;
    0.5 * log2_determinant(&autocovariance, (SIDE, SIDE)).unwrap() / pixels - (SIGMA * SIGMA).log2() / 2.0
}

fn half_width(trial: &Trial) -> f64 {
    0.5 * (trial.interval_95()[1] - trial.interval_95()[0])
}

#[test]
fn gaussian_field_with_read_noise_has_the_closed_form() {
    let truth = gaussian_truth();
    let (_, train) = gaussian_patches(3000, 11);
    let (clean, test) = gaussian_patches(1500, 12);
    let estimate = |covariance| {
        let request = GaussianRequest {
            train: train.view(),
            test: test.view(),
            test_clean: Some(clean.view()),
            covariance,
            noise: Noise::Read { sigma: SIGMA },
            protocol: Protocol::Default,
            seed: 3,
        };
        gaussian_estimate(&request).unwrap()
    };
    let (stationary, full) = (estimate(Covariance::Stationary), estimate(Covariance::Full));
    let [low, high] = stationary.interval_95();
    assert!(low <= truth && truth <= high, "{truth} not in {low} .. {high}");
    assert!(half_width(&stationary) < 0.01, "the interval says something");
    assert!(full.bits_per_pixel() > truth - half_width(&full));
    // Ten thousand free parameters cost the full model about pixels / (4 patches) nats per pixel.
    let cost = full.bits_per_pixel() - stationary.bits_per_pixel();
    let expected = 144.0 / (4.0 * 3000.0) / std::f64::consts::LN_2;
    assert!(cost > 0.7 * expected && cost < 1.5 * expected, "{cost} {expected}");
}

#[test]
fn pixels_of_two_brightnesses_are_bounded_from_above() {
    let rates = [10.0, 40.0];
    let patches = |count: usize, seed: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let clean = Array3::from_shape_simple_fn((count, 8, 8), || rates[usize::from(rng.random::<bool>())] as f32);
        let noisy = clean.mapv(|x| Poisson::new(x).unwrap().sample(&mut rng));
        (clean, noisy)
    };
    let probability = |k: usize, x: f64| (1..=k).fold((-x).exp(), |p, i| p * x / i as f64);
    let entropy_y: f64 =
        (0..120).map(|k| 0.5 * (probability(k, rates[0]) + probability(k, rates[1]))).map(|p| -p * p.log2()).sum();
    let truth = entropy_y - 0.5 * (poisson_entropy(rates[0]) + poisson_entropy(rates[1]));
    assert!(truth > 0.9 && truth < 1.0, "nearly one bit, since the rates are far apart");

    let (_, train) = patches(3000, 1);
    let (clean, test) = patches(1000, 2);
    let mut found = Vec::new();
    for protocol in [Protocol::Default, Protocol::Paper] {
        let request = GaussianRequest {
            train: train.view(),
            test: test.view(),
            test_clean: Some(clean.view()),
            covariance: Covariance::Stationary,
            noise: Noise::Shot,
            protocol,
            seed: 4,
        };
        let trial = gaussian_estimate(&request).unwrap();
        assert!(trial.bits_per_pixel() > truth - half_width(&trial), "{} {truth}", trial.bits_per_pixel());
        // Variance 15^2 between the rates, 25 within them, 1/12 of dequantisation.
        assert!((trial.entropy_y() - gaussian_entropy(250.0 + 1.0 / 12.0)).abs() < 0.01, "{}", trial.entropy_y());
        found.push(trial.bits_per_pixel());
    }
    // The paper protocol overstates the noise entropy, by 0.0127 bit at 10 photons and 0.0030 at 40.
    let difference = found[0] - found[1];
    assert!((difference - 0.5 * (0.0127 + 0.0030)).abs() < 3e-4, "{difference}");
}
