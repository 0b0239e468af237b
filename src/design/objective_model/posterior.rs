//! Decoder of beads: it gives a lower bound on the information and, by the I-MMSE relation, its gradient.

use std::ops::Range;

use ndarray::{Array2, Array3, ArrayView3, s};

use super::{MaskGradient, ModelFit, ModelValue, ObjectiveModel, WARM_RATE};
use crate::design::error::IdealError;
use crate::design::gradient::GradientDraw;
use crate::forward::ForwardModel;
use crate::information::{
    BeadChannel, Decoder, DecoderFit, DecoderKind, DecoderRefit, PretrainedLowerBound, SampleRange, SceneDraw,
    bead_response_gradient, decoder_information,
};
use crate::optics::{LensletArray, LensletGradient, psf_gradient, render_psf};
use crate::progress::{CancelToken, Progress};
use crate::seeds::SeedStream;

/// Pixels of a patch of 32 x 32 px; larger patches need fewer scenes.
const SMALL: f64 = 32.0 * 32.0;
/// Held-out scenes of such a patch.
const SCENES: usize = 512;
/// Scenes of one block; values rest on whole blocks.
pub(in crate::design) const BLOCK: usize = 64;
/// Factor of the held-out scenes for the last mask.
const LAST: usize = 4;

/// The autoregressive decoder, refitted to the mask.
pub(in crate::design) struct PosteriorModel<'a> {
    forward: &'a ForwardModel,
    patch: (usize, usize),
    seed: u64,
    /// Pretrained weights.
    initial: Decoder,
    decoder: Decoder,
    /// Channel of the mask of the model.
    channel: BeadChannel,
}

impl<'a> PosteriorModel<'a> {
    /// The pretrained decoder.
    ///
    /// # Errors
    /// For objects of unknown prior, and for masks and noise without a channel.
    pub fn new(
        forward: &'a ForwardModel,
        start: &LensletArray,
        patch: (usize, usize),
        seed: u64,
    ) -> Result<Self, IdealError> {
        let channel = channel(forward, start, patch)?;
        channel.check()?;
        let found = "posterior".into();
        let no_decoder =
            IdealError::Setting { name: "objective", found, expected: "density; this build has no pretrained decoder" };
        let initial = Decoder::shipped().ok_or(no_decoder)?.clone();
        Ok(Self { forward, patch, seed, decoder: initial.clone(), initial, channel })
    }
}

impl PosteriorModel<'_> {
    /// Held-out scenes: a multiple of [`BLOCK`].
    pub(in crate::design) fn scenes(&self) -> usize {
        self.equivalent_scenes(SCENES).next_multiple_of(BLOCK)
    }

    /// Number of scenes with about as many pixels as `patches` patches of 32 x 32 px, at most `patches`.
    pub(in crate::design) fn equivalent_scenes(&self, patches: usize) -> usize {
        let pixels = (self.patch.0 * self.patch.1) as f64;
        (patches as f64 * SMALL / pixels).round().clamp(1.0, patches as f64) as usize
    }

    /// Starts a fit from the present weights, which stay in use until it is installed.
    pub(in crate::design) fn refit(
        &self,
        &ModelFit { steps, seed, warm }: &ModelFit,
    ) -> Result<DecoderRefit, IdealError> {
        let mut fit = DecoderFit::of_steps(steps, DecoderKind::Autoregressive, seed);
        if warm {
            fit.rate *= WARM_RATE;
        }
        Ok(DecoderRefit::new(fit, &self.decoder)?)
    }

    /// Continues such a fit up to `steps` of its steps, on measurements through a mask. The token is checked after
    /// every step.
    pub(in crate::design) fn continue_fit(
        &self,
        refit: &mut DecoderRefit,
        array: &LensletArray,
        steps: usize,
        cancel: &CancelToken,
    ) -> Result<(), IdealError> {
        if refit.steps() < steps {
            let channel = channel(self.forward, array, self.patch)?;
            refit.advance_to(&channel, steps, &mut cancel.clone())?;
        }
        Ok(())
    }

    /// Information gain of some of the held-out scenes through a mask, bits; all of them give a [`lower_bound`].
    pub(in crate::design) fn held_out_gains(
        &self,
        array: &LensletArray,
        scenes: Range<usize>,
        progress: &mut dyn Progress<usize>,
    ) -> Result<Vec<f64>, IdealError> {
        let seed = SeedStream::RunLowerBound.derive(self.seed);
        self.gains(array, &SceneDraw { scenes, seed, block: BLOCK }, progress)
    }

    /// Information gain of scenes through a mask, bits.
    pub(in crate::design) fn gains(
        &self,
        array: &LensletArray,
        draw: &SceneDraw,
        progress: &mut dyn Progress<usize>,
    ) -> Result<Vec<f64>, IdealError> {
        let channel = channel(self.forward, array, self.patch)?;
        Ok(decoder_information(&self.decoder, &channel, draw, progress)?)
    }
}

/// Lower bound by the information gain of all held-out scenes, bits.
pub(in crate::design) fn lower_bound(gains: Vec<f64>) -> ModelValue {
    let PretrainedLowerBound { bits_per_pixel, interval_95, .. } = PretrainedLowerBound::of_savings(gains);
    ModelValue { bits_per_pixel, interval_95 }
}

