//! The ceiling that the entropy of independent beads puts on the information of any encoder.
//!
//! Every object pixel holds a bead with probability p, independently. By the chain rule the information is at most
//! the sum over object pixels of what the patch tells about one pixel when all others are known, and that is largest
//! when the others hold no bead: their light adds nothing but noise.
//!
//! For one bead, take a Gaussian channel of unit variance whose two inputs lie
//! `d^2 = sum over the patch of (added photons)^2 / bias` apart. It tells at least as much as the Poisson counts do,
//! for every p. Proof: let the counts have mean `bias + a q X`, add a Gaussian observation of squared separation
//! `(1 - a^2) q^2 / bias`, and raise a from 0 to 1. With the posterior probability `w` of a bead, the counts gain
//! information at the rate `E[q w ln((bias + a q) / (bias + a q w))] <= (a q^2 / bias) E[w (1 - w)]` (Guo, Shamai and
//! Verdú 2008) and the Gaussian observation loses it at the rate `(a q^2 / bias) E[w (1 - w)]` (Guo, Shamai and Verdú
//! 2005), so the total falls from the Gaussian channel's information to that of the counts.
//!
//! With read noise the separation is measured in the Fisher information of a pixel at the bias level: `1 / sigma^2` for
//! read noise alone, where the channel is Gaussian itself. For both noises the variance `bias + sigma^2` would be too
//! large: counts blurred by a small read noise tell more than a Gaussian of that variance (Cramér and Rao), so the
//! Fisher information of the mixture is taken, which lies between `1 / (bias + sigma^2)` and `1 / bias`. That it bounds
//! finite separations as well is not proven, but an enumeration over p, bias, read noise and separation (see the tests)
//! finds no exception.

use ndarray::{ArrayView2, ArrayView3};

use super::InformationError;
use super::conditional::check_noise;
use super::interpolation::UniformTable;
use super::poisson_gaussian::fisher_information;
use crate::sensor::Noise;

/// Separations that are tabulated; farther apart a bead is seen for certain, to 1e-13 bit.
const LARGEST_SEPARATION: f64 = 16.0;
const SEPARATION_STEP: f64 = 0.02;
/// A bead that adds less of its own energy (sum of squared photons) to the patch than this share does not touch it.
const TOUCHES: f64 = 1e-12;

/// Entropy of a yes-or-no question with probability `p`, in bits.
pub fn binary_entropy(p: f64) -> f64 {
    let term = |q: f64| if q > 0.0 { -q * q.log2() } else { 0.0 };
    term(p) + term(1.0 - p)
}

/// Upper bound on the information that any estimate of a patch of independent beads can truly have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ceiling {
    /// The ceiling, bits per pixel of the patch.
    pub bits_per_pixel: f64,
    /// The cruder bound that needs no noise: entropy of all object pixels that touch the patch, bits per pixel.
    pub footprint_entropy: f64,
    /// Object pixels that touch the patch, over all planes.
    pub footprint_pixels: usize,
    /// Entropy of one object pixel, bits.
    pub entropy_per_object_pixel: f64,
}

/// Ceilings for beads of one density; keeps a table, so make it once per object set.
#[derive(Clone, Debug)]
pub struct BeadCeiling {
    entropy: f64,
    information: UniformTable,
}

impl BeadCeiling {
    /// Ceilings for beads that occupy each object pixel with the given probability.
    ///
    /// # Errors
    /// When the probability is not between 0 and 1.
    pub fn new(probability: f64) -> Result<Self, InformationError> {
        if !(probability > 0.0 && probability < 1.0) {
            return Err(InformationError::Probability { found: probability });
        }
        let nodes = (LARGEST_SEPARATION / SEPARATION_STEP).round() as usize + 1;
        let values = (0..nodes).map(|i| two_point_information(probability, i as f64 * SEPARATION_STEP)).collect();
        Ok(Self { entropy: binary_entropy(probability), information: UniformTable::new(0.0, SEPARATION_STEP, values) })
    }

