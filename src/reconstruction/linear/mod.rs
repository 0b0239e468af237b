//! Linear MMSE estimate: the affine function of the measurement with the least expected squared error.
//!
//! With mean `m` and covariance `C` of the objects, the encoder `A` and the noise variance `D` of the mean measurement, the estimate is
//! `m + C A^T (A C A^T + D)^-1 (y - A m - b)`. It needs the first two moments of the objects and nothing else, so its error is known in
//! closed form. `D` is that of the mean measurement: exact for shot noise, whose variance is the mean.
//!
//! A [`Prior`] holds the moments. [`LinearMmse`] prepares it for a mask: by one Cholesky factor where mosaics have few tiles, by
//! conjugate gradients with Fourier transforms otherwise.

mod cholesky;
mod conjugate_gradients;
mod principal_components;
mod prior;
mod stationary;
mod tiles;

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, ArrayView3, Axis};

use super::decoder::{Decoder, DecoderKind, PreparedDecoder};
use super::error::ReconstructionError;
use super::model::ImagingModel;
use crate::progress::CancelToken;
use crate::sensor::{Convolution, Convolver};
use cholesky::CholeskyDecoder;
use conjugate_gradients::IterativeDecoder;
use prior::Moments;
pub use prior::{Light, Prior};
use stationary::StationaryCovariance;
use tiles::TileCovariance;

/// Most unknowns of a Cholesky factor: its time grows with their cube, half a second for these.
const MOST_UNKNOWNS: usize = 3200;

/// Linear MMSE estimate with a prior.
#[derive(Clone)]
pub struct LinearMmse {
    prior: Arc<Prior>,
}

impl LinearMmse {
    /// The estimate with this prior.
    pub fn new(prior: Arc<Prior>) -> Self {
        Self { prior }
    }
}

impl Decoder for LinearMmse {
    fn kind(&self) -> DecoderKind {
        DecoderKind::Linear
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        let expected = self.prior.field();
        if model.field() != expected {
            let found = model.field();
            return Err(ReconstructionError::shape("field", &[expected.0, expected.1], &[found.0, found.1]));
        }
        Ok(match &self.prior.moments {
            Moments::Tiles(tiles) if tiles.unknowns() <= MOST_UNKNOWNS => {
                Box::new(CholeskyDecoder::new(model, &self.prior, tiles.clone(), cancel)?)
            }
            Moments::Tiles(tiles) => {
                let covariance = TileCovariance::new(model, tiles.clone())?;
                Box::new(IterativeDecoder::new(model, &self.prior, covariance)?)
            }
            Moments::Stationary(stationary) => {
                let covariance = StationaryCovariance::new(model, stationary.clone())?;
                Box::new(IterativeDecoder::new(model, &self.prior, covariance)?)
            }
        })
    }
}

/// Encoder, mean measurement and noise of a linear estimate.
pub(super) struct MeanMeasurement {
    /// Valid convolution of one plane.
    convolver: Convolver,
    /// Expected measurement, row by row, photons per pixel.
    mean: Vec<f32>,
    /// Variance of the noise of each pixel, and of the components that the prior leaves out, photons squared.
    variance: Vec<f32>,
}

impl MeanMeasurement {
    /// Of objects of the mean `mean` (rows, cols), whose pixels vary by `left_out` (photons squared) beside the covariance of the prior.
    fn new(
        model: &ImagingModel,
        mean: ArrayView2<'_, f32>,
        left_out: Option<ArrayView2<'_, f32>>,
    ) -> Result<Self, ReconstructionError> {
        let psf = model.psf();
        let plan = Convolution::new(model.field(), psf.dim())?;
        let measure = |psf: ArrayView2<'_, f64>, object: ArrayView2<'_, f32>, bias: f64| {
            let object = object.insert_axis(Axis(0)).insert_axis(Axis(0));
            let convolver = plan.with_psf(psf.insert_axis(Axis(0)))?;
            let image = convolver.measure(object, bias)?;
            Ok::<_, ReconstructionError>((convolver, image.into_raw_vec_and_offset().0))
        };
        let (convolver, measured) = measure(psf, mean, model.background)?;
        let extra = match left_out {
            Some(left_out) => measure(psf.mapv(|value| value * value).view(), left_out, 0.0)?.1,
            None => vec![0.0; measured.len()],
        };
        let scale = measured.iter().map(|&value| f64::from(value)).sum::<f64>() / measured.len() as f64;
        let variance = measured.iter().zip(&extra);
        let variance = variance
            .map(|(&mean, &extra)| (model.noise_variance(f64::from(mean), scale) + f64::from(extra)) as f32)
            .collect();
        Ok(Self { convolver, mean: measured, variance })
    }
}

/// Checks measurements for a linear estimate: of the right shape and finite.
fn check(model: &ImagingModel, measurements: &ArrayView3<'_, f32>) -> Result<(), ReconstructionError> {
    model.check_measurements(measurements)?;
    ReconstructionError::check_finite("measurements", measurements)
}

/// One tile of shape (side, side), repeated over the field.
fn repeated(tile: &[f32], side: usize, field: (usize, usize)) -> Array2<f32> {
    Array2::from_shape_fn(field, |(row, col)| tile[row % side * side + col % side])
}

#[cfg(test)]
mod tests;
