//! Inputs of the network: the linear estimate of one mask, and what stands beside it.

use std::sync::Arc;

use ndarray::{Array2, Array3, ArrayView3, Axis};
use rayon::prelude::*;

use crate::objects::{ObjectSet, Split};
use crate::progress::CancelToken;
use crate::reconstruction::decoder::{Decoder, PreparedDecoder};
use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::linear::{LinearMmse, Prior};
use crate::reconstruction::model::ImagingModel;
use crate::seeds::SeedStream;
use crate::sensor::{Convolution, Convolver};

/// Channels of the input: linear estimate, its standard deviation, mean object, back-projected residual, coverage.
pub(super) const CHANNELS: usize = 5;
/// The network passes images whose sides are multiples of this, px.
const MULTIPLE: usize = 8;
/// Deviations of the objects in a result of 1 of the network.
const OUTPUT_DEVIATIONS: f32 = 3.0;
/// Factor of the back-projected residual within the hyperbolic tangent, and of the latter.
const RESIDUAL_FACTOR: f32 = 2.0;
/// Least mean measurement that a residual is divided by, photons.
const LEAST_MEAN: f32 = 1.0;
/// Objects that the deviation is computed from.
const SCALE_OBJECTS: usize = 64;

/// Standard deviation of all pixels of training objects about their mean, photons per pixel.
pub(super) fn deviation_of(set: &ObjectSet) -> Result<f64, ReconstructionError> {
    let objects = set.objects(Split::Train, SCALE_OBJECTS, SeedStream::ReconstructionNetwork.derive(0))?;
    Ok(objects.mapv(f64::from).std(0.0).max(f64::MIN_POSITIVE))
}

/// Inverse throughput of a PSF of this sum. Coverage and back-projection are those of a PSF of sum 1, by which networks
/// for any mask are trained.
fn unit_of(sum: f64) -> f32 {
    // A PSF of throughput 1 sums to 1 within rounding. It is not scaled, so its features keep every bit.
    if (sum - 1.0).abs() < 1e-6 { 1.0 } else { (1.0 / sum) as f32 }
}

/// Rows and columns of the images that the network passes.
pub(super) fn padded((rows, cols): (usize, usize)) -> (usize, usize) {
    (rows.next_multiple_of(MULTIPLE), cols.next_multiple_of(MULTIPLE))
}

/// Linear estimates of one mask as inputs of a network.
pub(super) struct Features {
    model: ImagingModel,
    linear: Box<dyn PreparedDecoder>,
    convolver: Convolver,
    /// Inverse mean measurement, divided by the throughput, row by row.
    weights: Vec<f32>,
    /// Standard deviation, mean and coverage, row by row, as the network reads them.
    constant: [Vec<f32>; 3],
    /// Factor from the scale of the set to that of lit objects.
    to_lit: f32,
    /// Standard deviation of the objects, photons.
    deviation: f32,
}

/// One measurement as the network sees it.
pub(super) struct Example {
    /// Linear estimate, row by row, photons per pixel on the scale of the set.
    pub(super) linear: Vec<f32>,
    /// Shape (padded rows, padded cols, channels).
    pub(super) image: Vec<f32>,
}