    /// The ceiling of one encoder.
    ///
    /// - `spot`: photons that one bead adds on an infinite sensor (bead convolved with the point spread function),
    ///   shape (planes, rows, cols);
    /// - `bias`: photons per pixel where there is no bead; 0 makes every bead that touches the patch count in full;
    /// - `patch`: (rows, cols), up to the whole sensor.
    ///
    /// # Errors
    /// For an empty patch or spot, no noise, or photons that are negative or not finite.
    pub fn evaluate(
        &self,
        spot: ArrayView3<'_, f64>,
        bias: f64,
        patch: (usize, usize),
        noise: Noise,
    ) -> Result<Ceiling, InformationError> {
        check_noise(noise)?;
        let (rows, cols) = patch;
        if rows == 0 || cols == 0 {
            return Err(InformationError::PatchSize { rows, cols, limit: super::MAX_PATCH_PIXELS });
        }
        let (_, found_rows, found_cols) = spot.dim();
        if spot.is_empty() {
            let (what, rows, cols) = ("bead spot", usize::MAX, usize::MAX);
            return Err(InformationError::SpotShape { what, rows, cols, found_rows, found_cols });
        }
        if let Some(&found) = spot.iter().chain([&bias]).find(|value| !(value.is_finite() && **value >= 0.0)) {
            return Err(InformationError::Photons { found });
        }
        let precision = match noise {
            Noise::None => return Err(InformationError::NoNoise),
            Noise::Shot => 1.0 / bias,
            Noise::Read { sigma } => 1.0 / (sigma * sigma),
            Noise::ShotRead { sigma } => fisher_information(bias, sigma),
        };
        let (mut bits, mut footprint_pixels) = (0.0, 0_usize);
        for plane in spot.outer_iter() {
            let sums = AreaSums::of_squares(plane);
            let least = TOUCHES * sums.total();
            for last_row in 0..rows + plane.nrows() - 1 {
                for last_col in 0..cols + plane.ncols() - 1 {
                    let energy = sums.overlap(last_row, last_col, patch);
                    if energy > least {
                        footprint_pixels += 1;
                        let separation = (energy * precision).sqrt();
                        bits += self.information.at(separation.min(LARGEST_SEPARATION)).clamp(0.0, self.entropy);
                    }
                }
            }
        }
        let pixels = (rows * cols) as f64;
        Ok(Ceiling {
            bits_per_pixel: bits / pixels,
            footprint_entropy: footprint_pixels as f64 * self.entropy / pixels,
            footprint_pixels,
            entropy_per_object_pixel: self.entropy,
        })
    }
}

/// Information in bits of a Bernoulli(p) input about which of two unit Gaussians, `d` apart, was drawn.
///
/// `I = p d^2 / 2 - E0[g ln g]` nats with the likelihood ratio mixture `g = 1 - p + p exp(d u - d^2 / 2)`.
fn two_point_information(p: f64, d: f64) -> f64 {
    // The integrand is analytic up to pi / d off the real axis; this step leaves an error below 1e-10.
    let step = 0.05;
    let count = ((18.0 + d) / step).ceil() as usize;
    let density = |u: f64| (-0.5 * u * u).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let mut sum = 0.0;
    for i in 0..=count {
        let u = i as f64 * step - 9.0;
        let mixture = (1.0 - p) * density(u) + p * density(u - d);
        sum += mixture * (p * (d * u - 0.5 * d * d).exp_m1()).ln_1p();
    }
    ((0.5 * p * d * d - sum * step) / std::f64::consts::LN_2).max(0.0)
}

/// Sums of squares over rectangles, from a summed-area table.
pub(super) struct AreaSums {
    rows: usize,
    cols: usize,
    /// Entry [r, c] of (rows + 1) x (cols + 1): the sum over all pixels above and left.
    table: Vec<f64>,
}

impl AreaSums {
    pub(super) fn of_squares(plane: ArrayView2<'_, f64>) -> Self {
        let (rows, cols) = plane.dim();
        let mut table = vec![0.0; (rows + 1) * (cols + 1)];
        for r in 0..rows {
            let mut along_row = 0.0;
            for c in 0..cols {
                along_row += plane[[r, c]] * plane[[r, c]];
                table[(r + 1) * (cols + 1) + c + 1] = table[r * (cols + 1) + c + 1] + along_row;
            }
        }
        Self { rows, cols, table }
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        self.table[row * (self.cols + 1) + col]
    }

    /// Sum over the whole spot.
    pub(super) fn total(&self) -> f64 {
        self.at(self.rows, self.cols)
    }

