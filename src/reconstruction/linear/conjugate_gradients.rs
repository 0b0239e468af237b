//! Linear estimates by conjugate gradients on the covariance of the measurement, for fields of any size.

use std::sync::OnceLock;

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use super::mean_measurement::{MeanMeasurement, check};
use crate::progress::{CancelToken, Progress};
use crate::reconstruction::decoder::{PreparedDecoder, ReconstructionStep};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::seeds::SeedStream;

/// Most iterations.
const MOST_ITERATIONS: usize = 200;
/// The residual that ends the iterations, relative to the measurement, in units of the noise.
const TOLERANCE: f64 = 1e-3;
/// Least variance of the noise in shares of the squared mean measurement. Single precision solves no problem with less noise.
const LEAST_RELATIVE_VARIANCE: f64 = 1e-5;
/// Errors that the standard deviation is the root mean square of.
const SAMPLES: usize = 48;
/// Pixels to each side that the variance is averaged over, as so few samples scatter.
const SMOOTHING_PX: usize = 2;

/// A draw from the prior without its mean: as lit, and on the scale of the set; row by row.
pub(super) struct PriorSample {
    pub(super) lit: Vec<f32>,
    pub(super) truth: Vec<f32>,
}

/// Covariance of the measurements that a prior implies. All images are row by row.
pub(super) trait MeasurementCovariance: Send + Sync {
    /// Images of one thread.
    type Memory: Send;

    /// Images of one thread.
    fn memory(&self) -> Self::Memory;
    /// Mean of the lit objects, shape (rows, cols).
    fn mean_lit(&self) -> Array2<f32>;
    /// Variance of each pixel that the covariance leaves out: of lit objects, and on the scale of the set.
    fn left_out(&self) -> Option<[Array2<f32>; 2]> {
        None
    }
    /// `A C A^T v`.
    fn apply(&self, v: &[f32], out: &mut [f32], memory: &mut Self::Memory);
    /// `C A^T v` on the scale of the set.
    fn estimate(&self, v: &[f32], out: &mut [f32], memory: &mut Self::Memory);
    /// Approximately the inverse of `A C A^T` and of the noise variance `noise` times `r`.
    fn precondition(&self, r: &[f32], noise: &[f32], out: &mut [f32], _memory: &mut Self::Memory) {
        for ((value, &r), &noise) in out.iter_mut().zip(r).zip(noise) {
            *value = r / noise;
        }
    }
    /// A draw from the prior.
    fn sample(&self, random: &mut dyn Rng, memory: &mut Self::Memory) -> PriorSample;
}

/// Linear estimate of one mask by conjugate gradients.
pub(super) struct IterativeDecoder<C> {
    model: ImagingModel,
    covariance: C,
    measurement: MeanMeasurement,
    mean_truth: Array2<f32>,
    /// Computed on the first request.
    variance: OnceLock<Array2<f64>>,
}

impl<C: MeasurementCovariance> IterativeDecoder<C> {
    /// The estimate of a model; `mean_truth` is the mean object on the scale of the set.
    pub(super) fn new(
        model: &ImagingModel,
        mean_truth: Array2<f32>,
        covariance: C,
    ) -> Result<Self, ReconstructionError> {
        let left_out = covariance.left_out();
        let lit = left_out.as_ref().map(|[lit, _]| lit.view());
        let mut measurement = MeanMeasurement::new(model, covariance.mean_lit().view(), lit)?;
        let mean = measurement.mean.iter().map(|&value| f64::from(value)).sum::<f64>() / measurement.mean.len() as f64;
        let least = (LEAST_RELATIVE_VARIANCE * mean * mean) as f32;
        for variance in &mut measurement.variance {
            *variance = variance.max(least);
        }
        Ok(Self { model: model.clone(), covariance, measurement, mean_truth, variance: OnceLock::new() })
    }

    /// Deviation of the object from its mean, on the scale of the set, from that of a measurement.
    fn solve(&self, deviation: &[f32], memory: &mut C::Memory) -> Vec<f32> {
        let pixels = deviation.len();
        let noise = &self.measurement.variance;
        let (mut v, mut r) = (vec![0.0_f32; pixels], deviation.to_vec());
        let (mut s, mut q) = (vec![0.0_f32; pixels], vec![0.0_f32; pixels]);
        self.covariance.precondition(&r, noise, &mut s, memory);
        let mut direction = s.clone();
        let mut size = dot(&r, &s);
        let enough = size * TOLERANCE * TOLERANCE;
        for _ in 0..MOST_ITERATIONS {
            if size <= enough || size <= 0.0 {
                break;
            }
            self.covariance.apply(&direction, &mut q, memory);
            q.iter_mut().zip(&direction).zip(noise).for_each(|((q, &d), &noise)| *q += noise * d);
            let step = size / dot(&direction, &q);
            add(&mut v, step, &direction);
            add(&mut r, -step, &q);
            self.covariance.precondition(&r, noise, &mut s, memory);
            let next = dot(&r, &s);
            let ratio = (next / size) as f32;
            direction.iter_mut().zip(&s).for_each(|(d, &s)| *d = s + ratio * *d);
            size = next;
        }
        let mut object = vec![0.0; self.mean_truth.len()];
        self.covariance.estimate(&v, &mut object, memory);
        object
    }

