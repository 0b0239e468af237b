//! Objective models: models of the measurements that give the information of a mask and its gradient.

mod density;
mod held_out;
mod pixelcnn;
mod posterior;

pub(super) use density::DensityModel;
pub(super) use pixelcnn::PixelCnnModel;
pub(super) use posterior::{BLOCK, PosteriorModel, lower_bound};

use super::error::IdealError;
use super::gradient::GradientDraw;
use crate::information::{CausalModel, DecoderRefit};
use crate::optics::{LensletArray, LensletGradient};
use crate::progress::Progress;

/// Factor of the learning rate of warm fits.
const WARM_RATE: f64 = 0.5;

/// Patches that a density model takes its data scale from.
const SAMPLE: usize = 256;

/// Length and start of one fit.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModelFit {
    /// Steps of the fit.
    pub steps: usize,
    /// Seed of its patches.
    pub seed: u64,
    /// Whether it starts from weights that were fitted to a similar mask.
    pub warm: bool,
}

/// Information of a mask by a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ModelValue {
    /// Information, bits per pixel.
    pub bits_per_pixel: f64,
    /// 95 % interval, bits per pixel.
    pub interval_95: [f64; 2],
}

/// Gradient of the information by every lenslet.
pub(super) type MaskGradient = Result<Vec<LensletGradient>, IdealError>;

/// A model of the measurements that is fitted to the mask in every round.
pub(super) trait ObjectiveModel {
    /// Points the model at another mask, with its present weights or, where it is not `warm`, with those of the start.
    fn retarget(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError>;

    /// Fits the weights to fresh training measurements of the mask; reports the share of the fit that is done, 0 to 1.
    fn fit(&mut self, fit: &ModelFit, progress: &mut dyn Progress<f64>) -> Result<(), IdealError>;

    /// Information of a mask on held-out objects, the same ones every time; on more of them for the `last` value of a run.
    /// Reports the number of measurements so far.
    fn value(
        &self,
        array: &LensletArray,
        last: bool,
        progress: &mut dyn Progress<usize>,
    ) -> Result<ModelValue, IdealError>;

    /// Gradient of the information by every lenslet; reports the number of patches so far.
    fn gradient(&self, array: &LensletArray, draw: &GradientDraw, progress: &mut dyn Progress<usize>) -> MaskGradient;

    /// Weights and `details`, as the bytes of a safetensors file.
    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError>;

    /// Restores the weights of such a file.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError>;

    /// Whether values are upper bounds, which a stale model overestimates; lower bounds stay valid.
    fn is_upper_bound(&self) -> bool;

    /// The decoder, for models that have one. It can be fitted and evaluated in parts while the mask moves.
    fn posterior(&self) -> Option<&PosteriorModel<'_>> {
        None
    }

    /// Installs the weights of such a fit.
    fn install(&mut self, _fit: DecoderRefit) {}

    /// Continues a fit up to `steps` of its steps on measurements of the moving mask, and uses its weights at once. Reports the
    /// number of steps so far. Returns whether the model can be fitted so.
    fn fit_online(
        &mut self,
        _fit: &ModelFit,
        _array: &LensletArray,
        _steps: usize,
        _progress: &mut dyn Progress<usize>,
    ) -> Result<bool, IdealError> {
        Ok(false)
    }

    /// The causal density model, for models that have one.
    fn density_model(&self) -> Option<&CausalModel> {
        None
    }
}
