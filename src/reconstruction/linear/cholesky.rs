//! Linear estimates of mosaics of few tiles, by a Cholesky factor for each mask.
//!
//! With the components `U` of all tiles, `G = A U` and the noise variance `D`, the coefficients are
//! `z = (I + G^T D^-1 G)^-1 G^T D^-1 (y - mean)`. The products of two tiles only need the pixels that see both.

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, MatRef, Par, Side};
use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;

use super::light::repeated;
use super::mean_measurement::{MeanMeasurement, check};
use super::principal_components::product;
use super::prior::Prior;
use super::tiles::TileMoments;
use crate::progress::{CancelToken, Progress};
use crate::reconstruction::decoder::{PreparedDecoder, ReconstructionStep};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::fourier::Fourier;
use crate::reconstruction::model::ImagingModel;

/// Measurements that are solved together.
const BATCH: usize = 64;

/// Linear estimate of one mask by a Cholesky factor.
pub(super) struct CholeskyDecoder {
    model: ImagingModel,
    moments: Arc<TileMoments>,
    measurement: MeanMeasurement,
    mean_truth: Array2<f32>,
    /// Lower factor of `I + G^T D^-1 G`.
    factor: Mat<f32>,
}

/// Rows and columns of the sensor that see a tile.
#[derive(Clone, Copy)]
struct Window {
    rows: (usize, usize),
    cols: (usize, usize),
}

impl Window {
    fn overlap(self, other: Self) -> Self {
        let both = |a: (usize, usize), b: (usize, usize)| (a.0.max(b.0), a.1.min(b.1).max(a.0.max(b.0)));
        Self { rows: both(self.rows, other.rows), cols: both(self.cols, other.cols) }
    }

    fn pixels(self) -> usize {
        (self.rows.1 - self.rows.0) * (self.cols.1 - self.cols.0)
    }

    fn each(self) -> impl Iterator<Item = (usize, usize)> {
        (self.rows.0..self.rows.1).flat_map(move |row| (self.cols.0..self.cols.1).map(move |col| (row, col)))
    }
}

/// Full convolutions of all components with the PSF.
struct Responses {
    /// Shape (components, rows x cols), pixel after pixel.
    values: Mat<f32>,
    rows: usize,
    cols: usize,
}

impl Responses {
    fn new(model: &ImagingModel, moments: &TileMoments) -> Self {
        let (psf, side) = (model.psf(), moments.side);
        let (rows, cols) = (side + psf.nrows() - 1, side + psf.ncols() - 1);
        let fourier = Fourier::at_least((rows, cols));
        let scale = 1.0 / fourier.points() as f64;
        let encoder = fourier.spectrum_of(psf.mapv(|value| (value * scale) as f32).view());
        let components: Vec<Vec<f32>> = (0..moments.components())
            .into_par_iter()
            .map(|k| {
                let tile = Array2::from_shape_fn((side, side), |(row, col)| moments.lit[(row * side + col, k)]);
                let mut spectrum = fourier.spectrum_of(tile.view());
                spectrum.iter_mut().zip(&encoder).for_each(|(value, factor)| *value *= factor);
                let mut image = vec![0.0; fourier.points()];
                fourier.inverse(&mut spectrum, &mut image);
                image
            })
            .collect();
        let width = fourier.shape().1;
        let values = Mat::from_fn(components.len(), rows * cols, |k, at| components[k][at / cols * width + at % cols]);
        Self { values, rows, cols }
    }

    /// Part of the sensor of shape `measured` that sees a tile, and the offset from its pixels to those of the response.
    fn window(&self, moments: &TileMoments, tile: usize, (psf, measured): ([usize; 2], (usize, usize))) -> Window {
        let corner = moments.corner(tile);
        // Response pixel a of a tile at row r lies on sensor row r + a - (psf rows - 1).
        let along = |corner: usize, psf: usize, length: usize, measured: usize| {
            let first = (corner + 1).saturating_sub(psf);
            (first.min(measured), (corner + 1 + length).saturating_sub(psf).clamp(first.min(measured), measured))
        };
        Window {
            rows: along(corner.0, psf[0], self.rows, measured.0),
            cols: along(corner.1, psf[1], self.cols, measured.1),
        }
    }
}

