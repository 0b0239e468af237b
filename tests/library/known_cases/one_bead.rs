//! One bead at a random place, with shot noise.

use ndarray::{Array2, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{CLEAN_STREAM, StudyError, TrueInformation, check};
use lenslet_studio::sensor::Noise;

/// Number of patches that the information is averaged over.
const SAMPLES: usize = 8192;

/// One bead over a background, with shot noise. Its place is uniform over all pixels from which it touches the patch. The
/// bead is a Gaussian spot that ends at three widths.
///
/// The counts give every place s its log-likelihood ratio against the background, `L_s = sum_j [y_j ln(1 + q_sj / b) -
/// q_sj]`. With N places the information of a patch is `E[log2(exp(L_true) / (1/N sum_s exp(L_s)))]`. It is exact for
/// each patch, and averaged over 8192 of them.
#[derive(Clone, Debug, PartialEq)]
pub struct OneBead {
    /// Side of a patch, px.
    pub side_px: usize,
    /// Standard deviation of the spot, px.
    pub sigma_px: f64,
    /// Photons that the spot adds to the pixel of its centre.
    pub peak: f64,
    /// Photons of the background in every pixel.
    pub bias: f64,
}

impl Default for OneBead {
    fn default() -> Self {
        Self { side_px: 8, sigma_px: 1.5, peak: 20.0, bias: 10.0 }
    }
}

impl OneBead {
    pub fn check(&self) -> Result<(), StudyError> {
        check("the bead's width in pixels", "0.1 to 16", self.sigma_px, 0.1..=16.0)?;
        check("the bead's peak in photons", "0 to 1000000", self.peak, 0.0..=1e6)?;
        check("the background in photons", "above 0 and at most 1000000", self.bias, 1e-3..=1e6)
    }

    /// Photons that the bead adds, side 2 radius + 1.
    fn spot(&self) -> Array2<f64> {
        let radius = (3.0 * self.sigma_px).ceil();
        let side = 2 * radius as usize + 1;
        Array2::from_shape_fn((side, side), |(r, c)| {
            let square = (r as f64 - radius).powi(2) + (c as f64 - radius).powi(2);
            self.peak * (-0.5 * square / self.sigma_px.powi(2)).exp()
        })
    }

    /// Places along one axis from which the bead touches the patch.
    fn places(&self) -> usize {
        self.side_px + self.spot().nrows() - 1
    }

    /// The clean patch with the bead's last spot pixel on patch pixel (row, col) `last`, or beyond the patch.
    fn patch_of(&self, last: (usize, usize), spot: &Array2<f64>) -> Array2<f32> {
        let (side, length) = (self.side_px, spot.nrows());
        // The bead lies in a field that exceeds the patch by the spot on all sides.
        let mut field = Array2::from_elem((side + 2 * (length - 1), side + 2 * (length - 1)), self.bias);
        let mut lit = field.slice_mut(s![last.0..last.0 + length, last.1..last.1 + length]);
        lit += spot;
        field.slice(s![length - 1..length - 1 + side, length - 1..length - 1 + side]).mapv(|x| x as f32)
    }

    fn random_place(&self, random: &mut ChaCha8Rng) -> (usize, usize) {
        let places = self.places();
        (random.random_range(0..places), random.random_range(0..places))
    }

    pub(super) fn clean_patch(&self, random: &mut ChaCha8Rng) -> Array2<f32> {
        self.patch_of(self.random_place(random), &self.spot())
    }

    pub(super) fn information(&self, seed: u64) -> TrueInformation {
        let (places, spot) = (self.places(), self.spot());
        // The mean is in f32, as drawn, so that the likelihood belongs to exactly these patches.
        let scenes: Vec<(Vec<f64>, f64)> = (0..places * places)
            .map(|index| {
                let clean = self.patch_of((index / places, index % places), &spot).mapv(f64::from);
                (clean.iter().map(|x| x.ln()).collect(), clean.sum())
            })
            .collect();
        let bits: Vec<f64> = (0..SAMPLES as u64)
            .into_par_iter()
            .map(|index| {
                let mut random = ChaCha8Rng::seed_from_u64(seed);
                random.set_stream(CLEAN_STREAM + index);
                let (row, col) = self.random_place(&mut random);
                let clean = self.patch_of((row, col), &spot);
                let counts = Noise::Shot.draw_from(clean.view().insert_axis(ndarray::Axis(0)), index as usize, seed);
                let counts: Vec<f64> = counts.iter().map(|&y| f64::from(y)).collect();
                let log_likelihood = |(logarithms, total): &(Vec<f64>, f64)| {
                    counts.iter().zip(logarithms).map(|(y, ln)| y * ln).sum::<f64>() - total
                };
                let truth = log_likelihood(&scenes[row * places + col]);
                let ratios = scenes.iter().map(|scene| (log_likelihood(scene) - truth).exp()).sum::<f64>();
                -(ratios / scenes.len() as f64).log2()
            })
            .collect();
        let mean = bits.iter().sum::<f64>() / SAMPLES as f64;
        let variance = bits.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (SAMPLES - 1) as f64;
        let pixels = (self.side_px * self.side_px) as f64;
        let standard_error = (variance / SAMPLES as f64).sqrt() / pixels;
        TrueInformation { bits_per_pixel: mean / pixels, standard_error }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lenslet_studio::information::poisson_entropy;

    #[test]
    fn one_pixel_agrees_with_the_sum_over_counts() {
        let bead = OneBead { side_px: 1, sigma_px: 0.6, peak: 30.0, bias: 4.0 };
        let means: Vec<f64> = bead.spot().iter().map(|q| f64::from((q + 4.0) as f32)).collect();
        assert_eq!((bead.places().pow(2), means.len()), (25, 25));
        let probability = |k: usize, x: f64| (1..=k).fold((-x).exp(), |p, i| p * x / i as f64);
        let mixture = |k: usize| means.iter().map(|&x| probability(k, x)).sum::<f64>() / 25.0;
        let entropy_y: f64 = (0..100).map(mixture).filter(|p| *p > 0.0).map(|p| -p * p.log2()).sum();
        let expected = entropy_y - means.iter().map(|&x| poisson_entropy(x)).sum::<f64>() / 25.0;
        let found = bead.information(5);
        assert!(found.standard_error < 0.02, "{found:?}");
        assert!((found.bits_per_pixel - expected).abs() < 3.5 * found.standard_error, "{found:?} {expected}");
    }

    #[test]
    fn a_bright_bead_tells_its_place_and_a_dark_one_nothing() {
        let bright = OneBead { peak: 1e6, ..OneBead::default() }.information(1);
        let places = 18.0_f64 * 18.0;
        assert!((bright.bits_per_pixel - places.log2() / 64.0).abs() < 1e-3, "{bright:?}");
        let dark = OneBead { peak: 0.0, ..OneBead::default() }.information(1);
        assert!(dark.bits_per_pixel.abs() < 1e-12, "{dark:?}");
    }

    #[test]
    fn the_bead_stands_where_it_is_put() {
        let bead = OneBead { side_px: 8, sigma_px: 0.3, peak: 5.0, bias: 1.0 };
        let spot = bead.spot();
        assert_eq!(spot.dim(), (3, 3));
        // The last of three spot pixels on (4, 2): the centre on (3, 1).
        let patch = bead.patch_of((4, 2), &spot);
        assert_eq!(patch[[3, 1]], 6.0);
        assert!((patch[[3, 2]] - 1.0 - spot[[1, 2]] as f32).abs() < 1e-6);
        assert_eq!(patch[[7, 7]], 1.0);
    }
}
