//! Information of a binary input through photon counts.
//!
//! A bead adds `q_j` photons to the mean `b` of pixel j. Its log-likelihood ratio is
//! `L = sum_j [y_j ln(1 + q_j / b) - q_j]`. The posterior log-odds are `w = ln(p / (1 - p)) + L`. The information is
//! `H2(p)` less the expected posterior entropy. With the measure of the dark counts (`E0`) tilted half-way to the lit
//! ones, that entropy is
//!
//! `sqrt(p (1 - p)) E0[exp(L / 2) G(w)]` nats, `G(w) = exp(-w / 2) ln(1 + e^w) + exp(w / 2) ln(1 + e^-w)`.
//!
//! `G` is even and falls like `|w| exp(-|w| / 2)`. Its Fourier transform is `pi / ((t^2 + 1/4) cosh(pi t))`, from the
//! Mellin transform `pi / (s sin(pi s))` of `ln(1 + x)`. The remaining factor is the moment generating function of
//! `L` on the line `s = 1/2 + i t`. For counts it is a sum over the pixels of the patch,
//!
//! `E0 exp(s L) = exp(sum_j [b (1 + q_j / b)^s - b - s q_j])`,
//!
//! so one summed-area table for each t serves all places of a bead at once:
//!
//! `sqrt(p (1 - p)) int_0^inf Re[(p / (1 - p))^(i t) E0 exp((1/2 + i t) L)] / ((t^2 + 1/4) cosh(pi t)) dt`.
//!
//! The midpoint rule of step `2 pi / P` replaces `G(w)` by `sum_k (-1)^k G(w + k P)`. By Poisson's summation formula
//! it misses at most `P exp(-P / 2)` nats, and in the direction that makes the information too large. The tail of the
//! integral is added too, so the result stays an upper bound.

use std::f64::consts::{LN_2, PI, TAU};

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use crate::information::statistics::area_sums::{AreaSums, Corners};

/// Period P of the quadrature in log-odds; misses 1e-8 nats.
const PERIOD: f64 = 44.0;
/// Distance between the nodes of the quadrature.
const STEP: f64 = TAU / PERIOD;
/// Nodes of the quadrature; beyond them lie 2e-8 of the integral of the weights.
const NODES: usize = 32;
/// A posterior entropy below this share of the prior entropy counts as none.
const CERTAIN: f64 = 1e-7;
/// Smallest number of places per parallel task.
const PLACES_PER_TASK: usize = 256;

/// Weight of the integral at t.
fn weight(t: f64) -> f64 {
    1.0 / ((t * t + 0.25) * (PI * t).cosh())
}

/// The node of an index.
fn node(index: usize) -> f64 {
    (index as f64 + 0.5) * STEP
}

/// Upper bound on the sum of the weights beyond the last node, by `cosh x > exp(x) / 2`.
fn tail() -> f64 {
    let last = NODES as f64 * STEP;
    2.0 * (-PI * last).exp() / (PI * (last * last + 0.25))
}

