//! Fit of lenslets to a PSF image, so that an imported mask can be edited and optimized.
//!
//! Round Gaussian spots are added one by one. Each is the spot that explains most of the residual (matching pursuit,
//! Mallat and Zhang 1993). All spots are then fitted together by damped least squares (Marquardt 1963).

use std::ops::Range;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use ndarray::{Array1, Array2, ArrayView2, Axis, Zip, s};
use thiserror::Error;

use super::encoder::Encoder;
use super::lenslets::{Lenslet, LensletArray, Spot};
use super::psf::SampledSpot;

use crate::plural::{counted, one_or_many};

/// Initial widths of a spot, px. Those of published lenslets lie between the first two.
const WIDTHS: [f64; 6] = [0.7, 1.0, 1.5, 2.3, 3.5, 5.5];
/// Narrowest spot, px.
const NARROWEST: f64 = 0.3;
/// Least share of the squared PSF that one more spot must explain. Below it the spot explains noise.
const LEAST_GAIN: f64 = 1e-5;
/// Largest share of misplaced light in a good fit.
const GOOD: f64 = 1e-3;
/// Share of the light below which a spot is omitted.
const DARK: f64 = 1e-4;
/// Fit steps after each new spot, and at the end.
const STEPS: usize = 4;
const LAST_STEPS: usize = 60;
/// Least relative decrease of the squared error after which the fit makes another step.
const LEAST_STEP: f64 = 1e-5;
/// Parameters of a spot: column, row and logarithm of the width, and weight.
const PARAMETERS: usize = 4;

/// Lenslets fitted to a PSF image.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedLenslets {
    /// The round lenslets, the brightest first.
    pub array: LensletArray,
    /// Share of the light at other pixels than in the image, 0 to 1: half the sum of absolute differences.
    pub misplaced: f64,
}

/// Reason why no lenslets are fitted.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LensletFitError {
    /// The image is too large for the fit.
    #[error(
        "lenslets are fitted to a PSF of at most {max} pixels a side, found {rows} x {cols}; resample it when it is imported",
        max = FittedLenslets::MOST_SIDE
    )]
    Shape {
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// The image holds no spot.
    #[error("no lenslet explains this PSF: it has no light")]
    NoSpot,
}

impl FittedLenslets {
    /// Largest number of lenslets of a fit.
    pub const MOST: usize = 64;
    /// Largest side of an image, px.
    pub const MOST_SIDE: usize = 128;

    /// Summary of the fit in a sentence.
    pub fn summary(&self) -> String {
        let count = self.array.lenslets.len();
        let (lenslets, stand) = (counted(count, "lenslet"), one_or_many(count, "stands", "stand"));
        format!("{lenslets} {stand} for the PSF, {:.1} % of whose light is elsewhere", 100.0 * self.misplaced)
    }

    /// Fits up to `most` lenslets to a PSF, shape (rows, cols), not negative.
    ///
    /// # Errors
    /// Where the image is too large, or no spot explains any of it.
    pub fn of(psf: ArrayView2<'_, f64>, most: usize) -> Result<Self, LensletFitError> {
        let (rows, cols) = psf.dim();
        if rows.max(cols) > Self::MOST_SIDE {
            return Err(LensletFitError::Shape { rows, cols });
        }
        let total = psf.sum();
        if !(total > 0.0 && total.is_finite()) {
            return Err(LensletFitError::NoSpot);
        }
        let psf = psf.mapv(|light| light / total);
        let energy = squared(&psf);
        let mut fit = Fit { psf: &psf, spots: Vec::new(), damping: 1e-3 };
        while fit.spots.len() < most.min(Self::MOST) {
            let left = fit.left();
            let Some((spot, gain)) = best_spot(&left) else { break };
            if gain < LEAST_GAIN * energy || 0.5 * left.mapv(f64::abs).sum() < GOOD {
                break;
            }
            fit.spots.push(spot);
            fit.improve(STEPS);
        }
        fit.improve(LAST_STEPS);
        let light: f64 = fit.spots.iter().map(|spot| spot.weight).sum();
        fit.spots.retain(|spot| spot.weight > DARK * light);
        if fit.spots.is_empty() {
            return Err(LensletFitError::NoSpot);
        }
        fit.spots.sort_by(|one, other| other.weight.total_cmp(&one.weight));
        let light: f64 = fit.spots.iter().map(|spot| spot.weight).sum();
        fit.spots.iter_mut().for_each(|spot| spot.weight /= light);
        let misplaced = 0.5 * fit.left().mapv(f64::abs).sum();
        Ok(Self { array: LensletArray::new(rows, cols, fit.spots), misplaced })
    }
}