impl CholeskyDecoder {
    pub(super) fn new(
        model: &ImagingModel,
        prior: &Prior,
        moments: Arc<TileMoments>,
        cancel: &CancelToken,
    ) -> Result<Self, ReconstructionError> {
        let over_field = |tile: &[f32]| repeated(tile, moments.side, moments.field);
        let left_out = over_field(&moments.left_out_lit);
        let measurement = MeanMeasurement::new(model, over_field(&moments.mean_lit).view(), Some(left_out.view()))?;
        let go_on = || if cancel.is_cancelled() { Err(ReconstructionError::Cancelled) } else { Ok(()) };
        let responses = Responses::new(model, &moments);
        go_on()?;
        let mut information = information(model, &moments, &responses, &measurement.variance);
        go_on()?;
        for i in 0..information.nrows() {
            information[(i, i)] += 1.0;
        }
        let factor = information.llt(Side::Lower).map_err(|_| ReconstructionError::NotPositiveDefinite)?;
        let factor = Mat::from_fn(information.nrows(), information.ncols(), |i, j| factor.L()[(i, j)] as f32);
        go_on()?;
        Ok(Self { model: model.clone(), moments, measurement, mean_truth: prior.mean().to_owned(), factor })
    }

    /// Objects of the deviations of measurements from their mean.
    fn solve(&self, measurements: ArrayView3<'_, f32>, objects: &mut [f32]) {
        let moments = &self.moments;
        let (count, pixels) = (measurements.len_of(Axis(0)), moments.field.0 * moments.field.1);
        let (side, tiles, components) = (moments.side.pow(2), moments.tiles(), moments.components());
        let mut cut = vec![0.0; count * pixels];
        let convolver = &self.measurement.convolver;
        cut.par_chunks_mut(pixels).zip(measurements.axis_iter(Axis(0)).into_par_iter()).for_each_init(
            || (convolver.blur_workspace(), vec![0.0; self.measurement.mean.len()], vec![0.0; pixels]),
            |(memory, weighted, object), (cut, measurement)| {
                let moments = self.measurement.mean.iter().zip(&self.measurement.variance);
                for ((value, &y), (&mean, &variance)) in weighted.iter_mut().zip(measurement).zip(moments) {
                    *value = (y - mean) / variance;
                }
                convolver.blur_transposed(weighted, object, memory);
                self.moments.cut(object, cut);
            },
        );
        let cut_columns = MatRef::from_column_major_slice(&cut, side, tiles * count);
        let projected = product(moments.lit.transpose(), cut_columns);
        let mut z =
            Mat::from_fn(components * tiles, count, |i, n| projected[(i % components, n * tiles + i / components)]);
        let par = if count == 1 { Par::Seq } else { Par::rayon(0) };
        solve_lower_triangular_in_place(self.factor.as_ref(), z.as_mut(), par);
        solve_upper_triangular_in_place(self.factor.transpose(), z.as_mut(), par);
        let z = Mat::from_fn(components, tiles * count, |k, at| z[(at % tiles * components + k, at / tiles)]);
        let found = product(moments.truth.as_ref(), z.as_ref());
        objects.par_chunks_mut(pixels).enumerate().for_each(|(n, object)| {
            let mut tiles_of_one = vec![0.0; pixels];
            for (tile, values) in tiles_of_one.chunks_exact_mut(side).enumerate() {
                let column = found.col(n * tiles + tile);
                values.iter_mut().zip(column.iter()).for_each(|(value, &found)| *value = found);
            }
            moments.join(&tiles_of_one, object);
            object.iter_mut().zip(&self.mean_truth).for_each(|(value, &mean)| *value += mean);
        });
    }

