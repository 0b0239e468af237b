//! A synthetic diffuser: the caustic of a smooth random phase surface.
//!
//! Parallel light passes a surface of random height. The local gradient deflects each ray. The ray lands displaced by
//! gradient times distance. Light concentrates in caustic lines where the map from mask to sensor folds. The surface is
//! Gaussian-filtered white noise on a periodic tile, the usual model of an off-the-shelf Gaussian diffuser. The published
//! diffuser is a photograph that is not public. So this one is of the same kind but has other pixels.
//!
//! An aperture blocks the light outside: the border of one caustic is dark. Its throughput is the share of the light
//! inside, unless the mask keeps the light.

use std::fmt;
use std::ops::RangeInclusive;

use ndarray::{Array2, s};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::throughput::{LEAST_THROUGHPUT, finish_debug, is_unit, unit};

/// Sides in pixels of the published square apertures, from none ("huge") to the smallest.
pub const DIFFUSER_APERTURES: [usize; 5] = [32, 28, 16, 12, 8];

/// A diffuser on a square PSF grid.
///
/// ```
/// use lenslet_studio::optics::Diffuser;
///
/// let blocking = Diffuser::behind_aperture(16, 1);
/// assert!(blocking.throughput < 0.5);
/// assert_eq!(Diffuser::with_light_kept(16, 1).throughput, 1.0);
/// ```
#[allow(
    clippy::unsafe_derive_deserialize,
    reason = "the unsafe code is in ndarray's slicing macro, not in an invariant"
)]
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Diffuser {
    /// Side of the square, centred aperture in pixels, 1 to that of the grid.
    pub aperture_px: usize,
    /// Seed of the surface. The same seed gives the same surface behind every aperture.
    pub seed: u64,
    /// Sum of the PSF, more than 0 and at most 1; 1 (the light is kept) where absent.
    #[serde(default = "unit", skip_serializing_if = "is_unit")]
    pub throughput: f64,
    /// Side of the PSF grid in pixels, 8 to 1024; 32 where absent. Bumps of the surface keep their size in pixels, so a larger grid
    /// shows more of them.
    #[serde(default = "published_grid", skip_serializing_if = "is_published_grid")]
    pub grid_px: usize,
}

fn published_grid() -> usize {
    Diffuser::GRID
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_published_grid(grid_px: &usize) -> bool {
    *grid_px == Diffuser::GRID
}

impl fmt::Debug for Diffuser {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { aperture_px, seed, throughput, grid_px } = self;
        let mut shown = formatter.debug_struct("Diffuser");
        shown.field("aperture_px", aperture_px).field("seed", seed);
        if !is_published_grid(grid_px) {
            shown.field("grid_px", grid_px);
        }
        finish_debug(&mut shown, *throughput)
    }
}

impl Diffuser {
    /// Side of the published PSF grid in pixels.
    pub const GRID: usize = 32;
    /// Smallest and largest side of a PSF grid in pixels.
    pub const GRIDS: RangeInclusive<usize> = 8..=1024;
    /// Most rays per pixel along each axis, and along the whole grid where that is large.
    const RAYS: usize = 16;
    const MOST_RAYS: usize = 1024;
    /// Least rays per pixel along each axis.
    const LEAST_RAYS: usize = 4;
    /// Standard deviation in pixels of the filter that smooths the surface. It sets the width of the bumps.
    const BUMP_PX: f64 = 2.5;
    /// Root mean square of the curvature times the distance to the sensor. At 1 most bumps focus near the sensor.
    const FOCUS: f64 = 1.0;

    /// A diffuser behind an aperture of `aperture_px` x `aperture_px` pixels that blocks the light outside: its throughput
    /// is the share of the caustic's light inside the aperture.
    pub fn behind_aperture(aperture_px: usize, seed: u64) -> Self {
        Self::with_light_kept(aperture_px, seed).blocking()
    }