    /// Mean squared error of every pixel: that of estimates of draws from the prior, averaged over its surroundings.
    fn variance(&self, cancel: &CancelToken) -> Result<&Array2<f64>, ReconstructionError> {
        if let Some(variance) = self.variance.get() {
            return Ok(variance);
        }
        let seed = SeedStream::ReconstructionPrior.derive(1);
        let errors: Vec<Option<Vec<f32>>> = (0..SAMPLES as u64)
            .into_par_iter()
            .map_init(
                || (self.covariance.memory(), self.measurement.convolver.blur_workspace()),
                |(memory, blur), index| {
                    if cancel.is_cancelled() {
                        return None;
                    }
                    let mut random = ChaCha8Rng::seed_from_u64(seed);
                    random.set_stream(index);
                    let PriorSample { lit, mut truth } = self.covariance.sample(&mut random, memory);
                    let mut measured = vec![0.0; self.measurement.mean.len()];
                    self.measurement.convolver.blur(&lit, &mut measured, blur);
                    for (value, &variance) in measured.iter_mut().zip(&self.measurement.variance) {
                        *value += variance.sqrt() * random.sample::<f32, _>(StandardNormal);
                    }
                    let estimate = self.solve(&measured, memory);
                    truth.iter_mut().zip(&estimate).for_each(|(truth, estimate)| *truth -= estimate);
                    Some(truth)
                },
            )
            .collect();
        let mut sum = Array2::<f64>::zeros(self.model.field());
        for error in errors {
            let error = error.ok_or(ReconstructionError::Cancelled)?;
            sum.iter_mut().zip(&error).for_each(|(sum, &error)| *sum += f64::from(error).powi(2));
        }
        let mut variance = smoothed(&(sum / SAMPLES as f64), SMOOTHING_PX);
        if let Some([_, left_out]) = self.covariance.left_out() {
            variance.iter_mut().zip(&left_out).for_each(|(sum, &left_out)| *sum += f64::from(left_out));
        }
        Ok(self.variance.get_or_init(|| variance))
    }
}

impl<C: MeasurementCovariance> PreparedDecoder for IterativeDecoder<C> {
    fn reconstruct(
        &self,
        measurements: ArrayView3<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array3<f32>, ReconstructionError> {
        check(&self.model, &measurements)?;
        let (rows, cols) = self.model.field();
        let total = measurements.len_of(Axis(0));
        let mut objects = Array3::zeros((total, rows, cols));
        let together = 4 * rayon::current_num_threads();
        for first in (0..total).step_by(together) {
            let done = (first + together).min(total);
            let part = ndarray::s![first..done, .., ..];
            let (mut to, from) = (objects.slice_mut(part), measurements.slice(part));
            let pairs = to.axis_iter_mut(Axis(0)).into_par_iter().zip(from.axis_iter(Axis(0)).into_par_iter());
            pairs.for_each_init(
                || self.covariance.memory(),
                |memory, (mut object, measurement)| {
                    let deviation: Vec<f32> =
                        measurement.iter().zip(&self.measurement.mean).map(|(&y, &mean)| y - mean).collect();
                    let found = self.solve(&deviation, memory);
                    let mean = self.mean_truth.iter().zip(&found);
                    object.iter_mut().zip(mean).for_each(|(value, (&mean, &found))| *value = mean + found);
                },
            );
            if progress.report(&ReconstructionStep::Images { done, total }).is_break() {
                return Err(ReconstructionError::Cancelled);
            }
        }
        Ok(objects)
    }

    fn standard_deviation(
        &self,
        _measurement: ArrayView2<'_, f32>,
        cancel: &CancelToken,
    ) -> Result<Option<Array2<f32>>, ReconstructionError> {
        Ok(Some(self.variance(cancel)?.mapv(|variance| variance.sqrt() as f32)))
    }

    fn expected_mse(&self, cancel: &CancelToken) -> Result<Option<f64>, ReconstructionError> {
        Ok(self.variance(cancel)?.mean())
    }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
}

fn add(sum: &mut [f32], factor: f64, values: &[f32]) {
    let factor = factor as f32;
    sum.iter_mut().zip(values).for_each(|(sum, &value)| *sum += factor * value);
}

/// Mean over the square of `reach` px to each side of every pixel, as far as it lies in the image.
fn smoothed(image: &Array2<f64>, reach: usize) -> Array2<f64> {
    let along = |image: &Array2<f64>, axis: Axis| {
        let length = image.len_of(axis);
        let mut result = image.clone();
        for (index, mut line) in result.axis_iter_mut(axis).enumerate() {
            let range = index.saturating_sub(reach)..(index + reach + 1).min(length);
            let count = range.len() as f64;
            line.fill(0.0);
            range.for_each(|other| line += &image.index_axis(axis, other));
            line /= count;
        }
        result
    };
    along(&along(image, Axis(0)), Axis(1))
}