/// Lenslets fitted to the PSF of an image or a diffuser, with its throughput.
///
/// # Errors
/// The errors of [`FittedLenslets::of`].
pub fn fit_lenslets(encoder: &Encoder) -> Result<FittedLenslets, LensletFitError> {
    let psf = encoder.psf(1).map_err(|_| LensletFitError::NoSpot)?;
    let fitted = FittedLenslets::of(psf.index_axis(Axis(0), 0), FittedLenslets::MOST)?;
    Ok(FittedLenslets { array: fitted.array.with_throughput(encoder.throughput()), ..fitted })
}

fn squared(image: &Array2<f64>) -> f64 {
    image.iter().map(|value| value * value).sum()
}

/// The spot that explains most of an image, and the decrease of the squared error.
fn best_spot(left: &Array2<f64>) -> Option<(Lenslet, f64)> {
    let mut best: Option<(Lenslet, f64)> = None;
    for sigma in WIDTHS {
        let reach = (4.0 * sigma).ceil() as usize;
        let profile: Vec<f64> =
            (0..=2 * reach).map(|at| (-0.5 * ((at as f64 - reach as f64) / sigma).powi(2)).exp()).collect();
        let sum: f64 = profile.iter().sum();
        let profile: Array1<f64> = profile.into_iter().map(|value| value / sum).collect();
        let seen = blurred(&blurred(left, &profile, Axis(0)), &profile, Axis(1));
        // The squared norm of a spot is the same at every place where no part of it is cut off.
        let square = profile.dot(&profile).powi(2);
        for ((row, col), &product) in seen.indexed_iter() {
            let gain = product.max(0.0).powi(2) / square;
            if gain > best.as_ref().map_or(0.0, |&(_, most)| most) {
                best = Some((Lenslet::round(col as f64, row as f64, sigma, product / square), gain));
            }
        }
    }
    best
}

/// An image convolved with a profile along an axis, with zeros beyond its border.
fn blurred(image: &Array2<f64>, profile: &Array1<f64>, axis: Axis) -> Array2<f64> {
    let (length, reach) = (image.len_of(axis), profile.len() / 2);
    let mut blurred = Array2::zeros(image.dim());
    for (into, mut line) in blurred.axis_iter_mut(axis).enumerate() {
        for from in into.saturating_sub(reach)..length.min(into + reach + 1) {
            line.scaled_add(profile[reach + from - into], &image.index_axis(axis, from));
        }
    }
    blurred
}

/// State of a fit.
struct Fit<'a> {
    /// Sum 1.
    psf: &'a Array2<f64>,
    /// Spots; their weights are shares of the light of the image.
    spots: Vec<Lenslet>,
    /// Damping of the next step.
    damping: f64,
}

/// A spot in the region where it is not negligible, and its derivatives with respect to each of its parameters.
struct Slopes {
    rows: Range<usize>,
    cols: Range<usize>,
    by: [Array2<f64>; PARAMETERS],
}

impl Slopes {
    fn of(lenslet: &Lenslet, (rows, cols): (usize, usize)) -> Self {
        let SampledSpot { rows, cols, values } = SampledSpot::new(lenslet, rows, cols);
        let variance = lenslet.spot.mean_sigma().powi(2);
        let scores = |at: (usize, usize)| {
            let (dx, dy) = ((cols.start + at.1) as f64 - lenslet.x, (rows.start + at.0) as f64 - lenslet.y);
            [dx / variance, dy / variance, (dx * dx + dy * dy) / variance]
        };
        // The sum of a spot stays 1, so the mean of each score is subtracted.
        let mut means = [0.0; PARAMETERS - 1];
        for (at, value) in values.indexed_iter() {
            means.iter_mut().zip(scores(at)).for_each(|(mean, score)| *mean += value * score);
        }
        let by = |index: usize| {
            Array2::from_shape_fn(values.dim(), |at| lenslet.weight * values[at] * (scores(at)[index] - means[index]))
        };
        let by = [by(0), by(1), by(2), values.clone()];
        Self { rows, cols, by }
    }

