//! Object-entropy bound for independent beads: an upper bound on the information of any encoder.
//!
//! Every object pixel holds a bead with probability p, independently. By the chain rule the information is at most a
//! sum over object pixels. The term of a pixel is the information of the patch about it when all others are known.
//! This term is largest when the others hold no bead: their light adds nothing but noise.
//!
//! For one bead, take a Gaussian channel of unit variance whose two inputs lie
//! `d^2 = sum over the patch of (added photons)^2 / bias` apart. For every p its information is at least that of the
//! Poisson counts. Proof: let the counts have mean `bias + a q X`, add a Gaussian observation of squared separation
//! `(1 - a^2) q^2 / bias`, and raise a from 0 to 1. Let `w` be the posterior probability of a bead. The counts gain
//! information at the rate `E[q w ln((bias + a q) / (bias + a q w))] <= (a q^2 / bias) E[w (1 - w)]` (Guo, Shamai and
//! Verdú 2008). The Gaussian observation loses it at the rate `(a q^2 / bias) E[w (1 - w)]` (Guo, Shamai and Verdú
//! 2005). The total therefore falls from the Gaussian channel's information to that of the counts.
//!
//! Shot noise needs no bound: [`BeadEntropyBound::evaluate_exact`] computes the information of the counts themselves
//! (see the module of the Poisson channel). It takes some milliseconds; the Gaussian channel takes a fraction of one.
//!
//! With read noise the separation is measured in the Fisher information of a pixel at the bias level. For read noise
//! alone this is `1 / sigma^2`, and the channel is Gaussian itself. For both noises the variance `bias + sigma^2`
//! would be too large: counts blurred by a small read noise hold more information than a Gaussian of that variance
//! (Cramér and Rao). The Fisher information of the mixture is used instead, which lies between `1 / (bias + sigma^2)`
//! and `1 / bias`. It is not proven that it bounds finite separations as well. An enumeration over p, bias, read
//! noise and separation (see the tests) finds no exception.

use ndarray::{ArrayView2, ArrayView3};

use super::gaussian_channel::two_point_information;
use super::poisson_channel::poisson_information;
use crate::information::density::gaussian::dense::MAX_PATCH_PIXELS;
use crate::information::entropy::noise_entropy::check_noise;
use crate::information::entropy::poisson_gaussian::fisher_information;
use crate::information::error::InformationError;
use crate::information::statistics::area_sums::{AreaSums, Corners};
use crate::information::statistics::uniform_table::UniformTable;
use crate::sensor::Noise;

/// Largest tabulated separation; beyond it a bead is detected with certainty, to 1e-13 bit.
const LARGEST_SEPARATION: f64 = 16.0;
const SEPARATION_STEP: f64 = 0.02;
/// Share of its own energy (sum of squared photons) below which the light of a bead does not touch the patch.
const TOUCHES: f64 = 1e-12;
/// Energy in units of the noise above which a bead touches the patch nevertheless: the faint light of very bright
/// beads also carries information.
const NEGLIGIBLE: f64 = 1e-6;

/// Entropy of a binary variable with probability `p`, bits.
pub fn binary_entropy(p: f64) -> f64 {
    let term = |q: f64| if q > 0.0 { -q * q.log2() } else { 0.0 };
    term(p) + term(1.0 - p)
}

/// Upper bound on the true information of a patch of independent beads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EntropyBound {
    /// The bound, bits per pixel of the patch.
    pub bits_per_pixel: f64,
    /// The looser bound without noise: entropy of all object pixels that touch the patch, bits per pixel.
    pub footprint_entropy: f64,
    /// Object pixels that touch the patch, over all planes.
    pub footprint_pixels: usize,
    /// Entropy of one object pixel, bits.
    pub entropy_per_object_pixel: f64,
}

