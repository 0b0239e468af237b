//! Beads: blurred point sources at random pixels (Kabuli et al., Optica 13, 227, 2026).

use ndarray::{Array2, ArrayViewMut2};
use rand::Rng;
use rand::seq::index;

use super::ObjectError;

/// Standard deviation of one Gaussian of a bead, px: 2.55 px full width at half maximum.
const SIGMA_PX: f64 = 1.275e-3 * 4e3 / 2.0 / 2.354_820_045_030_949_3;
/// The Gaussian is cut off beyond this many pixels, 4 standard deviations rounded.
const RADIUS_PX: usize = 4;
/// Rows and columns of a bead: two Gaussians one pixel apart on the main diagonal.
const SPOT_PX: usize = 2 * RADIUS_PX + 2;
/// Photons per unit of the published bead (which sums to 2) when the maximum is normalised.
const PHOTONS_PER_UNIT: f64 = 1000.0;

/// Prior of the beads, for methods that need a known prior.
#[derive(Clone, Debug, PartialEq)]
pub struct BeadPrior {
    /// Probability that a pixel of a plane holds a bead: the number of beads divided by the pixels.
    pub probability: f64,
    /// Number of independent depth planes.
    pub planes: usize,
    /// Photons per pixel that one bead adds to its plane, shape (10, 10).
    pub spot: Array2<f64>,
    /// Row and column of `spot` that lie on the pixel of the bead.
    pub anchor: (usize, usize),
}

/// Photon scale of a set of beads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum BeadScale {
    /// Expected photons per pixel over the set.
    Mean(f64),
    /// 1000 photons for each of the two Gaussians of a bead.
    PerBead,
}

/// A set of bead objects. The number of beads per plane is fixed. Their pixels are distinct and uniform.
#[derive(Clone, Debug)]
pub(super) struct Beads {
    prior: BeadPrior,
    field: (usize, usize),
    per_plane: usize,
    mean: f64,
    spot: Array2<f32>,
}

impl Beads {
    pub(super) fn new(
        density: f64,
        planes: usize,
        field: (usize, usize),
        scale: BeadScale,
    ) -> Result<Self, ObjectError> {
        let (rows, cols) = field;
        let pixels = rows * cols;
        let beads_per_plane = (density * pixels as f64).floor() as usize;
        if beads_per_plane == 0 {
            let expected = format!("a density of at least {} for {rows} x {cols} px (one bead)", 1.0 / pixels as f64);
            return Err(ObjectError::Option { name: "density", expected, found: density.to_string() });
        }
        let unit = published_spot();
        // Photons beyond the border are lost. Beads are uniform, so each loses the average share of its spot.
        let kept: f64 = unit
            .indexed_iter()
            .map(|((row, col), value)| {
                let reach = |index: usize, length: usize| length.saturating_sub(index.abs_diff(RADIUS_PX)) as f64;
                value * reach(row, rows) * reach(col, cols) / pixels as f64
            })
            .sum();
        let probability = beads_per_plane as f64 / pixels as f64;
        let factor = match scale {
            BeadScale::Mean(mean) => mean / (probability * kept),
            BeadScale::PerBead => PHOTONS_PER_UNIT,
        };
        let spot = unit * factor;
        Ok(Self {
            mean: probability * kept * factor,
            spot: spot.mapv(|value| value as f32),
            prior: BeadPrior { probability, planes, spot, anchor: (RADIUS_PX, RADIUS_PX) },
            field,
            per_plane: beads_per_plane,
        })
    }

    pub(super) fn prior(&self) -> &BeadPrior {
        &self.prior
    }

    pub(super) fn field(&self) -> (usize, usize) {
        self.field
    }

    pub(super) fn beads_per_plane(&self) -> usize {
        self.per_plane
    }

    /// Expected photons per pixel, including the loss at the border.
    pub(super) fn mean(&self) -> f64 {
        self.mean
    }

    /// Adds the beads of one plane to `plane`, which is zero.
    pub(super) fn draw(&self, generator: &mut impl Rng, mut plane: ArrayViewMut2<f32>) {
        let (rows, cols) = self.field;
        for pixel in index::sample(generator, rows * cols, self.per_plane) {
            let (row, col) = (pixel / cols, pixel % cols);
            for ((spot_row, spot_col), photons) in self.spot.indexed_iter() {
                let target = ((row + spot_row).wrapping_sub(RADIUS_PX), (col + spot_col).wrapping_sub(RADIUS_PX));
                if let Some(value) = plane.get_mut(target) {
                    *value += photons;
                }
            }
        }
    }

    /// Autocovariance of independent beads, photons squared: `p (1 - p)` times the autocorrelation of the spot
    /// (Campbell's theorem for a Bernoulli lattice).
    pub(super) fn autocovariance(&self, max_lag: usize) -> Array2<f64> {
        let spot = &self.prior.spot;
        let variance = self.prior.probability * (1.0 - self.prior.probability);
        Array2::from_shape_fn((2 * max_lag + 1, 2 * max_lag + 1), |(row, col)| {
            let (down, right) = (row.abs_diff(max_lag), col.abs_diff(max_lag));
            let same_sign = (row >= max_lag) == (col >= max_lag);
            if down >= SPOT_PX || right >= SPOT_PX {
                return 0.0;
            }
            let mut sum = 0.0;
            for i in 0..SPOT_PX - down {
                for j in 0..SPOT_PX - right {
                    sum += if same_sign {
                        spot[[i, j]] * spot[[i + down, j + right]]
                    } else {
                        spot[[i + down, j]] * spot[[i, j + right]]
                    };
                }
            }
            variance * sum
        })
    }
}