    /// Sums of products of the derivatives of two spots, over their common pixels.
    fn products(&self, other: &Self) -> [[f64; PARAMETERS]; PARAMETERS] {
        let shared = |one: &Range<usize>, other: &Range<usize>| one.start.max(other.start)..one.end.min(other.end);
        let (rows, cols) = (shared(&self.rows, &other.rows), shared(&self.cols, &other.cols));
        if rows.is_empty() || cols.is_empty() {
            return [[0.0; PARAMETERS]; PARAMETERS];
        }
        let places = [0, 1, 2, 3];
        let (ones, others) =
            (places.map(|index| self.part(index, &rows, &cols)), places.map(|index| other.part(index, &rows, &cols)));
        let product = |one: &ArrayView2<'_, f64>, other: &ArrayView2<'_, f64>| {
            Zip::from(one).and(other).fold(0.0, |sum, one, other| sum + one * other)
        };
        ones.each_ref().map(|one| others.each_ref().map(|other| product(one, other)))
    }

    /// One derivative at some of its pixels.
    fn part(&self, index: usize, rows: &Range<usize>, cols: &Range<usize>) -> ArrayView2<'_, f64> {
        let rows = rows.start - self.rows.start..rows.end - self.rows.start;
        self.by[index].slice(s![rows, cols.start - self.cols.start..cols.end - self.cols.start])
    }
}