/// Object-entropy bounds for beads of one density. Holds a table, so make one per object set.
///
/// The bound holds for any independent sparse objects that occupy each object pixel with one probability and add one known
/// pattern of light.
///
/// ```
/// use lenslet_studio::information::BeadEntropyBound;
/// use lenslet_studio::sensor::Noise;
/// use ndarray::Array3;
///
/// // Two depth planes: a point of 500 photons is seen sharp from one and spread over 4 x 4 pixels from the other.
/// let mut spot = Array3::zeros((2, 4, 4));
/// spot[[0, 1, 1]] = 500.0;
/// spot.index_axis_mut(ndarray::Axis(0), 1).fill(500.0 / 16.0);
///
/// let bounds = BeadEntropyBound::new(0.02)?;
/// let bound = bounds.evaluate_exact(spot.view(), 10.0, (32, 32), Noise::Shot)?;
/// // At most the entropy of the 32 x 32 + 35 x 35 object pixels that the patch sees.
/// assert_eq!(bound.footprint_pixels, 32 * 32 + 35 * 35);
/// assert!(bound.bits_per_pixel < bound.footprint_entropy);
/// // The Gaussian channel is faster and never below.
/// let fast = bounds.evaluate(spot.view(), 10.0, (32, 32), Noise::Shot)?;
/// assert!(bound.bits_per_pixel <= fast.bits_per_pixel);
/// # Ok::<(), lenslet_studio::information::InformationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct BeadEntropyBound {
    probability: f64,
    entropy: f64,
    information: UniformTable,
}

impl BeadEntropyBound {
    /// Bounds for beads that occupy each object pixel with the given probability.
    ///
    /// # Errors
    /// When the probability is not between 0 and 1.
    pub fn new(probability: f64) -> Result<Self, InformationError> {
        if !(probability > 0.0 && probability < 1.0) {
            return Err(InformationError::Probability { found: probability });
        }
        let nodes = (LARGEST_SEPARATION / SEPARATION_STEP).round() as usize + 1;
        let values = (0..nodes).map(|i| two_point_information(probability, i as f64 * SEPARATION_STEP)).collect();
        let information = UniformTable::new(0.0, SEPARATION_STEP, values);
        Ok(Self { probability, entropy: binary_entropy(probability), information })
    }

    /// The bound of one encoder, by a Gaussian channel for each bead: fast enough for every mouse move.
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
    ) -> Result<EntropyBound, InformationError> {
        let precision = check(spot, bias, patch, noise)?;
        let gaussian = |_: ArrayView2<'_, f64>, places: &[(Corners, f64)]| self.gaussian_bits(places, precision).sum();
        Ok(self.sum(spot, patch, precision, gaussian))
    }

    /// The bound of one encoder by the exact information of photon counts about each bead. It is tighter for shot
    /// noise, above all where few photons decide. Other noises have the bound of [`BeadEntropyBound::evaluate`]; the
    /// arguments are the same. A bias of 0 is no special case here, because a bead may still emit no photon.
    ///
    /// Each bead counts with the smaller of the two channels, so this never exceeds the other bound. The quadrature
    /// adds less than 1e-7 bit to each bead and removes nothing.
    ///
    /// # Errors
    /// As [`BeadEntropyBound::evaluate`].
    pub fn evaluate_exact(
        &self,
        spot: ArrayView3<'_, f64>,
        bias: f64,
        patch: (usize, usize),
        noise: Noise,
    ) -> Result<EntropyBound, InformationError> {
        if noise != Noise::Shot {
            return self.evaluate(spot, bias, patch, noise);
        }
        let precision = check(spot, bias, patch, noise)?;
        let exact = |plane: ArrayView2<'_, f64>, places: &[(Corners, f64)]| {
            let corners: Vec<Corners> = places.iter().map(|&(corners, _)| corners).collect();
            let counts = poisson_information(plane, bias, self.probability, self.entropy, &corners);
            self.gaussian_bits(places, precision).zip(counts).map(|(gaussian, counts)| gaussian.min(counts)).sum()
        };
        Ok(self.sum(spot, patch, precision, exact))
    }

    /// Information about each bead through its Gaussian channel, bits.
    fn gaussian_bits(&self, places: &[(Corners, f64)], precision: f64) -> impl Iterator<Item = f64> {
        places.iter().map(move |&(_, energy)| {
            let separation = (energy * precision).sqrt();
            self.information.at(separation.min(LARGEST_SEPARATION)).clamp(0.0, self.entropy)
        })
    }

    /// Sum of `bits` over all places of the bead. `bits` receives one plane's spot, the part of it on the patch and
    /// the energy (sum of squared photons) in that part.
    fn sum(
        &self,
        spot: ArrayView3<'_, f64>,
        patch: (usize, usize),
        precision: f64,
        bits: impl Fn(ArrayView2<'_, f64>, &[(Corners, f64)]) -> f64,
    ) -> EntropyBound {
        let (rows, cols) = patch;
        let (mut total, mut footprint_pixels) = (0.0, 0_usize);
        for plane in spot.outer_iter() {
            let energies = AreaSums::new(plane.dim(), |r, c| plane[[r, c]] * plane[[r, c]]);
            let touches = TOUCHES * energies.total();
            let least = if precision.is_finite() { touches.min(NEGLIGIBLE / precision) } else { touches };
            let lasts =
                (0..rows + plane.nrows() - 1).flat_map(|row| (0..cols + plane.ncols() - 1).map(move |col| (row, col)));
            let places: Vec<(Corners, f64)> = lasts
                .map(|last| energies.overlap(last, patch))
                .map(|corners| (corners, energies.over(corners).max(0.0)))
                .filter(|&(_, energy)| energy > least)
                .collect();
            footprint_pixels += places.len();
            total += bits(plane, &places);
        }
        let pixels = (rows * cols) as f64;
        EntropyBound {
            bits_per_pixel: total / pixels,
            footprint_entropy: footprint_pixels as f64 * self.entropy / pixels,
            footprint_pixels,
            entropy_per_object_pixel: self.entropy,
        }
    }
}