/// The published bead: two sampled Gaussians of unit sum, at its pixel and at the next pixel down and right. The sum is
/// 2.
fn published_spot() -> Array2<f64> {
    let weights: Vec<f64> =
        (0..=2 * RADIUS_PX).map(|index| (-0.5 * (index.abs_diff(RADIUS_PX) as f64 / SIGMA_PX).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let gaussian = |index: usize| weights.get(index).map_or(0.0, |weight| weight / sum);
    Array2::from_shape_fn((SPOT_PX, SPOT_PX), |(row, col)| {
        let second = gaussian(row.wrapping_sub(1)) * gaussian(col.wrapping_sub(1));
        gaussian(row) * gaussian(col) + second
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::Split;

    fn mean_tamura(density: f64) -> f64 {
        let beads = Beads::new(density, 1, (96, 96), BeadScale::Mean(100.0)).unwrap();
        let count = 60;
        (0..count)
            .map(|index| {
                let mut object = Array2::zeros((96, 96));
                beads.draw(&mut Split::All.generator(4, index), object.view_mut());
                tamura(&object)
            })
            .sum::<f64>()
            / count as f64
    }

    /// Square root of the coefficient of variation of Sobel gradient magnitudes, edge pixels repeated.
    fn tamura(object: &Array2<f32>) -> f64 {
        let (rows, cols) = object.dim();
        let at = |row: usize, col: usize, down: isize, right: isize| {
            let row = row.saturating_add_signed(down).min(rows - 1);
            f64::from(object[[row, col.saturating_add_signed(right).min(cols - 1)]])
        };
        let magnitudes = Array2::from_shape_fn((rows, cols), |(row, col)| {
            let p = |down, right| at(row, col, down, right);
            let across = p(-1, 1) + 2.0 * p(0, 1) + p(1, 1) - p(-1, -1) - 2.0 * p(0, -1) - p(1, -1);
            let down = p(1, -1) + 2.0 * p(1, 0) + p(1, 1) - p(-1, -1) - 2.0 * p(-1, 0) - p(-1, 1);
            across.hypot(down)
        });
        (magnitudes.std(0.0) / magnitudes.mean().unwrap()).sqrt()
    }

    #[test]
    fn the_bead_is_the_published_one() {
        let spot = published_spot();
        assert!((spot.sum() - 2.0).abs() < 1e-12);
        let peak = spot.iter().copied().fold(0.0, f64::max);
        assert!((peak - 0.1936).abs() < 5e-5, "{peak}");
        let beads = Beads::new(0.05, 1, (96, 96), BeadScale::PerBead).unwrap();
        assert!((beads.prior().spot.sum() - 2000.0).abs() < 1e-9);
        assert!((beads.prior().spot[[4, 4]] - 193.6).abs() < 0.05);
        assert_eq!(beads.beads_per_plane(), 460);
    }

    #[test]
    fn mean_tamura_coefficients_are_the_published_ones() {
        for (density, published) in
            [(0.008, 1.359), (0.01, 1.279), (0.02, 1.064), (0.03, 0.958), (0.05, 0.850), (0.11, 0.756)]
        {
            let measured = mean_tamura(density);
            assert!((measured - published).abs() < 0.006, "density {density}: {measured} against {published}");
        }
    }

    #[test]
    fn a_bead_falls_on_its_pixel_and_is_cut_at_the_border() {
        let beads = Beads::new(1.0 / 9.0, 1, (3, 3), BeadScale::PerBead).unwrap();
        assert_eq!(beads.beads_per_plane(), 1);
        let mut mean = 0.0;
        for index in 0..3000 {
            let mut plane = Array2::zeros((3, 3));
            beads.draw(&mut Split::Train.generator(1, index), plane.view_mut());
            mean += plane.mapv(f64::from).mean().unwrap() / 3000.0;
        }
        assert!((mean / beads.mean() - 1.0).abs() < 0.02, "{mean} against {}", beads.mean());
    }

    #[test]
    fn expected_mean_is_met_and_a_single_bead_is_required() {
        let beads = Beads::new(0.02, 1, (96, 96), BeadScale::Mean(100.0)).unwrap();
        assert!((beads.mean() - 100.0).abs() < 1e-9);
        let mut sum = 0.0;
        for index in 0..400 {
            let mut plane = Array2::zeros((96, 96));
            beads.draw(&mut Split::Train.generator(2, index), plane.view_mut());
            sum += plane.mapv(f64::from).mean().unwrap();
        }
        assert!((sum / 400.0 - 100.0).abs() < 0.15, "{}", sum / 400.0);
        assert!(Beads::new(0.0001, 1, (96, 96), BeadScale::PerBead).unwrap_err().to_string().contains("one bead"));
    }

    #[test]
    fn autocovariance_sums_to_the_squared_spot_and_is_a_covariance() {
        let beads = Beads::new(0.02, 1, (96, 96), BeadScale::PerBead).unwrap();
        let covariance = beads.autocovariance(12);
        let p = beads.prior().probability;
        assert!((covariance.sum() / (p * (1.0 - p) * 2000.0 * 2000.0) - 1.0).abs() < 1e-12);
        assert!(covariance[[12 + 2, 12 + 2]] > covariance[[12 + 2, 12 - 2]], "the bead lies on the main diagonal");
        assert!(super::super::autocovariance::least_eigenvalue(&covariance) > -1e-6);
    }
}
