//! Beads under the heuristic lenslet layouts, for the tests of this folder.

use ndarray::{Array2, Array3, Axis};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// (row, col) of the lenslets in the order in which the layouts add them, on a 32 x 32 grid.
const LAYOUT: [(usize, usize); 9] =
    [(16, 16), (7, 9), (23, 21), (8, 24), (21, 5), (27, 13), (4, 16), (16, 26), (14, 7)];

/// Separable Gaussian of unit sum within `radius` pixels of its centre.
fn gaussian(sigma: f64, radius: i32) -> Array2<f64> {
    let line: Vec<f64> = (-radius..=radius).map(|i| (-0.5 * (f64::from(i) / sigma).powi(2)).exp()).collect();
    let total: f64 = line.iter().sum();
    Array2::from_shape_fn((line.len(), line.len()), |(r, c)| line[r] * line[c] / (total * total))
}

/// Point spread function of the first `lenslets` of the layout, sum 1.
pub(in crate::information) fn heuristic_psf(lenslets: usize) -> Array2<f64> {
    let spot = gaussian(0.8, 3);
    let mut psf = Array2::zeros((32, 32));
    for &(row, col) in &LAYOUT[..lenslets] {
        for ((r, c), value) in spot.indexed_iter() {
            psf[[row + r - 3, col + c - 3]] += value / lenslets as f64;
        }
    }
    psf
}

/// The bead: two unit Gaussians one pixel apart on the diagonal; sum 2.
pub(in crate::information) fn bead() -> Array2<f64> {
    let sigma = 1.275e-3 * 4e3 / 2.0 / (2.0 * (2.0 * std::f64::consts::LN_2).sqrt());
    let one = gaussian(sigma, 4);
    let mut out = Array2::zeros((10, 10));
    for ((r, c), value) in one.indexed_iter() {
        out[[r, c]] += value;
        out[[r + 1, c + 1]] += value;
    }
    out
}

/// Full convolution.
pub(in crate::information) fn convolve(a: &Array2<f64>, b: &Array2<f64>) -> Array2<f64> {
    let mut out = Array2::zeros((a.nrows() + b.nrows() - 1, a.ncols() + b.ncols() - 1));
    for ((r, c), x) in a.indexed_iter() {
        for ((s, d), y) in b.indexed_iter() {
            out[[r + s, c + d]] += x * y;
        }
    }
    out
}

/// Photons that one bead adds on an infinite sensor, shape (1, rows, cols), at a scene mean of 100 photons per pixel.
pub(in crate::information) fn bead_spot(lenslets: usize, probability: f64) -> Array3<f64> {
    let scale = 100.0 / (2.0 * probability);
    convolve(&bead(), &heuristic_psf(lenslets)).mapv(|x| x * scale).insert_axis(Axis(0))
}

/// Autocovariance of independent beads of a scene mean of 100 photons per pixel, lags up to `lag`.
pub(in crate::information) fn bead_autocovariance(probability: f64, lag: usize) -> Array2<f64> {
    let bead = bead().mapv(|x| x * 100.0 / (2.0 * probability));
    let mut turned = bead.clone();
    turned.invert_axis(Axis(0));
    turned.invert_axis(Axis(1));
    let correlation = convolve(&bead, &turned);
    let mut out = Array2::zeros((2 * lag + 1, 2 * lag + 1));
    let reach = bead.nrows() - 1;
    for ((r, c), value) in correlation.indexed_iter() {
        out[[lag + r - reach, lag + c - reach]] = value * probability * (1.0 - probability);
    }
    out
}

/// One encoded image of independent beads, side x side pixels, with a bias of 10 photons.
pub(in crate::information) fn encoded_image(
    spot: &Array3<f64>,
    probability: f64,
    side: usize,
    seed: u64,
) -> Array2<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let spot = spot.index_axis(Axis(0), 0);
    let (rows, cols) = spot.dim();
    let lit: Vec<_> = spot.indexed_iter().filter(|(_, photons)| **photons > 1e-4).collect();
    let mut image = Array2::from_elem((side, side), 10.0_f64);
    for r in 0..side + rows - 1 {
        for c in 0..side + cols - 1 {
            if rng.random::<f64>() < probability {
                for ((s, d), photons) in &lit {
                    let (row, col) = ((r + s).wrapping_sub(rows - 1), (c + d).wrapping_sub(cols - 1));
                    if let Some(pixel) = image.get_mut((row, col)) {
                        *pixel += **photons;
                    }
                }
            }
        }
    }
    image.mapv(|x| x as f32)
}