impl ObjectiveModel for PosteriorModel<'_> {
    fn retarget(&mut self, array: &LensletArray, warm: bool) -> Result<(), IdealError> {
        self.channel = channel(self.forward, array, self.patch)?;
        if !warm {
            self.decoder = self.initial.clone();
        }
        Ok(())
    }

    fn fit(&mut self, fit: &ModelFit, progress: &mut dyn Progress<f64>) -> Result<(), IdealError> {
        let steps = fit.steps;
        let mut refit = self.refit(fit)?;
        refit.advance_to(&self.channel, steps, &mut |step: &usize| progress.report(&(*step as f64 / steps as f64)))?;
        self.install(refit);
        Ok(())
    }

    fn value(
        &self,
        array: &LensletArray,
        last: bool,
        progress: &mut dyn Progress<usize>,
    ) -> Result<ModelValue, IdealError> {
        let scenes = if last { LAST * self.scenes() } else { self.scenes() };
        Ok(lower_bound(self.held_out_gains(array, 0..scenes, progress)?))
    }

    fn posterior(&self) -> Option<&PosteriorModel<'_>> {
        Some(self)
    }

    fn install(&mut self, fit: DecoderRefit) {
        self.decoder = fit.decoder();
    }

    fn gradient(&self, array: &LensletArray, draw: &GradientDraw, _progress: &mut dyn Progress<usize>) -> MaskGradient {
        self.forward.posterior_gradient(array, self.patch, draw.patches, draw.seed, &self.decoder)
    }

    fn to_bytes(&self, details: Vec<(&str, String)>) -> Result<Vec<u8>, IdealError> {
        Ok(self.decoder.to_bytes_with(details)?)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), IdealError> {
        self.decoder = Decoder::from_bytes(bytes)?;
        Ok(())
    }

    fn is_upper_bound(&self) -> bool {
        false
    }
}

impl ForwardModel {
    /// Gradient of the information by every lenslet, bits per pixel and unit of the parameter: the mean over `patches` freshly drawn
    /// patches of shape `patch` (rows, cols), by the posterior means of the decoder.
    ///
    /// # Errors
    /// For objects of unknown prior, and where mask, objects and patches do not belong together.
    pub fn posterior_gradient(
        &self,
        array: &LensletArray,
        patch: (usize, usize),
        patches: usize,
        seed: u64,
        decoder: &Decoder,
    ) -> Result<Vec<LensletGradient>, IdealError> {
        let bead = &self.set.bead_prior().ok_or_else(no_prior)?.spot;
        let by_response = bead_response_gradient(
            &channel(self, array, patch)?,
            decoder,
            SampleRange { seed, first: 0, count: patches },
        )?;
        Ok(psf_gradient(array, by_psf(by_response.view(), bead).view())?)
    }
}

fn channel(forward: &ForwardModel, array: &LensletArray, patch: (usize, usize)) -> Result<BeadChannel, IdealError> {
    let psf = render_psf(array, forward.set.planes())?;
    forward.bead_channel(psf.view(), patch).ok_or_else(no_prior)
}

fn no_prior() -> IdealError {
    IdealError::Setting {
        name: "objective",
        found: "posterior".into(),
        expected: "density; only beads at a density below 1 have a decoder",
    }
}

/// Gradient by the point spread function from the gradient by the response to a bead, both (planes, rows, cols). `bead` is the
/// bead that blurs the PSF; this is the adjoint of the blur.
fn by_psf(by_response: ArrayView3<'_, f64>, bead: &Array2<f64>) -> Array3<f64> {
    let (planes, rows, cols) = by_response.dim();
    let (rows, cols) = (rows + 1 - bead.nrows(), cols + 1 - bead.ncols());
    let mut by_psf = Array3::zeros((planes, rows, cols));
    for ((row, col), &photons) in bead.indexed_iter() {
        by_psf.scaled_add(photons, &by_response.slice(s![.., row..row + rows, col..col + cols]));
    }
    by_psf
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::bead_response;
    use crate::objects::{ObjectOptions, ObjectSet};
    use crate::optics::heuristic_layout;
    use crate::sensor::Noise;

    #[test]
    fn gains_by_parts_are_those_of_all_scenes() {
        let options = ObjectOptions { field: (47, 47), mean_photons: 100.0, ..ObjectOptions::default() };
        let set = ObjectSet::open(&"beads:0.02".parse().unwrap(), &options).unwrap();
        let forward = ForwardModel::new(set.clone(), (32, 32), 10.0, Noise::Shot).unwrap();
        let mask = heuristic_layout(3);
        let model = PosteriorModel::new(&forward, &mask, (8, 8), 1).unwrap();
        let gains = |scenes: Range<usize>| model.held_out_gains(&mask, scenes, &mut CancelToken::new()).unwrap();
        let mut parts = Vec::new();
        for end in [8, 24, 30, 300, model.scenes()] {
            parts.extend(gains(parts.len()..end));
        }
        assert_eq!(parts, gains(0..model.scenes()));
        assert!(parts.iter().any(|bits| (bits - parts[0]).abs() > 1e-3), "scenes differ");
        assert_eq!(lower_bound(parts), model.value(&mask, false, &mut CancelToken::new()).unwrap());
    }

    #[test]
    fn gradient_by_the_psf_is_the_adjoint_of_the_blur() {
        let number = |place: usize| ((place * 7 + place * place) % 13) as f64 - 5.0;
        let bead = Array2::from_shape_fn((3, 2), |(r, c)| number(r * 2 + c));
        let psf = Array3::from_shape_fn((2, 4, 5), |(z, r, c)| number(z * 20 + r * 5 + c));
        let by_response = Array3::from_shape_fn((2, 6, 6), |(z, r, c)| number(z * 36 + r * 6 + c + 3));
        let (there, back) = (bead_response(&bead, psf.view()), by_psf(by_response.view(), &bead));
        assert_eq!((there.dim(), back.dim()), (by_response.dim(), psf.dim()));
        assert!(((there * &by_response).sum() - (back * &psf).sum()).abs() < 1e-9);
    }
}