    /// The diffuser with the throughput of an aperture that blocks the light outside.
    fn blocking(self) -> Self {
        let caustic = self.caustic();
        // A seed whose aperture is dark is not known; the least throughput keeps the mask valid.
        let share = (self.open(&caustic).sum() / caustic.sum()).max(LEAST_THROUGHPUT);
        Self { throughput: share, ..self }
    }

    /// Rays per pixel along each axis.
    fn rays(self) -> usize {
        (Self::MOST_RAYS / self.grid_px).clamp(Self::LEAST_RAYS, Self::RAYS)
    }

    /// A diffuser whose light passes through the aperture as a whole: throughput 1.
    pub fn with_light_kept(aperture_px: usize, seed: u64) -> Self {
        Self { aperture_px, seed, throughput: 1.0, grid_px: Self::GRID }
    }

    /// The diffuser over a grid of `side` x `side` pixels. The aperture keeps its share of the grid. A throughput that is the share of
    /// the light inside the aperture is that of the new aperture; another one stays.
    #[must_use]
    pub fn on_grid(self, side: usize) -> Self {
        if side == self.grid_px {
            return self;
        }
        let is_blocking = self.throughput < 1.0 && self.blocking() == self;
        let aperture = (self.aperture_px as f64 * side as f64 / self.grid_px as f64).round() as usize;
        let scaled = Self { aperture_px: aperture.clamp(1, side), grid_px: side, ..self };
        if is_blocking { scaled.blocking() } else { scaled }
    }

    /// Renders the PSF, shape (32, 32) or that of a larger grid. Its sum is the throughput. An aperture outside the grid is clamped.
    pub fn render(self) -> Array2<f64> {
        let psf = self.open(&self.caustic());
        let sum = psf.sum();
        psf / sum * self.throughput
    }

    /// The light inside the aperture, and zeros around it.
    fn open(self, caustic: &Array2<f64>) -> Array2<f64> {
        let aperture = self.aperture_px.clamp(1, self.grid_px);
        let start = (self.grid_px - aperture) / 2;
        let mut inside = Array2::zeros((self.grid_px, self.grid_px));
        let open = s![start..start + aperture, start..start + aperture];
        inside.slice_mut(open).assign(&caustic.slice(open));
        inside
    }

    /// Light on the whole periodic tile, unnormalised.
    fn caustic(self) -> Array2<f64> {
        let side = self.grid_px * self.rays();
        let height = self.surface(side);
        let rays = self.rays() as f64;
        // Central differences on the periodic tile, in pixels.
        let wrap = |index: usize, step: isize| (index as isize + step).rem_euclid(side as isize) as usize;
        let slope = |row: usize, col: usize| {
            let by_x = (height[(row, wrap(col, 1))] - height[(row, wrap(col, -1))]) * rays / 2.0;
            let by_y = (height[(wrap(row, 1), col)] - height[(wrap(row, -1), col)]) * rays / 2.0;
            (by_x, by_y)
        };
        let curvature = (0..side * side)
            .map(|ray| {
                let (row, col) = (ray / side, ray % side);
                let laplacian = height[(row, wrap(col, 1))]
                    + height[(row, wrap(col, -1))]
                    + height[(wrap(row, 1), col)]
                    + height[(wrap(row, -1), col)]
                    - 4.0 * height[(row, col)];
                (laplacian * rays * rays).powi(2)
            })
            .sum::<f64>()
            / (side * side) as f64;
        // Half the Laplacian is the mean curvature of the two axes.
        let distance = Self::FOCUS / (0.5 * curvature.sqrt());
        let mut light = Array2::zeros((self.grid_px, self.grid_px));
        for row in 0..side {
            for col in 0..side {
                let (by_x, by_y) = slope(row, col);
                let x = (col as f64 + 0.5) / rays - 0.5 - distance * by_x;
                let y = (row as f64 + 0.5) / rays - 0.5 - distance * by_y;
                splat(&mut light, x, y);
            }
        }
        light
    }

