//! Richardson-Lucy iterations of the cropped model (Richardson 1972, Lucy 1974).
//!
//! Each iteration multiplies the object by the back-projected quotient of measurement and model. The iterations end where the residual is
//! that of the noise; more would fit it. The object starts at one value, and keeps it where the sensor sees next to nothing.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis};

use super::data_term::DataTerm;
use super::decoder::{Decoder, DecoderKind, PreparedDecoder, ReconstructionStep};
use super::error::ReconstructionError;
use super::model::ImagingModel;
use super::one_by_one::{OneByOne, OneImage, check_memory, report};
use crate::progress::{CancelToken, Progress};
use crate::sensor::{Convolution, Convolver};

/// Iterations between reports of the object.
const ROUND: usize = 5;
/// Least sensitivity of a pixel, relative to the largest, that the sensor sees.
const LEAST_SENSITIVITY: f32 = 0.02;
/// Images of the size of the grid that the iterations hold.
const IMAGES: usize = 8;
/// Least model of a pixel, in shares of the mean measurement, that a measurement is divided by.
const LEAST_MODEL: f64 = 1e-4;

/// Richardson-Lucy iterations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RichardsonLucy {
    /// Most iterations.
    pub iterations: usize,
}

impl Default for RichardsonLucy {
    fn default() -> Self {
        Self { iterations: 100 }
    }
}

impl Decoder for RichardsonLucy {
    fn kind(&self) -> DecoderKind {
        DecoderKind::RichardsonLucy
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        _cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        check_memory(model.field(), IMAGES)?;
        let plan = Convolution::new(model.field(), model.psf().dim())?;
        let convolver = plan.with_psf(model.psf().insert_axis(Axis(0)))?;
        Ok(Box::new(OneByOne(Prepared { iterations: self.iterations.max(1), model: model.clone(), convolver })))
    }
}

/// The iterations of one mask.
struct Prepared {
    iterations: usize,
    model: ImagingModel,
    convolver: Convolver,
}

impl OneImage for Prepared {
    fn model(&self) -> &ImagingModel {
        &self.model
    }

    fn object(
        &self,
        measurement: ArrayView2<'_, f32>,
        progress: &mut dyn Progress<ReconstructionStep>,
    ) -> Result<Array2<f32>, ReconstructionError> {
        let data = DataTerm::new(&self.model, measurement)?;
        let (rows, cols) = self.model.field();
        let mut memory = self.convolver.blur_workspace();
        let background = self.model.background as f32;
        let is_measured: Vec<f32> = data.weights.iter().map(|&weight| f32::from(u8::from(weight > 0.0))).collect();
        let mut sensitivity = vec![0.0; rows * cols];
        self.convolver.blur_transposed(&is_measured, &mut sensitivity, &mut memory);
        let least = LEAST_SENSITIVITY * sensitivity.iter().copied().fold(0.0, f32::max);
        let mut object = vec![(data.mean / self.model.psf().sum()) as f32; rows * cols];
        let mut quotient = vec![0.0; data.light.len()];
        let mut correction = vec![0.0; rows * cols];
        let least_model = (LEAST_MODEL * data.mean) as f32;
        let shaped = |object: &[f32]| Array2::from_shape_fn((rows, cols), |(row, col)| object[row * cols + col]);
        for done in 1..=self.iterations {
            self.convolver.blur(&object, &mut quotient, &mut memory);
            let mut misfit = 0.0;
            for ((value, &light), &weight) in quotient.iter_mut().zip(&data.light).zip(&data.weights) {
                misfit += f64::from(weight * (light - *value) * (light - *value));
                let model = (*value + background).max(least_model);
                *value = if weight > 0.0 { (light + background).max(0.0) / model } else { 0.0 };
            }
            if misfit <= data.pixels {
                break;
            }
            self.convolver.blur_transposed(&quotient, &mut correction, &mut memory);
            for ((value, &correction), &sensitivity) in object.iter_mut().zip(&correction).zip(&sensitivity) {
                if sensitivity > least {
                    *value *= (correction / sensitivity).max(0.0);
                }
            }
            let image = (done % ROUND == 0).then(|| Arc::new(shaped(&object)));
            report(progress, &ReconstructionStep::Iteration { done, most: self.iterations, object: image })?;
        }
        Ok(shaped(&object))
    }
}
