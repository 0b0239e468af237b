//! Linear estimates against dense matrices of the definition.

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use ndarray::{Array2, Array3, ArrayView2, Axis};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::cholesky::CholeskyDecoder;
use super::conjugate_gradients::IterativeDecoder;
use super::prior::Moments;
use super::stationary::StationaryMoments;
use super::tiles::{TileCovariance, TileMoments};
use super::{Light, LinearMmse, Prior};
use crate::progress::CancelToken;
use crate::reconstruction::decoder::{Decoder, PreparedDecoder};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::sensor::{Convolution, Noise};

/// The affine estimate of the definition, with all matrices written out.
struct Dense {
    encoder: Mat<f64>,
    mean: Vec<f64>,
    /// Covariance of the truth with lit objects.
    cross: Mat<f64>,
    truth: Mat<f64>,
    /// `A C A^T + D`.
    measured: Mat<f64>,
    background: f64,
}

impl Dense {
    fn new(model: &ImagingModel, mean: &[f64], [lit, cross, truth]: [Mat<f64>; 3], left_out: &[f64]) -> Self {
        let (psf, (rows, cols)) = (model.psf(), model.measurement_shape());
        let field_cols = model.field().1;
        // x(i, j) = sum of h(k) o(i + R - 1 - k_row, j + C - 1 - k_col)
        let mut encoder = Mat::<f64>::zeros(rows * cols, mean.len());
        for i in 0..rows * cols {
            for ((r, c), &h) in psf.indexed_iter() {
                let at = (i / cols + psf.nrows() - 1 - r) * field_cols + i % cols + psf.ncols() - 1 - c;
                encoder[(i, at)] += h;
            }
        }
        let expected = |i: usize| (0..mean.len()).map(|j| encoder[(i, j)] * mean[j]).sum::<f64>() + model.background;
        let scale = (0..rows * cols).map(expected).sum::<f64>() / (rows * cols) as f64;
        let mut measured = &encoder * lit * encoder.transpose();
        for i in 0..rows * cols {
            let extra = (0..mean.len()).map(|j| encoder[(i, j)].powi(2) * left_out[j]).sum::<f64>();
            measured[(i, i)] += model.noise_variance(expected(i), scale) + extra;
        }
        Self { encoder, mean: mean.to_vec(), cross, truth, measured, background: model.background }
    }

    /// `C_truth,lit A^T (A C A^T + D)^-1`.
    fn gain(&self) -> Mat<f64> {
        let inverse = self.measured.llt(Side::Lower).unwrap().solve(&self.encoder * self.cross.transpose());
        inverse.transpose().to_owned()
    }

    fn estimate(&self, mean_truth: &[f64], measurement: ArrayView2<'_, f32>) -> Vec<f64> {
        let deviation = Mat::from_fn(measurement.len(), 1, |i, _| {
            let expected: f64 = (0..self.mean.len()).map(|j| self.encoder[(i, j)] * self.mean[j]).sum();
            f64::from(*measurement.iter().nth(i).unwrap()) - expected - self.background
        });
        let found = self.gain() * deviation;
        mean_truth.iter().enumerate().map(|(i, mean)| mean + found[(i, 0)]).collect()
    }

    /// Posterior variance of every pixel.
    fn variance(&self) -> Vec<f64> {
        let explained = self.gain() * (&self.encoder * self.cross.transpose());
        (0..self.mean.len()).map(|i| self.truth[(i, i)] - explained[(i, i)]).collect()
    }
}

fn psf(rows: usize, cols: usize) -> Array3<f64> {
    let psf = Array3::from_shape_fn((1, rows, cols), |(_, r, c)| ((r * 5 + c * 3) % 7) as f64);
    let sum = psf.sum();
    psf / sum
}

fn measurements(model: &ImagingModel) -> Array3<f32> {
    let (rows, cols) = model.measurement_shape();
    Array3::from_shape_fn((3, rows, cols), |(n, r, c)| 40.0 + ((n * 11 + r * 7 + c * 5) % 23) as f32)
}

fn assert_near(found: impl IntoIterator<Item = f32>, expected: &[f64], tolerance: f64) {
    let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    for (at, (found, expected)) in found.into_iter().zip(expected).enumerate() {
        assert!((f64::from(found) - expected).abs() < tolerance * largest, "pixel {at}: {found} against {expected}");
    }
}

