//! Point spread function of a lenslet array, and its exact gradient.
//!
//! Each lenslet makes a Gaussian spot, sampled at pixel centres and normalised to unit sum on the grid. The PSF is the
//! weighted sum of the spots, times the throughput and divided by the sum of the weights (Kabuli et al. 2026). So the PSF
//! sums to the throughput over all planes for any positions, and a lenslet at the border loses no light.

use std::ops::Range;

use ndarray::{Array2, Array3, ArrayView3, Axis, s};

use super::lenslets::{Lenslet, LensletArray, LensletError, Spot};

/// Renders the PSF of `array` for scenes of `planes` depth planes, shape (planes, rows, cols). Over all planes of the array
/// it sums to the throughput.
///
/// A lenslet focused on a plane that the scene lacks takes its share of the light and images nothing.
///
/// # Errors
/// The errors of [`LensletArray::check`].
pub fn render_psf(array: &LensletArray, planes: usize) -> Result<Array3<f64>, LensletError> {
    array.check()?;
    let total: f64 = array.lenslets.iter().map(|lenslet| lenslet.weight).sum();
    let mut psf = Array3::zeros((planes, array.rows, array.cols));
    for lenslet in array.lenslets.iter().filter(|lenslet| lenslet.weight > 0.0 && lenslet.plane < planes) {
        let spot = SampledSpot::new(lenslet, array.rows, array.cols);
        psf.index_axis_mut(Axis(0), lenslet.plane)
            .slice_mut(s![spot.rows.clone(), spot.cols.clone()])
            .scaled_add(array.throughput * lenslet.weight / total, &spot.values);
    }
    Ok(psf)
}

/// Gradient of a scalar with respect to the parameters of one lenslet.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensletGradient {
    /// With respect to the column of the centre, per pixel.
    pub x: f64,
    /// With respect to the row of the centre, per pixel.
    pub y: f64,
    /// With respect to the standard deviation of an isotropic spot, per pixel; 0 for an anisotropic one.
    pub sigma: f64,
    /// With respect to the covariance entries (xx, xy, yy) of an anisotropic spot, per square pixel; zeros for an
    /// isotropic one.
    pub covariance: [f64; 3],
    /// With respect to the weight as stored (before normalisation).
    pub weight: f64,
}

/// Gradient of a scalar with respect to every lenslet parameter, by the chain rule.
///
/// `cotangent` is the gradient with respect to each PSF value, shape (planes, rows, cols). The PSF is that of
/// [`render_psf`] with the same number of planes.
///
/// # Errors
/// The errors of [`LensletArray::check`].
///
/// # Panics
/// Where rows or columns of `cotangent` differ from the array's grid.
pub fn psf_gradient(
    array: &LensletArray,
    cotangent: ArrayView3<'_, f64>,
) -> Result<Vec<LensletGradient>, LensletError> {
    array.check()?;
    let planes = cotangent.len_of(Axis(0));
    assert_eq!(cotangent.dim(), (planes, array.rows, array.cols), "cotangent and PSF must have one shape");
    let total: f64 = array.lenslets.iter().map(|lenslet| lenslet.weight).sum();
    let mut gradients: Vec<_> = array
        .lenslets
        .iter()
        .map(|lenslet| {
            if lenslet.plane < planes {
                spot_gradient(array, lenslet, &cotangent, array.throughput * lenslet.weight / total)
            } else {
                LensletGradient::default()
            }
        })
        .collect();
    // `weight` holds <cotangent, spot> so far. Normalisation by the total weight subtracts the mean over lenslets.
    let mean: f64 =
        gradients.iter().zip(&array.lenslets).map(|(gradient, lenslet)| gradient.weight * lenslet.weight).sum::<f64>()
            / total;
    for gradient in &mut gradients {
        gradient.weight = array.throughput * (gradient.weight - mean) / total;
    }
    Ok(gradients)
}