/// Information of the counts of a patch about a bead, bits, for each of its `places`, when there is no other bead. It
/// is never too small, except for rounding.
///
/// - `spot`: photons that the bead adds, shape (rows, cols);
/// - `bias`: mean of every pixel without the bead, photons; 0 is allowed;
/// - `p`: probability of the bead, `entropy` its `H2(p)` in bits;
/// - `places`: the parts of the spot that fall on the patch.
pub(in crate::information) fn poisson_information(
    spot: ArrayView2<'_, f64>,
    bias: f64,
    p: f64,
    entropy: f64,
    places: &[Corners],
) -> Vec<f64> {
    let log_odds = (p / (1.0 - p)).ln();
    let scale = (p * (1.0 - p)).sqrt();
    // ln E0 exp(L / 2), written as a sum of squares, so that nothing cancels.
    let halves = AreaSums::new(spot.dim(), |r, c| {
        let q = spot[[r, c]];
        let difference = q / ((bias + q).sqrt() + bias.sqrt());
        if q > 0.0 { -0.5 * difference * difference } else { 0.0 }
    });
    // G is 2 ln 2 at most.
    let largest = |place: Corners| 2.0 * LN_2 * scale * halves.over(place).exp();
    let mut sums: Vec<(Corners, Option<f64>)> =
        places.iter().map(|&place| (place, (largest(place) > CERTAIN * entropy * LN_2).then_some(0.0))).collect();

    // (1 + q / b)^(i t), rotated from node to node; without background, b (1 + q / b)^s is 0.
    let turned = |angle: f64| -> Array2<Complex<f64>> {
        spot.mapv(|q| {
            let ratio = q / bias;
            if ratio.is_finite() { Complex::cis(angle * ratio.ln_1p()) } else { Complex::default() }
        })
    };
    let (mut power, turn) = (turned(node(0)), turned(STEP));
    for index in 0..NODES {
        let t = node(index);
        let exponents = AreaSums::new(spot.dim(), |r, c| {
            let q = spot[[r, c]];
            power[[r, c]] * (bias * (bias + q)).sqrt() - Complex::new(bias + 0.5 * q, t * q)
        });
        sums.par_iter_mut().with_min_len(PLACES_PER_TASK).for_each(|(place, sum)| {
            if let Some(sum) = sum {
                let exponent = exponents.over(*place);
                *sum += weight(t) * exponent.re.exp() * (exponent.im + t * log_odds).cos();
            }
        });
        power *= &turn;
    }
    let information = |place, sum: f64| {
        let nats = scale * (STEP * sum - tail() * halves.over(place).exp());
        entropy - nats.max(0.0) / LN_2
    };
    sums.into_iter().map(|(place, sum)| sum.map_or(entropy, |sum| information(place, sum))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::bead_upper_bound::binary_entropy;
    use super::super::gaussian_channel::two_point_information;
    use super::super::tests::{information, poisson};
    use super::*;

    #[test]
    fn quadrature_agrees_with_the_gaussian_channel() {
        for p in [1e-4, 0.008, 0.02, 0.3, 0.5, 0.97_f64] {
            for d in [0.01, 0.3, 1.0, 2.7, 5.0, 9.0_f64] {
                // L is Gaussian of mean -d^2 / 2 and variance d^2.
                let transform = |t: f64| (-0.5 * d * d * (0.25 + t * t)).exp();
                let log_odds = (p / (1.0 - p)).ln();
                let sum: f64 = (0..NODES).map(node).map(|t| weight(t) * transform(t) * (t * log_odds).cos()).sum();
                let entropy = (p * (1.0 - p)).sqrt() * (STEP * sum - tail() * transform(0.0));
                let found = binary_entropy(p) - entropy / LN_2;
                let expected = two_point_information(p, d);
                assert!(found > expected - 1e-9 && found < expected + 2e-7, "p {p}, d {d}: {found} {expected}");
            }
        }
    }

    #[test]
    fn one_pixel_agrees_with_the_sum_over_counts() {
        for bias in [0.0, 1e-6, 0.02, 0.3, 1.0, 10.0, 300.0] {
            for photons in [0.003, 0.05, 0.4, 1.5, 6.0, 30.0, 100.0] {
                let (mut dark, mut lit) = (poisson(bias), poisson(bias + photons));
                let length = dark.len().max(lit.len());
                dark.resize(length, 0.0);
                lit.resize(length, 0.0);
                for p in [1e-4, 0.008, 0.11, 0.5, 0.9] {
                    let expected = information(p, &dark, &lit, 1.0);
                    let spot = Array2::from_elem((1, 1), photons);
                    let place = AreaSums::new((1, 1), |_, _| 0.0).overlap((0, 0), (1, 1));
                    let found = poisson_information(spot.view(), bias, p, binary_entropy(p), &[place])[0];
                    let case = format!("bias {bias}, photons {photons}, p {p}: {found} {expected}");
                    assert!(found > expected - 1e-9 && found < expected + 3e-7, "{case}");
                }
            }
        }
    }

    #[test]
    fn two_pixels_agree_with_the_sum_over_pairs_of_counts() {
        let (bias, p, q) = (2.0, 0.07, [5.0, 1.5]);
        let [dark, first, second] = [bias, bias + q[0], bias + q[1]].map(poisson);
        let at = |table: &[f64], k: usize| table.get(k).copied().unwrap_or(0.0);
        let (mut both_dark, mut both_lit) = (Vec::new(), Vec::new());
        for (i, j) in (0..80).flat_map(|i| (0..80).map(move |j| (i, j))) {
            both_dark.push(at(&dark, i) * at(&dark, j));
            both_lit.push(at(&first, i) * at(&second, j));
        }
        let expected = information(p, &both_dark, &both_lit, 1.0);
        let spot = ndarray::arr2(&[q]);
        let place = AreaSums::new((1, 2), |_, _| 0.0).overlap((0, 1), (1, 2));
        let found = poisson_information(spot.view(), bias, p, binary_entropy(p), &[place])[0];
        assert!((found - expected).abs() < 3e-7, "{found} {expected}");
    }
}
