//! Total variation with non-negativity, by ADMM.
//!
//! The object is the minimum of `1/2 sum_i (y_i - b - (h * o)_i)^2 / var_i + weight TV(o)` among objects without negative light, with the
//! isotropic total variation. As in Antipa et al. (Optica 5, 1, 2018) the crop to the sensor is a split of its own. So every step is a
//! division: of pixels (crop, gradients, sign) or of frequencies (the object). `var_i` is the variance of the noise at the local mean of
//! the measurement. The weight is chosen by discrepancy: it rises while the residual is below that of the noise, and falls while it is
//! above, down to a least weight.

mod splits;

use std::sync::Arc;

use ndarray::{Array2, ArrayView2};
use rustfft::num_complex::Complex32;

use super::data_term::DataTerm;
use super::decoder::{Decoder, DecoderKind, PreparedDecoder, ReconstructionStep};
use super::error::ReconstructionError;
use super::fourier::Fourier;
use super::model::ImagingModel;
use super::one_by_one::{OneByOne, OneImage, check_memory, report};
use crate::progress::{CancelToken, Progress};
use splits::{Penalties, Splits, Target};

/// Iterations between changes of the weight, and between reports of the object.
const ROUND: usize = 5;
/// First and least weight, in units of the root of the typical data weight. Where the residual stays above the noise at this weight, it is
/// the error of the model, such as of a photographed PSF, and a smaller weight would fit it.
const LEAST_WEIGHT: f64 = 0.03;
/// Largest change of the weight in a round.
const LARGEST_CHANGE: f64 = 1.3;
/// Images of the size of the grid that the iterations hold.
const IMAGES: usize = 17;

/// Total variation with non-negativity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TotalVariation {
    /// Most iterations.
    pub iterations: usize,
    /// Weight of the total variation of the object in units of its mean; `None` chooses it by discrepancy.
    pub weight: Option<f64>,
}

impl Default for TotalVariation {
    fn default() -> Self {
        Self { iterations: 300, weight: None }
    }
}

impl Decoder for TotalVariation {
    fn kind(&self) -> DecoderKind {
        DecoderKind::TotalVariation
    }

    fn prepare(
        &self,
        model: &ImagingModel,
        _cancel: &CancelToken,
    ) -> Result<Box<dyn PreparedDecoder>, ReconstructionError> {
        check_memory(model.field(), IMAGES)?;
        let fourier = Fourier::at_least(model.field());
        let encoder = fourier.spectrum_of(model.psf().mapv(|value| value as f32).view());
        Ok(Box::new(OneByOne(Prepared { settings: *self, model: model.clone(), fourier, encoder })))
    }
}

/// The decoder with the spectrum of one mask.
struct Prepared {
    settings: TotalVariation,
    model: ImagingModel,
    fourier: Fourier,
    encoder: Vec<Complex32>,
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
        // The object in units of its mean, so that penalties and weight suit any light.
        let throughput = self.model.psf().sum();
        let unit = data.mean / throughput;
        let corner = (self.model.psf().nrows() - 1, self.model.psf().ncols() - 1);
        let target = Target::new(&data, unit, corner);
        let level = data.typical_weight() * unit * unit;
        let energy = self.model.psf().iter().map(|&value| value * value).sum();
        let penalties = Penalties::of(level, energy);
        let mut weight = self.settings.weight.unwrap_or(LEAST_WEIGHT * level.sqrt());
        let mut splits = Splits::new(&self.fourier, throughput as f32);
        let most = self.settings.iterations.max(1);
        for done in 1..=most {
            let misfit = splits.step(&self.fourier, &self.encoder, &target, penalties, weight as f32);
            let is_round = done % ROUND == 0;
            if is_round && self.settings.weight.is_none() {
                let change = (data.pixels / misfit.max(f64::MIN_POSITIVE)).sqrt();
                weight = (weight * change.clamp(1.0 / LARGEST_CHANGE, LARGEST_CHANGE)).max(LEAST_WEIGHT * level.sqrt());
            }
            let object = is_round.then(|| Arc::new(splits.object(self.fourier.shape().1, self.model.field(), unit)));
            report(progress, &ReconstructionStep::Iteration { done, most, object })?;
        }
        Ok(splits.object(self.fourier.shape().1, self.model.field(), unit))
    }
}

#[cfg(test)]
mod tests;
