//! Lenslet arrays: the parameters that a user edits and the optimizer changes.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::throughput::{LEAST_THROUGHPUT, OF_LENSLETS, finish_debug, is_unit, unit};

/// Shape of the focal spot of one lenslet, a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Spot {
    /// The same width in every direction.
    #[serde(rename = "sigma_px")]
    Isotropic(
        /// Standard deviation in pixels.
        f64,
    ),
    /// A full covariance, in square pixels.
    #[serde(rename = "covariance_px2")]
    Anisotropic {
        /// Variance along x (columns).
        xx: f64,
        /// Covariance of x and y.
        xy: f64,
        /// Variance along y (rows).
        yy: f64,
    },
}

impl Spot {
    /// Covariance entries (xx, xy, yy) in square pixels.
    pub fn covariance(self) -> (f64, f64, f64) {
        match self {
            Self::Isotropic(sigma) => (sigma * sigma, 0.0, sigma * sigma),
            Self::Anisotropic { xx, xy, yy } => (xx, xy, yy),
        }
    }

    /// Geometric mean of the standard deviations in pixels: the width of the round spot of equal area.
    pub fn mean_sigma(self) -> f64 {
        match self {
            Self::Isotropic(sigma) => sigma,
            Self::Anisotropic { xx, xy, yy } => (xx * yy - xy * xy).max(0.0).sqrt().sqrt(),
        }
    }

    /// The same shape scaled so that its mean standard deviation is `sigma` pixels.
    #[must_use]
    pub fn with_mean_sigma(self, sigma: f64) -> Self {
        match self {
            Self::Isotropic(_) => Self::Isotropic(sigma),
            Self::Anisotropic { xx, xy, yy } => {
                let scale = (sigma / self.mean_sigma()).powi(2);
                Self::Anisotropic { xx: xx * scale, xy: xy * scale, yy: yy * scale }
            }
        }
    }

    /// Standard deviations in pixels along the minor and the major axis.
    pub fn principal_sigmas(self) -> (f64, f64) {
        let (xx, xy, yy) = self.covariance();
        let middle = 0.5 * (xx + yy);
        let half = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        ((middle - half).max(0.0).sqrt(), (middle + half).sqrt())
    }
}

/// One lenslet, described by its spot on the sensor.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// // A spot of standard deviation 2 px at column 10, row 12.
/// let lenslet = Lenslet::round(10.0, 12.0, 2.0, 1.0);
/// assert_eq!(lenslet.spot.mean_sigma(), 2.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Lenslet {
    /// Column of the spot's centre in pixels.
    #[serde(rename = "x_px")]
    pub x: f64,
    /// Row of the spot's centre in pixels.
    #[serde(rename = "y_px")]
    pub y: f64,
    /// Shape of the spot.
    #[serde(flatten)]
    pub spot: Spot,
    /// Share of the light before normalisation of the array. Not negative.
    pub weight: f64,
    /// Depth plane in focus of this lenslet. The lenslet images no other plane.
    #[serde(default, skip_serializing_if = "is_first_plane")]
    pub plane: usize,
}

// serde passes a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_first_plane(plane: &usize) -> bool {
    *plane == 0
}

impl Lenslet {
    /// A round lenslet focused on the first plane; `x`, `y` and `sigma` in pixels.
    pub fn round(x: f64, y: f64, sigma: f64, weight: f64) -> Self {
        Self { x, y, spot: Spot::Isotropic(sigma), weight, plane: 0 }
    }
}

/// Lenslets over one grid of PSF pixels.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let array = LensletArray::new(32, 32, vec![Lenslet::round(10.0, 12.0, 2.0, 1.0)]);
/// assert!(array.check().is_ok());
/// ```
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct LensletArray {
    /// Rows of the PSF grid in pixels.
    pub rows: usize,
    /// Columns of the PSF grid in pixels.
    pub cols: usize,
    /// The lenslets.
    pub lenslets: Vec<Lenslet>,
    /// Sum of the PSF over all planes of the array, more than 0 and at most 64; 1 where absent.
    #[serde(default = "unit", skip_serializing_if = "is_unit")]
    pub throughput: f64,
}

impl fmt::Debug for LensletArray {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rows, cols, lenslets, throughput } = self;
        let mut shown = formatter.debug_struct("LensletArray");
        shown.field("rows", rows).field("cols", cols).field("lenslets", lenslets);
        finish_debug(&mut shown, *throughput)
    }
}