    /// Sum over the part of the spot that falls on the patch when its last pixel lies on patch pixel (row, col), or
    /// beyond the patch's far side by as much.
    pub(super) fn overlap(&self, last_row: usize, last_col: usize, patch: (usize, usize)) -> f64 {
        // Spot pixel r lies on patch row last_row - (rows - 1) + r.
        let span = |last: usize, length: usize, side: usize| {
            let first = (length - 1).saturating_sub(last);
            (first, (side + length - 1 - last).min(length))
        };
        let (top, bottom) = span(last_row, self.rows, patch.0);
        let (left, right) = span(last_col, self.cols, patch.1);
        (self.at(bottom, right) - self.at(top, right) - self.at(bottom, left) + self.at(top, left)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_beads::bead_spot;
    use super::*;
    use ndarray::{Array1, Array3};

    fn normal(z: f64) -> f64 {
        (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt()
    }

    /// Poisson probabilities of 0, 1, ..., far into the tail.
    fn poisson(mean: f64) -> Vec<f64> {
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
    fn information(p: f64, dark: &[f64], lit: &[f64], step: f64) -> f64 {
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
            let ceilings = BeadCeiling::new(probability).unwrap();
            let found =
                ceilings.evaluate(bead_spot(lenslets, probability).view(), 10.0, (32, 32), Noise::Shot).unwrap();
            assert!((found.bits_per_pixel - expected).abs() <= 0.005, "{lenslets} {probability}: {found:?}");
            assert!(found.footprint_entropy > found.bits_per_pixel);
        }
    }

    #[test]
    fn table_holds_the_two_point_information() {
        let ceilings = BeadCeiling::new(0.02).unwrap();
        for d in [0.013, 0.5, 1.111, 3.333, 7.77, 15.99] {
            let grid: Vec<f64> = (0..120_000).map(|i| f64::from(i) * 0.0005 - 20.0).collect();
            let dark: Vec<f64> = grid.iter().map(|&u| normal(u)).collect();
            let lit: Vec<f64> = grid.iter().map(|&u| normal(u - d)).collect();
            let expected = information(0.02, &dark, &lit, 0.0005);
            let found = ceilings.information.at(d);
            assert!((found - expected).abs() < 1e-7, "{d}: {found} {expected}");
        }
        assert!((ceilings.information.at(16.0) - binary_entropy(0.02)).abs() < 1e-12);
    }

    #[test]
    fn counts_tell_no_more_than_the_gaussian_channel() {
        for bias in [0.02, 0.3, 1.0, 4.0, 10.0, 60.0] {
            for photons in [0.003, 0.05, 0.4, 1.5, 6.0, 30.0, 100.0] {
                let mut dark = poisson(bias);
                let mut lit = poisson(bias + photons);
                let length = dark.len().max(lit.len());
                dark.resize(length, 0.0);
                lit.resize(length, 0.0);
                for p in [1e-4, 0.008, 0.02, 0.11, 0.5, 0.9, 0.999] {
                    let exact = information(p, &dark, &lit, 1.0);
                    let bound = two_point_information(p, (photons / bias.sqrt()).min(LARGEST_SEPARATION))
                        .min(binary_entropy(p));
                    assert!(exact <= bound + 1e-11, "bias {bias}, photons {photons}, p {p}: {exact} > {bound}");
                }
            }
        }
    }

    #[test]
    fn blurred_counts_tell_no_more_than_the_fisher_channel() {
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

    #[test]
    fn enumerated_information_of_a_toy_stays_below() {
        // Four object pixels, three measured ones, a spot of two pixels; all counts and all objects enumerated.
        let spot = Array3::from_shape_vec((1, 1, 2), vec![6.0, 3.0]).unwrap();
        let (bias, p) = (1.5, 0.1_f64);
        let mut means = Vec::new();
        for object in 0..16_usize {
            let lit = |i: usize| f64::from(u8::from(object >> i & 1 == 1));
            // Object pixel i lights measured pixels i - 1 and i.
            let mean: Vec<f64> = (0..3).map(|j| bias + 6.0 * lit(j + 1) + 3.0 * lit(j)).collect();
            let ones = object.count_ones() as i32;
            means.push((p.powi(ones) * (1.0 - p).powi(4 - ones), mean));
        }
        let mut exact = 0.0;
        let tables: Vec<(f64, [Vec<f64>; 3])> =
            means.iter().map(|(w, m)| (*w, [poisson(m[0]), poisson(m[1]), poisson(m[2])])).collect();
        let at = |table: &Vec<f64>, k: usize| table.get(k).copied().unwrap_or(0.0);
        for counts in 0..50_usize.pow(3) {
            let y = [counts % 50, counts / 50 % 50, counts / 2500];
            let likelihoods =
                Array1::from_iter(tables.iter().map(|(_, t)| at(&t[0], y[0]) * at(&t[1], y[1]) * at(&t[2], y[2])));
            let evidence: f64 = tables.iter().zip(&likelihoods).map(|((w, _), l)| w * l).sum();
            for ((w, _), l) in tables.iter().zip(&likelihoods) {
                if *l > 0.0 {
                    exact += w * l * (l / evidence).log2();
                }
            }
        }
        let ceiling = BeadCeiling::new(p).unwrap().evaluate(spot.view(), bias, (1, 3), Noise::Shot).unwrap();
        assert_eq!(ceiling.footprint_pixels, 4);
        let bound = 3.0 * ceiling.bits_per_pixel;
        assert!(exact > 0.5 * bound && exact < bound, "{exact} {bound}");
    }

    #[test]
    fn limits_are_respected() {
        let ceilings = BeadCeiling::new(0.05).unwrap();
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
            assert!(BeadCeiling::new(found).is_err());
        }
        let ceilings = BeadCeiling::new(0.05).unwrap();
        let spot = Array3::from_elem((1, 3, 3), 2.0);
        let of = |spot: &Array3<f64>, bias, patch, noise| ceilings.evaluate(spot.view(), bias, patch, noise);
        assert_eq!(of(&spot, 10.0, (4, 4), Noise::None), Err(InformationError::NoNoise));
        assert!(of(&spot, -1.0, (4, 4), Noise::Shot).is_err());
        assert!(of(&spot, 10.0, (0, 4), Noise::Shot).is_err());
        assert!(of(&Array3::zeros((1, 0, 3)), 10.0, (4, 4), Noise::Shot).is_err());
        assert!(of(&Array3::from_elem((1, 3, 3), f64::NAN), 10.0, (4, 4), Noise::Shot).is_err());
    }
}
