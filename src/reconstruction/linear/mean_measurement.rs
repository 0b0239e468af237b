//! Encoder, mean and noise of the measurements that a linear estimate expects.

use ndarray::{ArrayView2, ArrayView3, Axis};

use crate::reconstruction::error::ReconstructionError;
use crate::reconstruction::model::ImagingModel;
use crate::sensor::{Convolution, Convolver};

/// Encoder, mean measurement and noise of a linear estimate.
pub(super) struct MeanMeasurement {
    /// Valid convolution of one plane.
    pub(super) convolver: Convolver,
    /// Expected measurement, row by row, photons per pixel.
    pub(super) mean: Vec<f32>,
    /// Variance of the noise of each pixel, and of the components that the prior leaves out, photons squared.
    pub(super) variance: Vec<f32>,
}

impl MeanMeasurement {
    /// Of objects of the mean `mean` (rows, cols), whose pixels vary by `left_out` (photons squared) beside the covariance of the prior.
    pub(super) fn new(
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
pub(super) fn check(model: &ImagingModel, measurements: &ArrayView3<'_, f32>) -> Result<(), ReconstructionError> {
    model.check_measurements(measurements)?;
    ReconstructionError::check_finite("measurements", measurements)
}