fn stationary(field: (usize, usize)) -> (StationaryMoments, Vec<f64>, Mat<f64>) {
    let mean = Array2::from_shape_fn(field, |(row, col)| 40.0 + (row + 2 * col) as f32);
    let lag = field.0.max(field.1) - 1;
    let by_lag = |down: f64, right: f64| 300.0 * (-down.abs() / 3.0 - right.abs() / 2.0).exp();
    let autocovariance = Array2::from_shape_fn((2 * lag + 1, 2 * lag + 1), |(row, col)| {
        by_lag(row as f64 - lag as f64, col as f64 - lag as f64)
    });
    let cols = field.1;
    let covariance = Mat::from_fn(mean.len(), mean.len(), |i, j| {
        by_lag((i / cols) as f64 - (j / cols) as f64, (i % cols) as f64 - (j % cols) as f64)
    });
    let mean_values = mean.iter().map(|&value| f64::from(value)).collect();
    (StationaryMoments::known(mean, autocovariance), mean_values, covariance)
}

/// A random field with a known answer, for shot noise, read noise and both, on shapes that are not square.
#[test]
fn stationary_field_is_estimated_as_by_the_dense_matrices() {
    for (field, kernel, noise) in [
        ((14, 17), (5, 4), Noise::Shot),
        ((17, 14), (4, 7), Noise::Read { sigma: 3.0 }),
        ((9, 12), (9, 3), Noise::ShotRead { sigma: 6.0 }),
    ] {
        let model = ImagingModel::new(psf(kernel.0, kernel.1).view(), field, 10.0, noise).unwrap();
        let (moments, mean, covariance) = stationary(field);
        let prior = Prior::known(Moments::Stationary(Arc::new(moments)), field);
        let prepared = LinearMmse::new(Arc::new(prior)).prepare(&model, &CancelToken::new()).unwrap();
        let covariances = [covariance.clone(), covariance.clone(), covariance];
        let dense = Dense::new(&model, &mean, covariances, &vec![0.0; mean.len()]);
        let y = measurements(&model);
        let found = prepared.reconstruct(y.view(), &mut CancelToken::new()).unwrap();
        for (found, y) in found.outer_iter().zip(y.outer_iter()) {
            assert_near(found.iter().copied(), &dense.estimate(&mean, y), 3e-3);
        }
        let expected = dense.variance().iter().sum::<f64>() / mean.len() as f64;
        let mse = prepared.expected_mse(&CancelToken::new()).unwrap().unwrap();
        assert!((mse / expected - 1.0).abs() < 0.12, "{mse} against {expected}");
    }
}

/// Moments of tiles whose components on the scale of the set differ from those of lit tiles.
fn tiles(side: usize, grid: (usize, usize), components: usize) -> TileMoments {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut normal = |scale: f32| scale * random.sample::<f32, _>(StandardNormal);
    let pixels = side * side;
    let lit = Mat::from_fn(pixels, components, |_, _| normal(9.0));
    let truth = Mat::from_fn(pixels, components, |i, k| 0.5 * lit[(i, k)] + normal(1.0));
    TileMoments {
        side,
        grid,
        field: (side * grid.0, side * grid.1),
        mean_lit: (0..pixels).map(|i| 30.0 + (i % 5) as f32).collect(),
        mean_truth: (0..pixels).map(|i| 20.0 + (i % 3) as f32).collect(),
        lit,
        truth,
        left_out_lit: (0..pixels).map(|i| (i % 4) as f32).collect(),
        left_out_truth: (0..pixels).map(|i| (i % 2) as f32).collect(),
    }
}