/// Reason why an array is not a mask.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LensletError {
    /// The array has no lenslets.
    #[error("the mask has no lenslet; add one or choose a preset")]
    Empty,
    /// All weights are 0.
    #[error("every lenslet has weight 0, so no light reaches the sensor; raise one weight")]
    Dark,
    /// The PSF grid has no pixels, or too many.
    #[error("the PSF grid is {rows} x {cols} pixels; expected 1 to {max} a side", max = LensletArray::MAX_SIDE)]
    Grid {
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// There are too many lenslets to edit or compute.
    #[error("the mask has {found} lenslets; expected at most {max}", max = LensletArray::MAX_LENSLETS)]
    TooMany {
        /// Lenslets found.
        found: usize,
    },
    /// The throughput is outside its range.
    #[error("the throughput is {found:?}; expected {LEAST_THROUGHPUT} to {most}")]
    Throughput {
        /// The throughput.
        found: f64,
        /// Largest throughput of this kind of mask.
        most: f64,
    },
    /// A parameter is outside its range.
    #[error("lenslet {number}: {name} is {found:?}, expected {expected}")]
    Parameter {
        /// Number of the lenslet, counted from 1.
        number: usize,
        /// The parameter.
        name: &'static str,
        /// Its value.
        found: f64,
        /// Its range.
        expected: &'static str,
    },
}

impl LensletArray {
    /// Largest side of a PSF grid in pixels.
    pub const MAX_SIDE: usize = 1024;
    /// Largest number of lenslets of one mask.
    pub const MAX_LENSLETS: usize = 4096;

    /// An array over a PSF grid of `rows` x `cols` pixels with throughput 1.
    pub fn new(rows: usize, cols: usize, lenslets: Vec<Lenslet>) -> Self {
        Self { rows, cols, lenslets, throughput: 1.0 }
    }

    /// Checks that this array can be rendered.
    ///
    /// # Errors
    /// [`LensletError`] names the first invalid lenslet and parameter.
    pub fn check(&self) -> Result<(), LensletError> {
        let side = 1..=Self::MAX_SIDE;
        if !side.contains(&self.rows) || !side.contains(&self.cols) {
            return Err(LensletError::Grid { rows: self.rows, cols: self.cols });
        }
        if self.lenslets.is_empty() {
            return Err(LensletError::Empty);
        }
        if self.lenslets.len() > Self::MAX_LENSLETS {
            return Err(LensletError::TooMany { found: self.lenslets.len() });
        }
        for (index, lenslet) in self.lenslets.iter().enumerate() {
            lenslet.check(index + 1, self.rows, self.cols)?;
        }
        if self.lenslets.iter().all(|lenslet| lenslet.weight == 0.0) {
            return Err(LensletError::Dark);
        }
        if !OF_LENSLETS.contains(&self.throughput) {
            return Err(LensletError::Throughput { found: self.throughput, most: *OF_LENSLETS.end() });
        }
        Ok(())
    }

    /// The array with another throughput; 1 shares the light of one lenslet among all.
    #[must_use]
    pub fn with_throughput(self, throughput: f64) -> Self {
        Self { throughput, ..self }
    }

    /// The array over a grid of `rows` x `cols` pixels, with every centre at the same share of each side. Widths stay in pixels, as
    /// the published widths are those of a spot that one pixel limits.
    #[must_use]
    pub fn on_grid(mut self, rows: usize, cols: usize) -> Self {
        // Pixel centres are integers, so the grid begins at -0.5.
        let scaled = |centre: f64, from: usize, to: usize| {
            if from == to { centre } else { (centre + 0.5) * to as f64 / from as f64 - 0.5 }
        };
        for lenslet in &mut self.lenslets {
            lenslet.x = scaled(lenslet.x, self.cols, cols);
            lenslet.y = scaled(lenslet.y, self.rows, rows);
        }
        Self { rows, cols, ..self }
    }

    /// The array with its weights scaled to sum 1, or unchanged where they sum to 0.
    #[must_use]
    pub fn with_unit_weight(mut self) -> Self {
        let sum: f64 = self.lenslets.iter().map(|lenslet| lenslet.weight).sum();
        if sum > 0.0 {
            for lenslet in &mut self.lenslets {
                lenslet.weight /= sum;
            }
        }
        self
    }