/// Checks the arguments and returns the precision of a pixel at the bias level, 1 / photons^2.
fn check(
    spot: ArrayView3<'_, f64>,
    bias: f64,
    (rows, cols): (usize, usize),
    noise: Noise,
) -> Result<f64, InformationError> {
    check_noise(noise)?;
    if rows == 0 || cols == 0 {
        return Err(InformationError::PatchSize { rows, cols, limit: MAX_PATCH_PIXELS });
    }
    let (_, found_rows, found_cols) = spot.dim();
    if spot.is_empty() {
        let (what, rows, cols) = ("bead spot", usize::MAX, usize::MAX);
        return Err(InformationError::SpotShape { what, rows, cols, found_rows, found_cols });
    }
    if let Some(&found) = spot.iter().chain([&bias]).find(|value| !(value.is_finite() && **value >= 0.0)) {
        return Err(InformationError::Photons { found });
    }
    match noise {
        Noise::None => Err(InformationError::NoNoise),
        Noise::Shot => Ok(1.0 / bias),
        Noise::Read { sigma } => Ok(1.0 / (sigma * sigma)),
        Noise::ShotRead { sigma } => Ok(fisher_information(bias, sigma)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{information, normal};
    use super::*;

    #[test]
    fn faint_light_of_a_very_bright_bead_counts_where_it_exceeds_the_noise() {
        let ceilings = BeadEntropyBound::new(1e-4).unwrap();
        let places = |brightness: f64| {
            let mut spot = ndarray::Array3::zeros((1, 1, 9));
            spot[[0, 0, 0]] = 1e7 * brightness;
            spot[[0, 0, 8]] = brightness;
            ceilings.evaluate(spot.view(), 10.0, (1, 1), Noise::Shot).unwrap()
        };
        assert_eq!((places(1e-3).footprint_pixels, places(5.0).footprint_pixels), (1, 2));
        assert!(places(5.0).bits_per_pixel > 1.1 * places(1e-3).bits_per_pixel);
    }

    #[test]
    fn table_holds_the_two_point_information() {
        let ceilings = BeadEntropyBound::new(0.02).unwrap();
        for d in [0.013, 0.5, 1.111, 3.333, 7.77, 15.99] {
            let grid: Vec<f64> = (0..120_000).map(|i| f64::from(i) * 0.0005 - 20.0).collect();
            let dark: Vec<f64> = grid.iter().map(|&u| normal(u)).collect();
            let lit: Vec<f64> = grid.iter().map(|&u| normal(u - d)).collect();
            let expected = information(0.02, &dark, &lit, 0.0005);
            let found = ceilings.information.at(d);
            assert!((found - expected).abs() < 1e-7, "{d}: {found} {expected}");
        }
        assert!((ceilings.information.at(LARGEST_SEPARATION) - binary_entropy(0.02)).abs() < 1e-12);
    }
}