    /// White noise smoothed by a periodic Gaussian, shape (side, side).
    fn surface(self, side: usize) -> Array2<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        // The noise lies on the pixel grid, so the number of rays does not change the surface. The Gaussian that smooths
        // the noise also interpolates it.
        let (grid, rays) = (self.grid_px, self.rays() as f64);
        let noise = Array2::from_shape_simple_fn((grid, grid), || StandardNormal.sample(&mut random));
        let kernel = |fine: usize, coarse: usize| {
            let position = (fine as f64 + 0.5) / rays - 0.5;
            let half = grid as f64 / 2.0;
            let distance = (position - coarse as f64 + half).rem_euclid(grid as f64) - half;
            (-0.5 * (distance / Self::BUMP_PX).powi(2)).exp()
        };
        let smooth: Array2<f64> = Array2::from_shape_fn((side, grid), |(fine, coarse)| kernel(fine, coarse));
        smooth.dot(&noise).dot(&smooth.t())
    }
}

/// Adds one ray's light to the four pixels around (x, y) on the periodic grid.
fn splat(light: &mut Array2<f64>, x: f64, y: f64) {
    let (rows, cols) = light.dim();
    let (col, row) = (x.floor(), y.floor());
    let (right, down) = (x - col, y - row);
    // Whole numbers wrap several times as fast as floats.
    let wrapped = |first: f64, count: usize| {
        let first = (first as isize).rem_euclid(count as isize) as usize;
        [first, if first + 1 == count { 0 } else { first + 1 }]
    };
    let cols = wrapped(col, cols);
    for (row, share_row) in wrapped(row, rows).into_iter().zip([1.0 - down, down]) {
        for (col, share_col) in cols.into_iter().zip([1.0 - right, right]) {
            light[(row, col)] += share_row * share_col;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_aperture_shows_the_middle_of_the_same_caustic() {
        let huge = Diffuser::with_light_kept(32, 5).render();
        for aperture in DIFFUSER_APERTURES {
            let psf = Diffuser::with_light_kept(aperture, 5).render();
            assert!((psf.sum() - 1.0).abs() < 1e-12);
            assert!(psf.iter().filter(|&&h| h > 0.0).count() <= aperture * aperture);
            let ratio = psf[(16, 16)] / psf[(15, 14)];
            assert!((ratio - huge[(16, 16)] / huge[(15, 14)]).abs() < 1e-9 * ratio);
        }
    }

    #[test]
    fn apertures_darken_the_border_and_nothing_else() {
        let huge = Diffuser::behind_aperture(32, 5);
        assert_eq!(huge, Diffuser::with_light_kept(32, 5), "the whole caustic is the whole light");
        let caustic = huge.render();
        let mut before = f64::INFINITY;
        for aperture in DIFFUSER_APERTURES {
            let diffuser = Diffuser::behind_aperture(aperture, 5);
            let psf = diffuser.render();
            let border = (32 - aperture) / 2;
            let inside = border..32 - border;
            for ((row, col), &light) in caustic.indexed_iter() {
                let expected = if inside.contains(&row) && inside.contains(&col) { light } else { 0.0 };
                assert!((psf[(row, col)] - expected).abs() < 1e-15, "{aperture} px: row {row}, column {col}");
            }
            assert!((psf.sum() - diffuser.throughput).abs() < 1e-12 && diffuser.throughput < before);
            before = diffuser.throughput;
        }
        assert!((0.02..0.15).contains(&before), "8 px of 32 px: {before}");
    }

    #[test]
    fn light_piles_up_in_caustics() {
        for seed in 0..4 {
            let psf = Diffuser::with_light_kept(32, seed).render();
            let mean = psf.mean().unwrap();
            let peak = psf.iter().copied().fold(0.0, f64::max);
            let dark = psf.iter().filter(|&&h| h < 0.5 * mean).count() as f64 / 1024.0;
            assert!(peak > 3.0 * mean, "no bright line: {}", peak / mean);
            assert!(dark > 0.2, "no dark area: {dark}");
        }
    }
}