impl Features {
    /// Prepares a mask. `deviation` is that of the objects, `set_mean` their mean, photons per pixel.
    pub(super) fn new(
        model: &ImagingModel,
        prior: &Arc<Prior>,
        (deviation, set_mean): (f64, f64),
        cancel: &CancelToken,
    ) -> Result<Self, ReconstructionError> {
        let linear = LinearMmse::new(prior.clone()).prepare(model, cancel)?;
        let plan = Convolution::new(model.field(), model.psf().dim())?;
        let convolver = plan.with_psf(model.psf().insert_axis(Axis(0)))?;
        let to_lit = (1.0 / prior.light().to_set_scale(set_mean)) as f32;
        let lit = prior.mean().mapv(|value| value * to_lit);
        let mean = convolver.measure(lit.view().insert_axis(Axis(0)).insert_axis(Axis(0)), model.background)?;
        let zeros = Array2::zeros(model.measurement_shape());
        let posterior = linear.standard_deviation(zeros.view(), cancel)?;
        let posterior = posterior.unwrap_or_else(|| Array2::zeros(model.field()));
        let unit = unit_of(model.psf().sum());
        let mut coverage = vec![0.0; lit.len()];
        convolver.blur_transposed(&vec![unit; zeros.len()], &mut coverage, &mut convolver.blur_workspace());
        let scaled = |image: &mut dyn Iterator<Item = &f32>| image.map(|value| value / deviation as f32).collect();
        Ok(Self {
            constant: [scaled(&mut posterior.iter()), scaled(&mut prior.mean().iter()), coverage],
            weights: mean.iter().map(|&mean| unit / mean.max(LEAST_MEAN)).collect(),
            model: model.clone(),
            linear,
            convolver,
            to_lit,
            deviation: deviation as f32,
        })
    }

    /// The model of the mask.
    pub(super) fn model(&self) -> &ImagingModel {
        &self.model
    }

    /// The linear estimate.
    pub(super) fn linear(&self) -> &dyn PreparedDecoder {
        &*self.linear
    }

    /// Photons of a result of 1 of the network.
    pub(super) fn unit(&self) -> f32 {
        OUTPUT_DEVIATIONS * self.deviation
    }

    /// Measurements (n, rows, cols) of lit objects (n, 1, rows, cols), the first of number `first`.
    pub(super) fn measure(
        &self,
        lit: ndarray::ArrayView4<'_, f32>,
        (first, seed): (usize, u64),
    ) -> Result<Array3<f32>, ReconstructionError> {
        let noiseless = self.convolver.measure(lit, self.model.background)?;
        Ok(self.model.noise.draw_from(noiseless.view(), first, seed))
    }

    /// The examples of measurements (n, rows, cols).
    pub(super) fn examples(
        &self,
        measurements: ArrayView3<'_, f32>,
        cancel: &CancelToken,
    ) -> Result<Vec<Example>, ReconstructionError> {
        let linear = self.linear.reconstruct(measurements, &mut cancel.clone())?;
        let pairs = linear.axis_iter(Axis(0)).into_par_iter().zip(measurements.axis_iter(Axis(0)).into_par_iter());
        let (rows, cols) = self.model.field();
        let (_, padded_cols) = padded((rows, cols));
        let examples = pairs.map_init(
            || (self.convolver.blur_workspace(), vec![0.0; self.weights.len()], vec![0.0; rows * cols]),
            |(memory, residual, projected), (linear, measurement)| {
                let linear: Vec<f32> = linear.iter().copied().collect();
                projected.iter_mut().zip(&linear).for_each(|(lit, &value)| *lit = value * self.to_lit);
                self.convolver.blur(projected, residual, memory);
                let background = self.model.background as f32;
                for ((value, &y), weight) in residual.iter_mut().zip(measurement).zip(&self.weights) {
                    *value = (y - *value - background) * weight;
                }
                self.convolver.blur_transposed(residual, projected, memory);
                let [posterior, mean, coverage] = &self.constant;
                let (padded_rows, _) = padded((rows, cols));
                let mut image = vec![0.0; padded_rows * padded_cols * CHANNELS];
                for (row, line) in image.chunks_exact_mut(padded_cols * CHANNELS).take(rows).enumerate() {
                    for (col, pixel) in line.chunks_exact_mut(CHANNELS).take(cols).enumerate() {
                        let at = row * cols + col;
                        let residual = RESIDUAL_FACTOR * (RESIDUAL_FACTOR * projected[at]).tanh();
                        pixel.copy_from_slice(&[
                            linear[at] / self.deviation,
                            posterior[at],
                            mean[at],
                            residual,
                            coverage[at],
                        ]);
                    }
                }
                Example { linear, image }
            },
        );
        Ok(examples.collect())
    }
}