/// Derivatives of `<cotangent, share x spot>` with respect to the spot's parameters. `weight` holds `<cotangent, spot>`
/// itself.
///
/// With spot g = e / sum(e), e = exp(-q/2): `dg/dt = g (d log e/dt - E_g[d log e/dt])`. So each derivative is the
/// covariance under g of the cotangent with the score of the unnormalised Gaussian.
fn spot_gradient(
    array: &LensletArray,
    lenslet: &Lenslet,
    cotangent: &ArrayView3<'_, f64>,
    share: f64,
) -> LensletGradient {
    let spot = SampledSpot::new(lenslet, array.rows, array.cols);
    let precision = Precision::of(lenslet.spot);
    let window = cotangent.slice(s![lenslet.plane, spot.rows.clone(), spot.cols.clone()]);
    let mut mean_cotangent = 0.0;
    // Scores for (x, y, sigma, xx, xy, yy): their means under g, and the means of cotangent x score.
    let mut means = [0.0; 6];
    let mut products = [0.0; 6];
    for ((row, col), &g) in spot.values.indexed_iter() {
        let dx = (spot.cols.start + col) as f64 - lenslet.x;
        let dy = (spot.rows.start + row) as f64 - lenslet.y;
        let (vx, vy) = precision.times(dx, dy);
        let by_sigma = match lenslet.spot {
            Spot::Isotropic(sigma) => (dx * dx + dy * dy) / sigma.powi(3),
            Spot::Anisotropic { .. } => 0.0,
        };
        let scores = [vx, vy, by_sigma, 0.5 * vx * vx, vx * vy, 0.5 * vy * vy];
        let weighted = g * window[(row, col)];
        mean_cotangent += weighted;
        for ((mean, product), score) in means.iter_mut().zip(&mut products).zip(scores) {
            *mean += g * score;
            *product += weighted * score;
        }
    }
    let derivative = |index: usize| share * (products[index] - mean_cotangent * means[index]);
    let anisotropic = matches!(lenslet.spot, Spot::Anisotropic { .. });
    LensletGradient {
        x: derivative(0),
        y: derivative(1),
        sigma: derivative(2),
        covariance: if anisotropic { [derivative(3), derivative(4), derivative(5)] } else { [0.0; 3] },
        weight: mean_cotangent,
    }
}

/// Inverse covariance of a spot, per square pixel.
struct Precision {
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Precision {
    fn of(spot: Spot) -> Self {
        let (xx, xy, yy) = spot.covariance();
        let determinant = xx * yy - xy * xy;
        Self { xx: yy / determinant, xy: -xy / determinant, yy: xx / determinant }
    }

    fn times(&self, dx: f64, dy: f64) -> (f64, f64) {
        (self.xx * dx + self.xy * dy, self.xy * dx + self.yy * dy)
    }
}

/// One spot in the region where it is not negligible, normalised to unit sum on the grid.
pub(super) struct SampledSpot {
    pub rows: Range<usize>,
    pub cols: Range<usize>,
    pub values: Array2<f64>,
}

impl SampledSpot {
    /// Radius in standard deviations. Beyond it a Gaussian is below the rounding of `f64` (exp(-50) = 2e-22).
    const REACH: f64 = 10.0;

    pub fn new(lenslet: &Lenslet, rows: usize, cols: usize) -> Self {
        let (xx, _, yy) = lenslet.spot.covariance();
        let rows = Self::window(lenslet.y, yy.sqrt(), rows);
        let cols = Self::window(lenslet.x, xx.sqrt(), cols);
        let shape = (rows.len(), cols.len());
        let mut values = if let Spot::Isotropic(sigma) = lenslet.spot {
            let profile = |range: &Range<usize>, centre: f64| -> Vec<f64> {
                range.clone().map(|pixel| (-0.5 * ((pixel as f64 - centre) / sigma).powi(2)).exp()).collect()
            };
            let (along_y, along_x) = (profile(&rows, lenslet.y), profile(&cols, lenslet.x));
            Array2::from_shape_fn(shape, |(row, col)| along_y[row] * along_x[col])
        } else {
            let precision = Precision::of(lenslet.spot);
            Array2::from_shape_fn(shape, |(row, col)| {
                let (dx, dy) = ((cols.start + col) as f64 - lenslet.x, (rows.start + row) as f64 - lenslet.y);
                let (vx, vy) = precision.times(dx, dy);
                (-0.5 * (dx * vx + dy * vy)).exp()
            })
        };
        let sum = values.sum();
        values /= sum;
        Self { rows, cols, values }
    }