    /// Number of depth planes that the lenslets are focused on: one more than the deepest plane.
    pub fn planes(&self) -> usize {
        self.lenslets.iter().map(|lenslet| lenslet.plane + 1).max().unwrap_or(1)
    }

    /// Effective number of lenslets: the inverse sum of squared weight shares (the participation ratio). An array of this
    /// number of equal lenslets spreads its light as this array does.
    pub fn effective_count(&self) -> f64 {
        let sum: f64 = self.lenslets.iter().map(|lenslet| lenslet.weight).sum();
        let squares: f64 = self.lenslets.iter().map(|lenslet| lenslet.weight * lenslet.weight).sum();
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }
}

impl Lenslet {
    fn check(&self, number: usize, rows: usize, cols: usize) -> Result<(), LensletError> {
        let wrong = |name, found, expected| Err(LensletError::Parameter { number, name, found, expected });
        // Centres may leave the grid (a lenslet half outside is valid), but not so far that all light is lost.
        if !(self.x >= -0.5 && self.x <= cols as f64 - 0.5) {
            return wrong("x_px", self.x, "a column inside the PSF grid");
        }
        if !(self.y >= -0.5 && self.y <= rows as f64 - 0.5) {
            return wrong("y_px", self.y, "a row inside the PSF grid");
        }
        if !(self.weight >= 0.0 && self.weight.is_finite() && self.weight <= 1e9) {
            return wrong("weight", self.weight, "0 to 1e9");
        }
        if self.plane >= MAX_PLANES {
            return wrong("plane", self.plane as f64, "0 to 63");
        }
        match self.spot {
            Spot::Isotropic(sigma) if !SIGMAS.contains(&sigma) => wrong("sigma_px", sigma, "0.1 to 1000 pixels"),
            Spot::Anisotropic { xx, xy, yy } => {
                let determinant = xx * yy - xy * xy;
                let smallest = self.spot.principal_sigmas().0;
                let is_definite = xx > 0.0 && yy > 0.0 && determinant > 0.0 && determinant.is_finite();
                if !is_definite {
                    wrong("covariance_px2 determinant", determinant, "a positive definite covariance")
                } else if !SIGMAS.contains(&smallest) {
                    wrong("smallest width", smallest, "0.1 to 1000 pixels")
                } else {
                    Ok(())
                }
            }
            Spot::Isotropic(_) => Ok(()),
        }
    }
}

/// Least width, px. Below it the sampled Gaussian is one pixel and rounding destroys its gradient.
const MIN_SIGMA: f64 = 0.1;
const MAX_SIGMA: f64 = 1000.0;
/// Range of the widths. Its lower end leaves room for rounding where an ellipse is raised to the least width.
const SIGMAS: std::ops::RangeInclusive<f64> = MIN_SIGMA * (1.0 - 1e-9)..=MAX_SIGMA;
const MAX_PLANES: usize = 64;

/// Manufacturable region and width. The editor draws them and the optimizer projects onto them.
///
/// Defaults are those of Kabuli et al. 2026: widths of at least 0.775 px, centres in the central 80 % of the grid.
///
/// ```
/// use lenslet_studio::prelude::*;
///
/// let limits = Limits::default();
/// assert!(limits.min_sigma_px > 0.5 && limits.central_share < 1.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Limits {
    /// Smallest standard deviation in pixels.
    pub min_sigma_px: f64,
    /// Share of each side of the grid, around its middle, that centres may occupy.
    pub central_share: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { min_sigma_px: 0.775, central_share: 0.8 }
    }
}

impl Limits {
    /// Smallest and largest coordinate in pixels along a side of `side` pixels.
    pub fn coordinate_range(&self, side: usize) -> (f64, f64) {
        let last = side as f64 - 1.0;
        let margin = 0.5 * (1.0 - self.central_share) * last;
        (margin, last - margin)
    }

    /// The nearest lenslet within the limits.
    #[must_use]
    pub fn project(&self, mut lenslet: Lenslet, rows: usize, cols: usize) -> Lenslet {
        let (left, right) = self.coordinate_range(cols);
        let (top, bottom) = self.coordinate_range(rows);
        lenslet.x = lenslet.x.clamp(left, right);
        lenslet.y = lenslet.y.clamp(top, bottom);
        lenslet.weight = lenslet.weight.max(0.0);
        // Rounding may bring the least width slightly below its limit. Such a width stays bit-identical.
        if lenslet.spot.principal_sigmas().0 < self.min_sigma_px * (1.0 - 1e-9) {
            lenslet.spot = match lenslet.spot {
                Spot::Isotropic(_) => Spot::Isotropic(self.min_sigma_px),
                Spot::Anisotropic { xx, xy, yy } => floor_eigenvalues(xx, xy, yy, self.min_sigma_px.powi(2)),
            };
        }
        lenslet
    }
}

