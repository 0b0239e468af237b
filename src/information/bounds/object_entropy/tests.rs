//! The object-entropy bound against sums over counts, grids and small whole systems.

use ndarray::Array3;

use super::bead_upper_bound::{BeadEntropyBound, binary_entropy};
use super::gaussian_channel::two_point_information;
use crate::information::entropy::poisson_gaussian::fisher_information;
use crate::information::error::InformationError;
use crate::information::test_beads::bead_spot;
use crate::sensor::Noise;

/// Farthest separation in the table of the Gaussian channel.
const LARGEST_SEPARATION: f64 = 16.0;

pub(in crate::information) fn normal(z: f64) -> f64 {
    (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt()
}

/// Poisson probabilities of 0, 1, ..., far into the tail.
pub(in crate::information) fn poisson(mean: f64) -> Vec<f64> {
    let count = (mean + 12.0 * mean.sqrt() + 40.0) as usize;
    (0..count)
        .scan((-mean).exp(), |p, k| {
            let now = *p;
            *p *= mean / (k + 1) as f64;
            Some(now)
        })
        .collect()
}

/// Information in bits about a Bernoulli(p) input from its two output densities on a grid.
pub(in crate::information) fn information(p: f64, dark: &[f64], lit: &[f64], step: f64) -> f64 {
    let term = |w: f64, f: f64, mixture: f64| if f > 1e-290 { w * f * (f / mixture).log2() } else { 0.0 };
    let pairs = dark.iter().zip(lit);
    let sum: f64 = pairs
        .map(|(&a, &b)| {
            let mixture = (1.0 - p) * a + p * b;
            term(1.0 - p, a, mixture) + term(p, b, mixture)
        })
        .sum();
    sum * step
}

#[test]
fn published_settings_have_the_known_ceilings() {
    let known = [
        (1, 0.11, 0.69),
        (1, 0.05, 0.42),
        (1, 0.02, 0.21),
        (2, 0.02, 0.28),
        (4, 0.02, 0.36),
        (6, 0.02, 0.42),
        (9, 0.02, 0.44),
        (9, 0.013, 0.32),
        (9, 0.008, 0.22),
    ];
    for (lenslets, probability, expected) in known {
        let ceilings = BeadEntropyBound::new(probability).unwrap();
        let found = ceilings.evaluate(bead_spot(lenslets, probability).view(), 10.0, (32, 32), Noise::Shot).unwrap();
        assert!((found.bits_per_pixel - expected).abs() <= 0.005, "{lenslets} {probability}: {found:?}");
        assert!(found.footprint_entropy > found.bits_per_pixel);
    }
}

#[test]
fn counts_have_no_more_information_than_the_gaussian_channel() {
    for bias in [0.02, 0.3, 1.0, 4.0, 10.0, 60.0] {
        for photons in [0.003, 0.05, 0.4, 1.5, 6.0, 30.0, 100.0] {
            let mut dark = poisson(bias);
            let mut lit = poisson(bias + photons);
            let length = dark.len().max(lit.len());
            dark.resize(length, 0.0);
            lit.resize(length, 0.0);
            for p in [1e-4, 0.008, 0.02, 0.11, 0.5, 0.9, 0.999] {
                let exact = information(p, &dark, &lit, 1.0);
                let bound =
                    two_point_information(p, (photons / bias.sqrt()).min(LARGEST_SEPARATION)).min(binary_entropy(p));
                assert!(exact <= bound + 1e-11, "bias {bias}, photons {photons}, p {p}: {exact} > {bound}");
            }
        }
    }
}

#[test]
fn blurred_counts_have_no_more_information_than_the_fisher_channel() {
    let mut beaten = 0;
    for sigma in [0.12, 0.3, 0.5, 1.0, 4.0] {
        for bias in [0.02, 0.5, 3.0, 10.0] {
            let precision = fisher_information(bias, sigma);
            for photons in [0.02, 0.4, 3.0, 20.0] {
                let step = 0.125 * f64::min(sigma, 1.0);
                let from = -10.0 * sigma;
                let density = |mean: f64| -> Vec<f64> {
                    let weights = poisson(mean);
                    let count = ((poisson(bias + photons).len() as f64 + 20.0 * sigma) / step) as usize;
                    (0..count)
                        .map(|i| {
                            let y = from + i as f64 * step;
                            let low = (y - 11.0 * sigma).max(0.0) as usize;
                            let high = ((y + 11.0 * sigma).max(0.0) as usize + 1).min(weights.len());
                            (low..high).map(|k| weights[k] * normal((y - k as f64) / sigma) / sigma).sum()
                        })
                        .collect()
                };
                let (dark, lit) = (density(bias), density(bias + photons));
                for p in [1e-3, 0.02, 0.2, 0.5, 0.95] {
                    let exact = information(p, &dark, &lit, step);
                    let bound = two_point_information(p, (photons * precision.sqrt()).min(LARGEST_SEPARATION));
                    assert!(
                        exact <= bound.min(binary_entropy(p)) + 1e-9,
                        "sigma {sigma}, bias {bias}, photons {photons}, p {p}: {exact} > {bound}"
                    );
                    let naive =
                        two_point_information(p, (photons / (bias + sigma * sigma).sqrt()).min(LARGEST_SEPARATION));
                    beaten += usize::from(exact > naive + 1e-6);
                }
            }
        }
    }
    assert!(beaten > 0, "the variance bias + sigma^2 would have done");
}

/// Exact information of counts about independent objects of probability `p`, bits, by enumeration of all objects and
/// of counts below `most`. `light` holds the photons that each object adds to each pixel.
fn enumerated_information(p: f64, bias: f64, light: &[Vec<f64>], most: usize) -> f64 {
    let pixels = light[0].len();
    let objects: Vec<(f64, Vec<Vec<f64>>)> = (0..1_usize << light.len())
        .map(|object| {
            let lit: Vec<&Vec<f64>> = (0..light.len()).filter(|i| object >> i & 1 == 1).map(|i| &light[i]).collect();
            let probability = p.powi(lit.len() as i32) * (1.0 - p).powi((light.len() - lit.len()) as i32);
            let mean = |j: usize| bias + lit.iter().map(|photons| photons[j]).sum::<f64>();
            (probability, (0..pixels).map(|j| poisson(mean(j))).collect())
        })
        .collect();
    let at = |table: &Vec<f64>, k: usize| table.get(k).copied().unwrap_or(0.0);
    let mut bits = 0.0;
    for counts in 0..most.pow(pixels as u32) {
        let count = |j: usize| counts / most.pow(j as u32) % most;
        let likelihood =
            |tables: &Vec<Vec<f64>>| tables.iter().enumerate().map(|(j, table)| at(table, count(j))).product::<f64>();
        let likelihoods: Vec<f64> = objects.iter().map(|(_, tables)| likelihood(tables)).collect();
        let evidence: f64 = objects.iter().zip(&likelihoods).map(|((w, _), l)| w * l).sum();
        for ((w, _), l) in objects.iter().zip(&likelihoods).filter(|(_, l)| **l > 0.0) {
            bits += w * l * (l / evidence).log2();
        }
    }
    bits
}

#[test]
fn enumerated_information_of_a_toy_stays_below() {
    // Four object pixels, three measured ones, a spot of two pixels: object pixel i lights measured pixels i - 1 and i.
    let spot = Array3::from_shape_vec((1, 1, 2), vec![6.0, 3.0]).unwrap();
    let light: Vec<Vec<f64>> = (0..4_usize)
        .map(|i| (0..3).map(|j| if i == j + 1 { 6.0 } else { 3.0 * f64::from(u8::from(i == j)) }).collect())
        .collect();
    for (bias, p) in [(1.5, 0.1), (0.0, 0.1), (0.2, 0.4), (6.0, 0.02)] {
        let truth = enumerated_information(p, bias, &light, 50);
        let ceilings = BeadEntropyBound::new(p).unwrap();
        let gaussian = ceilings.evaluate(spot.view(), bias, (1, 3), Noise::Shot).unwrap();
        let exact = ceilings.evaluate_exact(spot.view(), bias, (1, 3), Noise::Shot).unwrap();
        assert_eq!((gaussian.footprint_pixels, exact.footprint_pixels), (4, 4));
        let bound = 3.0 * exact.bits_per_pixel;
        assert!(truth > 0.5 * bound && truth < bound, "bias {bias}, p {p}: {truth} {bound}");
        assert!(exact.bits_per_pixel < gaussian.bits_per_pixel, "bias {bias}, p {p}: {exact:?} {gaussian:?}");
    }
}

#[test]
fn enumerated_information_of_a_two_plane_toy_stays_below() {
    // Two measured pixels: three object pixels of the first plane touch them, two of the second.
    let spot = Array3::from_shape_vec((2, 1, 2), vec![5.0, 2.0, 0.0, 4.0]).unwrap();
    let light = [[2.0, 0.0], [5.0, 2.0], [0.0, 5.0], [4.0, 0.0], [0.0, 4.0]].map(Vec::from);
    for (bias, p) in [(1.0, 0.1), (3.0, 0.3)] {
        let truth = enumerated_information(p, bias, &light, 70);
        let ceiling = BeadEntropyBound::new(p).unwrap().evaluate_exact(spot.view(), bias, (1, 2), Noise::Shot).unwrap();
        assert_eq!(ceiling.footprint_pixels, 5);
        let bound = 2.0 * ceiling.bits_per_pixel;
        assert!(truth > 0.4 * bound && truth < bound, "bias {bias}, p {p}: {truth} {bound}");
    }
}

#[test]
fn exact_ceilings_of_published_settings_lie_a_little_below_the_gaussian_ones() {
    // By Monte Carlo on the exact log-likelihood ratios: .2113, .3625, .4399, .2163, with an error of about 2e-4.
    for (lenslets, probability, expected) in
        [(1, 0.02, 0.2113), (4, 0.02, 0.3625), (9, 0.02, 0.4399), (9, 0.008, 0.2163)]
    {
        let ceilings = BeadEntropyBound::new(probability).unwrap();
        let spot = bead_spot(lenslets, probability);
        let gaussian = ceilings.evaluate(spot.view(), 10.0, (32, 32), Noise::Shot).unwrap();
        let exact = ceilings.evaluate_exact(spot.view(), 10.0, (32, 32), Noise::Shot).unwrap();
        assert!((exact.bits_per_pixel - expected).abs() < 1e-3, "{lenslets} {probability}: {exact:?}");
        assert!(exact.bits_per_pixel < gaussian.bits_per_pixel, "{lenslets} {probability}: {exact:?}");
        assert_eq!(exact.footprint_pixels, gaussian.footprint_pixels);
    }
}

#[test]
fn limits_are_respected() {
    let ceilings = BeadEntropyBound::new(0.05).unwrap();
    let spot = Array3::from_elem((2, 3, 4), 2.0);
    let of = |bias, noise| ceilings.evaluate(spot.view(), bias, (5, 6), noise).unwrap();
    let dark = of(0.0, Noise::Shot);
    assert_eq!(dark.footprint_pixels, 2 * 7 * 9);
    assert!((dark.bits_per_pixel - dark.footprint_entropy).abs() < 1e-12, "no bias: every bead in full");
    assert!(of(1e12, Noise::Shot).bits_per_pixel < 1e-9);
    // The more read noise, the less information; a little read noise changes little.
    let series = [0.01, 0.5, 2.0, 20.0].map(|sigma| of(3.0, Noise::ShotRead { sigma }).bits_per_pixel);
    assert!(series.is_sorted_by(|a, b| a > b), "{series:?}");
    assert!((series[0] - of(3.0, Noise::Shot).bits_per_pixel).abs() < 1e-9);
    assert!(of(0.0, Noise::ShotRead { sigma: 2.0 }).bits_per_pixel < dark.bits_per_pixel);
    assert_eq!(of(9.0, Noise::Read { sigma: 3.0 }), of(9.0, Noise::Shot), "one variance");
}

#[test]
fn bad_requests_get_reasons() {
    for found in [0.0, 1.0, -0.1, f64::NAN] {
        assert!(BeadEntropyBound::new(found).is_err());
    }
    let ceilings = BeadEntropyBound::new(0.05).unwrap();
    let spot = Array3::from_elem((1, 3, 3), 2.0);
    let of = |spot: &Array3<f64>, bias, patch, noise| ceilings.evaluate(spot.view(), bias, patch, noise);
    assert_eq!(of(&spot, 10.0, (4, 4), Noise::None), Err(InformationError::NoNoise));
    assert!(of(&spot, -1.0, (4, 4), Noise::Shot).is_err());
    assert!(of(&spot, 10.0, (0, 4), Noise::Shot).is_err());
    assert!(of(&Array3::zeros((1, 0, 3)), 10.0, (4, 4), Noise::Shot).is_err());
    assert!(of(&Array3::from_elem((1, 3, 3), f64::NAN), 10.0, (4, 4), Noise::Shot).is_err());
    let exact = |bias, patch, noise| ceilings.evaluate_exact(spot.view(), bias, patch, noise);
    assert_eq!(exact(10.0, (4, 4), Noise::None), Err(InformationError::NoNoise));
    assert_eq!(exact(f64::INFINITY, (4, 4), Noise::Shot), Err(InformationError::Photons { found: f64::INFINITY }));
    assert!(exact(10.0, (4, 0), Noise::Shot).is_err());
    let read = Noise::Read { sigma: 3.0 };
    assert_eq!(exact(10.0, (4, 4), read), of(&spot, 10.0, (4, 4), read), "the Gaussian channel is exact already");
    assert!(exact(1e-300, (4, 4), Noise::Shot).unwrap().bits_per_pixel > 0.0, "hardly any background");
}