    fn window(centre: f64, sigma: f64, side: usize) -> Range<usize> {
        // The region holds at least the nearest pixel, however narrow the spot.
        let reach = (Self::REACH * sigma).max(1.0);
        let first = (centre - reach).ceil().max(0.0) as usize;
        let last = ((centre + reach).floor().max(0.0) as usize).min(side - 1);
        first.min(side - 1)..last + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{heuristic_layout, random_layout};

    #[test]
    fn a_psf_sums_to_one_and_sits_where_its_lenslet_is() {
        let mut array = heuristic_layout(1);
        array.lenslets[0] = Lenslet::round(5.0, 20.0, 0.8, 3.0);
        let psf = render_psf(&array, 1).unwrap();
        assert!((psf.sum() - 1.0).abs() < 1e-12);
        let ((_, row, col), _) = psf.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
        assert_eq!((row, col), (20, 5), "x is the column, y the row");
    }

    #[test]
    fn light_of_a_lenslet_focused_elsewhere_is_missing() {
        let mut array = heuristic_layout(4);
        array.lenslets[1].plane = 1;
        assert!((render_psf(&array, 2).unwrap().sum() - 1.0).abs() < 1e-12);
        assert!((render_psf(&array, 1).unwrap().sum() - 0.75).abs() < 1e-12);
    }

    #[test]
    fn an_anisotropic_spot_has_the_moments_it_was_given() {
        let mut array = heuristic_layout(1);
        (array.rows, array.cols) = (64, 64);
        let spot = Spot::Anisotropic { xx: 9.0, xy: 2.0, yy: 4.0 };
        array.lenslets[0] = Lenslet { x: 30.3, y: 33.1, spot, weight: 1.0, plane: 0 };
        let psf = render_psf(&array, 1).unwrap();
        let moment = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            psf.indexed_iter().map(|((_, row, col), h)| h * f(col as f64 - 30.3, row as f64 - 33.1)).sum()
        };
        for (found, expected) in [
            (moment(&|x, _| x), 0.0),
            (moment(&|_, y| y), 0.0),
            (moment(&|x, _| x * x), 9.0),
            (moment(&|x, y| x * y), 2.0),
            (moment(&|_, y| y * y), 4.0),
        ] {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    /// Central differences of <cotangent, PSF> for every parameter, against the gradient.
    #[test]
    fn the_gradient_agrees_with_finite_differences() {
        let mut array = random_layout(6, 3);
        array.lenslets[2].spot = Spot::Anisotropic { xx: 2.0, xy: 0.6, yy: 1.1 };
        array.lenslets[3].plane = 1;
        // A lenslet at the border, where the normalisation on the grid matters.
        array.lenslets[4].x = 0.3;
        array.lenslets[5].weight = 0.0;
        array.throughput = 0.3;
        let cotangent = Array3::from_shape_fn((2, 32, 32), |(plane, row, col)| {
            ((plane * 7 + row * 3 + col * 5) as f64 * 0.7).sin()
        });
        let value = |array: &LensletArray| (&cotangent * &render_psf(array, 2).unwrap()).sum();
        let gradients = psf_gradient(&array, cotangent.view()).unwrap();
        for (index, gradient) in gradients.iter().enumerate() {
            let difference = |change: &dyn Fn(&mut Lenslet, f64)| {
                let step = 1e-5;
                let (mut up, mut down) = (array.clone(), array.clone());
                change(&mut up.lenslets[index], step);
                change(&mut down.lenslets[index], -step);
                (value(&up) - value(&down)) / (2.0 * step)
            };
            let close = |name: &str, exact: f64, numeric: f64| {
                assert!((exact - numeric).abs() < 1e-8 + 1e-6 * numeric.abs(), "{index} {name}: {exact} {numeric}");
            };
            close("x", gradient.x, difference(&|lenslet, step| lenslet.x += step));
            close("y", gradient.y, difference(&|lenslet, step| lenslet.y += step));
            if index == 5 {
                // At weight 0 only one side exists.
                let mut up = array.clone();
                up.lenslets[5].weight = 1e-6;
                assert!((gradient.weight - (value(&up) - value(&array)) / 1e-6).abs() < 1e-4);
            } else {
                close("weight", gradient.weight, difference(&|lenslet, step| lenslet.weight += step));
            }
            for entry in 0..3 {
                let numeric = difference(&|lenslet, step| {
                    if let Spot::Anisotropic { xx, xy, yy } = &mut lenslet.spot {
                        *[xx, xy, yy][entry] += step;
                    }
                });
                close("covariance", gradient.covariance[entry], numeric);
            }
            let numeric = difference(&|lenslet, step| {
                if let Spot::Isotropic(sigma) = &mut lenslet.spot {
                    *sigma += step;
                }
            });
            close("sigma", gradient.sigma, numeric);
        }
    }
}