#[test]
fn mosaics_are_estimated_as_by_the_dense_matrices() {
    for (side, grid, kernel) in [(5, (3, 2), (6, 4)), (6, (2, 3), (7, 9)), (8, (1, 2), (3, 3))] {
        let moments = Arc::new(tiles(side, grid, 7));
        let field = moments.field;
        let model = ImagingModel::new(psf(kernel.0, kernel.1).view(), field, 5.0, Noise::Shot).unwrap();
        let place = |at: usize| {
            let (row, col) = (at / field.1, at % field.1);
            (row / side * grid.1 + col / side, row % side * side + col % side)
        };
        let outer = |a: &Mat<f32>, b: &Mat<f32>, own: Option<&[f32]>| {
            let pixels = field.0 * field.1;
            Mat::from_fn(pixels, pixels, |i, j| {
                let ((tile, p), (other, q)) = (place(i), place(j));
                let shared: f64 = (0..7).map(|k| f64::from(a[(p, k)]) * f64::from(b[(q, k)])).sum();
                let own = own.filter(|_| i == j).map_or(0.0, |own| f64::from(own[p]));
                if tile == other { shared + own } else { 0.0 }
            })
        };
        let over_field =
            |tile: &[f32]| (0..field.0 * field.1).map(|at| f64::from(tile[place(at).1])).collect::<Vec<f64>>();
        let covariances = [
            outer(&moments.lit, &moments.lit, None),
            outer(&moments.truth, &moments.lit, None),
            outer(&moments.truth, &moments.truth, Some(&moments.left_out_truth)),
        ];
        let left_out = over_field(&moments.left_out_lit);
        let dense = Dense::new(&model, &over_field(&moments.mean_lit), covariances, &left_out);
        let prior = Prior::known(Moments::Tiles(moments.clone()), field);
        let by_factor = CholeskyDecoder::new(&model, &prior, moments.clone(), &CancelToken::new()).unwrap();
        let covariance = TileCovariance::new(&model, moments.clone()).unwrap();
        let by_iterations = IterativeDecoder::new(&model, prior.mean().to_owned(), covariance).unwrap();
        let y = measurements(&model);
        let decoders: [&dyn PreparedDecoder; 2] = [&by_factor, &by_iterations];
        for decoder in decoders {
            let found = decoder.reconstruct(y.view(), &mut CancelToken::new()).unwrap();
            for (found, y) in found.outer_iter().zip(y.outer_iter()) {
                let expected = dense.estimate(&over_field(&moments.mean_truth), y);
                assert_near(found.iter().copied(), &expected, 3e-3);
            }
        }
        let deviation = by_factor.standard_deviation(y.index_axis(Axis(0), 0), &CancelToken::new()).unwrap().unwrap();
        assert_near(deviation.iter().map(|value| value * value), &dense.variance(), 1e-3);
        let expected = dense.variance().iter().sum::<f64>() / deviation.len() as f64;
        for (decoder, tolerance) in [(decoders[0], 1e-4), (decoders[1], 0.2)] {
            let mse = decoder.expected_mse(&CancelToken::new()).unwrap().unwrap();
            assert!((mse / expected - 1.0).abs() < tolerance, "{mse} against {expected}");
        }
    }
}

#[test]
fn other_fields_shapes_and_values_are_refused() {
    let field = (14, 17);
    let prior = || Prior::known(Moments::Stationary(Arc::new(stationary(field).0)), field);
    let model = ImagingModel::new(psf(5, 4).view(), (20, 17), 0.0, Noise::Shot).unwrap();
    let decoder = LinearMmse::new(Arc::new(prior()));
    let error = decoder.prepare(&model, &CancelToken::new()).err().unwrap().to_string();
    assert!(error.contains("expected shape 14 x 17, found 20 x 17"), "{error}");
    let model = ImagingModel::new(psf(5, 4).view(), field, 0.0, Noise::Shot).unwrap();
    let prepared = decoder.prepare(&model, &CancelToken::new()).unwrap();
    let mut y = measurements(&model);
    assert!(prepared.reconstruct(y.slice(ndarray::s![.., 1.., ..]), &mut CancelToken::new()).is_err());
    let cancelled = CancelToken::new();
    cancelled.cancel();
    let error = prepared.reconstruct(y.view(), &mut cancelled.clone()).err().unwrap();
    assert!(matches!(error, ReconstructionError::Cancelled));
    y[(1, 2, 3)] = f32::INFINITY;
    let error = prepared.reconstruct(y.view(), &mut CancelToken::new()).err().unwrap().to_string();
    assert!(error.contains("in image 2 at row 2, column 3"), "{error}");
}