/// The covariance with both eigenvalues raised to at least `floor` (square pixels) and unchanged axes.
fn floor_eigenvalues(xx: f64, xy: f64, yy: f64, floor: f64) -> Spot {
    let middle = 0.5 * (xx + yy);
    let half = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    if half < 1e-12 {
        return Spot::Anisotropic { xx: floor.max(xx), xy: 0.0, yy: floor.max(yy) };
    }
    let (small, large) = ((middle - half).max(floor), (middle + half).max(floor));
    // Unit deviator of the covariance: cos and sin of twice the major axis' angle.
    let (cos, sin) = (0.5 * (xx - yy) / half, xy / half);
    let (mean, spread) = (0.5 * (small + large), 0.5 * (large - small));
    Spot::Anisotropic { xx: mean + spread * cos, xy: spread * sin, yy: mean - spread * cos }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projection_is_idempotent_and_floors_the_narrow_axis_only() {
        let limits = Limits::default();
        let lenslet =
            Lenslet { x: -3.0, y: 40.0, spot: Spot::Anisotropic { xx: 4.0, xy: 0.3, yy: 0.1 }, weight: -1.0, plane: 0 };
        let once = limits.project(lenslet, 32, 32);
        assert_eq!(once.weight, 0.0);
        assert!((once.x - 3.1).abs() < 1e-12 && (once.y - 27.9).abs() < 1e-12);
        let (minor, major) = once.spot.principal_sigmas();
        assert!((minor - 0.775).abs() < 1e-12);
        assert!((major - lenslet.spot.principal_sigmas().1).abs() < 1e-12, "the wide axis must not change");
        assert_eq!(limits.project(once, 32, 32), once);
    }

    #[test]
    fn ellipses_that_are_raised_to_the_least_width_of_all_are_masks() {
        let limits = Limits { min_sigma_px: MIN_SIGMA, ..Limits::default() };
        for step in 0..500 {
            let angle = 0.013 * f64::from(step);
            let (sin, cos) = angle.sin_cos();
            let (large, small) = (0.3 + 0.01 * f64::from(step), 1e-4);
            let (xx, yy) = (large * cos * cos + small * sin * sin, large * sin * sin + small * cos * cos);
            let spot = Spot::Anisotropic { xx, xy: (large - small) * sin * cos, yy };
            let lenslet = limits.project(Lenslet { spot, ..Lenslet::round(16.0, 16.0, 1.0, 1.0) }, 32, 32);
            let array = LensletArray::new(32, 32, vec![lenslet]);
            assert!(array.check().is_ok(), "{lenslet:?}");
        }
    }

    #[test]
    fn effective_count_ignores_dark_lenslets() {
        let mut array = crate::optics::heuristic_layout(4);
        assert!((array.effective_count() - 4.0).abs() < 1e-12);
        array.lenslets[0].weight = 0.0;
        assert!((array.effective_count() - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_mask_that_cannot_be_is_named() {
        let mut array = crate::optics::heuristic_layout(2);
        array.lenslets[1].x = f64::NAN;
        let error = array.check().unwrap_err().to_string();
        assert!(error.starts_with("lenslet 2: x_px is NaN"), "{error}");
        array.lenslets.clear();
        assert_eq!(array.check(), Err(LensletError::Empty));
    }

    #[test]
    fn json_keeps_every_bit() {
        let mut array = crate::optics::random_layout(25, 7);
        array.lenslets[3].spot = Spot::Anisotropic { xx: 1.1, xy: -0.2, yy: 0.7 };
        array.lenslets[4].plane = 2;
        array.throughput = 0.3;
        let text = serde_json::to_string(&array).unwrap();
        assert_eq!(serde_json::from_str::<LensletArray>(&text).unwrap(), array);
        assert!(text.contains("\"throughput\":0.3"), "{text}");
        array.throughput = 1.0;
        assert!(!serde_json::to_string(&array).unwrap().contains("throughput"), "as before there were throughputs");
        assert!(text.contains("\"sigma_px\"") && text.contains("\"covariance_px2\""), "{text}");
    }
}