impl Fit<'_> {
    /// Residual of the image.
    fn left(&self) -> Array2<f64> {
        let mut left = self.psf.clone();
        let (rows, cols) = left.dim();
        for lenslet in &self.spots {
            let SampledSpot { rows, cols, values } = SampledSpot::new(lenslet, rows, cols);
            left.slice_mut(s![rows, cols]).scaled_add(-lenslet.weight, &values);
        }
        left
    }

    /// Makes steps towards the least squared error.
    fn improve(&mut self, steps: usize) {
        if self.spots.is_empty() {
            return;
        }
        let mut left = self.left();
        let mut error = squared(&left);
        for _ in 0..steps {
            let slopes: Vec<Slopes> = self.spots.iter().map(|spot| Slopes::of(spot, left.dim())).collect();
            let count = PARAMETERS * slopes.len();
            let mut square = Mat::<f64>::zeros(count, count);
            for (i, one) in slopes.iter().enumerate() {
                for (j, other) in slopes[..=i].iter().enumerate() {
                    for (a, row) in one.products(other).into_iter().enumerate() {
                        for (b, product) in row.into_iter().enumerate() {
                            square[(PARAMETERS * i + a, PARAMETERS * j + b)] = product;
                        }
                    }
                }
            }
            let towards = Mat::from_fn(count, 1, |index, _| {
                let Slopes { rows, cols, by } = &slopes[index / PARAMETERS];
                (&by[index % PARAMETERS] * &left.slice(s![rows.clone(), cols.clone()])).sum()
            });
            let before = (self.spots.clone(), error);
            for _ in 0..8 {
                self.spots.clone_from(&before.0);
                self.step(&square, &towards);
                left = self.left();
                error = squared(&left);
                if error < before.1 {
                    self.damping = (self.damping / 5.0).max(1e-9);
                    break;
                }
                self.damping = (self.damping * 4.0).min(1e9);
            }
            if error >= before.1 {
                self.spots = before.0;
                return;
            }
            if before.1 - error < LEAST_STEP * before.1 {
                return;
            }
        }
    }

    /// Makes one damped step. `square` holds the products of all derivatives (its lower half), `towards` their products
    /// with the residual.
    fn step(&mut self, square: &Mat<f64>, towards: &Mat<f64>) {
        let count = square.nrows();
        // The derivatives of a spot without light are 0 for place and width.
        let damped = Mat::from_fn(count, count, |i, j| {
            square[(i, j)] + if i == j { self.damping * square[(i, i)] + 1e-12 } else { 0.0 }
        });
        let Ok(factor) = damped.llt(Side::Lower) else { return };
        let step = factor.solve(towards);
        let (rows, cols) = self.psf.dim();
        let widest = rows.max(cols) as f64;
        for (index, spot) in self.spots.iter_mut().enumerate() {
            let by = |parameter: usize| step[(PARAMETERS * index + parameter, 0)];
            // Limited to where derivatives are informative.
            spot.x = (spot.x + by(0).clamp(-1.0, 1.0)).clamp(-0.5, cols as f64 - 0.5);
            spot.y = (spot.y + by(1).clamp(-1.0, 1.0)).clamp(-0.5, rows as f64 - 0.5);
            let sigma = spot.spot.mean_sigma() * by(2).clamp(-0.5, 0.5).exp();
            spot.spot = Spot::Isotropic(sigma.clamp(NARROWEST, widest));
            spot.weight = (spot.weight + by(3)).max(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Diffuser, heuristic_layout, random_layout, render_psf};

    fn psf_of(array: &LensletArray) -> Array2<f64> {
        render_psf(array, 1).unwrap().index_axis_move(Axis(0), 0)
    }

    #[test]
    fn lenslets_are_found_again() {
        let mut array = heuristic_layout(9);
        for (index, lenslet) in array.lenslets.iter_mut().enumerate() {
            lenslet.x += 0.37 * index as f64 / 9.0;
            lenslet.weight = 1.0 + index as f64;
            lenslet.spot = Spot::Isotropic(0.8 + 0.1 * index as f64);
        }
        let array = array.with_unit_weight();
        let found = FittedLenslets::of(psf_of(&array).view(), 64).unwrap();
        assert!(found.misplaced < 1e-3, "{}", found.misplaced);
        assert_eq!(found.array.lenslets.len(), 9, "{:?}", found.array);
        for (one, other) in found.array.lenslets.iter().zip(array.lenslets.iter().rev()) {
            assert!((one.x - other.x).hypot(one.y - other.y) < 0.01, "{one:?} {other:?}");
            assert!((one.weight - other.weight).abs() < 1e-3, "{one:?} {other:?}");
            assert!((one.spot.mean_sigma() - other.spot.mean_sigma()).abs() < 0.01, "{one:?} {other:?}");
        }
        assert!((found.array.lenslets.iter().map(|lenslet| lenslet.weight).sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn images_of_lenslets_that_overlap_are_explained() {
        for seed in 1..=3 {
            let found = FittedLenslets::of(psf_of(&random_layout(25, seed)).view(), 64).unwrap();
            assert!(found.misplaced < 0.01, "{}", found.misplaced);
            found.array.check().unwrap();
        }
    }

    #[test]
    fn residual_is_a_share_of_the_light() {
        let caustics = Diffuser::with_light_kept(32, 1).render();
        let share = |most| FittedLenslets::of(caustics.view(), most).unwrap();
        let (few, many) = (share(4), share(64));
        assert!(many.misplaced < few.misplaced && many.misplaced > 0.01, "{} {}", few.misplaced, many.misplaced);
        assert!(few.array.lenslets.len() <= 4 && few.misplaced < 1.0);
        let rendered = psf_of(&many.array);
        let caustics = &caustics / caustics.sum();
        assert!((0.5 * (&rendered - &caustics).mapv(f64::abs).sum() - many.misplaced).abs() < 1e-9);
    }

    #[test]
    fn noise_of_a_camera_makes_no_lenslets() {
        let array = heuristic_layout(4);
        let clean = psf_of(&array);
        let brightest = clean.fold(0.0_f64, |most, &light| most.max(light));
        // Grey levels of eight bits, some off by one.
        let grey =
            |light: f64, at: usize| ((light / brightest * 250.0).round() + (at * 7919 % 11 / 10) as f64).max(0.0);
        let psf = Array2::from_shape_fn(clean.dim(), |(row, col)| grey(clean[(row, col)], row * 32 + col));
        let found = FittedLenslets::of(psf.view(), 64).unwrap();
        for lenslet in &array.lenslets {
            let near = found.array.lenslets.iter().filter(|one| (one.x - lenslet.x).hypot(one.y - lenslet.y) < 0.3);
            let light: f64 = near.map(|one| one.weight).sum();
            assert!(light > 0.17, "{lenslet:?} {:?}", found.array);
        }
    }

    #[test]
    fn a_image_without_spots_is_refused() {
        let refused = |psf: Array2<f64>| FittedLenslets::of(psf.view(), 64).unwrap_err();
        assert_eq!(refused(Array2::zeros((8, 8))), LensletFitError::NoSpot);
        assert!(refused(Array2::ones((8, 129))).to_string().contains("at most 128 pixels a side, found 8 x 129"));
        // One pixel is also a spot.
        let found = FittedLenslets::of(Array2::ones((1, 1)).view(), 64).unwrap();
        assert_eq!((found.array.lenslets.len(), found.array.rows), (1, 1));
        assert!(found.misplaced < 1e-9);
    }
}