/// A set of few sites: their covariance by its definition, as many beads in every object.
#[test]
fn beads_are_estimated_as_by_the_dense_matrices() {
    let field = (12, 14);
    let options =
        crate::objects::ObjectOptions { field, mean_photons: 60.0, ..crate::objects::ObjectOptions::default() };
    let set = crate::objects::ObjectSet::open(&"beads:0.05".parse().unwrap(), &options).unwrap();
    let beads = set.bead_prior().unwrap();
    let sites = field.0 * field.1;
    let place = |at: usize| (at / field.1, at % field.1);
    // Photons that a bead at site `j` adds to pixel `i`.
    let spot = Mat::from_fn(sites, sites, |i, j| {
        let ((row, col), (site_row, site_col)) = (place(i), place(j));
        let index = (row + beads.anchor.0).checked_sub(site_row).zip((col + beads.anchor.1).checked_sub(site_col));
        index.and_then(|index| beads.spot.get(index)).copied().unwrap_or(0.0)
    });
    let (p, n) = (beads.probability, sites as f64);
    let of_sites = Mat::from_fn(sites, sites, |i, j| p * (1.0 - p) * if i == j { 1.0 } else { -1.0 / (n - 1.0) });
    let covariance = &spot * of_sites * spot.transpose();
    let prior = Prior::learn(&set, Light::Scene, &CancelToken::new()).unwrap();
    let mean: Vec<f64> = prior.mean().iter().map(|&value| f64::from(value)).collect();
    let model = ImagingModel::new(psf(5, 4).view(), field, 10.0, Noise::Shot).unwrap();
    let prepared = LinearMmse::new(Arc::new(prior)).prepare(&model, &CancelToken::new()).unwrap();
    let dense = Dense::new(&model, &mean, [covariance.clone(), covariance.clone(), covariance], &vec![0.0; sites]);
    let y = measurements(&model);
    let found = prepared.reconstruct(y.view(), &mut CancelToken::new()).unwrap();
    for (found, y) in found.outer_iter().zip(y.outer_iter()) {
        assert_near(found.iter().copied(), &dense.estimate(&mean, y), 3e-3);
    }
    let expected = dense.variance().iter().sum::<f64>() / n;
    let mse = prepared.expected_mse(&CancelToken::new()).unwrap().unwrap();
    assert!((mse / expected - 1.0).abs() < 0.12, "{mse} against {expected}");
}

/// Less noise makes no estimate worse, down to a sensor without any.
#[test]
fn estimates_get_better_with_less_noise() {
    let options = crate::objects::ObjectOptions {
        field: (40, 44),
        mean_photons: 60.0,
        ..crate::objects::ObjectOptions::default()
    };
    let set = crate::objects::ObjectSet::open(&"beads:0.03".parse().unwrap(), &options).unwrap();
    let prior = Arc::new(Prior::learn(&set, Light::Scene, &CancelToken::new()).unwrap());
    let mse = |noise| {
        let model = ImagingModel::new(psf(8, 9).view(), (40, 44), 10.0, noise).unwrap();
        let prepared = LinearMmse::new(prior.clone()).prepare(&model, &CancelToken::new()).unwrap();
        prepared.expected_mse(&CancelToken::new()).unwrap().unwrap()
    };
    let noises = [Noise::Shot, Noise::Read { sigma: 1.0 }, Noise::Read { sigma: 0.1 }, Noise::None];
    let found = noises.map(mse);
    for pair in found.windows(2) {
        assert!(pair[1] < 1.02 * pair[0], "{found:?}");
    }
}

/// Beads: the mean thins out at the border, and the estimate is that of independent sites.
#[test]
fn beads_have_their_mean_and_their_expected_error() {
    let options = crate::objects::ObjectOptions {
        field: (40, 44),
        mean_photons: 60.0,
        ..crate::objects::ObjectOptions::default()
    };
    let set = crate::objects::ObjectSet::open(&"beads:0.03".parse().unwrap(), &options).unwrap();
    let prior = Prior::learn(&set, Light::Scene, &CancelToken::new()).unwrap();
    let mean = prior.mean().mapv(f64::from);
    assert!((mean.mean().unwrap() / set.mean() - 1.0).abs() < 1e-5, "{}", mean.mean().unwrap());
    assert!(mean[(0, 0)] < 0.7 * mean[(20, 20)]);
    let model = ImagingModel::new(psf(8, 9).view(), (40, 44), 10.0, Noise::Shot).unwrap();
    let prepared = LinearMmse::new(Arc::new(prior)).prepare(&model, &CancelToken::new()).unwrap();
    let objects = set.objects(crate::objects::Split::Test, 60, 1).unwrap();
    let convolver = Convolution::new((40, 44), (8, 9)).unwrap().with_psf(psf(8, 9).view()).unwrap();
    let y = Noise::Shot.draw(convolver.measure(objects.view(), 10.0).unwrap().view(), 2);
    let found = prepared.reconstruct(y.view(), &mut CancelToken::new()).unwrap();
    let error = (&found - &objects.index_axis(Axis(1), 0)).mapv(|value| f64::from(value).powi(2)).mean().unwrap();
    let expected = prepared.expected_mse(&CancelToken::new()).unwrap().unwrap();
    assert!((error / expected - 1.0).abs() < 0.06, "{error} against {expected}");
}