    /// Posterior variance of every pixel, photons squared.
    fn variance(&self) -> Array2<f32> {
        let moments = &self.moments;
        let (components, side) = (moments.components(), moments.side.pow(2));
        let mut inverse = Mat::<f32>::zeros(self.factor.nrows(), self.factor.ncols());
        invert_lower_triangular(inverse.as_mut(), self.factor.as_ref(), Par::rayon(0));
        let mut variance = vec![0.0; moments.field.0 * moments.field.1];
        for (tile, values) in variance.chunks_exact_mut(side).enumerate() {
            // Rows above the block of the tile are zero.
            let first = tile * components;
            let columns = inverse.get(first.., first..first + components);
            let covariance = product(columns.transpose(), columns);
            let product = product(moments.truth.as_ref(), covariance.as_ref());
            for (pixel, value) in values.iter_mut().enumerate() {
                let pairs = product.row(pixel).iter().zip(moments.truth.row(pixel).iter());
                *value = pairs.map(|(&a, &b)| a * b).sum::<f32>() + moments.left_out_truth[pixel];
            }
        }
        let mut image = vec![0.0; variance.len()];
        moments.join(&variance, &mut image);
        Array2::from_shape_vec(moments.field, image).unwrap_or_default()
    }
}

/// `G^T D^-1 G`; the lower triangle is filled.
fn information(model: &ImagingModel, moments: &TileMoments, responses: &Responses, variance: &[f32]) -> Mat<f64> {
    let (tiles, components) = (moments.tiles(), moments.components());
    let (psf, measured) = (model.psf(), model.measurement_shape());
    let psf = [psf.nrows(), psf.ncols()];
    let windows: Vec<Window> = (0..tiles).map(|tile| responses.window(moments, tile, (psf, measured))).collect();
    let part = |tile: usize, window: Window, is_weighted: bool| {
        let corner = moments.corner(tile);
        let mut part = Mat::<f64>::zeros(components, window.pixels());
        for (at, (row, col)) in window.each().enumerate() {
            let response = (row + psf[0] - 1 - corner.0) * responses.cols + col + psf[1] - 1 - corner.1;
            let weight = if is_weighted { 1.0 / f64::from(variance[row * measured.1 + col]) } else { 1.0 };
            let values = responses.values.col(response);
            for (to, &from) in part.col_mut(at).iter_mut().zip(values.iter()) {
                *to = weight * f64::from(from);
            }
        }
        part
    };
    let pairs: Vec<(usize, usize)> = (0..tiles).flat_map(|a| (0..=a).map(move |b| (a, b))).collect();
    let blocks: Vec<Option<Mat<f64>>> = pairs
        .par_iter()
        .map(|&(a, b)| {
            let window = windows[a].overlap(windows[b]);
            (window.pixels() > 0).then(|| {
                let (left, right) = (part(a, window, true), part(b, window, false));
                let mut block = Mat::zeros(components, components);
                matmul(block.as_mut(), Accum::Replace, left.as_ref(), right.transpose(), 1.0, Par::Seq);
                block
            })
        })
        .collect();
    let mut information = Mat::zeros(tiles * components, tiles * components);
    for (&(a, b), block) in pairs.iter().zip(&blocks) {
        if let Some(block) = block {
            information.submatrix_mut(a * components, b * components, components, components).copy_from(block);
        }
    }
    information
}

impl PreparedDecoder for CholeskyDecoder {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        check(&self.model, &measurements)?;
        let (rows, cols) = self.model.field();
        let total = measurements.len_of(Axis(0));
        let mut objects = vec![0.0; total * rows * cols];
        for (index, part) in objects.chunks_mut(BATCH * rows * cols).enumerate() {
            let first = index * BATCH;
            let done = (first + BATCH).min(total);
            self.solve(measurements.slice(ndarray::s![first..done, .., ..]), part);
            if progress.report(&ReconstructionStep::Images { done, total }).is_break() {
                return Err(ReconstructionError::Cancelled);
            }
        }
        Array3::from_shape_vec((total, rows, cols), objects)
            .map_err(|_| ReconstructionError::shape("objects", &[total, rows, cols], &[0]))
    }

    fn standard_deviation(
        &self,
        _measurement: ArrayView2<'_, f32>,
        _cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>, ReconstructionError> {
        Ok(Some(self.variance().mapv(|variance| variance.max(0.0).sqrt())))
    }

    fn expected_mse(&self, _cancel: &CancelToken) -> Result<Option<f64>, ReconstructionError> {
        Ok(self.variance().mapv(f64::from).mean())
    }
}
